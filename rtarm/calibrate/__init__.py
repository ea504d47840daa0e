"""`rtarm calibrate`: direction, ratio and zero of each joint, found step by step by a person before the arm."""
