"""`rtarm view` in a real browser, beside arms that really run."""

from __future__ import annotations

import math
import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from arm_files import edited, known_arm
from browser import CHROMIUM, DRIVER, Browser, host_of
from in_chinese import english_in
from stack import PATIENT, Process, Stack
from working_threads import niceness_at_work

from config.loader import load_arm
from rtarm.running import requests
from rtarm.running.status import Report, read_status
from rtloop.kept import reference_store
from shm.words import Request, Unreferenced

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(CHROMIUM is None or DRIVER is None, reason="needs Debian's chromium and chromium-driver"),
]

PICTURED = "my_arm" if os.environ.get("RTARM_PICTURES") else ""
"""In pictures for the documentation an arm has a name that looks like one."""
SLOW_DEG = 60.0
"""joint1 needs several seconds for so much."""
SLOWLY = 0.1
"""At this speed a goal lasts until a browser beside a full machine has found a button."""


class ViewedArm(Stack):
    """An arm and the process that serves its page."""

    def start_view(self, *options: str) -> Process:
        self.view = self._keep(Process("rtarm", "view", str(self.arm_file), "--port", "0", *options, needs_ros=True))
        line = self.view.line_with("http://")
        self.url = re.search(r"http://\S+", line).group()
        return self.view

    def status(self) -> Report:
        return read_status(self.name)

    def speed_asked(self) -> float:
        with requests.connect(self.name) as connection:
            return float(connection.snapshot()["speed_scale_asked"])

    def position_deg(self, joint: int) -> float:
        return math.degrees(self.status()["joints"][joint - 1]["position_rad"])


def mock_with_geometry(name: str, folder: Path) -> ViewedArm:
    """An arm whose drives do as they are told, however busy the machine is."""
    arm = ViewedArm(name, folder, "mock")
    with edited(arm.arm_file) as values:
        values["kinematics"] = known_arm("episode1")["kinematics"]
    return arm


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    browser = Browser()
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def running(new_arm_name: Callable[[], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewedArm]:
    """A mock arm with its ROS process and its page."""
    arm = mock_with_geometry(PICTURED or new_arm_name(), tmp_path_factory.mktemp("view"))
    arm.start_loop()
    arm.start_front()
    arm.start_view()
    yield arm
    arm.close()


@pytest.fixture
def arm(running: ViewedArm, browser: Browser) -> Iterator[ViewedArm]:
    """The same, holding at full speed, in the browser."""
    requests.stop(running.name)
    requests.resume(running.name)
    requests.speed(running.name, 1.0)
    browser.open(running.url)
    yield running


def go(browser: Browser, **to_deg: float) -> None:
    """Set sliders and send the goal."""
    browser.tab("Move")
    for joint, degrees in to_deg.items():
        browser.slide(f"{joint} °", degrees)
    browser.until(lambda: any(label.startswith("Go there: the arm moves") for label in browser.buttons()))
    browser.press("Go there")


def blue(picture: np.ndarray) -> int:
    """How many pixels the ghost tints."""
    return int(np.count_nonzero(picture[..., 2] - np.maximum(picture[..., 0], picture[..., 1]) > 20))


def green(picture: np.ndarray) -> int:
    """How many pixels the wish tints."""
    return int(np.count_nonzero(picture[..., 1] - np.maximum(picture[..., 0], picture[..., 2]) > 15))


def line(picture: np.ndarray) -> int:
    """How many pixels the goal's path covers: nothing else is of so strong a blue."""
    return int(np.count_nonzero(picture[..., 2] - picture[..., 0] > 130))


def test_every_thread_that_works_for_the_page_gives_way(arm: ViewedArm, browser: Browser) -> None:
    assert niceness_at_work(arm.view.process.pid) == {19}


def test_the_page_shows_the_arm_as_it_is_and_asks_nobody_else(arm: ViewedArm, browser: Browser) -> None:
    browser.until(lambda: browser.text("#rt-mode") == "holding")
    for joint in arm.status()["joints"]:
        for kind, radians in (("measured", joint["position_rad"]), ("commanded", joint["commanded_rad"])):
            shown = browser.text(f"[data-{kind}={joint['name']}]")
            assert float(shown) == pytest.approx(math.degrees(radians), abs=0.006)
    browser.tab("Machine")
    browser.until(lambda: re.search(r"\d+ at 100 Hz", browser.text("#rt-machine")))
    assert f"pid {arm.front.process.pid}" in browser.text("#rt-machine")
    browser.tab("Events")
    browser.until(lambda: "Mode: holding." in browser.texts("td.text"))
    times, *joints = browser.until(lambda: browser.plotted("Position °"))
    assert len(joints) == 6 and times[-1] == 0.0 and times[0] >= -30.0
    assert browser.plotted("Wake-up lateness µs (worst of 0.1 s)")[1][-1] > 0.0
    asked = list(browser.asked())
    assert any(url.startswith("ws://") for url in asked)
    assert {host_of(url) for url in asked} <= {"127.0.0.1", ""}
    browser.tab("Joints")
    browser.keep("view")


def test_a_slider_moves_the_arm_when_go_is_pressed_and_not_before(arm: ViewedArm, browser: Browser) -> None:
    # A page that has just been loaded may still lay itself out over the scene.
    at_rest = browser.look(lambda picture: blue(picture) < 50 and green(picture) < 500 and line(picture) < 10)
    began_deg = arm.position_deg(1)
    to_deg = began_deg + SLOW_DEG if began_deg < 0.0 else began_deg - SLOW_DEG
    browser.tab("Move")
    browser.slide("joint1 °", round(to_deg, 1))
    wished = browser.look(lambda picture: green(picture) > 500)
    assert arm.status()["goal"] is None and arm.position_deg(1) == began_deg
    browser.keep("view_move")
    browser.press("Go there: the arm moves for")
    arm.until(lambda report: report["mode"] == "executing")
    arm.until(lambda report: report["goal"]["clock_s"] > 5.0)
    requests.hold(arm.name)  # so that a slow browser has the time to draw it
    moving = browser.look(lambda picture: blue(picture) > 500 and line(picture) > 50)
    assert blue(wished) < 50
    assert np.count_nonzero(np.abs(moving - at_rest).max(axis=-1) > 60) > 1000, "the arm itself stands elsewhere"
    browser.tab("Joints")
    browser.keep("view_goal")
    requests.resume(arm.name)
    arm.until(lambda report: report["goal"] is None)
    assert arm.position_deg(1) == pytest.approx(to_deg, abs=0.06)
    browser.until(lambda: "Goal reached" in browser.said("answer"))
    browser.until(lambda: browser.text("[data-measured=joint1]") == f"{arm.position_deg(1):.2f}")
    browser.look(lambda picture: blue(picture) < 50)
    browser.tab("Move")
    browser.until(lambda: browser.slider("joint1 °") == pytest.approx(arm.position_deg(1), abs=0.06))


def test_hold_stops_the_arm_resume_lets_it_go_on_and_stop_ends_the_goal(arm: ViewedArm, browser: Browser) -> None:
    began_deg = arm.position_deg(1)
    requests.speed(arm.name, SLOWLY)
    go(browser, joint1=round(began_deg + SLOW_DEG if began_deg < 0.0 else began_deg - SLOW_DEG, 1))
    arm.until(lambda report: report["mode"] == "executing" and report["goal"]["clock_s"] > 0.3)
    browser.press("Hold")
    report = arm.until(lambda report: report["goal"]["phase"] == "paused")
    assert abs(arm.position_deg(1) - began_deg) < SLOW_DEG - 5.0
    browser.until(lambda: "stands on its path" in browser.said("answer"))
    browser.until(lambda: "paused" in browser.text("#rt-goal"))
    browser.press("Resume")
    arm.until(lambda now: now["goal"]["phase"] == "running" and now["goal"]["clock_s"] > report["goal"]["clock_s"])
    browser.press("Stop and end the goal")
    arm.until(lambda now: now["goal"] is None)
    assert abs(arm.position_deg(1) - began_deg) < SLOW_DEG - 1.0
    browser.until(lambda: "stopped on its path and stands" in browser.said("answer"))
    browser.until(lambda: "A person has stopped or holds the arm" in browser.said("problem"))
    go(browser, joint5=10.0)
    browser.until(lambda: "A person has stopped or holds the arm" in browser.said("answer"))
    browser.press("Resume")
    browser.until(lambda: "takes goals again" in browser.said("answer"))


def test_a_goal_that_runs_is_never_replaced(arm: ViewedArm, browser: Browser) -> None:
    began_deg = arm.position_deg(1)
    requests.speed(arm.name, SLOWLY)
    go(browser, joint1=round(began_deg + SLOW_DEG if began_deg < 0.0 else began_deg - SLOW_DEG, 1))
    running = arm.until(lambda report: report["mode"] == "executing")["goal"]["id"]
    browser.press("Hold")
    arm.until(lambda report: report["goal"]["phase"] == "paused")
    go(browser, joint5=10.0)
    browser.until(lambda: f"Goal {running} is running" in browser.said("answer"))
    assert arm.status()["goal"]["id"] == running


def test_a_limp_arm_refuses_goals_and_is_enabled_only_after_a_second_press(arm: ViewedArm, browser: Browser) -> None:
    requests.let_go(arm.name, Request.DISABLE)
    try:
        browser.until(lambda: "The drives are limp" in browser.said("problem"))
        go(browser, joint5=20.0)
        browser.until(lambda: "disabled" in browser.said("answer"))
        browser.keep("view_refused")
        browser.press("Enable drives")
        browser.until(lambda: "Leave it as it is" in browser.buttons())
        assert arm.status()["mode"] == "disabled"
        browser.press("Leave it as it is")
        browser.until(lambda: "Leave it as it is" not in browser.buttons())
        assert arm.status()["mode"] == "disabled"
        browser.press("Enable drives …")
        browser.until(lambda: "Leave it as it is" in browser.buttons())
        browser.keep("view_enable")
        browser.press("Enable the drives")
        arm.until(lambda report: report["mode"] == "holding")
        browser.until(lambda: "are enabled" in browser.said("answer"))
        browser.until(lambda: not any(label.startswith("Enable drives") for label in browser.buttons()))
        browser.press("Sliders back to the arm")  # what was refused is still a wish, and offered as before
        browser.until(lambda: not any(label.startswith("Go there: the arm moves") for label in browser.buttons()))
    finally:
        if arm.status()["mode"] == "disabled":
            requests.enable(arm.name)


def test_the_speed_slider_slows_every_goal_and_follows_others(arm: ViewedArm, browser: Browser) -> None:
    browser.slide("Speed %", 40)
    browser.until(lambda: arm.speed_asked() == pytest.approx(0.4))
    browser.until(lambda: "run at 40% of their speed" in browser.said("answer"))
    assert "under way" not in browser.said("answer"), "the answer takes the place of what was said until it came"
    requests.speed(arm.name, 0.8)
    browser.until(lambda: browser.slider("Speed %") == 80)


def test_a_joint_near_its_limit_is_told(arm: ViewedArm, browser: Browser) -> None:
    go(browser, joint5=108.0)
    browser.tab("Joints")
    browser.until(lambda: "joint5 is 2.0° from its upper limit (110°)" in browser.said("near"))
    browser.keep("view_limit")


def test_on_a_phone_stop_is_there_however_the_sheet_is_scrolled_and_tapped(arm: ViewedArm, browser: Browser) -> None:
    stop = "Stop and end the goal"

    def scrolled_away() -> bool:
        browser.scroll(1e6)  # again: the page is laid out for a phone some time after it is narrow
        return browser.can_press(stop) and not browser.can_press("Hold")

    with browser.phone(height_px=500):
        browser.until(scrolled_away)
        browser.scroll(0)
        browser.until(lambda: browser.can_press("Hold"))
        browser.tap("rtarm: ")  # on the sheet's head, which else folds it, and then no browser lets one press Stop
        browser.tap("Events")
        browser.until(lambda: browser.selected_tab() == "Events")
        browser.scroll(0)
        browser.until(lambda: browser.can_press(stop) and browser.can_press("Hold"))  # once it is laid out again


def test_two_tabs_show_one_page(arm: ViewedArm, browser: Browser) -> None:
    browser.open_beside(arm.url)
    try:
        browser.tab("Move")
        browser.slide("joint4 °", 100)
        browser.until(lambda: any(label.startswith("Go there: the arm moves") for label in browser.buttons()))
    finally:
        browser.close_beside()
    browser.tab("Move")
    browser.until(lambda: browser.slider("joint4 °") == 100)
    browser.press("Sliders back to the arm")
    browser.until(lambda: browser.slider("joint4 °") == pytest.approx(arm.position_deg(4), abs=0.06))


def test_the_end_of_the_control_process_is_told_and_the_next_one_followed(arm: ViewedArm, browser: Browser) -> None:
    arm.loop.process.send_signal(signal.SIGKILL)
    arm.loop.process.wait()
    browser.until(lambda: "start it again" in browser.said("trouble"))
    assert browser.text("#rt-mode") == "waiting"
    filters = browser.driver.execute_script("return getComputedStyle(document.querySelector('canvas')).filter")
    assert "grayscale" in filters
    browser.keep("view_ended")
    arm.start_loop()
    browser.until(lambda: browser.text("#rt-mode") == "holding")
    assert browser.said("trouble") == ""


def test_a_fault_is_told_with_what_to_do(browser: Browser, new_arm_name: Callable[[], str], tmp_path: Path) -> None:
    with closing(ViewedArm(f"{PICTURED}_2" if PICTURED else new_arm_name(), tmp_path)) as arm:
        arm.start_sim()
        arm.start_loop()
        arm.start_view()
        browser.open(arm.url)
        arm.sim.process.send_signal(signal.SIGSTOP)  # silent drives
        browser.until(lambda: browser.text("#rt-mode") == "fault")
        arm.sim.process.send_signal(signal.SIGCONT)
        assert "No drive of the simulated arm has answered" in browser.said("problem")
        assert "rtarm clear-fault" in browser.said("problem")
        browser.keep("view_fault")
        browser.press("Clear fault")
        browser.until(lambda: "is cleared" in browser.said("answer"))
        arm.until(lambda report: report["fault"] is None)


def test_a_chinese_page_says_nothing_in_english(
    browser: Browser, new_arm_name: Callable[[], str], tmp_path: Path
) -> None:
    with closing(ViewedArm(new_arm_name(), tmp_path)) as arm:
        arm.start_sim()
        arm.start_loop()
        arm.start_front()
        arm.start_view("--language", "zh")
        browser.open(arm.url)
        browser.until(lambda: browser.text("#rt-mode") == "保持")
        browser.tab("运动")
        browser.slide("joint1 °", 20.0)
        browser.press("前往：机械臂将运动")
        browser.until(lambda: "目标已到达：最大误差是" in browser.said("answer"))
        browser.press("暂停")
        browser.until(lambda: "静止" in browser.said("answer") and browser.text("#rt-mode") == "已暂停")
        browser.press("继续")
        browser.until(lambda: "重新接受目标" in browser.said("answer"))
        arm.sim.process.send_signal(signal.SIGSTOP)  # silent drives
        browser.until(lambda: browser.text("#rt-mode") == "故障")
        assert "仿真机械臂没有一个驱动器应答" in browser.said("problem")
        for tab in ("运动", "关节", "事件", "机器"):
            browser.tab(tab)
            browser.until(lambda: browser.selected_tab() == tab)  # noqa: B023
            assert english_in(browser.page_text()) == set(), tab
        arm.sim.process.send_signal(signal.SIGCONT)
        browser.press("清除故障")
        browser.until(lambda: "故障已清除" in browser.said("answer"))
        arm.loop.process.send_signal(signal.SIGKILL)
        arm.loop.process.wait()
        browser.until(lambda: "没有正常结束就不在了" in browser.said("trouble"))


def test_joints_are_taken_where_they_read_only_after_the_angles_were_shown(
    browser: Browser, new_arm_name: Callable[[], str], tmp_path: Path
) -> None:
    name = f"{PICTURED}_3" if PICTURED else new_arm_name()
    with closing(ViewedArm(name, tmp_path, start_deg=(10.0, -20.0, 15.0, 30.0, -25.0, 40.0))) as arm:
        arm.change(limits=PATIENT)
        arm.start_sim()
        # it was silent when no mark was kept that could prove its power
        reference_store.keep_lost_reference(load_arm(arm.arm_file), 1, Unreferenced.SILENT)
        arm.start_loop()
        arm.start_view()
        browser.open(arm.url)
        arm.sim.say("power-loss:joint=joint5,at_s=0,off_s=4")
        arm.until(lambda report: report["fault"] is not None and report["joints"][4]["age_ms"] < 100.0)
        browser.until(lambda: browser.text("#rt-mode") == "fault")
        assert not any(label.startswith("Confirm where the joints") for label in browser.buttons())
        browser.press("Clear fault")
        browser.press("Confirm where the joints stand")
        browser.until(lambda: "Leave it as it is" in browser.buttons())
        silent, dark = browser.texts("[data-say=reading]")
        assert silent.startswith("joint2-20.0") and "was silent for too long" in silent
        assert dark == "joint5-The drive of joint5 may have lost power"
        assert "rtarm reference joint5=DEGREES" in browser.said("no_angle")
        browser.keep("view_reference")
        browser.press("Leave it as it is")
        browser.until(lambda: "Leave it as it is" not in browser.buttons())
        assert [joint["referenced"] for joint in arm.status()["joints"]] == [True, False, True, True, False, True]
        browser.press("Confirm where the joints stand")
        browser.press("They stand there")
        browser.until(lambda: "Taken: joint2 -20.0" in browser.said("answer"))
        assert [joint["referenced"] for joint in arm.status()["joints"]] == [True, True, True, True, False, True]
        browser.press("Confirm where the joints stand")
        browser.until(lambda: "Leave it as it is" in browser.buttons())
        assert "They stand there" not in browser.buttons(), "what counts from nowhere can only be told"
        requests.let_go(arm.name, Request.FREE)
        browser.press("Leave it as it is")
        browser.until(lambda: not any(label.startswith("Confirm where the joints") for label in browser.buttons()))
