"""Codecs of drives on a rig: the loop of one joint, which sends and hears frames by the functions that the cycle uses.

Frames are written as in can-utils: `123#` has a standard identifier, `00000123#` an extended one, `#R8` asks for eight
bytes. Golden frames are data, `tests/golden/FAMILY.yaml` for each family; what a file may hold is said at the head of
`test_golden_frames.py`.
"""

import importlib
import math
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import yaml

from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.bus.measured import take_frame
from rtloop.drives.power import Marks
from rtloop.memory import status
from rtloop.memory.frame_words import EXTENDED, REMOTE, STANDARD
from rtloop.process.initial_state import new_loop
from rtloop.service.port import Frame
from shm import layout

GOLDEN = Path(__file__).parent / "golden"
JOINT = {"ratio": 1, "lower_deg": -170, "upper_deg": 170, "motor_rpm": 60, "max_acceleration_rad_s2": 5.0}
"""What a joint is unless it is said."""
NOW_NS = 1_000_000_000
MEASURED = ("velocity_rad_s", "effort_nm", "temperature_c", "voltage_v")
"""Words of a drive's state that are no number until its drive has told them."""


@cache
def golden(family: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((GOLDEN / f"{family}.yaml").read_text(encoding="utf-8"))
    return found


def families() -> list[str]:
    return sorted(path.stem for path in GOLDEN.glob("*.yaml"))


def kinds() -> list[tuple[str, str]]:
    """Every family with each of the joints that its file names."""
    return [(family, joint) for family in families() for joint in golden(family)["joints"]]


def arm_of(*drives: dict[str, Any], **joint: Any) -> ArmConfig:
    """Joints that differ only in their drives."""
    joints = [{"name": f"joint{n}", "drive": drive, **JOINT, **joint} for n, drive in enumerate(drives, 1)]
    bus = {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 1_000_000}
    return ArmConfig.model_validate({"name": "arm", "control": {"rate_hz": 100}, "bus": bus, "joints": joints})


def word(data: bytes) -> int:
    """Data bytes as the cycle holds them, the first lowest."""
    return int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)


def data_of(value: int, length: int = 8) -> bytes:
    """The bytes of such a word."""
    return (int(value) % 2**64).to_bytes(8, "little")[:length]


def frame_of(text: str) -> tuple[Frame, int]:
    """A frame and its length, which a remote frame has without data."""
    identifier, _, data = text.partition("#")
    kind = EXTENDED if len(identifier) == 8 else STANDARD
    if data.startswith("R"):
        return Frame(int(identifier, 16), b"", kind=kind | REMOTE), int(data[1:])
    found = Frame(int(identifier, 16), bytes.fromhex(data), kind=kind)
    return found, len(found.data)


def text_of(frame_id: int, kind: int, data: bytes, length: int) -> str:
    identifier = f"{frame_id:08X}" if kind & EXTENDED else f"{frame_id:03X}"
    return f"{identifier}#R{length}" if kind & REMOTE else f"{identifier}# {data.hex(' ').upper()}".rstrip()


class Rig:
    """A loop of one joint. `drive` is its drive's section; what else is given is the joint's."""

    def __init__(self, drive: dict[str, Any], **joint: Any) -> None:
        self.arm = arm_of(drive, **joint)
        self.codec: ModuleType = importlib.import_module(f"rtloop.drives.{drive['family']}")
        self.shared = np.zeros(1, layout.StateFile.dtype)
        self.loop = new_loop(self.arm, self.shared.ctypes.data, 0)
        self.record = self.loop[0]
        self.axis, self.row = self.loop[0]["axes"][0], self.loop[0]["joints"][0]
        self.record["timing"]["cycle"] = self.record["published"]["cycle"] = 10

    @classmethod
    def named(cls, family: str, joint: str | None = None, **changes: Any) -> "Rig":
        """One of the joints in a family's file, the first unless one is named."""
        joints = golden(family)["joints"]
        return cls(**{**joints[joint or next(iter(joints))], **changes})

    @property
    def config(self) -> JointConfig:
        return self.arm.joints[0]

    @property
    def period_s(self) -> float:
        return self.arm.control.period_ns * 1e-9

    def stands(self, position_rad: float, velocity_rad_s: float = 0.0) -> "Rig":
        """Command the joint to move evenly, and measure it there."""
        axis = self.axis
        axis["commanded"]["position_rad"] = axis["measured"]["position_rad"] = axis["tracking"]["reference_rad"] = (
            position_rad
        )
        axis["commanded"]["velocity_rad_s"] = axis["commanded"]["next_velocity_rad_s"] = velocity_rad_s
        axis["commanded"]["next_position_rad"] = position_rad + velocity_rad_s * self.period_s
        axis["sent"]["led_cycle"] = self.record["timing"]["cycle"] - 1
        return self

    def sends(self, function: str) -> list[str]:
        """The frames that one of the family's functions sends."""
        outgoing = self.record["buses"][0]["outgoing"]
        outgoing["frames"] = outgoing["length"] = 0
        getattr(self.codec, function)(self.record, 0, self.shared[0])
        found = []
        for number in range(outgoing["frames"]):
            frame_id, kind, size = (int(outgoing[name][number]) for name in ("ids", "kinds", "sizes"))
            data = data_of(outgoing["payloads"][number])
            assert not any(data[size:])
            found.append(text_of(frame_id, kind, data[:size], size))
        return found

    def takes(self, frame_id: int, data: bytes, kind: int = STANDARD, length: int | None = None) -> None:
        """A frame comes from the bus."""
        length = len(data) if length is None else length
        take_frame(self.record, self.shared[0], self.record["buses"][0], frame_id, kind, length, word(data), NOW_NS)

    def hears(self, *frames: str) -> dict[str, Any]:
        """What the joint's drive has told by these frames and before: numbers in SI units, status as bits."""
        for text in frames:
            frame, length = frame_of(text)
            self.takes(frame.id, frame.data, frame.kind, length)
        return self.told()

    def told(self) -> dict[str, Any]:
        axis, drive = self.axis, self.axis["drive"]
        found = {name: float(drive[name]) for name in MEASURED if not math.isnan(drive[name])}
        if axis["reply"]["is_new"]:
            found["position_rad"] = float(axis["reply"]["position_rad"])
        if drive["status_readings"]:
            found["status"] = int(drive["status"])
        counted = {name: int(axis["checks"][name]) for name in ("refusals", "bad_statuses")}
        counted["error_code"] = int(drive["error_code"])
        counted["drive_errors"] = int(self.shared[0]["counters"]["drive_errors"])
        return found | {name: count for name, count in counted.items() if count}


def status_of(names: Iterable[str]) -> int:
    """Status bits by their names in `rtloop.memory.status`; a drive that has told its status has answered."""
    found = status.ANSWERED
    for name in names:
        found |= getattr(status, name.upper())
    return found


def meant(told: dict[str, Any], joint: JointConfig) -> dict[str, Any]:
    """What a vector says in words, degrees or counts of the encoder, as `Rig.told` has it."""
    found: dict[str, Any] = {}
    for name, value in told.items():
        if name == "status":
            found[name] = status_of(value)
        elif name == "position_counts":
            found["position_rad"] = joint.direction * value / joint.encoder_counts_per_rad - joint.zero_rad
        elif "_deg" in name:
            found[name.replace("_deg", "_rad")] = math.radians(value)
        else:
            found[name] = value
    return found


# --- conversations --------------------------------------------------------------------------------------------


class Host:
    """What a bring-up asks of whoever runs it, and a drive that answers from a script.

    `answers` gives what the drive answers to a question and its frames, if anything.
    """

    def __init__(
        self, arm: ArmConfig, answers: Callable[[Any, list[Frame]], Frame | None], *, clears_protection: bool = True
    ) -> None:
        self.arm, self.answers, self.clears_protection = arm, answers, clears_protection
        self.now_ns, self.port, self.unasked_before = 0, None, [0] * len(arm.joints)
        self.told: list[str] = []
        self.marks, self.was_silent, self.heals = Marks(), [False] * len(arm.joints), False

    def tell(self, sentence: str) -> None:
        self.told.append(sentence)

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Nothing is posted by the bring-up of drives that answer from scripts."""

    def hold(self, dialogue: Any) -> tuple[list[str], Any]:
        """Every frame that a conversation sends, and its end."""
        sent: list[str] = []
        answer = None
        while True:
            try:
                question = dialogue.send(answer)
            except StopIteration as end:
                return sent, end.value
            frames = [frame for frame, _ in question.packets(True)]
            sent += [text_of(frame.id, frame.kind, frame.data, len(frame.data)) for frame in frames]
            answer = self.answers(question, frames)
