"""A stand-in for the control process, small enough to be obviously right: plays waypoints without dynamics.

It owns an arm's memory files, takes every record, follows the positions of the newest complete goal by
straight lines in real time, answers every request, and reports what happened. Faults are switched on from the test.
"""

import fcntl
import sys
import threading
import time
import zlib

import numpy as np

from config.loader import arm_hash, load_arm
from shm import files, layout
from shm.record import offset_of
from shm.words import Answer, DriveStatus, Fault, Mode, Outcome, Phase, Request, Setpoint, Unreferenced

BRING_UP_CYCLES = 5
LIMP = (Mode.DISABLED, Mode.FREE)


class FakeLoop(threading.Thread):
    def __init__(self, arm, position_rad=None):
        super().__init__(daemon=True)
        self.arm, self.joints = arm, len(arm.joints)
        self.period_ns = arm.control.period_ns
        identity = files.Identity(arm.name, tuple(j.name for j in arm.joints), arm_hash(arm), self.period_ns)
        self.files = files.create(identity)
        self.state, self.command = self.files.state.record, self.files.command.record
        self.snapshot = np.zeros(1, layout.Snapshot.dtype)[0]
        rows = self.snapshot["joints"][: self.joints]
        rows["referenced"] = 1
        for word in ("measured_effort", "drive_temperature_c", "drive_voltage_v"):
            rows[word] = np.nan
        rows["drive_status"] = DriveStatus.ENABLED | DriveStatus.ANSWERED
        rows["commanded_position_rad"] = 0.0 if position_rad is None else position_rad
        self.rows = rows
        self.snapshot["mode"] = Mode.HOLDING
        for word in ("speed_scale", "speed_scale_target", "speed_scale_asked"):
            self.snapshot[word] = 1.0
        self.goals = {}
        self.records = []
        self.taken = self.requests = self.results_decided = 0
        self.active = self.incoming = 0
        self.cancel_at = self.up_at = self.newest = 0
        self.stop_ns = self.hold_ns = self.resume_ns = 0
        self.paused = False
        self.bring_up_fails = False
        self.asked = []
        self.measuring = self.taking = self.alive = True
        self.pause = threading.Event()
        self.cycle_hook = lambda loop: None

    def run(self):
        due = time.monotonic_ns()
        while self.alive:
            due += self.period_ns
            time.sleep(max(0, due - time.monotonic_ns()) * 1e-9)
            if not self.pause.is_set():
                self.cycle(due)

    def die(self):
        """As by kill -9: the lock falls, the files stay."""
        self.alive = False
        if self.is_alive():
            self.join()
        fcntl.flock(self.files.state.fd, fcntl.LOCK_UN)

    def sweep(self):
        """Remove what a dead one left."""
        for memory in (self.files.state, self.files.command):
            memory.path.unlink(missing_ok=True)
            memory.close()
        files.state_path(f"{self.arm.name}").with_suffix(".state.prev").unlink(missing_ok=True)

    def stop(self):
        self.die()
        self.files.remove()

    # --- one cycle ---

    def cycle(self, now_ns):
        s = self.snapshot
        s["cycle"] += 1
        s["monotonic_ns"] = now_ns
        s["epoch_ns"] = time.time_ns() - (time.monotonic_ns() - now_ns)
        self.state["counters"]["cycles"] += 1
        if self.taking:
            self.take_commands()  # in the order of the real cycle
            self.take_requests()
            self.take_setpoints()
        if self.up_at:
            self.bring_up()
        self.follow(now_ns)
        self.cycle_hook(self)
        if self.measuring:
            self.rows["measured_ns"] = now_ns
            for quantity in ("position_rad", "velocity_rad_s"):
                self.rows[f"measured_{quantity}"] = self.rows[f"commanded_{quantity}"]
                self.rows[f"reference_{quantity}"] = self.rows[f"commanded_{quantity}"]
        self.write()

    def take_setpoints(self):
        while self.taken < self.command["setpoints_written"][0]:
            slot = self.command["setpoints"][self.taken % layout.SETPOINT_SLOTS]
            raw = slot.tobytes()[: layout.used_bytes(layout.Setpoint, self.joints)]
            assert int.from_bytes(raw[:8], "little") == zlib.crc32(raw[8:])
            assert slot["sequence"] == self.taken
            self.taken += 1
            goal_id, kind = int(slot["goal_id"]), int(slot["kind"])
            self.records.append((goal_id, kind))
            if goal_id < self.command["announced_goal"][0]:
                continue
            if kind == Setpoint.BEGIN:
                begin = slot.copy().view(layout.Begin.dtype)
                self.goals[goal_id] = {"begin": begin, "times": [], "points": [], "ended": False}
                self.newest = goal_id
                if self.is_canceled(goal_id):
                    self.decide(goal_id, Outcome.CANCELED)
                elif self.snapshot["held"]:
                    self.decide(goal_id, Outcome.REFUSED_HELD)
                elif begin["epoch"] != self.snapshot["epoch"]:
                    self.decide(goal_id, Outcome.REFUSED_OUTDATED)
                else:
                    self.incoming = goal_id
            elif kind == Setpoint.WAYPOINT:
                self.goals[goal_id]["times"].append(int(slot["time_ns"]))
                self.goals[goal_id]["points"].append(slot["joints"]["position_rad"][: self.joints].copy())
            else:
                self.goals[goal_id]["ended"] = True
                self.goals[goal_id]["goal_tolerances"] = slot["joints"][: self.joints].copy()
        self.state["consumed"]["setpoints"] = self.taken

    def take_commands(self):
        """What is asked by stores: stop, hold and resume, the speed scale, cancels."""
        s, command = self.snapshot, self.command
        stop_ns, hold_ns, resume_ns = (int(command[name][0]) for name in ("stop_ns", "hold_ns", "resume_ns"))
        stopped, held, resumed = stop_ns != self.stop_ns, hold_ns != self.hold_ns, resume_ns != self.resume_ns
        self.stop_ns, self.hold_ns, self.resume_ns = stop_ns, hold_ns, resume_ns
        if stopped:
            s["stops"] += 1
            self.asked.append((Request.STOP, 0.0))
            if self.active:
                self.cancel_at = int(s["cycle"]) + 5
        if held:
            self.asked.append((Request.HOLD, 0.0))
        if stopped or held:
            s["held"] = 1
            s["epoch"] += 1
            if self.incoming:
                self.decide(self.incoming, Outcome.REFUSED_HELD)
                self.incoming = 0
        if resumed and resume_ns > max(stop_ns, hold_ns):
            s["held"] = 0
            self.asked.append((Request.RESUME, 0.0))
        self.paused = bool(s["held"] and self.active)
        scale = command["speed_scale"][:1]
        if scale.view("i8")[0] and 0.0 <= scale[0] <= 1.0 and scale[0] != s["speed_scale_asked"]:
            s["speed_scale_asked"] = abs(scale[0])
            self.asked.append((Request.SPEED_SCALE, float(s["speed_scale_asked"])))
        if self.incoming and self.is_canceled(self.incoming):
            self.decide(self.incoming, Outcome.CANCELED)
            self.incoming = 0
        if self.active and self.is_canceled(self.active):
            self.cancel_at = self.cancel_at or int(s["cycle"]) + 5

    def is_canceled(self, goal_id):
        canceled = self.command["canceled_goals"][goal_id % layout.CANCELED_SLOTS] == goal_id
        return canceled or goal_id <= self.command["canceled_through"][0]

    def take_requests(self):
        while self.requests < self.command["requests_written"][0]:
            request = self.command["requests"][self.requests % layout.REQUEST_SLOTS]
            self.requests += 1
            kind, value = Request(int(request["kind"])), float(request["value"])
            self.asked.append((kind, value))
            answer = self.snapshot["answers"][self.requests % layout.ANSWER_SLOTS]
            answer["sequence"] = self.requests
            answer["answer"] = self.obey(kind)
        self.state["consumed"]["requests"] = self.requests

    def obey(self, kind):
        s, mode = self.snapshot, self.snapshot["mode"]
        limp = {Request.DISABLE: Mode.DISABLED, Request.FREE: Mode.FREE}
        if kind in limp:
            if self.active:
                return Answer.REFUSED_MOVING
            if mode not in (Mode.HOLDING, *LIMP):
                return Answer.REFUSED_MODE
            s["mode"] = limp[kind]
            s["epoch"] += 1
            self.rows["drive_status"] &= ~int(DriveStatus.ENABLED)
        elif kind == Request.CLEAR_FAULT or (kind == Request.ENABLE and mode in LIMP):
            if kind == Request.CLEAR_FAULT and mode != Mode.FAULT:
                return Answer.REFUSED_MODE
            self.up_at = int(s["cycle"]) + BRING_UP_CYCLES
        elif kind == Request.ENABLE:
            return Answer.DONE if mode in (Mode.HOLDING, Mode.EXECUTING) else Answer.REFUSED_MODE
        else:
            return Answer.REFUSED_UNKNOWN
        return Answer.DONE

    def bring_up(self):
        s = self.snapshot
        s["mode"], s["fault"] = Mode.BRINGING_UP, Fault.NONE
        if s["cycle"] >= self.up_at:
            self.up_at = 0
            s["mode"] = Mode.HOLDING
            self.rows["drive_status"] |= int(DriveStatus.ENABLED)
            if self.bring_up_fails:
                self.fault(Fault.BRING_UP, -1, 0.0, 0.0)

    def follow(self, now_ns):
        s = self.snapshot
        goal = self.goals.get(self.incoming)
        if goal and (goal["ended"] or (goal["times"] and goal["times"][-1] > 1e9)):
            if self.active:
                self.decide(self.active, Outcome.REPLACED)
            self.active, self.incoming = self.incoming, 0
            self.origin = self.rows["commanded_position_rad"].copy()
            self.start_ns = int(goal["begin"]["start_ns"]) or now_ns
            s["mode"], s["goal_phase"] = Mode.EXECUTING, Phase.RUNNING
        s["goal_id"] = self.active
        s["speed_scale"] = 0.0 if self.paused else s["speed_scale_asked"]
        if not self.active:
            return
        s["goal_phase"] = Phase.PAUSED if self.paused else Phase.RUNNING
        self.start_ns += round((1.0 - s["speed_scale"]) * self.period_ns)
        goal = self.goals[self.active]
        clock = now_ns - self.start_ns
        s["trajectory_clock_ns"] = clock
        times, points = np.array([0, *goal["times"]]), np.array([self.origin, *goal["points"]])
        for joint in range(self.joints):
            if int(goal["begin"]["joint_mask"]) >> joint & 1:
                self.rows["commanded_position_rad"][joint] = np.interp(clock, times, points[:, joint])
        if self.cancel_at and s["cycle"] >= self.cancel_at:
            self.finish(Outcome.CANCELED)
        elif goal["ended"] and clock >= times[-1]:
            self.finish(Outcome.SUCCEEDED, joint=0, limit=0.01)

    def decide(self, goal_id, outcome, joint=-1, value=0.0, limit=0.0):
        row = self.snapshot["results"][self.results_decided % layout.RESULT_SLOTS]
        self.results_decided += 1
        for name, what in (("goal_id", goal_id), ("joint", joint), ("value", value), ("limit", limit)):
            row[name] = what
        row["outcome"] = outcome

    def finish(self, outcome, **details):
        self.decide(self.active, outcome, **details)
        self.active = self.cancel_at = 0
        self.snapshot["goal_id"] = 0
        self.snapshot["mode"], self.snapshot["goal_phase"] = Mode.HOLDING, Phase.NONE

    def write(self):
        used = layout.used_bytes(layout.Snapshot, self.joints)
        raw = self.snapshot.tobytes()[:used]
        at = offset_of(layout.StateFile, "snapshot")
        target = self.files.state.array.view(np.uint8)
        self.state["snapshot_sequence"][0] += 1
        target[at + 8 : at + used] = np.frombuffer(raw[8:], np.uint8)
        target[at : at + 8] = np.frombuffer(zlib.crc32(raw[8:]).to_bytes(8, "little"), np.uint8)
        self.state["snapshot_sequence"][0] += 1

    # --- what a test can do to it ---

    def fault(self, fault, joint, value, limit):
        s = self.snapshot
        s["fault"], s["fault_joint"], s["fault_value"], s["fault_limit"] = fault, joint, value, limit
        s["fault_ns"] = s["monotonic_ns"]
        s["epoch"] += 1
        if self.active:
            self.finish(Outcome.FAULT, joint=joint, value=value, limit=limit)
        s["mode"] = Mode.FAULT

    def unreference(self, joint):
        self.rows["referenced"][joint] = 0
        self.rows["unreferenced_reason"][joint] = Unreferenced.POWER_LOST


if __name__ == "__main__":  # a process of its own, for measuring
    loop = FakeLoop(load_arm(sys.argv[1]))
    loop.start()
    loop.join()
