"""What the programs of a control process share: their arm, the compiled cycle, what they tell.

To be imported before anything else: it takes the signals over.
"""

import os
import signal

_NOHUP = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT, *(() if _NOHUP else (signal.SIGHUP,)))
"""The last when its terminal is closed; nohup(1) lets it outlive that."""
for _number in STOP_SIGNALS:
    # While everything is loaded there is nothing to put in order, and an exception may be lost inside an import.
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
    """For a command line that names an arm, and the settings that it changes."""
    parser = argparse.ArgumentParser(prog=program, description=description)
    parser.add_argument("arm", help="name of an arm, or path of its YAML file")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="change a setting")
    return parser


def arm_of(options: argparse.Namespace) -> ArmConfig:
    """The arm that such a command line names; raises ConfigError."""
    return load_arm(options.arm, overrides=parse_overrides(options.set))


def compiled_cycle(stop_asked: StopAsked) -> compiled.CompiledCycle:
    """The compiled cycle; where there is none, another process compiles it, so that this one never holds a compiler.

    Raises CannotStart, and SystemExit when a signal asks for the end meanwhile.
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
        start_new_session=True,  # a Ctrl-C is for this process alone, which then ends it
    )
    while made.poll() is None and not stop_asked.yes:  # an exception out of a signal's handler could lose the compiler
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
    """For people; where they have closed the terminal, or ended who listens, the arm is led and ended all the same."""
    say(f"rtloop: {sentence}", sys.stderr)


def say(line: str, stream: TextIO) -> None:
    try:
        print(line, file=stream, flush=True)
    except OSError as problem:
        if problem.errno in NOBODY_READS:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())  # with what its buffer keeps
            os.close(nowhere)
