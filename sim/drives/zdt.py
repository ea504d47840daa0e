"""A ZDT Emm_V5 closed-loop stepper on CAN, from its frames to its shaft.

Written from the facts about the real drive (zdt-emm-v5.md; section numbers below are its). [inf] marks
what those facts leave open and what is assumed here; a host should not depend on it.

Modelled:
- Framing (1): extended data frames, address and packet number in the identifier, requests and replies
  split behind the function byte, checksum 6B. A packet out of order, a wrong length, argument or
  checksum, or an unknown function is answered `00 EE 6B` and changes nothing. [inf] A new first packet
  abandons an unfinished request (one `00 EE 6B`) and is itself taken.
- Standard frames, remote frames and other addresses meet silence; broadcasts are obeyed silently, but
  address 1 answers `FF 66`, and new firmware answers `15`.
- Answers (2) in all five response modes. [inf] They concern the motion and homing commands, refusals
  (`E2`) included; reads, settings and format errors are answered in every mode.
- Motion (3, 9): F3, F6, FD, FE, FF and, on new firmware, F1 and FC; the ramp of `ramp.py`; relative,
  absolute and measured-relative targets; retargeting in mid-move (`retarget="reject"` refuses it with E2
  as old firmware may); synchronous start, one buffered command a drive, the latest wins.
- Homing (4): to the single-turn zero (modes 00, 01), to a mechanical stop (02), abort, failure by
  time-out, parameters. [inf] It moves without a ramp, the place of the stop becomes zero without
  backing off, motion commands meanwhile get E2, except FE, which ends it as failed.
- Reads (5), settings (6) in flash and in volatile memory, zeroing, protection and its clearing, power
  loss, watchdog, periodic reports (one period for each kind of report).
- Stall (9.6): a blocked shaft stands while the ramp goes on; 1.8 degrees of error count as full current
  [inf], which after the stall time trips the protection, if it is on.
- Time: a request acts when its last frame has ended, and a read tells the state of that moment [inf];
  the answer is ready 0.2 to 0.4 ms later and then waits for the bus.

Assumed besides [inf]: FC obeys mode and speed of the last F1, and is refused (E2) before the first; a
speed of 0 does not move; FE and enabling make the present position the target; releasing in motion
coasts, losing 1 rpm a millisecond; `32` reads the commanded target in pulses; position readings are
rounded down to whole encoder counts; an error is the ramp minus the shaft.

Not modelled: load, inertia and belt (the shaft is the ramp, or follows it with a first-order lag),
other checksums, multi-motor `AA`, X firmware, limit switches (homing mode 03 runs until its time-out),
temperature and current (only the trip they cause, and that while they last it cannot be cleared [inf]),
the En and Dir inputs, calibration, factory reset, PID and all other settings not listed here (answered
`00 EE 6B`); the wire's bit rate never changes.

Here is its conversation on the bus; what its functions do stands in `zdt_functions.py`, what moves in
`zdt_motion.py`, what it keeps in flash in `zdt_settings.py`.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

from config.drives.zdt import ZdtDrive as ZdtConfig
from sim.bus import Frame, Outbox
from sim.drives.drive import Cause, Mounting
from sim.drives.ramp import GRAINS_PER_REVOLUTION, NEVER
from sim.drives.zdt_functions import CHECKSUM, READ_ARGUMENT, Functions
from sim.drives.zdt_motion import COMPLETE, DONE
from sim.drives.zdt_settings import CAN_CODES, Homing, Settings, homing_towards

FORMAT_ERROR = b"\x00\xee\x6b"
TRIP_FLAGS: dict[Cause, int] = {"stall": 0x00, "temperature": 0x10, "current": 0x20}
"""Bits of `3B` (section 4); a stall is told by `3A` alone."""


class ZdtDrive(Functions):
    """One drive: a node of the bus with a shaft.

    Args:
        settings: configuration in flash, the CAN address among it.
        start_ns: when it begins to exist; the first time it may be told.
        position_pulses: where its shaft stands and what it counts there.
        homed: whether it was referenced since power-up: power-lost flag cleared. Otherwise it counts
            from zero where it stands, with the flag set.
        firmware: "new" (V2.0.0) or "old" (V5.0 manual: none of the newer functions).
        retarget: whether a position command is taken in mid-move.
        enabling: what a drive that is enabled again does: hold where its shaft is, or pull it to the target of before.
        lag_s: time constant of the shaft behind the ramp [s].
        seed: of the jitter of its answers.

    Attributes:
        outbox: frames it wants to send.
        wake_ns: when it next does something that the bus could notice.
        shaft: its true motion.
        reply_delay_ns: least and greatest time from a request to its answer.
        reply_loss: share of its answers that never leave it.
        wrong_checksums: share of its answers that end in another byte.
        wrong_values: share of its position answers that are wrong, and by how many counts at most.
        refuses: whether it refuses every motion command.
        keeps_settings: whether it says that it took new settings, and keeps its own.
        stores_everything: whether what it is told for volatile memory alone outlives the power, too.
        unknown: function bytes that its firmware does not know, beside those of `firmware`.
        power_losses: how often it has lost its supply.
        power_flag: whether bit 7 of `3A` tells a loss of power ("right"), is always 0 ("absent"), is 0 after
            power-up ("unset"), or is always 1 ("stuck").
        ramp_steepness: how many times as hard as told its ramp is.
        foreign: whether its configuration block is longer, as that of another firmware [inf].
        causes: why its protection tripped, as bits of `3B` (4 over-temperature, 5 over-current; a stall has none).
        cause_lasts: whether that cause is still there, so that the protection cannot be cleared.
        count_shift: what its count reads beside what it is [counts].
        connected: whether its CAN plug is in.
        report_clock: period of its reports beside the one it was told, which its own clock makes longer or shorter.
        fast_is_relative: whether it takes each FC as an amount to go, although F1 said that targets are absolute.
        bare_report_ack: whether it acknowledges `11` without a code, as a manual says.
        listening, address: what the bus asks; see `sim.bus.Node`.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        *,
        start_ns: int = 0,
        position_pulses: int = 0,
        homed: bool = True,
        homing: Homing | None = None,
        firmware: Literal["new", "old"] = "new",
        retarget: Literal["accept", "reject"] = "accept",
        enabling: Literal["hold", "pull"] = "hold",
        lag_s: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__(
            settings or Settings(),
            homing or Homing(),
            start_ns=start_ns,
            position_pulses=position_pulses,
            homed=homed,
            firmware=firmware,
            retarget=retarget,
            enabling=enabling,
            lag_s=lag_s,
            seed=seed,
        )
        self.outbox: Outbox = deque()
        self.wake_ns = NEVER
        self.listening = True
        self.reply_delay_ns = (200_000, 400_000)
        self.reply_loss = 0.0
        self.wrong_checksums = 0.0
        self.connected = True
        self.bare_report_ack = False
        self._replied_ns = start_ns
        self._partial: tuple[int, bytearray, int] | None = None

    @classmethod
    def mounted(cls, mounting: Mounting) -> ZdtDrive:
        """The drive of a joint, with a stop at the joint's lower limit, towards which it homes."""
        joint = mounting.joint
        assert isinstance(joint.drive, ZdtConfig)
        drive = cls(
            Settings(
                address=joint.drive.address,
                microstep=joint.drive.microsteps % 256,
                can_code=CAN_CODES.get(mounting.bitrate, CAN_CODES[500_000]),
            ),
            start_ns=mounting.start_ns,
            position_pulses=round(
                joint.direction * (mounting.position_rad + joint.zero_rad) * joint.command_pulses_per_rad
            ),
            homed=mounting.homed,
            homing=homing_towards(joint.direction),
            firmware=mounting.firmware,
            retarget=mounting.retarget,
            enabling=mounting.enabling,
            lag_s=mounting.lag_s,
            seed=mounting.seed,
        )
        stop = round(mounting.turns(joint.lower_rad) * GRAINS_PER_REVOLUTION)
        if joint.direction > 0:
            drive.shaft.low = stop
        else:
            drive.shaft.high = stop
        return drive

    # -- the bus's side ------------------------------------------------------------------------------

    def receive(self, now_ns: int, frame: Frame) -> None:
        """Take a frame that ended at `now_ns` from the bus."""
        target = frame.can_id >> 8
        if not frame.extended or frame.remote or target not in (0, self.settings.address):
            return
        self.advance(now_ns)
        packet, data = frame.can_id & 0xFF, frame.data
        broadcast = target == 0
        if self._partial is not None:
            origin, gathered, expected = self._partial
            if origin == target and packet == expected and data and data[0] == gathered[0]:
                gathered += data[1:]
                length = self._request_length(gathered[0])
                if len(gathered) < length and len(data) == 8:
                    self._partial = (target, gathered, packet + 1)
                    return
                self._partial = None
                self._request(bytes(gathered), broadcast)
                return
            self._partial = None
            self._refuse_format(origin == 0)
            if packet != 0:
                return
        if packet == 0 and len(data) == 8 and self._request_length(data[0]) > 8:
            self._partial = (target, bytearray(data), 1)
        elif packet == 0:
            self._request(data, broadcast)
        else:
            self._refuse_format(broadcast)

    def sent(self, now_ns: int, frame: Frame) -> None:
        """Nothing to do: an answer that left is forgotten."""

    def wake(self, now_ns: int) -> None:
        """Do what is due at `now_ns`: finish moves, send reports."""
        self.advance(now_ns)
        for info, (due_ns, period_ns) in list(self._reports.items()):
            if due_ns <= now_ns:
                self._reports[info] = (due_ns + period_ns, period_ns)
                self._send(self._reads[info]() + bytes((CHECKSUM,)), now_ns)
        self._schedule()

    # -- what goes wrong -----------------------------------------------------------------------------

    def power_off(self, now_ns: int) -> None:
        """Lose the supply: silence, a loose shaft, and everything volatile forgotten (9.8)."""
        self.advance(now_ns)
        self.powered = self.listening = False
        self.power_losses += 1
        self.outbox.clear()
        self._partial = None
        self._buffered = None
        self._fast = None
        self._reports.clear()
        self._release()
        self._schedule()

    def power_on(self, now_ns: int) -> None:
        """Boot: flash settings, enabled, counting from zero where the shaft is, flag 7 set."""
        self.advance(now_ns)
        self.powered = True
        self.listening = self.connected
        self.settings, self.homing = self._flash, self._homing_flash
        self.address = self.settings.address
        self._single_turn_zero = self._single_turn_zero_flash
        self._hold()
        self._origin = self._ramp.position
        self.enabled, self.protected, self.power_lost = True, False, self.power_flag != "unset"
        self.causes = self.count_shift = 0
        self._homing_failed = False
        self._watchdog_ns = self._watchdog_flash_ns
        self._feed_watchdog()
        if self.homing.at_power_up:
            self._home(self.homing.mode)
        self._watch_contact()
        self._schedule()

    def unplug(self, now_ns: int) -> None:
        """Lose the CAN cable: it hears nothing, says nothing, and goes on with what it was told."""
        self.advance(now_ns)
        self.connected = self.listening = False
        self.outbox.clear()
        self._partial = None

    def plug_in(self, now_ns: int) -> None:
        """Get the CAN cable back."""
        self.advance(now_ns)
        self.connected = True
        self.listening = self.powered

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Trip the protection for a cause that stands until `cause_lasts` is False and it is cleared."""
        self.trip(now_ns, TRIP_FLAGS[cause])

    def trip(self, now_ns: int, causes: int) -> None:
        """Trip the protection, which lets the shaft go; `causes` are the bits of `3B` that then stand."""
        self.advance(now_ns)
        self.causes |= causes
        self.protected = True
        self._release()
        self._schedule()

    def disable(self, now_ns: int) -> None:
        """Be let go by somebody, not over the bus."""
        self.advance(now_ns)
        self.enabled = False
        self._release()
        self._schedule()

    # -- as others know it ---------------------------------------------------------------------------

    def owns(self, frame: Frame) -> bool:
        """Whether the frame is of its conversation with the host."""
        return frame.extended and frame.can_id >> 8 == self.settings.address

    def state_frame(self, now_ns: int) -> Frame:
        """The position it would answer at `now_ns`."""
        self.advance(now_ns)
        return Frame(self.settings.address << 8, self.position_answer())

    def twin(self, now_ns: int, seed: int) -> ZdtDrive:
        """Another drive with its address, from `now_ns` on, which counts from zero."""
        return ZdtDrive(self.settings, start_ns=now_ns, firmware="new" if self._new else "old", seed=seed)

    # -- requests and answers ------------------------------------------------------------------------

    def _request_length(self, function: int) -> int:
        if function in self.unknown:
            return 0
        if function in self._reads:
            return 3 if function in READ_ARGUMENT else 2
        command = self._commands.get(function)
        return command.length if command else 0

    def _request(self, request: bytes, broadcast: bool) -> None:
        """Carry out one complete request and answer it."""
        function = request[0] if request else 0
        command = self._commands.get(function)
        if len(request) < 2 or request[-1] != CHECKSUM or len(request) != self._request_length(function):
            self._refuse_format(broadcast)
        elif command is None:
            argument = READ_ARGUMENT.get(function)
            if argument is not None and request[1] != argument:
                self._refuse_format(broadcast)
                return
            self._feed_watchdog()
            if not broadcast or function == 0x15:
                self._reply(self._reads[function]())
        elif command.argument is not None and request[1] != command.argument:
            self._refuse_format(broadcast)
        else:
            self._feed_watchdog()
            asked = self.settings.address
            code = command.act(request[1:-1] if command.argument is None else request[2:-1])
            self._watch_contact()
            response = self.settings.response
            told = not command.motion or (response in (1, 3) or (response == 4 and not command.moves))
            if told and (not broadcast or (function == 0xFF and self.settings.address == 1)):
                bare = self.bare_report_ack and function == 0x11 and code == DONE
                self._reply(bytes((function,)) if bare else bytes((function, code)), asked)
            self._schedule()

    def _refuse_format(self, broadcast: bool) -> None:
        if not broadcast:
            self._send(FORMAT_ERROR, self._ready_ns())

    def _reply(self, body: bytes, address: int | None = None) -> None:
        self._send(body + bytes((CHECKSUM,)), self._ready_ns(), address)

    def _ready_ns(self) -> int:
        least, greatest = self.reply_delay_ns
        return self._now_ns + least + int((greatest - least) * self._random.random())

    def _send(self, message: bytes, ready_ns: int, address: int | None = None) -> None:
        """Queue a message, in several packets if it is long; the answer to a new address still bears the old one."""
        if not self.connected or (self.reply_loss and self._random.random() < self.reply_loss):
            return
        if self.wrong_checksums and self._random.random() < self.wrong_checksums:
            message = message[:-1] + bytes((self._random.choice([b for b in range(256) if b != CHECKSUM]),))
        ready_ns = self._replied_ns = max(ready_ns, self._replied_ns)
        base = (self.settings.address if address is None else address) << 8
        if len(message) <= 8:
            self.outbox.append((ready_ns, Frame(base, message)))
            return
        for packet, start in enumerate(range(1, len(message), 7)):
            part = message[:1] + message[start : start + 7]
            self.outbox.append((ready_ns, Frame(base | packet, part)))

    def _complete(self, function: int) -> None:
        self._finishing = 0
        self._reply(bytes((function, COMPLETE)))

    def _schedule(self) -> None:
        """Work out when the bus may next hear of this drive without asking."""
        if not self.powered:
            self.wake_ns = NEVER
            return
        wake_ns = min((due_ns for due_ns, _ in self._reports.values()), default=NEVER)
        if self._finishing or (self._homing_mode is not None and self.settings.response in (2, 3)):
            wake_ns = min(
                wake_ns, self._ramp.event_ns, self._contact_ns, self._found_ns, self._homing_end_ns,
                self._finish_ns,
            )  # fmt: skip
        self.wake_ns = wake_ns
