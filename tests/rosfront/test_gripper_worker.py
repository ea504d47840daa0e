"""The thread around a gripper's hook: every motion has one end, whatever the hook does."""

from __future__ import annotations

import math
import sys
import textwrap
import threading
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import until

from config.errors import ConfigError
from config.gripper import GripperConfig
from config.loader import load_arm
from motion.gripping import Grip
from rosfront.gripper import servo as servo_module
from rosfront.gripper import worker as worker_module
from rosfront.gripper.hook import GripperTrouble, NotThereYet, Reading
from rosfront.gripper.own import hook_of, load_class
from rosfront.gripper.servo import ServoGripper
from rosfront.gripper.simulated import SimulatedGripper
from rosfront.gripper.worker import End, Ended, GripperWorker, Motion
from rosfront.program import CannotServe
from rosfront.refusals import NotServing
from shm import layout
from shm.words import GripTrouble, Request

PATIENCE_S = 10.0


def config(**fields: Any) -> GripperConfig:
    return GripperConfig.model_validate({"hook": "simulated", **fields})


class Hook:
    """A gripper that jumps where it is told, and fails as told; what it was asked stands in `asked`."""

    def __init__(self) -> None:
        self.position_rad = 0.0
        self.jumps = True
        self.grip: Grip | None = None
        self.wrong: Exception | None = None
        self.asked: list[tuple[str, float]] = []
        self.pause = threading.Event()

    def move(self, position_rad: float, max_effort: float) -> None:
        self.asked.append(("move", position_rad))
        self._fail()
        if self.jumps:
            self.position_rad = position_rad

    def stop(self) -> None:
        self.asked.append(("stop", self.position_rad))
        self._fail()

    def read(self) -> Reading:
        while self.pause.is_set():
            time.sleep(0.005)
        self._fail()
        return Reading(self.position_rad, grip=self.grip)

    def home(self) -> None:
        self.asked.append(("home", self.position_rad))
        self._fail()

    def close(self) -> None:
        self.asked.append(("close", self.position_rad))

    def _fail(self) -> None:
        if self.wrong is not None:
            raise self.wrong


class Stage:
    def __init__(self, hook: Any, **fields: Any) -> None:
        self.hook = hook
        self.said: list[str] = []
        self.worker = GripperWorker(
            config(stall_time_s=0.2, **fields), lambda: hook, self.said.append, self.said.append
        )
        self.worker.start()

    def begin(self, target_rad: float | None) -> tuple[Motion, list[Any]]:
        ends: list[Any] = []
        motion = Motion(target_rad, 0.0, ends.append)
        self.worker.begin(motion)
        return motion, ends

    def go(self, target_rad: float | None) -> Any:
        return one(self.begin(target_rad)[1])


def one(ends: list[Any]) -> Any:
    until(lambda: ends, "an end")
    return ends[0]


@pytest.fixture
def stage() -> Iterator[Stage]:
    stage = Stage(Hook())
    yield stage
    stage.hook.pause.clear()
    stage.worker.close(5.0)
    assert not stage.worker.is_alive()


def test_a_motion_reaches_its_target(stage: Stage) -> None:
    end = stage.go(0.7)
    assert (end.how, end.reading.position_rad, end.succeeded) == (Ended.REACHED, 0.7, True)
    assert stage.worker.shown.grip == Grip.REACHED


def test_a_gripper_that_stands_elsewhere_has_gripped_and_is_told_to_hold(stage: Stage) -> None:
    stage.hook.jumps = False
    end = stage.go(0.7)
    assert (end.how, end.succeeded) == (Ended.STALLED, True)
    assert stage.hook.asked == [("move", 0.7), ("stop", 0.0)]


def test_what_the_gripper_itself_knows_is_believed(stage: Stage) -> None:
    stage.hook.grip = Grip.MOVING
    _, ends = stage.begin(0.7)
    until(lambda: ("move", 0.7) in stage.hook.asked, "the motion")
    time.sleep(0.4)  # twice the stall time
    assert ends == []
    stage.hook.grip = Grip.STALLED
    assert one(ends).how is Ended.STALLED
    assert ("stop", 0.7) not in stage.hook.asked, "it holds by itself"


def test_a_newer_motion_replaces_an_older_one(stage: Stage) -> None:
    stage.hook.grip = Grip.MOVING
    _, first = stage.begin(0.7)
    _, second = stage.begin(0.2)
    assert one(first).how is Ended.REPLACED
    stage.hook.grip = None
    assert one(second).how is Ended.REACHED
    assert len(first) == 1


def test_a_cancel_stops_it_and_ends_when_it_stands(stage: Stage) -> None:
    stage.hook.grip = Grip.MOVING
    motion, ends = stage.begin(0.7)
    until(lambda: stage.hook.asked, "the motion")
    stage.worker.cancel(motion)
    until(lambda: ("stop", 0.7) in stage.hook.asked, "the stop")
    time.sleep(0.2)
    assert ends == [], "it moves on"
    stage.hook.grip = Grip.HELD
    assert one(ends).how is Ended.CANCELED
    stage.worker.cancel(motion)
    assert stage.go(0.3).how is Ended.TROUBLE, "held by somebody else"


@pytest.mark.parametrize("wrong", [GripperTrouble("The port is gone."), OSError("no such device")])
def test_a_hook_that_fails_ends_the_motion_is_said_once_and_comes_back(stage: Stage, wrong: Exception) -> None:
    stage.hook.wrong = wrong
    first, second = stage.go(0.7), stage.go(0.6)
    assert first.how is second.how is Ended.TROUBLE
    assert str(wrong) in first.sentence
    assert [line for line in stage.said if str(wrong) in line] == [first.sentence]
    assert stage.worker.measured(time.monotonic_ns()) is None
    stage.hook.wrong = None
    until(lambda: "The gripper is in order again." in stage.said, "the way back")
    assert stage.go(0.5).how is Ended.REACHED


def test_what_is_still_starting_is_waited_for_without_a_word(stage: Stage) -> None:
    stage.hook.wrong = NotThereYet("It is just starting.")
    assert stage.go(0.7).sentence == "It is just starting."
    stage.hook.wrong = None
    assert stage.go(0.5).how is Ended.REACHED
    assert stage.said == []


def test_a_reading_that_is_no_number_is_a_trouble(stage: Stage) -> None:
    stage.hook.position_rad = math.nan
    assert "nan rad" in stage.go(0.7).sentence


@pytest.mark.parametrize(
    "reading",
    [
        None,
        0.3,
        (0.3,),
        Reading(0.3, None),  # type: ignore[arg-type]
        Reading(0.3, effort="little"),  # type: ignore[arg-type]
        Reading(0.3, grip="moving"),  # type: ignore[arg-type]
        Reading(0.3, measured_ns="now"),  # type: ignore[arg-type]
        Reading(0.3, measured_ns=math.inf),  # type: ignore[arg-type]
        Reading(10**400),
    ],
)
def test_a_reading_of_other_things_than_numbers_is_a_trouble_and_harms_no_other_thread(
    stage: Stage, reading: Any
) -> None:
    """The thread of /joint_states takes its numbers as they are; without it the arm stops."""
    stage.hook.read = lambda: reading
    assert "returns" in stage.go(0.7).sentence
    assert stage.worker.measured(time.monotonic_ns()) is None
    assert stage.worker.shown.grip is Grip.TROUBLE


def test_a_reading_from_the_future_grows_old_too(stage: Stage) -> None:
    ahead_ns = time.monotonic_ns() + 3_600_000_000_000
    stage.hook.read = lambda: Reading(0.3, measured_ns=ahead_ns)
    assert stage.go(0.3).how is Ended.REACHED
    assert stage.worker.measured(time.monotonic_ns() + 2_000_000_000) is None


def test_a_reading_is_known_until_it_is_old(stage: Stage) -> None:
    assert stage.go(0.7).how is Ended.REACHED
    now_ns = time.monotonic_ns()
    measured = stage.worker.measured(now_ns)
    assert measured is not None and measured[:2] == (0.7, 0.0) and math.isnan(measured[2])
    assert stage.worker.measured(now_ns + 2_000_000_000) is None


def test_the_end_of_the_program_stops_it_and_is_heard(stage: Stage) -> None:
    stage.hook.grip = Grip.MOVING
    _, ends = stage.begin(0.7)
    until(lambda: stage.hook.asked, "the motion")
    stage.worker.close(5.0)
    assert one(ends).how is Ended.TROUBLE
    assert stage.hook.asked[-2:] == [("stop", 0.7), ("close", 0.7)]


def test_a_hook_that_hangs_is_said_and_what_was_given_up_is_never_begun(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_module, "HANGS_AFTER_S", 0.1)
    assert stage.go(0.1).how is Ended.REACHED and stage.worker.hang() == ""
    stage.hook.pause.set()
    until(stage.worker.hang, "the hang")
    assert "has not returned" in stage.worker.hang()
    assert (stage.worker.measured(time.monotonic_ns()), stage.worker.shown.grip) == (None, Grip.TROUBLE)
    assert len([line for line in stage.said if "has not returned" in line]) == 1
    motion, _ = stage.begin(0.7)
    motion.end(End(Ended.TROUBLE, None, "It hangs."))
    stage.hook.pause.clear()
    assert stage.go(0.3).how is Ended.REACHED
    assert [angle for what, angle in stage.hook.asked if what == "move"] == [0.1, 0.3]
    assert "The gripper is in order again." in stage.said and stage.worker.hang() == ""


@pytest.mark.parametrize("amid", ["_begin", "_look"])
def test_a_motion_given_up_while_its_hook_hung_does_not_go_on(stage: Stage, amid: str) -> None:
    stage.hook.jumps, stage.hook.grip = False, Grip.MOVING
    if amid == "_begin":
        stage.hook.pause.set()
        time.sleep(0.15)
    motion, ends = stage.begin(0.7)
    if amid == "_look":
        until(lambda: stage.hook.asked, "the motion")
    motion.end(End(Ended.TROUBLE, None, "It hangs."))
    stage.hook.pause.clear()
    until(lambda: stage.worker._motion is None and stage.worker._works.empty(), "a gripper without a motion")
    stage.hook.grip = None
    assert stage.go(0.0).how is Ended.REACHED
    wanted = [] if amid == "_begin" else [("move", 0.7), ("stop", 0.0)]
    assert stage.hook.asked == [*wanted, ("move", 0.0)]
    assert [end.sentence for end in ends] == ["It hangs."], "whoever gave it up has told of its end"


def test_of_two_who_end_a_motion_the_first_one_is_heard() -> None:
    ends: list[End] = []
    motion = Motion(0.7, 0.0, ends.append)
    assert not motion.has_ended()
    for sentence in ("It hangs.", "It is there."):
        motion.end(End(Ended.TROUBLE, None, sentence))
        assert motion.has_ended()
    assert [end.sentence for end in ends] == ["It hangs."]


def test_a_hook_that_hangs_does_not_hold_up_the_end(stage: Stage) -> None:
    stage.hook.pause.set()
    time.sleep(0.15)
    began_s = time.monotonic()
    stage.worker.close(0.2)
    assert time.monotonic() - began_s < 2.0


def test_a_hook_that_cannot_be_opened_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_module, "TROUBLE_PERIOD_S", 0.05)
    tries: list[int] = []

    def make() -> Hook:
        tries.append(1)
        if len(tries) < 3:
            raise OSError("no port")
        return Hook()

    said: list[str] = []
    worker = GripperWorker(config(), make, said.append, said.append)
    worker.start()
    until(lambda: worker.shown.reading is not None, "the third try")
    worker.close(5.0)
    assert len([line for line in said if "no port" in line]) == 1


def test_homing_ends_with_the_reading_of_a_hook_that_knows_nothing_of_it(stage: Stage) -> None:
    assert stage.go(None).how is Ended.REACHED
    assert stage.hook.asked == [("home", 0.0)]


# --- the servo on the bus -------------------------------------------------------------------------------


class Loop:
    """What a control process would show of a gripper, and the requests it got."""

    def __init__(self) -> None:
        self.record = np.zeros((), layout.Gripper.dtype)
        self.record["written"], self.record["position_rad"] = 1, math.nan
        self.requests: list[tuple[Request, float, float]] = []
        self.refusal = ""
        self.absence = ""

    def show(self, grip: Grip, position_rad: float | None, trouble: GripTrouble = GripTrouble.NONE) -> None:
        self.record["monotonic_ns"] = time.monotonic_ns()
        self.record["grip"], self.record["trouble"] = grip, trouble
        self.record["measured_ns"] = 0 if position_rad is None else time.monotonic_ns()
        if position_rad is not None:
            self.record["position_rad"] = position_rad

    def request(self, kind: Request, on_reply: Any, *, value: float = 0.0, effort: float = 0.0) -> int:
        self.requests.append((kind, value, effort))
        if self.refusal:
            on_reply(False, self.refusal)
            return 0
        return len(self.requests)

    def gripper(self) -> np.ndarray:
        if self.absence:
            raise NotServing(self.absence)
        return self.record.copy()


def test_the_servo_is_moving_until_its_order_is_obeyed() -> None:
    loop = Loop()
    servo = ServoGripper(loop)
    loop.show(Grip.REACHED, 0.3)
    servo.move(1.0, 0.5)
    assert loop.requests == [(Request.GRIP, 1.0, 0.5)]
    assert servo.read().grip is Grip.MOVING
    loop.record["order"] = 1
    assert servo.read()[:1] == (0.3,) and servo.read().grip is Grip.REACHED
    loop.show(Grip.TROUBLE, 0.3, GripTrouble.PROTECTED)
    assert (servo.read().grip, servo.read().position_rad) == (Grip.TROUBLE, 0.3)
    assert "tripped its protection" in servo.read().trouble


def test_a_servo_that_does_not_know_where_it_is_can_be_homed() -> None:
    loop = Loop()
    loop.show(Grip.TROUBLE, None, GripTrouble.POWER_LOST)
    stage = Stage(ServoGripper(loop))
    assert "has lost power" in stage.go(0.5).sentence
    assert loop.requests == [], "it is not even asked"
    _, ends = stage.begin(None)
    until(lambda: loop.requests == [(Request.GRIP_HOME, 0.0, 0.0)], "the request")
    time.sleep(0.2)
    assert ends == [] and stage.worker.measured(time.monotonic_ns()) is None, "no angle is invented"
    loop.record["order"] = 1
    loop.show(Grip.MOVING, None)
    time.sleep(0.2)
    assert ends == []
    loop.show(Grip.REACHED, 0.0)
    assert one(ends).how is Ended.REACHED
    assert stage.worker.measured(time.monotonic_ns()) is not None
    stage.worker.close(5.0)


@pytest.mark.parametrize(("absence", "refusal"), [("It is not running.", ""), ("", "Not while it is offline.")])
def test_a_control_process_that_is_not_there_or_refuses_ends_the_motion(absence: str, refusal: str) -> None:
    loop = Loop()
    loop.show(Grip.HELD, 0.3)
    loop.absence, loop.refusal = absence, refusal
    stage = Stage(ServoGripper(loop))
    assert stage.go(0.5).sentence == (absence or refusal)
    stage.worker.close(5.0)


def test_an_order_that_a_new_control_process_never_heard_of_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(servo_module, "TAKEN_WITHIN_S", 0.1)
    loop = Loop()
    servo = ServoGripper(loop)
    loop.show(Grip.HELD, 0.3)
    servo.move(1.0, 0.0)
    time.sleep(0.15)
    with pytest.raises(GripperTrouble, match="has not passed the command on"):
        servo.read()
    assert servo.read().grip is Grip.HELD


def test_a_new_control_process_is_not_asked_for_an_order_of_its_predecessor(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = Loop()
    servo = ServoGripper(loop)
    servo.move(1.0, 0.0)
    loop.record["order"] = 1
    loop.show(Grip.REACHED, 1.0)
    assert servo.read().grip is Grip.REACHED
    loop.absence = "It is not running."
    with pytest.raises(NotThereYet):
        servo.read()
    loop.absence, loop.record["order"] = "", 0
    monkeypatch.setattr(servo_module, "TAKEN_WITHIN_S", 0.0)
    assert servo.read().grip is Grip.REACHED


def test_a_record_that_nobody_writes_any_more_is_not_believed() -> None:
    loop = Loop()
    loop.show(Grip.HELD, 0.3)
    loop.record["monotonic_ns"] -= 5_000_000_000
    with pytest.raises(GripperTrouble, match=r"has shown nothing of the gripper for 5\.0 s"):
        ServoGripper(loop).read()


# --- the simulated one ----------------------------------------------------------------------------------


@given(
    target=st.floats(0.0, 110.0),
    then=st.floats(0.0, 110.0),
    after_s=st.floats(0.0, 2.0),
    thing=st.none() | st.floats(-10.0, 120.0),
)
def test_the_simulated_one_never_jumps_and_never_passes_the_thing(
    target: float, then: float, after_s: float, thing: float | None
) -> None:
    now_s = 0.0
    settings = config(options={} if thing is None else {"object_deg": thing})
    gripper = SimulatedGripper(settings, lambda: now_s)
    before = gripper.read().position_rad
    least = min(before, -math.inf if thing is None else math.radians(thing))
    for angle, seconds in ((target, after_s), (then, 2.0)):
        gripper.move(math.radians(angle), 0.0)
        for _ in range(40):
            now_s += seconds / 40
            here = gripper.read().position_rad
            assert abs(here - before) <= settings.speed_rad_s * seconds / 40 + 1e-9
            assert here >= least - 1e-9
            before = here
    blocked = math.radians(then) < least
    assert blocked or before == pytest.approx(math.radians(then))


def test_an_object_that_is_no_angle_is_said() -> None:
    with pytest.raises(GripperTrouble, match="object_deg of the gripper is 'wide'"):
        SimulatedGripper(config(options={"object_deg": "wide"}))


# --- one's own ------------------------------------------------------------------------------------------

OWN = """
    from rosfront.gripper.hook import Reading

    class MyGripper:
        def __init__(self, config):
            self.at = config.options["start_rad"]
        def move(self, position_rad, max_effort):
            self.at = position_rad
        def stop(self): ...
        def read(self):
            return Reading(self.at)
        def close(self): ...
"""


def own_arm(folder: Path, hook: str, text: str = OWN) -> Any:
    (folder / "mine.py").write_text(textwrap.dedent(text), encoding="utf-8")
    arm_file = folder / "arm.yaml"
    mock = Path(load_arm("mock").source.file)
    source = Path(__file__).resolve().parents[2] / "config" / "arms" / mock
    section = f"\ngripper:\n  hook: {hook}\n  options: {{start_rad: 0.25}}\n"
    arm_file.write_text(source.read_text(encoding="utf-8").replace("name: mock", "name: mine") + section)
    return load_arm(arm_file)


def test_a_class_beside_the_arm_file_is_the_hook(tmp_path: Path) -> None:
    arm = own_arm(tmp_path, "mine.py:MyGripper")
    gripper = hook_of(arm, arm.gripper, None)()
    assert gripper.read().position_rad == 0.25


@pytest.mark.parametrize(
    ("hook", "text", "said"),
    [
        ("other.py:MyGripper", OWN, "which is no file"),
        ("mine.py:Other", OWN, "does not have"),
        ("mine.py:MyGripper", "class MyGripper:\n    def move(self): ...", "no stop and no read and no close"),
        ("mine.py:MyGripper", "raise RuntimeError('serial')", "RuntimeError: serial"),
        ("mine.py:MyGripper", "class", "SyntaxError"),
    ],
)
def test_a_hook_that_cannot_be_had_is_said_before_anything_is_served(
    tmp_path: Path, hook: str, text: str, said: str
) -> None:
    arm = own_arm(tmp_path, hook, text)
    with pytest.raises(CannotServe, match=said):
        hook_of(arm, arm.gripper, None)


class Line:
    """A serial port with the gripper of the example at its other end."""

    def __init__(self, port: str, baud: int, timeout: float) -> None:
        self.angle, self.answer = "0.0", b""

    def write(self, data: bytes) -> None:
        if data.startswith(b"G "):
            self.angle = data[2:].decode().strip()
        self.answer = self.angle.encode() + b"\n" if data == b"?\n" else b""

    def readline(self) -> bytes:
        return self.answer

    def close(self) -> None: ...


def test_the_example_of_the_page_is_a_hook(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", types.SimpleNamespace(Serial=Line))
    page = Path(__file__).resolve().parents[2] / "docs" / "hardware" / "gripper.md"
    code = page.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    assert len(code.splitlines()) <= 40
    namespace: dict[str, Any] = {}
    exec(compile(code, str(page), "exec"), namespace)
    stage = Stage(namespace["SerialGripper"](config(options={"port": "/dev/ttyUSB5"})))
    assert stage.go(1.0).how is Ended.REACHED
    stage.hook.port.angle = "open"
    assert "answers b'open\\n', not an angle" in stage.go(0.5).sentence
    stage.worker.close(5.0)


def test_load_class_wants_a_file(tmp_path: Path) -> None:
    with pytest.raises(CannotServe, match="no file"):
        load_class(tmp_path, "MyGripper")


@pytest.mark.parametrize("hook", ["", "mine", "mine.py", "mine.py:", "mine:MyGripper", "mine.py:2", "servo2"])
def test_a_hook_is_a_word_or_a_class_of_a_file(hook: str) -> None:
    with pytest.raises(ConfigError, match=r"gripper\.hook"):
        load_arm("mock", overrides={"gripper": {"hook": hook}})
