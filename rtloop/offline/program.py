"""What the programs beside an offline cycle share: one arm, a line in and lines out, sentences for what they refuse.

Importing this takes the signals over first, as `rtloop.process.program` does.
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
"""Works with an arm through a port, letting time pass with the function it is given."""


def run(
    arguments: list[str] | None, program: str, does: str, serve: Serve, *, alone: str, refuses: type[Exception]
) -> int:
    """The exit code of one such program, as of `python -m rtloop`; what is refused is said as `refused …`.

    `does` is what its help says. `alone` begins the sentence about an arm that another control process has, and
    `refuses` is what `serve` raises beside failed talks, with a sentence.
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
    """The next line of the standard input, empty at its end."""
    while not heard_more():
        pause()
    return sys.stdin.readline().strip()


def heard_more() -> bool:
    """Whether the standard input has a line, or has ended."""
    return bool(select.select([sys.stdin], (), (), 0)[0])


def say(word: str, text: str) -> None:
    """A line for the program that has started this one."""
    print(word, text, flush=True)
