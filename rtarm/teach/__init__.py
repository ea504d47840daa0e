"""Motions taught by hand: recorded from an arm that is led, smoothed, timed anew inside its limits, and played.

`recording` reads what the encoders said, `smoothing` and `timing` are the mathematics, `making` goes from one to the
other, `file` keeps the result, `teach` and `play` are the commands.
"""
