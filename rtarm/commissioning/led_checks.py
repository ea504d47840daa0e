"""The checks of a drive that its ordinary control process leads: whatever its family, through the bytes of every day.

What its manual says of answers, settings and errors is judged by its bring-up, which refuses what is not as documented.
Here it is seen to follow, to fall silent to, to be held fast and to lose its power.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from config.schema import ArmConfig
from rtarm.commissioning.led import FASTEST, Led, seconds_for
from rtarm.errors import Refusal
from rtloop.commissioned import PowerProof
from rtloop.commissioning.finding import Finding, Said, Verdict, judge_reply_delay, reply_delays_s, verdict_of
from rtloop.commissioning.session import wire_s
from rtloop.drives.setup import power_proof_of
from shm.sentences import unreferenced_sentence
from shm.words import DriveStatus, Unreferenced

MOST_DEG = 15.0
RANGE_SHARE = 0.25
"""No single move is longer than the least of both."""
GENTLE, BRISK = 0.3, 0.6
"""Shares of the joint's velocity and acceleration that a move uses at most."""
AT_EASE_RAD = 0.1
"""A joint that is led may be so far from its path before its goal ends; its following error ends more."""
LISTENS_S = 1.0
STILL_RAD = 0.005
"""A joint that stands moves no more."""
SILENCE_S = 1.5
LATE_S = 0.05
"""So old its last reading before a silence may be, and so long it may go on at its speed."""
SLACK_RAD = 0.01
PUSH_DEG, PUSH_S, PUSH_RAD = 5.0, 2.0, 0.03
"""Against a clamp; a goal whose joint is farther from its path ends."""
SWITCH_PATIENCE_S = 180.0
SILENT_S = 0.5
"""Without a reading: its plug is pulled, or its power off."""
SAME_RAD = math.radians(2.0)
"""A limp joint that a person holds may turn by so much while its power is off."""


@dataclass(frozen=True)
class Check:
    """One step of a bench test."""

    name: str
    explains: str
    question: str
    ask: Callable[[LedBench, int], list[Finding]]
    """Of the way the motor turns, 1 or -1."""
    moves: bool = False


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
        self.found: dict[str, Finding] = {}

    def check(self, check: Check, sign: int) -> list[Finding]:
        """Do one check, from a joint that holds and is referenced, and bring it back to where it stood."""
        found = self._checked(check, sign)
        self.found |= {finding.check: finding for finding in found}
        return found

    def _checked(self, check: Check, sign: int) -> list[Finding]:
        why = self.led.fault(self.led.snapshot())
        if why and not self._agrees(f"{why} Shall that be cleared, and {self.name} be held where it stands?"):
            return [_could_not_begin(check, why)]
        try:
            self.led.hold()
            self._know()
        except Refusal as refused:
            return [_could_not_begin(check, refused.sentence)]
        return check.ask(self, sign)

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
        way_rad = sign * way_of(self.led.config)
        asked = f"{abs(math.degrees(way_rad)):.0f}° there and back, with a new target or set-point in each cycle"
        documented = "it takes each of them and goes on, near its path"
        start_rad, worst_rad = self._stands_rad(), 0.0
        for to_rad, share in ((start_rad + way_rad, GENTLE), (start_rad, BRISK)):
            ended, off_rad = self._go(to_rad, share)
            worst_rad = max(worst_rad, off_rad)
            if ended:
                return [Finding("retarget", asked, documented, ended, Verdict.DIFFERS)]
        came = f"it went there and back, {math.degrees(worst_rad):.2f}° from its path at the most"
        return [
            Finding("retarget", asked, documented, came, Verdict.AS_DOCUMENTED, {"worst_deg": math.degrees(worst_rad)})
        ]

    def silence(self, sign: int) -> list[Finding]:
        """Nothing more is said to it in motion."""
        arm, way_rad = self.led.config, sign * way_of(self.led.config)
        asked = f"{SILENCE_S:g} s of silence amid a move of {abs(math.degrees(way_rad)):.0f}°"
        documented = "it stands at the last that it was told, and holds the joint"
        start_rad = self._stands_rad()
        seconds = seconds_for(arm, abs(way_rad), BRISK)
        goal = self.led.go(start_rad + way_rad, seconds, AT_EASE_RAD)
        self.led.let_pass(seconds / 2.0)
        before, after = self.led.say_nothing(SILENCE_S)
        if after is None:
            came = "it answers no more after the silence"
            return [Finding("silence", asked, documented, came, Verdict.DIFFERS)]
        ended = self.led.end_of(goal, arm.patience.person_s)
        stands, moving = self.led.joint(), before["joints"][0]
        speed_rad_s = abs(float(moving["commanded_velocity_rad_s"]))
        if speed_rad_s < 0.5 * FASTEST * abs(way_rad) / seconds:
            came = f"it did not move when the silence began: {ended or 'its goal was over'}"
            return [Finding("silence", asked, documented, came, Verdict.NOT_TRIED)]
        ramp_rad_s2 = arm.joints[0].max_acceleration_rad_s2 * arm.limits.silence_brake_factor
        most_rad = speed_rad_s**2 / (2.0 * ramp_rad_s2) + speed_rad_s * self._late_s + SLACK_RAD
        beyond_rad = sign * float(stands["measured_position_rad"] - moving["measured_position_rad"])
        crept_rad = abs(float(stands["measured_position_rad"] - after["joints"][0]["measured_position_rad"]))
        status = int(stands["drive_status"])
        holds = bool(status & DriveStatus.ENABLED) and not status & DriveStatus.PROTECTED
        stood = crept_rad <= STILL_RAD
        right = holds and stood and -most_rad <= beyond_rad <= most_rad
        came = (
            f"at {math.degrees(speed_rad_s):.1f} °/s it went on by {math.degrees(beyond_rad):.1f}° "
            f"({math.degrees(most_rad):.1f}° at the most), {'stood' if stood else 'still moved'} and "
            f"{'held the joint' if holds else 'let the joint go'}"
        )
        figures = {"speed_deg_s": math.degrees(speed_rad_s), "beyond_deg": math.degrees(beyond_rad)}
        self._go_back(start_rad)
        return [Finding("silence", asked, documented, came, verdict_of(right), figures)]

    def stall(self, sign: int) -> list[Finding]:
        """It pushes against a clamp."""
        asked = f"{PUSH_DEG:g}° against the clamp"
        documented = "its encoder tells that it stays behind, or its protection trips; the goal ends"
        start_rad = self._stands_rad()
        began_ns = self.led.now_ns()
        goal = self.led.go(start_rad + sign * math.radians(PUSH_DEG), PUSH_S, PUSH_RAD)
        ended = self.led.end_of(goal, PUSH_S + self.led.config.patience.person_s)
        seconds = (self.led.now_ns() - began_ns) * 1e-9
        moved_deg = abs(math.degrees(float(self.led.joint()["measured_position_rad"]) - start_rad))
        self._go_back(start_rad)
        figures = {"moved_deg": moved_deg, "seconds": seconds}
        if moved_deg > PUSH_DEG / 2.0:
            came = (
                f"it says that it turned by {moved_deg:.1f}°: the clamp gave way, or its encoder tells what is not so"
            )
            return [Finding("stall", asked, documented, came, Verdict.NOT_TRIED, figures)]
        came = f"after {seconds:.1f} s: {ended}" if ended else "nobody noticed that it does not turn"
        return [Finding("stall", asked, documented, came, verdict_of(bool(ended)), figures)]

    def unplugged(self, _: int) -> list[Finding]:
        """Its CAN plug is pulled while it stands, and its power stays on."""
        keeps = self.absolute or self._proves
        documented = {
            True: "it has held the joint, which is where it was",
            False: "its family proves nothing, so its angle is lost",
        }[keeps]
        finding = self._silenced(
            Finding(
                "unplugged",
                "its CAN plug pulled and put back, with its power on",
                documented,
                "its plug was not pulled and put back",
                Verdict.NOT_TRIED,
            ),
            f"Pull the CAN plug of {self.name}'s drive now, and leave its power on.",
            "It is silent. Put the plug back.",
            "Is it back in, was its power on all the time, and is nobody's hand at the joint?",
            keeps=keeps,
        )
        if finding.verdict == Verdict.DIFFERS:
            self._prove(PowerProof.NONE, finding.came)
        return [finding]

    def power_cycle(self, sign: int) -> list[Finding]:
        """Its power is switched off and on, away from where that was done before: one that counts 0 there shows it."""
        documented = {
            True: "its encoder knows its angle, with or without power",
            False: "it counts from where power came, and cannot pretend that it had power: its angle is lost",
        }[self.absolute]
        asked = "its power switched off and on"
        hindered, _ = self._go(self._stands_rad() + sign * way_of(self.led.config), GENTLE)
        if hindered:
            return [Finding("power cycle", asked, documented, hindered, Verdict.NOT_TRIED)]
        finding = self._silenced(
            Finding("power cycle", asked, documented, "its power was not switched off and on", Verdict.NOT_TRIED),
            f"Switch the power of {self.name}'s drive off now; it is watched until it falls silent.",
            "It is silent. Wait until nothing of it is lit, then switch it on again.",
            "Was it dark, is it on again, and is nobody's hand at the joint? It is enabled where it stands.",
            keeps=self.absolute,
        )
        if finding.verdict != Verdict.NOT_TRIED:
            proof = PowerProof.ABSOLUTE if self.absolute else PowerProof.CANARY
            proves = finding.good and (self.absolute or self._proves)
            self._prove(proof if proves else PowerProof.NONE, finding.came)
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

    def _silenced(self, undone: Finding, do: str, then: str, question: str, *, keeps: bool) -> Finding:
        """Have a person make it silent and end that; whether its angle is kept as it should be, and the same then."""
        before_rad = self._stands_rad()
        self._tell(do)
        silent_ns = round(SILENT_S * 1e9)
        silent = self.led.until(
            lambda now: int(now["monotonic_ns"]) - int(now["joints"][0]["measured_ns"]) > silent_ns, SWITCH_PATIENCE_S
        )
        if silent is not None:
            self._tell(then)
        if silent is None or not self._agrees(question):
            return undone
        ends_ns = self.led.now_ns() + round(SWITCH_PATIENCE_S * 1e9)
        while why := self._not_held():
            if self.led.now_ns() >= ends_ns:
                return replace(undone, came=why, verdict=Verdict.DIFFERS)
            self.led.let_pass(SILENT_S)
        known, away_rad = self.led.referenced, abs(self._stands_rad() - before_rad)
        return replace(
            undone,
            came=f"its angle was {'kept' if known else 'lost'}, {math.degrees(away_rad):.1f}° from that of before",
            verdict=verdict_of(known == keeps and not (known and away_rad > SAME_RAD)),
            figures={"away_deg": math.degrees(away_rad)},
        )

    def _not_held(self) -> str:
        """Clear its fault; why it does not hold then, "" where it does."""
        try:
            self.led.hold()
        except Refusal as refused:
            return refused.sentence
        return ""

    def _is_its(self, frame: Said) -> bool:
        """Whether this drive has said it; others on the bus have clocks of their own."""
        drive = self.led.config.joints[0].drive
        return any(said.from_drive and not (frame.id ^ said.match) & said.mask for said in drive.identifiers)

    @property
    def _late_s(self) -> float:
        """How long a joint may go on at its speed: what was sent just before the silence is told it a little later."""
        return LATE_S + 3.0 * self.led.config.control.period_ns * 1e-9

    def _stands_rad(self) -> float:
        return float(self.led.joint()["commanded_position_rad"])

    def _go(self, to_rad: float, share: float) -> tuple[str, float]:
        """Go somewhere; why it did not arrive, "" where it did, and how far it was from its path at the most."""
        arm = self.led.config
        seconds = seconds_for(arm, abs(to_rad - self._stands_rad()), share)
        goal = self.led.go(to_rad, seconds, AT_EASE_RAD)
        worst_rad = 0.0

        def ended(now: Any) -> bool:
            nonlocal worst_rad
            joint = now["joints"][0]
            worst_rad = max(worst_rad, abs(float(joint["measured_position_rad"] - joint["reference_position_rad"])))
            return goal in now["results"]["goal_id"]

        self.led.until(ended, seconds + arm.patience.person_s)
        why = self.led.end_of(goal, 0.0)
        return "Its goal does not end." if why is None else why, worst_rad

    def _go_back(self, to_rad: float) -> None:
        """Be where it stood, as far as it can: what hinders it is told when the next check begins."""
        if not self._not_held() and self.led.referenced:
            self._go(to_rad, GENTLE)


def _could_not_begin(check: Check, why: str) -> Finding:
    return Finding(check.name, check.explains, "", f"It could not begin: {why}", Verdict.NOT_TRIED)


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
