"""What each family sends for the cycle's requests, alone: identifiers, lengths, packets that belong together, stops.

Spelt for joint 2, whose drive has address 2. What leads it is tested in the files of the families' codecs.
"""

import importlib
from typing import Any

import numpy as np
import pytest

from config.loader import load_arm
from rtloop.memory.frame_words import EXTENDED, REMOTE, STANDARD
from rtloop.process.initial_state import new_loop
from shm import layout
from shm.words import Unreferenced

JOINT = 1
NOBODY = -1
NOW_NS = 5_000_000_000
FC = {"bus": {"position_command": "FC"}}
ARMS: dict[str, dict[str, Any]] = {
    "zdt": {},
    "zdt FC": FC,
    "mks": {},
    "odrive": {},
    "damiao": {},
    "damiao pv": {},
    "robstride": {},
    "robstride position": {},
    "myactuator": {},
    "cia402": {},
    "vesc": {},
}
FILES = {
    "zdt": "episode1",
    "zdt FC": "episode1",
    "damiao pv": "damiao6_pv",
    "robstride position": "robstride6_position",
}
FILES |= {"cia402": "cia402_6"}

Frame = tuple[int, int, int, int, int]
"""Identifier, kind, data bytes, whether the next frame belongs to it, and the joint whose stop command it is."""


def one(frame_id: int, kind: int, size: int, stops: int = NOBODY) -> list[Frame]:
    return [(frame_id, kind, size, 0, stops)]


def two(first: int, second: int, sizes: tuple[int, int] = (8, 8), stops: int = NOBODY) -> list[Frame]:
    return [(first, EXTENDED, sizes[0], 1, NOBODY), (second, EXTENDED, sizes[1], 0, stops)]


LEADS = {
    "zdt": two(0x200, 0x201, (8, 5)),
    "zdt FC": one(0x200, EXTENDED, 6),
    "mks": one(2, STANDARD, 8),
    "odrive": one(0x4C, STANDARD, 8),
    "damiao": one(2, STANDARD, 8),
    "damiao pv": one(0x102, STANDARD, 8),
    "robstride": one(0x017FFF02, EXTENDED, 8),
    "robstride position": two(0x1200FD02, 0x1200FD02),
    "myactuator": one(0x142, STANDARD, 8),
    "cia402": one(0x202, STANDARD, 6),
    "vesc": one(0x402, EXTENDED, 4),
}
STOPS = {
    "zdt": one(0x200, EXTENDED, 4, JOINT),
    "zdt FC": one(0x200, EXTENDED, 4, JOINT),
    "mks": one(2, STANDARD, 8, JOINT),
    "odrive": one(0x4C, STANDARD, 8, JOINT),
    "damiao": one(2, STANDARD, 8, JOINT),
    "damiao pv": one(0x102, STANDARD, 8, JOINT),
    "robstride": one(0x017FFF02, EXTENDED, 8, JOINT),
    "robstride position": two(0x1200FD02, 0x1200FD02, stops=JOINT),
    "myactuator": one(0x142, STANDARD, 8, JOINT),
    "cia402": one(0x202, STANDARD, 6, JOINT),
    "vesc": one(0x402, EXTENDED, 4, JOINT),
}
ASKS_POSITION = {
    "zdt": (one(0x200, EXTENDED, 2), "36 6B"),
    "zdt FC": (one(0x200, EXTENDED, 2), "36 6B"),
    "mks": (one(2, STANDARD, 2), "31 33"),
    "odrive": (one(0x49, REMOTE, 8), ""),
    "damiao": (one(0x7FF, STANDARD, 8), "02 00 CC 00 00 00 00 00"),
    "damiao pv": (one(0x7FF, STANDARD, 8), "02 00 CC 00 00 00 00 00"),
    "robstride": (one(0x1100FD02, EXTENDED, 8), "19 70 00 00 00 00 00 00"),
    "robstride position": (one(0x1100FD02, EXTENDED, 8), "19 70 00 00 00 00 00 00"),
    "myactuator": (one(0x142, STANDARD, 8), "92 00 00 00 00 00 00 00"),
    "cia402": (one(0x080, STANDARD, 0), ""),
    "vesc": ([], ""),
}
ASKS_STATUS = {
    "zdt": [(0x200, "3A 6B"), (0x200, "3A 6B")],
    "mks": [(2, "3A 3C"), (2, "3E 40")],
    "odrive": [(0x57, ""), (0x54, "")],
    "damiao": [],
    "robstride": [(0x1200FD02, "0A 70 00 00 00 00 00 00"), (0x1100FD02, "1C 70 00 00 00 00 00 00")],
    "myactuator": [(0x142, "9A 00 00 00 00 00 00 00"), (0x142, "9C 00 00 00 00 00 00 00")],
    "cia402": [],
    "vesc": [(0x802, "82 00 32 00 00 80 00"), (0x802, "82 00 32 00 20 00 00")],
}
"""In even turns and in odd ones, of a drive that is not led."""
every_arm = pytest.mark.parametrize("name", ARMS)


class Drive:
    """The drive of one joint, measured and commanded to stand at 0.5 rad."""

    def __init__(self, name: str) -> None:
        family = name.split(maxsplit=1)[0]
        self.module = importlib.import_module(f"rtloop.drives.{family}")
        arm = load_arm(FILES.get(name, f"{family}6"), overrides=ARMS[name])
        self.loop, self.shared = new_loop(arm, 0, 0), np.zeros(1, layout.StateFile.dtype)
        self.memory, self.axis = self.loop[0], self.loop[0]["axes"][JOINT]
        self.memory["timing"]["now_ns"], self.memory["timing"]["cycle"] = NOW_NS, 12
        self.axis["commanded"]["position_rad"] = self.axis["commanded"]["next_position_rad"] = 0.5
        self.axis["measured"]["position_rad"] = self.axis["tracking"]["reference_rad"] = 0.5
        self.axis["measured"]["readings"], self.axis["measured"]["time_ns"] = 3, NOW_NS
        self.axis["sent"]["asked_cycle"] = self.axis["sent"]["led_cycle"] = 11
        self.bus, self.outgoing = self.memory["buses"][0], self.memory["buses"][0]["outgoing"]
        self.bus["sync_cycle"] = 11
        self.axis["reference"]["unreferenced_reason"] = Unreferenced.NOT_BROUGHT_UP

    def sends(self, function: str) -> list[Frame]:
        self.outgoing["frames"] = self.outgoing["length"] = 0
        getattr(self.module, function)(self.loop[0], JOINT, self.shared[0])
        words = ("ids", "kinds", "sizes", "joined", "stops")
        return [tuple(int(self.outgoing[word][number]) for word in words) for number in range(self.outgoing["frames"])]

    def said(self) -> str:
        """Data of the last frame that was sent."""
        last = int(self.outgoing["frames"]) - 1
        size = 0 if self.outgoing["kinds"][last] & REMOTE else int(self.outgoing["sizes"][last])
        return str(self.outgoing["payloads"][last].tobytes()[:size].hex(" ").upper())

    def fill(self) -> None:
        """Leave no room for another frame."""
        self.outgoing["length"] = len(self.outgoing["bytes"]) - 1
        self.outgoing["frames"] = len(self.outgoing["ids"])


@every_arm
def test_what_leads_a_drive_is_one_command_and_no_stop(name: str) -> None:
    assert Drive(name).sends("lead") == LEADS[name]


@every_arm
def test_a_stop_is_known_as_that_of_its_joint(name: str) -> None:
    drive = Drive(name)
    assert drive.sends("stop") == STOPS[name]
    drive.axis["reference"]["unreferenced_reason"] = Unreferenced.NOT_HOMED
    homing = {"zdt": [(0x200, EXTENDED, 3, 0, NOBODY)], "mks": [(2, STANDARD, 2, 0, NOBODY)]}.get(
        name.split(maxsplit=1)[0], []
    )
    assert drive.sends("stop") == homing + STOPS[name], "a homing run is ended before"


@every_arm
def test_a_stop_without_room_is_said_to_be_none(name: str) -> None:
    drive = Drive(name)
    stop = drive.module.stop
    assert stop(drive.loop[0], JOINT, drive.shared[0]) is True
    drive.fill()
    assert stop(drive.loop[0], JOINT, drive.shared[0]) is False


@every_arm
def test_a_question_for_the_position_is_noted_where_it_is_sent(name: str) -> None:
    frames, data = ASKS_POSITION[name]
    drive = Drive(name)
    assert (drive.sends("ask_position"), drive.said()) == (frames, data)
    assert drive.axis["reply"]["questions"] == len(frames)
    drive.memory["timing"]["cycle"] += 1
    drive.fill()
    drive.module.ask_position(drive.loop[0], JOINT, drive.shared[0])
    assert drive.axis["reply"]["questions"] == len(frames)


@pytest.mark.parametrize("name", ASKS_STATUS)
def test_questions_for_the_status_take_turns(name: str) -> None:
    drive = Drive(name)
    said = []
    for cycle in (12, 18):  # of six joints, each of which is asked in its turn
        drive.memory["timing"]["cycle"] = cycle
        said += [(frame_id, drive.said()) for frame_id, *_ in drive.sends("ask_status")]
    assert said == ASKS_STATUS[name]
