"""What every simulated drive must do, whatever its family: by its frames and by where its shaft truly was.

A family is a row in `simulated_families`.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from depth import examples
from drive_bench import MILLISECOND, frame, text
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_families import FAMILIES, SILENCE_MS, TOP, Family, FamilyBench

from config.loader import load_arm
from sim.bus import Frame
from sim.drives import families
from sim.drives.drive import Mounting

CAUSES = ("stall", "temperature", "current")
HERE = 0.25
"""Where drives stand that were not just put at their zero [rev]."""
REST_MS = 2000
"""In which every row's shaft has come to rest."""
WAITING = 100
"""Requests that come faster than answers leave."""

Make = Callable[[int], Family]


def each(has: Callable[[Family], object] = lambda family: True) -> pytest.MarkDecorator:
    """Each family in turn that has something."""
    return pytest.mark.parametrize("make", [make for make in FAMILIES if has(make(1))], ids=lambda make: make.__name__)


@pytest.fixture(params=FAMILIES, ids=lambda make: make.__name__)
def make(request: pytest.FixtureRequest) -> Make:
    """Each family in turn."""
    return request.param


@pytest.fixture
def family(make: Make) -> Family:
    """Its drive number 1."""
    return make(1)


@pytest.fixture
def other(make: Make) -> Family:
    """Its drive number 2."""
    return make(2)


def holding(family: Family, turns: float = 0.0, **options: object) -> FamilyBench:
    """A drive that holds where it stands."""
    return FamilyBench(family, turns, **options).enable()


def underway(family: Family) -> FamilyBench:
    """A drive that has gone half of the way to 1."""
    bench = holding(family).tell(*family.go(1.0))
    while bench.turns < 0.5:
        bench.wait(1)
    assert bench.turns_s > 0.0
    return bench


def stands(bench: FamilyBench, milliseconds: float = 1000.0) -> bool:
    """Whether its shaft does not move in some time."""
    before, since_ns = bench.turns, bench.now_ns
    bench.wait(milliseconds)
    return bool(np.all(np.abs(bench.motion(since_ns)[0] - before) <= 1e-6))


# --- power and enabling -----------------------------------------------------------------------------------


def test_power_comes_to_a_drive_that_moves_nothing_says_so_and_counts_from_there(family: Family) -> None:
    bench = holding(family, HERE)
    assert bench.where == pytest.approx(HERE, abs=1e-4)
    bench.drive.protect(bench.now_ns, "current")
    bench.tell(family.where[0]).drive.power_off(bench.now_ns)
    assert (bench.drive.powered, bench.drive.listening, bench.drive.limp) == (False, False, True)
    assert bench.wait(500) == [], "what was ready is never sent"
    bench.drive.power_on(bench.now_ns)
    bench.wait(family.boots_ms)
    assert (bench.drive.powered, bench.drive.listening) == (True, True)
    assert bench.status == family.says["power"], "and errors end"
    assert bench.drive.enabled == family.holds_at_power == (not bench.drive.limp)
    assert bench.where == pytest.approx(0.0, abs=1e-6)
    assert stands(bench) and bench.turns == HERE
    bench.enable().tell(*family.go(0.5))
    assert bench.after(2500).turns == pytest.approx(HERE + 0.5, abs=family.within)


@each(lambda family: family.knows_its_angle)
def test_an_encoder_that_knows_its_angle_does_when_power_comes(family: Family) -> None:
    bench = holding(family, HERE, **family.knows_its_angle)
    bench.restart()
    assert bench.where == pytest.approx(HERE, abs=1e-4)
    assert stands(bench.enable())


@each(lambda family: family.volatile)
def test_what_is_not_stored_ends_with_the_power(family: Family) -> None:
    write, read, answer = family.volatile
    bench = FamilyBench(family)
    assert bench.ask(read) == [answer]
    bench.tell(write)
    assert bench.ask(read) != [answer]
    bench.restart()
    assert bench.ask(read) == [answer]


def test_enabling_moves_nothing_and_is_said(family: Family) -> None:
    bench = FamilyBench(family, HERE).tell(*family.let_go)
    assert bench.after(10).status == family.says["limp"]
    assert (bench.drive.enabled, bench.drive.limp) == (False, True)
    assert stands(bench.enable())
    assert bench.status == family.says["holding"]
    assert (bench.drive.enabled, bench.drive.limp) == (True, False)


def test_a_limp_drive_goes_nowhere_before_it_is_enabled(family: Family) -> None:
    bench = FamilyBench(family).tell(*family.let_go, *family.go(1.0))
    if not family.obeys_limp:
        assert stands(bench) and bench.status == family.says["limp"]
        if not family.keeps_target:
            assert stands(bench.enable())
            return
        *prepare, _, _, enable = family.enable(0.0)
        bench.tell(*prepare, *family.go(1.0), enable)
    assert bench.after(2500).drive.enabled and bench.turns == pytest.approx(1.0, abs=family.within)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("homed", [True, False])
def test_a_joints_drive_counts_what_the_arm_sees_or_from_where_it_was_switched_on(
    family: Family, direction: int, homed: bool
) -> None:
    joint = load_arm(family.arm).joints[0]
    config = joint.drive
    if hasattr(config, "encoder"):
        config = config.model_copy(update={"encoder": "motor_side"})
    joint = joint.model_copy(update={"direction": direction, "drive": config})
    drive = families.FAMILIES[config.family](
        Mounting(joint, 500_000, start_ns=0, position_rad=0.1, homed=homed, seed=1, **family.mounted)
    )
    bench = FamilyBench(replace(family, make=lambda _: drive, where=family.where_mounted or family.where))
    turns = direction * (0.1 + joint.zero_rad) * joint.ratio / (2 * np.pi)
    assert bench.turns == pytest.approx(turns, abs=2e-4)
    off = bench.where - (turns if homed else 0.0)
    assert (math.remainder(off, 1.0) if family.where_mounted else off) == pytest.approx(0.0, abs=2e-4)


# --- motion -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turns", [1.25, -1.25])
def test_a_target_is_reached_and_no_limit_passed_on_the_way(family: Family, turns: float) -> None:
    bench = holding(family).tell(*family.go(turns)).after(4000)
    positions, speeds = bench.motion()
    assert bench.turns == pytest.approx(turns, abs=family.within)
    assert bench.where == pytest.approx(bench.turns, abs=1e-4)
    assert bench.rests and bench.status == family.says["holding"]
    assert abs(positions - turns / 2).max() <= abs(turns) / 2 + family.within + family.overshoots
    if not family.overshoots:
        assert np.abs(speeds).max() == pytest.approx(TOP, rel=1e-3)
        assert (speeds * turns).min() >= -1e-3
    if family.climbs:
        climbed_s = np.argmax(np.abs(speeds) >= 0.999 * TOP) * 0.25e-3
        assert climbed_s == pytest.approx(TOP / family.climbs, rel=0.03)


@each()
@settings(max_examples=examples(10), deadline=None)
@given(st.lists(st.tuples(st.floats(-1.5, 1.5), st.integers(0, 700)), min_size=1, max_size=5))
def test_of_many_targets_the_last_is_where_it_ends(make: Make, targets: list[tuple[float, int]]) -> None:
    family = make(1)
    bench = holding(family)
    for turns, pause_ms in targets:
        bench.tell(*family.go(turns)).wait(pause_ms)
    bench.wait(8000)
    # Whole pulses or counts are the finest that is told.
    assert bench.turns == pytest.approx(targets[-1][0], abs=family.within + 0.5 / 3200)
    assert bench.rests
    _, speeds = bench.motion()
    if not family.overshoots:
        assert np.abs(speeds).max() <= TOP * (1 + 1e-3)


@each(lambda family: family.reals)
def test_a_target_that_is_no_number_changes_nothing(family: Family) -> None:
    bench = holding(family, HERE)
    bench.tell(*family.go(bench.where))
    for target in (math.nan, math.inf, -math.inf):
        bench.tell(*family.go(target))
        assert stands(bench, 50)
    assert bench.tell(*family.go(0.5)).after(2000).turns == pytest.approx(0.5, abs=family.within)


def test_told_to_stop_it_brakes_and_goes_on_holding(family: Family) -> None:
    bench = underway(family)
    assert bench.tell(*family.stop).after(family.brakes_s * 1e3).rests and bench.turns < 1.0
    assert stands(bench)
    assert bench.drive.enabled and bench.status == family.says["holding"]
    assert bench.tell(*family.go(0.0)).after(3000).turns == pytest.approx(0.0, abs=family.within)


@pytest.mark.parametrize("how", ["told", "beside", "power"])
def test_let_go_it_coasts_and_counts_and_holds_where_it_is_when_it_is_enabled(family: Family, how: str) -> None:
    bench = underway(family)
    speed, since_ns = bench.turns_s, bench.now_ns
    match how:
        case "told":
            bench.tell(*family.let_go)
        case "beside":
            bench.drive.disable(bench.now_ns)
        case "power":
            bench.drive.power_off(bench.now_ns)
    assert bench.drive.limp
    bench.wait(REST_MS)
    positions, speeds = bench.motion(since_ns)
    assert speeds[0] <= speed and np.all(np.diff(speeds) <= 0.0) and bench.rests
    assert positions[-1] - positions[0] == pytest.approx(speed**2 / 2 / family.coasts, rel=0.03)
    if how == "power":
        bench.restart()
        assert stands(bench) and bench.where == pytest.approx(0.0, abs=1e-6)
    else:
        assert bench.status == family.says["limp"] and not bench.drive.enabled
        assert bench.where == pytest.approx(positions[-1], abs=1e-4)
    assert stands(bench.enable())


def test_a_hand_leads_a_limp_shaft_and_the_drive_counts_it(family: Family) -> None:
    bench = FamilyBench(family).tell(*family.let_go).after(1)
    bench.drive.lead(bench.now_ns, 0.5)
    assert bench.after(1000).turns == pytest.approx(0.5, abs=1e-3)
    assert bench.where == pytest.approx(bench.turns, abs=1e-4)
    bench.drive.lead(bench.now_ns, 0.0)
    assert bench.after(10).status == family.says["limp"]
    assert stands(bench.enable())


@each(lambda family: family.zero)
def test_zero_is_set_where_it_stands_and_moves_nothing(family: Family) -> None:
    bench = FamilyBench(family, HERE, **(family.knows_its_angle or {})).tell(*family.let_go, *family.zero)
    bench.wait(family.zeroes_ms)
    bench.heard()
    assert bench.where == pytest.approx(0.0, abs=2e-4)
    assert stands(bench) and stands(bench.enable())
    assert bench.tell(*family.go(0.5)).after(2500).turns == pytest.approx(HERE + 0.5, abs=family.within)


# --- silence, errors, and what else goes wrong --------------------------------------------------------------


def watched(family: Family) -> FamilyBench:
    """A drive under way whose watchdog is on."""
    bench = holding(family, **family.watched).tell(*family.watch, *family.go(1.4))
    bench.heard()
    return bench


@each(lambda family: family.feed)
def test_the_watchdog_stops_a_drive_whose_host_is_silent(family: Family) -> None:
    bench = watched(family)
    for _ in range(6):
        bench.wait(SILENCE_MS - 10)
        bench.tell(family.feed)
        assert not bench.drive.limp and bench.turns_s != 0.0
    bench.wait(SILENCE_MS - 5)
    assert not bench.drive.limp and bench.turns_s != 0.0
    bench.wait(10)
    ends_limp = family.says["silence"] != family.says["holding"]
    assert bench.drive.limp == ends_limp and bench.drive.enabled != ends_limp
    assert bench.status == family.says["silence"]
    assert bench.after(REST_MS).rests and (bench.turns < 1.4 or family.overshoots)


@each(lambda family: family.feed)
def test_frames_of_others_do_not_satisfy_the_watchdog(family: Family, other: Family) -> None:
    bench = watched(family)
    for _ in range(4):
        bench.wait(SILENCE_MS / 2)
        bench.tell(*(text for text in (other.feed, family.feeds_not) if text and text != family.feed))
    assert bench.status == family.says["silence"]


@pytest.mark.parametrize("cause", CAUSES)
def test_an_error_lets_go_is_said_and_ends_by_being_cleared_alone(family: Family, cause: str) -> None:
    bench = underway(family)
    bench.drive.protect(bench.now_ns, cause)
    bench.drive.cause_lasts = True
    assert bench.drive.limp and bench.turns_s > 0.0, "it coasts"
    assert bench.after(REST_MS).rests
    assert bench.status == family.says[cause]
    bench.tell(*family.clear)
    assert bench.after(family.clears_ms).status == family.says[cause], "what caused it lasts"
    bench.drive.cause_lasts = False
    if cause not in family.ends_by_itself:
        bench.tell(*family.let_go, *family.enable(bench.where), *family.go(0.0), *family.stop)
        assert stands(bench)
        assert bench.status == family.says[cause], "nothing of that clears it"
        bench.tell(*family.clear)
    bench.wait(family.clears_ms)
    bench.tell(*family.let_go)
    bench.heard()
    assert bench.status == family.says["limp"]
    assert stands(bench) and stands(bench.enable())
    assert bench.status == family.says["holding"]


def test_a_held_shaft_stands_and_is_told_where(family: Family) -> None:
    bench = underway(family)
    bench.drive.block_shaft(bench.now_ns)
    held = bench.turns
    for _ in range(10):
        assert bench.rests and stands(bench, 20)
    assert bench.where == pytest.approx(held, abs=1e-4)
    assert bench.drive.enabled, "it pushes"


def test_unplugged_it_neither_hears_nor_speaks_and_carries_on(family: Family) -> None:
    bench = underway(family)
    bench.tell(family.where[0])
    bench.drive.unplug(bench.now_ns)
    assert (bench.drive.listening, bench.heard()) == (False, []), "what was ready is never sent"
    assert bench.wait(3000) == []
    assert bench.turns == pytest.approx(1.0, abs=family.within)
    bench.drive.plug_in(bench.now_ns)
    assert bench.drive.listening and bench.where == pytest.approx(bench.turns, abs=1e-4)
    bench.drive.unplug(bench.now_ns)
    bench.restart()
    assert (bench.drive.listening, bench.heard()) == (False, []), "power puts no plug in"


@each(lambda family: family.volts or family.celsius)
def test_what_it_measures_is_told(family: Family) -> None:
    bench = FamilyBench(family)
    bench.drive.supply_v, bench.drive.celsius = 23.5, 41.0
    assert family.volts is None or bench.number(family.volts) == 23.5
    assert family.celsius is None or bench.number(family.celsius) == 41.0


# --- frames -------------------------------------------------------------------------------------------------


def of_another_kind(whole: Frame) -> Frame:
    """A standard frame of an extended one, and the other way round."""
    return whole._replace(extended=not whole.extended)


def test_frames_for_another_drive_and_of_another_kind_change_nothing(family: Family, other: Family) -> None:
    own, others = ([frame(text_) for text_ in (*one.commands, one.where[0])] for one in (family, other))
    for limp in (False, True):
        bench = holding(family, HERE)
        if limp:
            bench.tell(*family.let_go)
            bench.heard()
        before, state = bench.where, bench.status
        for whole in (*others, *map(of_another_kind, own), *(one._replace(remote=True) for one in own[:-1])):
            assert bench.ask(whole) == [], text(whole)
        assert stands(bench)
        assert (bench.where, bench.status) == (before, state)


def test_frames_that_are_cut_off_are_no_commands(family: Family) -> None:
    bench = holding(family)
    if not family.obeys_limp:
        bench.tell(*family.let_go)
        bench.heard()
    before = bench.status
    for whole in map(frame, family.commands):
        for length in range(len(whole.data)):
            assert bench.ask(whole._replace(data=whole.data[:length])) in ([], list(family.silent)), text(whole)
    assert stands(bench) and bench.status == before


@each()
@settings(max_examples=examples(30), deadline=None)
@given(st.data())
def test_no_frames_break_it_or_make_it_jump(make: Make, data: st.DataObject) -> None:
    family = make(1)
    # Its own requests, some with other bytes, and any frames at all.
    own = [frame(text_) for text_ in (*family.commands, *family.watch, *family.zero, family.where[0])]
    changed = st.builds(
        lambda whole, at, byte: whole._replace(data=(whole.data[:at] + bytes((byte,)) + whole.data[at + 1 :])[:8]),
        st.sampled_from([whole for whole in own if whole.data]),
        st.integers(0, 7),
        st.integers(0, 255),
    )
    any_data = st.builds(lambda whole, some: whole._replace(data=some), st.sampled_from(own), st.binary(max_size=8))
    any_frame = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans(), st.booleans())
    bench = holding(family)
    for whole in data.draw(st.lists(st.one_of(st.sampled_from(own), changed, any_data, any_frame), max_size=15)):
        bench.tell(family.sealed(whole) if data.draw(st.booleans()) else whole)
        bench.wait(data.draw(st.integers(0, 50)))
    bench.motion()
    assert len(bench.drive.state_frame(bench.now_ns).data) <= 8


@each(lambda family: family.renumber)
def test_a_new_number_is_its_own_from_then_on(family: Family, other: Family) -> None:
    bench = FamilyBench(family, HERE).tell(family.renumber)
    bench.heard()
    assert bench.ask(family.where[0]) == []
    assert bench.number(other.where) == pytest.approx(HERE, abs=1e-4)


def test_it_knows_its_conversation_and_no_others(family: Family, other: Family) -> None:
    bench = holding(family)
    own = [frame(text_) for text_ in (*family.commands, family.where[0])]
    said = [frame(text_) for whole in own for text_ in bench.ask(whole)] + [frame(bench.ask(family.where[0])[0])]
    assert all(map(bench.drive.owns, own + said))
    assert not any(bench.drive.owns(frame(text_)) for text_ in (*other.commands, other.where[0]))
    assert not any(map(bench.drive.owns, map(of_another_kind, own)))


def test_others_may_repeat_its_position_or_have_its_number(family: Family) -> None:
    bench = underway(family)
    told = bench.drive.state_frame(bench.now_ns)
    assert bench.drive.owns(told) and bench.heard() == []
    assert bench.after(3).drive.state_frame(bench.now_ns) != told, "its position is in it"
    twin = FamilyBench(replace(family, make=lambda _: bench.drive.twin(bench.now_ns, 7)))
    twin.now_ns = bench.now_ns
    assert twin.where == pytest.approx(0.0, abs=2e-4)
    assert twin.ask(family.where[0])[0].partition("#")[0] == bench.ask(family.where[0])[0].partition("#")[0]


# --- time and chance ----------------------------------------------------------------------------------------


def test_answers_come_after_the_reply_delay_in_their_order_until_its_mailboxes_are_full(family: Family) -> None:
    bench = FamilyBench(family)
    least, greatest = bench.drive.reply_delay_ns
    asked = [step * 50_000 for step in range(10)]
    for now_ns in asked:
        bench.drive.receive(now_ns, frame(family.where[0]))
    ready = [ready_ns for ready_ns, _ in bench.drive.outbox]
    assert ready == sorted(ready) and ready[0] >= least
    for asked_ns, ready_ns in zip(asked, ready, strict=True):
        assert asked_ns + least <= ready_ns <= asked_ns + greatest
    for _ in range(WAITING):
        bench.drive.receive(asked[-1], frame(family.where[0]))
    assert len(bench.drive.outbox) == (family.mailboxes or len(asked) + WAITING)


def test_a_share_of_its_answers_is_lost(family: Family) -> None:
    bench = FamilyBench(family)
    for share, least, most in ((0.0, 200, 200), (0.5, 60, 140), (1.0, 0, 0)):
        bench.drive.reply_loss = share
        assert least <= sum(len(bench.ask(family.where[0])) for _ in range(200)) <= most


def life(make: Make, seed: int, steps_ns: Callable[[], int]) -> tuple[list[object], list[tuple[float, float]]]:
    """What a drive says and where its shaft is, looked at after each of the steps, and when it wants to be woken."""
    family = make(1)
    bench = FamilyBench(family, seed=seed, **family.watched)
    said: list[object] = []
    enabled = (*family.watch, *family.enable(0.0), *family.go(1.0))
    for number, told in enumerate((enabled, family.go(0.3), (family.where[0], *family.let_go), ()), 1):
        bench.tell(*told)
        while bench.now_ns < number * 377 * MILLISECOND:
            said += bench.drive.outbox
            bench.drive.outbox.clear()
            woken_ns = max(bench.drive.wake_ns, bench.now_ns)
            bench.now_ns = min(number * 377 * MILLISECOND, bench.now_ns + steps_ns(), woken_ns)
            if bench.now_ns == woken_ns:
                bench.drive.wake(bench.now_ns)
            bench.drive.advance(bench.now_ns)
    times_ns = np.arange(0, bench.now_ns, MILLISECOND)
    return said, list(zip(*bench.drive.shaft.history(times_ns), strict=True))


def hours() -> int:
    """Steps so long that only its own wishes wake the drive."""
    return 10**13


@each()
def test_how_often_time_is_looked_at_changes_nothing(make: Make) -> None:
    chance = random.Random(1)
    jumps = life(make, 1, hours)
    for _ in range(3):
        assert life(make, 1, lambda: chance.randrange(1, 5 * MILLISECOND)) == jumps


@each()
def test_the_same_seed_gives_the_same_frames_at_the_same_times_and_another_other_ones(make: Make) -> None:
    assert life(make, 1, hours) == life(make, 1, hours)
    assert life(make, 1, hours)[0] != life(make, 2, hours)[0]
