"""Comparison of what a ZDT (Emm_V5) drive did at the bench with its manual (zdt-emm-v5.md): a pure function a check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION as TURN
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.zdt_ask import NOT_UNDERSTOOD, Ask
from rtloop.drives.zdt_protocol import Block, Version
from rtloop.kept.commissioned import PowerProof
from rtloop.offline.calibration.zdt import ARRIVED_COUNTS, AWAY_COUNTS
from rtloop.offline.commissioning.finding import (
    RAMP_RANGE,
    Finding,
    Said,
    Samples,
    Verdict,
    braking_rev_s2,
    speeds_rev_s,
    verdict_of,
)
from rtloop.offline.commissioning.zdt_talk import PowerCycle, Pressed, Ran, Trial

FIRST_SHARE, RETARGET_SHARE = 0.6, 0.25
"""Shares of the trial's distance: the first target, and the position at which the second target is sent."""
GOES_ON = 0.7
"""Least speed after the second target, as a share of the expected one."""
STALL_TIMES = (0.5, 1.5)
STALL_SPARE_S = 1.0
"""A stall must trip within these shares of its time, plus this reserve: the torque grows with the error."""

QUESTIONS: Mapping[str, Ask] = {
    "firmware (1F)": Ask(protocol.ASK_FIRMWARE, (4, 6)),
    "status (3A)": Ask(protocol.ASK_STATUS, (3,)),
    "homing status (3B)": Ask(protocol.ASK_HOMING_STATUS, (3,)),
    "position (36)": Ask(protocol.ASK_POSITION, (7,)),
    "target (33)": Ask(protocol.ASK_TARGET, (7,)),
    "speed (35)": Ask(protocol.ASK_SPEED, (5,)),
    "supply (24)": Ask(protocol.ASK_SUPPLY, (4,)),
    "current (27)": Ask(protocol.ASK_CURRENT, (4,)),
    "homing parameters (22)": Ask(protocol.ASK_HOMING, (8,), packets=protocol.HOMING_PACKETS),
    "configuration (42)": Ask(protocol.ASK_BLOCK, (8,), packets=protocol.BLOCK_PACKETS),
    "watchdog (16)": Ask(protocol.ASK_WATCHDOG, (6,)),
    "protection (13)": Ask(protocol.ASK_TRIP, (8,)),
}
"""Every question that rtarm asks, with the lengths of its answer."""
NEWER = ("watchdog (16)", "protection (13)")
"""Questions that older firmware answers with `00 EE 6B`."""


def judge_answers(answers: Mapping[str, bytes | None], address: int) -> Finding:
    """Judge `answers`, with packets joined, by the names of `QUESTIONS`; `address` is where the drive answered."""
    version = protocol.version_of(answers["firmware (1F)"])
    newer = version is not None and version.newer
    block = protocol.block_of(answers["configuration (42)"])
    other = []
    for name, answer in answers.items():
        wanted = answer == NOT_UNDERSTOOD if name in NEWER and not newer else _is_answer(QUESTIONS[name], answer)
        if not wanted:
            other.append(f"{name}: {'nothing' if answer is None else answer.hex(' ').upper()}")
    if block is None and version is not None and not other:
        other.append("configuration (42): another block than the one of 33 bytes and 21 fields")
    if version is not None and not version.known:
        other.append(f"firmware {version}, of which nothing is known")
    if block is not None and block.address != address:
        other.append(f"address {block.address} in its configuration, but it answers at {address}")
    told = f"{len(answers)} answers as documented, firmware {version}" if not other else "; ".join(other)
    return Finding(
        "answers",
        f"{len(answers)} questions: {', '.join(answers)}",
        "an answer of the documented length to each; 00 EE 6B to what older firmware has not got",
        told,
        verdict_of(not other),
        {"questions": len(answers), "as_documented": len(answers) - len(other)},
    )


def _is_answer(ask: Ask, answer: bytes | None) -> bool:
    return answer is not None and answer[0] == ask.payload[0] and not (len(answer) == 3 and 3 not in ask.reply_lengths)


def samples_of(frames: Sequence[Said], start: int, way_counts: int) -> Samples:
    """The received positions, from where a move began (counts) and positive in its direction."""
    rows = [
        (frame.time_ns, counts)
        for frame in frames
        if not frame.sent and (counts := protocol.signed_of(frame.data, protocol.ASK_POSITION, 4)) is not None
    ]
    first_ns = rows[0][0] if rows else 0
    sign = 1 if way_counts >= 0 else -1
    found = [((time_ns - first_ns) * 1e-9, sign * (counts - start) / TURN) for time_ns, counts in rows]
    return np.array(found, np.float64).reshape(-1, 2)


def judge_silence(forth: Ran, samples: Samples, trial: Trial, back_rev: float, watchdog_ms: int) -> Finding:
    """Judge a move during which the drive was only asked for positions, and the move back in complete silence.

    `back_rev` is the distance that was left of the move back when the drive was asked again (revolutions).
    """
    told = trial.ramp_rpm_s
    asked = (
        f"one target {trial.turns * 360.0:.0f}° of the motor away at {trial.rpm} rpm with ramp {trial.acc_byte}, and "
        "back in complete silence"
    )
    documented = f"it brakes at {told:.0f} rpm/s by itself and stands on the target" + (
        f"; its watchdog stops it after {watchdog_ms} ms" if watchdog_ms else ""
    )
    if forth.problem is not None:
        return Finding("silence", asked, documented, forth.problem, Verdict.DIFFERS)
    went = abs(forth.stands - forth.start)
    if abs(went - trial.counts) > ARRIVED_COUNTS:
        came = f"it stood after {went * 360.0 / TURN:.0f}° already"
        return Finding("silence", asked, documented, came, Verdict.DIFFERS)
    braked = braking_rev_s2(samples, went / TURN, told / 60.0, trial.rpm / 60.0)
    if braked is None:
        came = "too few readings while it braked: the bus is too slow or too busy for this"
        return Finding("silence", asked, documented, came, Verdict.NOT_TRIED)
    factor = braked * 60.0 / told
    may_be_left = trial.counts if watchdog_ms else 0  # the watchdog stops it before its target
    arrived = abs(back_rev) * TURN <= may_be_left + ARRIVED_COUNTS
    came = f"it braked at {braked * 60.0:.0f} rpm/s, {factor:.2f} × the documented ramp, and after the silence stood "
    came += f"{abs(back_rev) * 360.0:.1f}° from its target"
    right = RAMP_RANGE[0] <= factor <= RAMP_RANGE[1] and arrived
    figures = {"told_rpm_s": told, "braked_rpm_s": braked * 60.0, "factor": factor, "left_deg": back_rev * 360.0}
    return Finding("silence", asked, documented, came, verdict_of(right), figures)


def judge_retarget(ran: Ran, frames: Sequence[Said], trial: Trial, sign: int) -> Finding:
    """Judge a second, farther target that was sent while the motor moved."""
    asked = f"a target at {FIRST_SHARE:.0%} of the way, and in motion, at {RETARGET_SHARE:.0%}, one at its end"
    documented = "it takes the second target and goes on from the speed it has (old firmware may answer E2)"
    done = sign * (ran.stands - ran.start)
    refused = any(not frame.sent and frame.data == b"\xfd\xe2\x6b" for frame in frames)
    told_ns = [frame.time_ns for frame in frames if frame.sent and frame.data[:1] == b"\xfd" and frame.id & 0xFF == 0]
    figures = {"way_deg": trial.turns * 360.0, "went_deg": done * 360.0 / TURN}
    if ran.problem is not None:
        return Finding("retarget", asked, documented, ran.problem, Verdict.DIFFERS, figures)
    if abs(done - trial.counts) > ARRIVED_COUNTS or refused or len(told_ns) < 2:
        came = "it refused the second target (E2)" if refused else "it did not take the second target"
        came += f" and stood after {figures['went_deg']:.0f}° of {figures['way_deg']:.0f}°"
        return Finding("retarget", asked, documented, came, Verdict.DIFFERS, figures)
    after = [frame for frame in frames if frame.time_ns >= told_ns[1]]
    samples = samples_of(after, ran.start, sign)
    brake_rev = trial.rpm**2 / trial.ramp_rpm_s / 120.0
    goes_on = samples[samples[:, 1] <= trial.turns - brake_rev]
    if len(goes_on) < 3:
        return Finding("retarget", asked, documented, "too few readings in motion", Verdict.NOT_TRIED, figures)
    # the ramp may not have been climbed yet when the second target came
    slowest = float(np.min(speeds_rev_s(goes_on)[:, 1])) * 60.0
    figures["slowest_rpm"] = slowest
    right = slowest >= GOES_ON * _speed_at(trial, RETARGET_SHARE * trial.turns)
    came = f"it took the second target, and was never slower than {slowest:.0f} of {trial.rpm} rpm"
    return Finding("retarget", asked, documented, came, verdict_of(right), figures)


def _speed_at(trial: Trial, way_rev: float) -> float:
    """Speed (rpm) of the ramp from rest after a distance."""
    return min(float(trial.rpm), float((120.0 * trial.ramp_rpm_s * way_rev) ** 0.5))


def judge_power_flag(cycle: PowerCycle | None) -> Finding:
    """Judge the flag for lost power, bit 7 of `3A` (yu1745/libzdt, zdt-protocol.md 5.4.4)."""
    asked = "the flag for lost power (bit 7 of 3A), cleared by 50 00, after its power was switched off and on"
    if cycle is None:
        documented = "1 after a loss of power, 0 once cleared"
        return Finding("power flag", asked, documented, "it was never silent: its power stayed on", Verdict.NOT_TRIED)
    newer = cycle.firmware.newer
    documented = "1 after a loss of power, 0 once cleared" if newer else "none in this firmware: always 0"
    before, after, cleared = (
        "nothing" if bit is None else f"{bit:d}" for bit in (cycle.flag_before, cycle.flag_after, cycle.flag_cleared)
    )
    right = (cycle.flag_before, cycle.flag_after, cycle.flag_cleared) == (False, newer, False)
    came = f"read {before} before, seen {after} after the power cycle, cleared, read {cleared}"
    figures = {"silent_s": cycle.silent_s, "counts_before": cycle.counts_before, "counts_after": cycle.counts_after}
    return Finding("power flag", asked, documented, came, verdict_of(right), figures)


def judge_volatile(cycle: PowerCycle | None) -> Finding:
    """Judge whether settings written with store byte 00 were lost with the power."""
    asked = "a homing time-out (4C AE) and a stall time (48 D1) in volatile memory, after its power was switched off"
    documented = "what is not stored is gone with the power"
    if cycle is None:
        came = "it was never silent: its power stayed on"
        return Finding("volatile settings", asked, documented, came, Verdict.NOT_TRIED)
    found = {"homing time-out": cycle.homing_forgotten, "stall time": cycle.block_forgotten}
    words = {True: "gone", False: "still there", None: "not to be had"}
    came = ", ".join(f"{name} {words[forgotten]}" for name, forgotten in found.items())
    if all(forgotten is None for forgotten in found.values()):
        return Finding("volatile settings", asked, documented, came, Verdict.NOT_TRIED)
    return Finding("volatile settings", asked, documented, came, verdict_of(False not in found.values()))


def not_put_back(problem: Exception) -> Finding:
    """The finding that the changed settings were not verified to be restored."""
    asked = "both settings put back"
    return Finding("put back", asked, "they are taken, and read so", str(problem), Verdict.NOT_TRIED)


def power_proof(cycle: PowerCycle | None) -> PowerProof | None:
    """How this drive can prove that it has kept its power; None if that was not tried."""
    if cycle is None:
        return None
    if cycle.firmware.newer and judge_power_flag(cycle).good:
        return PowerProof.FLAG
    return PowerProof.CANARY if cycle.homing_forgotten else PowerProof.NONE


def judge_stall(pressed: Pressed, block: Block) -> Finding:
    """Judge how a motor behaved that pushed against a clamp."""
    protects = block.stall_mode != 0
    limit_s = block.stall_time_ms * 1e-3
    asked = "a small turn against the clamp"
    documented = (
        f"it says that it stalls, and after {limit_s:.1f} s trips its protection, which 0E 52 clears"
        if protects
        else "it says that it stalls, and goes on pushing until it is stopped: its protection is off"
    )
    figures = {"seconds": pressed.seconds, "moved_deg": pressed.moved * 360.0 / TURN, "stall_time_s": limit_s}
    if pressed.problem is not None:
        return Finding("stall", asked, documented, pressed.problem, Verdict.DIFFERS, figures)
    if pressed.moved > AWAY_COUNTS:
        came = f"the clamp gave way: the motor turned by {figures['moved_deg']:.0f}° and was stopped"
        return Finding("stall", asked, documented, came, Verdict.NOT_TRIED, figures)
    stalled, tripped = bool(pressed.flags & protocol.STALLED), bool(pressed.flags & protocol.PROTECTED)
    came = f"flags {pressed.flags:02X} after {pressed.seconds:.1f} s" + (
        f", protection {'cleared' if pressed.cleared else 'not cleared: the joint is limp'}" if tripped else ""
    )
    in_time = STALL_TIMES[0] * limit_s <= pressed.seconds <= STALL_TIMES[1] * limit_s + STALL_SPARE_S
    right = stalled and (tripped and in_time and pressed.cleared if protects else not tripped)
    return Finding("stall", asked, documented, came, verdict_of(right), figures)


def judge_fast_targets(version: Version, problem: str | None) -> Finding:
    """Judge the test of FC; `problem` is the sentence of `rtloop.drives.zdt_fast_targets`, None if it passed."""
    asked, documented = "targets of FC, two pulses away, after F1 with mode 01", "they are absolute"
    if version.firmware < protocol.FAST_FIRMWARE:
        came = f"firmware {version} has no FC; 2.0.0 or newer has"
        return Finding("fast targets", asked, documented, came, Verdict.NOT_TRIED)
    return Finding("fast targets", asked, documented, problem or "they are absolute", verdict_of(problem is None))


def judge_reports(version: Version, period_ms: int, problem: str | None, ceased: bool) -> Finding:
    """Judge reports; `problem` is the sentence of `rtloop.drives.zdt_reports`, None if they came as they should."""
    asked = f"its position by itself, every {period_ms} ms (11 18), and no more"
    documented = "newer firmware sends it at that rate, and ceases when told"
    if not version.newer:
        came = f"firmware {version} has no reports; that of the X42S generation has"
        return Finding("reports", asked, documented, came, Verdict.NOT_TRIED)
    came = problem or ("it sends it at that rate, and ceased" if ceased else "it goes on sending when told to cease")
    return Finding("reports", asked, documented, came, verdict_of(problem is None and ceased))
