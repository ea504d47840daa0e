"""How late bytes arrive between real-time processes, by what carries them and by the priority of the kernel's worker.

The bytes of a serial port, as those of a pseudo-terminal, reach the line discipline by a worker of the kernel
(`kworker/u…`, flush_to_ldisc). A CAN frame, as a datagram on the loopback interface, is put into the socket's queue by
the interrupt's second half; a socket pair has nothing in between. All three are in every slice, message by message in
turn and each with a reader of its own, and the worker's priority changes from slice to slice, so that a noisy neighbour
hits all alike.

    python -m pytest bench/bench_bytes.py

As root, since the workers are the kernel's; they get back what they had. Where the kernel can be traced, one more
slice says what held the latest bytes (bench/held.py).
"""

import contextlib
import itertools
import multiprocessing
import os
import shutil
import socket
import struct
import subprocess
import threading
import time
import tty

import held
import numpy as np
import pytest
from carriers import carriers
from slices import spread

TURNS = 10
SLICE_S, TRACED_S = 5.0, 15.0
PERIOD_S = 1 / 360
"""Between two messages: each of the three ways carries as many a second as an arm has cycles."""
MESSAGE = struct.Struct("=q24x")
"""The time it was written at, and as many bytes as a frame has in SLCAN."""
SENDER, RECEIVER = 70, 71
KEPT_S = 0.025
"""Other workers take over, and a session of tests hurries them twice a second."""
SETTINGS = {
    "as it is": (os.SCHED_OTHER, None),
    "nice -20": (os.SCHED_OTHER, -20),
    "SCHED_FIFO 1": (os.SCHED_FIFO, None),
}
LOADS = {"as the machine is": [], "stress-ng --cpu 4": ["stress-ng", "--quiet", "--cpu", "4"]}
PERCENTS = {"p50_us": 50, "p99_us": 99, "latest_us": 100}
PRIORITY_REFUSED = "real-time priority was refused: these are times between ordinary processes"


def ways() -> dict[str, tuple[int, int]]:
    """Where a message is written and where it is read, by what carries it."""
    master, slave = os.openpty()
    tty.setraw(slave)
    one, other = socket.socketpair()
    into, out = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    out.bind(("127.0.0.1", 0))
    into.connect(out.getsockname())
    return {
        "pseudo-terminal": (master, slave),
        "datagram": (into.detach(), out.detach()),
        "socket pair": (one.detach(), other.detach()),
    }


def in_real_time(priority: int) -> bool:
    """Take a real-time priority; whether it was given."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        return True
    return False


def send(descriptors: list[int], seconds: float) -> None:
    """A message each period, on one way after the other; a last one of time 0 on each."""
    in_real_time(SENDER)
    due_s = time.monotonic()
    ends_s = due_s + seconds
    while due_s < ends_s:
        for descriptor in descriptors:
            due_s = max(due_s + PERIOD_S, time.monotonic())
            time.sleep(max(due_s - time.monotonic(), 0.0))
            os.write(descriptor, MESSAGE.pack(time.monotonic_ns()))
    for descriptor in descriptors:
        os.write(descriptor, MESSAGE.pack(0))


def receive(descriptor: int, answer) -> None:
    """Answers whether the priority was given, and when each message was written and how late it came, ns, (n, 2)."""
    given = in_real_time(RECEIVER)
    rest, late = b"", []
    while True:
        data = rest + os.read(descriptor, 4096)
        now_ns = time.monotonic_ns()
        whole = len(data) // MESSAGE.size * MESSAGE.size
        rest = data[whole:]
        for (sent_ns,) in MESSAGE.iter_unpack(data[:whole]):
            if not sent_ns:
                answer.send((given, np.array(late)))
                return
            late.append((sent_ns, now_ns - sent_ns))


class Workers:
    """The kernel's unbound workers, scheduled as wanted until they are given back what they had."""

    def __init__(self, policy: int, nice: int | None) -> None:
        self._wanted = policy, nice
        self._had: dict[int, tuple[int, os.sched_param, int]] = {}
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._keep)
        self._set()
        self._thread.start()

    def close(self) -> None:
        self._ends.set()
        self._thread.join()
        for pid, (policy, parameters, nice) in self._had.items():
            with contextlib.suppress(ProcessLookupError):
                os.setpriority(os.PRIO_PROCESS, pid, nice)
                os.sched_setscheduler(pid, policy, parameters)

    def _keep(self) -> None:
        while not self._ends.wait(KEPT_S):
            self._set()

    def _set(self) -> None:
        policy, nice = self._wanted
        for pid in carriers():
            with contextlib.suppress(ProcessLookupError):
                now = os.sched_getscheduler(pid)
                if pid not in self._had:
                    self._had[pid] = now, os.sched_getparam(pid), os.getpriority(os.PRIO_PROCESS, pid)
                    os.setpriority(os.PRIO_PROCESS, pid, self._had[pid][2] if nice is None else nice)
                if now != policy:
                    os.sched_setscheduler(pid, policy, os.sched_param(int(policy == os.SCHED_FIFO)))


def a_slice(setting: str, seconds: float = SLICE_S) -> tuple[bool, int, dict[str, np.ndarray]]:
    """Whether there was real-time priority, the sender's number, and the messages of each way, as `receive` answers."""
    carried = ways()
    fork = multiprocessing.get_context("fork")
    pipes = [fork.Pipe() for _ in carried]
    processes = [
        fork.Process(target=receive, args=(out, theirs))
        for (_, out), (_, theirs) in zip(carried.values(), pipes, strict=True)
    ]
    processes.append(fork.Process(target=send, args=([into for into, _ in carried.values()], seconds)))
    workers = Workers(*SETTINGS[setting])
    try:
        for process in processes:
            process.start()
        given, late = zip(*(ours.recv() for ours, _ in pipes), strict=True)
        for process in processes:
            process.join()
    finally:
        workers.close()
        for descriptor in itertools.chain(*carried.values()):
            os.close(descriptor)
    return all(given), processes[-1].pid, dict(zip(carried, late, strict=True))


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("load", LOADS)
def test_bytes(benchmark, report, load):
    if os.geteuid() != 0:
        pytest.skip("only root may change the scheduling of the kernel's workers: run it as root")
    if LOADS[load] and not shutil.which("stress-ng"):
        pytest.skip("stress-ng is not installed (Debian: apt-get install stress-ng)")

    def measure():
        with contextlib.ExitStack() as stack:
            if LOADS[load]:
                stack.callback(stack.enter_context(subprocess.Popen(LOADS[load])).terminate)
            turns = [{setting: a_slice(setting) for setting in SETTINGS} for _ in range(TURNS)]
            return turns, held.latest(lambda: a_slice("as it is", TRACED_S))

    loaded = os.getloadavg()[0]
    turns, found = benchmark.pedantic(measure, rounds=1)
    given = all(given for turn in turns for given, _, _ in turn.values())
    title = f"bytes between real-time processes, {load}" if given else f"{PRIORITY_REFUSED}, {load}"
    report(title, f"{TURNS} turns of {SLICE_S:g} s; load average {loaded:.1f} before, {os.getloadavg()[0]:.1f} after")
    for setting in SETTINGS:
        for way in turns[0][setting][2]:
            slices = [turn[setting][2][way][:, 1] / 1000 for turn in turns]
            figures = {name: [float(np.percentile(one, p)) for one in slices] for name, p in PERCENTS.items()}
            benchmark.extra_info[f"{setting}, {way}"] = figures
            usual_us = benchmark.extra_info[f"as it is, {way}"]["p99_us"]
            figures["p99_ratio"] = [a / b for a, b in zip(figures["p99_us"], usual_us, strict=True)]
            report(f"  {setting}, {way}", ", ".join(f"{name} {spread(one)}" for name, one in figures.items()))
    benchmark.extra_info["held"] = found
    for line in held.in_words(found):
        report(*line)
