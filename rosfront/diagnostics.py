"""/diagnostics: a report once a second on the arm, its bus, its cycle, each joint, the gripper and this process.

The publisher's thread makes it between two messages, from the control process' memory and what this process knows, and
only while there is a subscriber. A level describes the present: a single event shows in the next report only.
"""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.publisher import Publisher
from std_msgs.msg import Header

from config.schema import ArmConfig
from rosfront.gripper.worker import GripperWorker
from rosfront.link import Link
from rosfront.plan import NS
from rosfront.refusals import NotServing
from rosfront.serving import STALLED_NS, Serving, hung
from rosfront.verdict import fault_of
from sentences.drive_words import HELPLESS, TROUBLE, troubles_of, words_of
from sentences.english import NOBODY_ACKNOWLEDGES
from sentences.told import bus_state_sentence, joint_name, mode_name, of_bus, outcome_sentence, unreferenced_sentence
from shm import files
from shm.errors import TornRead
from shm.histogram import percentiles_ns
from shm.layout import BUS_TROUBLE
from shm.snapshot import Snapshot
from shm.words import BusState, Fault, Mode, Outcome, Phase, Unreferenced

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
PERCENTS = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
MEASURED = (
    ("temperature", "drive_temperature_c", "°C"),
    ("supply", "drive_voltage_v", "V"),
    ("effort", "measured_effort", "Nm"),
)
"""What a joint's drive may measure: key, word of the snapshot, unit."""
POLICIES = {0: "no real-time priority", 1: "SCHED_FIFO", 2: "SCHED_RR"}
_TOLD_BY_MODE = {
    Mode.OFFLINE: "The drives have not been brought up yet: wait for it.",
    Mode.BRINGING_UP: "The drives are being brought up: wait until the arm holds.",
    Mode.REFERENCING: "Joints are homed or referenced: wait until the arm holds; ~/hold ends it.",
    Mode.DISABLED: "The drives are limp and the arm is out of service: ~/enable brings it back.",
    Mode.FREE: "The drives are limp and the arm can be led by hand: ~/enable takes hold of it again.",
}

Values = Mapping[str, object]


@dataclass
class Counts:
    """Goals and trajectory messages that this process got since it started, and how they ended."""

    goals_taken: int = 0
    goals_succeeded: int = 0
    goals_canceled: int = 0
    goals_aborted: int = 0
    messages_taken: int = 0
    messages_shaped: int = 0
    """Those among the taken that asked for more than the limits allow, and were followed as closely as they do."""
    largest_lag_rad: float = 0.0
    """The largest lag of a joint behind one of them."""
    messages_refused: int = 0


class Diagnostics:
    """Makes and publishes the report; used by the publisher's thread alone."""

    def __init__(
        self,
        arm: ArmConfig,
        serving: Serving,
        counts: Counts,
        publisher: Publisher,
        gripper: GripperWorker | None = None,
    ) -> None:
        self._arm = arm
        self._gripper = gripper
        self._serving = serving
        self._counts = counts
        self._publisher = publisher
        self._late_s = max(arm.limits.stale_brake_s, 3 * arm.control.period_ns / NS)
        self._before: Mapping[str, int] = {}
        self._buses_before: Sequence[Mapping[str, int]] = ()
        self._before_ns = 0
        self._refused_before = 0

    def report(self, link: Link | None) -> None:
        """Publish the report if there is a subscriber; `link` is None without a control process."""
        if not self._publisher.get_subscription_count():
            return
        now_ns = time.time_ns()
        stamp = Time(sec=now_ns // NS, nanosec=now_ns % NS)
        self._publisher.publish(DiagnosticArray(header=Header(stamp=stamp), status=self.statuses(link)))

    def statuses(self, link: Link | None) -> list[Any]:
        """A status for each part of which something is known at present."""
        if link is None:
            return [self._status("arm", ERROR, self._absence(), {}), *self._gripper_status(), self._front({})]
        try:
            snapshot = link.reader.snapshot()
        except TornRead as problem:
            return [self._status("arm", ERROR, str(problem), {}), *self._gripper_status(), self._front({})]
        record = link.reader.memory.record
        age_ns = time.monotonic_ns() - snapshot["monotonic_ns"]
        return [
            self._arm_status(snapshot, age_ns),
            *self._of_counters(record),
            *(self._joint(index, snapshot) for index in range(len(self._arm.joints))),
            *self._gripper_status(),
            self._front({"snapshot age": f"{age_ns * 1e-6:.1f} ms"}),
        ]

    def _status(self, part: str, level: bytes, message: str, values: Values) -> Any:
        return DiagnosticStatus(
            name=f"{self._arm.front.controller_name}: {part}",
            level=level,
            message=message,
            hardware_id=self._arm.name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )

    def _absence(self) -> str:
        try:
            self._serving.present()
        except NotServing as reason:
            return reason.sentence
        return "The control process is just being attached to."

    def _arm_status(self, snapshot: Snapshot, age_ns: int) -> Any:
        mode, goal = snapshot["mode"], snapshot["goal_id"]
        if age_ns > STALLED_NS:
            level, message = ERROR, hung(self._arm.name, age_ns)
        elif snapshot["fault"] != Fault.NONE:
            level, message = ERROR, fault_of(snapshot, self._serving.names)
        elif self._serving.other_server:
            level, message = ERROR, self._serving.other_server
        elif mode in _TOLD_BY_MODE:
            level, message = WARN, _TOLD_BY_MODE[Mode(mode)]
        elif snapshot["held"]:
            level, message = WARN, outcome_sentence(Outcome.REFUSED_HELD)
        else:
            level, message = OK, mode_name(mode)
        values = {
            "mode": mode_name(mode),
            "goal": f"{goal} {_word(Phase, snapshot['goal_phase'])}" if goal else "none",
            "time along the trajectory": f"{snapshot['trajectory_clock_ns'] / NS:.3f} s",
            "speed scale asked": f"{snapshot['speed_scale_asked']:.3f}",
            "speed scale": f"{snapshot['speed_scale']:.3f}",
            "homing or referencing": joint_name(snapshot["referencing_joint"], self._serving.joints),
        }
        return self._status("arm", level, message, values)

    def _of_counters(self, record: np.void) -> Iterable[Any]:
        """Bus and cycle: totals, and levels from what has changed since the previous report."""
        now_ns = time.monotonic_ns()
        header, counters = record["header"], record["counters"]
        now = _counts(counters)
        if now["cycles"] < self._before.get("cycles", 0):  # another control process
            self._before, self._buses_before = {}, ()
        before_ns = self._before_ns if self._before else int(header["start_monotonic_ns"])
        elapsed_s = max(now_ns - before_ns, 1) / NS
        grown = _grown(now, self._before)
        self._before, self._before_ns = now, now_ns
        yield from self._buses(header, record["buses"], now, grown, elapsed_s)
        yield self._cycle(record, now, grown)

    def _buses(
        self, header: np.void, rows: np.ndarray, now: Mapping[str, int], grown: Mapping[str, int], elapsed_s: float
    ) -> Iterable[Any]:
        """All buses together, as busy as the busiest and named after the worst; then each, where there are several."""
        buses = files.buses(header)
        if len(buses) < 2:
            loads = [grown["bits_on_bus"] / (bus.bitrate * elapsed_s) for bus in buses]
            yield self._bus("bus", now, grown, elapsed_s, max(loads, default=None))
            return
        of_each = [_counts(row) for row in rows[: len(buses)]]
        grown_there = [
            _grown(counts, before)
            for counts, before in zip(of_each, self._buses_before or [{}] * len(buses), strict=True)
        ]
        self._buses_before = of_each
        loads = [
            counts["bits_on_bus"] / (bus.bitrate * elapsed_s) for bus, counts in zip(buses, grown_there, strict=True)
        ]
        worst = max(
            range(len(buses)),
            key=lambda number: (
                max(of_each[number]["bus_state"], BusState.WARNING),  # what lies below is in no sentence
                grown_there[number]["unacknowledged"],
            ),
        )
        yield self._bus("bus", now, grown, elapsed_s, max(loads), buses[worst].name)
        for bus, counts, risen, load in zip(buses, of_each, grown_there, loads, strict=True):
            yield self._bus(f"bus {bus.name}", counts, risen, elapsed_s, load, bus.name)

    def _bus(
        self,
        part: str,
        now: Mapping[str, int],
        grown: Mapping[str, int],
        elapsed_s: float,
        share: float | None,
        bus: str = "",
    ) -> Any:
        """What was counted, the `share` of the bits in use (None without a bus); `bus` is named if it is in doubt."""
        values: dict[str, object] = {}
        load = "no bus"
        if share is not None:
            load = f"load {share:.1%}"
            values["load"] = load.removeprefix("load ")
            values["frames sent per second"] = f"{grown['frames_sent'] / elapsed_s:.0f}"
            values["frames received per second"] = f"{grown['frames_received'] / elapsed_s:.0f}"
        troubles = [name for name in BUS_TROUBLE if name in now]
        for name in ("frames_sent", "frames_received", *troubles):
            values[name.replace("_", " ")] = now[name]
        values["bus state"] = _word(BusState, now["bus_state"])
        if now["bus_state"] in (BusState.PASSIVE, BusState.BUS_OFF):
            return self._status(part, ERROR, bus_state_sentence(now["bus_state"], bus=bus), values)
        if grown["unacknowledged"]:
            return self._status(part, WARN, of_bus(NOBODY_ACKNOWLEDGES.sentence, bus), values)
        trouble = [f"{grown[name]} {name.replace('_', ' ')}" for name in troubles if grown[name]]
        if trouble:
            return self._status(part, WARN, f"In the last {elapsed_s:.1f} s: {', '.join(trouble)}; {load}.", values)
        return self._status(part, OK, load, values)

    def _cycle(self, record: np.void, now: Mapping[str, int], grown: Mapping[str, int]) -> Any:
        rate_hz = NS / int(record["header"]["period_ns"])
        values: dict[str, object] = {"rate": f"{rate_hz:g} Hz", "cycles": now["cycles"], "overruns": now["overruns"]}
        for figure in ("lateness", "cycle_time"):
            found = percentiles_ns(record[figure], list(PERCENTS.values()))
            for name, value_ns in zip((*PERCENTS, "max"), (*found, int(record[figure]["max_ns"])), strict=True):
                values[f"{figure.replace('_', ' ')} {name}"] = f"{value_ns * 1e-3:.1f} µs"
        scheduling = record["scheduling"]
        policy, cpu = int(scheduling["policy"]), int(scheduling["cpu"])
        values["scheduling"] = POLICIES.get(policy, f"policy {policy}") + (
            f" {int(scheduling['priority'])}" if policy else ""
        )
        values["memory locked"] = bool(scheduling["memory_locked"])
        values["CPU"] = "any" if cpu < 0 else cpu
        values["CPU latency held low"] = bool(scheduling["dma_latency_held"])
        if grown["overruns"]:
            return self._status(
                "cycle", WARN, f"{grown['overruns']} cycles missed since the last report: see `rtarm doctor`.", values
            )
        return self._status("cycle", OK, f"{rate_hz:g} Hz, no cycle missed since the last report", values)

    def _joint(self, index: int, snapshot: Snapshot) -> Any:
        name, row = self._serving.joints[index], snapshot["joints"][index]
        status = int(row["drive_status"])
        measured_ns = int(row["measured_ns"])
        age_s = (snapshot["monotonic_ns"] - measured_ns) / NS
        level, message = OK, "referenced"
        if not row["referenced"]:
            reason = int(row["unreferenced_reason"]) or Unreferenced.NOT_BROUGHT_UP
            message = unreferenced_sentence(reason, name)
            level = WARN if reason == Unreferenced.NOT_BROUGHT_UP else ERROR
        elif status & HELPLESS:
            level, message = ERROR, f"The drive of {name} says: {', '.join(troubles_of(status))}; remove the cause."
        elif measured_ns and age_s > self._arm.limits.stale_fault_s:
            level, message = ERROR, f"{name} was last read {age_s:.3f} s ago: check its drive, cable and supply."
        elif measured_ns and age_s > self._late_s:
            level, message = WARN, f"{name} was last read {age_s:.3f} s ago: its drive answers late."
        elif status & TROUBLE:
            level, message = WARN, f"The drive of {name} warns: {', '.join(troubles_of(status))}."
        values = {
            "drive": ", ".join(words_of(status)) or "nothing reported",
            "referenced": bool(row["referenced"]),
            "age of the reading": f"{age_s * 1e3:.1f} ms" if measured_ns else "never read",
            "measured": f"{float(row['measured_position_rad']):.5f} rad",
            "commanded": f"{float(row['commanded_position_rad']):.5f} rad",
            "error": f"{float(row['reference_position_rad'] - row['measured_position_rad']):.5f} rad",
            **{what: words for what, word, unit in MEASURED if (words := _figure(float(row[word]), unit))},
        }
        return self._status(name, level, message, values)

    def _gripper_status(self) -> Iterable[Any]:
        """The gripper's status, whatever hook moves it; none for an arm without a gripper."""
        gripper = self._arm.gripper
        if gripper is None or self._gripper is None:
            return
        shown = self._gripper.shown
        values: dict[str, object] = {"hook": gripper.hook, "joint": gripper.joint}
        if shown.reading is not None:
            values["position"] = f"{shown.reading.position_rad:.5f} rad"
            values["effort"] = f"{shown.reading.effort:.3f} Nm"
            values["age of the reading"] = f"{(time.monotonic_ns() - shown.reading.measured_ns) * 1e-6:.1f} ms"
        message = shown.trouble or str(shown.grip.name).lower()
        yield self._status("gripper", ERROR if shown.trouble else OK, message, values)

    def _front(self, values: Values) -> Any:
        counts = {name.replace("_", " "): value for name, value in vars(self._counts).items()}
        refused = self._counts.messages_refused - self._refused_before
        self._refused_before += refused
        if refused:
            message = f"{refused} trajectory messages refused since the last report: the log says why."
            return self._status("front", WARN, message, {**counts, **values})
        return self._status("front", OK, "serving", {**counts, **values})


def _counts(counted: np.void) -> dict[str, int]:
    """The counters of a record of them, by name."""
    return {name: int(counted[name]) for name in counted.dtype.names or () if name != "padding"}


def _grown(now: Mapping[str, int], before: Mapping[str, int]) -> dict[str, int]:
    """By how much counters have risen since a report."""
    return {name: value - before.get(name, 0) for name, value in now.items()}


def _word(kind: Any, number: int) -> str:
    try:
        return str(kind(number).name).lower()
    except ValueError:
        return f"unknown {number}"


def _figure(value: float, unit: str) -> str:
    """A measured value with its unit; empty where the drive does not measure it (NaN)."""
    return f"{value:.3f} {unit}" if math.isfinite(value) else ""
