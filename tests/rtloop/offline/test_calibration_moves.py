"""One drive turned a little at a time beside an offline cycle, against simulated drives in virtual time."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION
from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.drives import zdt
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.power import Marks
from rtloop.offline.calibration.session import MOST_RPM, MOST_TURNS, NotDone, Session
from rtloop.service.conversation import DialogueFailed
from shm.words import Mode, Unreferenced
from sim import faults

TURN = ENCODER_COUNTS_PER_REVOLUTION
MOST_COUNTS = MOST_TURNS * TURN


class Cut(Exception):
    """The person wants no more."""


class Bench:
    """An arm nobody has brought up, and a session with its drives."""

    def __init__(self, found: Sequence[Any] = (), *, arm: ArmConfig | None = None, **options: Any) -> None:
        self.virtual = VirtualArm(arm or load_arm("episode1"), faults=found, **options)
        self.virtual.front_alive = False
        self.virtual.cycles(3)
        self.each_pause: Callable[[], None] = lambda: None
        self.told: list[str] = []
        self.lost: dict[int, Unreferenced | None] = {}
        self.session = Session(
            self.virtual.arm,
            self.virtual.port,
            clock_ns=lambda: self.virtual.now_ns,
            pause=self._pause,
            rest=self.virtual.cycle,
            tell=self.told.append,
            keep_lost=self.lost.__setitem__,
            marks=Marks(),
        )
        self.session.read()

    def _pause(self) -> None:
        self.virtual.cycle()
        self.each_pause()

    @property
    def drives(self) -> list[Any]:
        assert self.virtual.sim is not None
        return self.virtual.sim.drives

    def inject(self, fault: Any) -> None:
        assert self.virtual.sim is not None
        self.virtual.sim.inject(fault, self.virtual.sim.now_ns)

    def turned(self, joint: int = 0) -> float:
        """Motor turns since the beginning, as the shaft truly made them."""
        sim = self.virtual.sim
        assert sim is not None
        sim.run_until(max(self.virtual.now_ns, sim.now_ns))
        self.drives[joint].advance(sim.now_ns)  # also one that nothing reaches
        shaft = self.drives[joint].shaft
        began: float = shaft.past(sim.start_ns)[0]
        return float(shaft.past(sim.now_ns)[0]) - began

    def require_standing(self, joint: int = 0) -> None:
        """Nothing of the arm moves within the next second."""
        stood = self.turned(joint)
        self.virtual.cycles(self.virtual.arm.control.rate_hz.__ceil__())
        assert self.turned(joint) == stood
        assert not any(drive.moving for drive in self.drives)

    def sent(self) -> Iterator[tuple[int, bytes]]:
        """Address and whole command of everything that was said."""
        partial: dict[int, bytes] = {}
        for _, data in self.virtual.sent:
            for line in data.split(b"\r"):
                if not line.startswith(b"T"):
                    continue
                can_id, frame = int(line[1:9], 16), bytes.fromhex(line[10:].decode())
                address, packet = can_id >> 8, can_id & 255
                whole = frame if packet == 0 else partial.pop(address) + frame[1:]
                if len(frame) == 8 and frame[-1:] != b"\x6b":
                    partial[address] = whole
                else:
                    yield address, whole


def moves_of(bench: Bench) -> list[tuple[int, int, int, int, int]]:
    """Address, rpm, ramp byte, target in pulses, mode of every FD."""
    found = []
    for address, data in bench.sent():
        if data[0] == 0xFD:
            assert len(data) == 12 and data[-1] == 0x6B and data[10] == 0  # not synchronised
            pulses = int.from_bytes(data[5:9], "big") * (-1 if data[1] else 1)
            found.append((address, int.from_bytes(data[2:4], "big"), data[4], pulses, data[9]))
    return found


# --- bytes ----------------------------------------------------------------------------------------------


def test_the_bytes_of_a_move():
    """The facts' example (zdt-emm-v5.md 3: CCW, 129,536 pulses) at our speed, with our ramp, absolute."""
    assert protocol.move_to(-129_536, 8, 1) == bytes.fromhex("FD 01 00 08 01 00 01 FA 00 01 00 6B")
    assert protocol.move_to(3200, 10, 1) == bytes.fromhex("FD 00 00 0A 01 00 00 0C 80 01 00 6B")


@settings(deadline=None)  # the first compiles
@given(st.integers(-(2**32) + 1, 2**32 - 1), st.integers(1, 3000), st.integers(1, 255))
def test_a_move_is_what_the_cycle_would_say(pulses: int, rpm: int, ramp: int):
    first, second = zdt.pack_target(rpm, ramp, pulses)
    whole = (first & (1 << 64) - 1).to_bytes(8, "little") + second.to_bytes(5, "little")[1:]
    assert protocol.move_to(pulses, rpm, ramp) == whole


@pytest.mark.parametrize("wrong", [(0, 0, 1), (0, 3001, 1), (0, 8, 0), (0, 8, 256), (2**32, 8, 1)])
def test_no_move_without_ramp_or_with_a_speed_no_drive_has(wrong: tuple[int, int, int]):
    with pytest.raises(ValueError, match="no drive is sent"):
        protocol.move_to(*wrong)


# --- what is done -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("acknowledged", [True, False])
@pytest.mark.parametrize("by", [TURN // 12, -TURN // 12, MOST_COUNTS, 30])
def test_a_motor_turns_as_far_as_told_slowly_and_stands(by: int, acknowledged: bool):
    bench = Bench()
    if not acknowledged:  # as a bring-up has left them
        bench.drives[0].settings = replace(bench.drives[0].settings, response=0)
    before = bench.session.look(0)
    began_ns = bench.virtual.now_ns
    after = bench.session.turn(0, by, MOST_RPM)
    assert abs(after.counts - before.counts - by) <= 21  # one pulse
    assert bench.turned() == pytest.approx(by / TURN, abs=1 / 3200)
    assert bench.virtual.now_ns - began_ns >= abs(by) / TURN / MOST_RPM * 60e9
    bench.require_standing()
    assert bench.virtual.memory["mode"] == Mode.OFFLINE
    assert all(len(drive.shaft.changes_ns()) == 1 for drive in bench.drives[1:])


def test_what_goes_over_the_bus_is_bounded():
    bench = Bench()
    start = bench.session.look(2).counts
    for by, rpm in ((20_000, 8), (-20_000, 8), (MOST_COUNTS, MOST_RPM), (-5000, 1)):
        bench.session.turn(2, by, rpm)
    moves = moves_of(bench)
    assert len(moves) == 4
    expected = start * 3200 / TURN
    for (address, rpm, ramp, pulses, mode), (by, told) in zip(
        moves, ((20_000, 8), (-20_000, 8), (MOST_COUNTS, 10), (-5000, 1)), strict=True
    ):
        expected += by * 3200 / TURN
        assert (address, rpm, ramp, mode) == (3, told, 1, 1)
        assert abs(pulses - expected) <= 3
    said = {data[0] for _, data in bench.sent()}
    assert said & {0xF6, 0xF1, 0xFC, 0x9A, 0x0A, 0x93, 0xFF, 0x48, 0x4C} == set()


@pytest.mark.parametrize(("by", "rpm"), [(MOST_COUNTS + 1, 8), (1000, MOST_RPM + 1), (1000, 0), (-MOST_COUNTS - 1, 1)])
def test_what_is_too_far_or_too_fast_is_not_done(by: int, rpm: int):
    bench = Bench()
    with pytest.raises(NotDone, match="too far or too fast"):
        bench.session.turn(0, by, rpm)
    assert moves_of(bench) == []


def test_no_joint_gets_farther_than_its_range_from_where_it_began():
    bench = Bench()
    range_turns = 320 / 360  # joint6, direct
    bench.session.turn(5, round(0.8 * TURN), 10)
    with pytest.raises(NotDone, match=r"its range in the arm file, 320° with a ratio of 1"):
        bench.session.turn(5, round(0.2 * TURN), 10)
    assert bench.turned(5) < range_turns
    bench.session.turn(5, -round(0.8 * TURN), 10)


def test_a_drive_with_other_microsteps_turns_as_far_as_told():
    arm = load_arm("episode1")
    values = arm.model_dump(exclude_unset=True)
    values["joints"][0]["drive"]["microsteps"] = 64
    bench = Bench(arm=ArmConfig.model_validate(values))
    bench.session.turn(0, TURN // 4, 10)
    assert bench.turned() == pytest.approx(0.25, abs=1 / 12_800)


def test_limp_and_held_again_without_a_jump():
    bench = Bench(enabling="pull")
    assert bench.session.look(1).enabled
    assert not bench.session.let_go(1).enabled
    drive = bench.drives[1]
    drive.advance(bench.virtual.sim.now_ns)  # type: ignore[union-attr]
    drive._ramp.place(drive._ramp.position + drive._grains(5000))  # turned by hand
    state = bench.session.hold(1)
    assert state.enabled
    bench.require_standing(1)
    assert bench.turned(1) == pytest.approx(5000 / 3200, abs=0.01)
    bench.session.turn(1, 5000, 8)


def test_what_was_let_go_is_held_again_at_the_end():
    bench = Bench()
    bench.session.let_go(1)
    bench.each_pause = lambda: (_ for _ in ()).throw(Cut)  # who asks for the end goes on asking
    bench.session.close()
    assert [drive.enabled for drive in bench.drives] == [True] * 6


def test_a_homing_run_makes_its_count_mean_something():
    bench = Bench(homed=False)
    assert "lost power" in str(bench.session.look(5).doubt)
    state = bench.session.home(5)
    assert (state.counts, state.doubt) == (0, None)
    assert bench.lost == {5: None}
    assert any("homed" in line for line in bench.told)
    bench.require_standing(5)


@pytest.mark.parametrize(
    ("fault", "after", "sentence"),
    [
        (faults.Refusing("joint1", 0.0), 0, "does not begin its homing run"),
        (faults.PowerLoss("joint1", 0.0, 0.02), 100, "has lost power while .*, then run this again"),
        (faults.Protection("joint1", 0.0), 0, "is in protection and holds nothing: .*, then run this again"),
        (faults.Protection("joint1", 0.0), 100, "its protection, .*, then run this again"),
        (faults.Disabled("joint1", 0.0), 0, "is limp, so it cannot turn"),
    ],
)
def test_a_homing_run_that_fails_is_told_with_what_can_be_done_here(fault: Any, after: int, sentence: str):
    bench = Bench()
    pauses = itertools.count()

    def at_once_or_amid_the_run() -> None:
        if next(pauses) == after:
            bench.inject(fault)

    bench.each_pause = at_once_or_amid_the_run
    if after == 0:
        bench.session.look(0)
    with pytest.raises(DialogueFailed, match=sentence) as failed:
        bench.session.home(0)
    assert "rtarm" not in str(failed.value)
    bench.require_standing()


def test_firmware_that_cannot_tell_a_loss_of_power_is_doubted():
    assert "cannot say" in str(Bench(firmware="old").session.look(0).doubt)


# --- what goes wrong ----------------------------------------------------------------------------------------


def goes_wrong(bench: Bench, fault: Any, at: float = 0.4, by: int = TURN) -> str:
    """Let a fault happen when the motor has made that share of a move; what is said, once everything stands."""
    done = [False]

    def watch() -> None:
        if not done[0] and abs(bench.turned()) > at * by / TURN:
            done[0] = True
            bench.inject(fault)

    bench.session.look(0)
    bench.each_pause = watch
    with pytest.raises(DialogueFailed) as failed:
        bench.session.turn(0, by, 10)
    assert done[0]
    return str(failed.value)


def test_a_shaft_that_is_held_is_not_pushed_for_long():
    bench = Bench()
    said = goes_wrong(bench, faults.Stall("joint1", 0.0))
    assert "The drive of joint1 was held up" in said and "it was stopped" in said
    assert bench.turned() == pytest.approx(0.4, abs=0.05)
    bench.require_standing()
    assert not bench.drives[0].protected and bench.drives[0].enabled


def test_a_shaft_that_is_held_by_a_drive_that_says_nothing_of_it():
    """Its stall flag may be off: then only its place tells."""
    bench = Bench()
    drive = bench.drives[0]
    read = drive._reads[0x3A]
    drive._reads[0x3A] = lambda: bytes((0x3A, read()[1] & ~0x04))
    said = goes_wrong(bench, faults.Stall("joint1", 0.0))
    assert "does not turn as it should" in said
    target_turns = (drive.target_counts - drive.position_counts) / TURN
    assert abs(target_turns) < 0.01  # it does not go on pushing
    bench.require_standing()


@pytest.mark.parametrize("by", [TURN // 12, -TURN])
def test_a_joint_at_its_stop_is_not_pushed_on(by: int):
    bench = Bench()
    drive = bench.drives[0]
    drive.shaft.low = drive.shaft.high = drive.shaft.position_at(bench.virtual.sim.now_ns)  # type: ignore[union-attr]
    with pytest.raises(DialogueFailed, match=r"held up|does not turn"):
        bench.session.turn(0, by, 8)
    bench.require_standing()


@pytest.mark.parametrize(("off_s", "sentence"), [(0.02, "lost its power"), (0.5, "lost its power"), (3.0, "stands")])
def test_a_drive_that_loses_power_in_the_middle(off_s: float, sentence: str):
    """After a blink it is back before anybody misses it, enabled, counting from zero."""
    bench = Bench()
    assert sentence in goes_wrong(bench, faults.PowerLoss("joint1", 0.0, off_s))
    bench.virtual.cycles(400)
    bench.require_standing()
    assert abs(bench.turned()) < 0.6


def test_a_protection_that_trips_in_the_middle():
    bench = Bench()
    assert "was held up" in goes_wrong(bench, faults.Protection("joint1", 0.0))
    bench.virtual.cycles(120)
    assert not any(drive.moving for drive in bench.drives)
    with pytest.raises(DialogueFailed, match="in protection and holds nothing"):
        bench.session.turn(0, 1000, 8)


def test_a_drive_that_is_let_go_in_the_middle():
    assert "let go while it moved" in goes_wrong(Bench(), faults.Disabled("joint1", 0.0))


def test_a_count_that_jumps_in_the_middle_stops_the_move():
    bench = Bench()
    said = goes_wrong(bench, faults.CountSlip("joint1", 0.0, 5.0))
    assert "turns farther or faster than it was told" in said or "does not turn" in said
    bench.require_standing()
    assert abs(bench.turned()) < 0.6


def test_a_drive_that_falls_silent_ends_its_one_move_and_it_is_said():
    bench = Bench()
    said = goes_wrong(bench, faults.Silent("joint1", 0.0))
    assert "does not say that it stands" in said and "switch in the power line" in said
    bench.virtual.cycles(1200)
    assert bench.turned() == pytest.approx(1.0, abs=0.01)


def test_a_drive_that_refuses_is_believed():
    bench = Bench([faults.Refusing("joint1", 0.0)])
    with pytest.raises(DialogueFailed, match="refuses to move, and stands"):
        bench.session.turn(0, 1000, 8)
    bench.require_standing()


def test_a_drive_that_refuses_without_a_word_is_noticed():
    bench = Bench([faults.Refusing("joint1", 0.0)])
    bench.drives[0].settings = replace(bench.drives[0].settings, response=0)
    with pytest.raises(DialogueFailed, match=r"does not turn as it should|does not arrive"):
        bench.session.turn(0, TURN, 8)
    bench.require_standing()


def test_a_limp_drive_is_not_moved():
    bench = Bench([faults.Disabled("joint1", 0.0)])
    with pytest.raises(DialogueFailed, match="is limp, so it cannot turn"):
        bench.session.turn(0, 1000, 8)
    assert moves_of(bench) == []


def test_a_drive_whose_pulses_are_other_than_the_file_says_turns_too_far_and_is_stopped():
    """Its microsteps are changed behind the session's back: four times the angle."""
    bench = Bench()
    bench.drives[0].settings = replace(bench.drives[0].settings, microstep=4)
    with pytest.raises(DialogueFailed, match=r"farther or faster|did not stay"):
        bench.session.turn(0, TURN // 12, 8)
    bench.require_standing()
    assert abs(bench.turned()) < 0.2


PROBLEMS = {
    "missing": (faults.Silent("joint1", 0.0), "does not answer"),
    "X firmware": (faults.ForeignFirmware("joint1"), "37 bytes and 24 fields"),
    "in protection": (faults.Protection("joint1", 0.0), "in protection"),
}


@pytest.mark.parametrize(("fault", "sentence"), PROBLEMS.values(), ids=PROBLEMS)
def test_what_is_not_understood_is_said_before_anything_moves(fault: Any, sentence: str):
    bench = Bench([fault])
    assert sentence in bench.session.found[0].problems[0]
    assert bench.session.found[1].problems == []


@pytest.mark.parametrize("change", [{"microstep": 32}, {"motor_type": 0x32}])
def test_pulses_that_mean_another_angle_are_said_before_anything_moves(change: dict[str, int]):
    bench = Bench()
    bench.drives[0].settings = replace(bench.drives[0].settings, **change)
    bench.session.read()
    assert "is not the 3200 pulses a turn of the arm file" in bench.session.found[0].problems[0]


# --- a person who wants no more -------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["turn", "home", "hold", "release"])
@pytest.mark.parametrize("after", [0, 1, 2, 3, 5, 8, 13, 40, 100])
def test_cut_short_at_any_moment_it_stands_and_holds(order: str, after: int):
    bench = Bench()
    if order == "hold":
        bench.session.let_go(0)
    left = [after]

    def cut() -> None:
        left[0] -= 1
        if left[0] < 0:
            raise Cut

    bench.each_pause = cut
    orders: dict[str, Callable[[], Any]] = {
        "turn": lambda: bench.session.turn(0, TURN, 10),
        "home": lambda: bench.session.home(0),
        "hold": lambda: bench.session.hold(0),
        "release": lambda: bench.session.let_go(0),
    }
    try:
        orders[order]()
    except Cut:
        pass
    else:
        assert order in ("hold", "release")
    bench.session.close()
    turned = bench.turned()
    bench.require_standing()
    assert all(drive.enabled and not drive.homing_now for drive in bench.drives)
    speed = 30 if order == "home" else 10
    most_s = (after + 10) * bench.virtual.period_ns * 1e-9
    assert abs(turned) <= most_s * speed / 60


def test_the_session_asks_for_no_time_it_does_not_need():
    """A look is a handful of cycles, so a person is not kept waiting."""
    bench = Bench()
    began = int(bench.virtual.memory["timing"]["cycle"])
    bench.session.look(0)
    assert int(bench.virtual.memory["timing"]["cycle"]) - began <= 8
