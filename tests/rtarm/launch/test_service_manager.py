"""What a service manager is told, and when."""

from __future__ import annotations

import signal
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from stack import Process

from rtarm.launch import service_manager


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[socket.socket]:
    """A service manager's socket, of both kinds that there are."""
    name = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(name if request.param == "path" else f"\0{name}")
        listener.settimeout(30.0)
        monkeypatch.setenv(service_manager.VARIABLE, name if request.param == "path" else f"@{name}")
        yield listener


def test_a_service_manager_is_told(manager: socket.socket) -> None:
    service_manager.tell(service_manager.READY)
    assert manager.recv(100).split(b"\n")[0] == b"READY=1"


@pytest.mark.process
def test_an_arm_tells_when_it_is_ready_and_when_it_ends(manager: socket.socket, mock_file: Path) -> None:
    with closing(Process("rtarm", "up", str(mock_file), needs_ros=True)) as up:
        up.line_with("rtarm  running")
        assert manager.recv(100).startswith(b"READY=1")
        up.process.send_signal(signal.SIGTERM)
        assert up.code() == 0
        assert manager.recv(100).startswith(b"STOPPING=1")


def test_nobody_listening_is_no_failure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(service_manager.VARIABLE, str(tmp_path / "gone"))
    service_manager.tell(service_manager.READY)
    monkeypatch.delenv(service_manager.VARIABLE)
    service_manager.tell(service_manager.READY)
