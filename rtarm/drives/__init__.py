"""`rtarm drives`: what the drives of an arm are set to, beside what its file says."""
