"""The page of `rtarm view` without a browser: geometry, figures, words, and what it reads."""

from __future__ import annotations

import asyncio
import dataclasses
import io
import math
import string
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import Result
from written_arm import JOINTS, WrittenArm

from config.kinematics import Origin, joint_origins, link_poses, matrix
from config.loader import load_arm
from motion.segment import evaluate, quintic
from rtarm.console.errors import Refusal
from rtarm.moveit.robot import model_parts
from rtarm.moveit.shapes import link_shapes
from rtarm.recording.playback import Playback
from rtarm.running import requests
from rtarm.running.status import report_of
from rtarm.top.events import Happening
from rtarm.top.watch import Look
from rtarm.view.history import COLUMN_NS, COLUMNS, History
from rtarm.view.limits import Side, nearness, share
from rtarm.view.orders import GENTLY, SHORTEST_S, Orders, duration_s
from rtarm.view.page import Controls, _number, marks
from rtarm.view.panels import (
    Answered,
    answer_html,
    degrees,
    events_html,
    joints_html,
    machine_html,
    problems_html,
    state_html,
)
from rtarm.view.path import POINTS, GoalPath, sampled, thinned
from rtarm.view.scene import BROKEN, NEAR, body, quaternion
from rtarm.view.source import LiveArm, RecordedArm
from rtarm.view.words import CHINESE, ENGLISH, WORDS
from shm import files, layout
from shm.client import CommandWriter, StateReader
from shm.files import Bus
from shm.recording import Recording, record_dtype
from shm.words import Entry, Fault, Mode

EPISODE1 = load_arm("episode1", overrides={"bus": {"channel": "simulated"}})
TWO_JOINTS = EPISODE1.model_copy(
    update={
        "name": "two",
        "kinematics": None,
        "joints": [
            joint.model_copy(update={"name": name}) for joint, name in zip(EPISODE1.joints, JOINTS, strict=False)
        ],
    }
)
positions = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


# --- geometry -------------------------------------------------------------------------------------------


def turned(wxyz: tuple[float, ...]) -> np.ndarray:
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def placed(positions_rad: np.ndarray) -> list[np.ndarray]:
    """Where a browser puts the base and the links of episode1, from shifts and quaternions."""
    kinematics = EPISODE1.kinematics
    assert kinematics is not None
    pose = np.eye(4)
    poses = [pose]
    for origin, row, angle in zip(joint_origins(kinematics), kinematics.dh, positions_rad, strict=True):
        step = np.eye(4)
        step[:3, :3] = turned(quaternion(origin, row.sign * float(angle)))
        step[:3, 3] = origin.xyz_m
        pose = pose @ step
        poses.append(pose)
    return poses


@given(positions)
def test_links_stand_where_the_kinematics_say(positions_rad: np.ndarray) -> None:
    assert EPISODE1.kinematics is not None
    assert np.allclose(placed(positions_rad), link_poses(EPISODE1.kinematics, positions_rad), atol=1e-12)


@given(st.tuples(*[st.floats(-math.pi, math.pi)] * 3))
def test_a_quaternion_is_the_turn_of_its_origin(rpy_rad: tuple[float, float, float]) -> None:
    origin = Origin(rpy_rad=rpy_rad)
    assert np.allclose(turned(quaternion(origin)), matrix(origin)[:3, :3], atol=1e-12)


@settings(max_examples=examples(10), deadline=None)
@given(positions)
def test_the_arm_fills_the_same_space_as_its_urdf(positions_rad: np.ndarray) -> None:
    """As somebody else's reader of robot models has it, of the model that is generated for MoveIt and RViz."""
    yourdfpy = pytest.importorskip("yourdfpy")
    kinematics = EPISODE1.kinematics
    assert kinematics is not None
    urdf = yourdfpy.URDF.load(
        io.StringIO(model_parts(EPISODE1, kinematics)),
        build_collision_scene_graph=True,
        load_collision_meshes=True,
        force_collision_mesh=False,
    )
    urdf.update_cfg({joint.name: at for joint, at in zip(EPISODE1.joints, positions_rad, strict=True)})
    ours = [
        body(link).apply_transform(pose)
        for link, pose in zip(link_shapes(kinematics), placed(positions_rad), strict=True)
    ]
    corners = np.stack([mesh.bounds for mesh in ours])
    found = np.array([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])
    # Spheres and cylinders are made of flat faces, other ones there than here.
    assert np.allclose(found, urdf.collision_scene.bounds, atol=0.002)


# --- limits and durations -------------------------------------------------------------------------------


def test_a_joint_is_near_a_limit_within_a_twentieth_of_its_range() -> None:
    joint = EPISODE1.joints[4]  # -110° to 110°
    assert nearness(joint, math.radians(98.9)) is None
    upper, lower = nearness(joint, math.radians(99.1)), nearness(joint, math.radians(-108.0))
    assert upper is not None and upper.side is Side.UPPER and upper.distance_deg == pytest.approx(10.9)
    assert lower is not None and lower.side is Side.LOWER and lower.limit_deg == -110.0
    beyond = nearness(joint, math.radians(-110.5))
    assert beyond is not None and beyond.side is Side.BEYOND and beyond.distance_deg == pytest.approx(0.5)
    assert nearness(joint, None) is None and nearness(joint, math.nan) is None


@given(st.floats(-1e3, 1e3))
def test_a_place_in_its_range_is_never_outside_the_bar(position_rad: float) -> None:
    assert 0.0 <= share(EPISODE1.joints[0], position_rad) <= 1.0


@given(positions, positions)
def test_a_motion_keeps_to_its_share_of_every_limit(from_rad: np.ndarray, to_rad: np.ndarray) -> None:
    takes_s = duration_s(EPISODE1, from_rad, to_rad)
    assert takes_s >= SHORTEST_S
    for joint, start, end in zip(EPISODE1.joints, from_rad, to_rad, strict=True):
        times_s = np.linspace(0.0, takes_s, 200)
        _, velocities, accelerations = evaluate(*quintic(start, 0.0, 0.0, end, 0.0, 0.0, takes_s), times_s)
        assert np.abs(velocities).max() <= GENTLY * joint.max_velocity_rad_s * (1 + 1e-9)
        assert np.abs(accelerations).max() <= GENTLY * joint.max_acceleration_rad_s2 * (1 + 1e-9)


@pytest.mark.parametrize(
    ("sent", "taken"), [(12.5, 12.5), (200, 90.0), (-1e300, -90.0), (math.nan, -90.0), ("x", -90.0), (None, -90.0)]
)
def test_whatever_a_browser_sends_is_a_number_within_its_limits(sent: Any, taken: float) -> None:
    assert _number(sent, -90.0, 90.0) == taken


# --- plots ----------------------------------------------------------------------------------------------


def cycles(first_ns: int, count: int, period_ns: int = 10_000_000) -> np.ndarray:
    """Cycles of a two-joint arm that holds and was read in each of them."""
    records = np.zeros(count, record_dtype(2))
    records["mode"] = Mode.HOLDING
    records["monotonic_ns"] = first_ns + period_ns * np.arange(count)
    records["joints"]["measured_ns"] = records["monotonic_ns"][:, None]
    return records


def test_no_late_cycle_and_no_error_is_lost_between_two_points_of_a_plot() -> None:
    history = History(2)
    records = cycles(0, 200)
    records["lateness_ns"][57] = 3_000_000
    records["joints"]["measured_position_rad"][57, 1] = -0.1
    for part in np.split(records, [3, 55, 58, 61]):
        history.add(part)
    history.add(records[:0])
    curves = history.curves()
    assert curves.times_s.tolist() == pytest.approx([0.1 * (number - 19) for number in range(20)])
    assert curves.lateness_us.tolist() == [3000.0 if number == 5 else 0.0 for number in range(20)]
    assert curves.error_deg[:, 1].tolist() == pytest.approx(
        [math.degrees(-0.1) if number == 5 else 0.0 for number in range(20)]
    )
    assert not curves.measured_deg.any()


def test_an_arm_that_is_brought_up_has_no_error_before_it_is_commanded_anywhere() -> None:
    history = History(2)
    records = cycles(0, 20)
    records["mode"][:10] = Mode.BRINGING_UP
    records["joints"]["measured_position_rad"] = 1.0
    records["joints"]["reference_position_rad"][10:] = 1.0
    history.add(records)
    assert not history.curves().error_deg.any()


def test_plots_go_back_half_a_minute_and_a_joint_that_was_never_read_is_a_gap() -> None:
    history = History(2)
    records = cycles(0, 2 * COLUMNS, COLUMN_NS)
    records["joints"]["measured_ns"][:, 0] = 0
    history.add(records)
    curves = history.curves()
    assert len(curves.times_s) == COLUMNS and curves.times_s[0] == pytest.approx(-29.9)
    assert np.isnan(curves.measured_deg[:, 0]).all() and not np.isnan(curves.measured_deg[:, 1]).any()
    history.add(cycles(0, 1))
    assert len(history.curves().times_s) == 1, "time that goes back is another story"


# --- the path -------------------------------------------------------------------------------------------


@given(st.sampled_from([1, 3, 5]), st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3))
def test_a_path_goes_through_its_waypoints(order: int, angles: list[float]) -> None:
    waypoints = {
        number * 1_000_000_000: (order, np.array([[angle, 0.0, 0.0]] * 2)) for number, angle in enumerate(angles)
    }
    path = sampled(waypoints, 2)
    assert path.shape == (POINTS, 2)
    assert path[0, 0] == pytest.approx(angles[0]) and path[-1, 1] == pytest.approx(angles[2])
    assert np.abs(path[:, 0] - angles[1]).min() <= 0.02 * max(1.0, np.ptp(angles))


def test_the_path_of_a_goal_comes_from_the_ring_of_waypoints(arm: WrittenArm) -> None:
    path = GoalPath(arm.name, len(JOINTS))
    start = np.full((2, 3), [0.5, 0.0, 0.0])
    writer = CommandWriter(files.open_command(arm.name))
    try:
        tolerances = np.zeros((2, 3))
        writer.begin(
            4, start_ns=0, joint_mask=3, goal_time_s=0.0, entry=Entry(0), epoch=0, tolerances=tolerances, consumed=0
        )
        assert len(path.of(4, start)) == 0
        writer.waypoint(4, 2_000_000_000, 5, np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), 0)
        writer.end(4, tolerances, 0)
        found = path.of(4, start)
        assert found[0].tolist() == [0.5, 0.5], "a single point is gone to from where the arm was"
        assert found[-1].tolist() == pytest.approx([1.0, -1.0])
        assert path.of(4, start) is found, "nothing came, so nothing is drawn anew"
        arm.command["setpoints"][1]["time_ns"] = 1  # a record that is just being written
        assert len(path.of(0, start)) == 0 and len(path.of(5, start)) == 0
        assert len(path.of(4, start)) == 0
    finally:
        writer.close()
        path.close()


@given(st.integers(0, 5 * POINTS))
def test_thinning_keeps_both_ends(count: int) -> None:
    points = np.arange(count, dtype=float)[:, None]
    kept = thinned(points)
    assert len(kept) == min(count, POINTS)
    assert count == 0 or (kept[0] == 0 and kept[-1] == count - 1)


# --- panels and words -----------------------------------------------------------------------------------


def look_of(arm: WrittenArm, **changes: Any) -> Look:
    with closing(StateReader(files.open_state(arm.name))) as reader:
        report = report_of(arm.name, reader)
    return Look(arm.name, report=report | changes, recent=report, recent_s=1.0)


def test_everything_from_outside_is_escaped(arm: WrittenArm) -> None:
    evil = "<script>alert('1')</script>"
    look = look_of(arm, problems=[evil], mode=evil, healthy=False)
    assert look.report is not None
    look.report["last_result"] = {"goal_id": 1, "outcome": "x", "sentence": evil}
    look.report["joints"][0]["drive_trouble"] = [evil]
    look = dataclasses.replace(look, happenings=[Happening(1, evil)])
    for words in (ENGLISH, CHINESE):
        pages = [
            state_html(look, words),
            state_html(dataclasses.replace(look, trouble=evil), words),
            problems_html(look, TWO_JOINTS, words),
            joints_html(look, TWO_JOINTS, words),
            events_html(look, words),
            machine_html(look, words),
        ]
        assert sum("&lt;script&gt;" in page for page in pages) == 5
        assert not any("<script" in page for page in pages)


def test_a_held_arm_is_not_called_ready_to_move(arm: WrittenArm) -> None:
    arm.snapshot["held"] = 1
    arm.publish()
    shown = state_html(look_of(arm), ENGLISH)
    assert ">held<" in shown and ENGLISH.held_tag in shown and ENGLISH.fit not in shown


def test_an_answer_says_when_and_shows_commands_as_such() -> None:
    shown = answer_html([Answered(1000.0, "It stands; `rtarm resume` <lets> it go on.", True)])
    clock = time.strftime("%H:%M:%S", time.localtime(1000.0))
    assert clock in shown and "<code>rtarm resume</code> &lt;lets&gt;" in shown and "`" not in shown


def test_the_joint_that_the_fault_names_and_one_near_its_limit_are_marked(arm: WrittenArm) -> None:
    arm.rows["measured_position_rad"][1] = TWO_JOINTS.joints[1].upper_rad - 0.01
    arm.snapshot["fault"], arm.snapshot["fault_joint"] = Fault.FOLLOWING_ERROR, 0
    arm.publish()
    look = look_of(arm)
    assert look.report is not None
    assert marks(look.report, TWO_JOINTS) == [BROKEN, NEAR]
    assert f"elbow is 0.6° from its upper limit ({TWO_JOINTS.joints[1].upper_deg:g}°)" in joints_html(
        look, TWO_JOINTS, ENGLISH
    )
    problems = problems_html(look, TWO_JOINTS, ENGLISH)
    assert "clear-fault" in problems and ENGLISH.no_geometry in problems


def test_angles_are_never_minus_nothing() -> None:
    assert (degrees(-1e-9, 2), degrees(None, 2), degrees(math.pi, 1)) == ("0.00", "-", "180.0")


def test_both_languages_say_the_same_things() -> None:
    def fields(text: str) -> set[str | None]:
        return {name for _, name, _, _ in string.Formatter().parse(text)} - {None}

    for field in dataclasses.fields(ENGLISH):
        one, other = getattr(ENGLISH, field.name), getattr(CHINESE, field.name)
        assert other and fields(one) == fields(other), field.name
    assert {language: words.language for language, words in WORDS.items()} == {"en": "en", "zh": "zh"}


# --- sources --------------------------------------------------------------------------------------------


def test_an_arm_that_does_not_run_has_no_page(
    rtarm: Callable[..., Result], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(files, "DIRECTORY", tmp_path)  # on this machine somebody's may run
    result = rtarm("view", "mock")
    assert result.exit_code == 1 and "start it with `rtarm up` and the name" in result.stderr


def test_an_arm_whose_file_cannot_be_known_from_its_name_needs_it(
    rtarm: Callable[..., Result], arm: WrittenArm
) -> None:
    result = rtarm("view", arm.name)
    assert result.exit_code == 1 and f"`rtarm view ./{arm.name}.yaml`" in result.stderr


def test_another_arm_of_the_same_name_is_not_drawn(arm: WrittenArm) -> None:
    with closing(LiveArm(EPISODE1.model_copy(update={"name": arm.name}))) as source:
        look = source.look()
        assert look.report is None and look.trouble is not None
        assert "shoulder, elbow" in look.trouble and "start `rtarm view` again" in look.trouble
        assert len(source.cycles()) == 0 and len(source.path()) == 0


@pytest.fixture
def recording() -> Iterator[Recording]:
    """Two seconds of a two-joint arm, with a goal in its second half."""
    records = cycles(5_000_000_000, 200)
    records["cycle"] = np.arange(200)
    records["goal_id"][100:] = 3
    records["joints"]["commanded_position_rad"][100:] = np.linspace(0.0, 1.0, 100)[:, None]
    yield Recording(
        arm="two",
        joints=JOINTS,
        arm_hash=7,
        pid=1,
        period_ns=10_000_000,
        buses=(Bus("", 500_000),),
        records=records,
        frames=np.zeros(0, layout.BusFrame.dtype),
        events=np.zeros(0, layout.Event.dtype),
        limits=np.zeros((), layout.Limits.dtype),
        identifiers=np.zeros(0, layout.Identifiers.dtype),
        scheduling=np.zeros((), layout.Scheduling.dtype),
        lateness=np.zeros((), layout.Histogram.dtype),
        cycle_time=np.zeros((), layout.Histogram.dtype),
    )


def test_a_recording_stands_behind_the_page_like_an_arm(recording: Recording) -> None:
    now_ns = 0
    source = RecordedArm(recording, Playback(recording, 2.0, lambda: now_ns))
    assert source.joints == JOINTS
    assert len(source.cycles()) == 1 and len(source.path()) == 0
    now_ns = 300_000_000  # 0.6 s of the recording
    assert source.cycles()["cycle"].tolist() == list(range(1, 61))
    assert source.look().report is not None and len(source.path()) == 0
    now_ns = 600_000_000
    source.cycles()
    path = source.path()
    assert path[0, 0] == 0.0 and path[-1, 0] == 1.0, "what is still to come is known"
    now_ns = 10_000_000_000
    assert source.cycles()[-1]["cycle"] == 199 and len(source.cycles()) == 0
    look = source.look()
    assert look.report is not None and look.report["problems"][0].startswith("The recording ends here")
    assert state_html(look, ENGLISH) and joints_html(look, TWO_JOINTS, ENGLISH) and machine_html(look, CHINESE)
    source.close()


def test_only_the_joints_whose_sliders_were_touched_are_a_wish(monkeypatch: pytest.MonkeyPatch) -> None:
    """Touched amid somebody's goal: the other joints are not taken back to where they were then."""
    viser = pytest.importorskip("viser")
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        orders = Orders(EPISODE1, ENGLISH)
        sent: list[np.ndarray] = []
        monkeypatch.setattr(orders, "go", lambda target_rad, _: str(sent.append(target_rad)))
        controls = Controls(server, EPISODE1, orders, ENGLISH, None)
        controls.add_sliders()
        controls.follow(np.zeros(6), 1.0)
        touched: Any = SimpleNamespace(client_id=1, target=SimpleNamespace(value=30.0))
        controls._slider_moved(2, touched)
        controls.follow(np.full(6, 0.1), 1.0)
        controls._go_there(object())
        assert np.allclose(sent, [[0.1, 0.1, math.radians(30.0), 0.1, 0.1, 0.1]])
        assert [round(slider.value, 1) for slider in controls._sliders[:2]] == [5.7, 5.7]
        controls._forget()
        with pytest.raises(Refusal):
            controls._go_there(object())
    finally:
        server.stop()


def test_a_wish_is_known_before_a_press_that_comes_behind_it() -> None:
    """With all threads for callbacks busy, as on a loaded machine: a press would go to what was wished before."""
    viser = pytest.importorskip("viser")
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    busy = threading.Event()
    try:
        controls = Controls(server, EPISODE1, Orders(EPISODE1, ENGLISH), ENGLISH, None)
        controls.add_sliders()
        controls.follow(np.zeros(6), 1.0)
        pool = server.gui._thread_executor
        for _ in range(pool._max_workers):
            pool.submit(busy.wait, 60.0)
        slider = controls._sliders[2]
        moved = viser._messages.GuiUpdateMessage(slider._impl.uuid, {"value": 30.0})
        server._connected_clients[1] = SimpleNamespace(client_id=1)
        server.gui._resolve_client = lambda _: server._connected_clients[1]
        read = asyncio.run_coroutine_threadsafe(server.gui._handle_gui_updates(1, moved), server.gui._event_loop)
        read.result(60.0)
        assert controls._wished_rad == {2: math.radians(30.0)}
    finally:
        busy.set()
        server._connected_clients.clear()
        server.stop()


def test_a_goal_whose_sender_was_still_starting_when_stop_was_pressed_is_not_sent(
    arm: WrittenArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = EPISODE1.model_copy(update={"name": arm.name, "joints": EPISODE1.joints[: len(JOINTS)]})
    for press in ("stop", "stop_again"):
        orders = Orders(config, ENGLISH)
        sent: list[Any] = []
        sender = SimpleNamespace(send=sent.append, cancel=lambda: None, alive=True)

        def starts(orders: Orders = orders, press: str = press, sender: Any = sender) -> Any:
            getattr(orders, press)()
            return sender

        monkeypatch.setattr(requests, "stop", lambda *_: "The arm stands.")
        monkeypatch.setattr(orders._senders, "ready", starts)
        with pytest.raises(Refusal, match="A person has stopped or holds the arm"):
            orders.go(np.zeros(len(JOINTS)), lambda _: None)
        assert not sent


class Meeting:
    """A lock that two threads pass once each before either goes on, which finds out who looks and acts in two steps."""

    def __init__(self) -> None:
        self._lock, self._both, self._mine = threading.RLock(), threading.Barrier(2), threading.local()

    def __enter__(self) -> None:
        self._lock.acquire()
        self._mine.depth = getattr(self._mine, "depth", 0) + 1

    def __exit__(self, *_: object) -> None:
        self._mine.depth -= 1
        self._lock.release()
        if self._mine.depth == 0 and not hasattr(self._mine, "met"):
            self._mine.met = True
            self._both.wait(30.0)


def test_of_presses_at_the_same_moment_each_reaches_the_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever threads they come in: one is the first, and the other finds it under way."""
    viser = pytest.importorskip("viser")
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        orders = Orders(EPISODE1, ENGLISH)
        again = threading.Event()
        monkeypatch.setattr(orders, "hold_again", again.set)

        def hold() -> str:
            assert again.wait(5.0)
            return "The arm stands."

        monkeypatch.setattr(orders, "hold", hold)
        controls = Controls(server, EPISODE1, orders, ENGLISH, None)
        monkeypatch.setattr(controls, "_lock", Meeting())
        [press] = controls._hold._impl.update_cb
        threads = [threading.Thread(target=press, args=(None,)) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert "The arm stands." in controls._answer.content
    finally:
        server.stop()


@pytest.mark.parametrize("halt", ["stop", "hold"])
def test_every_press_of_stop_and_hold_reaches_the_arm_also_while_an_earlier_one_waits(
    halt: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    viser = pytest.importorskip("viser")
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        orders = Orders(EPISODE1, ENGLISH)
        waits, stands = threading.Event(), threading.Event()
        pressed: list[str] = []

        def order() -> str:
            pressed.append("first")
            waits.set()
            assert stands.wait(30.0)
            return "The arm stands."

        monkeypatch.setattr(orders, halt, order)
        monkeypatch.setattr(orders, f"{halt}_again", lambda: pressed.append("again"))
        controls = Controls(server, EPISODE1, orders, ENGLISH, None)
        [press] = getattr(controls, f"_{halt}")._impl.update_cb
        first = threading.Thread(target=press, args=(None,))
        first.start()
        assert waits.wait(30.0)
        for _ in range(3):
            press(None)
        assert pressed == ["first", "again", "again", "again"]
        stands.set()
        first.join()
        assert "The arm stands." in controls._answer.content
        press(None)
        assert pressed[-1] == "first"
    finally:
        server.stop()
