"""`rtarm replay`: a recording played back as `rtarm top` shows a running arm, in its own time or slower or quicker."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from rtarm.console.errors import Refusal
from rtarm.console.language import said
from rtarm.running.status import PERCENTS, CountedBus, Report, counters, key, of_cycle, problems, scheduling
from rtarm.top.events import Happening, happenings
from rtarm.top.terminal import show
from rtarm.top.watch import HAPPENINGS, RECENT_S, Look, Timing, span_words, spectrum_of
from sentences.meaning import Language
from sentences.told import joint_name, outcome_sentence
from shm.layout import Counted
from shm.recording import Recording
from shm.words import Event, Outcome

NS = 1_000_000_000


class Playback:
    """Looks at a recording, ever later in it."""

    def __init__(
        self,
        recording: Recording,
        speed: float,
        clock: Callable[[], int] = time.monotonic_ns,
        language: Language = "en",
    ) -> None:
        self._recording = recording
        self._language = language
        self._speed = speed
        self._clock = clock
        self._began_ns = clock()
        told = happenings(recording.events, recording.joints, language, recording.bus_names)
        self._happenings = [one for one, _ in told]
        self._instants = recording.records["monotonic_ns"]

    def close(self) -> None:
        """Nothing is held open."""

    def look(self) -> Look:
        """What was to be seen at the time that has been reached."""
        start_ns, end_ns = int(self._instants[0]), int(self._instants[-1])
        now_ns = min(self._now_ns(), end_ns)
        at = int(np.searchsorted(self._instants, now_ns, side="right")) - 1
        since = int(np.searchsorted(self._instants, now_ns - RECENT_S * NS))
        record = self._recording.records[at]
        report = self._report(at, now_ns)
        if now_ns >= end_ns:
            ends = said(self._language, "The recording ends here, after {s:.1f} s.", s=(end_ns - start_ns) / NS)
            report["problems"].insert(0, ends)
        recent_s = (now_ns - int(self._instants[since])) / NS
        return Look(
            arm=self._recording.arm,
            report=report,
            recent=self._counted(since, at),
            recent_s=recent_s,
            timings=[
                self._timing(what, span, name, first, at)
                for what, name in (("lateness", "lateness_ns"), ("cycle", "cycle_time_ns"))
                for span, first in (
                    (span_words(recent_s, self._language), since),
                    (said(self._language, "all along"), 0),
                )
            ],
            happenings=self._until(now_ns),
            epoch_offset_ns=int(record["epoch_ns"]) - int(record["monotonic_ns"]),
            language=self._language,
        )

    def reached(self) -> int:
        """How many cycles lie behind."""
        return int(np.searchsorted(self._instants, self._now_ns(), side="right"))

    def _now_ns(self) -> int:
        """The time that has been reached, on the recording's clock; it goes on behind the end."""
        return int(self._instants[0]) + round((self._clock() - self._began_ns) * self._speed)

    def _until(self, now_ns: int) -> list[Happening]:
        """What had happened, newest first."""
        past = [one for one in self._happenings if one.monotonic_ns <= now_ns]
        return past[: -HAPPENINGS - 1 : -1]

    def _report(self, at: int, now_ns: int) -> Report:
        recording = self._recording
        record = recording.records[at]
        heartbeat_ns = int(record["heartbeat_ns"])
        report: Report = {
            "arm": recording.arm,
            "running": True,
            **of_cycle(record, recording.joints, now_ns, self._language, recording.bus_names),
            "last_result": self._last_result(at, now_ns),
            "rate_hz": NS / recording.period_ns,
            "uptime_s": int(record["cycle"]) * recording.period_ns / NS,
            "cycle_age_ms": (now_ns - int(record["monotonic_ns"])) * 1e-6,
            "loop": {"pid": recording.pid},
            "front": {
                "pid": said(self._language, "not recorded"),
                "heartbeat_age_ms": (now_ns - heartbeat_ns) * 1e-6 if heartbeat_ns else None,
            },
            "scheduling": scheduling(recording.scheduling),
            **self._counted(None, at),
        }
        report["problems"] = problems(report, self._language)
        report["healthy"] = not report["problems"]
        return report

    def _counted(self, since: int | None, at: int) -> Report:
        """Counters since a cycle, or since the control process' start."""
        records = self._recording.records
        now = records[at]
        counted = {name: int(now[name]) for name in Counted.words}
        counted["cycles"] = int(now["cycle"])
        elapsed_ns = counted["cycles"] * self._recording.period_ns
        if since is not None:
            before = records[since]
            counted = {
                name: value - int(before["cycle" if name == "cycles" else name]) for name, value in counted.items()
            }
            elapsed_ns = int(now["monotonic_ns"] - before["monotonic_ns"])
        bitrate = self._recording.bitrate  # which bus carried what, the cycles do not tell
        return counters(counted, [CountedBus("", bitrate, counted)] if bitrate else [], elapsed_ns)

    def _timing(self, what: str, span: str, name: str, first: int, at: int) -> Timing:
        values = np.maximum(self._recording.records[name][first : at + 1], 0)
        percents = np.percentile(values, list(PERCENTS.values())) * 1e-3
        figures: Report = dict(zip(PERCENTS, percents.tolist(), strict=True))
        return Timing(
            what, span, {**figures, "max": float(values.max()) * 1e-3, "count": len(values)}, spectrum_of(values)
        )

    def _last_result(self, at: int, now_ns: int) -> Report | None:
        events = self._recording.events
        decided = events[(events["kind"] == Event.RESULT) & (events["monotonic_ns"] <= now_ns)]
        if len(decided) == 0:
            return None
        last = decided[-1]
        joint = joint_name(int(last["joint"]), self._recording.joints, self._language)
        before = self._recording.records[: at + 1]
        goals = before["goal_id"][(before["goal_id"] != 0) & (before["monotonic_ns"] <= last["monotonic_ns"])]
        return {
            "goal_id": int(goals[-1]) if len(goals) else 0,
            "outcome": key(Outcome, int(last["code"])),
            "sentence": outcome_sentence(
                int(last["code"]), joint, float(last["value"]), float(last["limit"]), self._language
            ),
        }


def play(recording: Recording, speed: float, language: Language = "en") -> None:
    """Show a recording until somebody ends it.

    Raises:
        Refusal: the speed is none, or there is no terminal.
    """
    if not (math.isfinite(speed) and speed > 0):
        raise Refusal(
            said(
                language,
                "--speed is {speed:g}, but a recording plays forward only: give a factor above 0, such as 0.5.",
                speed=speed,
            )
        )
    no_terminal = said(
        language,
        "`rtarm replay` draws on a terminal, and this is not one: use `rtarm explain` for a recording in words.",
    )
    show(lambda: Playback(recording, speed, language=language), no_terminal)
