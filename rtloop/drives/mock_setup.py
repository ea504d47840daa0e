"""A mock drive has nothing to set up."""

import numpy as np

from config.joint import JointConfig
from config.schema import ArmConfig


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Do nothing: a mock drive needs the common parameters only."""
