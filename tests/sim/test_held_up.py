"""A simulated arm that the machine did not run in time says so."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any

import pytest

from config.loader import load_arm
from sim import pty
from sim.arm import SimulatedArm


@pytest.mark.parametrize(("late_s", "times"), [(0.05, 0), (0.12, 1)])
def test_it_says_once_for_how_long_whether_or_not_anything_was_on_its_way(
    late_s: float, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns, rounds = 1_000_000_000, 0
    arm = SimulatedArm(load_arm("episode1"), start_ns=now_ns)
    told: list[int] = []

    def wait(readers: Any, _writers: Any, _errors: Any, wait_s: float) -> Any:
        """Of nine waits the third lasts too long, and the last ends by a byte."""
        nonlocal now_ns, rounds
        rounds += 1
        now_ns += round((wait_s + (late_s if rounds == 3 else 0.0)) * 1e9)
        return [server._wake_read] if rounds == 9 else [], [], []

    with pty.PtyServer(arm) as server:
        monkeypatch.setattr(pty, "time", SimpleNamespace(monotonic_ns=lambda: now_ns))
        monkeypatch.setattr(pty, "select", SimpleNamespace(select=wait))
        server.on_held_up = told.append
        os.write(server.wake_descriptor, b"\0")
        server.serve(iter((True, False)).__next__)
    assert told == [round(late_s * 1e9)] * times
