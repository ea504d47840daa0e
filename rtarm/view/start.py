"""What `rtarm view` does before the page is there: which arm, where its file is, what serves it."""

from __future__ import annotations

from collections.abc import Callable

from rtarm.running.arm_file import arm_file
from rtarm.running.status import resolve_arm
from rtarm.view.gate import open_server
from rtarm.view.orders import Orders
from rtarm.view.run import serve
from rtarm.view.source import LiveArm
from rtarm.view.words import WORDS
from sentences.meaning import Language


def view_arm(
    argument: str | None, host: str, port: int | None, language: Language, tell: Callable[[str], None]
) -> None:
    """Serve the page of a running arm until a signal (`host` and `port` as in `gate.open_server`).

    Raises:
        Refusal, ConfigError, SharedMemoryError: no such arm runs, or its page cannot be served.
    """
    words = WORDS[language]
    arm = arm_file(argument, resolve_arm(argument), "rtarm view")
    source = LiveArm(arm, language)
    page = open_server(host, port)
    if page.reachable_from_elsewhere:
        tell(
            "Other machines can connect, and nothing on the way is encrypted: whoever has or overhears this address "
            "moves the arm. `ssh -L` needs no --host (docs/explanation/security.md)."
        )
    tell(f"{page.url} shows {arm.name}; Ctrl-C ends the page, and the arm goes on.")
    serve(page.server, arm, source, Orders(arm, words), words)
