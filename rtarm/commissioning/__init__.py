"""`rtarm commission`: the bench test of one drive, with a person beside it."""
