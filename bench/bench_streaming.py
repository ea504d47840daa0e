"""~/joint_trajectory as MoveIt Servo uses it: windows of points 0.1 s behind to 0.1 s ahead, at 50, 100 and 250 Hz.

The latency of a message is the time from `publish` until the planned time of the first control cycle that runs it or
a newer one; the first 0.2 s are left out, as their stamps still lie ahead and are waited for. The n-th message that is
taken becomes the n-th goal, so it is known when none is refused; the cycles themselves are 8.3 ms apart. The front's
share is that of the whole process; the share without a stream is taken first.
"""

import math
import threading
import time
from collections import deque

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from builtin_interfaces.msg import Duration, Time
from live import NAMES, NS, LiveStack, Usage, commanded_rad, in_words, live, percentiles, point
from ros_client import until
from trajectory_msgs.msg import JointTrajectory

from shm.words import Fault, Mode

SECONDS = 15.0
IDLE_S = 5.0
CONTROL_HZ = 120.0
LATENCY_S = 0.1
SIZE_RAD, OMEGA, FADE_S = 0.08, 2.0, 1.5
LOOK_EVERY_S = 0.003


class Sender:
    """Servo's output: entries `LATENCY_S` ahead, those of the last 2 `LATENCY_S` in every message, newest withheld."""

    def __init__(self, stack: LiveStack) -> None:
        self._home = commanded_rad(stack)
        node = stack.client.node
        self._publisher = node.create_publisher(JointTrajectory, f"/controller_{stack.name}/joint_trajectory", 10)
        until(self._publisher.get_subscription_count, "the controller's subscription")
        self.published_ns: list[int] = []

    def run(self, rate_hz: float, seconds: float) -> None:
        begun, due = time.time(), time.monotonic()
        entries: deque = deque()
        while (now := time.time()) - begun < seconds:
            entries.append((now + LATENCY_S, point(0.0, *self._way(now - begun))))
            while entries[0][0] < now - LATENCY_S:
                entries.popleft()
            if len(entries) > 2:
                message = self._message(list(entries)[:-1])
                self.published_ns.append(time.monotonic_ns())
                self._publisher.publish(message)
            due += 1.0 / rate_hz
            time.sleep(max(0.0, due - time.monotonic()))

    def _way(self, t: float):
        u = min(t / FADE_S, 1.0)
        fade, rise = u * u * (3 - 2 * u), 6 * u * (1 - u) / FADE_S
        shape, speed = 1 - math.cos(OMEGA * t), OMEGA * math.sin(OMEGA * t)
        return self._home - SIZE_RAD * fade * shape, [-SIZE_RAD * (fade * speed + rise * shape)] * 6

    def _message(self, entries) -> JointTrajectory:
        first_s = entries[0][0]
        for at_s, entry in entries:
            entry.time_from_start = Duration(nanosec=round((at_s - first_s) * NS))
        message = JointTrajectory(joint_names=NAMES, points=[entry for _, entry in entries])
        message.header.stamp = Time(sec=int(first_s), nanosec=int(first_s % 1.0 * NS))
        return message


class Watcher(threading.Thread):
    """Planned time and running goal of every control cycle."""

    def __init__(self, stack: LiveStack) -> None:
        super().__init__()
        self._stack = stack
        self._leave = threading.Event()
        self.cycles: list[tuple[int, int, int]] = []

    def run(self) -> None:
        while not self._leave.wait(LOOK_EVERY_S):
            snapshot = self._stack.reader.snapshot()
            seen = snapshot["cycle"], snapshot["monotonic_ns"], snapshot["goal_id"]
            if not self.cycles or seen[0] > self.cycles[-1][0]:
                self.cycles.append(seen)

    def stop(self) -> np.ndarray:
        self._leave.set()
        self.join()
        return np.array(self.cycles)


@pytest.mark.benchmark(group="live")
@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 250.0])
def test_streaming(benchmark, report, tmp_path, rate_hz):
    def measure():
        with live(tmp_path, mock_hz=CONTROL_HZ) as stack:
            sender, watcher = Sender(stack), Watcher(stack)
            used, marks = [Usage(stack.front).processor_s], [time.monotonic()]
            time.sleep(IDLE_S)
            watcher.start()
            for stream_s in (0.0, SECONDS):
                sender.run(rate_hz, stream_s)
                used.append(Usage(stack.front).processor_s)
                marks.append(time.monotonic())
            until(lambda: stack.reader.snapshot()["mode"] == Mode.HOLDING, "a stop")
            snapshot = stack.reader.snapshot()
            assert snapshot["fault"] == Fault.NONE
            taken = int(snapshot["results"]["goal_id"].max())
            shares = 100 * np.diff(used) / np.diff(marks)
            return shares, np.array(sender.published_ns), taken, watcher.stop()

    (idle, busy), published_ns, taken, cycles = benchmark.pedantic(measure, rounds=1)
    sent = len(published_ns)
    each_ms = (busy - idle) / 100 * SECONDS / sent * 1e3
    missed = int((np.diff(cycles[:, 0]) - 1).sum())
    benchmark.extra_info.update(
        sent=sent, refused=sent - taken, core_percent=busy, idle_core_percent=idle, processor_ms_each=each_ms
    )
    report(
        f"stream at {rate_hz:g} Hz ({round(2 * LATENCY_S * rate_hz)} points each): front's share of a core",
        f"{busy:.1f} %, without {idle:.1f} %: {each_ms:.2f} ms a message; {sent} sent, {sent - taken} refused",
    )
    if taken == sent:
        first = np.searchsorted(np.maximum.accumulate(cycles[:, 2]), np.arange(1, sent + 1))
        seen = (first < len(cycles)) & (published_ns > published_ns[0] + 2 * LATENCY_S * NS)
        latency_ms = (cycles[first[seen], 1] - published_ns[seen]) / 1e6
        benchmark.extra_info["latency_ms"] = figures = percentiles(latency_ms, 50, 99)
        report("  published → running", f"{in_words(figures)} ms (cycles not looked at: {missed})")
