"""The file of an arm of which only the name is known: neither shared memory nor a recording has more than its hash."""

from __future__ import annotations

from config.errors import ConfigError
from config.loader import known_arms, load_arm
from config.schema import ArmConfig
from rtarm.errors import Refusal
from rtarm.launcher import SIMULATED_CHANNEL
from rtarm.status import is_path


def arm_file(argument: str | None, arm: str, given_as: str = "--arm") -> ArmConfig:
    """The configuration of an arm: from the file that was named, or that of an arm that comes with rtarm.

    Args:
        argument: the arm as a person gave it: a name, the path of a file, or None.
        arm: its name.
        given_as: what a path stands behind on the command line, for the sentence.

    Raises:
        Refusal: no file was named and the arm is none of those.
        ConfigError: it cannot be read.
    """
    given = argument if argument is not None and is_path(argument) else arm
    if given == arm and arm not in known_arms():
        raise Refusal(
            f"Arm {arm} is none of those that come with rtarm, and its arm file is needed here: give its path, "
            f"`{given_as} ./{arm}.yaml`."
        )
    try:
        return load_arm(given)
    except ConfigError:  # such as an adapter that is only given with `rtarm up`
        return load_arm(given, overrides={"bus": {"interface": "slcan", "channel": SIMULATED_CHANNEL}})
