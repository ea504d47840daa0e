"""The highest control rate of each family: computed by the budget, and reached on the simulated bus in virtual time.

    python -m pytest bench/bench_rates.py -s

Reached is the highest rate (a multiple of 5 Hz) at which a recorded goal succeeds with every drive's reading fresh in
every cycle, whatever share of the bus that takes: the limit of the load (`bus.load_limit`) is set aside for it, since
the simulated bus really carries each bit.
"""

import numpy as np
import pytest
from virtual import VirtualArm, recorded_goal

from config.budget import budget
from config.loader import known_arms, load_arm
from config.schema import ArmConfig
from shm.words import Outcome

ARMS = [name for name in known_arms() if name != "mock"]
STEP_HZ = 5.0
GOAL = "small"


def at_rate(name: str, rate_hz: float) -> ArmConfig:
    """The arm at a rate, its budget not judged."""
    arm = load_arm(name)
    return arm.model_copy(update={"control": arm.control.model_copy(update={"rate_hz": rate_hz})})


def carries(name: str, rate_hz: float) -> bool:
    """Whether the goal succeeds at this rate with a fresh reading of every joint in every cycle."""
    arm = VirtualArm(at_rate(name, rate_hz), start_rad=recorded_goal(GOAL)["joints"][0, :, 0])
    try:
        if arm.bring_up().failure is not None:
            return False
        arm.reference_all()
        goal, started = arm.play(GOAL), arm.loop[0]["axes"]["measured"]["readings"][:6].copy()
        cycles = 0
        while arm.outcome(goal) == Outcome.NONE:
            arm.cycle()
            cycles += 1
        fresh = arm.loop[0]["axes"]["measured"]["readings"][:6] - started
        return arm.outcome(goal) == Outcome.SUCCEEDED and bool(np.all(fresh >= cycles - 2))
    except AssertionError:  # not within the time that everything has in virtual time
        return False
    finally:
        arm.close()


def reached_hz(name: str, computed_hz: float) -> float:
    """The highest multiple of STEP_HZ that `carries`, looked for from half the computed rate upwards."""
    low, high = STEP_HZ * (computed_hz // (2 * STEP_HZ)), STEP_HZ * (computed_hz * 1.6 // STEP_HZ)
    while high - low > STEP_HZ:
        middle = STEP_HZ * ((low + high) // (2 * STEP_HZ))
        low, high = (middle, high) if carries(name, middle) else (low, middle)
    return low


@pytest.mark.timeout(1800)
def test_highest_rates(capsys: pytest.CaptureFixture[str]) -> None:
    """A row of the table in docs/hardware/drive-families.md for each arm."""
    with capsys.disabled():
        print("\n| arm | bus | bits a cycle, worst case | computed at 85 % | computed at 100 % | reached |")
        print("|---|---|---|---|---|---|")
        for name in ARMS:
            found = budget(load_arm(name))
            whole_hz = (found.bitrate - found.bits_beside_s) / found.bits_per_cycle
            reached = reached_hz(name, whole_hz)
            print(
                f"| `{name}` | {found.bitrate // 1000} kbit/s | {found.bits_per_cycle} "
                f"| {found.bus_highest_rate_hz:.0f} Hz | {whole_hz:.0f} Hz | {reached:.0f} Hz |",
                flush=True,
            )
            assert reached >= 0.9 * found.bus_highest_rate_hz
