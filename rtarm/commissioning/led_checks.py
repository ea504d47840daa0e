"""The checks of a drive that its ordinary control process leads: whatever its family, through the bytes of every day.

What its manual says of answers, settings and errors is judged by its bring-up, which refuses what is not as documented.
Here it is seen to follow, to fall silent to, to be held fast and to lose its power. Whatever is found limp, or stopped
by a person, stays so until the person at the bench says y to that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from config.schema import ArmConfig
from rtarm.console.errors import Refusal
from rtarm.led.joint import AT_EASE_RAD, DECIDED_S, FASTEST, Cause, End, Led, seconds_for, silent_for_s
from rtloop.drives.setup import power_proof_of
from rtloop.kept.commissioned import PowerProof
from rtloop.offline.commissioning.finding import (
    Check,
    Finding,
    Said,
    Verdict,
    beyond_limits,
    judge_reply_delay,
    reply_delays_s,
    verdict_of,
)
from rtloop.offline.commissioning.session import wire_s
from sentences.told import unreferenced_sentence
from shm.words import Unreferenced

MOST_DEG = 15.0
RANGE_SHARE = 0.25
"""No single move is longer than the least of both."""
GENTLE, BRISK = 0.3, 0.6
"""Shares of the joint's velocity and acceleration that a move uses at most."""
SLOW, SLOW_SHARE = 0.5, 0.1
"""A joint that goes on is slower than so much of its path's speed for so short a share of the time."""
LISTENS_S = 1.0
STILL_RAD = 0.005
"""A joint that stands moves no more."""
SILENCE_S = 1.5
LATE_S = 0.05
"""So old its last reading before a silence may be, and so long it may go on at its speed."""
GOES_ON_CYCLES = 2.0
"""A drive has targets for so many cycles ahead, and brakes then."""
HARDEST_RAMP = 2.0
"""A drive that promises a ramp brakes no harder than so many times that."""
SLACK_RAD = 0.01
PUSH_DEG, PUSH_S, PUSH_RAD = 5.0, 2.0, 0.03
"""Against a clamp; a goal whose joint is farther from its path ends."""
SWITCH_PATIENCE_S = 180.0
SILENT_S = 0.5
"""Without a reading: its plug is pulled, or its power off."""
SAME_RAD = math.radians(2.0)
"""A limp joint that a person holds may turn by so much while its power is off; of more they are asked."""
NO_LOSS = (Unreferenced.OUTSIDE_LIMITS, Unreferenced.POSITION_JUMP)
"""A count that is not believed for where it is, and tells nothing of whether it was lost."""
BOOTS_S = 10.0
"""From the y that its power is on to its first answer, if it gives any before it is brought up."""
ENABLE_TRIES = 3


class Declined(Refusal):
    """The person did not want the joint to be held."""


class Followed(NamedTuple):
    """How a joint followed its path."""

    off_rad: float
    """From it, at the most."""
    slow: float
    """Share of the time amid it in which it was slower than `SLOW` times what it was told."""


class Silenced(NamedTuple):
    """What came of a silence that a person has made."""

    finding: Finding
    angle_right: bool | None = None
    """Whether its angle was kept, or lost, as it should be; None where that was not seen."""


class LedBench:
    """What is found of a joint that is brought up and stands.

    `tell` gets what a person has to do meanwhile, and `agrees` asks: nothing limp is enabled without a y.
    """

    def __init__(self, led: Led, tell: Callable[[str], None], agrees: Callable[[str], bool]) -> None:
        self.led, self._tell, self._agrees = led, tell, agrees
        self.name = led.name
        self.absolute = led.referenced
        """Whether its encoder knows its angle as soon as it has power."""
        self.power_proof: PowerProof | None = None
        """How it proves that it has kept its power; None where that was not tried."""
        self.power = ""
        """What was found of that."""
        self.lets_go = False
        """Whether it let its joint go in any silence."""
        self.found: dict[str, Finding] = {}

    @property
    def brakes_in_silence(self) -> bool | None:
        """Whether it brakes and holds in silence; None where that was not tried."""
        return False if self.lets_go else self.found["silence"].good if "silence" in self.found else None

    def check(self, check: Check, sign: int) -> list[Finding]:
        """Do one check, from a joint that holds and is referenced, and bring it back to where it stood."""
        try:
            self._hold()
            self._know()
            found = check.ask(self, sign)
        except Refusal as refused:
            found = [Finding(check.name, check.explains, "", refused.sentence, Verdict.NOT_TRIED)]
        self.found |= {finding.check: finding for finding in found}
        return found

    def _know(self) -> None:
        """See that its angle is known: one that counts from where power came stands in the middle of its range."""
        if self.led.referenced:
            return
        if int(self.led.joint()["unreferenced_reason"]) == Unreferenced.OUTSIDE_LIMITS:
            raise Refusal(unreferenced_sentence(Unreferenced.OUTSIDE_LIMITS, self.name))
        joint = self.led.config.joints[0]
        self.led.reference(math.radians((joint.lower_deg + joint.upper_deg) / 2.0))

    # --- the checks

    def reply_delay(self, _: int) -> list[Finding]:
        """How soon it answers."""
        self.led.frames()
        self.led.let_pass(LISTENS_S)
        delays_s = reply_delays_s(self.led.frames(), lambda frame: True, self._is_its)
        return [judge_reply_delay(delays_s, wire_s(self.led.config, 0), self.led.config.joints[0].drive.processing_s)]

    def retarget(self, sign: int) -> list[Finding]:
        """A target in motion in each cycle."""
        start_rad, there_rad = self._way(sign * way_of(self.led.config))
        end, went = self._go(there_rad, GENTLE)
        if end.cause is Cause.ARRIVED:
            end, back = self._go(start_rad, BRISK)
            went = Followed(*map(max, zip(went, back, strict=True)))
        off_deg = math.degrees(went.off_rad)
        verdict = _verdict(end, Cause.ARRIVED)
        if end.cause is Cause.ARRIVED and went.slow > SLOW_SHARE:
            verdict = Verdict.DIFFERS
        return [
            Finding(
                "retarget",
                f"{abs(math.degrees(there_rad - start_rad)):.0f}° there and back, with a new target or set-point in "
                "each cycle",
                "it takes each of them and goes on, near its path, and is slower than "
                f"{SLOW:g} × what it was told for no more than {SLOW_SHARE:.0%} of the time",
                end.sentence
                or f"it went there and back, {off_deg:.2f}° from its path at the most, slower than {SLOW:g} × what it "
                f"was told for {went.slow:.0%} of the time",
                verdict,
                {"worst_deg": off_deg, "slow_share": went.slow},
            )
        ]

    def silence(self, sign: int) -> list[Finding]:
        """Nothing more is said to it in motion."""
        arm, way_rad = self.led.config, way_of(self.led.config)
        drive = arm.joints[0].drive
        ramp_rad_s2 = arm.joints[0].max_acceleration_rad_s2 * arm.limits.silence_brake_factor
        asked = f"{SILENCE_S:g} s of silence amid a move of {math.degrees(way_rad):.0f}°"
        brakes = f"brakes at {math.degrees(ramp_rad_s2):.0f} °/s², " if drive.plans_its_motion else ""
        documented = f"it {brakes}stands at the last that it was told, and holds the joint"
        start_rad, there_rad = self._way(sign * way_rad)
        seconds = seconds_for(arm, way_rad, BRISK)
        goal = self.led.go(there_rad, seconds, AT_EASE_RAD)
        self.led.let_pass(seconds / 2.0)
        before, after = self.led.say_nothing(SILENCE_S)
        ended = self.led.end_of(goal, arm.patience.person_s).sentence
        if after is None:
            self._go_back(start_rad)
            came = "it answers no more after the silence"
            return [Finding("silence", asked, documented, came, Verdict.DIFFERS)]
        stands, moving = self.led.joint(), before["joints"][0]
        speed_rad_s = abs(float(moving["commanded_velocity_rad_s"]))
        if speed_rad_s < 0.5 * FASTEST * way_rad / seconds:
            self._go_back(start_rad)
            came = f"it did not move when the silence began: {ended or 'its goal was over'}"
            return [Finding("silence", asked, documented, came, Verdict.NOT_TRIED)]
        beyond_rad = sign * float(stands["measured_position_rad"] - moving["measured_position_rad"])
        braked_rad_s2 = self._braked_rad_s2(speed_rad_s, beyond_rad)
        most_rad = speed_rad_s**2 / (2.0 * ramp_rad_s2) + speed_rad_s * self._late_s + SLACK_RAD
        crept_rad = abs(float(stands["measured_position_rad"] - after["joints"][0]["measured_position_rad"]))
        lets_go = self.led.is_disabled()
        self.lets_go |= lets_go
        stood = crept_rad <= STILL_RAD
        right = stood and not lets_go and -most_rad <= beyond_rad <= most_rad
        right &= not drive.plans_its_motion or braked_rad_s2 <= HARDEST_RAMP * ramp_rad_s2
        braked = f"braked at {math.degrees(braked_rad_s2):.0f} °/s² by its own encoder and held the joint"
        came = (
            f"at {math.degrees(speed_rad_s):.1f} °/s it went on by {math.degrees(beyond_rad):.1f}° "
            f"({math.degrees(most_rad):.1f}° at the most), {'stood' if stood else 'still moved'}, "
            f"{'let the joint go' if lets_go else braked}"
        )
        figures = {
            "speed_deg_s": math.degrees(speed_rad_s),
            "beyond_deg": math.degrees(beyond_rad),
            "braked_deg_s2": math.degrees(braked_rad_s2),
        }
        self._go_back(start_rad)
        return [Finding("silence", asked, documented, came, verdict_of(right), figures)]

    def stall(self, sign: int) -> list[Finding]:
        """It pushes against a clamp."""
        asked = f"{PUSH_DEG:g}° against the clamp"
        documented = "its encoder tells that it stays behind, or its protection trips; the goal ends"
        start_rad, there_rad = self._way(sign * math.radians(PUSH_DEG))
        began_ns = self.led.now_ns()
        goal = self.led.go(there_rad, PUSH_S, PUSH_RAD)
        end = self.led.end_of(goal, PUSH_S + self.led.config.patience.person_s)
        seconds = (self.led.now_ns() - began_ns) * 1e-9
        moved_deg = abs(math.degrees(float(self.led.joint()["measured_position_rad"]) - start_rad))
        self._go_back(start_rad)
        figures = {"moved_deg": moved_deg, "seconds": seconds}
        came = f"after {seconds:.1f} s: {end.sentence or 'nobody noticed that it does not turn'}"
        verdict = _verdict(end, Cause.BEHIND)
        if moved_deg > PUSH_DEG / 2.0:
            came = (
                f"it says that it turned by {moved_deg:.1f}°: the clamp gave way, or its encoder tells what is not so"
            )
            verdict = Verdict.NOT_TRIED
        return [Finding("stall", asked, documented, came, verdict, figures)]

    def unplugged(self, _: int) -> list[Finding]:
        """Its CAN plug is pulled while it stands, and its power stays on."""
        keeps = self.absolute or self._proves
        documented = "it holds the joint; " + (
            "its angle is where it was" if keeps else "its family proves nothing, so its angle is lost"
        )
        finding, angle_right = self._silenced(
            Finding(
                "unplugged",
                "its CAN plug pulled and put back, with its power on",
                documented,
                "its plug was not pulled",
                Verdict.NOT_TRIED,
            ),
            f"Pull the CAN plug of {self.name}'s drive now, and leave its power on.",
            "It is silent. Put the plug back.",
            "Is it back in, and was its power on all the time?",
            keeps=keeps,
            holds=True,
        )
        if angle_right is False:
            self._prove(PowerProof.NONE, finding.came)
        return [finding]

    def power_cycle(self, sign: int) -> list[Finding]:
        """Its power is switched off and on, away from where that was done before: one that counts 0 there shows it."""
        documented = {
            True: "its encoder knows its angle, with or without power",
            False: "it counts from where power came, and cannot pretend that it had power: its angle is lost",
        }[self.absolute]
        asked = "its power switched off and on"
        end, _ = self._go(self._way(sign * way_of(self.led.config))[1], GENTLE)
        if end.cause is not Cause.ARRIVED:
            return [Finding("power cycle", asked, documented, end.sentence, Verdict.NOT_TRIED)]
        finding, angle_right = self._silenced(
            Finding("power cycle", asked, documented, "its power was not switched off", Verdict.NOT_TRIED),
            f"Switch the power of {self.name}'s drive off now; it is watched until it falls silent.",
            "It is silent. Wait until nothing of it is lit, then switch it on again.",
            "Was it dark, is it on again, and did the joint stay where it was?",
            keeps=self.absolute,
            holds=False,
        )
        if angle_right is not None:
            proof = PowerProof.ABSOLUTE if self.absolute else PowerProof.CANARY
            self._prove(proof if angle_right and (self.absolute or self._proves) else PowerProof.NONE, finding.came)
        return [finding]

    # --- what they share

    @property
    def _proves(self) -> bool:
        """Whether its family can prove that it has kept its power, where that is needed."""
        return power_proof_of(self.led.config.joints[0].drive) is not None and not self.absolute

    def _prove(self, proof: PowerProof, came: str) -> None:
        """Remember how it proves its power; one that was found to prove nothing once does so never."""
        if self.power_proof is not PowerProof.NONE:
            self.power_proof, self.power = proof, came

    def _silenced(self, undone: Finding, do: str, then: str, question: str, *, keeps: bool, holds: bool) -> Silenced:
        """Have a person make it silent and end that; whether it `keeps` its angle and `holds` its joint, as told."""
        before_rad = self._stands_rad()
        self._tell(do)
        if self.led.until(lambda now: silent_for_s(now) > SILENT_S, SWITCH_PATIENCE_S) is None:
            return Silenced(undone)
        self._tell(then)
        if not self._agrees(question):
            return Silenced(replace(undone, came="it fell silent, but not as it was asked for, or nobody said so"))
        said_ns = self.led.now_ns()
        patience_s = SWITCH_PATIENCE_S if holds else BOOTS_S  # without power some are asked by their bring-up alone
        heard = self.led.until(lambda now: int(now["joints"][0]["measured_ns"]) > said_ns, patience_s) is not None
        if holds and not heard:
            return Silenced(replace(undone, came=f"it has not answered for {patience_s:g} s since your y"))
        self.led.let_pass(DECIDED_S)
        lets_go = holds and self.led.is_disabled()
        self.lets_go |= lets_go
        how = f"; it {'was limp' if self.led.is_disabled() else 'held the joint'} when it was back" if heard else ""
        try:
            self._hold()
        except Refusal as refused:
            differs = lets_go or (heard and not isinstance(refused, Declined))
            verdict = Verdict.DIFFERS if differs else Verdict.NOT_TRIED
            return Silenced(replace(undone, came=refused.sentence + how, verdict=verdict))
        known, stands_rad = self.led.referenced, self._stands_rad()
        away_rad = abs(stands_rad - before_rad)
        unclear = verdict_of(False) if lets_go else Verdict.NOT_TRIED
        reason = Unreferenced(int(self.led.joint()["unreferenced_reason"]))
        if reason in NO_LOSS:
            return Silenced(replace(undone, came=unreferenced_sentence(reason, self.name) + how, verdict=unclear))
        # a joint that was let go amid it may be elsewhere, and its encoder right
        elsewhere = known and keeps and away_rad > SAME_RAD and not lets_go
        if elsewhere:  # it may have sunk in a hand
            both = f"its encoder says {math.degrees(stands_rad):.1f}°, and said {math.degrees(before_rad):.1f}° before"
            if not self._agrees(f"{self.name}: {both}. Did the joint itself stay where it was?"):
                came = f"{both}, and nobody said that the joint stayed where it was{how}"
                return Silenced(replace(undone, came=came, verdict=unclear))
        angle_right = known == keeps and not elsewhere
        finding = replace(
            undone,
            came=f"its angle was {'kept' if known else 'lost'}, {math.degrees(away_rad):.1f}° from that of before{how}",
            verdict=verdict_of(angle_right and not lets_go),
            figures={"away_deg": math.degrees(away_rad)},
        )
        return Silenced(finding, angle_right)

    def _hold(self) -> None:
        """See it hold and take goals: what keeps it from that is taken away after a y alone; raises Refusal."""
        refused: Refusal | None = None
        for _ in range(ENABLE_TRIES):
            why = self.led.hindrance()
            if not why:
                return
            limp = (
                f"{self.name} is limp, and is enabled where it stands: no hand at it. "
                if self.led.is_disabled()
                else ""
            )
            if not self._agrees(f"{why} {limp}Shall that be cleared, and {self.name} be held where it stands?"):
                raise Declined(why)
            try:
                self.led.clear()
            except Refusal as again:
                refused = again
        raise refused or Refusal(why)

    def _is_its(self, frame: Said) -> bool:
        """Whether this drive has said it; others on the bus have clocks of their own."""
        drive = self.led.config.joints[0].drive
        return any(said.from_drive and not (frame.id ^ said.match) & said.mask for said in drive.identifiers)

    @property
    def _late_s(self) -> float:
        """How long a joint may go on at its speed: what was sent just before the silence is told it a little later."""
        return LATE_S + 3.0 * self.led.config.control.period_ns * 1e-9

    def _braked_rad_s2(self, speed_rad_s: float, beyond_rad: float) -> float:
        """How hard it braked, by the way between its readings of before and after, less that of its last targets."""
        goes_on_rad = speed_rad_s * GOES_ON_CYCLES * self.led.config.control.period_ns * 1e-9
        return speed_rad_s**2 / (2.0 * max(beyond_rad - goes_on_rad, STILL_RAD / 10.0))

    def _stands_rad(self) -> float:
        return float(self.led.joint()["commanded_position_rad"])

    def _way(self, way_rad: float) -> tuple[float, float]:
        """Where it stands, and where such a way ends; raises Refusal where that is beyond its limits."""
        joint = self.led.config.joints[0]
        here_rad = self._stands_rad()
        there_rad = here_rad + way_rad
        if not joint.lower_rad <= there_rad <= joint.upper_rad:
            raise Refusal(beyond_limits(joint, math.degrees(here_rad), math.degrees(there_rad)))
        return here_rad, there_rad

    def _go(self, to_rad: float, share: float) -> tuple[End, Followed]:
        """Go somewhere; how that ended, and how the joint followed."""
        arm, way_rad = self.led.config, abs(to_rad - self._stands_rad())
        seconds = seconds_for(arm, way_rad, share)
        off_rad, speeds = [0.0], [(0.0, 0.0)]

        def look(joint: Any) -> None:
            off_rad.append(abs(float(joint["measured_position_rad"] - joint["reference_position_rad"])))
            speeds.append((abs(float(joint["reference_velocity_rad_s"])), abs(float(joint["measured_velocity_rad_s"]))))

        end = self.led.end_of(self.led.go(to_rad, seconds, AT_EASE_RAD), seconds + arm.patience.person_s, look)
        under_way = [has < SLOW * told for told, has in speeds if told > 0.5 * FASTEST * way_rad / seconds]
        return end, Followed(max(off_rad), sum(under_way) / max(len(under_way), 1))

    def _go_back(self, to_rad: float) -> None:
        """Be where it stood, as far as it can; one that was limp may be anywhere, and turns back after a y alone."""
        try:
            unasked = not self.led.hindrance()
            self._hold()
        except Refusal:
            return  # which is told when the next check begins
        here_rad = self._stands_rad()
        unasked &= abs(here_rad - to_rad) <= way_of(self.led.config) + SLACK_RAD
        from_to = f"from {math.degrees(here_rad):.1f}° to {math.degrees(to_rad):.1f}°, where it began"
        away = abs(here_rad - to_rad) > STILL_RAD
        if away and self.led.referenced and (unasked or self._agrees(f"Shall {self.name} turn back, {from_to}?")):
            self._go(to_rad, GENTLE)


def judge_answers(told: Sequence[str], refused: str) -> Finding:
    """What a bring-up `told`, and why it was `refused`."""
    return Finding(
        "answers",
        "all that a bring-up asks and sets",
        "an answer to each, settings that are taken, a drive that holds",
        refused or " ".join(told) or "it answered, nothing had to be set, and it holds",
        verdict_of(not refused),
    )


def _verdict(end: End, documented: Cause) -> Verdict:
    return Verdict.NOT_TRIED if end.cause is Cause.ELSEWHERE else verdict_of(end.cause is documented)


def way_of(arm: ArmConfig) -> float:
    """How far the joint is moved (rad)."""
    joint = arm.joints[0]
    return math.radians(min(MOST_DEG, RANGE_SHARE * (joint.upper_deg - joint.lower_deg)))


def checks_of(arm: ArmConfig) -> Sequence[Check]:
    """The checks of the arm's joint in their order."""
    name, way_deg = arm.joints[0].name, math.degrees(way_of(arm))
    fastest_deg_s = FASTEST * way_deg / seconds_for(arm, way_of(arm), BRISK)
    ratio = arm.joints[0].ratio
    move = f"{name} turns by {way_deg:.1f}° at up to {fastest_deg_s:.0f} °/s, if its ratio is {ratio:g}, and back"
    return (
        Check("reply delay", "How soon it answers. Nothing moves.", "Listen to it?", LedBench.reply_delay),
        Check("retarget", f"New targets in motion. {move}.", "Turn it?", LedBench.retarget, moves=True),
        Check(
            "silence",
            f"What it does in silence. {move}; on the way there nothing is said to it for {SILENCE_S:g} s, in which it "
            "cannot be stopped but by its switch.",
            "Turn it?",
            LedBench.silence,
            moves=True,
        ),
        Check(
            "stall",
            f"A stall. Clamp {name} so that it cannot turn: it pushes against the clamp by up to {PUSH_DEG:g}° for "
            f"{PUSH_S:g} s, and when its protection trips the joint is limp for a moment.",
            "Is it clamped, and shall it push?",
            LedBench.stall,
            moves=True,
        ),
        Check(
            "unplugged",
            f"A silence with power. {name} holds where it stands. Leave this out where CAN and power share one plug.",
            "Watch it while you pull its CAN plug and put it back?",
            LedBench.unplugged,
        ),
        Check(
            "power cycle",
            f"A loss of power. {name} turns by {way_deg:.1f}° first. It is limp without power: clamp or hold it then. "
            "Every drive on the same switch loses its power, too.",
            "Turn it, and watch it while you switch it off and on?",
            LedBench.power_cycle,
            moves=True,
        ),
    )
