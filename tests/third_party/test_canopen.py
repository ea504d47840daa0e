"""canopen 2.4.1, somebody else's CANopen library: its masters and our simulated drives, our dialogues and its nodes.

Its remote node and its CiA 402 profile run unchanged, in real time, on python-can's virtual bus. Where the library
simulates (its local node: object dictionary and SDO server), our own dialogues talk to that, byte by byte.
"""

import struct
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any

import can
import canopen
import pytest
from canopen.objectdictionary import ODRecord, ODVariable, datatypes
from canopen.profiles.p402 import BaseNode402
from third_party.conftest import on_python_can
from waiting import until

from rtloop.drives import cia402_protocol, pdo, sdo
from rtloop.service.port import Frame
from sim.faults import Protection

NODE = 2
PATIENCE_S = 10.0
COUNTS = 131_072
RAD = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
U8, U16, U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
I8, I16, I32 = datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32
VARIABLES = (
    (0x1000, "device type", U32, "ro"),
    (0x1001, "error register", U8, "ro"),
    (0x1008, "device name", datatypes.VISIBLE_STRING, "ro"),
    (0x1017, "heartbeat", U16, "rw"),
    (0x6007, "abort connection", I16, "rw"),
    (0x603F, "error code", U16, "ro"),
    (0x6040, "controlword", U16, "rw"),
    (0x6041, "statusword", U16, "ro"),
    (0x6060, "mode", I8, "rw"),
    (0x6061, "mode shown", I8, "ro"),
    (0x6064, "position", I32, "ro"),
    (0x6077, "torque", I16, "ro"),
    (0x607A, "target", I32, "rw"),
    (0x6081, "profile velocity", U32, "rw"),
    (0x6502, "modes", U32, "ro"),
)
"""From the tables of CiA 301 and CiA 402, not from our simulated drive."""


def variable(index: int, sub: int, name: str, kind: int, access: str = "rw") -> ODVariable:
    found = ODVariable(name, index, sub)
    found.data_type, found.access_type, found.pdo_mappable = kind, access, True
    return found


def dictionary() -> canopen.ObjectDictionary:
    """What an EDS file of a CiA 402 drive would say."""
    od = canopen.ObjectDictionary()
    for index, name, kind, access in VARIABLES:
        od.add_object(variable(index, 0, name, kind, access))
    for base in (0x1400, 0x1800):
        for number in range(4):
            communication = ODRecord(f"pdo {base + number:x}", base + number)
            for sub, kind in ((0, U8), (1, U32), (2, U8)):
                communication.add_member(variable(base + number, sub, f"part {sub}", kind))
            od.add_object(communication)
            mapping = ODRecord(f"map {base + number:x}", base + number + 0x200)
            mapping.add_member(variable(base + number + 0x200, 0, "count", U8))
            for sub in range(1, 9):
                mapping.add_member(variable(base + number + 0x200, sub, f"object {sub}", U32))
            od.add_object(mapping)
    time_record = ODRecord("interpolation time", 0x60C2)
    for sub, kind in ((0, U8), (1, U8), (2, I8)):
        time_record.add_member(variable(0x60C2, sub, f"part {sub}", kind))
    od.add_object(time_record)
    return od


@pytest.fixture
def connect(live: Callable[..., can.BusABC]) -> Iterator[Callable[..., BaseNode402]]:
    """Opens the library's network on simulated drives (options as `sim.arm.SimulatedArm`) and gives its node 2."""
    networks = []

    def open_network(**options: Any) -> BaseNode402:
        network = canopen.Network(live(on_python_can("cia402_6"), joint_position_rad=RAD, **options))
        network.NOTIFIER_CYCLE = 0.02
        network.connect()
        networks.append(network)
        node = BaseNode402(NODE, dictionary())
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
        for patience in ("RESET_FAULT", "SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE"):
            setattr(node, f"TIMEOUT_{patience}", PATIENCE_S if patience != "RESET_FAULT" else 0.1)
        return node

    yield open_network
    for network in networks:
        network.notifier.stop()


@pytest.fixture
def node(connect: Callable[..., BaseNode402]) -> BaseNode402:
    return connect()


def position(node: BaseNode402) -> int:
    return int(node.sdo[0x6064].raw)


# --- their master, our drives ---------------------------------------------------------------------------------


def test_it_reads_and_writes_objects(node: BaseNode402) -> None:
    assert node.sdo[0x1000].raw == 0x0002_0192
    assert node.sdo[0x1008].raw == "rtarm simulated CiA 402 servo drive", "a segmented upload"
    node.sdo[0x6081].raw = 123_456
    assert node.sdo[0x6081].raw == 123_456
    with node.sdo.open(0x6081, 0, "wb", size=4, force_segment=True) as segmented:
        segmented.write(struct.pack("<I", 654_321))
    assert node.sdo[0x6081].raw == 654_321, "a segmented download"
    joint = on_python_can("cia402_6").joints[1]
    turns = joint.ratio * (RAD[1] + joint.zero_rad) / 6.283185307179586
    assert position(node) == pytest.approx(turns * COUNTS, abs=1)


@pytest.mark.parametrize(
    ("ask", "code"),
    [
        (lambda sdo: sdo.upload(0x2000, 0), 0x0602_0000),
        (lambda sdo: sdo.upload(0x60C2, 3), 0x0609_0011),
        (lambda sdo: sdo.download(0x1000, 0, bytes(4)), 0x0601_0002),
        (lambda sdo: sdo.download(0x6040, 0, bytes(4)), 0x0607_0012),
        (lambda sdo: sdo.download(0x6040, 0, bytes(1)), 0x0607_0013),
        (lambda sdo: sdo.download(0x6060, 0, b"\x05"), 0x0609_0030),
        (lambda sdo: sdo.download(0x1600, 0, b"\0"), 0x0800_0022),
    ],
)
def test_it_hears_why_something_is_refused(node: BaseNode402, ask: Callable[[Any], object], code: int) -> None:
    with pytest.raises(canopen.SdoAbortedError) as refused:
        ask(node.sdo)
    assert refused.value.code == code
    assert f"{code:08X}" in sdo.abort_words(code) and "a reason of its own" not in sdo.abort_words(code)


def test_it_leads_a_node_through_its_states(node: BaseNode402) -> None:
    node.sdo[0x1017].raw = 20
    for state in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
        node.nmt.state = state
        until(lambda state=state: node.nmt.wait_for_heartbeat(PATIENCE_S) == state)
    node.nmt.state = "RESET"
    node.nmt.wait_for_bootup(PATIENCE_S)
    assert node.sdo[0x1017].raw == 0, "volatile"


def map_pdos(node: BaseNode402) -> None:
    """The library maps what rtarm maps."""
    node.tpdo.read()
    node.rpdo.read()
    for found, objects in ((node.tpdo, (0x6041, 0x6064)), (node.rpdo, (0x6040, 0x607A))):
        for number in range(1, 5):
            found[number].enabled = number == 1
        found[1].clear()
        for index in objects:
            found[1].add_variable(index)
        found[1].trans_type = 1
        found.save()


def test_it_maps_process_data_and_hears_them_with_each_sync(node: BaseNode402) -> None:
    map_pdos(node)
    fits = [
        pdo.fits(sdo.Node(1, on_python_can("cia402_6").joints[1]), *wanted)
        for wanted in (
            (pdo.RECEIVED, 0x202, cia402_protocol.RPDO1_OBJECTS),
            (pdo.TOLD, 0x182, cia402_protocol.TPDO1_OBJECTS),
        )
    ]
    assert [play(part, asked_through(node.network.bus)) for part in fits] == [True, True], "as we would have it"
    node.nmt.state = "OPERATIONAL"
    node.network.sync.transmit()
    assert node.tpdo[1].wait_for_reception(PATIENCE_S) is not None
    assert node.tpdo[1][0x6064].raw == position(node)
    assert node.tpdo[1][0x6041].raw == node.sdo[0x6041].raw


def test_its_state_machine_enables_a_drive_and_streams_targets(node: BaseNode402) -> None:
    map_pdos(node)
    node.sdo[0x60C2][1].raw, node.sdo[0x60C2][2].raw = 4, -3
    node.nmt.state = "OPERATIONAL"
    node.setup_402_state_machine(read_pdos=False)
    here = position(node)
    assert node.is_op_mode_supported("CYCLIC SYNCHRONOUS POSITION") and not node.is_op_mode_supported("HOMING")
    node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
    node.sdo[0x607A].raw = here
    node.rpdo[1][0x607A].raw = here
    node.rpdo[1].start(0.01)  # a synchronous PDO is the caller's to send
    node.network.sync.start(0.01)
    try:
        for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
            node.state = state
            assert node.state == state
        for step in range(1, 101):
            node.rpdo[1][0x607A].raw = here + 20 * step
            node.tpdo[1].wait_for_reception(PATIENCE_S)
        until(lambda: abs(node.tpdo[1][0x6064].raw - here - 2000) <= 1)
        node.state = "SWITCH ON DISABLED"
        assert node.state == "SWITCH ON DISABLED"
    finally:
        node.network.sync.stop()
        node.rpdo[1].stop()


def test_it_sees_a_failure_and_resets_it(connect: Callable[..., BaseNode402]) -> None:
    node = connect(faults=[Protection("joint2", 0.3, cause="temperature")])
    until(lambda: [error.code for error in node.emcy.active] == [0x4310])
    node.setup_402_state_machine(read_pdos=False)
    assert node.is_faulted() and node.sdo[0x603F].raw == 0x4310 and node.sdo[0x1001].raw == 1
    node.reset_from_fault()
    assert node.state == "OPERATION ENABLED"
    assert node.sdo[0x603F].raw == 0 and node.emcy.active == []


def test_a_profile_move_arrives(node: BaseNode402) -> None:
    node.setup_402_state_machine(read_pdos=False)
    node.op_mode = "PROFILED POSITION"
    node.state = "OPERATION ENABLED"
    target = position(node) + 3000
    node.sdo[0x607A].raw = target
    node.controlword = 0x1F
    until(lambda: bool(node.sdo[0x6041].raw & 0x0400) and abs(position(node) - target) <= 1)


# --- our dialogues, their node --------------------------------------------------------------------------------


def play(part: Generator[Any, Any, Any], answer: Callable[[Frame], Frame]) -> Any:
    """Run part of a dialogue; every question has one frame, and is answered at once."""
    heard = None
    while True:
        try:
            question = part.send(heard)
        except StopIteration as end:
            return end.value
        ((frame, _),) = question.packets(True)
        heard = question.receive(answer(frame), True)
        assert heard is not None


def asked_through(bus: can.BusABC) -> Callable[[Frame], Frame]:
    """Ask over the bus, beside whoever else listens there."""

    def ask(frame: Frame) -> Frame:
        with can.Bus(bus.channel_id, "virtual", ignore_config=True) as ours:
            ours.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))
            deadline = time.monotonic() + PATIENCE_S
            while time.monotonic() < deadline:
                message = ours.recv(PATIENCE_S)
                if message is not None and message.arbitration_id == 0x580 + NODE:
                    return Frame(message.arbitration_id, bytes(message.data))
        raise AssertionError("no answer")

    return ask


@pytest.fixture
def their_server() -> Callable[[Frame], Frame]:
    """The library's local node: what it answers to a frame."""
    answers: list[tuple[int, bytes]] = []

    class Wire(canopen.Network):
        def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
            answers.append((can_id, bytes(data)))

    network = Wire()
    local = network.create_node(NODE, dictionary())
    local.sdo[0x1000].raw = 0x0002_0192
    local.sdo[0x6064].raw = -16_382
    local.sdo[0x6060].raw = 0
    for base in (0x1400, 0x1800):
        for number in range(4):
            local.sdo[base + number][1].raw, local.sdo[base + number][2].raw = 1 << 31, 255
            local.sdo[base + 0x200 + number][0].raw = 0

    def ask(frame: Frame) -> Frame:
        answers.clear()
        network.notify(frame.id, bytearray(frame.data), 0.0)
        ((can_id, data),) = [found for found in answers if found[0] == 0x580 + NODE]
        return Frame(can_id, data)

    ask.local = local  # type: ignore[attr-defined]
    return ask


def test_our_reads_and_writes_are_understood(their_server: Any) -> None:
    ours = sdo.Node(1, on_python_can("cia402_6").joints[1])
    assert play(ours.read(cia402_protocol.DEVICE_TYPE), their_server) == 0x0002_0192
    assert play(ours.read(cia402_protocol.POSITION), their_server) == -16_382
    for entry, value in ((cia402_protocol.MODE, 8), (cia402_protocol.TARGET, -5), (cia402_protocol.CONTROLWORD, 15)):
        play(ours.write(entry, value), their_server)
        assert their_server.local.sdo[entry.index].raw == value
        assert play(ours.read(entry), their_server) == value


def test_what_it_refuses_is_said(their_server: Any) -> None:
    ours = sdo.Node(1, on_python_can("cia402_6").joints[1])
    with pytest.raises(sdo.Aborted, match="it has no such object, abort code 06020000"):
        play(ours.read(sdo.Object(0x2000, 0, 4, "nothing")), their_server)
    assert play(ours.read_if_there(sdo.Object(0x2000, 0, 4, "nothing")), their_server) is None
    with pytest.raises(sdo.Aborted, match="can only be read, abort code 06010002"):
        play(ours.write(cia402_protocol.DEVICE_TYPE, 1), their_server)


def test_what_we_map_is_what_it_finds_mapped(their_server: Any) -> None:
    """Into its node by our dialogue; read out of it by its own PDO classes."""
    ours = sdo.Node(1, on_python_can("cia402_6").joints[1])
    wanted = (
        (pdo.RECEIVED, 0x200 + NODE, cia402_protocol.RPDO1_OBJECTS),
        (pdo.TOLD, 0x180 + NODE, (*cia402_protocol.TPDO1_OBJECTS, cia402_protocol.TORQUE_OBJECT)),
    )
    their_server.local.sdo[0x1800][1].raw = 0x4000_0180 + NODE
    for first, identifier, objects in wanted:
        play(pdo.map_anew(ours, first, identifier, objects), their_server)
    local = their_server.local
    local.tpdo.read()
    local.rpdo.read()
    assert [(found.index, found.length) for found in local.rpdo[1].map] == [(0x6040, 16), (0x607A, 32)]
    assert [(found.index, found.length) for found in local.tpdo[1].map] == [(0x6041, 16), (0x6064, 32), (0x6077, 16)]
    assert (local.rpdo[1].cob_id, local.tpdo[1].cob_id) == (0x202, 0x182)
    assert local.rpdo[1].enabled and local.tpdo[1].enabled and not local.tpdo[1].rtr_allowed
    assert (local.rpdo[1].trans_type, local.tpdo[1].trans_type) == (1, 1)
