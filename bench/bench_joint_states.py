"""/joint_states while a goal runs, beside a plain rclpy timer node with the same message at the same rate.

Both publish at the same time to the same subscriber. Arrivals are the middleware's own reception times, taken in its
receiving thread, so that the subscriber's Python does not count; a callback's time is that at which rclpy has called
it. The age is the time since the stamp: the plain node stamps a message when it makes it, the front with the time of
its newest measurement, which a mock arm takes in the very cycle. A processor's share is utime + stime of the whole
process, of one core.
"""

import struct
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from live import Usage, commanded_rad, goal_to, in_words, live, percentiles
from rclpy.qos import QoSProfile
from ros_client import until
from sensor_msgs.msg import JointState
from stack import Process

from shm.words import Mode

WINDOW_S = 20.0
HIGHEST_HZ = 2000.0
STAMP = struct.Struct("<iI")
STAMP_AT = 4  # behind the encapsulation header


class Listener:
    """Stamp, reception time and time of the callback (epoch ns) of every message on a topic."""

    def __init__(self, node, topic: str) -> None:
        self.heard: list[tuple[int, int, int]] = []
        # raw: building the message would cost this process more than everything else
        node.create_subscription(JointState, topic, self._hear, QoSProfile(depth=2000), raw=True)

    def _hear(self, data: bytes, info: dict) -> None:
        sec, nanosec = STAMP.unpack_from(data, STAMP_AT)
        self.heard.append((sec * 1_000_000_000 + nanosec, info["received_timestamp"], time.time_ns()))


def shares(processes: list[Process], seconds: float) -> list[float]:
    """Per cent of a core that each process uses from now on."""
    before, begun = [Usage(process).processor_s for process in processes], time.monotonic()
    time.sleep(seconds)
    after, passed = [Usage(process).processor_s for process in processes], time.monotonic() - begun
    return [100 * (b - a) / passed for a, b in zip(before, after, strict=True)]


@pytest.mark.benchmark(group="live")
@pytest.mark.parametrize("rate_hz", [100.0, 120.0, HIGHEST_HZ], ids=["100", "120", "highest"])
def test_joint_states(benchmark, report, tmp_path, rate_hz):
    """Of a mock arm, at 120 Hz of episode1 behind the simulated adapter."""

    def measure():
        with live(tmp_path, mock_hz=None if rate_hz == 120.0 else rate_hz) as stack:
            plain = Process("bench.plain_joint_states", str(rate_hz), needs_ros=True)
            try:
                plain.line_with("ready")
                ours = Listener(stack.client.node, "joint_states")
                theirs = Listener(stack.client.node, "plain_joint_states")
                until(lambda: ours.heard and theirs.heard, "a message of each")
                stack.client.send(goal_to(commanded_rad(stack) + 0.3, WINDOW_S + 4.0))
                until(lambda: stack.reader.snapshot()["mode"] == Mode.EXECUTING, "motion")
                first = len(ours.heard), len(theirs.heard)
                share = shares([stack.front, plain, stack.loop], WINDOW_S)
                assert stack.reader.snapshot()["mode"] == Mode.EXECUTING
                return share, ours.heard[first[0] :], theirs.heard[first[1] :]
            finally:
                plain.close()

    share, *heard = benchmark.pedantic(measure, rounds=1)
    report(f"/joint_states at {rate_hz:g} Hz while a goal runs", f"interval {1000 / rate_hz:.3f} ms")
    report("  control process: share of a core", f"{share[2]:.1f} %")
    for who, used, messages in zip(("front", "plain timer node"), share[:2], heard, strict=True):
        stamps_ns, arrivals_ns, called_ns = np.array(messages).T
        figures = {"core_percent": used, "messages_a_second": len(messages) / WINDOW_S}
        words = "aim ≤ 3 %: " if who == "front" and rate_hz == 120.0 else ""
        report(f"  {who}: share of a core", f"{words}{used:.1f} %, {figures['messages_a_second']:.1f} messages/s")
        for what, times_ns in (("stamps", stamps_ns), ("arrivals", arrivals_ns)):
            figures[what] = percentiles(np.diff(times_ns) / 1e6, 50, 99, 99.9)
            report(f"  {who}: interval of {what}", f"{in_words(figures[what], 3)} ms")
        for what, times_ns in (("arrival", arrivals_ns), ("callback", called_ns)):
            figures[f"age_ms at {what}"] = percentiles((times_ns - stamps_ns) / 1e6, 50, 99, 99.9)
            report(f"  {who}: age at the {what}", f"{in_words(figures[f'age_ms at {what}'], 3)} ms")
        benchmark.extra_info[who] = figures
