"""Lead the arm by hand to two poses, and let it go back and forth between them: `python two_poses.py [ARM]`."""

from __future__ import annotations

import sys

import rtarm

ROUNDS = 3


def pick_pose(arm: rtarm.Arm, which: str) -> dict[str, float]:
    """Joint → angle (rad) of a pose to which somebody leads the limp arm."""
    input(f"Hold the arm, it goes limp now: press Enter, and lead it to the {which} pose. ")
    print(arm.free())
    try:
        input("Press Enter when it is there, and hold it until it holds itself. ")
    finally:
        print(arm.enable())
    return dict(zip(arm.joints, arm.state().commanded_rad.tolist(), strict=True))


def main() -> None:
    """The program."""
    with rtarm.connect(sys.argv[1] if len(sys.argv) > 1 else None) as arm:
        poses = [pick_pose(arm, "first"), pick_pose(arm, "second")]
        input("Press Enter when the way between them is clear. ")
        for number in range(ROUNDS):
            for pose in poses:
                print(f"round {number + 1}: {arm.move(pose, speed=0.3)}")


if __name__ == "__main__":
    main()
