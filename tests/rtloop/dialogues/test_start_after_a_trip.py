"""A drive that tripped while nobody ran the arm: the start refuses, and clears it when a person asks for that."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path

import pytest
from stack import Stack

from rtarm.running.status import read_status

pytestmark = pytest.mark.process


def test_a_start_says_how_a_tripped_drive_is_cleared_and_that_clears_it(tmp_path: Path) -> None:
    with closing(Stack(f"tripped_{os.getpid()}", tmp_path)) as stack:
        sim = stack.start_sim()
        sim.say("protection:joint=joint3,at_s=0")
        sim.line_with("protection")
        refused = stack.start_loop(ready=False)
        assert refused.code() == 2
        assert (
            "The drive of joint3 has tripped its protection (stall) and holds nothing: free what blocks the joint, "
            "then start again with `rtarm up … --clear-fault`, which clears it."
        ) in refused.text
        stack.start_loop("--clear-fault")
        status = read_status(stack.name)
        assert (status["mode"], status["fault"]) == ("holding", None)
        assert all(joint["referenced"] for joint in status["joints"])
