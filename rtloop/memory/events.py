"""Writing to the event ring and to the tables of results and answers."""

from compilation.jit import jit
from rtloop.memory.state import Loop
from shm import layout
from shm.atomics import load_relaxed, store_release
from shm.layout import StateFile
from shm.record import offset_of
from shm.words import Event

_EVENTS_WRITTEN_AT = offset_of(layout.StateFile, "events_written")


@jit
def record_event(
    loop: Loop,
    shared: StateFile,
    kind: int,
    joint: int,
    code: int,
    value: float,
    limit: float,
    silent: int = 0,
    evidence: int = 0,
) -> None:
    """Append to the event ring; the oldest is overwritten."""
    head = loop.params.state_address + _EVENTS_WRITTEN_AT
    written = load_relaxed(head)
    event = shared.events[written & (layout.EVENT_SLOTS - 1)]
    event.monotonic_ns = loop.timing.now_ns
    event.kind = kind
    event.joint = joint
    event.code = code
    event.value = value
    event.limit = limit
    event.silent = silent
    event.evidence = evidence
    # pairs with `shm.recording.newest_events`, which looks at the count again: the event is whole before it is counted
    store_release(head, written + 1)


@jit
def set_result(
    loop: Loop, shared: StateFile, goal_id: int, outcome: int, joint: int, value: float, limit: float
) -> None:
    """Append to the table of results; the oldest decision is overwritten, whichever goal's it is."""
    result = loop.snapshot.results[loop.published.results_decided & (layout.RESULT_SLOTS - 1)]
    loop.published.results_decided += 1
    result.goal_id = goal_id
    result.outcome = outcome
    result.joint = joint
    result.value = value
    result.limit = limit
    result.monotonic_ns = loop.timing.now_ns
    loop.published.decisions_shown = 0
    record_event(loop, shared, Event.RESULT, joint, outcome, value, limit)


@jit
def answer_request(loop: Loop, shared: StateFile, sequence: int, kind: int, answer: int) -> None:
    """Answer the request of a number; its event says too what was asked (`kind`, shm.words.Request)."""
    row = loop.snapshot.answers[sequence & (layout.ANSWER_SLOTS - 1)]
    row.sequence = sequence
    row.answer = answer
    loop.published.decisions_shown = 0
    record_event(loop, shared, Event.REQUEST, -1, answer, float(sequence), float(kind))
