"""Move a joint there and back, keep what the arm did, and draw it: `python record_and_plot.py [ARM] [FOLDER]`.

Drawing needs matplotlib: `pip install matplotlib`.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import rtarm

JOINT, WAY_RAD = "joint1", 0.2


def record(arm: rtarm.Arm, motion_ended: threading.Event) -> np.ndarray:
    """Rows of time (s), commanded and measured angle of the joint (rad), a row a control cycle."""
    index = arm.joints.index(JOINT)
    rows = []
    for state in arm.states():
        rows.append((state.time_s, state.commanded_rad[index], state.position_rad[index]))
        if motion_ended.is_set():
            break
    return np.array(rows)


def move(arm: rtarm.Arm, motion_ended: threading.Event) -> None:
    """There and back."""
    try:
        for way_rad in (WAY_RAD, -WAY_RAD):
            print(arm.move({JOINT: way_rad}, relative=True, speed=0.5))
    finally:
        motion_ended.set()


def main() -> None:
    """The program."""
    name = sys.argv[1] if len(sys.argv) > 1 else None
    folder = Path(sys.argv[2] if len(sys.argv) > 2 else ".")
    with rtarm.connect(name) as arm:
        motion_ended = threading.Event()
        mover = threading.Thread(target=move, args=(arm, motion_ended))
        mover.start()
        rows = record(arm, motion_ended)
        mover.join()
    times_s = rows[:, 0] - rows[0, 0]
    np.savetxt(folder / "motion.csv", rows, delimiter=",", header="time_s,commanded_rad,measured_rad", comments="")
    plt.plot(times_s, np.degrees(rows[:, 1]), label="commanded")
    plt.plot(times_s, np.degrees(rows[:, 2]), label="measured")
    plt.xlabel("s")
    plt.ylabel(f"{JOINT}, degrees")
    plt.legend()
    plt.savefig(folder / "motion.png")
    print(f"{len(rows)} cycles are in {folder / 'motion.csv'}, drawn in {folder / 'motion.png'}.")


if __name__ == "__main__":
    main()
