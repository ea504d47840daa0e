"""What `rtarm view` does before the page is there: which arm, where its file is, what serves it."""

from __future__ import annotations

from collections.abc import Callable

from config.errors import ConfigError
from config.loader import known_arms, load_arm
from config.schema import ArmConfig
from rtarm.errors import Refusal
from rtarm.status import resolve_arm
from rtarm.view.gate import open_server
from rtarm.view.orders import Orders
from rtarm.view.run import serve
from rtarm.view.source import LiveArm
from rtarm.view.words import words_of


def view_arm(argument: str | None, host: str, port: int | None, language: str, tell: Callable[[str], None]) -> None:
    """Serve the page of a running arm until a signal (`host` and `port` as in `gate.open_server`).

    Raises:
        Refusal, ConfigError, SharedMemoryError: no such arm runs, or its page cannot be served.
    """
    words = words_of(language)
    arm = arm_of(argument)
    source = LiveArm(arm)
    page = open_server(host, port)
    if page.reachable_from_elsewhere:
        tell(
            "Other machines can connect, and nothing on the way is encrypted: whoever has or overhears this address "
            "moves the arm. `ssh -L` needs no --host (docs/security.md)."
        )
    tell(f"{page.url} shows {arm.name}; Ctrl-C ends the page, and the arm goes on.")
    serve(page.server, arm, source, Orders(arm, words), words)


def arm_of(argument: str | None) -> ArmConfig:
    """The configuration of the arm that is meant: a name, the path of its file, or None for the only one that runs.

    Raises:
        Refusal: none or several run, or one runs whose file cannot be known from its name.
        ConfigError: the arm file cannot be read.
    """
    name = resolve_arm(argument)
    if argument is not None and argument != name:
        return load_arm(argument)
    if name not in known_arms():
        raise Refusal(
            f"Arm {name} is none of those that come with rtarm, and the page is drawn from the arm file: give its "
            f"path, such as `rtarm view ./{name}.yaml`."
        )
    try:
        return load_arm(name)
    except ConfigError:  # such as an adapter that is only given with `rtarm up`
        return load_arm(name, overrides={"bus": {"channel": "simulated"}})
