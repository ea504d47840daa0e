"""Turns streams that ask for more than the limits allow into motion that follows them as closely as the limits permit.

A message within the limits is handed on as it came if it continues the arm's motion, or, from rest, leaves time for its
first point. Otherwise the arm follows a path made here (`motion.shaping`). That path begins on the path that the arm
runs along, so that entering it causes no motion of its own, and ends where the message ends.
"""

from dataclasses import dataclass, replace

import numpy as np

from config.schema import ArmConfig
from motion import shaping, stopping
from motion.limits import band
from rosfront.limits import check_limits
from rosfront.path import PlannedPath
from rosfront.plan import NS, REST_RAD_S, GoalPlan, Present
from rosfront.refusals import BeyondLimits, GoalRefused, NoRoomToStop, TooFar
from shm.words import Entry

STREAM_S = 5.0
"""A message that ends later is a whole trajectory, which could have been planned within the limits. It is checked
like a goal."""
FAR_S = 0.1
"""A stream's target may jump by the start tolerance plus a joint's travel in this time: points come at 10 Hz."""
AHEAD_S, AHEAD_PERIODS = 0.01, 3.5
"""For this time the arm goes on as it does: checking takes a while, and the control process looks once a cycle.

The half period is there because a path made here changes its acceleration in steps. At the time of a cycle, rounding
would decide on which side of a step the arm is, and the entry of the next path would take the step for a difference
that must fade.
"""
STEP_S = 0.01
TAIL_STEP_S, MOST_TAIL_STEPS = 0.05, 1000
BLEND_S = 0.4
BLEND_SHARE = 0.1
"""A blend of the control process may add at most this share of the acceleration limit, within BLEND_S."""
ARRIVED_RAD = 1e-9


@dataclass(frozen=True)
class _State:
    """Positions and velocities of a message's joints, at one time or at several."""

    position: np.ndarray
    velocity: np.ndarray

    def is_at(self, position: np.ndarray) -> bool:
        """Whether all joints are at rest at `position`."""
        away, speed = np.abs(self.position - position), np.abs(self.velocity)
        return bool((away < ARRIVED_RAD).all() and (speed < ARRIVED_RAD).all())


@dataclass(frozen=True)
class _Limits:
    """The limits of a message's joints, without margins; arrays (joints,)."""

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    @classmethod
    def of(cls, arm: ArmConfig, mask: np.ndarray) -> "_Limits":
        joints = [joint for joint, chosen in zip(arm.joints, mask, strict=True) if chosen]
        return cls(
            np.array([joint.lower_rad for joint in joints]),
            np.array([joint.upper_rad for joint in joints]),
            np.array([joint.max_velocity_rad_s for joint in joints]),
            np.array([joint.max_acceleration_rad_s2 for joint in joints]),
        )

    def after(self, state: _State, target: np.ndarray, target_velocity: np.ndarray, step_s: float) -> _State:
        """The state a step later, on the way to a target within the limits."""
        limits = (self.lower, self.upper, self.velocity, self.acceleration)
        velocity = shaping.next_velocity(state.position, state.velocity, target, target_velocity, limits, step_s)
        return _State(state.position + 0.5 * step_s * (state.velocity + velocity), velocity)


def shaped(asked: GoalPlan, arm: ArmConfig, present: Present, earlier: GoalPlan | None) -> GoalPlan:
    """The plan by which a message is followed: `asked` itself, or one that follows it; raises GoalRefused.

    `earlier` is the stream that the arm follows or is about to follow, None where there is none. The points of `asked`
    must keep the position limits.
    """
    begins_ns, follows_ns = asked.start_ns or present.monotonic_ns, _follows_ns(arm, present)
    # the present motion may go on until a message begins, so a message that lies ahead is not followed from now on
    if begins_ns > follows_ns or begins_ns + int(asked.times_ns[-1]) - present.monotonic_ns > STREAM_S * NS:
        check_limits(asked, arm)
        check_room_to_stop(asked, arm)
        return asked
    if earlier is not None and earlier.start_ns == 0:
        earlier = None
    reason = _why_not(asked, arm)
    whole = _with_its_way(asked) if _has_a_way(asked, present, earlier) else asked
    fits = reason is None and (whole is asked or _why_not(whole, arm) is None)
    maker = _Maker(replace(whole, start_ns=begins_ns), arm, present, earlier)
    if fits and maker.a_blend_does():
        return asked
    maker.refuse_jump()
    return replace(maker.plan(), wanted=maker.wanted, reason=reason)


def _follows_ns(arm: ArmConfig, present: Present) -> int:
    """When the arm can begin to follow a message (CLOCK_MONOTONIC, ns)."""
    return present.monotonic_ns + round((AHEAD_S * NS) + AHEAD_PERIODS * arm.control.period_ns)


def _why_not(plan: GoalPlan, arm: ArmConfig) -> GoalRefused | None:
    """The refusal for the first limit, without margins, that a message would break; None if it breaks none."""
    try:
        check_limits(plan, arm, margins=False)
        check_room_to_stop(plan, arm)
    except (BeyondLimits, NoRoomToStop) as problem:
        return problem
    return None


def _has_a_way(asked: GoalPlan, present: Present, earlier: GoalPlan | None) -> bool:
    """Whether the way to the first point is part of the motion: from rest, or where that point lies far ahead.

    Otherwise the points before it came with earlier messages, and the way is the line through the first point.
    """
    begins = present.standing and earlier is None
    return asked.approach and (begins or asked.times_ns[0] - asked.entry_ns > FAR_S * NS)


def _with_its_way(asked: GoalPlan) -> GoalPlan:
    """The same plan with the way from the arm's commanded state to its first point."""
    return replace(
        asked,
        times_ns=np.insert(asked.times_ns, 0, asked.entry_ns),
        orders=np.insert(asked.orders, 0, asked.orders[0]),
        joints=np.concatenate([asked.origin[np.newaxis], asked.joints]),
        entry=Entry.STREAM,
    )


class _Maker:
    """Makes the path that follows a message; all times are CLOCK_MONOTONIC in ns."""

    def __init__(self, wanted: GoalPlan, arm: ArmConfig, present: Present, earlier: GoalPlan | None) -> None:
        self.wanted, self._arm, self._present, self._earlier = wanted, arm, present, earlier
        self._path = PlannedPath(wanted)
        self._mask = self._path.mask
        self._limits = _Limits.of(arm, self._mask)
        self._from_ns = _follows_ns(arm, present)
        self._from = self._going_on()

    def _targets(self, times_ns: np.ndarray) -> _State:
        """What the message asks for at some times, (n, joints); exact rest after a last point meant to be at rest."""
        times_ns = times_ns - self.wanted.start_ns
        position, velocity, _ = self._path.at(times_ns)
        if self._ends_at_rest:
            over = times_ns >= self._path.times_ns[-1]
            position[over], velocity[over] = self._path.waypoints[-1, :, 0], 0.0
        return _State(position, velocity)

    @property
    def _ends_at_rest(self) -> bool:
        return bool((np.abs(self._path.waypoints[-1, :, 1]) <= REST_RAD_S).all())

    def _going_on(self) -> _State:
        """The state in which the arm begins to follow: by the earlier stream, else by its present velocity."""
        now = self._present.commanded[self._mask]
        ahead_s = (self._from_ns - self._present.monotonic_ns) / NS
        position, velocity = now[:, 0] + now[:, 1] * ahead_s, now[:, 1].copy()
        if self._earlier is not None:
            mine, theirs = self._shared_joints(self._earlier)
            before, after = (_at(self._earlier, ns) for ns in (self._present.monotonic_ns, self._from_ns))
            position[mine] += (after.position - before.position)[theirs] - before.velocity[theirs] * ahead_s
            velocity[mine] += (after.velocity - before.velocity)[theirs]
        return _State(position, velocity)

    def _shared_joints(self, earlier: GoalPlan) -> tuple[np.ndarray, np.ndarray]:
        """Masks of the joints in both messages: among this message's joints, and among the earlier one's."""
        theirs = np.array([bool(earlier.joint_mask >> joint & 1) for joint in range(len(self._mask))])
        both = theirs & self._mask
        return both[self._mask], both[theirs]

    def a_blend_does(self) -> bool:
        """Whether the control process can lead the arm onto the message's own path within the limits.

        A quintic that removes d rad and w rad/s within T accelerates by at most 5.8 d / T² and 3.9 w / T.
        """
        if self._present.standing and self._earlier is None and self.wanted.start_ns >= self._present.monotonic_ns:
            return True  # from rest, now or later: the start, or the way to the first point, was checked before
        target = self._targets(np.array([self._from_ns]))
        push = 5.8 * np.abs(target.position - self._from.position) / BLEND_S**2
        push += 3.9 * np.abs(target.velocity - self._from.velocity) / BLEND_S
        return bool((push <= BLEND_SHARE * self._limits.acceleration).all())

    def refuse_jump(self) -> None:
        """Raise TooFar for a target that is not near what was asked for before.

        A message of a few ms is over at the time compared here. Then its last point counts, not the line beyond it.
        """
        target, before = _asked_at(self.wanted, self._from_ns), self._from.position.copy()
        allowed = self._arm.limits.start_tolerance_rad + FAR_S * self._limits.velocity
        if self._earlier is not None:
            mine, theirs = self._shared_joints(self._earlier)
            before[mine] = _asked_at(self._earlier.wanted or self._earlier, self._from_ns)[theirs]
        away = np.abs(target - before)
        if not (away <= allowed).all():
            worst = int((away - allowed).argmax())
            joint = self._arm.joints[int(np.flatnonzero(self._mask)[worst])].name
            raise TooFar("The message", joint, float(away[worst]), float(allowed[worst]), float(target[worst]))

    def plan(self) -> GoalPlan:
        """The path that follows the message, from the present commanded state on."""
        times_ns, orders, waypoints = self._run_up()
        state, at_ns = self._from, self._from_ns
        # a message of a few ms is over before the arm can follow it: a stream of such messages would never begin
        end_ns = max(int(self._path.times_ns[-1]) + self.wanted.start_ns, 2 * at_ns - self._present.monotonic_ns)

        def step(to_ns: int, target: _State) -> None:
            nonlocal state, at_ns
            state = self._limits.after(state, target.position, target.velocity, (to_ns - at_ns) / NS)
            at_ns = to_ns
            times_ns.append(to_ns)
            orders.append(3)
            waypoints.append(np.stack([state.position, state.velocity, np.zeros_like(state.velocity)], axis=1))

        steps = np.append(np.arange(at_ns + round(STEP_S * NS), end_ns, round(STEP_S * NS)), end_ns)
        targets = self._targets(steps)
        for to_ns, position, velocity in zip(steps, targets.position, targets.velocity, strict=True):
            step(int(to_ns), _State(position, velocity))
        if self._ends_at_rest:
            # rounding may have put the last point beyond the limits
            end = np.clip(self._path.waypoints[-1, :, 0], self._limits.lower, self._limits.upper)
            goal = _State(end, np.zeros_like(end))
            for _ in range(MOST_TAIL_STEPS):
                if state.is_at(end):
                    waypoints[-1][:, :2] = np.stack([end, goal.velocity], axis=1)
                    break
                step(at_ns + round(TAIL_STEP_S * NS), goal)
        made = self._made(times_ns, orders, waypoints)
        try:
            check_room_to_stop(made, self._arm)
        except NoRoomToStop:
            while (np.abs(state.velocity) > 0.0).any():
                to_ns = at_ns + round(STEP_S * NS)
                step(to_ns, _State(state.position + 0.5 * STEP_S * state.velocity, np.zeros_like(state.velocity)))
            made = self._made(times_ns, orders, waypoints)
        return made

    def _run_up(self) -> tuple[list[int], list[int], list[np.ndarray]]:
        """The arm's motion until it follows, as times, orders, waypoints: an entry anywhere in it changes nothing."""
        now_ns, now = self._present.monotonic_ns, self._present.commanded[self._mask]
        times_ns, orders, waypoints = [now_ns], [3], [now.copy()]
        if self._earlier is not None and self._earlier.joint_mask == self.wanted.joint_mask:
            earlier = PlannedPath(self._earlier)
            own_ns = earlier.times_ns + self._earlier.start_ns
            between = np.flatnonzero((own_ns > now_ns) & (own_ns < self._from_ns))
            before, ahead_s = _at(self._earlier, now_ns), (own_ns[between] - now_ns) / NS
            for index, later_s in zip(between, ahead_s, strict=True):
                waypoint = earlier.waypoints[index].copy()
                waypoint[:, 0] += now[:, 0] - before.position + (now[:, 1] - before.velocity) * later_s
                waypoint[:, 1] += now[:, 1] - before.velocity
                times_ns.append(int(own_ns[index]))
                orders.append(int(earlier.orders[index - 1]) if index else 3)
                waypoints.append(waypoint)
        times_ns.append(self._from_ns)
        orders.append(3)
        waypoints.append(
            np.stack([self._from.position, self._from.velocity, np.zeros_like(self._from.velocity)], axis=1)
        )
        return times_ns, orders, waypoints

    def _made(self, times_ns: list[int], orders: list[int], waypoints: list[np.ndarray]) -> GoalPlan:
        joints = np.zeros((len(waypoints), len(self._mask), 3))
        joints[:, :, 0] = self._present.commanded[:, 0]
        joints[:, self._mask] = np.stack(waypoints)
        start_ns = times_ns[0]
        return replace(
            self.wanted,
            times_ns=np.array(times_ns) - start_ns,
            orders=np.array(orders),
            joints=joints,
            start_ns=start_ns,
            entry_ns=0,
            entry=Entry.STREAM,
        )


def _at(plan: GoalPlan, time_ns: int) -> _State:
    """What a stream with a known start asks for at a time of CLOCK_MONOTONIC (ns)."""
    position, velocity, _ = PlannedPath(plan).at(np.array([time_ns - plan.start_ns]))
    return _State(position[0], velocity[0])


def _asked_at(plan: GoalPlan, time_ns: int) -> np.ndarray:
    """The positions that a stream asks for at a time of CLOCK_MONOTONIC (ns), or at its end if that is earlier."""
    return _at(plan, min(time_ns, plan.start_ns + int(plan.times_ns[-1]))).position


def largest_lag(plan: GoalPlan) -> tuple[int, float]:
    """The joint (index in the arm) with the largest lag behind its message while that lasts, and the lag (rad)."""
    if plan.wanted is None:
        return -1, 0.0
    wanted, path = PlannedPath(plan.wanted), PlannedPath(plan)
    times_ns = path.times_ns[path.times_ns + plan.start_ns <= plan.wanted.start_ns + plan.wanted.times_ns[-1]]
    lag = np.abs(wanted.at(times_ns + plan.start_ns - plan.wanted.start_ns)[0] - path.at(times_ns)[0])
    joint = int(lag.max(axis=0, initial=0.0).argmax())
    return int(np.flatnonzero(path.mask)[joint]), float(lag.max(initial=0.0))


def check_room_to_stop(plan: GoalPlan, arm: ArmConfig) -> None:
    """Raise NoRoomToStop unless the stream can stop in a straight line behind its last point, inside the limits."""
    period_s = arm.control.period_ns / NS
    position, velocity, acceleration = plan.joints[-1].T
    fade_s = stopping.fade_duration_s(period_s)
    position, velocity = stopping.line_beyond(position, velocity, acceleration, fade_s)
    hardest = np.array([joint.max_acceleration_rad_s2 for joint in arm.joints])
    to_brake_s = float((np.abs(velocity) / (stopping.ORDERLY * hardest)).max())
    stop = position + velocity * stopping.reach_s(to_brake_s, arm.longest_stop_s, period_s)
    for joint, config in enumerate(arm.joints):
        lowest_rad, highest_rad = band(config.lower_rad, config.upper_rad, config.slack_rad)
        if velocity[joint] > 0.0 and stop[joint] > highest_rad:
            raise NoRoomToStop(config.name, float(velocity[joint]), float(stop[joint]), config.upper_rad)
        if velocity[joint] < 0.0 and stop[joint] < lowest_rad:
            raise NoRoomToStop(config.name, float(velocity[joint]), float(stop[joint]), config.lower_rad)
