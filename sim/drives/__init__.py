"""Simulated drives, one file a family (`zdt.py`), and the ramp and the shaft they are made of."""
