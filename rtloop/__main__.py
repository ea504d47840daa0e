"""`python -m rtloop ARM [--set section.key=value]...`: the control process of an arm.

Prints `ready` when the arm has been brought up; with `control.init_mode` 0 its homing begins then. Exit codes: 0
orderly end, 2 refused to start, the arm could not be brought up, or a conversation failed while it was shut down, 3
the cycle ended by itself or takes no orders.
"""

from rtloop.process.program import STOP_SIGNALS, arm_of, arm_parser, compiled_cycle, say, tell

# isort: split
import sys

from config.errors import ConfigError
from rtloop.kept import commissioned
from rtloop.process.another_file import refuse_another_file
from rtloop.process.control_process import CannotStart, ControlProcess, StopAsked
from rtloop.wire.refusal import WireRefused
from shm.errors import SharedMemoryError


def main(arguments: list[str] | None = None) -> int:
    try:
        parser = arm_parser("python -m rtloop", "The control process of an arm.")
        parser.add_argument("--clear-fault", action="store_true", help="clear what a drive has tripped at before")
        options = parser.parse_args(arguments)
        arm = arm_of(options)
        refuse_another_file(arm)
        if sentence := commissioned.withheld(arm):
            raise CannotStart(sentence)
        stop_asked = StopAsked(STOP_SIGNALS)
        process = ControlProcess(arm, compiled_cycle(stop_asked), tell, stop_asked)
        return process.serve(lambda: say("ready", sys.stdout), clears_protection=options.clear_fault)
    except (ConfigError, SharedMemoryError, CannotStart, WireRefused) as error:
        tell(str(error))
        return 2


if __name__ == "__main__":
    sys.exit(main())
