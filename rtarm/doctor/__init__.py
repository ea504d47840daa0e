"""`rtarm doctor`: what on this machine makes control cycles late or a bus slow, and what mends it.

`machine` reads the machine, `checks` is the one table of what is looked at, the files beside it hold the checks
themselves, `report` runs and shows them, `repair` does what `--fix` may do.
"""
