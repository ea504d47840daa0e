"""No drive at all."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from config.drives.drive import Drive
from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION


class MockDrive(Drive):
    """No drive: what is commanded is at once measured."""

    family: Literal["mock"] = Field(description="Drive family.")
    called: ClassVar[str] = "a mock drive"
    counts_on: ClassVar[bool] = True
    highest_motor_rpm: ClassVar[float] = 3000.0

    @property
    def command_steps_per_revolution(self) -> float:
        """A mock drive is commanded in the counts of an encoder, in which it is also measured."""
        return ENCODER_COUNTS_PER_REVOLUTION
