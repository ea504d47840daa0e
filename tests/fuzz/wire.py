"""Hostile bytes from the adapter, and hostile frames from the drives, against the whole cycle: all compiled.

The arm is the one with six drives on a serial adapter of any kind. Before each cycle some drives answer as drives do,
and a writer who knows the grammar of its frames, or does not care for it, puts its own between them. The judge decodes
what the cycle sends by itself.
"""

import numpy as np

from compilation.jit import jit
from fuzz import memory
from fuzz.framing import put_byte, put_frame, read_frame
from fuzz.memory import SOUND, UNKNOWN_WORD
from rtloop.bus.measured import whose
from rtloop.cycle import step
from rtloop.memory.frame_words import EXTENDED
from rtloop.memory.link import WIRE_SLCAN
from rtloop.memory.state import Loop
from rtloop.service.port import OUT, TAKEN, WRITTEN
from rtloop.wire import received
from shm.atomics import store_relaxed
from shm.layout import StateFile

CYCLES = 40
MOST_BYTES = 2048
CR, BEL = 13, 7
BAD_LINE, BAD_TARGET, LED_BLIND = 7, 8, 9
GUILT = (*memory.GUILT, "a line that is none", "a target outside its limits", "led without a reference")
_TEMPLATES = [b"z", b"Z", b"", b"\x07", b"V1013", b"NA123", b"FA4", b"T", b"t", b"T0", b"t1FF", b"r1238", b"R000001008"]
_TEMPLATES += [
    b"T0000010073601",
    b"T00000100Z36",
    b"T000001009360000000000006B",
    b"\x00\x00",
    b"\xff\x80\xc3",
    b"C",
    b"O",
]
_SLCAN_TEMPLATES = len(_TEMPLATES)
_TEMPLATES += [
    b"\xaa",
    b"\x55",
    b"\xaa\x55",
    b"\xaa\x55\x04" + bytes(16) + b"\x04",
    b"\xaa\xe8\x00\x01",
    b"\xaa\xe7\x00\x01\x00\x00\x36\x00",
    b"\xaa\xf8\x00\x01\x00\x00\x55",
    b"\xaa\xc9\x00\x01\x55",
    b"A",
    b"AT",
    b"AT+AT\r\n",
    b"OK\r\n",
    b"AT\x00\x00\x08\x04\x08\x36",
    b"AT\x00\x00\x08\x04\x09",
    b"AT\x20\x00\x00\x00\x02\x36\x6b\r\n",
    b"\r\n",
]
_PIECES = np.zeros((len(_TEMPLATES), 32), np.uint8)
for _row, _text in zip(_PIECES, _TEMPLATES, strict=True):
    _row[: len(_text)] = np.frombuffer(_text, np.uint8)
_LENGTHS = np.array([len(text) for text in _TEMPLATES])
_FUNCTIONS = np.array([0x36, 0x3A, 0xFD, 0xFE, 0xF3, 0x00, 0xE2, 0xEE, 0x35])


@jit
def position_reply(loop: Loop, joint: int, off_rad: float) -> int:
    """`36 sign counts32 6B` of a joint that is where it is commanded, but for an error."""
    row = loop.joints[joint]
    counts = round((loop.axes[joint].commanded.position_rad + off_rad + row.zero_rad) * row.reading_per_rad)
    size = min(abs(counts), 0xFFFFFFFF)
    data = 0x36 | ((1 if counts < 0 else 0) << 8) | (0x6B << 48)
    for i in range(4):
        data |= ((size >> (8 * (3 - i))) & 255) << (8 * (2 + i))
    return data


@jit
def put_answers(loop: Loop, out: np.ndarray, at: int, silence: float) -> int:
    """What sound drives say in a cycle."""
    for joint in range(loop.params.joint_count):
        if np.random.random() < silence:
            continue
        address = loop.joints[joint].address << 8
        at = put_frame(loop, out, at, address, 7, position_reply(loop, joint, 0.0))
        if np.random.random() < 0.2:
            at = put_frame(loop, out, at, address, 3, 0x3A | (0x03 << 8) | (0x6B << 16))
    return at


@jit
def put_hostile_frame(loop: Loop, out: np.ndarray, at: int) -> int:
    """A frame that is whole as such: of any drive, of any function, of any length."""
    joint = int(np.random.randint(0, loop.params.joint_count))
    frame_id = loop.joints[joint].address << 8
    kind = np.random.randint(0, 8)
    if kind == 0:  # where it cannot be, or nearly is
        off_rad = float(np.random.normal(0.0, 1.0) * 10.0 ** np.random.randint(-5, 4))
        return put_frame(loop, out, at, frame_id, 7, position_reply(loop, joint, off_rad))
    if kind == 1:  # any state
        return put_frame(loop, out, at, frame_id, 3, 0x3A | (int(np.random.randint(0, 256)) << 8) | (0x6B << 16))
    if kind == 2:  # any count
        data = 0x36 | (int(np.random.randint(0, 1 << 40)) << 8) | (0x6B << 48)
        return put_frame(loop, out, at, frame_id, 7, data)
    length = int(np.random.randint(0, 16)) if kind == 3 else int(np.random.randint(0, 9))
    data = int(np.random.randint(0, 1 << 62)) << np.random.randint(0, 3)
    if kind < 6:
        data = (data & ~255) | _FUNCTIONS[np.random.randint(0, len(_FUNCTIONS))]
    if kind == 6:
        frame_id = int(np.random.randint(0, 1 << 32))
    elif np.random.random() < 0.3:
        frame_id |= int(np.random.randint(0, 256))
    return put_frame(loop, out, at, frame_id, length, data)


@jit
def put_noise(loop: Loop, out: np.ndarray, at: int) -> int:
    """Bytes that are no frame, or no line at all."""
    kind = np.random.randint(0, 5)
    if kind == 0:
        for _ in range(np.random.randint(1, 40)):
            at = put_byte(out, at, np.random.randint(0, 256))
    elif kind == 1:  # an overlong line
        byte = np.random.randint(32, 256)
        for _ in range(np.random.randint(27, 300)):
            at = put_byte(out, at, byte)
    elif kind == 2:
        at = put_byte(out, at, BEL)
    else:
        pieces = _SLCAN_TEMPLATES if loop.buses[0].interface == WIRE_SLCAN else len(_LENGTHS)
        piece = int(np.random.randint(0, pieces))
        for i in range(_LENGTHS[piece]):
            at = put_byte(out, at, _PIECES[piece, i])
    return put_byte(out, at, CR) if np.random.random() < 0.7 else at


@jit
def spoil(out: np.ndarray, count: int) -> int:
    """Flip, drop or double bytes of what was made; how many are left."""
    for _ in range(np.random.randint(1, 4)):
        if count < 2:
            return count
        at = int(np.random.randint(0, count - 1))
        kind = np.random.randint(0, 3)
        if kind == 0:
            out[at] ^= 1 << np.random.randint(0, 8)
        elif kind == 1:
            for i in range(at, count - 1):
                out[i] = out[i + 1]
            count -= 1
        elif count < len(out):
            for i in range(count, at, -1):
                out[i] = out[i - 1]
            count += 1
    return count


@jit
def bring(loop: Loop, out: np.ndarray, count: int, now_ns: int) -> None:
    """Put bytes into the receive ring in chunks, as a reader thread finds them."""
    done = 0
    while done < count:
        size = min(int(np.random.randint(1, 400)), count - done)
        received.push(loop.buses[0], now_ns - int(np.random.randint(0, 3_000_000)), out[done:], size)
        done += size


@jit
def judge_bytes(loop: Loop, count: int, verdict: np.ndarray) -> int:
    """Decode what is sent: whole lines, drives of the arm, targets inside their limits, none that is led blind."""
    at, first = 0, 0
    while at < count:
        at, frame_id, data = read_frame(loop, at, count)
        joint = whose(loop, loop.buses[0], frame_id, EXTENDED) if at > 0 else -1
        if joint < 0:
            return BAD_LINE
        if data & 255 == 0xFD:
            if loop.axes[joint].reference.referenced == 0:
                verdict[0] = joint
                return LED_BLIND
            if frame_id & 255 == 0:
                first = data
            else:
                pulses = data >> 8 & 255
                for i in range(5, 8):
                    pulses |= (first >> (8 * i) & 255) << (8 * (8 - i))
                if first >> 8 & 255 == 1:
                    pulses = -pulses
                row = loop.joints[joint]
                target = pulses / row.command_per_rad - row.zero_rad
                slack = 3.0 / abs(row.command_per_rad) + row.slack_rad
                if not (row.lower_rad - slack <= target <= row.upper_rad + slack):
                    verdict[0], verdict[1] = joint, target
                    return BAD_TARGET
    return SOUND


@jit
def run_case(
    loop: Loop,
    shared: StateFile,
    fresh: int,
    seed: int,
    case: int,
    seen: np.ndarray,
    verdict: np.ndarray,
    out: np.ndarray,
) -> int:
    """Run one case; what it is guilty of."""
    np.random.seed((seed * 1_000_003 + case) & 0xFFFFFFFF)
    memory.refresh(loop, fresh, case)
    for word in (WRITTEN, TAKEN):
        store_relaxed(loop.params.address + OUT + word, 0)
    command = loop.params.command_address
    box, before = np.zeros(1), memory.standing(loop)
    silence = 0.0 if np.random.random() < 0.7 else np.random.random()
    calm = np.random.random() < 0.5
    now_ns, guilt = int(loop.timing.now_ns), SOUND
    for cycle in range(CYCLES):
        now_ns += loop.params.period_ns
        store_relaxed(command + memory.HEARTBEAT, now_ns)
        if cycle % 12 == 1:
            memory.put_goal(loop, command, 1 + cycle, 0.0, box)
        at = put_answers(loop, out, 0, silence)
        for _ in range(np.random.randint(0, 3 if calm else 12)):
            at = put_hostile_frame(loop, out, at) if np.random.random() < 0.6 else put_noise(loop, out, at)
        if np.random.random() < 0.3:
            at = spoil(out, at)
        bring(loop, out, at, now_ns)
        step(loop, shared, now_ns)
        sent = loop.buses[0].outgoing.length
        guilt = memory.judge(loop, before, verdict)
        if guilt == SOUND:
            guilt = judge_bytes(loop, sent, verdict)
        if guilt == SOUND and not memory.words_known(loop, shared, seen):
            guilt = UNKNOWN_WORD
        if guilt != SOUND:
            verdict[4], verdict[5], verdict[6] = cycle, calm, loop.fault.code
            return guilt
        loop.buses[0].outgoing.length = 0
    return SOUND


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
    out: np.ndarray,
) -> int:
    """Run cases until one is guilty or all are done; how many were judged."""
    for number in range(count):
        if run_case(loop, shared, fresh, seed, first + number, seen, verdict, out) != SOUND:
            return number + 1
        faults[loop.fault.code] += 1
    return count
