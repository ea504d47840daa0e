"""Which arm file belongs to a recording: it is not in it, only its hash is."""

from __future__ import annotations

from config.errors import ConfigError
from config.loader import known_arms, load_arm
from config.schema import ArmConfig
from rtarm.errors import Refusal
from rtarm.launcher import SIMULATED_CHANNEL


def arm_file(argument: str | None, arm: str) -> ArmConfig:
    """The file that was named, or that of an arm that comes with rtarm.

    Raises:
        Refusal: none was named and the arm is none of those.
        ConfigError: it cannot be read.
    """
    given = argument if argument is not None and ("/" in argument or argument.endswith((".yaml", ".yml"))) else arm
    if given == arm and arm not in known_arms():
        raise Refusal(f"{arm} is no arm that comes with rtarm: say which file it has, such as `--arm ./{arm}.yaml`.")
    try:
        return load_arm(given)
    except ConfigError:  # such as an adapter that is only given with `rtarm up`
        return load_arm(given, overrides={"bus": {"interface": "slcan", "channel": SIMULATED_CHANNEL}})
