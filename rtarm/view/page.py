"""The page: what it is made of, how often it looks, and what happens when somebody touches it.

All tabs that are open show one and the same page: whoever moves a slider moves it for all.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Any

import numpy as np

from config.schema import ArmConfig
from rtarm.console.errors import Refusal
from rtarm.console.language import told
from rtarm.top.watch import Look
from rtarm.view.history import History
from rtarm.view.limits import Side, nearness
from rtarm.view.orders import Orders, duration_s
from rtarm.view.panels import (
    STOP_FOLLOWS,
    STYLE,
    Answered,
    answer_html,
    events_html,
    joints_html,
    machine_html,
    problems_html,
    readings_html,
    state_html,
)
from rtarm.view.plots import Plots
from rtarm.view.scene import BROKEN, NEAR, SHOWN_APART_RAD, Colour, Scene
from rtarm.view.source import Source
from rtarm.view.words import Words
from shm.errors import SharedMemoryError

if TYPE_CHECKING:
    import viser

POSE_S = 0.05
PANELS_S = 0.2
ANSWERS = 2
"""So many of the newest answers are shown."""
PANEL_PX = 400
PLOTS_PX = 340
STEP_DEG = 0.1
YOUNG_S = 2.0
"""An answer of so long ago may be that to what is seen to have happened just now."""
LET_GO_S = 1.0
"""A speed slider that nobody has moved for so long follows the arm again."""
LIMP = ("disabled", "free")


class Page:
    """Scene and panels on a viser server, kept up to what a source shows."""

    def __init__(
        self, server: viser.ViserServer, arm: ArmConfig, source: Source, orders: Orders | None, words: Words
    ) -> None:
        self._server = server
        self._arm = arm
        self._source = source
        self._words = words
        self._history = History(len(arm.joints))
        self._scene = None if arm.kinematics is None else Scene(server, arm, arm.kinematics)
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(40, 120, 220))
        gui.set_panel_label(words.title.format(arm=arm.name))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_PX)
        gui.add_html(STYLE)
        self._state = gui.add_html("")
        self._controls = None if orders is None else Controls(server, arm, orders, words, self._scene)
        if self._controls is None:
            gui.add_html(f'<div class="rt dim">{words.recording}</div>')
        self._problems = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab(words.joints):
            self._joints = gui.add_html("")
        if self._controls is not None:
            with tabs.add_tab(words.move):
                self._controls.add_sliders()
        with tabs.add_tab(words.events):
            self._events = gui.add_html("")
        with tabs.add_tab(words.machine):
            self._machine = gui.add_html("")
        beside = gui.add_panel()
        with beside.add_tab(words.plots):
            self._plots = Plots(server, source.joints, words)
        beside.dock_left()
        beside.set_width(PLOTS_PX)

    def serve(self, ended: threading.Event) -> None:
        """Look again and again until somebody sets `ended`; while nobody is connected nothing is read or sent."""
        panels_due_s = 0.0
        while not ended.wait(POSE_S):
            if not self._server.get_clients():
                panels_due_s = 0.0
                continue
            now_s = time.monotonic()
            self.look_at_pose()
            if now_s >= panels_due_s:
                panels_due_s = now_s + PANELS_S
                self.look_at_all()

    def look_at_pose(self) -> None:
        """Bring the arm in the scene up to now."""
        records = self._source.cycles()
        if len(records) == 0:
            return
        self._history.add(records)
        newest = records[-1]
        joints = newest["joints"]
        measured_rad = np.where(joints["measured_ns"] != 0, joints["measured_position_rad"], np.nan)
        commanded_rad = joints["commanded_position_rad"]
        goal_runs = int(newest["goal_id"]) != 0
        if self._controls is not None:
            self._controls.follow(commanded_rad, float(newest["speed_scale_asked"]))
        if self._scene is not None:
            apart_rad = np.nan_to_num(np.abs(measured_rad - commanded_rad)).max()
            with self._server.atomic():
                self._scene.measured.move(measured_rad)
                self._scene.commanded.move(commanded_rad)
                self._scene.commanded.show(goal_runs or bool(apart_rad > SHOWN_APART_RAD))

    def look_at_all(self) -> None:
        """Bring everything beside the scene up to now."""
        look = self._source.look()
        if look.trouble is None:
            self._plots.update(self._history.curves())
        with self._server.atomic():
            _set(self._state, state_html(look, self._words))
            if look.report is not None and look.trouble is None:
                self._tell(look, look.report)
            _set(self._events, events_html(look, self._words))
            if self._controls is not None:
                self._controls.offer(look)

    def _tell(self, look: Look, report: dict[str, Any]) -> None:
        _set(self._problems, problems_html(look, self._arm, self._words))
        _set(self._joints, joints_html(look, self._arm, self._words))
        _set(self._machine, machine_html(look, self._words))
        if self._scene is not None:
            self._scene.measured.paint(marks(report, self._arm))
            self._scene.show_path(self._source.path())
            gripper = report.get("gripper")
            if gripper is not None and gripper["position_rad"] is not None:
                self._scene.measured.grip(gripper["position_rad"])


def marks(report: dict[str, Any], arm: ArmConfig) -> list[Colour | None]:
    """The colour of each joint's link: what the fault names, or a limit that is near."""
    fault = report["fault"]
    blamed = None if fault is None else fault["joint"]
    colours: list[Colour | None] = []
    for joint, config in zip(report["joints"], arm.joints, strict=True):
        close = nearness(config, joint["position_rad"])
        if joint["name"] == blamed or (close is not None and close.side is Side.BEYOND):
            colours.append(BROKEN)
        else:
            colours.append(None if close is None else NEAR)
    return colours


def _set(panel: viser.GuiHtmlHandle, content: str) -> None:
    if panel.content != content:
        panel.content = content


class Controls:
    """Buttons and sliders, and what came of them.

    Callbacks come from viser's threads, from whatever a browser sent: every value is checked, and an order that is
    under way is not given a second time, Hold and Stop excepted.
    """

    def __init__(
        self, server: viser.ViserServer, arm: ArmConfig, orders: Orders, words: Words, scene: Scene | None
    ) -> None:
        self._server, self._arm, self._orders, self._words, self._scene = server, arm, orders, words, scene
        self._lock = threading.RLock()
        self._under_way: dict[str, object] = {}
        self._answers: dict[object, Answered] = {}
        self._held = False
        self._stands_rad = np.zeros(len(arm.joints))
        self._wished_rad: dict[int, float] = {}  # of the joints whose sliders were touched; the others follow the arm
        self._speed_wish: float | None = None
        self._speed_touched_s = -math.inf
        gui = server.gui
        self._hold = gui.add_button(words.hold, hint=words.hold_hint, color="orange")
        self._hold.on_click(lambda _: self._halt(words.hold, orders.hold, orders.hold_again))
        self._resume = self._button(words.resume, words.resume_hint, orders.resume, "blue")
        gui.add_html(STOP_FOLLOWS)
        self._stop = gui.add_button(words.stop, hint=words.stop_hint, color="red")
        self._stop.on_click(lambda _: self._halt(words.stop, orders.stop, orders.stop_again))
        self._clear = self._button(words.clear_fault, words.clear_fault_hint, orders.clear_fault, "green")
        self._clear.visible = False
        self._enable = gui.add_button(words.enable, hint=words.enable_hint, color="green", visible=False)
        self._enable.on_click(self._ask_to_enable)
        self._reference = gui.add_button(words.reference, hint=words.reference_hint, color="green", visible=False)
        self._reference.on_click(self._ask_to_reference)
        self._speed: Any = gui.add_slider(words.speed, 0, 100, 1, 100, hint=words.speed_hint)
        self._speed.on_update(self._speed_moved)
        self._answer = gui.add_html("")
        self._sliders: list[Any] = []

    def _button(self, label: str, hint: str, order: Callable[[], str], colour: Any) -> viser.GuiButtonHandle:
        button = self._server.gui.add_button(label, hint=hint, color=colour)
        button.on_click(lambda _: self._give(label, lambda _: order()))
        return button

    def add_sliders(self) -> None:
        """The joints' sliders and the button that sends the goal, where the GUI is being filled."""
        gui, words = self._server.gui, self._words
        gui.add_html(f'<div class="rt dim">{words.move_help}</div>')
        for index, joint in enumerate(self._arm.joints):
            low, high = math.ceil(joint.lower_deg / STEP_DEG), math.floor(joint.upper_deg / STEP_DEG)
            slider = gui.add_slider(
                f"{joint.name} °",
                min=round(low * STEP_DEG, 1),
                max=round(high * STEP_DEG, 1),
                step=STEP_DEG,
                initial_value=round(min(max(0, low), high) * STEP_DEG, 1),
            )
            slider.on_update(self._mover(index))
            self._sliders.append(slider)
        self._go = gui.add_button(words.go_nowhere, hint=words.go_hint, color="green", disabled=True)
        self._go.on_click(lambda _: self._give(words.go_nowhere, self._go_there))
        self._back = gui.add_button(words.back, hint=words.back_hint, color="gray", disabled=True)
        self._back.on_click(lambda _: self._forget())

    # --- what the arm does ---------------------------------------------------------------------------------

    def follow(self, commanded_rad: np.ndarray, speed_asked: float) -> None:
        """Sliders that nobody has touched stand where the arm is."""
        with self._lock:
            self._stands_rad = commanded_rad.copy()
            self._place_sliders(commanded_rad)
            if self._wished_rad and self._scene is not None:
                self._scene.wished.move(self._target_rad())
            speed = round(100.0 * speed_asked) if math.isfinite(speed_asked) else 100
            if time.monotonic() - self._speed_touched_s > LET_GO_S and self._speed.value != speed:
                self._speed.value = speed

    def offer(self, look: Look) -> None:
        """Offer the buttons that mean something now."""
        report = look.report if look.trouble is None else None
        with self._lock:
            held = report is not None and report["held"]
            if self._held and not held:
                self._forget_answers()
            self._held = held
            _enable(self._hold, not held)  # also of an arm that stands: it keeps what comes from beginning
            _enable(self._resume, held)
            _show(self._clear, report is not None and report["fault"] is not None)
            _show(self._enable, report is not None and report["fault"] is None and report["mode"] in LIMP)
            _show(self._reference, report is not None and report["mode"] == "holding" and _lacks_a_reference(report))
            self._offer_go()

    def _forget_answers(self) -> None:
        """What was said of a hold is over with it; an answer as young as this is that to the resume."""
        now_s = time.time()
        self._answers = {given: one for given, one in self._answers.items() if now_s - one.at_s < YOUNG_S}
        _set(self._answer, answer_html([*reversed(self._answers.values())]))

    def _offer_go(self) -> None:
        words = self._words
        label = words.go_nowhere
        if self._wished_rad:
            takes_s = duration_s(self._arm, self._stands_rad, self._target_rad()) / max(self._speed.value / 100.0, 0.01)
            label = words.go.format(duration=takes_s)
        if self._go.label != label:
            self._go.label = label
        for button in (self._go, self._back):
            if button.disabled == bool(self._wished_rad):
                button.disabled = not self._wished_rad

    def _target_rad(self) -> np.ndarray:
        """Where Go would take the arm (joints,)."""
        target_rad = self._stands_rad.copy()
        for index, wished_rad in self._wished_rad.items():
            target_rad[index] = wished_rad
        return target_rad

    def _place_sliders(self, positions_rad: np.ndarray) -> None:
        """Let the sliders that are no wish stand where the arm does."""
        placed = zip(self._sliders, self._arm.joints, positions_rad.tolist(), strict=True)
        for index, (slider, joint, position) in enumerate(placed):
            if index in self._wished_rad:
                continue
            degrees = min(max(math.degrees(position), joint.lower_deg), joint.upper_deg)
            shown = min(max(round(degrees / STEP_DEG) * STEP_DEG, slider.min), slider.max)
            if abs(slider.value - shown) > 0.5 * STEP_DEG:
                slider.value = round(shown, 1)

    # --- what people do ------------------------------------------------------------------------------------

    def _halt(self, what: str, order: Callable[[], str], again: Callable[[], None]) -> None:
        """Every press of Hold and Stop reaches the arm, which may have been resumed since one that still waits."""
        self._give(what, lambda _: order(), again)

    def _give(self, what: str, order: Callable[[object], str], again: Callable[[], None] = lambda: None) -> None:
        """Give an order and show its answer, which takes the place of what is said while it is under way.

        While the same order is under way, `again` is called instead.
        """
        given = object()
        with self._lock:
            is_first = what not in self._under_way
            if is_first:
                self._under_way[what] = given
                self._answered(given, self._words.under_way.format(what=what), True)
        if not is_first:
            again()
            return
        sentence, done = self._words.broken.format(what=what), False
        try:
            sentence, done = order(given), True
        except (Refusal, SharedMemoryError) as refused:
            sentence, done = _why(refused, self._words), False
        finally:
            self._over(what, given)
            self._answered(given, sentence, done)

    def _over(self, what: str, given: object) -> None:
        """From here on the same may be ordered again; whatever is under way then is left alone."""
        with self._lock:
            if self._under_way.get(what) is given:
                del self._under_way[what]

    def _answered(self, given: object, sentence: str, done: bool) -> None:
        with self._lock:
            self._answers.pop(given, None)
            self._answers[given] = Answered(time.time(), sentence, done)
            for old in list(self._answers)[:-ANSWERS]:
                del self._answers[old]
            _set(self._answer, answer_html([*reversed(self._answers.values())]))

    def _ask_to_enable(self, event: viser.GuiEvent[Any]) -> None:
        """A limp arm is one that somebody may have their hands on."""
        if event.client is not None:
            gui, words = event.client.gui, self._words
            with gui.add_modal(words.enable_question.format(arm=self._arm.name)) as question:
                gui.add_markdown(words.enable_warning)
                self._add_answers(gui, question.close, words.enable_yes, self._orders.enable)

    def _ask_to_reference(self, event: viser.GuiEvent[Any]) -> None:
        """Every goal believes where the joints are taken to stand, so a person compares the angles first."""
        if event.client is None:
            return
        gui, words = event.client.gui, self._words
        try:
            shown = self._orders.readings()
        except (Refusal, SharedMemoryError) as refused:
            self._answered(object(), _why(refused, self._words), False)
            return
        if not shown:  # somebody else was faster
            return
        with gui.add_modal(words.reference_question.format(arm=self._arm.name)) as question:
            gui.add_html(readings_html(shown, words))
            agree = words.reference_yes if any(one.stands_deg is not None for one in shown) else None
            self._add_answers(gui, question.close, agree, lambda: self._orders.reference(shown))

    def _add_answers(
        self, gui: viser.GuiApi, close: Callable[[], None], agree: str | None, order: Callable[[], str]
    ) -> None:
        """The buttons under a question; with None for its label there is nothing to agree to."""

        def give(label: str) -> None:
            close()
            self._give(label, lambda _: order())

        if agree is not None:
            gui.add_button(agree, color="green").on_click(lambda _: give(agree))
        gui.add_button(self._words.no, color="gray").on_click(lambda _: close())

    def _speed_moved(self, event: viser.GuiEvent[Any]) -> None:
        if event.client_id is None:  # set by the page itself
            return
        percent = _number(event.target.value, 0.0, 100.0)
        with self._lock:
            self._speed_touched_s = time.monotonic()
            self._speed_wish = percent
        self._give(self._words.speed, self._set_speed)

    def _set_speed(self, given: object) -> str:
        """Ask for the newest speed until no newer one was chosen meanwhile."""
        sentence = ""
        while True:
            with self._lock:
                percent, self._speed_wish = self._speed_wish, None
                if percent is None:
                    self._over(self._words.speed, given)  # a speed that is chosen from here on is a new order
                    return sentence
            sentence = self._orders.speed(percent / 100.0)

    def _mover(self, index: int) -> Callable[[viser.GuiEvent[Any]], Coroutine[Any, Any, None]]:
        """What viser calls when a slider is moved.

        A coroutine runs where messages are read, so the wish is known before a press that comes behind it is carried
        out, and before the slider could be put back to where the arm is. A function would run in a pool of threads.
        """

        async def moved(event: viser.GuiEvent[Any]) -> None:
            self._slider_moved(index, event)

        return moved

    def _slider_moved(self, index: int, event: viser.GuiEvent[Any]) -> None:
        if event.client_id is None:
            return
        joint = self._arm.joints[index]
        degrees = _number(event.target.value, joint.lower_deg, joint.upper_deg)
        with self._lock:
            self._wished_rad[index] = math.radians(degrees)
            if self._scene is not None:
                with self._server.atomic():
                    self._scene.wished.move(self._target_rad())
                    self._scene.wished.show(True)
            self._offer_go()

    def _forget(self) -> None:
        with self._lock:
            self._wished_rad.clear()
            self._place_sliders(self._stands_rad)
            if self._scene is not None:
                self._scene.wished.show(False)
            self._offer_go()

    def _go_there(self, given: object) -> str:
        with self._lock:
            if not self._wished_rad:
                raise Refusal(self._words.already)
            target_rad = self._target_rad()

        def on_the_way(sentence: str) -> None:
            self._forget()
            self._over(self._words.go_nowhere, given)  # whoever presses again from here on is told that a goal runs
            self._answered(given, sentence, True)

        return self._orders.go(target_rad, on_the_way)


def _why(refused: Refusal | SharedMemoryError, words: Words) -> str:
    return refused.sentence if isinstance(refused, Refusal) else told(refused, words.language)


def _number(value: Any, low: float, high: float) -> float:
    """What a browser says is a number, within its limits; the lower one where it is none."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return low
    return min(max(number, low), high) if math.isfinite(number) else low


def _lacks_a_reference(report: dict[str, Any]) -> bool:
    return not all(joint["referenced"] for joint in report["joints"])


def _enable(button: viser.GuiButtonHandle, enabled: bool) -> None:
    if button.disabled == enabled:
        button.disabled = not enabled


def _show(button: viser.GuiButtonHandle, shown: bool) -> None:
    if button.visible != shown:
        button.visible = shown
