"""Small errors put into leaf functions one at a time, to see that a test notices each: `python -m mutants`."""
