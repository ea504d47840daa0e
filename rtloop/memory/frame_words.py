"""What kind of classic CAN frame one is, as bits; none of them: a data frame with a standard identifier (11 bits)."""

STANDARD = 0
EXTENDED = 1
"""Its identifier has 29 bits."""
REMOTE = 2
"""It asks for data and has none; its length is how many are asked for."""
