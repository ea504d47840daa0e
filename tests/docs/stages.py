"""Where each command of the documentation is run, and why some cannot be: the two tables to which a new one is added.

A command that is shown anywhere in README.md, CONTRIBUTING.md or docs/ stands either in `RUN` or, by itself or by a
pattern, in `NOT_RUN`. Each is run at a terminal, with names replaced as the stage says (an arm of its own instead of
episode1, the simulated adapter instead of /dev/ttyUSB0).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from at_terminal import CTRL_C

from rtarm.console.errors import ExitCode

DONE, REFUSED, UNHEALTHY = int(ExitCode.DONE), int(ExitCode.REFUSED), int(ExitCode.UNHEALTHY)
LOOP_REFUSED = int(ExitCode.LOOP_REFUSED)

NOTHING = "nothing runs"
ADAPTER = "simulated drives behind an adapter"
ARM = "an arm runs"


class Run(NamedTuple):
    """How a command is run."""

    stage: str
    says: str = ""
    """A part of what it says."""
    codes: tuple[int, ...] = (DONE,)
    """Exit codes, one of which it must have: more where the machine decides."""
    talk: tuple[tuple[str, str], ...] = ()
    """What is waited for, and what is typed then."""
    arm: dict[str, dict[str, Any]] = {}  # noqa: RUF012 (a default of a tuple, which nobody changes)
    """Keys that my_arm.yaml has for this command beside Episode1's."""


RUNS = (("running; Ctrl-C", CTRL_C),)
QUITS = (("q ends", "q\n"),)
ENDS_RECORDING = (("nothing missing", ""), ("nothing missing", ""), ("nothing missing", CTRL_C))
"""Once it has looked a few times."""
TURNED_ON = {"bus": {"positions": "reported", "position_command": "FC"}, "control": {"rate_hz": 250.0}}

RUN: dict[str, Run] = {
    # nothing runs
    "rtarm config check episode1": Run(NOTHING, "highest rate"),
    "rtarm config check ./my_arm.yaml": Run(NOTHING, "TOO MUCH", (REFUSED,), arm=TURNED_ON),
    "rtarm doctor": Run(NOTHING, "clock", (DONE, UNHEALTHY)),
    "rtarm doctor episode1": Run(NOTHING, "clock", (DONE, UNHEALTHY)),
    "rtarm doctor my_arm.yaml": Run(NOTHING, "clock", (DONE, UNHEALTHY)),
    "rtarm doctor episode1 --json": Run(NOTHING, '"healthy"', (DONE, UNHEALTHY)),
    "rtarm config check episode1 --json": Run(NOTHING),
    "rtarm moveit-config ./my_arm.yaml -o ~/ros2_ws/src": Run(NOTHING, "_moveit_config"),
    "rtarm up ./my_arm.yaml --sim --rate 200": Run(NOTHING, "the highest rate that fits is", (REFUSED,)),
    "rtarm up ./my_arm.yaml --channel /dev/ttyUSB7": Run(NOTHING, "There is no serial port", (LOOP_REFUSED,)),
    "rtarm motions": Run(NOTHING),
    "rtarm up mock": Run(NOTHING, "ended in order", talk=RUNS),
    "rtarm demo": Run(NOTHING, "4 of 4 goals succeeded"),
    "python -m sim --arm odrive6 --link arm.tty": Run(NOTHING, talk=(("ready /dev/pts", CTRL_C),)),
    "python -m sim --arm episode1 --faults-from-stdin": Run(NOTHING, talk=(("ready /dev/pts", CTRL_C),)),
    # simulated drives behind an adapter
    "rtarm scan --port /dev/ttyUSB0": Run(ADAPTER, "joints:"),
    "rtarm drives episode1": Run(ADAPTER, "joint6", (DONE, UNHEALTHY)),
    "rtarm drives my_arm.yaml": Run(ADAPTER, "joint6", (DONE, UNHEALTHY)),
    "rtarm drives my_arm.yaml --write": Run(ADAPTER, "joint6"),
    "rtarm drives ./my_arm.yaml --write --store": Run(
        ADAPTER, "written and read back", talk=(("Write flash?", "y\n"),)
    ),
    "rtarm calibrate ./my_arm.yaml": Run(ADAPTER, "Nothing was written", (REFUSED,), QUITS),
    "rtarm calibrate ./my_arm.yaml --joint joint5": Run(ADAPTER, "Nothing was written", (REFUSED,), QUITS),
    "rtarm commission ./my_arm.yaml joint6": Run(ADAPTER, "Nothing was checked", (REFUSED,), QUITS),
    "rtarm up episode1 --channel /dev/ttyUSB1": Run(ADAPTER, "ended in order", talk=RUNS),
    "rtarm up ./my_arm.yaml": Run(ADAPTER, "ended in order", talk=RUNS),
    # an arm runs
    "rtarm status": Run(ARM, "lateness"),
    "rtarm status --language zh": Run(ARM, "唤醒延迟"),
    "rtarm top": Run(ARM, talk=(("lateness all along", "q"),)),
    "rtarm top episode1": Run(ARM, talk=(("lateness all along", "q"),)),
    "rtarm record": Run(ARM, ".mcap"),
    "rtarm record episode1 -o strange_noise.mcap": Run(ARM, "strange_noise.mcap"),
    "rtarm record -f": Run(ARM, ".mcap", talk=ENDS_RECORDING),
    "rtarm record --for 60 -o test_run.mcap": Run(ARM, "test_run.mcap", talk=ENDS_RECORDING),
    "rtarm plot": Run(ARM, ".png"),
    "rtarm plot test_run.mcap -o test_run.svg": Run(ARM, "test_run.svg"),
    "rtarm explain": Run(ARM, "at 120 Hz"),
    "rtarm explain FILE.mcap": Run(ARM, "at 120 Hz"),
    "rtarm replay": Run(ARM, talk=(("joint6", "q"),)),
    "rtarm replay FILE.mcap --speed 0.5": Run(ARM, talk=(("joint6", "q"),)),
    "rtarm hold": Run(ARM, "stands and takes no goals before `rtarm resume`"),
    "rtarm resume": Run(ARM, "is not held"),
    "rtarm move joint1=15 joint2=-5": Run(ARM, "Goal reached"),
    "rtarm move joint6=5 --relative --speed 0.1": Run(ARM, "Goal reached"),
    "rtarm stop": Run(ARM, "no goal was running"),
    "rtarm clear-fault": Run(ARM, "fault"),
    "python goal.py": Run(ARM, "Goal reached: the largest error is"),
    "rtarm reference joint1": Run(ARM, "Taken: joint1"),
    "rtarm reference joint2": Run(ARM, "Taken: joint2"),
    "rtarm reference joint2=-12.5": Run(ARM, "Taken: joint2 -12.50°"),
    "rtarm reference --all": Run(ARM, "are referenced"),
    "rtarm reference joint6=-24": Run(ARM, "Taken: joint6 -24.00°"),
    "rtarm free": Run(ARM, "are limp: lead it by hand"),
    "rtarm enable": Run(ARM, "are enabled; the arm holds where it stands"),
    "rtarm disable": Run(ARM, "out of service until `rtarm enable`"),
    "rtarm home joint1": Run(ARM, "Homed"),
    "rtarm home joint2": Run(ARM, "Homed"),
    "rtarm home joint6": Run(ARM, "Homed"),
    "rtarm home joint6 joint5": Run(ARM, "Homed"),
    "rtarm home joint2 joint5": Run(ARM, "Homed"),
}

FILES = {"goal.py": ("docs/start/first-run.md", "my_first_goal")}
"""Files that a page shows for its reader to write: the page, and a word of the block."""

NOT_RUN: dict[str, str] = {
    "make *": "builds the environment, or runs for minutes: continuous integration does it (.ci/run)",
    "sudo *": "needs root, and hardware that is not here",
    "pip install *": "changes the environment in which the tests run",
    "python3 -m venv *": "an environment with nothing in it is tests/packages/from_nothing.py",
    "systemctl *": "needs a booted systemd; the unit is read in tests/packages/test_service.py",
    "journalctl *": "needs a booted systemd",
    "docker *": "needs a container engine",
    "ros2 *": "needs a ROS installation; launch files and interfaces have tests of their own (tests/ros)",
    "source *": "needs a ROS installation, or has no effect of its own",
    "cd *": "needs a ROS installation, or has no effect of its own",
    "colcon build*": "needs a ROS installation; tests/ros builds the workspace",
    "git clone *": "needs the network",
    "ln -s *": "needs a ROS workspace",
    "ls -l /dev/serial/by-id/": "needs an adapter",
    "ip -details link show can0": "needs a CAN interface",
    "candump vcan0": "needs a CAN interface",
    "cat >> my_arm.yaml": "a person types on",
    "cp config/arms/episode1.yaml my_arm.yaml": "the stages' my_arm.yaml is this file under a name of its own",
    "sed * config/arms/episode1.yaml > my_arm.yaml": "the same; that it changes the file is checked",
    "export *": "the tests have it in their environment",
    "python -m sim --arm ./as_built.yaml --link ./tty *": "the stage with an adapter is this",
    "python -m sim --arm my_arm.yaml --can vcan0": "needs a CAN interface: tests/vm",
    "rtarm up my_arm.yaml": "needs a CAN interface: tests/vm",
    "rtarm up episode1 --interface socketcan --channel can0": "needs a CAN interface: tests/vm",
    "rtarm up * --channel /dev/pts/?": "the same as with /dev/ttyUSB1",
    "rtarm up episode1 --sim": "the stage with an arm is this",
    "rtarm up my_arm.yaml --sim": "the stage with an arm is this",
    "rtarm up ./my_arm.yaml --sim": "the stage with an arm is this",
    "rtarm --install-completion": "writes into the shell's own files",
    "rtarm up episode1 --sim --hand wave": "tests/end_to_end/test_teach.py leads an arm so",
    "rtarm teach *": "needs a hand that leads the arm: tests/end_to_end/test_teach.py",
    "rtarm play *": "plays what was taught: tests/end_to_end/test_teach.py",
    "rtarm view*": "an arm of one's own needs its file there; in a browser: tests/rtarm/view/test_view_browser.py",
    "rtarm replay FILE.mcap --view": "tests/rtarm/replay/test_recording_on_page.py, in a browser",
    "rtarm replay * --on-arm*": "tests/end_to_end/test_replay.py",
    "rtarm scan": "would open whatever is plugged into this machine",
    "rtarm scan --port /dev/ttyACM0": "the same as with /dev/ttyUSB0",
    "rtarm drives ./my_arm.yaml*": "the same file as my_arm.yaml",
    "rtarm drives my_arm.yaml --write --store": "the same file as ./my_arm.yaml",
    "rtarm calibrate episode1 -o ./my_arm.yaml": "would open /dev/ttyUSB1: tests/rtarm/calibrate",
    "rtarm calibrate ./my_arm.yaml --joint joint6": "the same as with joint5",
    "rtarm calibrate ./my_arm.yaml --channel ./tty": "the same as without, my_arm.yaml names the adapter already",
    "rtarm bench --quick": "a minute in which nothing else may run: tests/rtarm/bench/test_bench.py",
    "RTARM_TAIL_ROUNDS=30 python -m pytest bench/bench_tail.py": "twenty minutes in which nothing else may run",
    "rtarm demo --arm *my_arm.yaml": "the same as rtarm demo; tests/rtarm/launch/test_up_processes.py runs others",
    "rtarm demo --arm *6*": "tests/rtarm/test_other_families.py runs each family",
    "rtarm reference joint1=-178 joint3=-81 joint4=-27 joint6=-24": "of an arm whose drives have lost power: "
    "tests/end_to_end/test_lost_references.py",
    "PYTHONPATH=tests python -m *": "minutes to hours; its options are checked here",
    "python -m pytest *": "is what runs this",
    "cp -r examples/nemo/. .": "tests/docs/test_add_a_drive.py, in a copy of the tree",
    "sed * config/arms/odrive6.yaml > config/arms/nemo6.yaml": "tests/docs/test_add_a_drive.py",
    "python -m rtloop.warm": "packaging/arm64.py runs what the section on ARM64 shows",
    "python -m rtloop mock": "the same",
    "rtarm * mock": "the same",
    "rtarm record mock -o mock.mcap": "the same",
    "rtarm explain mock.mcap": "the same",
    "rtarm config check nemo6": "tests/docs/test_add_a_drive.py",
}
"""Patterns (fnmatch) of commands that are not run here, and why."""
