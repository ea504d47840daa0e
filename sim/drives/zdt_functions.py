"""What the function bytes of a ZDT Emm_V5 read and do, without the frames that carry them.

The model is described in `sim.drives.zdt`; section numbers are those of zdt-emm-v5.md.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from sim.drives.ramp import GRAINS_PER_REVOLUTION
from sim.drives.zdt_motion import COUNTS_PER_REVOLUTION, DONE, REFUSED, Motion
from sim.drives.zdt_settings import Homing, Settings

CHECKSUM = 0x6B
PULL_RPM = 300
"""At which a drive that pulls does, at once: nobody has measured it."""
SUPPLY_MV = 12_000
SUPPLY_MA = 200
TEMPERATURE_C = 25
TRIP_C, TRIP_MA, TRIP_MS = 100, 6600, 1000
"""Heat and current that would trip it; read as they are written (`D3 56`) [inf], which is not modelled."""

READ_ARGUMENT = {0x43: 0x7A, 0x42: 0x6C}
"""The fixed second byte of the reads that have one."""

_POSITION = struct.Struct(">BHBIBB")
_VELOCITY = struct.Struct(">BHBB")
_FAST = struct.Struct(">HBBB")
_NEW_READS = frozenset((0x13, 0x26, 0x39, 0x3C, 0x15, 0x16))
_NEW_COMMANDS = frozenset((0xF1, 0xFC, 0x50, 0x68, 0x11))


@dataclass(frozen=True)
class Command:
    """How a command looks and what it does.

    Attributes:
        length: of the whole request, function byte to checksum.
        argument: fixed second byte, None where there is none.
        act: called with the bytes between that and the checksum, returns the code of the answer.
        motion: whether the response mode governs its answer.
        moves: whether it is a position move in the sense of response mode 4.
    """

    length: int
    argument: int | None
    act: Callable[[bytes], int]
    motion: bool = False
    moves: bool = False


class Functions(Motion):
    """The functions of one drive by their byte: each command and each read is a method."""

    # -- commands: each takes its arguments and returns the code of its answer -----------------------

    def _now_or_synced(self, sync: int, action: Callable[[], int]) -> int:
        if sync > 1:
            return REFUSED
        if sync:
            self._buffered = action
            return DONE
        return action()

    def _do_enable(self, arguments: bytes) -> int:
        enable, sync = arguments
        if enable > 1:
            return REFUSED

        def action() -> int:
            if not enable:
                if self.enabled:
                    self._left = self._target
                self.enabled = False
                self._release()
            elif not self.enabled:
                self.enabled = True
                self._hold()
                if self._pulls and self._left is not None:
                    self._ramp.seek(self._left, PULL_RPM, 0)
            return DONE

        return self._now_or_synced(sync, action)

    def _do_velocity(self, arguments: bytes) -> int:
        direction, rpm, acc, sync = _VELOCITY.unpack(arguments)
        if direction > 1 or not self._able:
            return REFUSED
        signed = min(rpm, self._max_rpm) * (-1 if direction else 1)
        return self._now_or_synced(sync, lambda: self._run(signed, acc))

    def _do_position(self, arguments: bytes) -> int:
        direction, rpm, acc, pulses, mode, sync = _POSITION.unpack(arguments)
        if direction > 1 or mode > (2 if self._new else 1) or not self._able:
            return REFUSED
        offset = self._grains(-pulses if direction else pulses)
        if sync:
            return self._now_or_synced(sync, lambda: self._move(0xFD, offset, mode, rpm, acc))
        return self._move(0xFD, offset, mode, rpm, acc)

    def _do_fast_setup(self, arguments: bytes) -> int:
        rpm, acc, mode, sync = _FAST.unpack(arguments)
        if mode > 2:
            return REFUSED

        def action() -> int:
            self._fast = (rpm, acc, mode)
            return DONE

        return self._now_or_synced(sync, action)

    def _do_fast_position(self, arguments: bytes) -> int:
        if self._fast is None:
            return REFUSED
        rpm, acc, mode = self._fast
        if self.fast_is_relative and mode == 1:
            mode = 0
        return self._move(0xFC, self._grains(int.from_bytes(arguments, "big", signed=True)), mode, rpm, acc)

    def _do_stop(self, arguments: bytes) -> int:
        def action() -> int:
            if self.powered and self.enabled and not self.protected:
                failed = self.homing_now
                self._hold()
                self._homing_failed |= failed
            return DONE

        return self._now_or_synced(arguments[0], action)

    def _do_trigger(self, _: bytes) -> int:
        action, self._buffered = self._buffered, None
        if action is not None:
            action()
        return DONE

    def _do_set_single_turn_zero(self, arguments: bytes) -> int:
        self._single_turn_zero = self._ramp.position % GRAINS_PER_REVOLUTION
        if arguments[0]:
            self._single_turn_zero_flash = self._single_turn_zero
        return DONE

    def _do_home(self, arguments: bytes) -> int:
        mode, sync = arguments
        if mode > 3 or not self._able:
            return REFUSED
        return self._now_or_synced(sync, lambda: self._home(mode))

    def _do_abort_homing(self, _: bytes) -> int:
        if not self.homing_now:
            return REFUSED
        self._hold()
        return DONE

    def _do_write_homing(self, arguments: bytes) -> int:
        homing = Homing.unpack(arguments[1:])
        if homing.mode > 3 or homing.direction > 1 or homing.at_power_up > 1:
            return REFUSED
        self.homing = homing
        if arguments[0] or self.stores_everything:
            self._homing_flash = homing
        return DONE

    def _do_zero(self, _: bytes) -> int:
        self._hold()
        self._origin = self._ramp.position
        return DONE

    def _do_clear_protection(self, _: bytes) -> int:
        if not self.protected or self.cause_lasts:
            return REFUSED
        self.protected = False
        self.causes = 0
        self._hold()
        return DONE

    def _do_clear_power_lost(self, _: bytes) -> int:
        self.power_lost = False
        return DONE

    def _do_write_settings(self, arguments: bytes) -> int:
        """The address and screen bytes are sent as 0 and stay what they are (6)."""
        new = Settings.unpack(arguments[1:])
        return self._store(arguments[0], replace(new, address=0, screen_off=0))

    def _do_microstep(self, arguments: bytes) -> int:
        return self._store(arguments[0], replace(self.settings, microstep=arguments[1]))

    def _do_address(self, arguments: bytes) -> int:
        store, address = arguments
        if address == 0:
            return REFUSED
        self.settings = replace(self.settings, address=address)
        self.address = address
        if store:
            self._flash = replace(self._flash, address=address)
        return DONE

    def _do_open_current(self, arguments: bytes) -> int:
        current_ma = int.from_bytes(arguments[1:], "big")
        return self._store(arguments[0], replace(self.settings, open_loop_ma=current_ma))

    def _do_closed_current(self, arguments: bytes) -> int:
        current_ma = int.from_bytes(arguments[1:], "big")
        return self._store(arguments[0], replace(self.settings, closed_loop_ma=current_ma))

    def _do_loop_mode(self, arguments: bytes) -> int:
        return DONE if arguments[1] in ((0, 1) if self._new else (1, 2)) else REFUSED

    def _store(self, store: int, new: Settings) -> int:
        if not new.valid:
            return REFUSED
        if self.keeps_settings:
            return DONE
        self.settings = replace(new, address=self.settings.address, screen_off=self.settings.screen_off)
        if store or self.stores_everything:
            self._flash = self.settings
        return DONE

    def _do_watchdog(self, arguments: bytes) -> int:
        self._watchdog_ns = int.from_bytes(arguments[1:], "big") * 1_000_000
        if arguments[0]:
            self._watchdog_flash_ns = self._watchdog_ns
        self._feed_watchdog()
        return DONE

    def _do_report(self, arguments: bytes) -> int:
        info = arguments[0]
        period_ns = round(int.from_bytes(arguments[1:], "big") * 1_000_000 * self.report_clock)
        if info not in self._reads or info in READ_ARGUMENT:
            return REFUSED
        self._reports.pop(info, None)
        if period_ns:
            self._reports[info] = (self._now_ns + period_ns, period_ns)
        return DONE

    # -- reads: each returns its answer without the checksum -----------------------------------------

    def _signed(self, function: int, value: int, size: int) -> bytes:
        magnitude = min(abs(value), (1 << 8 * size) - 1)
        return bytes((function, value < 0)) + magnitude.to_bytes(size, "big")

    def _speed(self) -> int:
        return round(self.shaft.speed_at(self._now_ns))

    def _current_ma(self) -> int:
        return self.settings.closed_loop_ma if self._stalled else 627

    def _encoder(self) -> int:
        return self._counts(self.shaft.position_at(self._now_ns)) % COUNTS_PER_REVOLUTION

    def position_answer(self) -> bytes:
        """What it would now answer to `36 6B`."""
        return self._signed(0x36, self.position_counts, 4) + bytes((CHECKSUM,))

    def _read_position(self) -> bytes:
        share, most = self.wrong_values
        wrong = round(self._random.uniform(-most, most)) if share and self._random.random() < share else 0
        return self._signed(0x36, self.position_counts + wrong, 4)

    def _read_version(self) -> bytes:
        return struct.pack(">BHH", 0x1F, 200, 111) if self._new else b"\x1f\x7d\x6f"

    def _read_settings(self) -> bytes:
        if self.foreign:
            return b"\x42\x25\x18" + self.settings.pack() + bytes(4)
        return b"\x42\x21\x15" + self.settings.pack()

    def _read_pid(self) -> bytes:
        return struct.pack(">BIII", 0x21, *((18000, 10, 18000) if self._new else (62000, 100, 62000)))

    def _read_everything(self) -> bytes:
        return (
            b"\x43\x1f\x09"
            + struct.pack(">HHH", SUPPLY_MV, self._current_ma(), self._encoder())
            + self._signed(0, self.target_counts, 4)[1:]
            + self._signed(0, self._speed(), 2)[1:]
            + self._signed(0, self.position_counts, 4)[1:]
            + self._signed(0, self._counts(self._error), 4)[1:]
            + bytes((self.homing_byte, self.status_byte))
        )

    def _pulses(self) -> int:
        per_revolution = self.settings.pulses_per_revolution
        grains = self._target - self._origin
        return (2 * grains * per_revolution + GRAINS_PER_REVOLUTION) // (2 * GRAINS_PER_REVOLUTION)

    # -- both, by their function byte ----------------------------------------------------------------

    @cached_property
    def _reads(self) -> dict[int, Callable[[], bytes]]:
        """The reads this drive knows."""
        reads: dict[int, Callable[[], bytes]] = {
            0x1F: self._read_version,
            0x13: lambda: struct.pack(">BHHH", 0x13, TRIP_C, TRIP_MA, TRIP_MS),
            0x20: lambda: struct.pack(">BHH", 0x20, 1146, 3368),
            0x21: self._read_pid,
            0x22: lambda: b"\x22" + self.homing.pack(),
            0x24: lambda: struct.pack(">BH", 0x24, SUPPLY_MV),
            0x26: lambda: struct.pack(">BH", 0x26, SUPPLY_MA),
            0x27: lambda: struct.pack(">BH", 0x27, self._current_ma()),
            0x31: lambda: struct.pack(">BH", 0x31, self._encoder()),
            0x32: lambda: self._signed(0x32, self._pulses(), 4),
            0x33: lambda: self._signed(0x33, self.target_counts, 4),
            0x34: lambda: self._signed(0x34, self._counts(self._ramp.position - self._origin), 4),
            0x35: lambda: self._signed(0x35, self._speed(), 2),
            0x36: self._read_position,
            0x37: lambda: self._signed(0x37, self._counts(self._error), 4),
            0x39: lambda: bytes((0x39, 1, TEMPERATURE_C)),
            0x3A: lambda: bytes((0x3A, self.status_byte)),
            0x3B: lambda: bytes((0x3B, self.homing_byte)),
            0x3C: lambda: bytes((0x3C, self.homing_byte, self.status_byte)),
            0x15: lambda: bytes((0x15, self.settings.address)),
            0x16: lambda: struct.pack(">BI", 0x16, self._watchdog_ns // 1_000_000),
            0x42: self._read_settings,
            0x43: self._read_everything,
        }
        return {function: read for function, read in reads.items() if self._new or function not in _NEW_READS}

    @cached_property
    def _commands(self) -> dict[int, Command]:
        """The commands this drive knows."""
        commands = {
            0xF3: Command(5, 0xAB, self._do_enable, motion=True),
            0xF6: Command(7, None, self._do_velocity, motion=True),
            0xFD: Command(12, None, self._do_position, motion=True, moves=True),
            0xF1: Command(7, None, self._do_fast_setup, motion=True),
            0xFC: Command(6, None, self._do_fast_position, motion=True, moves=True),
            0xFE: Command(4, 0x98, self._do_stop, motion=True),
            0xFF: Command(3, 0x66, self._do_trigger, motion=True),
            0x93: Command(4, 0x88, self._do_set_single_turn_zero),
            0x9A: Command(4, None, self._do_home, motion=True),
            0x9C: Command(3, 0x48, self._do_abort_homing, motion=True),
            0x4C: Command(19, 0xAE, self._do_write_homing),
            0x0A: Command(3, 0x6D, self._do_zero),
            0x0E: Command(3, 0x52, self._do_clear_protection),
            0x50: Command(3, 0x00, self._do_clear_power_lost),
            0x48: Command(32, 0xD1, self._do_write_settings),
            0x84: Command(5, 0x8A, self._do_microstep),
            0xAE: Command(5, 0x4B, self._do_address),
            0x44: Command(6, 0x33, self._do_open_current),
            0x45: Command(6, 0x66, self._do_closed_current),
            0x46: Command(5, 0x69, self._do_loop_mode),
            0x68: Command(8, 0x38, self._do_watchdog),
            0x11: Command(6, 0x18, self._do_report),
        }
        return {function: act for function, act in commands.items() if self._new or function not in _NEW_COMMANDS}
