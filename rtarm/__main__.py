"""`rtarm`, and `python -m rtarm`."""

from __future__ import annotations

import signal


def main() -> None:
    """The command line. Until it has been imported there is nothing to end in order: Ctrl-C just ends it."""
    interrupt = signal.signal(signal.SIGINT, signal.SIG_DFL)
    from rtarm.cli.application import app

    signal.signal(signal.SIGINT, interrupt)
    app(prog_name="rtarm")


if __name__ == "__main__":
    main()
