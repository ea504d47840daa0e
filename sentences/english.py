"""What every number of `shm.words` means to a person, in English: messages and documentation are made of it.

Every outcome, fault, answer, bus state and reason has a `Meaning`: the sentence (what happened, with the value; what is
allowed; what to do), why the check exists, and the ways out. Placeholders in a sentence are `{joint}`,
`{value}` and `{limit}`; `{value:mode}` writes the value as the name of a mode, `{value:drive}` what is wrong by the
status bits of a drive.
"""

from sentences.meaning import Meaning, Phrases, Silence
from shm.words import Answer, BusState, Fault, GripTrouble, Mode, Outcome, Request, Unreferenced

OUTCOMES: dict[Outcome, Meaning] = {
    Outcome.NONE: Meaning(
        "The goal is not decided yet.",
        "A goal stays undecided from its announcement until the control process ends it.",
        "Wait for its result, or cancel it.",
    ),
    Outcome.SUCCEEDED: Meaning(
        "Goal reached: the largest error is {value:.4f} rad, of {joint}; {limit:.4f} rad are allowed.",
        "Success means that every measured joint is inside its goal tolerance, not that time has passed.",
        "Nothing to do.",
    ),
    Outcome.CANCELED: Meaning(
        "Canceled: the arm is at rest and has not left its path.",
        "A cancel slows the trajectory's clock to a stop, so the arm never leaves the planned path.",
        "Plan from where the arm stands.",
    ),
    Outcome.REPLACED: Meaning(
        "The goal was replaced by a newer goal, or by a trajectory on ~/joint_trajectory.",
        "One goal moves the arm at a time, and the newest is what its user wants.",
        "Send goals one after the other if each is to be completed.",
    ),
    Outcome.STOPPED: Meaning(
        "The arm was stopped by a person, has come to rest on its path, and takes no goals before `rtarm resume` (or "
        "~/resume).",
        "A stop must work when the ROS side does not, and must last when a client sends its goal again.",
        "Find out why, resume, then plan from where the arm stands.",
    ),
    Outcome.PATH_TOLERANCE: Meaning(
        "{joint} was {value:.4f} rad from its setpoint and {limit:.4f} rad are allowed: check what hinders "
        "it, move more slowly, or allow more in path_tolerance.",
        "A joint that falls behind its setpoint makes the arm leave the planned, collision-free path.",
        "Look for an obstacle, a load or a current limit that is too low; slow the motion down; then, if the "
        "error is acceptable, raise the goal's path_tolerance or trajectory.path_tolerance_rad.",
    ),
    Outcome.GOAL_TOLERANCE: Meaning(
        "{joint} was {value:.4f} rad from its target when the time to arrive was over, and {limit:.4f} rad "
        "are allowed: check what hinders it, or allow more in goal_tolerance or goal_time_tolerance.",
        "A goal that never arrives must end, or its client would wait for ever.",
        "Look for an obstacle or a load; allow more time in goal_time_tolerance or trajectory.goal_time_s, "
        "or a larger error in goal_tolerance or trajectory.goal_tolerance_rad.",
    ),
    Outcome.FAULT: Meaning(
        "The control process latched a fault and stopped the arm: see `rtarm status`, remove the cause, then "
        "`rtarm clear-fault`.",
        "A latched fault ends every goal; nothing moves until a person has cleared it.",
        "Read the fault, remove its cause, clear it.",
    ),
    Outcome.STARVED: Meaning(
        "The trajectory stopped arriving from the ROS process, so the arm braked on the part it had: look at "
        "that process' log and at the machine's load, then send the goal again.",
        "Braking begins while there is still path to brake on.",
        "Look for a blocked or overloaded ROS process, then send the goal again.",
    ),
    Outcome.FRONT_LOST: Meaning(
        "The ROS process gave no sign of life for {value:.3f} s and {limit:.3f} s are allowed; the arm "
        "stopped on its path: restart that process, or relieve the machine.",
        "Nobody could cancel a motion whose ROS process is gone.",
        "`rtarm up` restarts the process by itself; look at its log and at the machine's load.",
    ),
    Outcome.SHUTDOWN: Meaning(
        "The control process is shutting down; the arm has come to rest on its path: start it again to go on.",
        "An orderly end stops the arm before anything is closed.",
        "Start it again with `rtarm up`, then plan from where the arm stands.",
    ),
    Outcome.REFUSED_MODE: Meaning(
        "The control process takes no goals while it is {value:mode}; goals are taken while it is holding or "
        "executing: wait, enable the drives if they are limp, or see `rtarm status`.",
        "A goal is begun only from a state in which the drives are known to follow.",
        "Wait until bring-up is over, clear the fault, or enable the drives.",
    ),
    Outcome.REFUSED_OUTDATED: Meaning(
        "It arrived before the arm was stopped, held, let go, homed or in a fault, so it does not begin: look where "
        "the arm stands, then send it again.",
        "Whoever sent it did not know of that, and it would move an arm that nobody expects to move.",
        "Plan from where the arm stands now and send that.",
    ),
    Outcome.REFUSED_HELD: Meaning(
        "A person has stopped or holds the arm, so this does not begin: let the arm go on with `rtarm resume` (or "
        "~/resume), then send it again.",
        "A person who stops the arm means it, and neither a stream nor a client that sends its goal again knows of it.",
        "Ask who stopped the arm and why; then `rtarm resume`, the service ~/resume, or Resume on its page.",
    ),
    Outcome.REFUSED_STREAM: Meaning(
        "All drives were silent for a moment and the arm holds again by itself, so a stream waits for a person: look "
        "where the arm stands, then `rtarm resume` (or ~/resume).",
        "A stream was cut off in motion, and who sends it may not know where the arm stands now.",
        "See that nothing is in the arm's way; then `rtarm resume`, the service ~/resume, or Resume on its page.",
    ),
    Outcome.REFUSED_UNREFERENCED: Meaning(
        "{joint} has no reference, so its angle is not known and no goal is taken: see `rtarm status` for "
        "the reason and what to do about it.",
        "Moving to an angle needs to know the present one.",
        "Follow what `rtarm status` says of the joint.",
    ),
    Outcome.REFUSED_START: Meaning(
        "Where it would be entered, the trajectory has {joint} {value:.4f} rad from where it is commanded and "
        "{limit:.4f} rad are allowed: plan from the present state, or give the first point a time_from_start "
        "above 0.",
        "A start elsewhere would be a jump.",
        "Plan from the present state.",
    ),
    Outcome.REFUSED_LIMITS: Meaning(
        "From the arm's present motion no way onto the trajectory keeps the limits of every joint: start "
        "from rest, or allow the trajectory more time.",
        "A new trajectory starts from the commanded position, velocity and acceleration, without a jump.",
        "Wait for the arm to stand, or send a trajectory that begins more gently.",
    ),
    Outcome.REFUSED_CORRUPT: Meaning(
        "The control process refused a trajectory point ({joint}, value {value:g}, limit {limit:g}), "
        "although the ROS process had checked it: both must come from one installation and one arm file; "
        "report this.",
        "The control process believes nothing it reads from shared memory.",
        "Restart both processes from one installation; if it happens again, report it with the goal.",
    ),
    Outcome.RAN_DRY: Meaning(
        "The next point of the stream did not come in time while the arm moved, so it came to rest in a straight line "
        "beyond the last point: send points earlier, and end a stream with a point at rest.",
        "What the sender meant to do next is not known; straight on is the least surprising way to stop.",
        "Nothing to do when the stream ended on purpose; otherwise look for what delays its sender.",
    ),
    Outcome.PATH_VELOCITY: Meaning(
        "The velocity of {joint} was {value:.4f} rad/s from its setpoint and {limit:.4f} rad/s are allowed: check "
        "what hinders it, move more slowly, or allow more in path_tolerance.",
        "The goal asked for its velocity to be watched on the way.",
        "Look for an obstacle or a load; slow the motion down; then raise the goal's path_tolerance.",
    ),
    Outcome.PATH_ACCELERATION: Meaning(
        "The acceleration of {joint}, smoothed, was {value:.3f} rad/s² from its setpoint and {limit:.3f} rad/s² are "
        "allowed: check what hinders it, move more slowly, or allow more in path_tolerance.",
        "The goal asked for its acceleration to be watched on the way.",
        "Look for an obstacle or a load; slow the motion down; then raise the goal's path_tolerance.",
    ),
    Outcome.GOAL_VELOCITY: Meaning(
        "{joint} still moved at {value:.4f} rad/s when the time to arrive was over, and {limit:.4f} rad/s are "
        "allowed: check what moves it, or allow more in goal_tolerance or goal_time_tolerance.",
        "A goal is reached by an arm that stands there, not by one that passes.",
        "Look for an oscillation or a load; allow more time, or a larger velocity in goal_tolerance or "
        "trajectory.stopped_velocity_rad_s.",
    ),
    Outcome.GOAL_ACCELERATION: Meaning(
        "The acceleration of {joint}, smoothed, was {value:.3f} rad/s² from its setpoint when the time to arrive was "
        "over, and {limit:.3f} rad/s² are allowed: check what moves it, or allow more in goal_tolerance.",
        "The goal asked for its acceleration to be watched at the end.",
        "Look for an oscillation; allow more time, or more in goal_tolerance.",
    ),
    Outcome.CLOCK_GAP: Meaning(
        "The control cycle was away for {value:.3f} s and the drives look ahead for {limit:.3f} s, so they "
        "had stopped by themselves: look for what suspends or overloads the machine.",
        "After such a gap the drives stand where nobody planned, and the trajectory must not go on.",
        "Find what suspends or overloads the machine; plan from where the arm stands.",
    ),
}

FAULTS: dict[Fault, Meaning] = {
    Fault.NONE: Meaning("There is no fault.", "", ""),
    Fault.NOT_FINITE: Meaning(
        "The setpoint of {joint} was {value:g}, which is no number, and was not sent: report this with the "
        "goal, then `rtarm clear-fault`.",
        "Last line of defence: such a setpoint can only come from a defect of the program.",
        "Clear the fault; report it with the goal and the log.",
    ),
    Fault.POSITION_LIMIT: Meaning(
        "The setpoint of {joint} led to {value:.4f} rad, beyond its limit {limit:.4f} rad, and was not sent: "
        "check the trajectory and the limits in the arm file, then `rtarm clear-fault`.",
        "Last line of defence behind the goal checks: no setpoint beyond a joint limit is ever sent, nor one after "
        "which the joint could not stop before it.",
        "Check the trajectory and the arm file's limits; clear the fault.",
    ),
    Fault.VELOCITY_LIMIT: Meaning(
        "The setpoint of {joint} moved at {value:.4f} rad/s and {limit:.4f} rad/s are allowed, so it was not "
        "sent: give the trajectory more time, then `rtarm clear-fault`.",
        "Last line of defence behind the goal checks.",
        "Allow the trajectory more time; clear the fault.",
    ),
    Fault.ACCELERATION_LIMIT: Meaning(
        "The setpoint of {joint} accelerated with {value:.3f} rad/s² and {limit:.3f} rad/s² are allowed, so "
        "it was not sent: smooth the trajectory, then `rtarm clear-fault`.",
        "Last line of defence behind the goal checks.",
        "Give the trajectory more time or smooth it; clear the fault.",
    ),
    Fault.FOLLOWING_ERROR: Meaning(
        "{joint} was {value:.4f} rad from where it was commanded and {limit:.4f} rad are allowed: look for "
        "an obstacle, a load or a weak drive, then `rtarm clear-fault`.",
        "A joint that does not follow is blocked, overloaded or not driven.",
        "Free the arm, check the drive's current limit and supply, clear the fault.",
    ),
    Fault.STALE_READING: Meaning(
        "{joint} has given no believable answer for {value:.3f} s and {limit:.3f} s are allowed: check the drive's "
        "supply, its plug and its cable, then `rtarm clear-fault`.",
        "Without readings nobody knows where the joint is.",
        "Check the drive's supply, plug and cable; clear the fault. Where the drive does not prove that it had power, "
        "`rtarm reference` the joint if it stands where it reads, home it if not.",
    ),
    Fault.DRIVE_FAULT: Meaning(
        "The drive of {joint} reports a fault of its own ({value:drive}): remove the cause, then `rtarm clear-fault`.",
        "A drive that has an error, or is not enabled, does not follow setpoints and may hold nothing.",
        "Look at what it names, and at its display or its maker's tool: free the joint, let the drive cool, check its "
        "supply, its encoder and its cable; clear the fault.",
    ),
    Fault.REFERENCE_LOST: Meaning(
        "{joint} lost its reference, so its angle is not known and it gets no motion: see `rtarm status` for the "
        "reason and what to do about it.",
        "After a loss of power or a jump the drive's count does not mean an angle any more.",
        "Follow what `rtarm status` says of the joint; `rtarm clear-fault` alone never references it.",
    ),
    Fault.COMMAND_RING: Meaning(
        "The command memory holds what cannot be right (value {value:g}, limit {limit:g}), and nothing of it "
        "was used: restart the ROS process, then `rtarm clear-fault`.",
        "The control process believes nothing it reads: a corrupt ring must never move the arm.",
        "Restart the ROS process from the same installation; clear the fault.",
    ),
    Fault.WIRE: Meaning(
        "The CAN adapter is gone or refuses: check its cable and that nothing else has opened it, wait for the event "
        "that says it is back, then `rtarm clear-fault`.",
        "Without the adapter no drive can be told anything.",
        "Plug it in again; the control process says when it is back; clear the fault. Joints whose drives were silent "
        "for too long have lost their reference: `rtarm reference` those that stand where they read, home the others.",
    ),
    Fault.LINK_DOWN: Meaning(
        "The CAN interface was taken down: set it up again (`sudo ip link set can0 up type can bitrate 500000`), wait "
        "for the event that says it is back, then `rtarm clear-fault`.",
        "Nothing leaves an interface that is down, and what it held back is lost.",
        "Find out who took it down; set it up; the control process says when it is back; clear the fault. Joints whose "
        "drives were silent for too long have lost their reference: `rtarm reference` those that stand where they "
        "read, home the others.",
    ),
    Fault.HOMING: Meaning(
        "{joint} was not homed, keep clear until it stands: see the control process' message for the reason, mend it, "
        "then `rtarm clear-fault` and `rtarm home` again.",
        "A joint whose stop was not found counts from nowhere.",
        "Follow the message of the control process; clear the fault; home the joint again.",
    ),
    Fault.BUS_OFF: Meaning(
        "The CAN controller has left the bus after too many errors (bus-off): check wires, termination and bit rate, "
        "restart it (`sudo ip link set can0 type can restart`) unless restart-ms does, then `rtarm clear-fault`.",
        "A controller in bus-off sends nothing until it is restarted.",
        "Look for a short circuit, a missing 120 Ω or a node at another bit rate; restart the controller; clear the "
        "fault.",
    ),
    Fault.BRING_UP: Meaning(
        "Bringing up the drives failed: see the control process' message for the drive and the reason, mend "
        "it, then `rtarm clear-fault`.",
        "A drive that does not answer as it should at the start is not moved.",
        "Follow the message of the control process; clear the fault.",
    ),
    Fault.RELEASE: Meaning(
        "The drive of {joint} stays enabled although the arm was to go limp: keep clear, look at the drive's display, "
        "then `rtarm clear-fault`.",
        "An arm of which some joints are limp and others hold must not be taken for one that can be led by hand.",
        "Look at the drive's display; clear the fault, which brings all drives up again.",
    ),
}


_NO_DRIVE = "No drive has given a believable answer for {value:.3f} s and {limit:.3f} s are allowed"
_THEN = ", then `rtarm clear-fault`."

SILENCES: dict[Silence, Meaning] = {
    Silence.SEVERAL_DRIVES: Meaning(
        "{joint} have given no believable answer for {value:.3f} s and {limit:.3f} s are allowed, while other drives "
        "answer: check the supply and the cable that they share" + _THEN,
        "Drives that fall silent together have lost something that they share.",
        "Check the supply that they share and the CAN cable up to the first of them; clear the fault.",
    ),
    Silence.NOT_BELIEVED: Meaning(
        _NO_DRIVE + ", although frames of drives still come: check the Checksum in the drives' menus (0x6B), the "
        "serial line for garbled characters, and that the drives hear what is sent" + _THEN,
        "An answer that cannot be right tells no place.",
        "Look at the wire errors in `rtarm status`, at the drives' menus and at the adapter; clear the fault.",
    ),
    Silence.NOT_ACKNOWLEDGED: Meaning(
        _NO_DRIVE + ", and none acknowledges what is sent: look first at the drives' supply and its switch, then at "
        "the CAN cable to them" + _THEN,
        "A drive that has power and hears a frame acknowledges it, whatever it thinks of it.",
        "Switch the drives on; check the CAN cable and the bit rate; clear the fault.",
    ),
    Silence.BABBLE: Meaning(
        _NO_DRIVE + ", and frames of none of them fill the bus: find the node that sends without a pause (unplug one "
        "after the other)" + _THEN,
        "A node of higher priority that never pauses lets no drive answer.",
        "Find that node; clear the fault.",
    ),
    Silence.BUS: Meaning(
        _NO_DRIVE + ", and the CAN controller tells of errors: check wires, plugs and the 120 Ω at both ends, and that "
        "the drives have power" + _THEN,
        "On a disturbed bus no frame arrives whole.",
        "Check wires, plugs and termination, and the drives' supply; clear the fault.",
    ),
    Silence.MACHINE: Meaning(
        _NO_DRIVE + ", and this machine did not run the control process in time: find what overloads or suspends it "
        "(`rtarm doctor`), and see that the drives have power" + _THEN,
        "What came meanwhile may not have been read in time.",
        "Relieve the machine, set it up for real time (`rtarm doctor --fix`); clear the fault.",
    ),
    Silence.SIMULATED_ARM: Meaning(
        "No drive of the simulated arm has answered for {value:.3f} s and {limit:.3f} s are allowed: this machine was "
        "too busy to run it in time (its own line says so), or the silence was planted; relieve the machine" + _THEN,
        "A simulated arm is a program, which other programs can hold up.",
        "Look for what keeps the machine busy (`rtarm doctor`); clear the fault.",
    ),
    Silence.NOT_TAKEN: Meaning(
        _NO_DRIVE + ", and the adapter did not take all that was written: look at the adapter, its USB cable and hub, "
        "then at the drives' supply and its switch" + _THEN,
        "What an adapter does not take never reaches a drive.",
        "Plug the adapter into another port, without a hub; check that the drives have power; clear the fault.",
    ),
    Silence.ADAPTER: Meaning(
        _NO_DRIVE + ", and the adapter has fallen silent with them: look at the adapter, its USB cable and hub, and "
        "whether this machine was too busy to pass its bytes on (`rtarm doctor`), and see that the drives have power"
        + _THEN,
        "An adapter that answers each frame says by its silence that it, or the way to it, stands still.",
        "Plug the adapter into another port, without a hub; relieve the machine; clear the fault.",
    ),
    Silence.SUPPLY_OR_CABLE: Meaning(
        _NO_DRIVE + ", while the adapter went on answering: look first at the drives' supply and its switch, then at "
        "the CAN cable between adapter and drives" + _THEN,
        "Drives share their supply, so together they fall silent most often for want of it.",
        "Switch the drives on; check the CAN cable and its plugs; clear the fault.",
    ),
    Silence.SUPPLY: Meaning(
        _NO_DRIVE + ": look first at the drives' supply and its switch, then at the CAN cable, the adapter and its USB "
        "cable" + _THEN,
        "Drives share their supply, so together they fall silent most often for want of it.",
        "Switch the drives on; check the CAN cable, the adapter and its USB cable; clear the fault.",
    ),
}
"""STALE_READING, where not one drive alone is silent."""

BUS_STATES: dict[BusState, Meaning] = {
    BusState.ACTIVE: Meaning("The bus is in order.", "", ""),
    BusState.WARNING: Meaning(
        "The CAN controller counts many errors: check wires, plugs and termination.",
        "At 96 errors a controller warns; good frames count down again.",
        "Check wires, plugs and the 120 Ω at both ends.",
    ),
    BusState.PASSIVE: Meaning(
        "The CAN controller is error-passive, so frames of the arm may be lost: see that the drives have power, that "
        "all have one bit rate and that the bus has 120 Ω at both ends.",
        "At 128 errors a controller stays quiet about errors; a bus on which nobody acknowledges leads there at once.",
        "Switch the drives on; compare bit rates; check wires and termination.",
    ),
    BusState.BUS_OFF: Meaning(
        "The CAN controller is off the bus: mend the bus, restart the controller (`sudo ip link set can0 type can "
        "restart`), then `rtarm clear-fault`.",
        "At 256 errors a controller takes no part any more.",
        "Mend the bus, restart the controller, clear the fault.",
    ),
}

UNREFERENCED: dict[Unreferenced, Meaning] = {
    Unreferenced.REFERENCED: Meaning("{joint} is referenced.", "", ""),
    Unreferenced.NOT_BROUGHT_UP: Meaning(
        "{joint} has not been brought up yet, so its angle is not known: wait for bring-up to end.",
        "Only bring-up tells what a drive's count means.",
        "Wait, or see why bring-up does not end.",
    ),
    Unreferenced.POWER_LOST: Meaning(
        "The drive of {joint} may have lost power, so its angle is not known: home it with `rtarm home`, or say "
        "where it stands with `rtarm reference`.",
        "A drive counts from where it stood when it was switched on; that its mark is there proves that it was not.",
        "Home the joint; or look at it and say its angle (`rtarm reference JOINT=DEGREES`).",
    ),
    Unreferenced.POSITION_JUMP: Meaning(
        "The measured position of {joint} jumped, so its angle is not known: check the drive, then "
        "home the joint with `rtarm home`, or say where it stands with `rtarm reference`.",
        "No joint moves that far in one cycle; the count must have changed its meaning.",
        "Check encoder and supply; home the joint, or look at it and say where it stands.",
    ),
    Unreferenced.SILENT: Meaning(
        "The drive of {joint} was silent for too long, so its angle is not known: where `rtarm clear-fault` does not "
        "bring it back, see whether the joint stands where `rtarm status` says, then take that with `rtarm reference`, "
        "or home it.",
        "A drive that was away may have been switched off and moved meanwhile.",
        "Look at the joint; `rtarm reference` it if it stands where it reads, home it if not.",
    ),
    Unreferenced.TARGET_FAR: Meaning(
        "The drive of {joint} stands far from its own target, so adopting either would move it or lie: free "
        "the joint, then `rtarm reference` it if it stands where `rtarm status` says, or home it.",
        "Where target and position disagree the joint is held off its target by force, or its count is wrong.",
        "Free the joint; `rtarm reference` it if it stands where it reads, home it if not.",
    ),
    Unreferenced.NOT_HOMED: Meaning(
        "{joint} has not been homed since its count lost its meaning, so its angle is not known: home it with `rtarm "
        "home`, or say where it stands with `rtarm reference`.",
        "A homing run changes what the drive's count means, at a moment that nobody else knows.",
        "Home it; or look at the joint and say its angle (`rtarm reference JOINT=DEGREES`).",
    ),
    Unreferenced.MOVED: Meaning(
        "{joint} does not stand where it stood when rtarm was ended, so it was moved by hand or its drive has lost its "
        "count: see that it stands where `rtarm status` says, then take that with `rtarm reference`, or home it.",
        "Old firmware does not tell that it has lost power, and nobody watched meanwhile.",
        "Look at the joint; `rtarm reference` it if it stands where it reads, home it if not.",
    ),
    Unreferenced.INCREMENTAL: Meaning(
        "The drive of {joint} cannot tell where it was switched on, so its angle is not known: say where it stands "
        "with `rtarm reference`, or home it where its drive can.",
        "An incremental encoder knows how far it has turned, not where it is; an absolute one knows it within its own "
        "range alone.",
        "Look at the joint and say its angle (`rtarm reference JOINT=DEGREES`), or `rtarm home` it.",
    ),
    Unreferenced.OUTSIDE_LIMITS: Meaning(
        "{joint} stands outside its limits, so its count or its zero must be wrong: home it with `rtarm home`, or say "
        "where it stands with `rtarm reference`; if it comes back, check zero_deg, direction and limits in the arm "
        "file, which is read when rtarm starts.",
        "A joint cannot stand where the arm file says it never is.",
        "Home the joint, or say its angle (`rtarm reference JOINT=DEGREES`); check zero_deg, direction and limits in "
        "the arm file, then start rtarm again.",
    ),
}

ANSWERS: dict[Answer, Meaning] = {
    Answer.NONE: Meaning("The request has not been answered yet.", "", ""),
    Answer.DONE: Meaning("Done.", "", ""),
    Answer.REFUSED_MODE: Meaning(
        "The control process cannot do this in its present mode: see `rtarm status`.",
        "One table says which change of mode is allowed.",
        "Wait for the mode in which it is possible.",
    ),
    Answer.REFUSED_NO_GOAL: Meaning(
        "No such goal is running, so there is nothing to do.",
        "A request about a goal may arrive after the goal has ended.",
        "Nothing to do.",
    ),
    Answer.REFUSED_VALUE: Meaning(
        "The value is not allowed: a speed scale lies between 0 and 1, a joint stands inside its limits, and a drive "
        "that lost power or was not homed to the end counts from nowhere.",
        "The control process believes no value that cannot be.",
        "Give a speed scale from 0 to 1, an angle inside the joint's limits, joints that the arm has.",
    ),
    Answer.REFUSED_MOVING: Meaning(
        "The arm is moving or still coming to rest: ask again when it stands.",
        "What brakes the arm is not interrupted, and an arm in motion is not let go.",
        "Ask again once nothing moves.",
    ),
    Answer.REFUSED_WIRE: Meaning(
        "The CAN adapter is not there, so the drives cannot be brought up: plug it in or set its link up, wait for the "
        "event that says it is back, then ask again.",
        "Clearing a fault speaks to every drive.",
        "Wait until the control process says that the adapter is back.",
    ),
    Answer.REFUSED_OUTDATED: Meaning(
        "It was asked for before the arm was stopped, held, let go, homed or in a fault, so it does not begin: ask "
        "again.",
        "Whoever asked did not know of that, and it would move an arm that nobody expects to move.",
        "Look where the arm stands, then ask again.",
    ),
    Answer.REFUSED_HELD: Meaning(
        "A person has stopped or holds the arm, so nothing that moves it is begun: `rtarm resume` (or ~/resume) first.",
        "What a person has stopped, only a person sets in motion again.",
        "Ask who stopped the arm and why, then resume.",
    ),
    Answer.REFUSED_UNKNOWN: Meaning(
        "The control process does not know this request: start both processes from one installation.",
        "An unknown request is refused, never guessed at.",
        "Restart both processes from one installation.",
    ),
}


GRIP_TROUBLES: dict[GripTrouble, Meaning] = {
    GripTrouble.NONE: Meaning("The gripper is in order.", "", ""),
    GripTrouble.SILENT: Meaning(
        "The gripper's drive (address {value:.0f}) does not answer: check its power, its address and the bit rate in "
        "its menu, and its CAN wires.",
        "What nobody hears of may stand anywhere.",
        "Check power, address, bit rate and wires; it is taken up again as soon as it answers.",
    ),
    GripTrouble.FIRMWARE: Meaning(
        "The gripper's drive has a firmware (version {value:.0f}) whose settings are not known here, so it is not "
        "moved: use a drive with Emm_V5 firmware 1.0.0 to 2.9.9.",
        "Other firmware reads the same command as another angle.",
        "Switch the drive to Emm firmware, or use another.",
    ),
    GripTrouble.MICROSTEPS: Meaning(
        "The gripper's drive is set to {value:.0f} microsteps, the arm file says otherwise, and angles would be wrong "
        "by that factor: change one of the two.",
        "A command counts microsteps.",
        "Change gripper.servo.microsteps, or the drive's menu.",
    ),
    GripTrouble.CHECKSUM: Meaning(
        "The gripper's drive uses checksum mode {value:.0f}, and only 0 (the constant 6B) is spoken here: set Checksum "
        "to 0x6B in its menu.",
        "The other checksums are described in contradictory ways.",
        "Set Checksum to 0x6B in the drive's menu.",
    ),
    GripTrouble.PROTECTED: Meaning(
        "The gripper's drive has tripped its protection and holds nothing: free what blocks it; the next command "
        "clears the protection.",
        "A drive that pushes for too long against something lets go by itself.",
        "Free the fingers, let the drive cool, send the next command.",
    ),
    GripTrouble.DISABLED: Meaning(
        "The gripper's drive is disabled and holds nothing: the next command enables it; if not, see the En setting in "
        "its menu.",
        "Somebody let it go, at its menu or its En input.",
        "Send the next command; look at the drive's En setting.",
    ),
    GripTrouble.POWER_LOST: Meaning(
        "The gripper's drive has lost power, so what it counts is no angle and it is not moved: clear the space "
        "between its fingers, then call the service home of its controller.",
        "A drive counts from where it stood when it was switched on.",
        "Clear the space between the fingers and home it.",
    ),
    GripTrouble.REFUSED: Meaning(
        "The gripper's drive does not take the command to go to {value:.3f} rad: look at its display for a fault.",
        "A command that was lost is repeated several times.",
        "Look at the drive's display, check the wires, send the command again.",
    ),
    GripTrouble.NOT_HOMED: Meaning(
        "The gripper's drive has not found its stop (it counts {value:.0f}): see that it can reach it and that "
        "direction, speed and collision current in its menu fit, then home it again.",
        "Without its stop nobody knows what its count means.",
        "Check the homing parameters in the drive's menu; home it again.",
    ),
    GripTrouble.OUTSIDE: Meaning(
        "The gripper reads {value:.3f} rad, far outside its range, so it is not moved: home it, or mend zero_deg, "
        "direction or ratio of gripper.servo.",
        "A command from there might turn it by whole turns.",
        "Home it; compare gripper.servo with the mechanics.",
    ),
    GripTrouble.CURRENT: Meaning(
        "The gripper's drive does not take a limit of {value:.0f} mA for its current, so it was not moved: set it in "
        "its menu, and leave gripper.servo.nm_per_ampere out.",
        "A command that names an effort must not push harder.",
        "Send the command without an effort, or leave nm_per_ampere out.",
    ),
}

NOBODY_ACKNOWLEDGES = Meaning(
    "No drive acknowledges what is sent: see that the motors have power, that all have the bus' bit rate and that it "
    "has 120 Ω at both ends.",
    "A frame that nobody acknowledges is sent again and again, and nothing behind it leaves.",
    "Switch the motors on, check bit rate, plugs and termination.",
)
STILL_QUEUED = Meaning(
    "Nobody on the bus has taken the last frames, and the system keeps them for {channel}: before the drives are "
    "switched on, take it down and up again (`sudo ip link set {channel} down`, then `… up`).",
    "Frames that are kept would reach the drives when they get power, long after they were meant.",
    "Take the interface down and up, then switch the drives on.",
)
"""At the end of a control process on SocketCAN, where the frames outlive it."""
HEALED = (
    "All drives were silent for a moment; each has kept its power and stands where it may, so the arm holds by itself "
    "and takes the next goal. Streams wait for `rtarm resume`."
)
"""Of an arm that goes on after a stall by itself."""
WIRE_IS_BACK = "The adapter is back: `rtarm clear-fault` brings the drives up again."


PHRASES = Phrases(
    modes={mode: mode.name.lower().replace("_", " ") for mode in Mode},
    unknown_mode="in unknown mode {mode}",
    unknown_status="unknown status {status}",
    unknown="Unknown {kind} {number}: start all processes from one installation.",
    no_joint="no joint",
    between=", ",
    before_last=" and ",
    each_of="each of {joints}",
    so=", so ",
    healed=HEALED,
    wire_is_back=WIRE_IS_BACK,
    of_bus="Bus {bus}: {sentence}",
    asked={Request.STOP: "Stop", Request.HOLD: "Hold", Request.RESUME: "Resume"},
    asked_by="{what} was asked for by process {process:.0f}.",
    speed_asked="Speed scale {scale:.0%} was asked for.",
    unknown_command="Unknown command {kind}",
)
