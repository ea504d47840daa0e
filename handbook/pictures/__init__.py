"""The pictures that are drawn from the code, each with the function that makes it."""

from collections.abc import Callable

from handbook.pictures import motion, states

PICTURES: dict[str, Callable[[], str]] = {
    "arm_modes.svg": states.arm_modes,
    "goal_ends.svg": motion.ends,
    "goal_interpolation.svg": motion.interpolation,
    "goal_phases.svg": states.goal_phases,
    "goal_stops.svg": motion.stops,
}
