"""What stands beside the arm, as HTML: pure functions of a look. Everything from outside is escaped."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

from config.joint import JointConfig
from config.schema import ArmConfig
from rtarm.console.chinese import MODES, PHASES
from rtarm.console.language import named
from rtarm.running.referencing import Reading, no_angle_words
from rtarm.running.status import DOUBTFUL_BUS, describe_scheduling
from rtarm.running.status_tables import buses_words, duration_words, gripper_words, trouble_words
from rtarm.top.events import BAD, GOOD, ODD, Happening
from rtarm.top.watch import Look
from rtarm.view.limits import Nearness, Side, nearness, share
from rtarm.view.words import Words
from sentences.drive_words import listed

EVENTS = 24
"""So many are shown, newest first."""

STYLE = """<style>
.rt {font-size: 13px; line-height: 1.4; padding: 4px 10px; color: #1f2933}
.rt b.mode {font-size: 17px; margin-right: 8px}
.rt .tag {display: inline-block; border-radius: 10px; padding: 0 8px; font-size: 12px; color: #fff; background: #2b8a3e}
.rt .tag.bad {background: #c92a2a} .rt .tag.wait {background: #b35c00}
.rt code {font-size: 12px; background: #f1f3f5; border-radius: 3px; padding: 0 3px}
.rt .say {border-left: 4px solid #e67700; background: #fff4e6; padding: 4px 8px; margin-top: 5px; border-radius: 3px}
.rt .say.bad {border-color: #c92a2a; background: #fff0f0}
.rt .say.good {border-color: #2b8a3e; background: #ebfbee}
.rt .box {max-height: 190px; overflow-y: auto; margin-bottom: 6px}
.rt .dim {color: #7b8794}
.rt table {border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums}
.rt th {font-weight: 500; color: #7b8794; text-align: right; padding: 1px 0 1px 6px}
.rt td {text-align: right; padding: 1px 0 1px 6px; white-space: nowrap}
.rt th:first-child, .rt td:first-child {text-align: left; padding-left: 0}
.rt td.text {text-align: left; white-space: normal}
.rt .near td {color: #b35c00} .rt .bad td {color: #c92a2a}
.rt .bar {position: relative; height: 3px; background: #e4e7eb; border-radius: 2px; margin: 0 0 4px}
.rt .bar i {position: absolute; width: 7px; height: 7px; top: -2px; margin-left: -3px; border-radius: 4px}
.rt .bar i.is {background: #3e4c59} .rt .bar i.ought {background: #2878dc; opacity: .5}
.rt .near .bar i.is {background: #e67700} .rt .bad .bar i.is {background: #c92a2a}
.rt .GOOD {color: #2b8a3e} .rt .BAD {color: #c92a2a} .rt .ODD {color: #b35c00}
@media (max-width: 36em) {
  div:has(> .rt-stop) + div {position: fixed; top: 8px; left: 0; right: 0; z-index: 1000}
  div:has(+ div div .rt-stop) {pointer-events: none}
  div:has(+ div div .rt-stop) > :last-child {pointer-events: auto}
}
.u-legend .u-value, .u-legend tr:first-child {display: none} .u-legend th::after {content: "" !important}
</style>"""
STOP_FOLLOWS = '<span class="rt-stop"></span>'
"""Stands before the button that stops the arm, which on a phone is at the top of the screen. The head of
the sheet takes no taps there, its last icon excepted: browsers take none of a button in a sheet that is folded up."""
OF_THE_PAST = "<style>canvas {filter: grayscale(1); opacity: .3} .rt.now {opacity: .4}</style>"
"""What is shown is not of now."""

_CLASSES = {GOOD: "GOOD", BAD: "BAD", ODD: "ODD"}


def state_html(look: Look, words: Words) -> str:
    """Mode, fitness and goal; why what is shown is not of now."""
    report = look.report
    if report is None or look.trouble is not None:
        said = "" if look.trouble is None else _say(look.trouble, "bad", "trouble") + OF_THE_PAST
        return _page(f'<b class="mode" id="rt-mode">{escape(words.waiting)}</b>{said}')
    held = report["held"] and report["mode"] in ("holding", "executing")
    mode = words.held if held else named(words.language, MODES, report["mode"])
    kind, told = ("", words.fit) if report["healthy"] else (" bad", words.unfit)
    if held:
        kind, told = " wait", words.held_tag
    tag = f'<span class="tag{kind}">{escape(told)}</span>'
    goal = words.goal.format(stands=goal_words(report, words), scale=report["speed_scale"])
    return _page(
        f'<div><b class="mode" id="rt-mode" data-mode="{escape(report["mode"])}">{escape(mode)}</b>{tag}</div>'
        f'<div id="rt-goal">{escape(goal)}</div>'
    )


def problems_html(look: Look, arm: ArmConfig, words: Words) -> str:
    """What is wrong and what to do; else how the last goal ended."""
    report = look.report
    if report is None:
        return _page("", now=True)
    fault, last = report["fault"], report["last_result"]
    lines = [
        _say(sentence, "bad" if fault is not None and sentence == fault["sentence"] else "", "problem")
        for sentence in report["problems"]
    ]
    if report["goal"] is None and last is not None:
        told = words.last_result.format(id=last["goal_id"], sentence=last["sentence"])
        lines.append(f'<div class="dim" id="rt-result">{_legible(told)}</div>')
    if arm.kinematics is None:
        lines.append(f'<div class="dim">{escape(words.no_geometry)}</div>')
    return _page(f'<div class="box">{"".join(lines)}</div>', now=True)


def goal_words(report: Mapping[str, Any], words: Words) -> str:
    """Where the running goal stands."""
    goal = report["goal"]
    if goal is None:
        return words.no_goal
    phase = named(words.language, PHASES, goal["phase"])
    text = words.goal_endless if goal["duration_s"] is None else words.goal_of
    return text.format(id=goal["id"], phase=phase, clock=goal["clock_s"] or 0.0, duration=goal["duration_s"])


def joints_html(look: Look, arm: ArmConfig, words: Words) -> str:
    """A row a joint: where it is and ought to be, in its range too, and the limit it is near."""
    if look.report is None:
        return _page("", now=True)
    head = "".join(f"<th>{escape(one)}</th>" for one in (words.joint, words.measured, words.commanded, words.error))
    rows, near = [], []
    for joint, config in zip(look.report["joints"], arm.joints, strict=True):
        close = nearness(config, joint["position_rad"])
        rows.append(_joint(joint, config, close))
        if close is not None:
            near.append(_say(near_words(config.name, close, words), "bad" if close.side is Side.BEYOND else "", "near"))
        if joint["drive_trouble"]:
            near.append(_say(f"{config.name}: {listed(joint['drive_trouble'], words.language)}", "bad", "drive"))
    gripper = look.report.get("gripper")
    held = ""
    if gripper is not None:
        held = f"<div>{_legible(words.gripper.format(does=gripper_words(gripper, words.language)))}</div>"
    return _page(f"<table><tr>{head}</tr>{''.join(rows)}</table>{held}{''.join(near)}", now=True)


def degrees(value_rad: float | None, digits: int) -> str:
    """An angle in so many decimals of a degree, none of which is -0."""
    return "-" if value_rad is None else f"{round(math.degrees(value_rad), digits) + 0.0:.{digits}f}"


def near_words(joint: str, close: Nearness, words: Words) -> str:
    """The sentence about a limit that is near."""
    text = {Side.LOWER: words.near_lower, Side.UPPER: words.near_upper, Side.BEYOND: words.beyond}[close.side]
    return text.format(joint=joint, distance=close.distance_deg, limit=close.limit_deg)


def _joint(joint: Mapping[str, Any], config: JointConfig, close: Nearness | None) -> str:
    kind = "bad" if (close is not None and close.side is Side.BEYOND) or not joint["referenced"] else ""
    kind = kind or ("near" if close is not None else "")
    name = escape(config.name)
    figures = "".join(
        f'<td data-{key}="{name}">{degrees(joint[field], digits)}</td>'
        for key, field, digits in (
            ("measured", "position_rad", 2),
            ("commanded", "commanded_rad", 2),
            ("error", "error_rad", 3),
        )
    )
    dots = "".join(
        f'<i class="{dot}" style="left:{100.0 * share(config, at_rad):.1f}%"></i>'
        for dot, at_rad in (("ought", joint["commanded_rad"]), ("is", joint["position_rad"]))
        if at_rad is not None
    )
    return (
        f'<tr class="{kind}"><td>{name}</td>{figures}</tr>'
        f'<tr class="{kind}"><td colspan="4"><div class="bar">{dots}</div></td></tr>'
    )


def events_html(look: Look, words: Words) -> str:
    """What happened, newest first."""
    rows = [_event(one, look.epoch_offset_ns) for one in look.happenings[:EVENTS]]
    return _page(f"<table>{''.join(rows)}</table>" if rows else escape(words.nothing_yet))


def _event(one: Happening, epoch_offset_ns: int) -> str:
    clock = time.strftime("%H:%M:%S", time.localtime((one.monotonic_ns + epoch_offset_ns) * 1e-9))
    kind = _CLASSES.get(one.style, "")
    return f'<tr><td class="dim" valign="top">{clock}</td><td class="text {kind}">{_legible(one.sentence)}</td></tr>'


def machine_html(look: Look, words: Words) -> str:
    """What bears on punctuality: cycles, overruns, lateness, bus, processes."""
    report, recent = look.report, look.recent
    if report is None or recent is None:
        return _page("", now=True)
    rows = [
        (
            words.cycles,
            words.cycles_told.format(
                cycles=report["cycles"], rate=report["rate_hz"], uptime=duration_words(report["uptime_s"])
            ),
            "",
        ),
        (
            words.overruns,
            words.overruns_told.format(all=report["overruns"], recent=recent["overruns"], span=look.recent_span),
            "BAD" if recent["overruns"] else "",
        ),
    ]
    names = {"lateness": words.lateness, "cycle": words.cycle_time}
    rows += [
        (names[timing.what], words.percentiles.format(**timing.figures, span=timing.span), "")
        for timing in look.timings[::2]
    ]
    bus = recent["bus"]
    seconds = look.recent_s
    if bus["load"] is None or seconds <= 0.0:
        rows.append((words.bus, words.no_bus, ""))
    else:
        told = words.bus_told.format(
            load=bus["load"], sent=bus["frames_tx"] / seconds, received=bus["frames_rx"] / seconds
        )
        rows.append((words.bus, told, ""))
    if "buses" in recent:
        doubtful = any(one["state"] in DOUBTFUL_BUS for one in recent["buses"])
        rows.append((words.buses, buses_words(recent["buses"], words.language), "BAD" if doubtful else ""))
    if trouble := trouble_words(report["bus"], words.language):
        rows.append((words.bus_trouble, trouble, "BAD" if trouble_words(bus) else ""))
    front = report["front"]["pid"]
    scheduling = describe_scheduling(report["scheduling"], words.language)
    rows += [
        (words.ros, words.ros_none if front is None else words.ros_told.format(pid=front), ""),
        (
            words.control,
            words.control_told.format(pid=report["loop"]["pid"], scheduling=scheduling),
            "",
        ),
    ]
    cells = (
        f'<tr><td class="dim" valign="top">{escape(name)}</td><td class="text {kind}">{escape(told)}</td></tr>'
        for name, told, kind in rows
    )
    return _page(f'<table id="rt-machine">{"".join(cells)}</table>', now=True)


def readings_html(found: Sequence[Reading], words: Words) -> str:
    """Joints without a reference: where each stands if its count is believed, why it is not, what else to do."""
    head = "".join(f"<th>{escape(one)}</th>" for one in (words.joint, words.stands_at, ""))
    rows = "".join(
        f'<tr data-say="reading"><td>{escape(one.joint)}</td>'
        f"<td>{'-' if one.stands_deg is None else f'{one.stands_deg:.2f}'}</td>"
        f'<td class="text">{escape(one.cause)}</td></tr>'
        for one in found
    )
    left = [one for one in found if one.stands_deg is None]
    said = _say(no_angle_words(left, words.language), "", "no_angle") if left else ""
    return _page(f"<table><tr>{head}</tr>{rows}</table>{said}")


class Answered(NamedTuple):
    """What came of a button: when it was said (seconds since 1970), the sentence, whether it was done."""

    at_s: float
    sentence: str
    done: bool


def answer_html(answers: Sequence[Answered]) -> str:
    """What came of the buttons that were pressed last."""
    said = (
        _say(one.sentence, "good" if one.done else "bad", "answer", time.strftime("%H:%M:%S", time.localtime(one.at_s)))
        for one in answers
    )
    return _page("".join(said))


def _say(sentence: str, kind: str, what: str, clock: str = "") -> str:
    at = f'<span class="dim">{clock}</span> ' if clock else ""
    return f'<div class="say {kind}">{at}<span data-say="{what}">{_legible(sentence)}</span></div>'


def _legible(sentence: str) -> str:
    """A sentence as HTML; what it has in backticks, as commands stand in it, is code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(sentence))


def _page(body: str, *, now: bool = False) -> str:
    return f'<div class="rt{" now" if now else ""}">{body}</div>'
