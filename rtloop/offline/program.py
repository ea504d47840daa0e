"""What the programs with an offline cycle share: one arm, orders as input lines, answers as output lines, refusals.

Importing this module takes over the signals first, as `rtloop.process.program` does.
"""

from __future__ import annotations

from rtloop.process.program import STOP_SIGNALS, arm_of, arm_parser, compiled_cycle, tell

# isort: split
import select
import sys
from collections.abc import Callable

from config.errors import ConfigError
from config.schema import ArmConfig
from rtloop.process.control_process import CannotStart, ControlProcess, StopAsked
from rtloop.service.conversation import DialogueFailed
from rtloop.service.port import ServicePort
from rtloop.wire.refusal import WireRefused
from shm.errors import AlreadyHeld, SharedMemoryError, led_already

Serve = Callable[[ArmConfig, ServicePort, Callable[[], None]], None]
"""Works with an arm through a port; it calls the given function to let time pass."""


def run(
    arguments: list[str] | None, program: str, does: str, serve: Serve, *, alone: str, refuses: type[Exception]
) -> int:
    """Run such a program and return its exit code, as of `python -m rtloop`; a refusal is printed as `refused …`.

    `does` is the text of its help. `alone` begins the sentence about an arm that another control process has.
    `refuses` is the exception, with a sentence, that `serve` raises besides failed dialogues.
    """
    try:
        arm = arm_of(arm_parser(program, does).parse_args(arguments))
        stop_asked = StopAsked(STOP_SIGNALS)
        process = ControlProcess(arm, compiled_cycle(stop_asked), tell, stop_asked)
        return process.serve_offline(lambda port, pause: serve(arm, port, pause))
    except AlreadyHeld as error:
        say("refused", f"{led_already(alone)} ({error})")
    except (ConfigError, SharedMemoryError, CannotStart, WireRefused, DialogueFailed, refuses) as error:
        say("refused", str(error))
    return 2


def next_line(pause: Callable[[], None]) -> str:
    """Wait for the next line of the standard input; empty at its end."""
    while not heard_more():
        pause()
    return sys.stdin.readline().strip()


def heard_more() -> bool:
    """Whether the standard input has a line to read, or has ended."""
    return bool(select.select([sys.stdin], (), (), 0)[0])


def say(word: str, text: str) -> None:
    """Print a line for the program that has started this one."""
    print(word, text, flush=True)
