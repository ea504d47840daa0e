"""The session of a bench test: one check after another of one drive, each with its findings."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import numpy as np

from config.schema import ArmConfig
from config.serial_adapters import SERIAL_ADAPTERS
from rtloop.kept.commissioned import Commissioned, PowerProof
from rtloop.kept.reference_store import NotSaved, channel_of
from rtloop.offline import families
from rtloop.offline.calibration.session import DriveState, NotDone, Session
from rtloop.offline.commissioning.finding import Check, Finding, Said, Verdict, beyond_limits, frames_of
from rtloop.process.initial_state import byte_s
from rtloop.service.conversation import DialogueFailed, Unaddressed
from shm.words import Unreferenced


def checks_of(arm: ArmConfig, joint: int) -> list[Check]:
    """The checks of a joint's drive in their order; raises NotDone for a family without checks."""
    drive = arm.joints[joint].drive
    if not families.knows("commissioning", drive):
        raise NotDone(
            f"{arm.joints[joint].name} has {drive.called}, and there are no checks for its family yet: "
            "docs/hardware/drive-families.md says what is unproven of it."
        )
    return cast(list[Check], families.file_of("commissioning", drive).checks_of(arm, joint))


def wire_s(arm: ArmConfig, joint: int) -> float:
    """Time (s) that the request for a joint's position and its answer take on bus and serial line."""
    bus = arm.bus_of(arm.joints[joint])
    adapter = SERIAL_ADAPTERS.get(bus.interface, SERIAL_ADAPTERS["slcan"])
    frames = arm.joints[joint].drive.readings(bus)
    return sum(one.bits / bus.bitrate + byte_s(bus) * adapter.bytes_of(one) for one in frames)


class Bench(Session):
    """A session in which one drive is checked; `recorded` returns the frames (layout.BusFrame) since its last call."""

    def __init__(self, *arguments: Any, recorded: Callable[[], np.ndarray], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._recorded = recorded
        self._findings: dict[str, Finding] = {}
        self._at_bench: int | None = None
        self._held: set[int] = set()
        self.power_proof: PowerProof | None = None

    def checks(self, joint: int) -> list[Check]:
        """The checks of a joint's drive, which is at the bench from now on; raises NotDone if its family has none."""
        self._at_bench = joint
        return checks_of(self.arm, joint)

    def hold(self, joint: int) -> DriveState:
        self._held.add(joint)
        return super().hold(joint)

    def see_it_stand(self) -> None:
        """Raise DialogueFailed unless the drive at the bench stands, and holds its joint if it ever did."""
        if (joint := self._at_bench) is not None:
            held = joint in self._held or self.found[joint].enabled
            self._have_undisturbed(joint, lambda motor: motor.stand_held() if held else motor.stand())

    def check(self, name: str, joint: int, sign: int) -> list[Finding]:
        """Carry out one check; a check that could not be tried gives a finding too.

        Raises DialogueFailed if a drive that may be moving does not report that it stands.
        """
        check = next((check for check in checks_of(self.arm, joint) if check.name == name), None)
        if check is None or sign not in (1, -1):
            raise NotDone(f"There is no check {name!r} of {self.arm.joints[joint].name}.")
        self.frames()
        try:
            found = check.ask(self, joint, sign)
        except (DialogueFailed, NotSaved) as problem:
            if check.moves:
                self.have(joint, lambda motor: motor.stand())
            found = [Finding(name, check.explains, "", str(problem), Verdict.NOT_TRIED)]
        self._findings |= {finding.check: finding for finding in found}
        return found

    def record(self, joint: int) -> Commissioned:
        """What the control process may rely on, according to the checks so far."""
        drive = self.arm.joints[joint].drive
        good = {name: finding.good for name, finding in self._findings.items()}
        return Commissioned(
            channel=channel_of(self.arm),
            family=drive.family,
            number=drive.number,
            firmware=self.found[joint].firmware,
            when=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            power_proof=self.power_proof,
            power=self._findings["power flag"].came if self.power_proof is not None else "",
            fast_targets=good.get("fast targets"),
            reports=good.get("reports"),
            retargets=good.get("retarget"),
            brakes_in_silence=good.get("silence"),
        )

    def frames(self) -> list[Said]:
        """The frames on the bus since the last call."""
        return frames_of(self._recorded())

    def say_nothing(self, joint: int, for_ns: int) -> None:
        """Send nothing on the bus for `for_ns`; if an exception ends that early, the drive is stopped."""
        until_ns = self._clock_ns() + for_ns
        with self._stopping(joint):
            while self._clock_ns() < until_ns:
                self._pause()

    def require_room(self, joint: int, by_counts: int) -> None:
        """Raise DialogueFailed if turning the motor by `by_counts` would take the joint beyond its limits.

        Nothing is raised if the joint's angle is not known.
        """
        state, config = self.look(joint), self.arm.joints[joint]
        here_rad, there_rad = (
            counts / self.port.reading_per_rad(joint) - self.port.zero_rad(joint)
            for counts in (state.counts, state.counts + by_counts)
        )
        if state.doubt is None and not config.lower_rad <= there_rad <= config.upper_rad:
            raise DialogueFailed(joint, beyond_limits(config, math.degrees(here_rad), math.degrees(there_rad)))

    @contextmanager
    def ending_with(self, joint: int, dialogue: Callable[[Any], Unaddressed[object]]) -> Iterator[None]:
        """Run a dialogue at the end of the context, also after an exception; raises DialogueFailed."""
        try:
            yield
        finally:
            self._have_undisturbed(joint, dialogue)

    def _have_undisturbed(self, joint: int, dialogue: Callable[[Any], Unaddressed[object]]) -> None:
        """Run a dialogue that no input can end early."""
        pause, self._pause = self._pause, self._rest
        try:
            self.have(joint, dialogue)
        finally:
            self._pause = pause

    def forget_mark(self, joint: int) -> None:
        """Forget the drive's mark, because it is about to be overwritten, and the drive's power to be switched off."""
        self._marks[joint] = None

    def lose(self, joint: int) -> None:
        """Store that the drive has lost its power; raises NotSaved."""
        self._remember(joint, Unreferenced.POWER_LOST)
