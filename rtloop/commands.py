"""What people ask at any moment: stop, hold and resume, the speed scale, cancels.

Each is one store in the command file of which the newest counts, so none can be lost, and none waits behind another.
"""

from typing import Any

from rtloop.events import record_event, set_result
from rtloop.state import LOOP, offset_of
from shm import layout
from shm.atomics import load_acquire
from shm.jit import jit
from shm.seqlock import copy_words
from shm.words import Event, Mode, Outcome, Request

Loop = Any  # record of dtype rtloop.state.LOOP
Shared = Any  # record of dtype shm.layout.STATE

_STOP = offset_of(layout.COMMAND, "stop_ns")
_HOLD = offset_of(layout.COMMAND, "hold_ns")
_RESUME = offset_of(layout.COMMAND, "resume_ns")
_SPEED_SCALE = offset_of(layout.COMMAND, "speed_scale")
_CANCELED_THROUGH = offset_of(layout.COMMAND, "canceled_through")
_CANCELED_GOALS = offset_of(layout.COMMAND, "canceled_goals")
_SCRATCH_SCALE = offset_of(LOOP, "scratch_scale")
_WORD = 8

GOALS_AHEAD = 1_000_000
"""Goal ids rise by one; a word that is this far ahead was not written by a front."""


@jit
def obey_commands(loop: Loop, shared: Shared) -> None:
    """Obey the newest of each."""
    command = loop.params.command_address
    if command == 0:
        return
    obey_stop_and_hold(loop, shared, command)
    take_speed_scale(loop, shared, command)
    core = loop.core
    if core.incoming_goal != 0 and is_canceled(loop, core.incoming_goal):
        end_incoming(loop, shared, Outcome.CANCELED)
    if core.goal_id != 0 and is_canceled(loop, core.goal_id):
        end_running(loop, shared, Outcome.CANCELED)


@jit
def obey_stop_and_hold(loop: Loop, shared: Shared, command: int) -> None:
    """A stop or a hold leaves the arm held until a resume that was asked for later; a stop also ends what moves it."""
    core = loop.core
    stop_ns, hold_ns = load_acquire(command + _STOP), load_acquire(command + _HOLD)
    resume_ns = load_acquire(command + _RESUME)
    stopped, held, resumed = stop_ns != core.stop_ns, hold_ns != core.hold_ns, resume_ns != core.resume_ns
    core.stop_ns, core.hold_ns, core.resume_ns = stop_ns, hold_ns, resume_ns
    if stopped:
        core.stops += 1
        note(loop, shared, Request.STOP, _STOP)
    if held:
        note(loop, shared, Request.HOLD, _HOLD)
    if stopped or held:
        core.held = 1
        core.pose_due_ns = 0
        raise_epoch(loop, shared, Outcome.REFUSED_HELD)
        if core.mode == Mode.REFERENCING:
            core.referencing_ends = 1
        # A stream keeps its own time, which a pause would take from it.
        if stopped or loop.paths[core.active].stream == 1:
            end_running(loop, shared, Outcome.STOPPED)
    if core.held == 1 and resumed and resume_ns > max(stop_ns, hold_ns):
        core.held = 0
        raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)  # what was sent meanwhile is not begun by this
        note(loop, shared, Request.RESUME, _RESUME)


@jit
def note(loop: Loop, shared: Shared, kind: int, offset: int) -> None:
    """An event that says what was asked, and by which process."""
    who = load_acquire(loop.params.command_address + offset + _WORD)
    record_event(loop, shared, Event.COMMAND, -1, kind, float(who), 0.0)


@jit
def raise_epoch(loop: Loop, shared: Shared, outcome: int) -> None:
    """What arrived before this never begins; the goal that waits ends with the outcome."""
    loop.core.epoch += 1
    end_incoming(loop, shared, outcome)


@jit
def take_speed_scale(loop: Loop, shared: Shared, command: int) -> None:
    """A number that is no share of a speed is passed over."""
    core = loop.core
    if load_acquire(command + _SPEED_SCALE) == 0:
        return
    copy_words(loop.params.address + _SCRATCH_SCALE, command + _SPEED_SCALE, 1)
    scale = loop.scratch_scale
    if scale >= 0.0 and scale <= 1.0 and scale != core.speed_scale:
        core.speed_scale = abs(scale)
        record_event(loop, shared, Event.COMMAND, -1, Request.SPEED_SCALE, core.speed_scale, 0.0)


@jit
def is_canceled(loop: Loop, goal_id: int) -> bool:
    """Whether its client no longer wants it."""
    command = loop.params.command_address
    if command == 0:
        return False
    slot = command + _CANCELED_GOALS + _WORD * (goal_id & (layout.CANCELED_SLOTS - 1))
    through = load_acquire(command + _CANCELED_THROUGH)
    return goal_id == load_acquire(slot) or goal_id <= through <= loop.core.announced_goal


@jit
def end_incoming(loop: Loop, shared: Shared, outcome: int) -> None:
    """The goal that waits is not begun."""
    core = loop.core
    if core.incoming_goal != 0:
        set_result(loop, shared, core.incoming_goal, outcome, -1, 0.0, 0.0)
        core.incoming_goal = core.incoming_waits = 0


@jit
def end_running(loop: Loop, shared: Shared, outcome: int) -> None:
    """The goal that runs ends by a stop on its path, unless it ends already."""
    core = loop.core
    if core.goal_id != 0 and (core.ending == Outcome.NONE or core.ending == Outcome.RAN_DRY):
        core.ending = outcome
        core.ending_joint = -1
        core.ending_value = core.ending_limit = 0.0
