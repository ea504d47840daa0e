"""Transcripts: everything that the control cycle says in a hundred scenarios of virtual time, kept to be compared.

PYTHONPATH=tests python -m transcripts                      # run all, and tell the first difference of each in words
PYTHONPATH=tests python -m transcripts --record pause       # record one anew

`scenarios` are what happens, `tape` listens, `words` says where the published words stand today, `store` keeps a
transcript in a small file, `compare` finds the first difference.
"""
