"""What can go wrong on the bus of an arm, and what may come of it: the rows of docs/explanation/safety.md.

`bus_trials` runs them in virtual time, `live_bus_trials` with real processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from shm.words import Fault
from sim import faults as wrong
from sim.babble import Babbler
from sim.drives.zdt import ZdtDrive
from sim.drives.zdt_motion import PowerFlag

if TYPE_CHECKING:
    from bus_trials import TrialArm

GOES_ON = Fault.NONE
FLAGS: tuple[PowerFlag, ...] = get_args(PowerFlag)
"""A joint whose drive's flag is stuck is where a person says."""

JOINTS = tuple(f"joint{number}" for number in range(1, 7))

Inject = Callable[[np.random.Generator, str], Sequence[wrong.Fault]]
Mend = Callable[["TrialArm", int], None]


@dataclass(frozen=True)
class BusFault:
    """One row: what goes wrong, and what may come of it.

    Attributes:
        inject: the faults of the simulated arm, times counted from the trial's moment; by random numbers and a joint.
        latched: what may be latched; GOES_ON among them if the goal may end by itself.
        mend: takes the cause away; None where it goes away by itself.
        unplugs: the adapter is pulled out, and stays out.
        throws: the joint's own drive fails, so that its acceleration is not ours.
        loses: the joint must not be referenced afterwards, whatever was latched.
        blind_rad: nothing is expected of a joint that stands nearer than this to where its drive counts from, where no
            flag tells a loss of power.
        options, overrides: of the simulated arm, and of the arm's file.
        backlog: what was on its way when the way was blocked still arrives when it is free.
        heals: the arm goes on by itself where it may.
        flags: kinds of flags for lost power that the drives may have.
    """

    name: str
    inject: Inject
    latched: frozenset[Fault]
    mend: Mend | None = None
    unplugs: bool = False
    throws: bool = False
    loses: bool = False
    backlog: bool = False
    heals: bool = False
    flags: tuple[PowerFlag, ...] = ()
    blind_rad: float = 0.0
    options: dict[str, Any] = field(default_factory=dict)
    overrides: dict[str, dict[str, object]] = field(default_factory=dict)

    def is_blind(self, away_rad: float, flag: PowerFlag) -> bool:
        """Whether nothing is expected of a joint so far from where its drive counts from, which has such a flag."""
        return away_rad < self.blind_rad and (flag != "right" or self.options.get("firmware") == "old")


def spelled(fault: wrong.Fault) -> str:
    """A fault as the simulated arm's command line takes it."""
    name = next(name for name, kind in wrong.FAULTS.items() if kind is type(fault))
    values = {field.name: getattr(fault, field.name) for field in fields(fault)}
    return f"{name}:" + ",".join(f"{key}={value}" for key, value in values.items() if value is not None)


def _now(kind: Callable[..., wrong.Fault], **fixed: Any) -> Inject:
    """A fault of the chosen joint, from the trial's moment on."""
    return lambda _, joint: [kind(joint=joint, at_s=0.0, **fixed)]


def _all(kind: Callable[..., wrong.Fault], **fixed: Any) -> Inject:
    """A fault of no drive, or of all, from the trial's moment on."""
    return lambda _, __: [kind(at_s=0.0, **fixed)]


def _plug_in(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    arm.sim.drives[joint].plug_in(arm.sim.now_ns)


def _inject(*faults: wrong.Fault) -> Mend:
    """Take a cause away by a fault that is none."""

    def mend(arm: TrialArm, _: int) -> None:
        assert arm.sim is not None
        for fault in faults:
            arm.sim.inject(fault, arm.sim.now_ns)

    return mend


def _be_quiet(arm: TrialArm, _: int) -> None:
    assert arm.sim is not None
    for node in arm.sim.bus.nodes:
        if isinstance(node, Babbler):
            node.end(arm.sim.now_ns)


def _unblock(arm: TrialArm, _: int) -> None:
    assert arm.sim is not None
    arm.sim.adapter.takes_characters = True


def _let_refuse_no_more(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    arm.sim.drives[joint].refuses = False


def _let_go_of_shaft(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    shaft = arm.sim.drives[joint].shaft
    shaft.low = shaft.high = None


def _cool(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    arm.sim.drives[joint].cause_lasts = False


def _wait_for_power(arm: TrialArm, _: int) -> None:
    """The cut lasts a second, and drives need a moment to boot."""
    arm.cycles(round(1.5e9 / arm.period_ns))


def _remove_the_other(arm: TrialArm, joint: int) -> None:
    assert arm.sim is not None
    address = arm.sim.drives[joint].settings.address
    for node in arm.sim.bus.nodes:
        if isinstance(node, ZdtDrive) and node.settings.address == address and node is not arm.sim.drives[joint]:
            node.unplug(arm.sim.now_ns)


def _between(random: np.random.Generator, low: float, high: float) -> float:
    return float(random.uniform(low, high))


def _silences(random: np.random.Generator, _: str) -> list[wrong.Fault]:
    until_s = _between(random, 0.05, 0.9)
    return [wrong.Silent(joint, 0.0, until_s) for joint in JOINTS]


def _loses_power_in_silence(random: np.random.Generator, joint: str) -> list[wrong.Fault]:
    """As long as all are silent, or for a moment of it."""
    until_s = _between(random, 0.15, 0.9)
    off_s = _between(random, 0.01, until_s)
    return [
        *(wrong.Silent(each, 0.0, until_s) for each in JOINTS),
        wrong.PowerLoss(joint, _between(random, 0.0, until_s - off_s), off_s),
    ]


STALE = frozenset({Fault.STALE_READING})
STALE_OR_NOT = frozenset({Fault.STALE_READING, GOES_ON})
NEVER = frozenset({GOES_ON})
STALL = frozenset({Fault.STALE_READING, Fault.FOLLOWING_ERROR, GOES_ON})
REFERENCE = frozenset({Fault.REFERENCE_LOST})
FOLLOWING = Fault.FOLLOWING_ERROR

FAULTS = (
    BusFault("a drive falls silent", _now(wrong.Silent), STALE, _plug_in, loses=True),
    BusFault(
        "a drive is silent for 30 to 80 ms",
        lambda r, j: [wrong.Silent(j, 0.0, _between(r, 0.03, 0.08))],
        frozenset({GOES_ON, FOLLOWING}),
    ),
    BusFault(
        "10 % of the answers are lost", _all(wrong.LostReplies, share=0.1), NEVER, _inject(wrong.LostReplies(0.0))
    ),
    BusFault(
        "answers up to 5 ms late",
        _all(wrong.SlowReplies, extra_s=0.0, jitter_s=0.005),
        NEVER,
    ),
    BusFault(
        "5 % of the answers 12 ms late, overtaken by others", _all(wrong.LateReplies, share=0.05, late_s=0.012), NEVER
    ),
    BusFault(
        "20 % of the answers twice, up to 9 ms apart",
        lambda r, _: [wrong.DuplicateReplies(0.2, gap_s=_between(r, 0.0, 0.009))],
        NEVER,
    ),
    BusFault(
        "0.1 % of the characters garbled",
        _all(wrong.CorruptBytes, share=0.001),
        NEVER,
        _inject(wrong.CorruptBytes(0.0)),
    ),
    BusFault("2 % of the lines break off, the rest is missing", _all(wrong.CutLines, share=0.02), NEVER),
    BusFault(
        "2 % of the lines break off, the rest comes 2 ms later", _all(wrong.CutLines, share=0.02, rest_s=0.002), NEVER
    ),
    BusFault(
        "10 % of the answers with a wrong checksum",
        _all(wrong.WrongChecksums, share=0.1),
        NEVER,
        _inject(wrong.WrongChecksums(0.0)),
    ),
    BusFault(
        "every answer of a drive with a wrong checksum",
        _now(wrong.WrongChecksums, share=1.0),
        STALE,
        _inject(wrong.WrongChecksums(0.0)),
        loses=True,
    ),
    BusFault(
        "0.1 % of the positions wrong by up to 15°",
        _all(wrong.WrongValues, share=0.001, most_deg=15.0),
        NEVER,
        _inject(wrong.WrongValues(0.0, 0.0)),
    ),
    BusFault("a node babbles with the highest priority", _all(wrong.Babble), STALE, _be_quiet, backlog=True),
    BusFault(
        "a node babbles for 10 to 80 ms",
        lambda r, _: [wrong.Babble(0.0, _between(r, 0.01, 0.08))],
        frozenset({GOES_ON, FOLLOWING}),
        backlog=True,
    ),
    BusFault(
        "a drive babbles its position",
        _now(wrong.Babble),
        frozenset({Fault.STALE_READING, FOLLOWING, GOES_ON}),
        _be_quiet,
    ),
    BusFault(
        "the adapter says nothing for 30 to 90 ms, then all at once",
        lambda r, _: [wrong.ReceiveStall(0.0, _between(r, 0.03, 0.09))],
        frozenset({GOES_ON, FOLLOWING}),
    ),
    BusFault(
        "the adapter says nothing for 0.3 s, then what fits its buffer",
        _all(wrong.ReceiveStall, stall_s=0.3),
        STALE,
    ),
    BusFault(
        "the adapter's transmit buffer holds 6 frames",
        _all(wrong.TransmitOverflow, depth=6),
        frozenset({Fault.STALE_READING, FOLLOWING, GOES_ON}),
        _inject(wrong.TransmitOverflow(64, 0.0)),
    ),
    BusFault(
        "2 % of the frames refused by the adapter (BEL)", _all(wrong.Bels, share=0.02), NEVER, _inject(wrong.Bels(0.0))
    ),
    BusFault("the serial port takes nothing more", _all(wrong.SerialBlocked), STALE, _unblock, backlog=True),
    BusFault(
        "the serial port takes nothing for 30 to 80 ms",
        lambda r, _: [wrong.SerialBlocked(0.0, _between(r, 0.03, 0.08))],
        frozenset({GOES_ON, FOLLOWING}),
        backlog=True,
    ),
    BusFault(
        "the adapter says nothing for 50 to 900 ms, and the arm may heal",
        lambda r, _: [wrong.ReceiveStall(0.0, _between(r, 0.05, 0.9))],
        STALL,
        heals=True,
    ),
    BusFault(
        "the serial port takes nothing for 50 to 900 ms, and the arm may heal",
        lambda r, _: [wrong.SerialBlocked(0.0, _between(r, 0.05, 0.9))],
        STALL,
        backlog=True,
        heals=True,
    ),
    BusFault(
        "a node babbles for 50 to 900 ms, and the arm may heal",
        lambda r, _: [wrong.Babble(0.0, _between(r, 0.05, 0.9))],
        STALL,
        backlog=True,
        heals=True,
    ),
    BusFault("all drives are silent for 50 to 900 ms, and the arm may heal", _silences, STALL, heals=True),
    BusFault(
        "all drives are silent for 150 to 900 ms, one loses power meanwhile, and the arm may heal",
        _loses_power_in_silence,
        STALL,
        _wait_for_power,
        throws=True,
        loses=True,
        heals=True,
        flags=FLAGS,
    ),
    BusFault("the adapter is pulled out", lambda _, __: [], frozenset({Fault.WIRE}), unplugs=True),
    BusFault("a shaft is held", _now(wrong.Stall), frozenset({FOLLOWING, GOES_ON}), _let_go_of_shaft, throws=True),
    BusFault(
        "a drive trips its stall protection",
        _now(wrong.Protection),
        frozenset({Fault.DRIVE_FAULT, FOLLOWING}),
        throws=True,
    ),
    BusFault(
        "a drive is too hot and trips",
        _now(wrong.Protection, until_s=1e6, cause="temperature"),
        frozenset({Fault.DRIVE_FAULT, FOLLOWING}),
        _cool,
        throws=True,
    ),
    BusFault(
        "a drive draws too much current and trips",
        _now(wrong.Protection, until_s=1e6, cause="current"),
        frozenset({Fault.DRIVE_FAULT, FOLLOWING}),
        _cool,
        throws=True,
    ),
    BusFault("somebody lets a drive go", _now(wrong.Disabled), frozenset({Fault.DRIVE_FAULT, FOLLOWING}), throws=True),
    BusFault(
        "a drive refuses motion (E2), without acknowledgements",
        _now(wrong.Refusing),
        frozenset({FOLLOWING, GOES_ON}),
        _let_refuse_no_more,
    ),
    BusFault(
        "a drive refuses motion (E2), with acknowledgements and 100 Hz",
        _now(wrong.Refusing),
        frozenset({Fault.DRIVE_FAULT, GOES_ON}),
        _let_refuse_no_more,
        overrides={"bus": {"acknowledge": True}, "control": {"rate_hz": 100.0}},
    ),
    BusFault(
        "every position of a drive is nonsense",
        _now(wrong.WrongValues, share=1.0, most_deg=200.0),
        frozenset({Fault.STALE_READING, Fault.REFERENCE_LOST, FOLLOWING}),
        _inject(wrong.WrongValues(0.0, 0.0)),
        loses=True,
    ),
    BusFault(
        "a drive loses power for 10 to 80 ms",
        lambda r, j: [wrong.PowerLoss(j, 0.0, _between(r, 0.01, 0.08))],
        frozenset({Fault.REFERENCE_LOST, Fault.STALE_READING, FOLLOWING}),  # and the flag, a moment later
        throws=True,
        loses=True,
        flags=FLAGS,
        blind_rad=1.0,
    ),
    BusFault(
        "a drive loses power for 0.5 s",
        _now(wrong.PowerLoss, off_s=0.5),
        STALE,
        throws=True,
        loses=True,
        flags=FLAGS,
    ),
    BusFault(
        "all drives lose power for 1 s",
        lambda _, __: [wrong.PowerLoss(joint, 0.0, 1.0) for joint in JOINTS],
        STALE,
        _wait_for_power,
        throws=True,
        loses=True,
        flags=FLAGS,
    ),
    BusFault(
        "old firmware, which has no flag for it, loses power for 10 to 80 ms",
        lambda r, j: [wrong.PowerLoss(j, 0.0, _between(r, 0.01, 0.08))],
        frozenset({Fault.REFERENCE_LOST, Fault.STALE_READING}),
        throws=True,
        loses=True,
        blind_rad=1.0,
        options={"firmware": "old"},
    ),
    BusFault(
        "a count jumps by 20° to 90°",
        lambda r, j: [wrong.CountSlip(j, 0.0, _between(r, 20.0, 90.0) * (1 if r.random() < 0.5 else -1))],
        REFERENCE,
        throws=True,
        loses=True,
    ),
    BusFault("a count passes the end of its 32 bits", _now(wrong.CountWrap), REFERENCE, throws=True, loses=True),
    BusFault(
        "a second drive with the same address",
        _now(wrong.SameAddress),
        frozenset({Fault.STALE_READING, Fault.REFERENCE_LOST, FOLLOWING, GOES_ON}),
        _remove_the_other,
        throws=True,
    ),
)
