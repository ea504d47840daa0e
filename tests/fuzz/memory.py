"""A hostile writer of the command file against the whole cycle, thousands of cases a second: all compiled.

A case is a fresh arm and some dozen cycles of the mock arm, before each of which the writer does what it likes to the
file: goals that are well made but for their numbers, heads that jump, records of other kinds and ids, garbage with a
valid CRC, flipped bits anywhere. The judge is told nothing by the loop but where the arm is commanded, which on the
mock arm is where it stands, and differences that by itself.
"""

import math

import numpy as np

from compilation.jit import jit
from rtloop.commands import orders
from rtloop.cycle import step
from rtloop.memory.modes import change_mode
from rtloop.memory.state import Loop
from rtloop.trajectory.phases import runs, waits
from shm import layout
from shm.atomics import load_relaxed, store_relaxed
from shm.layout import StateFile
from shm.record import offset_of
from shm.seqlock import copy_words, crc32_at
from shm.words import Answer, Fault, Mode, Outcome, Request, Setpoint

ARM = "mock"
RATE_HZ = 100.0
CYCLES = 60
RECORDS_A_CYCLE = 24

# what a case was found guilty of
SOUND, NOT_FINITE, OUTSIDE, TOO_FAST, TOO_HARD, UNKNOWN_WORD, LEFT_EARLY = range(7)
GUILT = ("sound", "not finite", "outside its position limits", "too fast", "too hard", "an unknown word", "no end")

ROUNDING = 1.0 + 1e-6
WHOLE_FILE, MOSTLY_SOUND, WELL_MADE = range(3)
"""How hostile a writer is: bits and heads anywhere; one corrupt thing now and then; only the numbers are hostile."""

_COMMAND = layout.CommandFile
HEARTBEAT = offset_of(_COMMAND, "heartbeat_ns")
_ANNOUNCED = offset_of(_COMMAND, "announced_goal")
_WRITTEN = offset_of(_COMMAND, "setpoints_written")
_STOP = offset_of(_COMMAND, "stop_ns")
_HOLD = offset_of(_COMMAND, "hold_ns")
_RESUME = offset_of(_COMMAND, "resume_ns")
_SPEED_SCALE = offset_of(_COMMAND, "speed_scale")
_CANCELED_GOALS = offset_of(_COMMAND, "canceled_goals")
_CANCELED_THROUGH = offset_of(_COMMAND, "canceled_through")
_REQUESTS_WRITTEN = offset_of(_COMMAND, "requests_written")
_ROWS_AT = offset_of(layout.Setpoint, "joints")
_KINDS = max(Request) + 1
_REQUESTS = offset_of(_COMMAND, "requests")
_SETPOINTS = offset_of(_COMMAND, "setpoints")
_RECORD_BYTES = layout.Setpoint.dtype.itemsize
_REQUEST_BYTES = layout.Request.dtype.itemsize
_REQUEST_EPOCH = offset_of(layout.Request, "epoch")
_HEAD_WORDS = offset_of(layout.Setpoint, "joints") // 8
_COMMAND_WORDS = _COMMAND.dtype.itemsize // 8
_WAYPOINTS, _HISTORY = offset_of(Loop, "waypoints"), offset_of(Loop, "history")
_LAST = offset_of(Loop, "service_in")
_WAYPOINT = int(Setpoint.WAYPOINT)
_CASE_RECORDS = 1 << 16
"""Records of one case lie this far from those of the next, so that none of an earlier one can be taken for its own."""

HOSTILE_NUMBERS = np.array(
    [0.0, -0.0, 1.0, -1.0, 1e-320, 1e-9, -1e-9, 1e3, -1e6, 1e18, -1e18, 1e300, np.nan, np.inf, -np.inf, 3.2e-10]
)
_I64 = np.iinfo(np.int64)
HOSTILE_WORDS = np.array(
    [
        *(0, 1, -1, 2, 63, 64, 4095, 4096, 4097, 65536, 10**6, 10**6 + 1, 1 << 31, 1 << 32, 1 << 62, -(1 << 62)),
        *(_I64.max, _I64.max - 1, _I64.min, _I64.min + 1),
    ]
)


@jit
def reseed(seed: int) -> None:
    """Begin the random numbers of compiled code anew."""
    np.random.seed(seed)


@jit
def hostile_number() -> float:
    """A number that a check may have forgotten, or any."""
    kind = np.random.randint(0, 3)
    if kind == 0:
        return float(HOSTILE_NUMBERS[np.random.randint(0, len(HOSTILE_NUMBERS))])
    return float(np.random.normal(0.0, 1.0) * 10.0 ** np.random.randint(-6, 7))


@jit
def hostile_word() -> int:
    """A whole number that a check may have forgotten, or any."""
    kind = np.random.randint(0, 3)
    if kind == 0:
        return int(HOSTILE_WORDS[np.random.randint(0, len(HOSTILE_WORDS))])
    if kind == 1:
        return int(np.random.randint(-8, 9))
    return int(np.random.randint(0, 1 << 62)) << np.random.randint(0, 2)


@jit
def store_number(address: int, value: float, box: np.ndarray) -> None:
    """Write a double as the word it is made of."""
    box[0] = value
    copy_words(address, box.ctypes.data, 1)


@jit
def seal(record: int, joint_count: int) -> None:
    """Give a record the CRC it needs to be believed."""
    store_relaxed(record, crc32_at(record + 8, _HEAD_WORDS - 1 + 3 * joint_count))


@jit
def slot_of(command: int, sequence: int) -> int:
    return command + _SETPOINTS + (sequence & (layout.SETPOINT_SLOTS - 1)) * _RECORD_BYTES


@jit
def put_head(command: int, kind: int, goal: int, first: int, second: int, third: int, fourth: int, fifth: int) -> int:
    """Begin the next record of the ring; its address."""
    sequence = load_relaxed(command + _WRITTEN)
    record = slot_of(command, sequence)
    store_relaxed(record + 8, sequence)
    store_relaxed(record + 16, goal)
    store_relaxed(record + 24, kind)
    store_relaxed(record + 32, first)
    store_relaxed(record + 40, second)
    store_relaxed(record + 48, third)
    store_relaxed(record + 56, fourth)
    store_relaxed(record + 64, fifth)
    return record


@jit
def publish_record(command: int, record: int, joint_count: int) -> None:
    seal(record, joint_count)
    store_relaxed(command + _WRITTEN, load_relaxed(command + _WRITTEN) + 1)


@jit
def put_goal(loop: Loop, command: int, goal: int, wild: float, box: np.ndarray) -> None:
    """A whole goal or a part of one; each number is hostile with the probability `wild`, else plausible."""
    count = loop.params.joint_count
    period_ns = loop.params.period_ns
    store_relaxed(command + _ANNOUNCED, goal)
    start_ns = 0
    if np.random.random() < 0.4:
        start_ns = loop.timing.now_ns + int(np.random.randint(-40, 20)) * period_ns // 4
    mask = int(np.random.randint(1, 1 << count))
    patience = np.random.random() * 0.5
    entry = int(np.random.randint(0, 4))
    if np.random.random() < wild:
        start_ns = hostile_word()
    if np.random.random() < wild:
        mask = hostile_word()
    if np.random.random() < wild:
        patience = hostile_number()
    if np.random.random() < wild:
        entry = hostile_word()
    record = put_head(command, Setpoint.BEGIN, goal, start_ns, mask, 0, entry, loop.goals.epoch)
    store_number(record + 48, patience, box)
    for joint in range(count):
        for column in range(3):
            value = 0.1 if column == 0 else 0.0
            if np.random.random() < wild:
                value = hostile_number()
            store_number(record + _ROWS_AT + 24 * joint + 8 * column, value, box)
    publish_record(command, record, count)
    put_waypoints(loop, command, goal, wild, box)
    if np.random.random() < 0.7:
        put_end(loop, command, goal, wild, box)
    if np.random.random() < 0.1:
        put_waypoints(loop, command, goal, wild, box)


@jit
def put_end(loop: Loop, command: int, goal: int, wild: float, box: np.ndarray) -> None:
    record = put_head(command, Setpoint.END, goal, 0, 0, 0, 0, 0)
    for joint in range(loop.params.joint_count):
        for column in range(3):
            value = (0.01, 0.05, 0.0)[column] if np.random.random() >= wild else hostile_number()
            store_number(record + _ROWS_AT + 24 * joint + 8 * column, value, box)
    publish_record(command, record, loop.params.joint_count)


@jit
def put_waypoints(loop: Loop, command: int, goal: int, wild: float, box: np.ndarray) -> None:
    """Some waypoints that lead anywhere inside what a waypoint may say, from where the arm is commanded."""
    count, period_ns = loop.params.joint_count, loop.params.period_ns
    waypoints = int(np.random.randint(1, RECORDS_A_CYCLE))
    time_ns = 0 if np.random.random() < 0.6 else int(np.random.randint(0, 20)) * period_ns // 2
    style = int(np.random.randint(0, 4))
    gap_ns = (1, period_ns // 7, period_ns, 12 * period_ns)[int(np.random.randint(0, 4))]
    share = np.random.random() * 1.05
    order = (1, 3, 3, 5)[int(np.random.randint(0, 4))]
    for _ in range(waypoints):
        here_ns = time_ns if np.random.random() >= wild else hostile_word()
        here_order = order if np.random.random() >= wild else hostile_word()
        kind = _WAYPOINT if np.random.random() >= 0.1 * wild else int(np.random.randint(-1, 9))
        owner = goal if np.random.random() >= 0.1 * wild else int(np.random.randint(-1, 3))
        record = put_head(command, kind, owner, here_ns, here_order, hostile_word(), hostile_word(), hostile_word())
        for joint in range(count):
            row, axis = loop.joints[joint], loop.axes[joint]
            v = np.random.uniform(-share, share) * row.max_velocity_rad_s
            a = np.random.uniform(-2.0, 2.0) * row.max_acceleration_rad_s2
            p = float(axis.commanded.position_rad)
            if style == 0:  # a smooth way out and on, with the limit in sight
                v = share * row.max_velocity_rad_s
                p += v * time_ns * 1e-9
                a = 0.0
            elif style == 1:  # anywhere
                p = np.random.uniform(row.lower_rad, row.upper_rad)
            elif style == 2:  # at a limit, and on the way through it
                p = float(row.upper_rad if np.random.random() < 0.5 else row.lower_rad)
                v = math.copysign(share * row.max_velocity_rad_s, p)
            else:
                p += np.random.normal(0.0, 1e-3)
            p = min(max(p, float(row.lower_rad)), float(row.upper_rad))
            if np.random.random() < wild:
                p = hostile_number()
            if np.random.random() < wild:
                v = hostile_number()
            if np.random.random() < wild:
                a = hostile_number()
            store_number(record + _ROWS_AT + 24 * joint, p, box)
            store_number(record + _ROWS_AT + 8 + 24 * joint, v, box)
            store_number(record + _ROWS_AT + 16 + 24 * joint, a, box)
        publish_record(command, record, count)
        time_ns += gap_ns if np.random.random() < 0.5 else int(np.random.randint(1, 2 * gap_ns + 1))


@jit
def put_command(command: int, goal: int, wild: float, box: np.ndarray) -> None:
    """A stop, hold, resume, speed scale or cancel."""
    which = int(np.random.randint(0, 5))
    now_ns = load_relaxed(command + HEARTBEAT)
    word = hostile_word() if np.random.random() < wild else now_ns + int(np.random.randint(0, 1000))
    meant = (goal, goal + 1)[int(np.random.randint(0, 2))] if np.random.random() >= wild else hostile_word()
    if which == 0:
        store_relaxed(command + _STOP, word)
    elif which == 1:
        store_relaxed(command + (_HOLD if np.random.random() < 0.3 else _RESUME), word)
    elif which == 2:
        scale = np.random.random() if np.random.random() >= wild else hostile_number()
        store_number(command + _SPEED_SCALE, scale, box)
    elif which == 3:
        store_relaxed(command + _CANCELED_GOALS + 8 * (meant & (layout.CANCELED_SLOTS - 1)), meant)
    else:
        store_relaxed(command + _CANCELED_THROUGH, meant)


@jit
def put_request(loop: Loop, command: int, wild: float, box: np.ndarray) -> None:
    """A request of any kind, sealed."""
    written = load_relaxed(command + _REQUESTS_WRITTEN)
    record = command + _REQUESTS + (written & (layout.REQUEST_SLOTS - 1)) * _REQUEST_BYTES
    kind = int(np.random.randint(0, _KINDS)) if np.random.random() >= wild else hostile_word()
    value = np.random.random() if np.random.random() >= wild else hostile_number()
    store_relaxed(record + 8, written + 1)
    store_relaxed(record + 16, kind)
    store_number(record + 24, value, box)
    for word in range(4, _REQUEST_BYTES // 8):
        store_relaxed(record + 8 * word, hostile_word())
    if np.random.random() >= wild:
        store_relaxed(record + _REQUEST_EPOCH, loop.goals.epoch)
    store_relaxed(record, crc32_at(record + 8, _REQUEST_BYTES // 8 - 1))
    store_relaxed(command + _REQUESTS_WRITTEN, written + 1)


@jit
def put_garbage(loop: Loop, command: int) -> None:
    """A record every word of which is hostile, believed by its CRC and its number."""
    record = put_head(command, hostile_word(), hostile_word(), hostile_word(), hostile_word(), hostile_word(), 0, 0)
    for word in range(7, _HEAD_WORDS + 3 * loop.params.joint_count):
        store_relaxed(record + 8 * word, hostile_word())
    publish_record(command, record, loop.params.joint_count)


@jit
def scribble(command: int) -> None:
    """Change what is there already: a bit anywhere, a word of the first pages, or a head."""
    kind = np.random.randint(0, 4)
    if kind == 0:
        at = command + 8 * int(np.random.randint(0, _COMMAND_WORDS))
        store_relaxed(at, load_relaxed(at) ^ (1 << np.random.randint(0, 63)))
    elif kind == 1:
        at = command + 8 * int(np.random.randint(0, _SETPOINTS // 8))
        store_relaxed(at, hostile_word())
    else:
        heads = (HEARTBEAT, _ANNOUNCED, _WRITTEN, _REQUESTS_WRITTEN)
        head = command + heads[int(np.random.randint(0, 4))]
        store_relaxed(head, load_relaxed(head) + hostile_word() if np.random.random() < 0.7 else hostile_word())


@jit
def write_hostile(loop: Loop, command: int, how: int, goal: int, box: np.ndarray) -> int:
    """What the writer does before one cycle; the newest goal it has spoken of."""
    wild = (0.05, 0.01, 0.0)[how] if np.random.random() < 0.5 else 0.0
    dice = np.random.random()
    if dice < 0.12:
        goal += 1 if np.random.random() >= 0.1 * wild else int(np.random.randint(-2, 3))
        put_goal(loop, command, goal, wild, box)
    elif dice < 0.18:
        put_waypoints(loop, command, goal if np.random.random() < 0.8 else 0, wild, box)
    elif dice < 0.22:
        put_end(loop, command, goal, wild, box)
    elif dice < 0.30:
        for _ in range(1 + (70 if np.random.random() < 0.02 else 0)):  # now and then a flood
            put_request(loop, command, wild, box)
        if np.random.random() < 0.05:
            put_command(command, goal, wild, box)
    elif dice < 0.34 and how != WELL_MADE:
        put_garbage(loop, command)
    elif (dice < 0.50 and how == WHOLE_FILE) or (dice < 0.36 and how == MOSTLY_SOUND):
        scribble(command)
    return goal


@jit
def bring_up(loop: Loop, shared: StateFile) -> None:
    """What the conversation in ordinary Python does for a mock arm."""
    orders.begin_bring_up(loop, shared)
    if loop.mode == Mode.BRINGING_UP:
        for joint in range(loop.params.joint_count):
            orders.sync_setpoint(loop, joint, loop.axes[joint].measured.position_rad, 0)
        change_mode(loop, shared, Mode.HOLDING)


@jit
def place(loop: Loop) -> None:
    """Let the arm stand somewhere inside its limits, often at one of them."""
    for joint in range(loop.params.joint_count):
        row, axis = loop.joints[joint], loop.axes[joint]
        p = np.random.uniform(row.lower_rad, row.upper_rad)
        if np.random.random() < 0.3:
            p = float(row.upper_rad if np.random.random() < 0.5 else row.lower_rad)
        axis.commanded.position_rad = axis.commanded.next_position_rad = axis.measured.position_rad = (
            axis.tracking.reference_rad
        ) = p


@jit
def judge(loop: Loop, before: np.ndarray, verdict: np.ndarray) -> int:
    """Hold where every joint is commanded now against its limits; `before` (joints, 3) is kept from cycle to cycle."""
    period_s = loop.params.period_ns * 1e-9
    guilt = SOUND
    for joint in range(loop.params.joint_count):
        row, p = loop.joints[joint], loop.axes[joint].commanded.position_rad
        v = (p - before[joint, 0]) / period_s
        a = (v - before[joint, 1]) / period_s
        before[joint, 0], before[joint, 1] = p, v
        beyond = max(p - row.upper_rad, row.lower_rad - p)
        fastest = loop.params.velocity_margin * row.max_velocity_rad_s * ROUNDING
        hardest = loop.params.acceleration_margin * row.max_acceleration_rad_s2 * ROUNDING
        found = SOUND
        if not math.isfinite(p):
            found = NOT_FINITE
        elif beyond > row.slack_rad + 1e-9:
            found = OUTSIDE
        elif abs(v) > fastest:
            found = TOO_FAST
        elif abs(a) > hardest + 2e-15 / (period_s * period_s):
            found = TOO_HARD
        if found != SOUND and guilt == SOUND:
            guilt = found
            verdict[0], verdict[1], verdict[2], verdict[3] = joint, p, v, a
    return guilt


@jit
def word_seen(value: int, highest: int, seen: np.ndarray, row: int) -> bool:
    """Note a word of the loop; False for one that has no name."""
    if value < 0 or value > highest:
        return False
    seen[row, value] = 1
    return True


_MODES, _FAULTS, _OUTCOMES, _ANSWERS = (int(max(words)) for words in (Mode, Fault, Outcome, Answer))


@jit
def words_known(loop: Loop, shared: StateFile, seen: np.ndarray) -> bool:
    """Whether everything the loop has decided has a name; notes what it was."""
    known = word_seen(loop.mode, _MODES, seen, 0) and word_seen(loop.fault.code, _FAULTS, seen, 1)
    for i in range(layout.RESULT_SLOTS):
        known = known and word_seen(loop.snapshot.results[i].outcome, _OUTCOMES, seen, 2)
    for i in range(layout.ANSWER_SLOTS):
        known = known and word_seen(loop.snapshot.answers[i].answer, _ANSWERS, seen, 3)
    return known


@jit
def refresh(loop: Loop, fresh: int, case: int) -> None:
    """Begin a case: the loop as it was brought up, the rings at a place of the case's own."""
    address, command = loop.params.address, loop.params.command_address
    copy_words(address, fresh, _WAYPOINTS // 8)
    copy_words(address + _HISTORY, fresh + _HISTORY, (_LAST - _HISTORY) // 8)
    first = (case & 0xFFFF_FFFF) * _CASE_RECORDS
    loop.front.setpoints_taken = loop.front.requests_taken = first
    for word in (_ANNOUNCED, HEARTBEAT):
        store_relaxed(command + word, 0)
    for word in (_WRITTEN, _REQUESTS_WRITTEN):
        store_relaxed(command + word, first)


@jit
def standing(loop: Loop) -> np.ndarray:
    """What `judge` keeps from cycle to cycle, of an arm at rest."""
    before = np.zeros((loop.params.joint_count, 2))
    for joint in range(loop.params.joint_count):
        before[joint, 0] = loop.axes[joint].commanded.position_rad
    return before


@jit
def run_case(
    loop: Loop, shared: StateFile, fresh: int, seed: int, case: int, seen: np.ndarray, verdict: np.ndarray
) -> int:
    """Run one case; what it is guilty of. `fresh` is the address of a loop's memory as it should begin."""
    np.random.seed((seed * 1_000_003 + case) & 0xFFFFFFFF)
    refresh(loop, fresh, case)
    command = loop.params.command_address
    box = np.zeros(1)
    place(loop)
    how = int(np.random.randint(0, 3))
    before = standing(loop)
    now_ns, goal, guilt = int(loop.timing.now_ns), 0, SOUND
    for cycle in range(CYCLES):
        now_ns += loop.params.period_ns
        if how != WHOLE_FILE or np.random.random() < 0.9:
            store_relaxed(command + HEARTBEAT, now_ns)
        goal = write_hostile(loop, command, how, goal, box)
        step(loop, shared, now_ns)
        guilt = judge(loop, before, verdict)
        if guilt == SOUND and not words_known(loop, shared, seen):
            guilt = UNKNOWN_WORD
        if guilt != SOUND:
            verdict[4], verdict[5], verdict[6] = cycle, how, loop.fault.code
            return guilt
        if loop.dialogue.bring_up_asked == 1:
            bring_up(loop, shared)
            for joint in range(loop.params.joint_count):
                before[joint, 0], before[joint, 1] = loop.axes[joint].commanded.position_rad, 0.0
        if loop.fault.code != Fault.NONE and np.random.random() < 0.2:
            put_request(loop, command, 0.0, box)
            if np.random.random() < 0.5:
                clear_fault(command)
    return SOUND


@jit
def clear_fault(command: int) -> None:
    """Turn the newest request into one that clears a fault."""
    written = load_relaxed(command + _REQUESTS_WRITTEN) - 1
    record = command + _REQUESTS + (written & (layout.REQUEST_SLOTS - 1)) * _REQUEST_BYTES
    store_relaxed(record + 16, Request.CLEAR_FAULT)
    store_relaxed(record, crc32_at(record + 8, _REQUEST_BYTES // 8 - 1))


@jit
def run_cases(
    loop: Loop,
    shared: StateFile,
    fresh: int,
    seed: int,
    first: int,
    count: int,
    seen: np.ndarray,
    verdict: np.ndarray,
    faults: np.ndarray,
) -> int:
    """Run cases until one is guilty or all are done; how many were judged. `faults` (n,) counts how cases ended."""
    for number in range(count):
        if run_case(loop, shared, fresh, seed, first + number, seen, verdict) != SOUND:
            return number + 1
        faults[loop.fault.code] += 1
    return count


@jit
def follow(loop: Loop, shared: StateFile, start_ns: int, most_cycles: int, verdict: np.ndarray) -> int:
    """Let the goal in the ring be executed under the judge's eyes until nothing moves; what it is guilty of."""
    before = standing(loop)
    now_ns = start_ns
    for cycle in range(most_cycles):
        now_ns += loop.params.period_ns
        store_relaxed(loop.params.command_address + HEARTBEAT, now_ns)
        step(loop, shared, now_ns)
        guilt = judge(loop, before, verdict)
        if guilt != SOUND:
            verdict[4] = cycle
            return guilt
        if cycle > 2 and not runs(loop) and not waits(loop) and loop.motion.per_joint_stop == 0:
            return SOUND
    return LEFT_EARLY
