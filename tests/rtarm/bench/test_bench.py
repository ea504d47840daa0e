"""`rtarm bench`: its arithmetic as pure functions, its baselines' frames, and once everything with tiny slices."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_trials import impossible
from rich.console import Console

from config.loader import load_arm
from rtarm.bench import plot
from rtarm.bench.competitors import PlainLoop
from rtarm.bench.lateness import (
    PERCENTS,
    as_pairs,
    empty,
    figures_us,
    from_cyclictest,
    from_pairs,
    merged,
    recorded,
    spread,
    survival,
)
from rtarm.bench.load import described, loaded
from rtarm.bench.machine import machine, versions
from rtarm.bench.motion import WAYPOINT_S, there_and_back
from rtarm.bench.python_arm import Path as JointPath
from rtarm.bench.python_arm import PythonArm
from rtarm.bench.report import render
from rtarm.bench.results import LOADS, WHO, Measurements, Slice, document, missed_cycles
from rtarm.bench.run import Extent, absent, run_bench
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.reporter import Reporter
from rtarm.launch.own_domain import own_domain
from rtarm.why_late.causes import Cause
from rtarm.why_late.divide import Segment
from rtarm.why_late.watch import Late
from shm import files

ROOT = Path(__file__).resolve().parents[3]
SCHEDULING = {"policy": "other", "priority": 0, "memory_locked": False, "cpu": None, "dma_latency_held": False}
# Beyond 2**36 ns (a minute) everything lies in the last bucket.
LATE_NS = st.integers(min_value=0, max_value=2**36)
MANY = st.lists(LATE_NS, min_size=1, max_size=50)


def same(one: np.void, other: np.void, *names: str) -> bool:
    return all(np.array_equal(one[name], other[name]) for name in names)


# --- histograms -----------------------------------------------------------------------------------------


@given(st.lists(MANY, max_size=5))
def test_merging_parts_is_recording_the_whole(parts: list[list[int]]) -> None:
    whole = [value for part in parts for value in part]
    found = merged(recorded(part) for part in parts)
    assert same(found, recorded(whole), "buckets", "count", "sum_ns", "max_ns")
    assert same(found, merged(recorded(part) for part in reversed(parts)), "buckets", "count", "sum_ns", "max_ns")


@given(MANY)
def test_percentiles_are_at_most_a_bucket_above_the_true_ones(values: list[int]) -> None:
    found, ranked = figures_us(recorded(values)), sorted(values)
    assert found["count"] == len(values)
    assert found["max"] == max(values) * 1e-3
    for name, percent in PERCENTS.items():
        true_us = ranked[math.ceil(percent / 100.0 * len(values)) - 1] * 1e-3
        assert true_us <= found[name] * (1 + 1e-12)
        assert found[name] <= true_us * 1.0323 + 1e-3
    assert found["p50"] <= found["p90"] <= found["p99"] <= found["p99_9"] <= found["max"]


@given(MANY)
def test_what_json_keeps_is_the_same_histogram(values: list[int]) -> None:
    kept = recorded(values)
    back = from_pairs(json.loads(json.dumps(as_pairs(kept))))
    assert same(back, kept, "buckets", "count", "max_ns")
    assert as_pairs(back) == as_pairs(kept)


@given(MANY)
def test_survival_falls_from_one(values: list[int]) -> None:
    late_us, share = survival(recorded(values))
    assert share[0] == 1.0
    assert np.all(np.diff(share) < 0) and np.all(np.diff(late_us) > 0)
    assert late_us[-1] == max(values) * 1e-3
    assert share[-1] >= 1 / len(values) * (1 - 1e-12)


def test_nothing_recorded_is_no_error() -> None:
    assert figures_us(empty()) == {"p50": 0.0, "p90": 0.0, "p99": 0.0, "p99_9": 0.0, "max": 0.0, "count": 0}
    assert as_pairs(recorded([])) == []
    assert recorded([-5])["max_ns"] == 0  # a wake-up before its time is not late


@given(st.lists(st.floats(min_value=0.1, max_value=1e6), min_size=1))
def test_spread(values: list[float]) -> None:
    found = spread(values)
    assert found["lowest"] <= found["median"] <= found["highest"]  # type: ignore[operator]
    assert found["repeats"] == len(values)
    assert spread([])["median"] is None


def test_missed_cycles_are_the_deadlines_that_passed() -> None:
    ms = 1_000_000
    assert missed_cycles(recorded([0, 20_000, 900_000]), ms) == 0
    assert missed_cycles(recorded([20_000, 1_500_000, 7_500_000]), ms) == 8


# --- cyclictest -----------------------------------------------------------------------------------------

CYCLICTEST = """# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000001 000002
000002 000500
000003 000000
000004 000001
# Total: 000000503
# Min Latencies: 00001
# Avg Latencies: 00002
# Max Latencies: {most}
# Histogram Overflows: {overflows}
# Histogram Overflow at cycle number:
# Thread 0: {cycles}
"""


def test_cyclictest_histogram() -> None:
    found = from_cyclictest(CYCLICTEST.format(most="00004", overflows="00000", cycles=""))
    assert (int(found["count"]), int(found["max_ns"])) == (503, 4500)
    assert figures_us(found)["p50"] == pytest.approx(2.5, rel=0.032)


def test_cyclictest_overflows_count_as_its_maximum() -> None:
    found = from_cyclictest(CYCLICTEST.format(most="12345", overflows="00002", cycles="00017 00018"))
    assert (int(found["count"]), int(found["max_ns"])) == (505, 12_345_500)
    assert as_pairs(found)[-1] == [12_345_500, 2]


@pytest.mark.parametrize("text", ["", "Unable to change scheduling policy!\n", "# Histogram\n# Max Latencies: 00003\n"])
def test_what_is_no_histogram_of_cyclictest(text: str) -> None:
    with pytest.raises(ValueError, match="no histogram"):
        from_cyclictest(text)


# --- the document ---------------------------------------------------------------------------------------


def sliced(values_ns: list[int], processor_ns: int = 1_000_000, trouble: str = "") -> Slice:
    return Slice(recorded(values_ns), 1.0, {"process": processor_ns}, SCHEDULING, trouble)


def measurements(values: list[list[int]], rates: list[int]) -> Measurements:
    """Every competitor with the same slices, which everybody but rtarm spends twice the time on."""
    measured = Measurements()
    for repeat in values:
        for rate in rates:
            for load in LOADS:
                for who in WHO:
                    measured.add(rate, who, load, sliced(repeat, 1_000_000 if who == "rtarm" else 2_000_000))
    return measured


@settings(deadline=None)
@given(
    st.lists(st.lists(st.integers(min_value=1, max_value=10**9), min_size=1, max_size=20), min_size=1, max_size=5),
    st.lists(st.sampled_from([200, 500, 1000]), unique=True, min_size=1),
)
def test_shape_of_the_document(values: list[list[int]], rates: list[int]) -> None:
    found = json.loads(json.dumps(document(measurements(values, rates)), allow_nan=False))
    assert set(found["lateness_us"]) == set(WHO)
    for who in WHO:
        assert set(found["lateness_us"][who]) == {str(rate) for rate in rates}
        for rate in map(str, rates):
            assert set(found["lateness_us"][who][rate]) == set(LOADS)
            for load in LOADS:
                figures = found["lateness_us"][who][rate][load]
                assert set(figures) == {"p50", "p90", "p99", "p99_9", "max", "count"}
                assert figures["count"] == sum(map(len, values))
                assert figures["max"] == max(max(repeat) for repeat in values) * 1e-3
    for name, by_rate in found["ratios"].items():
        for by_load in by_rate.values():
            for figures in by_load.values():
                for figure in ("p50", "p99", "p99_9", "max"):
                    expected = {"median": 1.0, "lowest": 1.0, "highest": 1.0, "repeats": len(values)}
                    assert figures[figure] == expected
                if name == "rtarm_to_cyclictest":
                    assert "processor_time" not in figures
                else:
                    assert figures["processor_time"]["median"] == 2.0


def test_ratios_are_of_slices_that_alternated() -> None:
    measured = Measurements()
    for ours, theirs in ((10_000, 20_000), (40_000, 20_000), (20_000, 20_000)):
        measured.add(1000, "rtarm", "idle", sliced([ours]))
        measured.add(1000, "cyclictest", "idle", sliced([theirs]))
    found = document(measured)["ratios"]
    assert set(found) == {"rtarm_to_cyclictest"}
    assert found["rtarm_to_cyclictest"]["1000"]["idle"]["max"] == {
        "median": 1.0,
        "lowest": 0.5,
        "highest": 2.0,
        "repeats": 3,
    }


def test_ratio_to_no_lateness_at_all_is_left_out() -> None:
    measured = Measurements()
    measured.add(1000, "rtarm", "idle", sliced([5]))
    measured.add(1000, "cyclictest", "idle", sliced([0]))
    assert document(measured)["ratios"]["rtarm_to_cyclictest"]["1000"]["idle"]["max"]["median"] is None


def test_links_of_the_chain_are_of_those_who_have_them() -> None:
    states = {"count": 3, "rate_hz": 100.0, "interval_ms": {"p50": 10.0, "p99": 11.0, "max": 12.0}, "age_ms": None}
    measured = Measurements()
    measured.add(1000, "cyclictest", "idle", replace(sliced([5]), seconds=None))
    ours = replace(sliced([5]), cycle_time=recorded([7_000]), joint_states=states, goal_ms=4.0)
    measured.add(1000, "rtarm", "idle", ours)
    measured.add(1000, "one_node", "idle", replace(sliced([5]), joint_states=states))
    found = document(measured)
    chain = found["chain"]
    assert {link: set(by_who) for link, by_who in chain.items()} == {
        "wake_up_to_written_us": {"rtarm"},
        "stamp_to_subscriber_ms": set(),
        "between_joint_states_ms": {"rtarm", "one_node"},
        "goal_sent_to_first_setpoint_ms": {"rtarm"},
    }
    assert chain["wake_up_to_written_us"]["rtarm"]["1000"]["idle"]["max"] == 7.0
    assert chain["between_joint_states_ms"]["rtarm"]["1000"]["idle"]["max"]["median"] == 12.0
    assert set(found["obtained_hz"]) == {"rtarm", "one_node"}  # cyclictest is told a number of cycles


def told(**more: Any) -> dict[str, Any]:
    measured = measurements([[1_000, 987_654_321]] * 2, [200, 1000])
    for who in WHO:
        trouble = "The front was lost." if who == "rtarm" else ""
        measured.add(1000, who, "loaded", sliced([3], trouble=trouble))
    wires = {"200": "arm simulated behind a terminal, CAN at 1 Mbit/s", "1000": "no bus (mock drives, virtual CAN)"}
    return {
        **document(measured),
        "machine": machine(),
        "versions": versions(),
        "load": "stress-ng",
        "wires": wires,
        "notes": [],
        **more,
    }


def test_tables_fit_eighty_columns() -> None:
    console = Console(file=io.StringIO(), width=80)
    console.print(render(told(notes=["A remark."])))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert all(len(line) <= 80 for line in text.splitlines())
    for word in (
        "p99.9",
        "987654",
        "cyclictest",
        "one_node / rtarm",
        "1000 Hz loaded",
        "The front was lost.",
        "A remark.",
    ):
        assert word in text
    assert "CPU µs" in text and "… " not in text


def test_causes_stand_where_they_were_traced() -> None:
    assert "causes" not in document(measurements([[1]], [200]))
    measured = Measurements()
    disk = Segment(0, 400_000, Cause.INTERRUPT, "disk"), Segment(400_000, 412_000, Cause.OWN)
    late = Late.of(1, True, disk), Late.of(2, True, (Segment(0, 200_000, Cause.TASK, "hog 2"),))
    measured.add(200, "rtarm", "idle", replace(sliced([412_000]), late=late))
    measured.add(200, "rtarm", "loaded", replace(sliced([1]), late=()))
    found = document(measured)["causes"]["rtarm"]["200"]
    assert [one["cause"] for one in found["idle"]] == ["interrupt", "other_task", "own_work"]
    assert found["loaded"] == []
    console = Console(file=io.StringIO(), width=200)
    console.print(render(told(causes={"rtarm": {"200": found}})))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "rtarm, 200 Hz idle, the latest: 412 µs, interrupt, disk" in text
    assert "interrupt 65%, another task 33%, our own work 2%" in text


@pytest.mark.process
@pytest.mark.skipif(bool(impossible()), reason=impossible())
def test_why_the_cycles_of_a_run_were_late(tmp_path: Path) -> None:
    extent = Extent((200,), repeats=1, slice_s=0.5, longest_s=60.0, who=("rtarm",))
    console = Console(file=io.StringIO(), width=80)
    assert run_bench(extent, tmp_path / "figures.json", None, Reporter(console), why=True) == ExitCode.DONE
    found = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert set(found["causes"]["rtarm"]["200"]) == set(LOADS)
    assert any("--why" in remark for remark in found["notes"])


def test_plot(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for name in ("curve.png", "curve.svg"):
        plot.check(tmp_path / name)
        plot.draw(told(), tmp_path / name)
        assert (tmp_path / name).stat().st_size > 1000


def test_plot_is_refused_before_anything_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plot, "has_module", lambda _: True)
    with pytest.raises(Refusal, match=r"curve.txt is no name of a picture: .*\.png"):
        plot.check(Path("curve.txt"))
    monkeypatch.setattr(plot, "has_module", lambda _: False)
    with pytest.raises(Refusal, match="matplotlib is not installed"):
        plot.check(Path("curve.png"))


def test_machine_and_versions_are_json() -> None:
    assert json.loads(json.dumps([machine(), versions()]))[0]["processors"] >= 1
    assert versions()["numba"] is not None


def test_who_is_absent_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rtarm.bench.run.shutil.which", lambda _: None)
    monkeypatch.setattr("rtarm.bench.run.has_module", lambda name: name == "can")
    found = absent()
    assert set(found) == {"cyclictest", "one_node", "plain_loop", "one_node_fifo"}
    assert "for want of pyserial and loop-rate-limiters:" in found["plain_loop"]


def test_cyclictest_is_left_out_where_it_may_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "cyclictest"
    program.write_text("#!/bin/sh\necho 'Unable to change scheduling policy!' >&2\necho more >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    assert absent()["cyclictest"].startswith(
        "cyclictest is left out, since it may not run here (Unable to change scheduling policy!): "
    )


# --- what the baselines do ------------------------------------------------------------------------------


@given(st.floats(min_value=0.5, max_value=20.0), st.lists(st.floats(min_value=-1.0, max_value=1.0), min_size=1))
def test_goal_goes_there_and_comes_back(duration_s: float, start_rad: list[float]) -> None:
    goal = there_and_back([f"joint{i}" for i in range(len(start_rad))], start_rad, duration_s)
    path = JointPath(goal)
    points = goal["trajectory"]["points"]
    assert path.duration_s == pytest.approx(duration_s)
    for end in (points[0], points[-1]):
        assert end["positions"] == pytest.approx(start_rad, abs=1e-12)
        assert end["velocities"] == pytest.approx([0.0] * len(start_rad), abs=1e-12)
    # The cubic between the points goes where the points' velocities say.
    for time_s in np.linspace(WAYPOINT_S, duration_s - WAYPOINT_S, 7):
        slope = (path.at(time_s + 1e-4)[0] - path.at(time_s - 1e-4)[0]) / 2e-4
        turn = 2.0 * math.pi / duration_s
        planned = 0.5 * 0.03 * duration_s * turn * math.sin(turn * time_s)
        assert slope == pytest.approx(planned, abs=2e-3)
    for point in points:
        at_s = point["time_from_start"]["sec"] + point["time_from_start"]["nanosec"] * 1e-9
        assert path.at(at_s) == pytest.approx(point["positions"], abs=1e-9)


def test_baselines_send_what_our_cycle_sends() -> None:
    """Joint 1 at 0 stands 180° · 25 / 360° = 12.5 motor turns from its stop."""
    config = load_arm("episode1", overrides={"bus": {"channel": "none"}})
    with (
        contextlib.closing(PythonArm(config, None)) as arm,
        can.Bus(interface="virtual", channel="rtarm_bench") as drives,
    ):
        arm.cycle([0.0] * 6)
        frames = [drives.recv(1.0) for _ in range(19)]
        assert drives.recv(0) is None
        reply = can.Message(arbitration_id=0x100, data=b"\x36\x00\x00\x0c\x80\x00\x6b", is_extended_id=True)
        arm.listen()
        drives.send(reply)  # 12.5 turns of 65536
        while math.isnan(arm.measured_rad[0]):
            time.sleep(0.001)
    sent = [(frame.arbitration_id, bytes(frame.data)) for frame in frames if frame is not None]
    assert sent[:2] == [(0x100, b"\xfd\x00\x00\x64\xc8\x00\x00\x9c"), (0x101, b"\xfd\x40\x01\x00\x6b")]  # 40,000 pulses
    assert sent[12:18] == [(joint << 8, b"\x36\x6b") for joint in range(1, 7)]
    assert sent[18][1] == b"\x3a\x6b"
    assert arm.measured_rad[0] == pytest.approx(0.0)


def test_resting_baselines_do_not_poll() -> None:
    arm = PythonArm(load_arm("mock"), None)
    before = set(threading.enumerate())
    arm.listen()
    assert set(threading.enumerate()) > before
    arm.rest()
    assert set(threading.enumerate()) == before
    arm.close()


# --- all of it ------------------------------------------------------------------------------------------


def arms_left() -> list[Path]:
    return list(files.DIRECTORY.glob("rtarm.bench_*"))


@pytest.mark.process
def test_own_load_where_there_is_no_stress_ng(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rtarm.bench.load.shutil.which", lambda _: None)

    async def busy() -> None:
        async with loaded(tmp_path, wanted=True):
            while not list(tmp_path.glob("hog.*")):  # the last one that is started
                await asyncio.sleep(0.01)

    used_s = os.times().children_user
    asyncio.run(busy())
    assert os.times().children_user > used_s
    assert "own hogs" in described()


@pytest.mark.process
def test_everything_with_tiny_slices(tmp_path: Path) -> None:
    console = Console(file=io.StringIO(), width=80)
    extent = Extent((200,), repeats=1, slice_s=0.3, longest_s=60.0)
    assert run_bench(extent, tmp_path / "figures.json", None, Reporter(console)) == ExitCode.DONE
    found = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert {"rtarm", "one_node"} <= set(found["lateness_us"]) <= set(WHO)
    for by_rate in found["lateness_us"].values():
        for load in LOADS:
            assert by_rate["200"][load]["count"] > 0
    assert found["scheduling"]["rtarm"]["policy"] in {"fifo", "other"}
    assert found["wires"]["200"].startswith("arm simulated")
    assert arms_left() == []


OF_EVERY_NODE = {"/rosout", "/parameter_events"}


@contextlib.contextmanager
def overheard(domain: int) -> Iterator[set[str]]:
    """All names that come up meanwhile in a ROS domain."""
    import rclpy
    from rclpy.node import Node
    from ros_client import names_seen

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node("overhearing", context=context, enable_rosout=False, start_parameter_services=False)
    seen, over = set[str](), threading.Event()

    def look() -> None:
        while not over.wait(0.02):
            seen.update(names_seen(node))

    looking = threading.Thread(target=look)
    looking.start()
    try:
        yield seen
    finally:
        over.set()
        looking.join()
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.process
def test_nothing_of_it_has_a_name_that_an_arm_may_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither goals of ours for an arm of somebody's in the same domain, nor the other way round."""
    pytest.importorskip("rclpy")
    environment = own_domain()
    monkeypatch.setattr("rtarm.bench.run.own_domain", lambda: environment)
    extent = Extent((1000,), repeats=1, slice_s=0.3, longest_s=60.0, who=("rtarm", "one_node"))
    silent = Reporter(Console(file=io.StringIO()))
    with overheard(int(environment["ROS_DOMAIN_ID"])) as names, contextlib.suppress(Refusal):  # of a busy machine
        run_bench(extent, None, None, silent)
    actions = {name for name in names if name.endswith("/follow_joint_trajectory/_action/send_goal")}
    assert len(actions) == 2  # of both
    assert {name for name in names if not name.startswith(("/bench_", "/overhearing"))} <= OF_EVERY_NODE


@pytest.mark.process
def test_what_was_measured_survives_a_competitor_that_dies(tmp_path: Path) -> None:
    """After the first round a baseline's process dies each time that it is to be measured."""
    rounds = 0

    class Dies(PlainLoop):
        async def measure(self, seconds: float) -> Slice:
            if rounds > len(LOADS):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(self._partner.pid, signal.SIGKILL)
            return await super().measure(seconds)

        async def prepare(self, seconds: float) -> None:
            nonlocal rounds
            rounds += 1
            await super().prepare(seconds)

    console = Console(file=io.StringIO(), width=200)
    extent = Extent((200,), repeats=3, slice_s=0.3, longest_s=100.0, who=("plain_loop",))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rtarm.bench.run.everybody", lambda bench, _: [Dies(bench)])
        code = run_bench(extent, tmp_path / "figures.json", None, Reporter(console))
    assert code == ExitCode.REFUSED
    found = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert found["lateness_spread_us"]["plain_loop"]["200"]["idle"]["max"]["repeats"] == 1
    assert "plain_loop could not be measured (idle): plain_loop ended by SIGKILL" in " ".join(found["notes"])


@pytest.mark.process
@pytest.mark.parametrize(("line", "kept"), [("repeat 1 ", False), ("repeat 2 ", True)])
def test_control_c_keeps_what_was_measured(line: str, kept: bool, tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path; from rich.console import Console; from rtarm.bench.run import *;"
        "from rtarm.console.errors import Refusal\n"
        "extent = Extent((200,), repeats=3, slice_s=0.3, longest_s=1000.0, who=('rtarm', 'plain_loop'))\n"
        "try: sys.exit(run_bench(extent, Path(sys.argv[1]), None, Reporter(Console())))\n"
        "except Refusal as refusal: sys.exit(refusal.sentence)"
    )
    file = tmp_path / "figures.json"
    with subprocess.Popen(
        [sys.executable, "-c", program, str(file)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        for said in process.stdout:
            if line in said:
                break
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=60.0)
    assert process.returncode == ExitCode.REFUSED
    if kept:
        assert "The benchmark was ended by SIGINT before it was complete." in output
        ratios = json.loads(file.read_text())["ratios"]["plain_loop_to_rtarm"]["200"]
        assert {load: ratios[load]["max"]["repeats"] for load in LOADS} == dict.fromkeys(LOADS, 1)
    else:
        assert errors.strip() == "The benchmark was ended by SIGINT before it was complete. Nothing was measured."
        assert not file.exists()
    assert arms_left() == []
