"""Keeps today's files of every kind for the versions to come: `make keep` at a release (tests/kept/README.md).

What is kept is told in `facts.json` beside it, and `test_kept_files.py` holds every later version to that.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from virtual import VirtualArm

from config.check import figures
from config.loader import ARMS_FOLDER, load_arm
from config.schema import ArmConfig
from rtarm.recording import mcap_reader, mcap_writer
from rtarm.recording.explain import explanation, plain
from rtarm.recording.mcap_format import Reason
from rtarm.running.limits import Limits
from rtarm.teach import file as motion_file
from rtarm.teach.motion import Motion
from rtloop.kept import commissioned, reference_store
from rtloop.kept.commissioned import Commissioned, PowerProof
from shm.recording import read_recording
from shm.words import Event, Fault, Outcome, Unreferenced
from sim.faults import Stall

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "tests" / "kept"
OWN_ARMS = KEPT / "arms"
"""Arm files that are there to have every key; a version's folder gets them as they are then."""
SMALL = "every_section"
"""The arm of state and recordings: of two joints, so that a recording is small."""
EPOCH_NS = 1_700_000_000_000_000_000

Facts = dict[str, Any]


def folder_of_today() -> Path:
    """Where this version's files belong."""
    return KEPT / f"v{tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))['project']['version']}"


def keep(folder: Path) -> None:
    """Make and fill a version's folder."""
    (folder / "arms").mkdir(parents=True)
    for path in [*ARMS_FOLDER.glob("*.yaml"), *OWN_ARMS.glob("*.yaml")]:
        shutil.copy(path, folder / "arms")
    keep_state(folder)
    keep_motion(folder)
    keep_recordings(folder)
    (folder / "facts.json").write_text(json.dumps(facts(folder), indent=1) + "\n", encoding="utf-8")


def facts(folder: Path) -> Facts:
    """What the code makes of a version's files: figures, marks, outcomes, and no sentence."""
    return {
        "arms": {path.stem: figures(load_arm(path)) for path in sorted((folder / "arms").glob("*.yaml"))},
        "state": of_state(folder),
        "motions": {path.stem: of_motion(path) for path in sorted((folder / "motions").glob("*.yaml"))},
        "recordings": {path.stem: of_recording(path) for path in sorted((folder / "recordings").glob("*.mcap"))},
    }


# --- what is kept of an arm between two runs ---------------------------------------------------------------------


@contextmanager
def state_home(folder: Path) -> Iterator[ArmConfig]:
    """The small arm, with a folder as the home of its state."""
    with patch.dict(os.environ, {"XDG_STATE_HOME": str(folder / "state")}):
        yield load_arm(folder / "arms" / f"{SMALL}.yaml")


def keep_state(folder: Path) -> None:
    """Something of everything that is kept."""
    with state_home(folder) as arm:
        reference_store.save(arm, {0: 12_345, 1: -6_789})
        reference_store.keep_lost_references(arm, {0: Unreferenced.POWER_LOST, 1: Unreferenced.SILENT})
        reference_store.keep_power_marks(arm, {0: "flag", 1: "canary 7"})
        drive = arm.joints[1].drive
        found = Commissioned(
            channel=reference_store.channel_of(arm),
            family=drive.family,
            number=drive.number,
            firmware="2.0.0",
            when="2026-01-31T12:00:00Z",
            power_proof=PowerProof.FLAG,
            power="flag seen 1 after the power cycle, cleared, read 0",
            fast_targets=True,
            reports=False,
            retargets=True,
            brakes_in_silence=True,
        )
        commissioned.save(arm, 1, found)


def of_state(folder: Path) -> Facts:
    """What the next control process would know of the arm."""
    with state_home(folder) as arm:
        found = commissioned.load(arm)[1]
        return {
            "counts": {str(joint): count for joint, count in reference_store.counts_before(arm).items()},
            "lost references": {str(joint): why.name for joint, why in reference_store.lost_references(arm).items()},
            "power marks": {str(joint): mark for joint, mark in reference_store.power_marks(arm).items()},
            "commissioned": {
                "power proof": found.power_proof,
                "fast targets": found.fast_targets,
                "reports": found.reports,
                "retargets": found.retargets,
                "brakes in silence": found.brakes_in_silence,
                "heals": found.heals,
            },
        }


# --- a taught motion -----------------------------------------------------------------------------------------------


def keep_motion(folder: Path) -> None:
    """A motion of episode1."""
    (folder / "motions").mkdir()
    arm = load_arm(folder / "arms" / "episode1.yaml")
    limits = Limits(
        tuple(joint.name for joint in arm.joints),
        *(
            np.array([getattr(joint, name) for joint in arm.joints])
            for name in ("lower_rad", "upper_rad", "max_velocity_rad_s", "max_acceleration_rad_s2")
        ),
    )
    times_s = np.array([0.0, 0.5, 1.0, 1.5])
    positions_rad = np.radians(np.outer([0.0, 1.0, 2.0, 2.0], [1.0, -1.0, 2.0, 3.0, -4.0, 5.0]))
    motion = Motion("episode1", limits, "2026-11-22T12:00:00+00:00", 0.01, 0.004, times_s, positions_rad)
    motion_file.save(motion, folder / "motions" / "wave.yaml", force=False)


def of_motion(path: Path) -> Facts:
    """What `rtarm play` would play."""
    motion = motion_file.load(path)
    return {
        "arm": motion.arm,
        "joints": list(motion.limits.joints),
        "duration_s": motion.duration_s,
        "end_deg": np.degrees(motion.positions_rad[-1]).round(6).tolist(),
        "highest speed": round(motion.fastest(), 3),
    }


# --- recordings ----------------------------------------------------------------------------------------------------


def keep_recordings(folder: Path) -> None:
    """A goal that is reached, and one that ends because a joint is stuck."""
    (folder / "recordings").mkdir()
    arm = small_arm(folder)
    assert arm.end_of(arm.send_shift(0.2, 1.2)) == Outcome.SUCCEEDED
    arm.cycles(10)
    write(arm, Reason("asked", "Asked for by a person."), folder / "recordings" / "goal.mcap")
    arm = small_arm(folder)
    arm.send_shift(0.3, 2.0)
    arm.cycles(30)
    assert arm.sim is not None
    arm.sim.inject(Stall("elbow", at_s=0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["fault"]["code"] != Fault.NONE)
    arm.cycles(20)
    write(arm, Reason("fault", "elbow is stuck."), folder / "recordings" / "fault.mcap")


def small_arm(folder: Path) -> VirtualArm:
    """The small arm in virtual time, brought up."""
    arm = VirtualArm.brought_up(load_arm(folder / "arms" / f"{SMALL}.yaml"), start_rad=[0.0, 0.0])
    arm.memory["timing"]["epoch_offset_ns"] = EPOCH_NS
    return arm


def write(arm: VirtualArm, reason: Reason, path: Path) -> None:
    """An arm's recording; the arm ends."""
    mcap_writer.write(read_recording(arm.state, arm.command), reason, path)
    arm.close()


def of_recording(path: Path) -> Facts:
    """What `rtarm explain` says in words and numbers, and what a program reads."""
    loaded, story = mcap_reader.read(path), plain(explanation(path))
    recording = loaded.recording
    results = recording.events[recording.events["kind"] == Event.RESULT]
    return {
        **{name: story[name] for name in ("arm", "reason", "damage", "fault", "joint")},
        "joints": list(recording.joints),
        "period_ns": recording.period_ns,
        "bitrate": recording.buses[0].bitrate if recording.buses else 0,
        "cycles": len(recording.records),
        "frames": len(recording.frames),
        "events": [[Event(int(event["kind"])).name, int(event["code"])] for event in recording.events],
        "outcomes": [Outcome(int(result["code"])).name for result in results],
        "end_rad": recording.records["joints"]["measured_position_rad"][-1].round(9).tolist(),
    }


if __name__ == "__main__":
    today = folder_of_today()
    if today.exists():
        sys.exit(f"{today.relative_to(ROOT)} is there and is never edited: raise the version in pyproject.toml first.")
    keep(today)
