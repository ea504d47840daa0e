"""Tests on real SocketCAN, collected where there is an interface vcan0: in the virtual machine of `make test-vm`."""

from pathlib import Path

import stack

stack.PATIENCE_S = 240.0
"""An emulated processor takes its time, and tells nothing by it."""
collect_ignore_glob = [] if Path("/sys/class/net/vcan0").exists() else ["test_*.py"]
