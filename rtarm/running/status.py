"""What `rtarm status` says of a running arm, read from its memory files alone."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from motion.gripping import Grip
from rtarm.console.chinese import MODES
from rtarm.console.errors import Refusal
from rtarm.console.language import named, said
from sentences.drive_words import listed, troubles_of, words_of
from sentences.meaning import Language
from sentences.told import (
    bus_state_sentence,
    grip_trouble_sentence,
    joint_name,
    latched_sentence,
    outcome_sentence,
    reasons_unreferenced,
    unreferenced_sentence,
    unreferenced_sentences,
)
from shm import files, histogram
from shm.client import StateReader
from shm.errors import NotRunning
from shm.files import MemoryFile
from shm.gripper import read_gripper
from shm.layout import BUS_TROUBLE, BusCounters
from shm.snapshot import Snapshot
from shm.words import BusState, DriveStatus, Fault, Mode, Outcome, Phase, Unreferenced

Report = dict[str, Any]
"""What `--json` prints, in English; keys carry their units."""

MOVING_MODES = (Mode.EXECUTING, Mode.STOPPING)
FIT_MODES = (Mode.HOLDING, *MOVING_MODES)
LIMP_MODES = (Mode.DISABLED, Mode.FREE)
DOUBTFUL_BUS = {"passive": BusState.PASSIVE, "bus_off": BusState.BUS_OFF}
CYCLE_OVERDUE_S = 0.5
"""A cycle this late is a control process that hangs, not one that was preempted."""
FRONT_SILENT_S = 1.0

STOPPED_BY_A_PERSON = (
    "A person has stopped or holds the arm, so it takes no goals: make sure that it may move, then `rtarm resume` "
    "(or ~/resume)."
)

PERCENTS = {"p50": 50.0, "p99": 99.0, "p99_9": 99.9}
POLICIES = {0: "other", 1: "fifo", 2: "rr"}


def resolve_arm(argument: str | None, language: Language = "en") -> str:
    """Name of the arm meant: a name, the path of an arm file, or None for the only one that runs or has died.

    Raises:
        Refusal: there is none, there are several, or the argument can be no arm's name.
        ConfigError: the arm file cannot be read.
    """
    if argument is None:
        arms = files.running_arms() or [arm for arm in files.arms_left_behind() if files.died_with(arm)]
        if not arms:
            raise Refusal(said(language, "No arm is running here: start one with `rtarm up ARM`, or try `rtarm demo`."))
        if len(arms) > 1:
            meant: dict[str, object] = {"arms": ", ".join(arms), "first": arms[0]}
            if files.running_arms():
                several = "Several arms are running ({arms}): name the one you mean, such as `--arm {first}`."
                raise Refusal(said(language, several, **meant))
            died = "No arm is running here; several have died ({arms}): name the one you mean, such as `--arm {first}`."
            raise Refusal(said(language, died, **meant))
        return arms[0]
    if is_path(argument):
        from config.loader import load_arm

        return load_arm(argument).name
    if re.fullmatch(r"[a-z][a-z0-9_]{0,31}", argument) is None:
        raise Refusal(
            said(
                language,
                "{argument!r} is no name of an arm, which has small letters, digits and _ (at most 32); give such a "
                "name, or the path of an arm file.",
                argument=argument,
            )
        )
    return argument


def is_path(argument: str) -> bool:
    """Whether a person means a file by this, rather than a name."""
    return "/" in argument or argument.endswith((".yaml", ".yml"))


def open_running(arm: str) -> MemoryFile:
    """The state file of an arm.

    Raises:
        SharedMemoryError: as `shm.files.open_state`; where others run instead, the sentence names them.
    """
    try:
        return files.open_state(arm)
    except NotRunning:
        others = ", ".join(files.running_arms())
        if not others or files.state_path(arm).exists():
            raise
        raise NotRunning(
            "No control process is running for arm '{arm}', but for {arms}: name that arm, or start this one with "
            "`rtarm up` and the name or the path of its arm file.",
            arm=arm,
            arms=others,
        ) from None


def read_status(arm: str, language: Language = "en") -> Report:
    """Everything `status` tells about a running arm, its sentences in a language.

    Raises:
        SharedMemoryError: it is not running, or its files are not what they should be.
    """
    reader = StateReader(open_running(arm))
    try:
        return report_of(arm, reader, language)
    finally:
        reader.close()


def report_of(arm: str, reader: StateReader, language: Language = "en") -> Report:
    """The same, from a state file that is mapped already.

    Raises:
        SharedMemoryError: it cannot be read, or the command file beside it is not what it should be.
    """
    snapshot = reader.snapshot()
    record = reader.memory.record
    header = record["header"]
    joints = files.joint_names(header)
    now_ns = time.monotonic_ns()
    front = files.front_of(arm)
    report: Report = {
        "arm": arm,
        "running": True,
        **of_cycle(snapshot, joints, now_ns, language, files.bus_names(header)),
        "gripper": _gripper(reader.memory, now_ns, language),
        "last_result": _last_result(snapshot, joints, language),
        "rate_hz": 1e9 / int(header["period_ns"]),
        "uptime_s": (now_ns - int(header["start_monotonic_ns"])) * 1e-9,
        "cycle_age_ms": (now_ns - snapshot["monotonic_ns"]) * 1e-6,
        "loop": {"pid": int(header["pid"])},
        "front": {
            "pid": None if front is None else front[0],
            "heartbeat_age_ms": None if not front or not front[1] else (now_ns - front[1]) * 1e-6,
        },
        "lateness_us": percentiles_us(record["lateness"]),
        "cycle_us": percentiles_us(record["cycle_time"]),
        "scheduling": scheduling(record["scheduling"]),
        **counters(record["counters"], counted_buses(record), now_ns - int(header["start_monotonic_ns"])),
    }
    report["problems"] = problems(report, language)
    report["healthy"] = not report["problems"]
    return report


def _gripper(memory: MemoryFile, now_ns: int, language: Language) -> Report | None:
    """The gripper on the arm's bus; None where there is none, and for one that the ROS process moves."""
    record = read_gripper(memory)
    if record is None:
        return None
    trouble, measured_ns = int(record["trouble"]), int(record["measured_ns"])
    known = measured_ns != 0
    return {
        "grip": key(Grip, int(record["grip"])),
        "position_rad": _finite(float(record["position_rad"])) if known else None,
        "target_rad": _finite(float(record["target_rad"])),
        "effort_nm": _finite(float(record["measured_effort"])),
        "age_ms": (now_ns - measured_ns) * 1e-6 if known else None,
        "trouble": grip_trouble_sentence(trouble, float(record["trouble_value"]), language) if trouble else None,
    }


def of_cycle(
    cycle: Any, joints: Sequence[str], now_ns: int, language: Language = "en", buses: Sequence[str] = ()
) -> Report:
    """What a snapshot tells, or the flight recorder's record of a cycle, whose words have the same names.

    `buses` are the names of the arm's buses, where it has several.
    """
    return {
        "mode": key(Mode, int(cycle["mode"])),
        "held": bool(cycle["held"]),
        "fault": _fault(cycle, joints, now_ns, language, buses),
        "goal": _goal(cycle),
        "speed_scale": float(cycle["speed_scale"]),
        "joints": [_joint(name, cycle["joints"][index], now_ns, language) for index, name in enumerate(joints)],
        "unreferenced": unreferenced_sentences(_why_unreferenced(cycle, joints), language),
    }


def key(kind: type[IntEnum], number: int) -> str:
    """A number of shared memory as JSON names it, such as `bringing_up`."""
    try:
        return kind(number).name.lower()
    except ValueError:
        return f"unknown_{number}"


def scheduling(record: Any) -> Report:
    """What real-time set-up the control process really obtained."""
    cpu = int(record["cpu"])
    return {
        "policy": POLICIES.get(int(record["policy"]), f"unknown {int(record['policy'])}"),
        "priority": int(record["priority"]),
        "memory_locked": bool(record["memory_locked"]),
        "cpu": None if cpu < 0 else cpu,
        "dma_latency_held": bool(record["dma_latency_held"]),
    }


def describe_scheduling(found: Mapping[str, Any], language: Language = "en") -> str:
    """The same in words."""
    policy = found["policy"]
    words = [
        f"SCHED_{policy.upper()} {found['priority']}" if policy != "other" else said(language, "no real-time priority"),
        said(language, "memory locked") if found["memory_locked"] else said(language, "memory not locked"),
        said(language, "any CPU") if found["cpu"] is None else f"CPU {found['cpu']}",
        said(language, "CPU latency held low") if found["dma_latency_held"] else said(language, "CPU latency not held"),
    ]
    return said(language, ", ").join(words)


def percentiles_us(record: np.void) -> Report:
    """Percentiles of a histogram of durations, in microseconds, with the number of values."""
    values = histogram.percentiles_ns(record, list(PERCENTS.values()))
    found: Report = {percent: value * 1e-3 for percent, value in zip(PERCENTS, values, strict=True)}
    return {**found, "max": int(record["max_ns"]) * 1e-3, "count": int(record["count"])}


class CountedBus(NamedTuple):
    """A bus: its name ("" where the arm has one), its bit rate (bit/s), what was counted on it (layout.BusCounters)."""

    name: str
    bitrate: int
    counted: Any


def counted_buses(record: np.void) -> list[CountedBus]:
    """The arm's buses in a state file, and what was counted on each since the start."""
    return [
        CountedBus(bus.name, bus.bitrate, counted)
        for bus, counted in zip(files.buses(record["header"]), record["buses"], strict=False)
    ]


def counters(record: Any, buses: Sequence[CountedBus], elapsed_ns: int) -> Report:
    """The counters of all buses with the load of the busiest, and those of each where there are several.

    A load is the mean over `elapsed_ns`, None without a bus.
    """
    loads = [_load(bus, elapsed_ns * 1e-9) for bus in buses]
    report: Report = {
        "cycles": int(record["cycles"]),
        "overruns": int(record["overruns"]),
        "bus": _of_bus(record, max((load for load in loads if load is not None), default=None), BUS_TROUBLE),
    }
    if len(buses) > 1:
        troubles = [name for name in BUS_TROUBLE if name in BusCounters.words]
        report["buses"] = [
            {"name": bus.name, **_of_bus(bus.counted, load, troubles)} for bus, load in zip(buses, loads, strict=True)
        ]
    return report


def _load(bus: CountedBus, seconds: float) -> float | None:
    return int(bus.counted["bits_on_bus"]) / (bus.bitrate * seconds) if seconds > 0 else None


def _of_bus(counted: Any, load: float | None, troubles: Sequence[str]) -> Report:
    return {
        "frames_tx": int(counted["frames_sent"]),
        "frames_rx": int(counted["frames_received"]),
        "load": load,
        **{name: int(counted[name]) for name in troubles},
        "state": key(BusState, int(counted["bus_state"])),
    }


def problems(report: Mapping[str, Any], language: Language = "en") -> list[str]:
    """Why the arm is not fit to move, a sentence each; empty when it is healthy."""
    found: list[str] = []
    mode = named(language, MODES, report["mode"])
    if report["fault"] is not None:
        found.append(report["fault"]["sentence"])
    elif report["mode"] in {key(Mode, mode) for mode in LIMP_MODES}:
        found.append(
            said(
                language,
                "The drives are limp ({mode}): clear the arm's surroundings, then `rtarm enable` (or ~/enable), and "
                "the arm holds where it stands.",
                mode=mode,
            )
        )
    elif report["mode"] not in {key(Mode, mode) for mode in FIT_MODES}:
        found.append(said(language, "The control process is {mode}: wait until it is holding.", mode=mode))
    if report["held"]:
        found.append(said(language, STOPPED_BY_A_PERSON))
    if report["cycle_age_ms"] > CYCLE_OVERDUE_S * 1e3:
        found.append(
            said(
                language,
                "The last control cycle was {age:.1f} s ago, so the control process hangs: stop it and start it again.",
                age=report["cycle_age_ms"] / 1e3,
            )
        )
    for bus in report.get("buses", [{"name": "", **report["bus"]}]):
        if bus["state"] in DOUBTFUL_BUS:
            found.append(bus_state_sentence(DOUBTFUL_BUS[bus["state"]], language, bus["name"]))
    found += report["unreferenced"]
    (protected,) = troubles_of(DriveStatus.PROTECTED, language)
    for joint in report["joints"]:
        blamed = report["fault"] is not None and report["fault"]["joint"] == joint["name"]
        if protected in joint["drive_trouble"] and not blamed:  # no fault speaks of it where a reference is lost
            found.append(_drive_problem(joint, language))
    front = report["front"]
    if front["pid"] is None:
        found.append(
            said(
                language,
                "No ROS process serves the arm, so it takes no goals: `rtarm up` starts one and keeps it alive.",
            )
        )
    elif front["heartbeat_age_ms"] is None or front["heartbeat_age_ms"] > FRONT_SILENT_S * 1e3:
        found.append(
            said(language, "The ROS process (pid {pid}) gives no sign of life: look at its log.", pid=front["pid"])
        )
    return found


def _drive_problem(joint: Mapping[str, Any], language: Language) -> str:
    return said(
        language,
        "The drive of {joint} has an error ({trouble}) and may hold nothing: remove the cause, then "
        "`rtarm clear-fault`.",
        joint=joint["name"],
        trouble=listed(joint["drive_trouble"], language),
    )


def _fault(
    snapshot: Snapshot, joints: Sequence[str], now_ns: int, language: Language, buses: Sequence[str]
) -> Report | None:
    number = snapshot["fault"]
    if number == Fault.NONE:
        return None
    joint = snapshot["fault_joint"]
    return {
        "name": key(Fault, number),
        "sentence": latched_sentence(snapshot, joints, language, buses),
        "joint": joints[joint] if 0 <= joint < len(joints) else None,
        "value": _finite(snapshot["fault_value"]),
        "limit": _finite(snapshot["fault_limit"]),
        "age_s": (now_ns - snapshot["fault_ns"]) * 1e-9,
    }


def _why_unreferenced(cycle: Any, joints: Sequence[str]) -> dict[str, int]:
    """Before the first bring-up too, when no reason is told yet."""
    found = reasons_unreferenced(cycle, joints)
    return {name: reason or Unreferenced.NOT_BROUGHT_UP for name, reason in found.items()}


def _goal(snapshot: Snapshot) -> Report | None:
    goal_id = snapshot["goal_id"]
    if goal_id == 0:
        return None
    phase, end_ns = snapshot["goal_phase"], snapshot["trajectory_end_ns"]
    return {
        "id": goal_id,
        "phase": key(Phase, phase),
        "clock_s": _finite(snapshot["trajectory_clock_ns"] * 1e-9),
        "duration_s": None if end_ns < 0 else end_ns * 1e-9,
    }


def _last_result(snapshot: Snapshot, joints: Sequence[str], language: Language) -> Report | None:
    results = snapshot["results"]
    newest = results["monotonic_ns"] == results["monotonic_ns"].max()  # one, or neighbours that go round
    last = results[np.argmax(newest & ~np.roll(newest, -1))]
    outcome = int(last["outcome"])
    if outcome == Outcome.NONE:
        return None
    return {
        "goal_id": int(last["goal_id"]),
        "outcome": key(Outcome, outcome),
        "sentence": outcome_sentence(
            outcome,
            joint_name(int(last["joint"]), joints, language),
            float(last["value"]),
            float(last["limit"]),
            language,
        ),
    }


def _joint(name: str, record: np.void, now_ns: int, language: Language) -> Report:
    measured_ns, referenced = int(record["measured_ns"]), bool(record["referenced"])
    read = measured_ns != 0
    reason, status = int(record["unreferenced_reason"]), int(record["drive_status"])
    return {
        "name": name,
        "position_rad": _finite(float(record["measured_position_rad"])) if read else None,
        "velocity_rad_s": _finite(float(record["measured_velocity_rad_s"])) if read else None,
        "commanded_rad": _finite(float(record["commanded_position_rad"])),
        "error_rad": _finite(float(record["measured_position_rad"] - record["reference_position_rad"]))
        if read
        else None,
        "age_ms": (now_ns - measured_ns) * 1e-6 if read else None,
        "effort_nm": _finite(float(record["measured_effort"])),
        "temperature_c": _finite(float(record["drive_temperature_c"])),
        "voltage_v": _finite(float(record["drive_voltage_v"])),
        "drive": words_of(status, language),
        "drive_trouble": troubles_of(status, language),
        "referenced": referenced,
        "unreferenced": None
        if referenced
        else unreferenced_sentence(reason or Unreferenced.NOT_BROUGHT_UP, name, language),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
