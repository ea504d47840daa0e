"""`python -m rtloop ARM [--set section.key=value]...`: the control process of an arm.

Prints `ready` when the arm holds. Exit codes: 0 orderly end, 2 refused to start, 3 ended by a fault of its own.
"""

import argparse
import sys

from config.errors import ConfigError
from config.loader import load_arm, parse_overrides
from rtloop import warm
from shm.errors import SharedMemoryError


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rtloop", description="The control process of an arm.")
    parser.add_argument("arm", help="name of an arm, or path of its YAML file")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="change a setting")
    options = parser.parse_args(arguments)
    try:
        arm = load_arm(options.arm, overrides=parse_overrides(options.set))
    except ConfigError as error:
        return refuse(error)
    warm.main(tell)
    from rtloop.process import CannotStart, ControlProcess, install_signals  # compiled code: only once it is needed
    from rtloop.wire.tty import WireRefused

    try:
        process = ControlProcess(arm, tell)
        install_signals(process)
        return process.serve(lambda: print("ready", flush=True))
    except (ConfigError, SharedMemoryError, CannotStart, WireRefused) as error:
        return refuse(error)


def tell(sentence: str) -> None:
    print(f"rtloop: {sentence}", file=sys.stderr, flush=True)


def refuse(error: Exception) -> int:
    tell(str(error))
    return 2


if __name__ == "__main__":
    sys.exit(main())
