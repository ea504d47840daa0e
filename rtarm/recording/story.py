"""What a recording tells: what happened, in its order, what came first, which limit was broken, what the arm did."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rtarm.console.chinese import BUS_STATES
from rtarm.console.language import named, said
from rtarm.recording.mcap_format import Reason
from rtarm.running.status import key
from rtarm.top.events import BAD, ODD, PLAIN, happenings
from sentences.meaning import Language
from sentences.told import latched_sentence, meaning, whose_silence
from shm.recording import Recording
from shm.words import BusState, DriveStatus, Event, Fault, Mode, Phase, Slowed

LATE_PERIODS = 2.5
"""A reading older than this was not followed by the next one: at least one answer is missing."""
SIGN_SHARE = 0.5
"""A share of a limit that is worth telling before the limit is reached."""
BURST_S = 0.5
"""Errors of one kind that follow each other within this are told in one line."""
WARNED_S = 5.0
"""Signs that far before a fault are taken for its beginning."""
STANDS_RAD_S = 0.002
"""A measured joint slower than this stands: one encoder count in a cycle is less on every known drive."""

COUNTED = {
    "wire_errors": "{n} garbled {lines} from the adapter, or refusals of it{within}.",
    "bytes_unsent": "{n} {bytes} that the adapter did not take in their cycle{within}.",
    "receive_overflows": "{n} {bytes} lost because the cycle did not take them in time{within}.",
    "drive_errors": "{n} {commands} that a drive refused or did not understand{within}.",
    "error_frames": "{n} {errors} that the CAN controller told of{within}.",
    "unacknowledged": "{n} {errors} of the CAN controller because no drive acknowledged a frame{within}.",
}
"""Counters whose every rise is told."""

SLOWED = {
    Slowed.HELD: ("A person paused the goal: the arm stops on its path and keeps it.", PLAIN),
    Slowed.STARVING: (
        "The rest of the trajectory has not come from the ROS process: the arm brakes on what it has.",
        ODD,
    ),
    Slowed.MAKING_WAY: ("A newer goal waits, and the arm stops on its path to make way for it.", PLAIN),
    Slowed.CLOSING: ("The control process was asked to end: the arm stops on its path.", PLAIN),
    Slowed.OWN_BRAKE: ("Each joint brakes by itself, since the path cannot be trusted.", ODD),
}

UNLED = (Mode.OFFLINE, Mode.BRINGING_UP, Mode.DISABLED, Mode.FREE, Mode.REFERENCING)
"""Modes in which a joint need not be where it is commanded."""

STATUS = {
    DriveStatus.STALLED: "The drive of {joint} reports that its shaft is held{measured}.",
    DriveStatus.PROTECTED: "The drive of {joint} reports that it has an error and may hold nothing (its protection has "
    "tripped){measured}.",
    DriveStatus.POWER_LOST: "The drive of {joint} reports that it has lost power{measured}.",
    DriveStatus.OVER_CURRENT: "The drive of {joint} reports too high a current{measured}.",
    DriveStatus.OVER_VOLTAGE: "The drive of {joint} reports too high a supply voltage{measured}.",
    DriveStatus.UNDER_VOLTAGE: "The drive of {joint} reports too low a supply voltage{measured}.",
    DriveStatus.OVER_TEMPERATURE: "The drive of {joint} reports that it is too hot{measured}.",
    DriveStatus.ENCODER: "The drive of {joint} reports an error of its encoder{measured}.",
    DriveStatus.COMMUNICATION: "The drive of {joint} was lost from sight: it heard nothing for too long, or its status "
    "no longer comes{measured}.",
}


class Line(NamedTuple):
    """Something that happened, its style, whether it is a sign that something is wrong, and when it had an end (ns)."""

    monotonic_ns: int
    sentence: str
    style: str = PLAIN
    sign: bool = False
    joint: int = -1
    end_ns: int = 0


@dataclass(frozen=True)
class Story:
    """A recording, told.

    Attributes:
        zero_ns: the instant that times are told from (CLOCK_MONOTONIC): the fault's, else the last cycle.
        fault: shm.words.Fault that it is about, 0 if about none.
        joint: index of the joint that it is about, -1 if none is to blame.
        first: what came first of what led there, if anything did.
        verdict: sentences about the whole.
    """

    heading: str
    zero_ns: int
    fault: int
    joint: int
    lines: Sequence[Line]
    first: Line | None
    verdict: Sequence[str]


def tell(recording: Recording, reason: Reason, language: Language = "en") -> Story:
    """The story of a recording in a language; a function of these alone."""
    records = recording.records
    at = _latched(records)
    zero_ns = int(records["fault_ns"][at]) if at is not None else int(records["monotonic_ns"][-1])
    lines = sorted(_lines(recording, language), key=lambda line: line.monotonic_ns)
    if reason.word == "death":
        last = said(language, "The last cycle of the control process.")
        lines.append(Line(int(records["monotonic_ns"][-1]), last, BAD, sign=True))
    fault = int(records["fault"][at]) if at is not None else 0
    joint = int(records["fault_joint"][at]) if at is not None else -1
    if at is not None and not any(line.monotonic_ns == zero_ns and line.style == BAD for line in lines):
        lines.append(Line(zero_ns, _fault_words(recording, at, language), BAD, sign=True, joint=joint))
        lines.sort(key=lambda line: line.monotonic_ns)
    first = _first(lines, zero_ns, joint) if at is not None or reason.word == "death" else None
    return Story(
        heading=_heading(recording, zero_ns, language),
        zero_ns=zero_ns,
        fault=fault,
        joint=joint,
        lines=lines,
        first=first,
        verdict=list(_verdict(recording, reason, at, language)),
    )


def _first(lines: Sequence[Line], zero_ns: int, joint: int) -> Line | None:
    """What came first of what led to an instant: the first sign of its joint, or what had just gone wrong before that.

    Signs of nothing in particular, such as a garbled line, belong to it only if they came shortly before; so where no
    joint is to blame, the instant's own line is what they must have come shortly before.
    """
    signs = [line for line in lines if line.sign and 0 <= zero_ns - line.monotonic_ns <= WARNED_S * 1e9]
    if joint >= 0:
        first = next((line for line in signs if line.joint == joint), None)
    else:
        first = next((line for line in signs if line.monotonic_ns == zero_ns and line.style == BAD), None)
    for line in reversed(signs):
        if first is None or line.joint >= 0 or line.monotonic_ns >= first.monotonic_ns:
            continue
        if first.monotonic_ns - max(line.monotonic_ns, line.end_ns) <= BURST_S * 1e9:
            first = line
    return first


def _latched(records: np.ndarray) -> int | None:
    """The cycle in which the newest fault was latched; None if there is none, or only one from before the recording."""
    faulted = records["fault"] != Fault.NONE
    fresh = faulted & (records["fault_ns"] >= records["monotonic_ns"][0])
    if not fresh.any():
        return None
    newest_ns = records["fault_ns"][fresh].max()
    return int(np.flatnonzero(fresh & (records["fault_ns"] == newest_ns))[0])


def _fault_words(recording: Recording, at: int, language: Language) -> str:
    return latched_sentence(recording.records[at], recording.joints, language, recording.bus_names)


def _heading(recording: Recording, zero_ns: int, language: Language) -> str:
    records = recording.records
    at = int(np.clip(np.searchsorted(records["monotonic_ns"], zero_ns, side="right") - 1, 0, None))
    epoch_ns = zero_ns + int(records["epoch_ns"][at] - records["monotonic_ns"][at])
    moment = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(epoch_ns // 1_000_000_000))
    length_s = float(records["monotonic_ns"][-1] - records["monotonic_ns"][0]) * 1e-9
    return said(
        language,
        "{arm}, {length:.1f} s at {rate:g} Hz; times from {moment}",
        arm=recording.arm,
        length=length_s,
        rate=1e9 / recording.period_ns,
        moment=f"{moment}.{epoch_ns // 1_000_000 % 1000:03d}",
    )


# --- what happened ----------------------------------------------------------------------------------------


def _lines(recording: Recording, language: Language) -> Iterator[Line]:
    yield from _from_events(recording, language)
    yield from _goals(recording, language)
    yield from _silences(recording, language)
    yield from _slow(recording, language)
    yield from _counted(recording, language)
    yield from _bus(recording, language)
    yield from _missed(recording, language)
    yield from _front(recording, language)
    yield from _errors(recording, language)
    yield from _drives(recording, language)
    yield from _standing(recording, language)


def _from_events(recording: Recording, language: Language) -> Iterator[Line]:
    start_ns = int(recording.records["monotonic_ns"][0])
    bad = (Event.FAULT, Event.OVERRUN, Event.REFERENCE)
    for told, event in happenings(recording.events, recording.joints, language, recording.bus_names):
        if told.monotonic_ns >= start_ns:
            yield Line(told.monotonic_ns, told.sentence, told.style, int(event["kind"]) in bad, int(event["joint"]))


def _onsets(happens: np.ndarray) -> list[int]:
    """Where a condition begins to hold; not where it held from the start."""
    return (np.flatnonzero(happens[1:] & ~happens[:-1]) + 1).tolist()


def _goals(recording: Recording, language: Language) -> Iterator[Line]:
    """When a goal began to move the arm."""
    records = recording.records
    moves = records["goal_id"] * (records["goal_phase"] == Phase.RUNNING)
    for at in np.flatnonzero((np.diff(moves) != 0) & (moves[1:] != 0)) + 1:
        if moves[at] in records["goal_id"][:at]:
            continue
        known = records["trajectory_end_ns"][records["goal_id"] == moves[at]]
        if known.max() >= 0:
            length_s = float(known.max()) * 1e-9
            moving = said(language, "Goal {id} moves the arm, {length:.2f} s long.", id=moves[at], length=length_s)
        else:
            moving = said(language, "Goal {id} moves the arm.", id=moves[at])
        yield Line(int(records["monotonic_ns"][at]), moving)


def _silences(recording: Recording, language: Language) -> Iterator[Line]:
    """When a drive answered for the last time before answers were missing; once where that befell all of them."""
    found = sorted(_silences_of_each(recording, language), key=lambda line: line.monotonic_ns)
    while found:
        first = found[0]
        within_ns = first.monotonic_ns + LATE_PERIODS * recording.period_ns
        together = {line.joint: line for line in reversed(found) if line.monotonic_ns <= within_ns}
        if len(together) == len(recording.joints) > 1:
            lasted = max((line.end_ns or math.inf) - line.monotonic_ns for line in together.values())
            if math.isinf(lasted):
                silent = said(language, "No drive gives readings from here on.")
            else:
                silent = said(language, "No drive gives readings for {ms:.0f} ms after this.", ms=lasted * 1e-6)
            yield Line(first.monotonic_ns, silent, ODD, sign=True, end_ns=first.end_ns)
        else:
            yield first
            together = {first.joint: first}
        found = [line for line in found if all(line is not told for told in together.values())]


def _silences_of_each(recording: Recording, language: Language) -> Iterator[Line]:
    records = recording.records
    for joint, name in enumerate(recording.joints):
        read_ns = records["joints"]["measured_ns"][:, joint]
        ages_ns = records["monotonic_ns"] - read_ns
        late = (read_ns > 0) & (ages_ns > LATE_PERIODS * recording.period_ns)
        away = np.diff(records["monotonic_ns"], prepend=records["monotonic_ns"][0]) > 1.5 * recording.period_ns
        for at in _onsets(late):
            if away[at]:
                continue  # the cycle was away, not the drive
            last_ns = int(read_ns[at])
            again = np.flatnonzero(~late[at:])
            if len(again) and records["mode"][at] in (Mode.OFFLINE, Mode.BRINGING_UP):
                continue  # bring-up asks for other things than readings
            again_ns = int(read_ns[at + again[0]]) if len(again) else 0
            if again_ns:
                ms = (again_ns - last_ns) * 1e-6
                sentence = said(language, "{joint} gives no readings for {ms:.0f} ms after this.", joint=name, ms=ms)
            else:
                sentence = said(language, "{joint} gives no readings from here on.", joint=name)
            yield Line(last_ns, sentence, ODD, sign=True, joint=joint, end_ns=again_ns)


def _slow(recording: Recording, language: Language) -> Iterator[Line]:
    """Why the arm slowed down."""
    records = recording.records
    for why, (sentence, style) in SLOWED.items():
        for at in _onsets(records["slowed"] & why != 0):
            sign = why == Slowed.STARVING
            yield Line(int(records["monotonic_ns"][at]), said(language, sentence), style, sign)
    for at in _onsets(records["slowed"] & Slowed.LATE_DRIVE != 0):
        ages_ns = records["monotonic_ns"][at] - records["joints"]["measured_ns"][at]
        joint = int(np.argmax(ages_ns))
        allowed_ms = float(recording.limits["stale_brake_ns"]) * 1e-6
        if len(ages_ns) > 1 and ages_ns.min() > LATE_PERIODS * recording.period_ns:
            joint = -1
            sentence = said(
                language,
                "All drives are late: their readings are {age:.0f} ms old and more, and from {allowed:.0f} ms on the "
                "arm brakes on its path.",
                age=ages_ns.min() * 1e-6,
                allowed=allowed_ms,
            )
        else:
            sentence = said(
                language,
                "{joint} is late: its reading is {age:.0f} ms old, and from {allowed:.0f} ms on the arm brakes on its "
                "path.",
                joint=recording.joints[joint],
                age=ages_ns[joint] * 1e-6,
                allowed=allowed_ms,
            )
        yield Line(int(records["monotonic_ns"][at]), sentence, ODD, sign=True, joint=joint)


def _counted(recording: Recording, language: Language) -> Iterator[Line]:
    """Errors on wire and bus, those of a kind that follow each other in one line."""
    records = recording.records
    times = records["monotonic_ns"]
    for name, sentence in COUNTED.items():
        rises = np.diff(records[name])
        burst: list[int] = []
        for at in [*(np.flatnonzero(rises > 0) + 1).tolist(), None]:
            if burst and (at is None or times[at] - times[burst[-1]] > BURST_S * 1e9):
                count = int(rises[np.array(burst) - 1].sum())
                many = "" if count == 1 else "s"
                nouns = {noun + "s": noun + many for noun in ("line", "byte", "command", "error")}
                lasted_s = float(times[burst[-1]] - times[burst[0]]) * 1e-9
                within = said(language, " within {seconds:.2f} s", seconds=lasted_s) if len(burst) > 1 else ""
                words = said(language, sentence, n=count, within=within, **nouns)
                yield Line(int(times[burst[0]]), words, ODD, sign=True, end_ns=int(times[burst[-1]]))
                burst = []
            if at is not None:
                burst.append(at)


def _bus(recording: Recording, language: Language) -> Iterator[Line]:
    """What the CAN controller thought of its bus, whenever that changed."""
    records = recording.records
    states = records["bus_state"]
    for at in (np.flatnonzero(np.diff(states)) + 1).tolist():
        worse = bool(states[at] > states[at - 1])
        name = named(language, BUS_STATES, key(BusState, int(states[at])))
        now = said(language, "The CAN controller is {state} now.", state=name)
        yield Line(int(records["monotonic_ns"][at]), now, ODD if worse else PLAIN, worse)


def _missed(recording: Recording, language: Language) -> Iterator[Line]:
    """When the cycle was away, or what it did is not in the recording."""
    records = recording.records
    gaps_ns = np.diff(records["monotonic_ns"])
    skipped = np.diff(records["number"]) - 1
    for at in (np.flatnonzero(skipped > 0) + 1).tolist():
        if skipped[at - 1] == 1:
            missing = said(language, "1 control cycle is missing in the recording after this.")
        else:
            missing = said(language, "{n} control cycles are missing in the recording after this.", n=skipped[at - 1])
        yield Line(int(records["monotonic_ns"][at - 1]), missing, ODD)
    for at in (np.flatnonzero((gaps_ns > 1.5 * recording.period_ns) & (skipped == 0)) + 1).tolist():
        missed = round(float(gaps_ns[at - 1]) / recording.period_ns) - 1
        late_ms = records["lateness_ns"][at] * 1e-6
        woke = said(language, " (woken {ms:.1f} ms late)", ms=late_ms) if late_ms else ""
        if missed == 1:
            sentence = said(language, "1 control cycle was missed after this{woke}.", woke=woke)
        else:
            sentence = said(language, "{n} control cycles were missed after this{woke}.", n=missed, woke=woke)
        yield Line(int(records["monotonic_ns"][at - 1]), sentence, ODD, sign=True)


def _front(recording: Recording, language: Language) -> Iterator[Line]:
    """When the ROS process fell silent."""
    records = recording.records
    ages_ns = records["monotonic_ns"] - records["heartbeat_ns"]
    silent = (records["heartbeat_ns"] > 0) & (ages_ns > SIGN_SHARE * float(recording.limits["front_timeout_ns"]))
    for at in _onsets(silent):
        again = np.flatnonzero(~silent[at:])
        if len(again):
            lasted_s = float(ages_ns[at + again[0] - 1]) * 1e-9
            sentence = said(
                language, "The ROS process gives no sign of life for {seconds:.2f} s after this.", seconds=lasted_s
            )
        else:
            sentence = said(language, "The ROS process gives no sign of life from here on.")
        yield Line(int(records["heartbeat_ns"][at]), sentence, ODD, sign=True)


def _errors(recording: Recording, language: Language) -> Iterator[Line]:
    """When a joint had fallen behind its setpoint by half of what is allowed."""
    records, allowed = recording.records, float(recording.limits["following_error_rad"])
    joints = records["joints"]
    errors = np.abs(joints["measured_position_rad"] - joints["reference_position_rad"])
    led = ~np.isin(records["mode"], UNLED)[:, None] & (joints["referenced"] == 1)
    far = led & (errors > SIGN_SHARE * allowed)
    for joint, name in enumerate(recording.joints):
        for at in _onsets(far[:, joint]):
            sentence = said(
                language,
                "{joint} is {error:.4f} rad from where it is commanded, half of the {allowed:.4f} rad "
                "that are allowed.",
                joint=name,
                error=errors[at, joint],
                allowed=allowed,
            )
            yield Line(int(records["monotonic_ns"][at]), sentence, ODD, sign=True, joint=joint)


def _drives(recording: Recording, language: Language) -> Iterator[Line]:
    """What drives reported of themselves, and what they had measured by then."""
    records = recording.records
    for joint, name in enumerate(recording.joints):
        status = records["joints"]["drive_status"][:, joint]
        for bit, what in STATUS.items():
            for at in _onsets(status & bit != 0):
                measured = _measured(records["joints"][at, joint], language)
                sentence = said(language, what, joint=name, measured=measured)
                yield Line(int(records["monotonic_ns"][at]), sentence, ODD, sign=True, joint=joint)
        enabled = status & DriveStatus.ENABLED != 0
        answered = status & DriveStatus.ANSWERED != 0
        for at in _onsets(~enabled & answered):
            if status[at - 1] & DriveStatus.ENABLED:
                sentence = said(language, "The drive of {joint} reports that it is not enabled.", joint=name)
                yield Line(int(records["monotonic_ns"][at]), sentence, ODD, sign=True, joint=joint)


def _measured(row: np.void, language: Language) -> str:
    """What the drive had measured of itself when it said something, as far as it measures anything."""
    told = (("drive_temperature_c", "{:.0f} °C"), ("drive_voltage_v", "{:.1f} V"), ("measured_effort", "{:.2f} Nm"))
    found = [words.format(row[name]) for name, words in told if math.isfinite(row[name])]
    return said(language, " ({figures})", figures=", ".join(found)) if found else ""


def _standing(recording: Recording, language: Language) -> Iterator[Line]:
    """When the arm stood, after a fault or at the end of a motion."""
    records = recording.records
    commanded = np.any(records["joints"]["commanded_velocity_rad_s"] != 0.0, axis=1)
    for at in _onsets(~commanded):
        yield Line(int(records["monotonic_ns"][at]), said(language, "No joint is commanded to move any more."))


# --- what it comes to -------------------------------------------------------------------------------------


def _verdict(recording: Recording, reason: Reason, at: int | None, language: Language) -> Iterator[str]:
    records = recording.records
    if at is None and reason.word != "death":
        standing = int(records["fault"][-1])
        if standing != Fault.NONE:
            before = _fault_words(recording, len(records) - 1, language)
            yield said(language, "A fault was latched before this recording begins: {fault}", fault=before)
        else:
            yield said(language, "No fault was latched in this recording.")
    if reason.word == "death":
        yield said(
            language,
            "The control process ended without an orderly end (killed, or by a defect); {drives}.",
            drives=_left_alone(recording, language),
        )
    if at is not None:
        yield _fault_words(recording, at, language)
        yield _what_the_arm_did(recording, at, language)
        row = meaning(_known_fault(int(records["fault"][at])), language)
        why = row.reason
        whose = whose_silence(*(int(records[f"fault_{word}"][at]) for word in ("joint", "silent", "evidence")))
        if records["fault"][at] == Fault.STALE_READING and whose is not None:
            row = meaning(whose, language)
            why = said(language, "{one} {other}", one=why, other=row.reason)
        if why:
            yield said(language, "Why that is a fault: {reason}", reason=why)
        if row.remedy:
            yield said(language, "What to do: {remedy}", remedy=row.remedy)
    if recording.lost:
        yield said(language, "{n} records were being written when they were read, and are left out.", n=recording.lost)


def _left_alone(recording: Recording, language: Language) -> str:
    """What the drives did when the control process had died."""
    if recording.bitrate == 0:
        return said(language, "it had no bus, and so no drives")
    if recording.records["mode"][-1] == Mode.REFERENCING:
        return said(language, "a drive amid its homing run goes on")
    if not np.any(recording.records["joints"]["commanded_velocity_rad_s"][-1] != 0.0):
        return said(language, "no joint was commanded to move then")
    return said(language, "the drives went on for a moment and stopped by themselves")


def _known_fault(number: int) -> Fault:
    try:
        return Fault(number)
    except ValueError:
        return Fault.NONE


def _what_the_arm_did(recording: Recording, at: int, language: Language) -> str:
    after = recording.records[at:]
    start_ns = int(after["fault_ns"][0])
    moving = np.any(after["joints"]["commanded_velocity_rad_s"] != 0.0, axis=1)
    own = np.any(after["slowed"] & Slowed.OWN_BRAKE)
    how = said(language, "each joint braked by itself") if own else said(language, "the arm stopped on its path")
    if not moving.any():
        return said(language, "The arm stood when it was latched, and nothing was commanded to move afterwards.")
    if moving[-1]:
        return said(language, "Then {how}; where the recording ends it is still commanded to move.", how=how)
    last = int(np.flatnonzero(moving)[-1])
    took_s = (int(after["monotonic_ns"][min(last + 1, len(after) - 1)]) - start_ns) * 1e-9
    still = np.abs(after["joints"]["measured_velocity_rad_s"][-1]) > STANDS_RAD_S
    names = [name for name, moves in zip(recording.joints, still, strict=True) if moves]
    if not names:
        return said(language, "Then {how} and came to rest {took:.2f} s after the fault.", how=how, took=took_s)
    return said(
        language,
        "Then {how} and came to rest {took:.2f} s after the fault; {joints} measured as moving at the end.",
        how=how,
        took=took_s,
        joints=said(language, ", ").join(names),
    )


def guilty_joint(recording: Recording, story: Story) -> int:
    """The joint worth looking at: the fault's, else that of the first sign, else the one with the largest error."""
    if story.joint >= 0:
        return story.joint
    if story.first is not None and story.first.joint >= 0:
        return story.first.joint
    joints = recording.records["joints"]
    errors = np.abs(joints["measured_position_rad"] - joints["reference_position_rad"])
    worst = np.nanmax(np.where(np.isfinite(errors), errors, 0.0), axis=0)
    return int(np.argmax(worst))


def since(line_ns: int, zero_ns: int) -> str:
    """A time from the story's instant, such as `-0.104 s`."""
    seconds = (line_ns - zero_ns) * 1e-9
    return f"{seconds:+9.3f} s" if not math.isclose(seconds, 0.0, abs_tol=5e-7) else "        0 s"
