"""`rtarm replay`: a recording played back, on the page that shows an arm or on the arm itself."""
