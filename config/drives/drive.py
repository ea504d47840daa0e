"""What every family of drives says of itself to the rest of the configuration."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from config.bus import BusConfig
from config.frames import CycleFrames, Identifiers, PeriodicFrames
from config.section import Section


class Drive(Section, ABC):
    """A drive of an arm file; a family's own file says what is different."""

    family: str
    called: ClassVar[str]
    """One of its drives, in sentences."""
    processing_s: ClassVar[float] = 300e-6
    """Time it is assumed to take from a request to its answer (unproven on hardware)."""
    stepper_ramp: ClassVar[bool] = False
    """Whether its ramp is a byte of each command, as in `config.ramp`."""

    counts_on: ClassVar[bool] = False
    """Whether the next start can tell that what it counts means the angle that it meant before."""

    number_field: ClassVar[str] = "address"
    """The field that holds its number."""

    @property
    def number(self) -> int:
        """What tells it from others of its family on the bus; 0 where there is none."""
        return 0

    @property
    def knows_its_angle(self) -> bool:
        """Whether what it counts means an angle as soon as it has power, without homing."""
        return False

    def knows_its_angle_within(self, turns: float) -> bool:
        """The same for a joint whose range is so many motor turns."""
        return self.knows_its_angle

    @property
    def within_a_turn(self) -> str | None:
        """What to do where one that knows its angle within a motor turn alone counts a turn off; None of others."""
        return None

    most_of_a_turn: ClassVar[float | None] = None
    """What a joint's range may be of a motor turn, where positions come round each turn; None where they do not."""

    @property
    def tells_its_position_hz(self) -> float | None:
        """How often it sends its position by itself, where no cycle asks for it; None where each cycle does."""
        return None

    @property
    def plans_its_motion(self) -> bool:
        """Whether it goes to a target with a speed and a ramp of its own, and so brakes by itself in silence."""
        return False

    @property
    def ramp_range_rad_s2(self) -> tuple[float, float] | None:
        """Least and most that the ramp of its own shaft can be set to (rad/s²); None where any will do."""
        return None

    @property
    @abstractmethod
    def highest_motor_rpm(self) -> float:
        """Highest speed that may be asked of a motor (rpm)."""

    @property
    @abstractmethod
    def command_steps_per_revolution(self) -> float:
        """Steps of a position command for one motor turn."""

    @property
    def reading_steps_per_revolution(self) -> float:
        """Steps of a position that it tells, for one motor turn."""
        return self.command_steps_per_revolution

    @property
    def highest_turns(self) -> float | None:
        """Motor turns from its zero that a command can reach, either way; None where no joint can leave that range."""
        return None

    @property
    def identifiers(self) -> tuple[Identifiers, ...]:
        """What it hears and says on the bus."""
        return ()

    def commands(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Frames that lead it in a control cycle, with what it answers to them."""
        return ()

    def readings(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Frames of a control cycle that tell where it is."""
        return ()

    def in_turn(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Frames beside those that a cycle exchanges with one of the arm's drives, each in turn."""
        return ()

    def for_all(self, bus: BusConfig) -> tuple[CycleFrames, ...]:
        """Frames that a cycle sends once for all drives of the family."""
        return ()

    def by_itself(self) -> tuple[PeriodicFrames, ...]:
        """Frames that it sends at its own clock."""
        return ()
