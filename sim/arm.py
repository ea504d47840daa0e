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
from typing import Any, Literal, TypeVar

import numpy as np

from config import schema
from config.bus import BusConfig
from config.gripper import GripperConfig
from config.serial_adapters import SERIAL_ADAPTERS
from sim import faults as wrong
from sim.adapter import Dialect, SlcanAdapter
from sim.at_adapter import AtAdapter
from sim.babble import Babbler
from sim.bus import Arrivals, Bus, Frame, Outbox, joined
from sim.can_interface import CanInterface
from sim.drives.drive import Drive, Mounting
from sim.drives.families import FAMILIES
from sim.drives.ramp import GRAINS_PER_REVOLUTION, NEVER
from sim.drives.shaft import Reals, Times
from sim.drives.zdt import ZdtDrive
from sim.drives.zdt_settings import CAN_CODES, Settings, homing_towards
from sim.faults import Fault
from sim.hand import Guided, Hand
from sim.seeed_adapter import SeeedAdapter
from sim.serial_adapter import LineFault, SerialAdapter

FINGER_SLACK_RAD = math.radians(5.0)

Value = TypeVar("Value")
At = Callable[[float | None, Callable[[int], None]], None]
"""Lets something happen at a time [s] after the one a fault's times count from; never, if that is None."""

HIGHEST_PRIORITY = Frame(0, b"", extended=False)
"""Nothing wins against it, and no drive understands it."""
COUNT_RANGE = 1 << 32


class SimulatedArm:
    """Six (or any number of) drives of any families behind a serial adapter or a CAN interface.

    Args:
        arm: its configuration; the families of its drives must be among `sim.drives.families`.
        start_ns: when it begins; the first time that may be told.
        joint_position_rad: where the joints stand (ZDT drives to the nearest command pulse); all zero by default.
        seed: of every random delay and fault.
        faults: what goes wrong, and when.
        dialect: how an SLCAN adapter answers, see `sim.adapter`.
        firmware: of all ZDT drives, see `sim.drives.zdt`.
        homed: False makes drives that have just been switched on where they stand: they count from zero
            and say that power was lost.
        retarget: whether ZDT drives take a position command in mid-move, see `sim.drives.zdt`.
        enabling: what ZDT drives do that are enabled again, see `sim.drives.zdt`.
        lag_s: time constant of the shafts of ZDT drives behind their ramps [s].
        odrive_firmware: of all ODrives, see `sim.drives.odrive`.
        planning: how Damiao motors go to targets, see `sim.drives.damiao`.
        echo: whether the adapter reports its own transmissions as received frames.
        hand: a motion along which somebody leads the joints whenever all are limp, see `sim.hand`.

    Attributes:
        drives: in joint order.
        gripper: the servo of its gripper, None without one; faults name it as the gripper's joint. It homes to a stop
            where it counts 0, has another 5 degrees beyond its range, and stands where it is open.
        adapter: the serial adapter, or the CAN interface of an arm on SocketCAN.
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
        enabling: Literal["hold", "pull"] = "hold",
        lag_s: float = 0.0,
        odrive_firmware: Literal["0.5.6", "0.6"] = "0.5.6",
        planning: Literal["ramp", "gain"] = "ramp",
        echo: bool = False,
        hand: Guided | None = None,
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
        self.adapter: SerialAdapter[Any] | CanInterface
        if arm.bus.spoken not in SERIAL_ADAPTERS:
            self.adapter = CanInterface()
        else:
            self.adapter = _serial_adapter(arm.bus, dialect, echo=echo, seed=seed)
        self.drives: list[Drive] = []
        for index, (joint, position_rad) in enumerate(zip(arm.joints, positions, strict=True)):
            make = FAMILIES.get(joint.drive.family)
            if make is None:
                raise ValueError(
                    f"joint {joint.name} of arm {arm.name} has a {joint.drive.family} drive, but only "
                    f"{', '.join(FAMILIES)} drives can be simulated; run an arm with such drives without a simulator."
                )
            mounting = Mounting(
                joint=joint,
                bitrate=arm.bus.bitrate,
                start_ns=start_ns,
                position_rad=position_rad,
                homed=homed,
                seed=seed * 1000 + index,
                firmware=firmware,
                retarget=retarget,
                enabling=enabling,
                lag_s=lag_s,
                odrive_firmware=odrive_firmware,
                planning=planning,
            )
            self.drives.append(make(mounting))
        self.gripper = self._gripper_drive(start_ns, firmware, homed, seed)
        self._seed = seed
        self._script = _Script()
        self.bus.nodes += [self.adapter, *self.drives, *([self.gripper] if self.gripper else []), self._script]
        if hand is not None:
            self.bus.nodes.append(Hand(hand, arm.joints, self.drives, start_ns))
        for fault in faults:
            self.inject(fault)

    def _gripper_drive(self, start_ns: int, firmware: Literal["new", "old"], homed: bool, seed: int) -> ZdtDrive | None:
        gripper = self.config.gripper
        if gripper is None or gripper.servo is None:
            return None
        servo = gripper.servo
        drive = ZdtDrive(
            Settings(
                address=servo.address,
                microstep=servo.microsteps % 256,
                can_code=CAN_CODES.get(self.config.bus.bitrate, CAN_CODES[500_000]),
            ),
            start_ns=start_ns,
            position_pulses=round((gripper.open_rad + servo.zero_rad) * servo.pulses_per_rad),
            homed=homed,
            homing=homing_towards(servo.direction),
            firmware=firmware,
            seed=seed * 1000 + len(self.config.joints),
        )
        _let_stop(drive, gripper, _closed_stop_rad(gripper), start_ns)
        return drive

    def _put_between_fingers(self, angle_rad: float, now_ns: int) -> None:
        """Let the fingers stop at an angle; those that are closer already stay where they are."""
        gripper, drive = self.config.gripper, self.gripper
        assert gripper is not None and drive is not None
        drive.advance(now_ns)
        _let_stop(drive, gripper, min(angle_rad, self.gripper_rad(now_ns)), now_ns)

    def gripper_rad(self, t_ns: int) -> float:
        """Where the gripper truly was at `t_ns`, between the start and now [rad]; of an arm that has one."""
        gripper, drive = self.config.gripper, self.gripper
        assert gripper is not None and gripper.servo is not None and drive is not None
        drive.advance(self.now_ns)
        servo = gripper.servo
        return servo.direction * drive.shaft.past(t_ns)[0] * (2.0 * math.pi / servo.ratio) - servo.zero_rad

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

    def arrivals(self, now_ns: int) -> Arrivals:
        """All bytes for the host that have arrived up to `now_ns`, each with its time."""
        self.run_until(now_ns)
        return self.adapter.arrivals(now_ns)

    def collect(self, now_ns: int) -> bytes:
        """All bytes for the host that have arrived up to `now_ns`."""
        return joined(self.arrivals(now_ns))

    def next_due_ns(self) -> int | None:
        """The earliest time at which there may be bytes for the host if it writes nothing meanwhile.

        Returns:
            That time, always later than the last one told unless bytes are waiting already: there may
            then be none yet, and asking again gives a later time. None if nothing is on its way.
        """
        self.bus.run_until(self.now_ns)
        due_ns = self.adapter.next_due_ns()
        if due_ns == NEVER:
            drives = [*self.drives, *([self.gripper] if self.gripper else [])]
            answer_ns = min(drive.reply_delay_ns[0] for drive in drives)
            due_ns = self.bus.quiet_until_ns(self.adapter, answer_ns)
        return None if due_ns == NEVER else due_ns

    def inject(self, fault: Fault, since_ns: int | None = None) -> None:
        """Let something go wrong at its time, counted from `since_ns` (the arm's start by default).

        What lies in the past happens now.

        Raises:
            ValueError: the arm has no such joint, its drive is of a family without such faults, or the arm has no
                serial adapter that it could befall.
        """
        origin_ns = self.start_ns if since_ns is None else since_ns

        def at(at_s: float | None, action: Callable[[int], None]) -> None:
            if at_s is not None:
                self._script.add(max(origin_ns + round(at_s * 1e9), self.now_ns), action)

        done = self._inject_in_drive(fault, at) or self._inject_in_zdt(fault, at) or self._inject_in_adapter(fault, at)
        if not done:
            raise ValueError(f"{fault} is no fault this arm can have.")

    def _inject_in_drive(self, fault: Fault, at: At) -> bool:
        """What can go wrong with a drive of any family, or beside it on the bus."""
        match fault:
            case wrong.Silent(joint, at_s, until_s):
                at(at_s, self._drive(joint).unplug)
                at(until_s, self._drive(joint).plug_in)
            case wrong.PowerLoss(joint, at_s, off_s):
                at(at_s, self._drive(joint).power_off)
                at(at_s + off_s, self._drive(joint).power_on)
            case wrong.Stall(joint, at_s):
                at(at_s, self._drive(joint).block_shaft)
            case wrong.Protection(joint, at_s, until_s, cause):
                drive = self._drive(joint)
                at(at_s, partial(_set, drive, "cause_lasts", until_s is not None))
                at(at_s, partial(_call, drive.protect, cause))
                at(until_s, partial(_set, drive, "cause_lasts", False))
            case wrong.Disabled(joint, at_s):
                at(at_s, self._drive(joint).disable)
            case wrong.Thing(at_s, deg, until_s) if self.config.gripper is not None and self.gripper is not None:
                at(at_s, partial(self._put_between_fingers, math.radians(deg)))
                at(until_s, partial(self._put_between_fingers, _closed_stop_rad(self.config.gripper)))
            case wrong.SameAddress(joint, at_s):
                at(at_s, partial(self._add_drive, self._drive(joint)))
            case wrong.LostReplies(share, at_s, joint_or_all):
                for drive in self._chosen(joint_or_all):
                    at(at_s, partial(_set, drive, "reply_loss", share))
            case wrong.SlowReplies(extra_s, jitter_s, at_s, joint_or_all):
                for drive in self._chosen(joint_or_all):
                    least, greatest = drive.reply_delay_ns
                    slow = (least + round(extra_s * 1e9), greatest + round((extra_s + jitter_s) * 1e9))
                    at(at_s, partial(_set, drive, "reply_delay_ns", slow))
            case wrong.Babble(at_s, until_s, joint_or_none):
                babbler = Babbler()
                self.bus.nodes.append(babbler)
                at(at_s, partial(self._babble, babbler, joint_or_none))
                at(until_s, babbler.end)
            case _:
                return False
        return True

    def _inject_in_zdt(self, fault: Fault, at: At) -> bool:
        """What only a ZDT drive can suffer."""
        drives = self._zdt_drives(getattr(fault, "joint", None))
        if not drives:
            return False
        match fault:
            case wrong.Refusing(_, at_s, until_s):
                at(at_s, partial(_set, drives[0], "refuses", True))
                at(until_s, partial(_set, drives[0], "refuses", False))
            case wrong.CountSlip(joint, at_s, deg):
                at(at_s, partial(_call, drives[0].slip, self._counts(joint, deg)))
            case wrong.CountWrap(_, at_s):
                at(at_s, partial(_set, drives[0], "count_shift", -COUNT_RANGE))
            case wrong.KeepsSettings(_, at_s):
                at(at_s, partial(_set, drives[0], "keeps_settings", True))
            case wrong.ForeignFirmware(_, at_s):
                at(at_s, partial(_set, drives[0], "foreign", True))
            case wrong.WrongChecksums(share, at_s):
                for drive in drives:
                    at(at_s, partial(_set, drive, "wrong_checksums", share))
            case wrong.WrongValues(share, most_deg, at_s, joint_or_all):
                for config, node in zip(self.config.joints, self.drives, strict=True):
                    if isinstance(node, ZdtDrive) and joint_or_all in (None, config.name):
                        most = abs(self._counts(config.name, most_deg))
                        at(at_s, partial(_set, node, "wrong_values", (share, most)))
            case _:
                return False
        return True

    def _inject_in_adapter(self, fault: Fault, at: At) -> bool:
        adapter = self.serial_adapter()
        match fault:
            case wrong.OpenRefused():
                adapter.refuses_open = True
            case wrong.CorruptBytes(share, at_s):
                at(at_s, partial(_set, adapter, "corruption", share))
            case wrong.DuplicateReplies(share, gap_s, at_s, joint):
                self._spoil_lines(at, at_s, LineFault("twice", share, round(gap_s * 1e9), self._owner(joint)))
            case wrong.LateReplies(share, late_s, at_s, joint):
                self._spoil_lines(at, at_s, LineFault("late", share, round(late_s * 1e9), self._owner(joint)))
            case wrong.CutLines(share, rest_s, at_s, joint):
                rest_ns = None if rest_s is None else round(rest_s * 1e9)
                self._spoil_lines(at, at_s, LineFault("cut", share, rest_ns, self._owner(joint)))
            case wrong.ReceiveStall(at_s, stall_s, depth):
                at(at_s, lambda _: adapter.stall(int(depth)))
                at(at_s + stall_s, adapter.recover)
            case wrong.TransmitOverflow(depth, at_s, until_s):
                at(at_s, partial(_set, adapter, "depth", int(depth)))
                at(until_s, partial(_set, adapter, "depth", adapter.depth))
            case wrong.Bels(share, at_s):
                at(at_s, partial(_set, adapter, "refusals", share))
            case wrong.SerialBlocked(at_s, until_s):
                at(at_s, partial(_set, adapter, "takes_characters", False))
                at(until_s, partial(_set, adapter, "takes_characters", True))
            case _:
                return False
        return True

    def _spoil_lines(self, at: At, at_s: float, fault: LineFault) -> None:
        at(at_s, lambda _: self.serial_adapter().line_faults.append(fault))

    def _babble(self, babbler: Babbler, joint: str | None, now_ns: int) -> None:
        frame = HIGHEST_PRIORITY
        if joint is not None:
            frame = self._drive(joint).state_frame(now_ns)
        babbler.begin(now_ns, frame)

    def _add_drive(self, other: Drive, now_ns: int) -> None:
        self.bus.nodes.append(other.twin(now_ns, self._seed * 1000 + len(self.bus.nodes)))

    def _owner(self, joint: str | None) -> Callable[[Frame], bool] | None:
        return None if joint is None else self._drive(joint).owns

    def _counts(self, joint: str, deg: float) -> int:
        config = next(config for config in self.config.joints if config.name == joint)
        return round(config.direction * math.radians(deg) * config.encoder_counts_per_rad)

    def serial_adapter(self) -> SerialAdapter[Any]:
        """The adapter of an arm that is reached through a serial port; raises ValueError for one that is not."""
        if not isinstance(self.adapter, SerialAdapter):
            raise ValueError(f"arm {self.config.name} has no serial adapter that this fault could befall.")
        return self.adapter

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

    def _drive(self, name: str) -> Drive:
        names = [joint.name for joint in self.config.joints]
        gripper = self.config.gripper
        if gripper is not None and self.gripper is not None and name == gripper.joint:
            return self.gripper
        if name not in names:
            raise ValueError(f"arm {self.config.name} has no joint {name!r}; it has {', '.join(names)}.")
        return self.drives[names.index(name)]

    def _chosen(self, name: str | None) -> list[Drive]:
        return self.drives if name is None else [self._drive(name)]

    def _zdt_drives(self, name: str | None) -> list[ZdtDrive]:
        return [drive for drive in self._chosen(name) if isinstance(drive, ZdtDrive)]


def _serial_adapter(bus: BusConfig, dialect: Dialect, *, echo: bool, seed: int) -> SerialAdapter[Any]:
    baud = None if bus.serial_baud == "cdc" else bus.serial_baud
    if bus.spoken == "seeedstudio":
        return SeeedAdapter(bus.bitrate, baud=baud, echo=echo, seed=seed)
    if bus.spoken == "ch340-at":
        return AtAdapter(bus.bitrate, baud=baud, echo=echo, seed=seed)
    return SlcanAdapter(bus.bitrate, dialect=dialect, baud=baud, echo=echo, seed=seed)


def _set(owner: object, name: str, value: object, _: int) -> None:
    setattr(owner, name, value)


def _call(action: Callable[[int, Value], None], value: Value, now_ns: int) -> None:
    action(now_ns, value)


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


def _closed_stop_rad(gripper: GripperConfig) -> float:
    """Where the closed fingers meet: the count 0 of its homing, where that lies below its range."""
    assert gripper.servo is not None
    return min(-gripper.servo.zero_rad, gripper.lower_rad)


def _let_stop(drive: ZdtDrive, gripper: GripperConfig, low_rad: float, now_ns: int) -> None:
    """Let the gripper's joint stop there, and beyond its range on the other side."""
    servo = gripper.servo
    assert servo is not None
    turns = [
        servo.direction * (angle_rad + servo.zero_rad) * servo.ratio / (2.0 * math.pi)
        for angle_rad in (low_rad, gripper.upper_rad + FINGER_SLACK_RAD)
    ]
    low, high = sorted(round(turn * GRAINS_PER_REVOLUTION) for turn in turns)
    drive.let_stop(now_ns, low, high)
