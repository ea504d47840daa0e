"""The way through one joint: direction, ratio, zero; each step explained, agreed to, and left out at will."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from config.schema import ArmConfig
from rtarm.calibrate.angles import (
    FIRST_MOTOR_DEG,
    READ_TO_DEG,
    Move,
    RatioFound,
    joint_move,
    least_angle_deg,
    most_joint_deg,
    motor_angle_deg,
    nudges,
    ratio_found,
    zero_deg,
)
from rtarm.calibrate.drives import Drive, State
from rtarm.calibrate.words import positive_in_words
from rtarm.console.errors import Refusal
from rtarm.console.person import Person, agrees, as_number, chosen, number
from rtloop.drives.setup import homes_by_a_run
from rtloop.offline.calibration.session import NotDone

RATIO_DIGITS = 4
AT_STOP_DEG = 0.5
"""A limit within this of the homing stop is the stop; a joint that was homed is believed 1.1° outside its limits."""
FALLS = (
    "Limp, the joint turns freely and falls where gravity pulls it and all that hangs on it: take its weight in your "
    "hands before you agree."
)


@dataclass
class Values:
    """What is believed of a joint."""

    direction: int
    ratio: float
    zero_deg: float

    def changes_from(self, other: Values) -> dict[str, float]:
        """The fields that differ, with the new values."""
        before = vars(other)
        return {field: value for field, value in vars(self).items() if value != before[field]}


class Guide:
    """One joint's way; `values` has what has been found and agreed to so far, `limits` those that changed with it.

    `require` raises Refusal where the arm file could not have the values it is called with.
    """

    def __init__(
        self,
        arm: ArmConfig,
        joint: int,
        drive: Drive,
        person: Person,
        require: Callable[[Mapping[str, float]], None],
    ) -> None:
        self._arm = arm
        self._joint = joint
        self._config = arm.joints[joint]
        self._name = self._config.name
        self._drive = drive
        self._homes = homes_by_a_run(self._config.drive)
        self._where_zero = "at its homing stop" if self._homes else "where its drive counts 0"
        self._person = person
        self._require = require
        self._longest_motor_deg = 0.0
        self.limits: dict[str, float] = {}
        self.before = Values(self._config.direction, self._config.ratio, self._config.zero_deg)
        self.values = Values(**vars(self.before))

    @property
    def changes(self) -> dict[str, float]:
        """The fields of the joint that are to be written, with their new values."""
        return {**self.values.changes_from(self.before), **self.limits}

    def go(self) -> None:
        """All three steps; raises Quit, Refusal for a ratio the file cannot have, and whatever the drives raise."""
        before, tell = self.before, self._person.tell
        state = self._drive.look()
        tell("")
        tell(
            f"{self._name} (drive {self._config.drive.number}, {'held' if state.enabled else 'limp'}). The file says: "
            f"direction {before.direction}, ratio {before.ratio:g}, zero_deg {before.zero_deg:g}."
        )
        if not state.enabled:
            if not agrees(self._person, "Its drive must hold it to go on. Let it hold the joint where it stands?"):
                tell(f"{self._name} is left out.")
                return
            self._drive.hold()
        seen = self._find_direction()
        self._find_ratio()
        if not seen and self.values.ratio > self.before.ratio:
            tell("With this ratio the joint may turn farther than what could not be seen.")
            self._find_direction()
        means_an_angle = self._homes or self._config.knows_its_angle  # any other is told where it stands at each start
        if not self._find_zero() and self.changes and means_an_angle:
            self._warn_of_zero()

    # --- 1: direction

    def _find_direction(self) -> bool:
        """False where even the farthest turn was too little to be seen, as with a ratio that is far too small."""
        tell = self._person.tell
        tell(f"1. Direction. {positive_in_words(self._arm, self._joint)}")
        moves = nudges(self.values.ratio, self._config.motor_rpm)
        sign, farther = 1, 0
        while farther < len(moves):
            move = moves[farther]
            tell(f"{self._described(Move(sign * move.turns, move.rpm))}, and back again.")
            answer = self._person.answer("Turn it? [y/N; o: the other way first; q ends]").lower()
            if answer == "o":
                sign = -sign
                continue
            if answer not in ("y", "yes"):
                break
            if not self._turned(Move(sign * move.turns, move.rpm)):
                continue
            seen = chosen(
                self._person,
                f"It has turned and stands. Which way did {self._name} go?",
                {"p": "the positive way", "n": "the negative way", "u": "not seen, go farther"},
            )
            self._turn(Move(-sign * move.turns, move.rpm))
            if seen == "u":
                farther += 1
                continue
            if not seen or not agrees(self._person, "It has turned back. Was that the opposite way?"):
                tell("Then it is not clear yet.")
                continue
            self.values.direction = sign if seen == "p" else -sign
            tell(f"direction: {self.values.direction}{self._beside_file('direction')}")
            return True
        tell(f"direction stays {self.values.direction}.")
        return farther < len(moves)

    # --- 2: ratio

    def _find_ratio(self) -> None:
        tell = self._person.tell
        tell(
            f"2. Ratio: motor turns for one turn of {self._name}. The joint is put on two marks, one after the other, "
            f"whose angle you measure; {least_angle_deg(self.values.ratio):.0f}° or more, 90° is good."
        )
        while how := self._asked_how():
            turns = self._between_marks(how)
            angle_deg = None if turns is None else number(self._person, "By how many degrees did the joint turn?")
            if turns is None or angle_deg is None:
                break
            found = ratio_found(turns, abs(angle_deg), self._config.ratio)
            if found.too_small_for:
                tell(found.too_small_for)
                continue
            tell(
                f"The motor turned {abs(turns):.3f} times: the ratio is {found.measured:.3f} ± "
                f"{found.uncertainty:.2f}, if you read the angle to ±{READ_TO_DEG:g}°."
            )
            ratio = self._decided(found)
            if ratio is not None:
                self.values.ratio = ratio
                self._require(self.changes)  # a zero found with it could not be written either
                tell(f"ratio: {ratio:g}{self._beside_file('ratio')}")
                return
        tell(f"ratio stays {self.values.ratio:g}.")

    def _decided(self, found: RatioFound) -> float | None:
        suggestion = found.suggestion or round(found.measured, RATIO_DIGITS)
        why = "what the file says fits" if suggestion == self._config.ratio else "the only whole number that fits"
        if found.suggestion is None:
            why = "as measured; no whole number fits"
        if agrees(self._person, f"Take {suggestion:g} ({why})?"):
            return suggestion
        own = number(self._person, "Which ratio then?")
        if own is None:
            return None
        if own <= 0 or (
            abs(own - found.measured) > found.uncertainty
            and not agrees(self._person, f"{own:g} does not fit what was measured. Take it all the same?")
        ):
            return None
        return round(own, RATIO_DIGITS)

    def _between_marks(self, how: str) -> float | None:
        """By how much the motor turned between two marks; None if the person does not want to."""
        if how == "h":
            if not agrees(self._person, f"{FALLS} Make {self._name} limp?"):
                return None
            self._drive.let_go()
            self._person.answer("It is limp. Put it on the first mark, then press Enter [q ends]:")
            first = self._drive.look()
            self._person.answer("Turn it to the second mark, then press Enter [q ends]:")
            second = self._drive.look()
            self._take_hold()
            return second.turns - first.turns
        began = self._jogged_to("the first mark")
        ended = None if began is None else self._jogged_to("the second mark")
        return None if began is None or ended is None else ended.turns - began.turns

    # --- 3: zero

    def _find_zero(self) -> bool:
        """Whether it was found."""
        tell, values = self._person.tell, self.values
        tell(
            f"3. Zero: {self._where_zero} {self._name} is at -zero_deg, {-values.zero_deg:g}° by the file. The joint "
            "is put where you know its angle, best on its zero mark."
        )
        if not (self._counts_from_stop() if self._homes else self._knows_its_angle()):
            tell(f"zero_deg stays {values.zero_deg:g}.")
            return False
        while how := self._asked_how():
            state = self._placed(how)
            if state is None:
                break
            angle_deg = number(self._person, f"At how many degrees does {self._name} stand there (0 on its zero mark)?")
            if angle_deg is None:
                break
            found = zero_deg(state.turns, values.ratio, values.direction, angle_deg)
            tell(
                f"The motor stands {motor_angle_deg(state.turns, values.ratio):.2f}° of the joint from "
                f"{'the homing stop' if self._homes else 'there'}: zero_deg is {found:g}, as well as the joint stands "
                "on the mark."
            )
            if self._fits({"zero_deg": found}) and agrees(self._person, f"Take {found:g}?"):
                values.zero_deg = found
                tell(f"zero_deg: {found:g}{self._beside_file('zero_deg')}")
                if self._homes:
                    self._match_limit(state.turns)
                return True
        tell(f"zero_deg stays {values.zero_deg:g}.")
        return False

    def _match_limit(self, turns: float) -> None:
        """The homing stop is an end of the joint's range: offer its angle for the limit there."""
        values, name = self.values, self._name
        low = values.direction * turns > 0
        field, other = ("lower_deg", "upper_deg") if low else ("upper_deg", "lower_deg")
        limit, stop = getattr(self._config, field), -values.zero_deg + 0.0  # no -0
        inside_deg = (limit - stop) if low else (stop - limit)
        if turns == 0 or abs(inside_deg) < AT_STOP_DEG:
            return
        self._person.tell(
            f"So the homing stop is the {'lower' if low else 'upper'} end of {name}, at {stop:g}°, but {field} in the "
            f"file is {limit:g}: "
            + (
                "a joint that has been homed then stands outside its limits, and is not believed."
                if inside_deg > 0
                else "a goal beyond the stop would press the joint against it."
            )
        )
        if self._fits({field: stop}) and agrees(self._person, f"Take {stop:g} for {field}?"):
            self.limits = {field: stop}
            self._person.tell(
                f"{field}: {stop:g}; the file says {limit:g}. {other} stays {getattr(self._config, other):g}: see that "
                f"{name} gets so far."
            )
        else:
            self._person.tell(f"{field} stays {limit:g}: mend it by hand before you move the arm.")

    def _fits(self, changes: Mapping[str, float]) -> bool:
        """Whether the file could have these values too; the person is told why not."""
        try:
            self._require({**self.changes, **changes})
        except Refusal as problem:
            self._person.tell(str(problem))
            return False
        return True

    def _warn_of_zero(self) -> None:
        """Other values have changed, and the zero was not found with them."""
        values, config = self.values, self._config
        self._person.tell(
            f"zero_deg {values.zero_deg:g} was not found with these values: it is right only if {self._name} is at "
            f"{-values.zero_deg:g}° {self._where_zero}. If it was measured with the old ones, find it anew."
        )
        state = self._drive.look()
        if state.doubt is not None:
            return
        here_deg = values.direction * motor_angle_deg(state.turns, values.ratio) - values.zero_deg
        limits = f"{config.lower_deg:g}° to {config.upper_deg:g}°"
        inside = config.lower_deg - AT_STOP_DEG <= here_deg <= config.upper_deg + AT_STOP_DEG
        self._person.tell(
            f"With them {self._name} would stand at {here_deg:.1f}° now, {'within' if inside else 'outside'} its "
            f"limits of {limits}: look whether that is so."
        )

    def _counts_from_stop(self) -> bool:
        """Whether the drive counts from the homing stop, after a homing run if the person wants one."""
        doubt = self._drive.look().doubt
        if doubt is not None:
            self._person.tell(f"{self._name} {doubt}.")
        elif agrees(self._person, "Its drive says that it has been homed. Is that so, at this very stop?"):
            return True
        rpm = self._drive.homing_rpm
        speed = f"at {rpm} rpm of the motor" if rpm is not None else "at the speed of its menu"
        self._person.tell(
            f"A homing run is the drive's own: it runs {speed}, the way its menu says, until something stops it. "
            "Nothing sees what is in its way; Ctrl-C ends it."
        )
        if not agrees(self._person, f"Home {self._name} now, with the way to its stop free?"):
            self._person.tell("Without a homing run the zero cannot be found.")
            return False
        self._drive.home()
        return True

    def _knows_its_angle(self) -> bool:
        """Whether the drive counts from the same place whenever it gets power; if not, the person is told."""
        if self._config.knows_its_angle:
            return True
        self._person.tell(
            f"The drive of {self._name} does not know by itself where the joint stands, so zero_deg says nothing: say "
            f"the angle with `rtarm reference {self._name}=DEGREES` after each start."
        )
        return False

    def _placed(self, how: str) -> State | None:
        if how == "d":
            return self._jogged_to("its mark")
        if not agrees(self._person, f"{FALLS} Make {self._name} limp?"):
            return None
        self._drive.let_go()
        self._person.answer("It is limp. Put it on its mark, then press Enter [q ends]:")
        state = self._drive.look()
        self._take_hold()
        return state

    # --- what steps share

    def _asked_how(self) -> str:
        return chosen(
            self._person,
            f"How shall {self._name} get to the mark?",
            {"d": "by its drive, in small turns you agree to", "h": "by hand, limp"},
        )

    def _jogged_to(self, mark: str) -> State | None:
        """Turn the joint by its drive until the person says that it is there; None if they give up."""
        values = self.values
        while True:
            most = self._most_joint_deg()
            answer = self._person.answer(
                f"Degrees to turn {self._name}, up to ±{most:g} at a time [a number; y: it is on {mark}; Enter: give "
                "up; q ends]"
            ).lower()
            if not answer:
                return None
            if answer in ("y", "yes"):
                return self._drive.look()
            wanted_deg = as_number(answer)
            if not abs(wanted_deg) <= most:
                self._person.tell(f"{answer} is no number from -{most:g} to {most:g}.")
                continue
            move = joint_move(values.direction * wanted_deg, values.ratio, self._config.motor_rpm)
            if agrees(self._person, f"{self._described(move)}. Turn it?"):
                self._turned(move)

    def _most_joint_deg(self) -> float:
        """Longest next move: a wrong ratio shows in a short one, so none is more than twice as long as those before."""
        seen_deg = max(FIRST_MOTOR_DEG, 2.0 * self._longest_motor_deg) / self.values.ratio
        return min(most_joint_deg(self.values.ratio), float(f"{seen_deg:.3g}"))

    def _turned(self, move: Move) -> bool:
        """Turn the motor; where that is farther than it may go the person is told, and nothing moves."""
        try:
            self._turn(move)
        except NotDone as refused:
            self._person.tell(str(refused))
            return False
        return True

    def _turn(self, move: Move) -> None:
        self._drive.turn(move.turns, move.rpm)
        self._longest_motor_deg = max(self._longest_motor_deg, abs(move.motor_deg))

    def _take_hold(self) -> None:
        self._person.answer("Keep it there and press Enter: its drive then holds it where it stands [q ends]:")
        self._drive.hold()

    def _described(self, move: Move) -> str:
        return (
            f"The motor of {self._name} turns by {move.motor_deg:+.1f}° at {move.rpm} rpm, the joint by "
            f"{abs(move.motor_deg) / self.values.ratio:.1f}° if its ratio is {self.values.ratio:g}"
        )

    def _beside_file(self, field: str) -> str:
        before, now = getattr(self.before, field), getattr(self.values, field)
        return ", as in the file." if before == now else f"; the file says {before:g}."
