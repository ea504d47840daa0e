"""Lead joints with the sticks of a gamepad, while its dead-man button is held: `python gamepad.py [ARM] [DEVICE]`.

Reads Linux' own joystick device, /dev/input/js0, and needs nothing else. Where the button is let go, the gamepad is
unplugged or this program ends, no point comes any more, and the arm stops by itself.
"""

from __future__ import annotations

import os
import struct
import sys
import time

import rtarm

RATE_HZ = 50.0
DEAD_MAN_BUTTON = 4
"""The left shoulder button of most."""
SPEED = 0.3
"""Of the joints' highest velocity, with a stick at its end."""
JOINTS = {0: "joint1", 1: "joint2", 3: "joint3", 4: "joint5"}
"""The joint that each axis of the sticks leads."""
RESTS = 0.1
"""A stick that is nearer to its middle rests."""
EVENT = struct.Struct("IhBB")
"""Time (ms), value, kind and number, as linux/joystick.h has it."""
BUTTON, AXIS = 1, 2


class Gamepad:
    """Where the sticks and the dead-man button are."""

    def __init__(self, device: str) -> None:
        self._file = os.open(device, os.O_RDONLY | os.O_NONBLOCK)
        self.axes: dict[int, float] = {}
        self.held = False
        self.there = True

    def look(self) -> None:
        """Take what has happened since the last look."""
        while self.there:
            try:
                data = os.read(self._file, EVENT.size)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if len(data) < EVENT.size:
                self.there = self.held = False
                return
            _, value, kind, number = EVENT.unpack(data)
            if kind & BUTTON and number == DEAD_MAN_BUTTON:
                self.held = bool(value)
            elif kind & AXIS:
                self.axes[number] = value / 32767.0


def main() -> None:
    """The program."""
    name = sys.argv[1] if len(sys.argv) > 1 else None
    gamepad = Gamepad(sys.argv[2] if len(sys.argv) > 2 else "/dev/input/js0")
    with rtarm.connect(name) as arm, arm.stream(rate_hz=RATE_HZ) as stream:
        print(f"Hold button {DEAD_MAN_BUTTON} and use the sticks; Ctrl-C ends.")
        target_rad = arm.state().commanded_rad
        next_s = time.monotonic()
        while gamepad.there:
            gamepad.look()
            if gamepad.held:
                for axis, joint in JOINTS.items():
                    index, pushed = arm.joints.index(joint), gamepad.axes.get(axis, 0.0)
                    if abs(pushed) > RESTS:
                        target_rad[index] += pushed * SPEED * arm.limits.velocity_rad_s[index] / RATE_HZ
                target_rad = target_rad.clip(arm.limits.lower_rad, arm.limits.upper_rad)
                stream.send(target_rad)
            else:
                target_rad = arm.state().commanded_rad
            next_s += 1.0 / RATE_HZ
            time.sleep(max(0.0, next_s - time.monotonic()))
        print("The gamepad is gone; the arm stops by itself.")


if __name__ == "__main__":
    main()
