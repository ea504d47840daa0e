"""A simulated arm: drives, bus and adapter in virtual time.

Bytes go in with the time at which they were written and come out when they would have arrived. Nothing
happens by itself: time passes only in `feed` and `collect`, and never backwards. The same bytes at the
same times with the same seed always give the same arm.

Unless told otherwise it is an arm that was switched on and homed before anybody looked: every drive is
enabled, counts from its homing stop, has its power-lost flag cleared, factory response mode, and
firmware V2.0.0. Each joint has a mechanical stop at its lower limit, towards which it would home.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import numpy as np

from config import schema
from config.joint import JointConfig
from config.joint import ZdtDrive as ZdtConfig
from sim.adapter import Dialect, SlcanAdapter
from sim.bus import Bus, Frame, Outbox
from sim.drives.ramp import GRAINS_PER_REVOLUTION, NEVER
from sim.drives.shaft import Reals, Times
from sim.drives.zdt import Homing, Settings, ZdtDrive
from sim.faults import CorruptBytes, Fault, LostReplies, OpenRefused, PowerLoss, Silent, SlowReplies, Stall

HOMING_RPM = 30
HOMING_TIMEOUT_MS = 120_000


class SimulatedArm:
    """Six (or any number of) drives behind an SLCAN adapter.

    Args:
        arm: its configuration; all joints must be of family zdt.
        start_ns: when it begins; the first time that may be told.
        joint_position_rad: where the joints stand, to the nearest command pulse; all zero by default.
        seed: of every random delay and fault.
        faults: what goes wrong, and when.
        dialect: how the adapter answers, see `sim.adapter`.
        firmware: of all drives, see `sim.drives.zdt`.
        homed: False makes drives that have just been switched on where they stand: they count from zero
            and say that power was lost.
        retarget: whether drives take a position command in mid-move, see `sim.drives.zdt`.
        lag_s: time constant of the shafts behind their ramps [s].
        echo: whether the adapter reports its own transmissions as received frames.

    Attributes:
        drives: in joint order.
        adapter: the serial adapter.
        bus: with the time it was busy and the frames it carried.
    """

    def __init__(
        self,
        arm: schema.ArmConfig,
        *,
        start_ns: int = 0,
        joint_position_rad: Sequence[float] | None = None,
        seed: int = 0,
        faults: Sequence[Fault] = (),
        dialect: Dialect = "lawicel",
        firmware: Literal["new", "old"] = "new",
        homed: bool = True,
        retarget: Literal["accept", "reject"] = "accept",
        lag_s: float = 0.0,
        echo: bool = False,
    ) -> None:
        self.config = arm
        self.start_ns = self.now_ns = start_ns
        positions = [0.0] * len(arm.joints) if joint_position_rad is None else joint_position_rad
        if len(positions) != len(arm.joints):
            raise ValueError(
                f"{len(positions)} joint positions were given, but arm {arm.name} has {len(arm.joints)} "
                "joints; give one for each."
            )
        self.bus = Bus(arm.bus.bitrate, start_ns)
        baud = arm.bus.serial_baud
        self.adapter = SlcanAdapter(
            arm.bus.bitrate,
            dialect=dialect,
            baud=None if baud == "cdc" else baud,
            echo=echo,
            seed=seed,
        )
        self.drives: list[ZdtDrive] = []
        for index, (joint, position_rad) in enumerate(zip(arm.joints, positions, strict=True)):
            if not isinstance(joint.drive, ZdtConfig):
                raise ValueError(
                    f"joint {joint.name} of arm {arm.name} has a {joint.drive.family} drive, but only zdt "
                    "drives can be simulated; run an arm with such drives without a simulator."
                )
            settings = Settings(
                address=joint.drive.address,
                microstep=joint.drive.microsteps % 256,
                can_code=_CAN_CODES.get(arm.bus.bitrate, 7),
            )
            drive = ZdtDrive(
                settings,
                start_ns=start_ns,
                position_pulses=round(joint.direction * (position_rad + joint.zero_rad) * joint.command_pulses_per_rad),
                homed=homed,
                homing=Homing(
                    mode=2,
                    direction=1 if joint.direction > 0 else 0,
                    rpm=HOMING_RPM,
                    timeout_ms=HOMING_TIMEOUT_MS,
                ),
                firmware=firmware,
                retarget=retarget,
                lag_s=lag_s,
                seed=seed * 1000 + index,
            )
            stop = round(_motor_turns(joint, joint.lower_rad) * GRAINS_PER_REVOLUTION)
            if joint.direction > 0:
                drive.shaft.low = stop
            else:
                drive.shaft.high = stop
            self.drives.append(drive)
        self._script = _Script()
        self.bus.nodes += [self.adapter, *self.drives, self._script]
        for fault in faults:
            self.inject(fault)

    def run_until(self, now_ns: int) -> None:
        """Let time pass up to `now_ns`; what is for the host waits to be collected."""
        if now_ns < self.now_ns:
            raise ValueError(f"time {now_ns} ns lies before {self.now_ns} ns, but must not run backwards.")
        self.now_ns = now_ns
        self.bus.run_until(now_ns)

    def feed(self, now_ns: int, data: bytes) -> None:
        """Bytes from the host, written at `now_ns`."""
        self.run_until(now_ns)
        self.adapter.feed(now_ns, data)

    def collect(self, now_ns: int) -> bytes:
        """All bytes for the host that have arrived up to `now_ns`."""
        self.run_until(now_ns)
        return self.adapter.collect(now_ns)

    def next_due_ns(self) -> int | None:
        """The earliest time at which there may be bytes for the host if it writes nothing meanwhile.

        Returns:
            That time, always later than the last one told unless bytes are waiting already: there may
            then be none yet, and asking again gives a later time. None if nothing is on its way.
        """
        self.bus.run_until(self.now_ns)
        due_ns = self.adapter.next_due_ns()
        if due_ns == NEVER:
            answer_ns = min(drive.reply_delay_ns[0] for drive in self.drives)
            due_ns = self.bus.quiet_until_ns(self.adapter, answer_ns)
        return None if due_ns == NEVER else due_ns

    def inject(self, fault: Fault, since_ns: int | None = None) -> None:
        """Let something go wrong at its time, counted from `since_ns` (the arm's start by default).

        What lies in the past happens now.

        Raises:
            ValueError: the arm has no such joint.
        """
        origin_ns = self.start_ns if since_ns is None else since_ns

        def at(at_s: float, action: Callable[[int], None]) -> None:
            self._script.add(max(origin_ns + round(at_s * 1e9), self.now_ns), action)

        match fault:
            case OpenRefused():
                self.adapter.refuses_open = True
            case CorruptBytes(share, at_s):
                at(at_s, partial(_set, self.adapter, "corruption", share))
            case Silent(joint, at_s, until_s):
                drive = self._drive(joint)
                at(at_s, drive.unplug)
                if until_s is not None:
                    at(until_s, drive.plug_in)
            case PowerLoss(joint, at_s, off_s):
                drive = self._drive(joint)
                at(at_s, drive.power_off)
                at(at_s + off_s, drive.power_on)
            case Stall(joint, at_s):
                at(at_s, self._drive(joint).block_shaft)
            case LostReplies(share, at_s, joint_or_all):
                for drive in self._chosen(joint_or_all):
                    at(at_s, partial(_set, drive, "reply_loss", share))
            case SlowReplies(extra_s, jitter_s, at_s, joint_or_all):
                for drive in self._chosen(joint_or_all):
                    least, greatest = drive.reply_delay_ns
                    slow = (least + round(extra_s * 1e9), greatest + round((extra_s + jitter_s) * 1e9))
                    at(at_s, partial(_set, drive, "reply_delay_ns", slow))

    def true_position_rad(self, joint: int, t_ns: int) -> float:
        """Where the joint truly was at `t_ns`, between the start and now [rad]."""
        self._live()
        return self._joint_rad(joint, self.drives[joint].shaft.past(t_ns)[0])

    def true_velocity_rad_s(self, joint: int, t_ns: int) -> float:
        """How fast the joint truly was at `t_ns`, between the start and now [rad/s]."""
        self._live()
        return self.drives[joint].shaft.past(t_ns)[1] * self._rad_s_per_rpm(joint)

    def truth(self, joint: int, times_ns: Times) -> tuple[Reals, Reals]:
        """True positions [rad] and velocities [rad/s] of a joint at many times between start and now."""
        self._live()
        turns, rpm = self.drives[joint].shaft.history(times_ns)
        config = self.config.joints[joint]
        position_rad = config.direction * turns * (2.0 * math.pi / config.ratio) - config.zero_rad
        return position_rad, rpm * self._rad_s_per_rpm(joint)

    def truth_changes(self, joint: int) -> Times:
        """The times at which the joint's true velocity changed, oldest first, then now.

        Without lag the position is linear in between, so `truth` at these times is the whole motion.
        """
        self._live()
        return np.append(self.drives[joint].shaft.changes_ns(), self.now_ns)

    def _live(self) -> None:
        for drive in self.drives:
            drive.advance(self.now_ns)

    def _joint_rad(self, joint: int, turns: float) -> float:
        config = self.config.joints[joint]
        return config.direction * turns * (2.0 * math.pi / config.ratio) - config.zero_rad

    def _rad_s_per_rpm(self, joint: int) -> float:
        config = self.config.joints[joint]
        return config.direction * 2.0 * math.pi / 60.0 / config.ratio

    def _drive(self, name: str) -> ZdtDrive:
        names = [joint.name for joint in self.config.joints]
        if name not in names:
            raise ValueError(f"arm {self.config.name} has no joint {name!r}; it has {', '.join(names)}.")
        return self.drives[names.index(name)]

    def _chosen(self, name: str | None) -> list[ZdtDrive]:
        return self.drives if name is None else [self._drive(name)]


def _set(owner: object, name: str, value: object, _: int) -> None:
    setattr(owner, name, value)


class _Script:
    """What happens at given times; on the bus only so as to be woken in order."""

    def __init__(self) -> None:
        self.outbox: Outbox = deque()
        self.listening = False
        self.address: int | None = None
        self.wake_ns = NEVER
        self._events: list[tuple[int, int, Callable[[int], None]]] = []
        self._order = itertools.count()

    def add(self, time_ns: int, action: Callable[[int], None]) -> None:
        heapq.heappush(self._events, (time_ns, next(self._order), action))
        self.wake_ns = self._events[0][0]

    def wake(self, now_ns: int) -> None:
        heapq.heappop(self._events)[2](now_ns)
        self.wake_ns = self._events[0][0] if self._events else NEVER

    def receive(self, now_ns: int, frame: Frame) -> None:
        """It does not listen."""

    def sent(self, now_ns: int, frame: Frame) -> None:
        """It does not send."""


_CAN_CODES = {
    10_000: 0,
    20_000: 1,
    50_000: 2,
    100_000: 4,
    125_000: 5,
    250_000: 6,
    500_000: 7,
    1_000_000: 9,
}
"""The drive's menu codes for its bit rate (zdt-emm-v5.md section 1)."""


def _motor_turns(joint: JointConfig, position_rad: float) -> float:
    return joint.direction * (position_rad + joint.zero_rad) * joint.ratio / (2.0 * math.pi)
