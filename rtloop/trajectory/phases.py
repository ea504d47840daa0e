"""The life of a goal: where it stands, the table of changes, and for what reason it stops.

There is a place for two, those of the two paths: one runs, a newer one waits to take over.

none → waiting → running → settling → none
running ⇄ paused ⇄ settling (a person's hold)
running, paused, settling → stopping → none
each of them → none: refused, replaced, or the drives have stopped the arm by themselves
"""

from compilation.jit import jit
from rtloop.memory.events import set_result
from rtloop.memory.state import Loop
from shm.layout import StateFile
from shm.words import Outcome, Phase, Slowed

ALLOWED = {
    Phase.NONE: (Phase.WAITING,),
    Phase.WAITING: (Phase.RUNNING, Phase.NONE),
    Phase.RUNNING: (Phase.PAUSED, Phase.SETTLING, Phase.STOPPING, Phase.NONE),
    Phase.SETTLING: (Phase.PAUSED, Phase.STOPPING, Phase.NONE),
    Phase.STOPPING: (Phase.NONE,),
    Phase.PAUSED: (Phase.RUNNING, Phase.SETTLING, Phase.STOPPING, Phase.NONE),
}

_MAKING_WAY = int(Slowed.MAKING_WAY)
_ALLOWED_BITS = tuple(sum(1 << int(to) for to in ALLOWED[phase]) for phase in Phase)


@jit
def change_phase(loop: Loop, path_index: int, phase: int) -> bool:
    """Let the goal of a path go to a phase if the table allows it; says whether it did."""
    path = loop.paths[path_index]
    if (_ALLOWED_BITS[path.phase] >> phase) & 1 == 0:
        return False
    path.phase = phase
    return True


@jit
def incoming(loop: Loop) -> int:
    """The path that a newer goal has or would have."""
    return int(1 - loop.goals.active)


@jit
def waits(loop: Loop) -> bool:
    """Whether a newer goal waits to take over."""
    return bool(loop.paths[incoming(loop)].phase == Phase.WAITING)


@jit
def runs(loop: Loop) -> bool:
    """Whether a goal moves or pauses the arm."""
    return bool(loop.paths[loop.goals.active].phase != Phase.NONE)


@jit
def running_goal(loop: Loop) -> int:
    """Id of the goal that runs, 0 none."""
    return int(loop.paths[loop.goals.active].goal_id) if runs(loop) else 0


@jit
def stops_for_good(loop: Loop, path_index: int) -> bool:
    """Whether the goal of a path has been ended; one that ran dry goes on with the next message of its stream."""
    path = loop.paths[path_index]
    return bool(path.phase == Phase.STOPPING and path.reason != Outcome.RAN_DRY)


@jit
def stop_running(loop: Loop, outcome: int, joint: int, value: float, limit: float) -> None:
    """Let the goal that runs stop, for a reason that becomes its outcome.

    The first reason stands, but a fault comes before all, and everything before lack of a stream's next message.
    """
    running = loop.paths[loop.goals.active]
    if running.phase == Phase.NONE or (stops_for_good(loop, loop.goals.active) and outcome != Outcome.FAULT):
        return
    change_phase(loop, loop.goals.active, Phase.STOPPING)
    running.reason, running.reason_joint = outcome, joint
    running.reason_value, running.reason_limit = value, limit


@jit
def tell_result(
    loop: Loop, shared: StateFile, path_index: int, outcome: int, joint: int, value: float, limit: float
) -> None:
    """Decide the goal of a path; the first decision stands."""
    path = loop.paths[path_index]
    if path.decided == 0:
        path.decided = 1
        set_result(loop, shared, path.goal_id, outcome, joint, value, limit)


@jit
def tell_why_it_stops(loop: Loop, shared: StateFile) -> None:
    """Decide the goal that stops with the reason for which it does, before the arm stands."""
    running = loop.paths[loop.goals.active]
    joint, value, limit = running.reason_joint, running.reason_value, running.reason_limit
    tell_result(loop, shared, loop.goals.active, running.reason, joint, value, limit)


@jit
def end_goal(
    loop: Loop, shared: StateFile, path_index: int, outcome: int, joint: int, value: float, limit: float
) -> None:
    """Let the goal of a path, if there is one, be over."""
    if change_phase(loop, path_index, Phase.NONE):
        tell_result(loop, shared, path_index, outcome, joint, value, limit)


@jit
def end_waiting(loop: Loop, shared: StateFile, outcome: int, joint: int, value: float, limit: float) -> None:
    """Let the goal that waits, if there is one, not be begun."""
    slow_down(loop, _MAKING_WAY, False)
    end_goal(loop, shared, incoming(loop), outcome, joint, value, limit)


@jit
def raise_epoch(
    loop: Loop, shared: StateFile, outcome: int, joint: int = -1, value: float = 0.0, limit: float = 0.0
) -> None:
    """What arrived before this never begins; the goal that waits ends with the outcome."""
    loop.goals.epoch += 1
    end_waiting(loop, shared, outcome, joint, value, limit)


@jit
def slow_down(loop: Loop, why: int, yes: bool) -> None:
    """Let the clock run slower or stand for a reason (bits of shm.words.Slowed), or no longer."""
    loop.goals.slowed = loop.goals.slowed | why if yes else loop.goals.slowed & ~why


@jit
def pause_running(loop: Loop) -> None:
    """Keep the goal that runs, and its place on its path."""
    change_phase(loop, loop.goals.active, Phase.PAUSED)


@jit
def resume_paused(loop: Loop) -> None:
    """Let a paused goal go on with what it did."""
    running = loop.paths[loop.goals.active]
    if running.phase == Phase.PAUSED:
        change_phase(loop, loop.goals.active, Phase.RUNNING if running.settle_start_ns == 0 else Phase.SETTLING)
