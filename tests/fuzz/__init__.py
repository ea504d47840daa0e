"""Hostile inputs by the million: `PYTHONPATH=tests python -m fuzz` for the long run, tests/fuzz/test_*.py for a sample.

A case is one input that was judged. It is made of three words, its target, the run's seed and its number, and
nothing else, so that `--again TARGET-SEED-NUMBER` makes it once more.
"""
