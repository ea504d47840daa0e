"""`python -m sim --arm ARM --link PATH`: a simulated arm at a pseudo-terminal, until SIGTERM or SIGINT.

With `--can vcan0` it lives on that CAN interface instead, with `--python-can interface=…,channel=…` on a bus of
python-can, another adapter on the host's bus for instance. Prints `ready <terminal or interface>` when it can be
opened. SIGUSR1 writes the true motion so far to the file given with `--truth` and then prints `truth <file>`; the same
file is written at the end. With `--truth-window-s` it holds that many seconds, and what is older is forgotten. With
`--faults-from-stdin` every line that comes in is a fault, its times counted from that moment, answered by
`fault <line>`, or by `refused <sentence>`. With `--hand` somebody leads the arm whenever it is limp.

Of an arm with several buses one process simulates one (`--bus`), with the drives on it; `--start-deg` and `--hand` are
of the whole arm all the same.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import math
import os
import select
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from config.buses import bus_number
from config.errors import ConfigError, did_you_mean
from config.loader import load_arm, parse_overrides
from config.schema import ArmConfig
from sim.adapter import DIALECTS
from sim.arm import SimulatedArm
from sim.can_interface import CanInterface
from sim.can_socket import CanServer
from sim.faults import FAULTS, parse_fault
from sim.hand import load_guided
from sim.pty import PtyServer
from sim.truth import save_truth

if TYPE_CHECKING:
    from sim.python_can_host import PythonCanServer

Server: TypeAlias = "PtyServer | CanServer | PythonCanServer"

PR_SET_TIMERSLACK = 29
PRIORITY = 20


def main(arguments: list[str] | None = None) -> int:
    """Run the simulator; returns its exit code."""
    options = _parser().parse_args(arguments)
    try:
        config = load_arm(options.arm, overrides=parse_overrides(options.set))
        bus = _bus_number(config, options.bus)
        part = config.parts[bus]
        arm = SimulatedArm(
            part,
            start_ns=time.monotonic_ns(),
            joint_position_rad=_start_of(part, config, _start(options.start_deg)),
            seed=options.seed + bus,
            faults=[parse_fault(text) for text in options.fault],
            dialect=options.dialect,
            firmware=options.firmware,
            odrive_firmware=options.odrive_firmware,
            homed=not options.unhomed,
            hand=None if options.hand is None else load_guided(options.hand, _names(config)).of(_names(part)),
        )
        server = _server(arm, options)
    except (ConfigError, ValueError, OSError) as error:
        print(f"sim: {error}", file=sys.stderr)
        return 2
    if options.truth is not None and not options.truth.absolute().parent.is_dir():
        server.close()
        print(f"sim: there is no folder for {options.truth}; create it or choose another.", file=sys.stderr)
        return 2
    with server:
        _serve(server, options.truth, options.truth_window_s, options.faults_from_stdin)
    return 0


def _bus_number(arm: ArmConfig, name: str | None) -> int:
    """Which of the arm's buses is simulated."""
    names = [bus.name for bus in arm.buses if bus.name is not None]
    if name is None and len(arm.buses) == 1:
        return 0
    if name is None:
        raise ValueError(
            f"arm {arm.name} has {len(names)} buses, and one process simulates one: give --bus with one of "
            f"{', '.join(names)}, and start a process for each."
        )
    if name not in names:
        allowed = f"has {', '.join(names)}; name one of them." if names else "has one without a name: leave --bus out."
        raise ValueError(f"--bus is {name}, which is no bus of arm {arm.name}{did_you_mean(name, names)}; it {allowed}")
    return bus_number(arm.buses, name)


def _start_of(part: ArmConfig, arm: ArmConfig, angles_rad: list[float] | None) -> list[float] | None:
    """Of the angles that were given for the whole arm those of the joints on one bus."""
    if angles_rad is None or len(arm.buses) == 1:
        return angles_rad
    if len(angles_rad) != len(arm.joints):
        raise ValueError(
            f"--start-deg has {len(angles_rad)} angles, but arm {arm.name} has {len(arm.joints)} joints on all its "
            "buses; give one for each."
        )
    return [angle for angle, name in zip(angles_rad, _names(arm), strict=True) if name in _names(part)]


def _names(arm: ArmConfig) -> list[str]:
    return [joint.name for joint in arm.joints]


def _server(arm: SimulatedArm, options: argparse.Namespace) -> Server:
    interface = arm.config.bus.interface
    name = arm.config.name
    if (options.can is not None) != (interface == "socketcan"):
        raise ValueError(
            f"arm {name} is reached through {interface}: --can is for interface socketcan, and for that alone."
        )
    on_python_can = interface == "python-can" and isinstance(arm.adapter, CanInterface)
    if on_python_can and options.python_can is None:
        raise ValueError(
            f"arm {name} is reached through python-can: name the simulated drives' end of its bus, as in --python-can "
            "interface=pcan,channel=PCAN_USBBUS2; or let the arm have python_can: {interface: slcan}, which they are "
            "behind without any adapter."
        )
    if options.python_can is not None:
        if not on_python_can:
            raise ValueError(
                f"arm {name} is reached through a serial adapter or a CAN interface of the system: --python-can is for "
                "an arm with interface python-can alone."
            )
        from sim.python_can_host import PythonCanServer, opened  # most simulated arms need no python-can

        return PythonCanServer(arm, opened(options.python_can, arm.config.bus.bitrate))
    return PtyServer(arm, options.link) if options.can is None else CanServer(arm, options.can)


def _serve(server: Server, truth: Path | None, window_s: float | None, faults_from_stdin: bool) -> None:
    pending: set[int] = set()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1):
        signal.signal(number, lambda caught, _: pending.add(caught))
    signal.set_wakeup_fd(server.wake_descriptor, warn_on_full_buffer=False)
    _be_as_prompt_as_hardware()

    watched = [sys.stdin.fileno()] if faults_from_stdin else []
    typed = bytearray()

    def attend() -> bool:
        if watched and select.select(watched, (), (), 0)[0]:
            data = os.read(watched[0], 4096)
            typed.extend(data)
            if not data:
                watched.clear()
            while b"\n" in typed:
                line, _, rest = typed.partition(b"\n")
                typed[:] = rest
                print(_inject(server, line.decode(errors="replace").strip()), flush=True)
        if signal.SIGUSR1 in pending:
            pending.discard(signal.SIGUSR1)
            write_truth()
        return not pending

    def write_truth() -> None:
        if truth is not None and server.heard is not None:
            now_ns = time.monotonic_ns()
            server.arm.run_until(now_ns)
            if window_s is not None:
                _forget_before(server, now_ns - round(window_s * 1e9))
            save_truth(server.arm, truth, server.heard)
            print(f"truth {truth}", flush=True)

    if truth is not None:
        server.heard = []
    if isinstance(server, PtyServer):
        server.on_held_up = _say_held_up
    print(f"ready {server.place}", flush=True)
    server.serve(attend, watched)
    signal.set_wakeup_fd(-1)
    write_truth()


def _say_held_up(late_ns: int) -> None:
    print(
        f"sim: This machine held the simulated arm up for {late_ns * 1e-9:.3f} s, in which all its drives were silent: "
        "relieve it, or see `rtarm doctor`.",
        file=sys.stderr,
        flush=True,
    )


def _forget_before(server: Server, time_ns: int) -> None:
    for drive in server.arm.drives:
        drive.shaft.forget_before(time_ns)
    if server.heard is not None:
        server.heard = [piece for piece in server.heard if piece[0] >= time_ns]


def _inject(server: Server, text: str) -> str:
    now_ns = time.monotonic_ns()
    try:
        server.arm.run_until(now_ns)
        server.arm.inject(parse_fault(text), now_ns)
    except ValueError as error:
        return f"refused {error}"
    return f"fault {text}"


def _be_as_prompt_as_hardware() -> None:
    """Drives are never kept waiting by other programs, so ask for real-time priority, below the loop's.

    Without the permission a busy machine makes the simulated drives answer late, which the control process
    rightly takes for silence.
    """
    # The kernel otherwise delays every wake-up by up to 50 us; that it does is no harm.
    ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m sim",
        description="Simulated drives behind a serial adapter at a pseudo-terminal, or on a CAN interface.",
    )
    parser.add_argument("--arm", required=True, help="name of an arm, or path of its YAML file")
    parser.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="change a setting of the arm"
    )
    parser.add_argument("--bus", metavar="NAME", help="which bus to simulate, of an arm with several")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--link", type=Path, help="symbolic link to make to the terminal")
    place.add_argument(
        "--python-can",
        metavar="KEY=VALUE,…",
        help="bus of python-can to live on (interface=pcan,channel=PCAN_USBBUS2), of an arm with interface python-can",
    )
    place.add_argument(
        "--can", metavar="INTERFACE", help="CAN interface to live on (vcan0), of an arm with interface socketcan"
    )
    parser.add_argument("--start-deg", help="joint angles to start at, in degrees, with commas between")
    parser.add_argument(
        "--fault", action="append", default=[], help=f"NAME:FIELD=VALUE,… with NAME of {', '.join(FAULTS)}"
    )
    parser.add_argument("--faults-from-stdin", action="store_true", help="take faults while running, too")
    parser.add_argument(
        "--hand",
        metavar="FILE",
        help="motion (CSV, or `wave`) along which a hand leads the joints whenever all are limp",
    )
    parser.add_argument("--dialect", choices=DIALECTS, default="lawicel", help="of an SLCAN adapter")
    parser.add_argument("--firmware", choices=("new", "old"), default="new", help="of ZDT drives")
    parser.add_argument("--odrive-firmware", choices=("0.5.6", "0.6"), default="0.5.6", help="of ODrives")
    parser.add_argument("--unhomed", action="store_true", help="drives that have just been switched on")
    parser.add_argument("--seed", type=int, default=0, help="of random delays and faults")
    parser.add_argument("--truth", type=Path, help="file for the true motion (NumPy archive)")
    parser.add_argument("--truth-window-s", type=float, metavar="S", help="seconds of motion to remember for --truth")
    return parser


def _start(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [math.radians(float(part)) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"--start-deg is {text!r}, but must be numbers with commas between, one a joint.") from None


if __name__ == "__main__":
    sys.exit(main())
