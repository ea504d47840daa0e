"""The bench test of a ZDT (Emm_V5) drive: its checks in their order, with explanation and question for the operator."""

from __future__ import annotations

from config.drives.zdt import ENCODER_COUNTS_PER_REVOLUTION
from config.schema import ArmConfig
from rtloop.drives import zdt_fast_targets, zdt_reports, zdt_talk
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.zdt_ask import Ask
from rtloop.drives.zdt_protocol import Version
from rtloop.drives.zdt_talk import Answered
from rtloop.offline.calibration.zdt import ARRIVED_COUNTS, LATE_NS, Drive
from rtloop.offline.commissioning import zdt_checks as checks
from rtloop.offline.commissioning import zdt_talk as talk
from rtloop.offline.commissioning.finding import Check, Finding, Said, judge_reply_delay, reply_delays_s
from rtloop.offline.commissioning.session import Bench, wire_s
from rtloop.service.conversation import DialogueFailed

SILENCE_SPARE_NS = 1_000_000_000
"""By how much the silence is longer than the move should take."""
CEASED_LOOKS = 10
PRESS_SPARE_NS = 2_000_000_000
PRESS_FREE_NS = 5_000_000_000
"""How long a motor pushes if its protection is off."""


def checks_of(arm: ArmConfig, joint: int) -> list[Check]:
    """The checks of a joint's drive, with the figures of this joint's moves."""
    name, trial = arm.joints[joint].name, talk.trial_of(arm, joint)
    move = (
        f"The motor of {name} turns by {trial.turns * 360.0:.0f}° at {trial.rpm} rpm, the joint by "
        f"{trial.turns * 360.0 / arm.joints[joint].ratio:.1f}° if its ratio is {arm.joints[joint].ratio:g}, and back"
    )
    return [
        Check("answers", "What it answers. Nothing moves: every question that rtarm asks, once.", "Ask it?", _answers),
        Check("reply delay", "How soon it answers. Nothing moves.", "Ask it?", _reply_delay),
        Check("fast targets", "What FC means to it. It may turn by a hundredth of a degree.", "Try it?", _fast_targets),
        Check("reports", "Whether it sends its position by itself. Nothing moves.", "Try it?", _reports),
        Check(
            "silence",
            f"What it does in silence. {move} while nothing is said to it; then it cannot be stopped but by its switch "
            "for some seconds.",
            "Turn it?",
            _silence,
            moves=True,
        ),
        Check("retarget", f"A new target in motion. {move}.", "Turn it?", _retarget, moves=True),
        Check(
            "stall",
            f"A stall. Clamp {name} so that it cannot turn: its motor pushes against the clamp with up to 30° of its "
            "own for some seconds, and when its protection trips the joint is limp for a moment.",
            "Is it clamped, and shall it push?",
            _stall,
            moves=True,
        ),
        Check(
            "power cycle",
            f"A loss of power. {name} is limp without power: clamp or hold it. Every drive on the same switch loses "
            f"its count, and {name} has to be homed or referenced afterwards.",
            "Watch it while you switch it off and on?",
            _power_cycle,
        ),
    ]


def _version(drive: Drive) -> Answered[Version]:
    version = protocol.version_of((yield Ask(protocol.ASK_FIRMWARE, (4, 6))))
    if version is None:
        raise drive.fails(f"The drive of {drive.config.name} does not tell its firmware: ask it for its answers first.")
    return version


def _of_joint(bench: Bench, joint: int) -> list[Said]:
    """The recorded frames to and from the joint's drive since the last call."""
    config = bench.arm.joints[joint]
    whose = bench.arm.bus_number(config), config.drive.number
    return [frame for frame in bench.frames() if (frame.bus, frame.id >> 8) == whose]


def _answers(bench: Bench, joint: int, _: int) -> list[Finding]:
    answers = bench.have(joint, lambda drive: talk.ask_all(checks.QUESTIONS))
    return [checks.judge_answers(answers, bench.arm.joints[joint].drive.number)]


def _reply_delay(bench: Bench, joint: int, _: int) -> list[Finding]:
    bench.have(joint, lambda drive: talk.ask_positions())
    frames = _of_joint(bench, joint)
    delays_s = reply_delays_s(
        frames,
        lambda frame: frame.data == protocol.ASK_POSITION,
        lambda frame: frame.data[:1] == protocol.ASK_POSITION[:1] and len(frame.data) == 7,
    )
    drive = bench.arm.joints[joint].drive
    return [judge_reply_delay(delays_s, wire_s(bench.arm, joint), drive.processing_s)]


def _fast_targets(bench: Bench, joint: int, _: int) -> list[Finding]:
    config = bench.arm.joints[joint].drive

    def ask(drive: Drive) -> Answered[tuple[Version, str | None]]:
        yield from drive.require_held()
        version = yield from _version(drive)
        if version.firmware < protocol.FAST_FIRMWARE:
            return version, None
        try:
            yield from zdt_fast_targets.prepare(bench.arm, joint, config, version)  # type: ignore[arg-type]
        except DialogueFailed as problem:
            yield from drive.stand()
            return version, str(problem)
        return version, None

    return [checks.judge_fast_targets(*bench.have(joint, ask, moves=True))]


def _reports(bench: Bench, joint: int, _: int) -> list[Finding]:
    def ask(drive: Drive) -> Answered[tuple[Version, str | None, bool]]:
        version = yield from _version(drive)
        if not version.newer:
            return version, None, False
        problem = None
        try:
            yield from zdt_reports.begin(bench.arm, bench.port, joint, version)
        except DialogueFailed as failed:
            problem = str(failed)
        yield from zdt_talk.set_reports(0)
        yield from drive.flags()
        before = bench.port.unasked(joint)
        for _ in range(CEASED_LOOKS):
            yield from drive.flags()
        return version, problem, bench.port.unasked(joint) == before

    version, problem, ceased = bench.have(joint, ask)
    return [checks.judge_reports(version, bench.arm.control.report_period_ms, problem, ceased)]


def _silence(bench: Bench, joint: int, sign: int) -> list[Finding]:
    trial = talk.trial_of(bench.arm, joint)
    way = sign * trial.counts
    bench.require_room(joint, way)
    watchdog_ms = bench.have(joint, lambda drive: zdt_talk.read_watchdog()) or 0
    forth = bench.have(joint, lambda drive: talk.run(drive, trial, ((0, way),)), moves=True)
    samples = checks.samples_of(_of_joint(bench, joint), forth.start, way)
    left_rev = 0.0
    if forth.problem is None:
        began = bench.have(joint, lambda drive: talk.send(drive, trial, forth.start - forth.stands), moves=True)
        bench.say_nothing(joint, trial.lasts_ns + LATE_NS + SILENCE_SPARE_NS)
        left_rev = (
            bench.have(joint, Drive.counts) - began + forth.stands - forth.start
        ) / ENCODER_COUNTS_PER_REVOLUTION
        bench.have(joint, Drive.stand)
    return [checks.judge_silence(forth, samples, trial, left_rev, watchdog_ms)]


def _retarget(bench: Bench, joint: int, sign: int) -> list[Finding]:
    trial = talk.trial_of(bench.arm, joint)
    way = sign * trial.counts
    bench.require_room(joint, way)
    first, told_at = round(checks.FIRST_SHARE * way), round(checks.RETARGET_SHARE * trial.counts)
    ran = bench.have(joint, lambda drive: talk.run(drive, trial, ((0, first), (told_at, way))), moves=True)
    frames = _of_joint(bench, joint)
    if ran.problem is None and abs(ran.stands - ran.start) > ARRIVED_COUNTS:
        bench.have(joint, lambda drive: talk.run(drive, trial, ((0, ran.start - ran.stands),)), moves=True)
    return [checks.judge_retarget(ran, frames, trial, sign)]


def _stall(bench: Bench, joint: int, sign: int) -> list[Finding]:
    bench.require_room(joint, sign * talk.PRESS_COUNTS)
    block = bench.have(joint, lambda drive: zdt_talk.surely(zdt_talk.read_block))
    if block is None:
        raise DialogueFailed(joint, f"The drive of {bench.arm.joints[joint].name} does not tell its stall protection.")
    protects = block.stall_mode != 0
    patience_ns = PRESS_FREE_NS
    if protects:
        patience_ns = round(checks.STALL_TIMES[1] * block.stall_time_ms * 1e6) + PRESS_SPARE_NS
    wanted = protocol.PROTECTED if protects else protocol.STALLED
    pressed = bench.have(joint, lambda drive: talk.press(drive, sign, patience_ns, wanted), moves=True)
    return [checks.judge_stall(pressed, block)]


def _power_cycle(bench: Bench, joint: int, _: int) -> list[Finding]:
    bench.forget_mark(joint)
    changed = talk.Changed()
    cycle, beside = None, []
    try:
        with bench.ending_with(joint, lambda drive: talk.put_back(drive, changed)):
            cycle = bench.have(
                joint, lambda drive: talk.power_cycle(drive, changed, bench.tell, lambda: bench.lose(joint))
            )
    except DialogueFailed as problem:
        if cycle is None:
            raise
        beside = [checks.not_put_back(problem)]  # the results from before are kept
    bench.power_proof = checks.power_proof(cycle)
    return [checks.judge_power_flag(cycle), checks.judge_volatile(cycle), *beside]
