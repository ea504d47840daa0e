"""What an arm is: the schema, the YAML arm files, and every figure that follows from them.

This package imports nothing else of rtarm. `load_arm` is the one way from a name or a file to a
validated, frozen `ArmConfig`; `check_budget` then says whether the bus can carry it.
"""

from config.budget import check_budget
from config.errors import ConfigError
from config.loader import arm_hash, known_arms, load_arm
from config.schema import ArmConfig

__all__ = ["ArmConfig", "ConfigError", "arm_hash", "check_budget", "known_arms", "load_arm"]
