"""What a wire's bytes turned out to be, for the cycle."""

NOTHING = 0
FRAME = 1
CONTROLLER_ERROR = 2
"""An error frame that the controller's driver has made; its id is the class."""
