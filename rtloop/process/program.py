"""What the programs of a control process share: their arm, the compiled cycle, their messages.

To be imported before anything else, since it takes the signals over.
"""

import os
import signal

_NOHUP = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT, *(() if _NOHUP else (signal.SIGHUP,)))
"""SIGHUP comes when the terminal is closed; under nohup(1) it stays ignored, so that the process outlives that."""
for _number in STOP_SIGNALS:
    # During the imports there is nothing to clean up, and an exception from a handler may be lost inside an import.
    signal.signal(_number, lambda *_: os._exit(0))

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy's threads have nothing to do here

import argparse
import errno
import subprocess
import sys
import time
from typing import TextIO

from compilation.cache import ROOT
from config.loader import load_arm, parse_overrides
from config.schema import ArmConfig
from rtloop.process import compiled
from rtloop.process.control_process import CannotStart, StopAsked

COMPILER_POLL_S = 0.02
NOBODY_READS = (errno.EPIPE, errno.EIO, errno.ENXIO, errno.EBADF)


def arm_parser(program: str, description: str) -> argparse.ArgumentParser:
    """The parser of a command line that names an arm, and the settings that it changes."""
    parser = argparse.ArgumentParser(prog=program, description=description)
    parser.add_argument("arm", help="name of an arm, or path of its YAML file")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="change a setting")
    return parser


def arm_of(options: argparse.Namespace) -> ArmConfig:
    """Load the arm that such a command line names; raises ConfigError."""
    return load_arm(options.arm, overrides=parse_overrides(options.set))


def compiled_cycle(stop_asked: StopAsked) -> compiled.CompiledCycle:
    """Load the compiled cycle; if there is none, another process compiles it, so that this one never holds a compiler.

    Raises CannotStart, and SystemExit when a signal asks for shutdown meanwhile.
    """
    try:
        return compiled.load()
    except (OSError, compiled.NotLoadable):
        pass
    search = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    made = subprocess.Popen(
        [sys.executable, "-m", "rtloop.warm"],
        env={**os.environ, "PYTHONPATH": search},
        stdout=sys.stderr,
        start_new_session=True,  # a Ctrl-C reaches this process alone, which then ends the compiler
    )
    while made.poll() is None and not stop_asked.yes:  # a handler that raised could leave the compiler behind
        time.sleep(COMPILER_POLL_S)
    if stop_asked.yes:
        made.kill()
        made.wait()
        raise SystemExit(0)
    try:
        return compiled.load()
    except (OSError, compiled.NotLoadable) as problem:
        raise CannotStart(
            f"The control cycle could not be compiled ({problem}; the compiler ended with code {made.returncode}): see "
            f"the lines above, and make sure that {compiled.path().parent} can be written."
        ) from problem


def tell(sentence: str) -> None:
    """Print a message for the operator; a terminal or reader that is gone disturbs neither operation nor shutdown."""
    say(f"rtloop: {sentence}", sys.stderr)


def say(line: str, stream: TextIO) -> None:
    """Print a line; if nobody can read the stream any more, it goes to /dev/null from now on."""
    try:
        print(f"{line}\n", end="", file=stream, flush=True)  # one piece: several threads have lines to print
    except OSError as problem:
        if problem.errno in NOBODY_READS:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())  # what is left in its buffer goes there too
            os.close(nowhere)
