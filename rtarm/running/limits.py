"""What the joints of an arm may do, as its control process has it."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]

EQUAL = 1e-6
"""Limits that differ by less than this share are the same: those of a file are rounded."""


@dataclass(frozen=True)
class Limits:
    """What the joints of an arm may do; (joints,) each."""

    joints: tuple[str, ...]
    lower_rad: Reals
    upper_rad: Reals
    velocity_rad_s: Reals
    acceleration_rad_s2: Reals

    def difference(self, other: Limits) -> str:
        """What `other` has else, in words, with its value last; "" if it is the same arm's."""
        if self.joints != other.joints:
            return f"the joints are {', '.join(self.joints)}, not {', '.join(other.joints)}"
        for field, word, unit in zip(
            fields(self)[1:],
            ("lower limit", "upper limit", "velocity limit", "acceleration limit"),
            ("°", "°", "°/s", "°/s²"),
            strict=True,
        ):
            own, others = (np.degrees(getattr(limits, field.name)) for limits in (self, other))
            for joint, one, another in zip(self.joints, own, others, strict=True):
                if not math.isclose(one, another, rel_tol=EQUAL, abs_tol=1e-4):
                    return f"the {word} of {joint} is {one:.6g}{unit}, not {another:.6g}{unit}"
        return ""


def limits_of(joints: tuple[str, ...], limits: np.ndarray) -> Limits:
    """What an arm's control process allows its joints, from its state file's limits (layout.Limits)."""
    rows = limits["joints"][: len(joints)]
    return Limits(
        joints,
        *(
            rows[name].astype(float)
            for name in ("lower_rad", "upper_rad", "max_velocity_rad_s", "max_acceleration_rad_s2")
        ),
    )
