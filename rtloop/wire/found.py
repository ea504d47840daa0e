"""Results of decoding a wire's bytes in the cycle."""

NOTHING = 0
FRAME = 1
CONTROLLER_ERROR = 2
"""An error frame that the controller's driver has made; its id is the class."""
