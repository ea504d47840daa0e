"""Bring-up and disabling of a Nemo N23.

HOLD makes its position its target, whatever it was told before, so nothing moves.
"""

import math
from typing import NamedTuple

import numpy as np

from config.drives.nemo import COUNTS_PER_TURN, REQUEST, NemoDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import nemo_protocol as protocol
from rtloop.drives.asking import AskFrames, confirmed
from rtloop.drives.errors import error_words
from rtloop.drives.numbers import packed, unpacked
from rtloop.drives.setup import SAME_PLACE_RAD, Found, Host, require_may_enable
from rtloop.drives.steps import answered, let_go, unanswered, without_error
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part
from rtloop.service.port import Frame


class State(NamedTuple):
    """What a drive answers: its flags, and its position (counts)."""

    flags: int
    counts: int

    @property
    def holds(self) -> bool:
        """Whether it holds its shaft."""
        return self.flags & protocol.HOLDS != 0

    @property
    def error(self) -> str:
        """Its errors in words."""
        errors = self.flags & ~protocol.HOLDS
        return error_words(errors, protocol.ERRORS) if errors else ""


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of a Nemo drive for the cycle; see `rtloop.drives.setup.Setup`."""
    counts_per_rad = joint.direction * joint.ratio * COUNTS_PER_TURN / (2.0 * math.pi)
    row["command_per_rad"] = row["reading_per_rad"] = counts_per_rad


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    config = host.arm.joints[joint]
    address = _address(config)
    answer = yield _asked(address, protocol.STATE)
    if answer is None:
        raise unanswered(
            joint, config, f"address {address}", f"its switches, the bit rate ({host.arm.bus_of(config).bitrate})"
        )
    cleared = lambda: _told(joint, config, protocol.CLEAR)  # noqa: E731
    state = yield from without_error(host, joint, _state(answer), lambda state: state.error, cleared)
    if not state.holds:
        require_may_enable(host, joint)
    for _ in range(TRIES):
        state = yield from _told(joint, config, protocol.HOLD)
        if state.holds:
            break
    else:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not hold its shaft ({state.error or 'without an error'}): see its "
            "lamps, then `rtarm clear-fault`, or `rtarm up` where it has ended.",
        )
    within = SAME_PLACE_RAD * config.encoder_counts_per_rad
    state = yield from confirmed(lambda: _told(joint, config, protocol.STATE), within, place=lambda state: state.counts)
    return Found(state.counts, state.counts)


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Let the shaft go, and check that the drive does not hold it; raises DialogueFailed."""
    config = arm.joints[joint]

    def told() -> Part[str]:
        return "goes on holding" if (yield from _told(joint, config, protocol.LET_GO)).holds else ""

    yield from let_go(joint, config, told, "switch the drive off")


def _address(config: JointConfig) -> int:
    assert isinstance(config.drive, NemoDrive)
    return config.drive.address


def _asked(address: int, function: int) -> AskFrames:
    request = Frame(REQUEST + address, packed({protocol.FUNCTION: function}), kind=STANDARD)
    return AskFrames(
        (request,), lambda frame: len(frame.data) == 8 and unpacked(frame.data, protocol.FUNCTION) == function
    )


def _state(answer: Frame) -> State:
    return State(unpacked(answer.data, protocol.FLAGS), unpacked(answer.data, protocol.COUNTS))


def _told(joint: int, config: JointConfig, function: int) -> Part[State]:
    """The drive's state, after it was told something; raises DialogueFailed if it does not answer."""
    return _state((yield from answered(joint, config, _asked(_address(config), function), "state")))
