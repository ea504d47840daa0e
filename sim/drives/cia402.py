"""A servo drive with the profile CiA 402 on CANopen: its power states, cyclic synchronous and profile position.

Facts: CiA 402 (IEC 61800-7-201), states and transitions, objects 6xxx. What a maker may choose is chosen so that a host
that is careless is found out [inf]: the power stage fails when the node leaves operation (6007 is 1), a quick stop lets
go at its end (605A is 2), targets that do not move with the shaft are jumped to, and other PDOs are on by default.

Not modelled: other modes, homing, ramps of shutdown and halt of their own, limits of position in the drive.
"""

from __future__ import annotations

from collections.abc import Iterable

from config.drives.cia402 import Cia402Drive as Cia402Config
from sim.bus import Frame
from sim.drives.canopen import GENERIC_ERROR, NO_ERROR, OPERATIONAL, TPDO, WRONG_VALUE, CanopenNode, Entry
from sim.drives.drive import Cause, Mounting
from sim.drives.servo import TURN_RAD, Interpolation, Limp, Load, Plan, Spin

NOT_READY, SWITCH_ON_DISABLED, READY, SWITCHED_ON = 0x00, 0x40, 0x21, 0x23
OPERATION_ENABLED, QUICK_STOP, FAULT = 0x27, 0x07, 0x08
"""States, as the statusword tells them; the reaction to a fault takes no time."""
VOLTAGE, REMOTE, REACHED, MODE_BIT = 1 << 4, 1 << 9, 1 << 10, 1 << 12
"""Other bits of it; MODE_BIT is a target taken (profile position) or followed (CSP)."""
NEW_TARGET, RELATIVE, FAULT_RESET, HALT = 1 << 4, 1 << 6, 1 << 7, 1 << 8
"""Bits of the controlword."""

PROFILE_POSITION, CSP = 1, 8
MODES = 1 << 0 | 1 << 7
STAYS_STOPPED = (5, 6, 7, 8)
"""Quick stop option codes (605A) with which the drive goes on holding."""
CODES: dict[Cause, int] = {"stall": 0x7121, "temperature": 0x4310, "current": 0x2310}
TOO_FAR, CONNECTION_LOST = 0x8611, 0x8100

NAME = b"rtarm simulated CiA 402 servo drive"
COUNTS = 131_072
FOLLOWING_TURNS = 0.25
"""Following error at which it fails [inf]."""
QUICK_STOP_S = 0.05
"""Time from its highest speed to rest in a quick stop [inf]."""
HEADROOM = 1.5
"""Of its profile velocity over the joint's highest [inf]."""


class Cia402Drive(CanopenNode):
    """One drive.

    Args:
        node: its number, 1 to 127.
        counts: of its position for one turn.
        absolute: whether its encoder knows its angle when power comes.
        top: highest speed of its motor [rev/s].
        rated_nm: rated torque of the motor.
        start_ns, turns, counted, load, seed: see `ServoDrive`.

    Attributes:
        power: the state of its power stage, as the statusword tells it.
    """

    def __init__(
        self,
        node: int,
        *,
        counts: int = COUNTS,
        absolute: bool = False,
        top: float = 10.0,
        rated_nm: float | None = None,
        start_ns: int = 0,
        turns: float = 0.0,
        counted: float | None = None,
        load: Load | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(node, start_ns=start_ns, turns=turns, counted=counted, load=load, seed=seed)
        self.counts = counts
        self.absolute = absolute
        self.top = top
        self.rated_nm = rated_nm or self.shaft.load.torque_nm
        self.power = SWITCH_ON_DISABLED
        self._begin()

    @classmethod
    def mounted(cls, mounting: Mounting) -> Cia402Drive:
        """The drive of a joint."""
        joint = mounting.joint
        config = joint.drive
        assert isinstance(config, Cia402Config)
        absolute = config.encoder == "absolute"
        turns = mounting.turns(mounting.position_rad)
        return cls(
            config.node_id,
            counts=config.counts_per_revolution,
            absolute=absolute,
            top=HEADROOM * joint.motor_rpm / 60.0,
            rated_nm=config.rated_torque_nm,
            start_ns=mounting.start_ns,
            turns=turns,
            counted=turns if mounting.homed or absolute else 0.0,
            load=mounting.load,
            seed=mounting.seed,
        )

    # -- as others know it ---------------------------------------------------------------------------

    def state_frame(self, now_ns: int) -> Frame:
        """Statusword and position, as it would tell them at `now_ns`."""
        self.advance(now_ns)
        data = self.objects[0x6041, 0].data() + self.objects[0x6064, 0].data()
        return Frame(TPDO[0] + self.node, data, extended=False)

    def twin(self, now_ns: int, seed: int) -> Cia402Drive:
        """Another drive with its number, from `now_ns` on, which counts from zero."""
        return Cia402Drive(self.node, counts=self.counts, start_ns=now_ns, seed=seed)

    # -- what happens to it --------------------------------------------------------------------------

    def boot(self) -> None:
        """Boot, with everything volatile forgotten; an incremental encoder begins to count."""
        if not self.absolute:
            self.origin += self.counted
        self.reset()
        if self.arms_itself:
            self._go(OPERATION_ENABLED)

    def reset(self) -> None:
        """Begin anew, in a node that boots."""
        self._begin()
        self.begin_booting()

    def _begin(self) -> None:
        self.objects = self._profile_objects()
        self.add_communication_objects(NAME)
        self._go(SWITCH_ON_DISABLED)

    def release(self) -> None:
        """Its enabling input goes, or safe torque off comes."""
        if self.power != FAULT:
            self._go(SWITCH_ON_DISABLED)

    def protect(self, now_ns: int, cause: Cause) -> None:
        """Fail: motor blocked, drive too hot, or too much current."""
        self.advance(now_ns)
        self._fail(CODES[cause])

    def disconnect(self) -> None:
        """Do what the abort connection option code (6007) says."""
        if self.power not in (OPERATION_ENABLED, QUICK_STOP):
            return
        match self.number(0x6007):
            case 1:
                self._fail(CONNECTION_LOST)
            case 2:
                self._go(SWITCH_ON_DISABLED)
            case 3:
                self._stop_quickly()

    def _fail(self, code: int) -> None:
        self.objects[0x603F, 0].value = code
        self.emergency(code, GENERIC_ERROR)
        self._go(FAULT)

    # -- objects -------------------------------------------------------------------------------------

    def _profile_objects(self) -> dict[tuple[int, int], Entry]:
        speed = round(self.top * self.counts)
        ramp = round(self.top / QUICK_STOP_S * self.counts)
        return {
            (0x6007, 0): Entry(1, 2, signed=True, writable=True),
            (0x603F, 0): Entry(0, 2, mappable=True),
            (0x6040, 0): Entry(0, 2, writable=True, mappable=True, write=self._obey),
            (0x6041, 0): Entry(size=2, mappable=True, read=self._statusword),
            (0x605A, 0): Entry(2, 2, signed=True, writable=True),
            (0x6060, 0): Entry(0, 1, signed=True, writable=True, mappable=True, write=self._choose_mode),
            (0x6061, 0): Entry(size=1, signed=True, mappable=True, read=lambda: self.number(0x6060)),
            (0x6064, 0): Entry(size=4, signed=True, mappable=True, read=self._position),
            (0x6065, 0): Entry(round(FOLLOWING_TURNS * self.counts), writable=True),
            (0x606C, 0): Entry(size=4, signed=True, mappable=True, read=lambda: round(self.shaft.speed * self.counts)),
            (0x6076, 0): Entry(round(self.rated_nm * 1e3), writable=True),
            (0x6079, 0): Entry(read=lambda: round(self.supply_v * 1e3)),
            (0x607D, 0): Entry(2, 1),
            (0x607D, 1): Entry(-(1 << 31), signed=True, writable=True),
            (0x607D, 2): Entry((1 << 31) - 1, signed=True, writable=True),
            (0x6080, 0): Entry(round(self.top * 60.0), writable=True),
            (0x6091, 0): Entry(2, 1),
            (0x6091, 1): Entry(1, writable=True),
            (0x6091, 2): Entry(1, writable=True),
            (0x6092, 0): Entry(2, 1),
            (0x6092, 1): Entry(self.counts, writable=True),
            (0x6092, 2): Entry(1, writable=True),
            (0x6077, 0): Entry(size=2, signed=True, mappable=True, read=self._torque),
            (0x607A, 0): Entry(0, 4, signed=True, writable=True, mappable=True, write=self._aim),
            (0x6081, 0): Entry(speed, writable=True, mappable=True),
            (0x6083, 0): Entry(ramp, writable=True, mappable=True),
            (0x6084, 0): Entry(ramp, writable=True, mappable=True),
            (0x6085, 0): Entry(ramp, writable=True, mappable=True),
            (0x60C2, 0): Entry(2, 1),
            (0x60C2, 1): Entry(1, 1, writable=True),
            (0x60C2, 2): Entry(-3, 1, signed=True, writable=True, write=self._choose_power),
            (0x60F4, 0): Entry(size=4, signed=True, mappable=True, read=self._error),
            (0x6502, 0): Entry(MODES),
        }

    @property
    def in_use(self) -> bool:
        """Whether it holds its shaft."""
        return self.enabled

    def stored(self) -> Iterable[tuple[int, int]]:
        """Those that its owner sets."""
        return ((0x6007, 0), (0x605A, 0), (0x6065, 0), (0x607D, 1), (0x607D, 2), (0x6080, 0))

    def default_pdos(self) -> tuple[Iterable[tuple[int, ...]], Iterable[tuple[int, ...]]]:
        """Controlword and statusword, alone and with modes, targets and values: CiA 402's first three, and none."""
        control, status = 0x6040_0010, 0x6041_0010
        return (
            ((control,), (control, 0x6060_0008), (control, 0x607A_0020), ()),
            ((status,), (status, 0x6061_0008), (status, 0x6064_0020), ()),
        )

    def _position(self) -> int:
        return round(self.counted * self.counts)

    def _torque(self) -> int:
        """In thousandths of the rated torque."""
        return max(-32_768, min(32_767, round(self.shaft.torque_nm / self.rated_nm * 1e3)))

    def _error(self) -> int:
        """From where it should be to where it is."""
        if not isinstance(self.shaft.law, Interpolation):
            return 0
        return round((self.shaft.law.line(self._now_ns)[0] - self.origin) * self.counts) - self._position()

    def _statusword(self) -> int:
        word = self.power | VOLTAGE
        if self.state == OPERATIONAL:
            word |= REMOTE
        law, mode = self.shaft.law, self.number(0x6060)
        follows = mode == CSP and self.power == OPERATION_ENABLED
        took = mode == PROFILE_POSITION and self.number(0x6040) & NEW_TARGET
        if follows or took:
            word |= MODE_BIT
        if self.shaft.speed == 0.0 and (isinstance(law, Spin) or (isinstance(law, Plan) and law.rests)):
            word |= REACHED
        return word

    def _choose_mode(self, mode: int) -> int:
        if mode not in (0, PROFILE_POSITION, CSP):
            return WRONG_VALUE
        if mode != self.number(0x6060):
            self.objects[0x6060, 0].value = mode
            if self.power == OPERATION_ENABLED:
                self._hold()
        return 0

    def _choose_power(self, power: int) -> int:
        return 0 if -6 <= power <= 0 else WRONG_VALUE

    # -- power states --------------------------------------------------------------------------------

    def _obey(self, word: int) -> int:
        """A controlword: the transitions of CiA 402, then what its mode's bits say."""
        before, self.objects[0x6040, 0].value = self.number(0x6040), word
        rises = word & ~before
        if self.power == FAULT:
            if rises & FAULT_RESET and not self.cause_lasts:
                self.objects[0x603F, 0].value = 0
                self.emergency(NO_ERROR, 0)
                self._go(SWITCH_ON_DISABLED)
            return 0
        self._change_power(word)
        if self.power == OPERATION_ENABLED and self.number(0x6060) == PROFILE_POSITION:
            self._go_to_target(word, rises)
        return 0

    def _change_power(self, word: int) -> None:
        power = self.power
        on = power in (SWITCHED_ON, OPERATION_ENABLED)
        if not word & 0x02:  # disable voltage
            if power != NOT_READY:
                self._go(SWITCH_ON_DISABLED)
        elif not word & 0x04:  # quick stop
            if power == OPERATION_ENABLED:
                self._stop_quickly()
            elif power in (READY, SWITCHED_ON):
                self._go(SWITCH_ON_DISABLED)
        elif not word & 0x01:  # shut down
            if on or power == SWITCH_ON_DISABLED:
                self._go(READY)
        elif not word & 0x08:  # switch on, or disable operation
            if on or power == READY:
                self._go(SWITCHED_ON)
        elif power in (READY, SWITCHED_ON) or (power == QUICK_STOP and self.number(0x605A) in STAYS_STOPPED):
            self._go(OPERATION_ENABLED)

    def _go(self, power: int) -> None:
        """Be in a state of the power stage."""
        changed = power != self.power
        self.power = power
        self.enabled = power in (OPERATION_ENABLED, QUICK_STOP)
        self.cancel("quick stop")
        if power == OPERATION_ENABLED:
            if changed:
                self._hold()
        elif power != QUICK_STOP:
            self.shaft.obey(Limp())
        if changed:
            self.tell_change()

    def _stop_quickly(self) -> None:
        self._go(QUICK_STOP)
        ramp = max(self.number(0x6085), 1) / self.counts
        self.shaft.obey(Spin(0.0, ramp))
        if self.number(0x605A) not in STAYS_STOPPED:
            takes_ns = round(abs(self.shaft.speed) / ramp * 1e9) + 1_000_000
            self.after("quick stop", takes_ns, lambda: self._go(SWITCH_ON_DISABLED))

    # -- motion --------------------------------------------------------------------------------------

    def _hold(self) -> None:
        """Begin to hold in the mode that is set: in CSP at the target, wherever that is."""
        here = self.shaft.position_at(self._now_ns)
        if self.number(0x6060) == CSP:
            load = self.shaft.load
            self.shaft.obey(Interpolation(here, load.torque_nm / load.inertia_kg_m2 / TURN_RAD))
            self._aim(self.number(0x607A))
        else:
            self._plan(here)

    def _aim(self, target: int) -> int:
        """A target has come."""
        law = self.shaft.law
        if self.power == OPERATION_ENABLED and isinstance(law, Interpolation):
            law.aim(self._now_ns, self.origin + target / self.counts, self._beat_ns())
            self.shaft.obey(law)
            if abs(self._error()) > self.number(0x6065):
                self._fail(TOO_FAR)
        return 0

    def _beat_ns(self) -> int:
        return max(round(self.number(0x60C2, 1) * 10.0 ** self.number(0x60C2, 2) * 1e9), 1)

    def _go_to_target(self, word: int, rises: int) -> None:
        """Profile position: bit 4 takes a target, bit 8 halts."""
        law = self.shaft.law
        if word & HALT:
            self.shaft.obey(Spin(0.0, max(self.number(0x6084), 1) / self.counts))
        elif rises & NEW_TARGET:
            target = self.number(0x607A) / self.counts
            start = self.shaft.position_at(self._now_ns) if word & RELATIVE else self.origin
            self._plan(start + target)
        elif isinstance(law, Spin):
            self._plan(self.shaft.position_at(self._now_ns))

    def _plan(self, target: float) -> None:
        top, up, down = (max(self.number(index), 1) / self.counts for index in (0x6081, 0x6083, 0x6084))
        self.shaft.obey(Plan(target, top, up, down))
