"""The arm as a good engineer drives it in plain Python: python-can, cubic interpolation, one frame after the other.

Shared by both baselines, `one_node` and `plain_loop`. They send what our cycle sends (six position commands of two
frames, six position requests, one status request) and read what the drives answer. At a simulated arm they speak
SLCAN through a pseudo-terminal like ours; without one they use python-can's `virtual` bus, which costs less than any
real one and on which nobody answers.
"""

from __future__ import annotations

import bisect
import math
import struct
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import can

    from config.joint import JointConfig
    from config.schema import ArmConfig

PULSES_A_TURN = 3200
COUNTS_A_TURN = 65_536
ACC_BYTE = 200
CHECKSUM = b"\x6b"
READ_POSITION, READ_STATUS, READ_SETTINGS = b"\x36\x6b", b"\x3a\x6b", b"\x42\x6c\x6b"
SETTINGS_AT, SETTINGS_BYTES = 3, 28
"""Where a drive's settings stand in its answer to `READ_SETTINGS`, behind two more bytes of head."""
SCREEN_AT, ADDRESS_AT, RESPONSE_AT = 7, 16, 18
"""Within the settings; the first two are written as 0, which leaves them as they are (Emm_V5 manual)."""
ANSWER_S = 1.0


class Path:
    """A joint trajectory as cubic polynomials between its points."""

    def __init__(self, goal: dict[str, Any]) -> None:
        points = goal["trajectory"]["points"]
        self._times_s = [
            point["time_from_start"]["sec"] + point["time_from_start"]["nanosec"] * 1e-9 for point in points
        ]
        self._positions = [point["positions"] for point in points]
        self._velocities = [point["velocities"] for point in points]
        self.duration_s: float = self._times_s[-1]

    def at(self, time_s: float) -> list[float]:
        """Positions (rad) so long after the start; before and beyond, the first and last ones."""
        if time_s <= 0.0 or time_s >= self.duration_s:
            held: list[float] = self._positions[0 if time_s <= 0.0 else -1]
            return held
        index = bisect.bisect_right(self._times_s, time_s)
        begin_s, end_s = self._times_s[index - 1], self._times_s[index]
        length_s = end_s - begin_s
        u = (time_s - begin_s) / length_s
        h00, h10 = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * (1.0 - u) ** 2 * length_s
        h01, h11 = u * u * (3.0 - 2.0 * u), u * u * (u - 1.0) * length_s
        return [
            h00 * p0 + h10 * v0 + h01 * p1 + h11 * v1
            for p0, v0, p1, v1 in zip(
                self._positions[index - 1],
                self._velocities[index - 1],
                self._positions[index],
                self._velocities[index],
                strict=True,
            )
        ]


class PythonArm:
    """The drives at a python-can bus.

    Args:
        arm: whose drives; mock drives are addressed from 1 on.
        channel: terminal of the simulated adapter, None for a virtual bus.

    Attributes:
        measured_rad: the newest position of every joint; NaN until it was read.
    """

    def __init__(self, arm: ArmConfig, channel: str | None) -> None:
        import can

        self._message = can.Message
        self._joints: Sequence[JointConfig] = arm.joints
        self._addresses = [getattr(joint.drive, "address", number) for number, joint in enumerate(arm.joints, 1)]
        self._joint_at = {address: index for index, address in enumerate(self._addresses)}
        self._turn = 0
        self.measured_rad = [math.nan] * len(arm.joints)
        self.bus: can.BusABC
        if channel is None:
            self.bus = can.Bus(interface="virtual", channel="rtarm_bench")
        else:
            self.bus = can.Bus(interface="slcan", channel=channel, bitrate=arm.bus.bitrate, sleep_after_open=0.0)
            for address in self._addresses:
                self._end_acknowledgements(address)
        self._notifier: can.Notifier | None = None

    def listen(self) -> None:
        """Read in a thread of its own, as python-can does it, until `rest`."""
        import can

        self._notifier = can.Notifier(self.bus, [self._take])

    def rest(self) -> None:
        """End that thread: it would poll on."""
        notifier, self._notifier = self._notifier, None
        if notifier is not None:
            notifier.stop()

    def cycle(self, positions_rad: Sequence[float]) -> None:
        """Send a target to every drive and ask each where it is, and one in turn for its status."""
        for joint, address, position_rad in zip(self._joints, self._addresses, positions_rad, strict=True):
            turns = joint.direction * (position_rad + math.radians(joint.zero_deg)) * joint.ratio / (2.0 * math.pi)
            pulses = round(turns * PULSES_A_TURN)
            body = struct.pack(">BBHBI", 0xFD, pulses < 0, round(joint.motor_rpm), ACC_BYTE, abs(pulses))
            self._send(address << 8, body[:8])
            self._send(address << 8 | 1, b"\xfd" + body[8:] + b"\x01\x00" + CHECKSUM)
        for address in self._addresses:
            self._send(address << 8, READ_POSITION)
        self._turn = (self._turn + 1) % len(self._addresses)
        self._send(self._addresses[self._turn] << 8, READ_STATUS)

    def close(self) -> None:
        """End the reading thread and close the bus."""
        self.rest()
        self.bus.shutdown()

    def _send(self, identifier: int, data: bytes) -> None:
        self.bus.send(self._message(arbitration_id=identifier, data=data, is_extended_id=True))

    def _take(self, message: can.Message) -> None:
        """Called by python-can's reading thread."""
        index = self._joint_at.get(message.arbitration_id >> 8)
        data = message.data
        if index is None or len(data) != 7 or data[0] != READ_POSITION[0]:
            return
        sign, counts = struct.unpack_from(">BI", data, 1)
        joint = self._joints[index]
        turns = (-counts if sign else counts) / COUNTS_A_TURN
        self.measured_rad[index] = joint.direction * turns * 2.0 * math.pi / joint.ratio - math.radians(joint.zero_deg)

    def _end_acknowledgements(self, address: int) -> None:
        """As our bring-up does, so that nobody has more to read: in the drive's volatile memory.

        Raises:
            RuntimeError: the drive does not tell its settings.
        """
        self._send(address << 8, READ_SETTINGS)
        answer = bytearray(READ_SETTINGS[:1])
        until_s = time.monotonic() + ANSWER_S
        while len(answer) < SETTINGS_AT + SETTINGS_BYTES + 1:
            message = self.bus.recv(0.1)
            if message is not None and message.arbitration_id >> 8 == address and message.data[0] == answer[0]:
                answer += message.data[1:]
            elif time.monotonic() > until_s:
                raise RuntimeError(f"drive {address} does not tell its settings")
        settings = answer[SETTINGS_AT : SETTINGS_AT + SETTINGS_BYTES]
        settings[SCREEN_AT] = settings[ADDRESS_AT] = settings[RESPONSE_AT] = 0
        message_bytes = b"\xd1\x00" + bytes(settings) + CHECKSUM
        for packet, start in enumerate(range(0, len(message_bytes), 7)):
            self._send(address << 8 | packet, b"\x48" + message_bytes[start : start + 7])
