"""How a drive that plans its own ramp is led back onto the plan: by a share of the measured error in its speed."""

ERROR_SHARE_1_S = 8.0
"""Share of the measured error that goes into the speed, per second: corrected within about 1/8 s."""
ERROR_SPEED_SHARE = 0.25
"""That part of the speed never exceeds this share of the joint's highest velocity: a held joint is not rushed at."""
