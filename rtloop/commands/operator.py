"""What people ask at any moment: stop, hold and resume, the speed scale, cancels.

Each is one store in the command file of which the newest counts, so none can be lost, and none waits behind another.
"""

from compilation.jit import jit
from rtloop.memory.events import record_event
from rtloop.memory.state import Loop
from rtloop.trajectory.phases import (
    end_waiting,
    incoming,
    pause_running,
    raise_epoch,
    resume_paused,
    running_goal,
    runs,
    stop_running,
    waits,
)
from shm import layout
from shm.atomics import load_acquire
from shm.layout import StateFile
from shm.record import offset_of
from shm.seqlock import copy_words
from shm.words import Event, Mode, Outcome, Request

_STOP = offset_of(layout.CommandFile, "stop_ns")
_HOLD = offset_of(layout.CommandFile, "hold_ns")
_RESUME = offset_of(layout.CommandFile, "resume_ns")
_SPEED_SCALE = offset_of(layout.CommandFile, "speed_scale")
_CANCELED_THROUGH = offset_of(layout.CommandFile, "canceled_through")
_CANCELED_GOALS = offset_of(layout.CommandFile, "canceled_goals")
_SCRATCH_SCALE = offset_of(Loop, "scratch_scale")
_WORD = 8

GOALS_AHEAD = 1_000_000
"""Goal ids rise by one; a word that is this far ahead was not written by a front."""


@jit
def obey_commands(loop: Loop, shared: StateFile) -> None:
    """Obey the newest of each."""
    command = loop.params.command_address
    if command == 0:
        return
    obey_stop_and_hold(loop, shared, command)
    take_speed_scale(loop, shared, command)
    if waits(loop) and is_canceled(loop, loop.paths[incoming(loop)].goal_id):
        end_waiting(loop, shared, Outcome.CANCELED, -1, 0.0, 0.0)
    if runs(loop) and is_canceled(loop, running_goal(loop)):
        stop_running(loop, Outcome.CANCELED, -1, 0.0, 0.0)


@jit
def obey_stop_and_hold(loop: Loop, shared: StateFile, command: int) -> None:
    """A stop or a hold leaves the arm held until a resume that was asked for later; a stop also ends what moves it."""
    operator = loop.operator
    # pairs with `CommandWriter._store`, a plain store; the word is all there is
    stop_ns, hold_ns = load_acquire(command + _STOP), load_acquire(command + _HOLD)
    resume_ns = load_acquire(command + _RESUME)
    stopped, held, resumed = stop_ns != operator.stop_ns, hold_ns != operator.hold_ns, resume_ns != operator.resume_ns
    operator.stop_ns, operator.hold_ns, operator.resume_ns = stop_ns, hold_ns, resume_ns
    if stopped:
        operator.stops += 1
        note(loop, shared, Request.STOP, _STOP)
    if held:
        note(loop, shared, Request.HOLD, _HOLD)
    if stopped or held:
        operator.held = 1
        loop.gripper.halted = loop.gripper.sequence
        loop.dialogue.pose_due_ns = 0
        raise_epoch(loop, shared, Outcome.REFUSED_HELD)
        if loop.mode == Mode.REFERENCING:
            loop.dialogue.referencing_ends = 1
        # A stream keeps its own time, which a pause would take from it.
        if stopped or loop.paths[loop.goals.active].stream == 1:
            stop_running(loop, Outcome.STOPPED, -1, 0.0, 0.0)
        pause_running(loop)
    if operator.held == 1 and resumed and resume_ns > max(stop_ns, hold_ns):
        operator.held = 0
        resume_paused(loop)
        raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)  # what was sent meanwhile is not begun by this
        note(loop, shared, Request.RESUME, _RESUME)


@jit
def note(loop: Loop, shared: StateFile, kind: int, offset: int) -> None:
    """Record what was commanded, and by which process."""
    # pairs with `CommandWriter._store`, a plain store, so this may be of another store; it is only told
    who = load_acquire(loop.params.command_address + offset + _WORD)
    record_event(loop, shared, Event.COMMAND, -1, kind, float(who), 0.0)


@jit
def take_speed_scale(loop: Loop, shared: StateFile, command: int) -> None:
    """A number that is no share of a speed is passed over."""
    operator = loop.operator
    # pairs with `CommandWriter.scale`; the word is all there is
    if load_acquire(command + _SPEED_SCALE) == 0:
        return
    copy_words(loop.params.address + _SCRATCH_SCALE, command + _SPEED_SCALE, 1)
    scale = loop.scratch_scale
    if scale >= 0.0 and scale <= 1.0 and scale != operator.speed_scale:
        operator.speed_scale = abs(scale)
        record_event(loop, shared, Event.COMMAND, -1, Request.SPEED_SCALE, operator.speed_scale, 0.0)


@jit
def is_canceled(loop: Loop, goal_id: int) -> bool:
    """Whether its client no longer wants it."""
    command = loop.params.command_address
    if command == 0:
        return False
    slot = command + _CANCELED_GOALS + _WORD * (goal_id & (layout.CANCELED_SLOTS - 1))
    # pairs with `CommandWriter.cancel` and `cancel_all`; each word is all there is
    through = load_acquire(command + _CANCELED_THROUGH)
    return goal_id == load_acquire(slot) or goal_id <= through <= loop.front.announced_goal
