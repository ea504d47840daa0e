"""The control cycle, from top to bottom: bytes in, motion, bytes out.

`step(loop, shared, now_ns)` is one cycle as a function of its inputs: the state, the time and what the wire
brought (in the state's receive rings); its output stands in the state's transmit buffers. It sleeps for
nothing, asks the system for nothing and allocates nothing. `rtloop.process.run` calls it in real time, tests in
virtual time.
"""

from compilation.jit import jit
from rtloop import setpoints
from rtloop.bus import frames, measured
from rtloop.commands import operator, orders, request_reader, setpoint_reader
from rtloop.memory.events import record_event
from rtloop.memory.state import HISTORY_SLOTS, Loop
from rtloop.publish import publish_snapshot
from rtloop.safety import monitor
from rtloop.trajectory import goals
from rtloop.trajectory.correction import ERROR_SHARE_1_S
from rtloop.trajectory.phases import raise_epoch, runs
from shm.layout import MAX_JOINTS, StateFile
from shm.words import Event, Outcome

GAP_NS = 100_000_000
"""A cycle later than this finds drives that have braked by themselves: the goal is over."""


@jit
def step(loop: Loop, shared: StateFile, now_ns: int) -> None:
    """Run one cycle whose planned time is now_ns; what it sends stands in the transmit buffers of `loop.buses`."""
    begin_cycle(loop, shared, now_ns)
    measured.take_what_the_bus_brought(loop, shared)
    orders.take_service_orders(loop, shared)
    setpoint_reader.read_heartbeat(loop)
    operator.obey_commands(loop, shared)
    request_reader.take_requests(loop, shared)
    setpoint_reader.take_setpoints(loop, shared)
    monitor.check_measured(loop, shared)
    goals.enter_newer_goal(loop, shared)
    goals.steer(loop, shared)
    setpoints.move(loop, shared)
    goals.judge_goal(loop, shared)
    frames.encode(loop, shared)
    publish_snapshot(loop, shared)


@jit
def begin_cycle(loop: Loop, shared: StateFile, now_ns: int) -> None:
    """The setpoint that was sent for this instant becomes the present one; a long gap ends the goal."""
    timing = loop.timing
    waited_ns = now_ns - timing.now_ns if timing.cycle > 0 else 0
    gap_ns = waited_ns + timing.suspended_ns
    timing.suspended_ns = 0
    timing.now_ns = now_ns
    timing.cycle += 1
    late_ns = max(waited_ns - loop.params.period_ns, 0)
    away_ns = min(max(gap_ns - loop.params.period_ns, 0), GAP_NS)
    period_s = loop.params.period_ns * 1e-9
    slot = loop.history.next & (HISTORY_SLOTS - 1)
    loop.history.time_ns[slot] = now_ns
    for number in range(loop.params.bus_count):
        bus = loop.buses[number]
        bus.quiet.away_ns += late_ns
        if bus.unacknowledged_since_ns != 0:
            bus.unacknowledged_since_ns += late_ns
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        commanded = axis.commanded
        commanded.difference_velocity_rad_s = (commanded.next_position_rad - commanded.position_rad) / period_s
        commanded.position_rad = commanded.next_position_rad
        commanded.velocity_rad_s = commanded.next_velocity_rad_s
        commanded.acceleration_rad_s2 = commanded.next_acceleration_rad_s2
        if axis.reply.unanswered_since_ns != 0:
            axis.reply.unanswered_since_ns += late_ns  # the loop was away, not the drive
        axis.tracking.slip_rad *= 1.0 - min(ERROR_SHARE_1_S * period_s, 1.0)
        axis.tracking.slip_rad += abs(commanded.velocity_rad_s) * away_ns * 1e-9
        loop.history.position_rad[slot * MAX_JOINTS + joint] = commanded.position_rad
    loop.history.next += 1
    shared.counters.cycles = timing.cycle
    if gap_ns > GAP_NS:
        stand_where_the_drives_stopped(loop, shared, gap_ns)


@jit
def stand_where_the_drives_stopped(loop: Loop, shared: StateFile, gap_ns: int) -> None:
    """After a gap longer than the drives' look-ahead: the goal is over, the arm is where it came to rest."""
    record_event(loop, shared, Event.OVERRUN, -1, gap_ns, gap_ns * 1e-9, GAP_NS * 1e-9)
    raise_epoch(loop, shared, Outcome.REFUSED_OUTDATED)  # what waited meanwhile moves nothing
    if not runs(loop) and loop.motion.per_joint_stop == 0:
        return
    goals.finish_running(loop, shared, Outcome.CLOCK_GAP, -1, gap_ns * 1e-9, GAP_NS * 1e-9)
    loop.motion.resync_ns = loop.timing.now_ns
