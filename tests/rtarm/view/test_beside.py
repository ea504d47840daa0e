"""`rtarm up --view` and `rtarm demo --view`: the page beside the arm, with the real processes."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("viser")
pytest.importorskip("rclpy")

from plain_viewer import PlainViewer
from stack import Process
from waiting import until
from working_threads import niceness_at_work

from rtarm.running.status import read_status
from shm import files

pytestmark = pytest.mark.process

RECORDED = Path(__file__).resolve().parents[2] / "data" / "moveit"
ADDRESS = re.compile(r"view   ready, open (http://127\.0\.0\.1:\d+/[\w-]{43}/)")


@pytest.fixture
def up(mock_file: Path) -> Iterator[Process]:
    process = Process("rtarm", "up", str(mock_file), "--view", needs_ros=True)
    yield process
    process.close()


def address(process: Process) -> str:
    found = ADDRESS.search(process.line_with("view   ready, open"))
    assert found is not None
    return found[1]


def page_status(url: str) -> int:
    parts = urlsplit(url)
    assert parts.hostname is not None
    with closing(http.client.HTTPConnection(parts.hostname, parts.port, timeout=60.0)) as connection:
        connection.request("GET", parts.path)
        return connection.getresponse().status


def pid_of(process: Process, module: str = "rtarm.view") -> int:
    """The child that runs a module."""
    arguments = ["ps", "-o", "pid=,args=", "--ppid", str(process.process.pid)]
    lines = subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.splitlines()
    (pid,) = [int(line.split()[0]) for line in lines if f"-m {module} " in line]
    return pid


def domain_of(pid: int) -> list[bytes]:
    """What a process was told of the ROS domain."""
    words = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    return sorted(word for word in words if word.startswith(b"ROS_"))


def test_the_page_stands_beside_the_arm_and_ends_with_it(up: Process, arm_name: str) -> None:
    url = address(up)
    assert page_status(url) == 200
    with PlainViewer(url) as viewer:
        viewer.wait_for_page()
        pid = pid_of(up)
        assert niceness_at_work(pid) == {19}
    up.process.send_signal(signal.SIGINT)
    assert up.code() == 0
    assert up.text.endswith("rtarm  ended in order")
    assert not Path(f"/proc/{pid}").exists()
    with pytest.raises(ConnectionRefusedError):
        page_status(url)


def test_a_page_that_dies_takes_nothing_with_it(up: Process, arm_name: str) -> None:
    url = address(up)
    assert page_status(url) == 200
    before = read_status(arm_name)
    os.kill(pid_of(up), signal.SIGKILL)
    up.line_with("view   the page ended by SIGKILL; the arm goes on, and `rtarm view` opens a new page")
    after = read_status(arm_name)
    assert after["healthy"]
    assert [after[one]["pid"] for one in ("loop", "front")] == [before[one]["pid"] for one in ("loop", "front")]
    up.process.send_signal(signal.SIGINT)
    assert up.code() == 0


def test_a_page_ends_when_rtarm_up_is_killed(up: Process, arm_name: str) -> None:
    address(up)
    pid, loop = pid_of(up), read_status(arm_name)["loop"]["pid"]
    up.process.kill()
    until(lambda: not (Path(f"/proc/{pid}").exists() or Path(f"/proc/{loop}").exists()), "the end of its processes")


def test_without_viser_nothing_is_started(mock_file: Path, arm_name: str) -> None:
    """It is said before any drive is touched."""
    program = (
        "import importlib.util, sys\n"
        "find = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name, *more: None if name == 'viser' else find(name, *more)\n"
        "from rtarm.cli.application import app\napp()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "up", str(mock_file), "--view"],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1
    assert done.stderr == "viser is not installed, and this needs it: `pip install viser`, then try again.\n"
    assert done.stdout == ""
    assert not list(files.DIRECTORY.glob(f"rtarm.{arm_name}.*"))


def test_the_demo_waits_for_a_browser_plays_and_stays(arm_file: Path, arm_name: str, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    demo = Process(
        *("rtarm", "demo", "--view", "--arm", str(arm_file)),
        *("--goal", str(RECORDED / "small.json"), "--json", str(figures)),
        needs_ros=True,
    )
    try:
        url = address(demo)
        assert "small" not in demo.text
        with PlainViewer(url):
            demo.line_with("1 of 1 goals succeeded")
            demo.line_with(f"the arm stays, to be moved from its page {url}; Ctrl-C ends all")
            assert json.loads(figures.read_text(encoding="utf-8"))["succeeded"]
            (name,) = [arm for arm in files.running_arms() if arm.startswith(f"{arm_name}_demo_")]
            assert read_status(name)["running"]
            # Or the page's goals would go to another arm.
            assert domain_of(pid_of(demo)) == domain_of(pid_of(demo, "rosfront"))
            page = Path(f"/proc/{pid_of(demo)}/cmdline").read_text().split("\0")
            assert page[page.index("--namespace") + 1] == f"/{name}"
        assert page_status(url) == 200
        demo.process.send_signal(signal.SIGINT)
        assert demo.code() == 0
        assert not list(files.DIRECTORY.glob(f"rtarm.{arm_name}*"))
    finally:
        demo.close()
