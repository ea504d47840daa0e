"""Which functions are mutated, which tests judge them, and the mutants that no test could tell from the original."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Leaf:
    file: str
    tests: tuple[str, ...]
    """Arguments of pytest: files, and `-k` where it spares compiling; what goes through the whole cycle is left out."""
    functions: tuple[str, ...] = ()
    """All of the file unless some are named."""


WIRES = "tests/rtloop/wire/test_wire_conformance.py"
OF_ALL_FAMILIES = tuple(
    f"tests/rtloop/drives/test_{name}.py" for name in ("drive_frames", "golden_frames", "codec_laws")
)
OF_ONE_FAMILY = {"zdt": ("tests/rtloop/drives/test_zdt_targets.py",)}


def drive(family: str) -> Leaf:
    tests = (f"tests/rtloop/drives/test_{family}_codec.py", *OF_ALL_FAMILIES, *OF_ONE_FAMILY.get(family, ()))
    return Leaf(f"rtloop/drives/{family}.py", (*tests, "-k", family))


LEAVES = (
    Leaf("config/stopping.py", ("tests/config/test_patience.py",)),
    Leaf("motion/segment.py", ("tests/motion",)),
    Leaf("motion/scaling.py", ("tests/motion",)),
    Leaf("motion/stopping.py", ("tests/motion",)),
    Leaf("motion/bounds.py", ("tests/motion",)),
    Leaf("motion/slopes.py", ("tests/motion",)),
    Leaf("motion/limits.py", ("tests/motion",)),
    Leaf("motion/gripping.py", ("tests/rtloop/dialogues/test_gripper.py",)),
    Leaf("shm/seqlock.py", ("tests/shm/test_seqlock.py", "tests/shm/test_memory_order.py")),
    Leaf("shm/histogram.py", ("tests/shm/test_histogram.py",)),
    Leaf("rtloop/trajectory/path.py", ("tests/rtloop/trajectory/test_path.py",)),
    Leaf("rtloop/trajectory/clock.py", ("tests/rtloop/trajectory/test_clock.py",)),
    Leaf(
        "rtloop/trajectory/entry.py",
        ("tests/rtloop/trajectory/test_path.py",),
        ("due_s", "lay_approach", "lay_run_up", "lay_blend"),
    ),
    Leaf(
        "rtloop/trajectory/limits.py",
        ("tests/rtloop/safety/test_limits.py",),
        ("clamped_rad", "stopping_distance_rad", "stop_rad", "keeps_room", "highest_rad_s", "hardest_rad_s2"),
    ),
    Leaf(
        "rtloop/safety/setpoint_check.py",
        ("tests/rtloop/safety/test_limits.py",),
        ("check_next_setpoint",),
    ),
    Leaf(
        "rtloop/safety/setpoint_check.py",
        ("tests/rtloop/drives/test_codec_laws.py", "-k", "no_number"),
        ("setpoint_sum", "may_be_sent"),
    ),
    Leaf("rtloop/safety/absolute_encoder.py", ("tests/rtloop/kept/test_reference_store.py", "-k", "no_clear_forgives")),
    Leaf("rtloop/drives/leading.py", ("tests/rtloop/drives/test_leading.py",)),
    Leaf("rtloop/drives/following.py", ("tests/rtloop/drives/test_following.py",)),
    Leaf("rtloop/wire/slcan.py", ("tests/rtloop/wire/test_slcan_codec.py", WIRES, "-k", "slcan")),
    Leaf("rtloop/wire/can_frame.py", ("tests/rtloop/wire/test_can_frames.py",)),
    Leaf("rtloop/wire/can_errors.py", ("tests/rtloop/wire/test_can_frames.py",)),
    Leaf("rtloop/wire/seeed.py", (WIRES, "-k", "seeedstudio")),
    Leaf("rtloop/wire/at_frames.py", (WIRES, "-k", "ch340-at")),
    Leaf("rtloop/wire/framed.py", (WIRES, "-k", "seeedstudio or ch340-at")),
    Leaf("rtloop/drives/fields.py", ("tests/rtloop/drives/test_words.py", "tests/rtloop/drives/test_golden_frames.py")),
    Leaf(
        "rtloop/drives/errors.py",
        ("tests/rtloop/drives/test_cia402_codec.py", "-k", "common_classes"),
        ("code_words", "code_meanings"),
    ),
    Leaf("rtloop/drives/words.py", ("tests/rtloop/drives/test_words.py", "tests/rtloop/drives/test_golden_frames.py")),
    Leaf("rtloop/drives/sdo.py", ("tests/rtloop/drives/test_cia402_codec.py",), ("writing", "value_in", "_asked")),
    drive("zdt"),
    drive("mks"),
    drive("odrive"),
    drive("damiao"),
    drive("robstride"),
    drive("myactuator"),
    drive("cia402"),
    drive("vesc"),
)

_STOPS_INSIDE = (
    "rtloop/safety/setpoint_check.py check_next_setpoint: "
    "if (velocity > 0.0 and stop > high + BESIDE_RAD) or (velocity < 0.0 and stop < low - BESIDE_RAD): → "
    "if (velocity > 0.0 and stop {} high + BESIDE_RAD) or (velocity < 0.0 and stop {} low - BESIDE_RAD):"
)
_BESIDE = "BESIDE_RAD is what arithmetic may be off by: nobody can say on which side of it the last bit of a sum falls"

_SETPOINT_SUM = (
    "rtloop/safety/setpoint_check.py setpoint_sum: "
    "return float(commanded.next_position_rad + commanded.next_velocity_rad_s + "
    "commanded.next_acceleration_rad_s2) → return float(commanded.next_position_rad {} commanded.next_velocity_rad_s "
    "{} commanded.next_acceleration_rad_s2)"
)
_SENT_SUM = (
    "rtloop/safety/setpoint_check.py may_be_sent: total = setpoint_sum(axis.commanded) + position + velocity → "
    "total = setpoint_sum(axis.commanded) {} position {} velocity"
)
_FINITE = "all that is asked of the sum is whether it is finite, and no sign changes that"

EQUIVALENT: dict[str, str] = {
    **{text.format(*signs): _FINITE for text in (_SETPOINT_SUM, _SENT_SUM) for signs in ("+-", "-+")},
    _STOPS_INSIDE.format(">=", "<"): _BESIDE,
    _STOPS_INSIDE.format(">", "<="): _BESIDE,
    "rtloop/wire/framed.py collect: needed = max(parser.line_needed, 1) → needed = max(parser.line_needed, 2)": (
        "only before a wire's first look is nothing needed, and that look waits for a whole frame of 5 bytes or more"
    ),
    "rtloop/wire/framed.py found_sound: bus.parser.line_spoilt = 0 → bus.parser.line_spoilt = (-1)": (
        "the word is only asked whether it is 1"
    ),
}
"""Keys of mutants (`mutants.making.Mutant.key`) that behave as the original does, each with the reason."""
