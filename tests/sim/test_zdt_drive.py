"""The simulated ZDT drive against the byte examples and the behaviour of the facts (zdt-emm-v5.md)."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import pytest
from drive_bench import DriveBench

from sim.bus import Frame
from sim.drives.ramp import GRAINS_PER_REVOLUTION as TURN
from sim.drives.zdt import ZdtDrive
from sim.drives.zdt_settings import Homing, Settings

EE = "00 EE 6B"
TO_2_TURNS = "FD 00 00 64 00 00 00 19 00 01 00 6B"  # 100 rpm, no ramp, absolute 6400 pulses


class Bench(DriveBench):
    """A drive with new firmware and factory settings, homed, at zero, or with other options.

    Its messages are as the manuals print them, without address; what it says is so too, packets with their number.
    """

    def __init__(self, **options: object) -> None:
        super().__init__(ZdtDrive(**options))

    def tell(self, *messages: str | bytes | Frame, address: int = 1) -> Self:
        for message in messages:
            if isinstance(message, Frame):
                super().tell(message)
                continue
            data = bytes.fromhex(message) if isinstance(message, str) else message
            rest = [data[:1] + data[start : start + 7] for start in range(8, len(data), 7)]
            super().tell(*(Frame(address << 8 | packet, part) for packet, part in enumerate((data[:8], *rest))))
        return self

    def heard(self) -> list[str]:
        said = [text.partition("# ") for text in super().heard()]
        return [f"{int(head[-2:], 16)}: {data}".removeprefix("0: ") for head, _, data in said]

    def body(self, message: str) -> bytes:
        """The answer put together, without function byte and checksum."""
        whole = b"".join(bytes.fromhex(text.split(": ")[-1])[1:] for text in self.ask(message))
        assert whole[-1] == 0x6B
        return whole[:-1]


@pytest.fixture
def bench() -> Bench:
    """One as it comes."""
    return Bench()


@pytest.mark.parametrize(
    ("request_hex", "answer"),
    [
        ("F3 AB 01 00 6B", ["F3 02 6B"]),
        ("F3 AB 00 00 6B", ["F3 02 6B"]),
        ("F6 01 05 DC 0A 00 6B", ["F6 02 6B"]),
        ("FD 01 0F A0 00 00 01 FA 00 00 00 6B", ["FD 02 6B"]),
        ("F1 03 20 64 00 00 6B", ["F1 02 6B"]),
        ("FC 00 00 0C 80 6B", ["FC E2 6B"]),  # before the first F1
        ("FE 98 00 6B", ["FE 02 6B"]),
        ("93 88 01 6B", ["93 02 6B"]),
        ("9A 02 00 6B", ["9A 02 6B"]),
        ("9A 00 00 6B", ["9A 12 6B"]),  # already at zero
        ("9C 48 6B", ["9C E2 6B"]),  # not homing
        ("3B 6B", ["3B 03 6B"]),
        ("4C AE 01 00 00 00 1E 00 00 27 10 01 2C 03 20 00 3C 00 6B", ["4C 02 6B"]),
        ("22 6B", ["22 00 00 00 1E 00 00 27", "1: 22 10 01 2C 03 20 00 3C", "2: 22 00 6B"]),
        ("1F 6B", ["1F 00 C8 00 6F 6B"]),
        ("13 6B", ["13 00 64 19 C8 03 E8 6B"]),
        ("20 6B", ["20 04 7A 0D 28 6B"]),
        ("21 6B", ["21 00 00 46 50 00 00 00", "1: 21 0A 00 00 46 50 6B"]),
        ("24 6B", ["24 2E E0 6B"]),
        ("26 6B", ["26 00 C8 6B"]),
        ("27 6B", ["27 02 73 6B"]),
        ("31 6B", ["31 00 00 6B"]),
        ("35 6B", ["35 00 00 00 6B"]),
        ("36 6B", ["36 00 00 00 00 00 6B"]),
        ("37 6B", ["37 00 00 00 00 00 6B"]),
        ("39 6B", ["39 01 19 6B"]),
        ("3A 6B", ["3A 03 6B"]),
        ("3C 6B", ["3C 03 03 6B"]),
        ("15 6B", ["15 01 6B"]),
        ("16 6B", ["16 00 00 00 00 6B"]),
        ("0A 6D 6B", ["0A 02 6B"]),
        ("0E 52 6B", ["0E E2 6B"]),  # no protection active
        ("50 00 6B", ["50 02 6B"]),
        ("AE 4B 01 01 6B", ["AE 02 6B"]),
        ("84 8A 01 20 6B", ["84 02 6B"]),
        ("44 33 00 04 B0 6B", ["44 02 6B"]),
        ("45 66 00 0B B8 6B", ["45 02 6B"]),
        ("46 69 00 01 6B", ["46 02 6B"]),
        ("68 38 01 00 00 13 88 6B", ["68 02 6B"]),
        ("11 18 3A 00 0A 6B", ["11 02 6B"]),
        ("FF 66 6B", ["FF 02 6B"]),
    ],
)
def test_golden_requests(bench, request_hex, answer):
    assert bench.ask(request_hex) == answer


def test_configuration_block_as_in_the_manual(bench):
    assert bench.ask("42 6C 6B") == [
        "42 21 15 19 02 02 02 00",
        "1: 42 10 01 00 03 E8 0B B8",
        "2: 42 0F A0 05 07 01 00 01",
        "3: 42 01 00 28 09 60 0F A0",
        "4: 42 00 01 6B",
    ]


def test_everything_at_once_one_turn_back():
    bench = Bench(position_pulses=-3200).tell("43 7A 6B")
    assert bench.heard() == [
        "43 1F 09 2E E0 02 73 00",
        "1: 43 00 01 00 01 00 00 00",
        "2: 43 00 00 01 00 01 00 00",
        "3: 43 00 00 00 00 00 03 03",
        "4: 43 6B",
    ]


def test_positions_one_turn_back_as_in_the_manual():
    bench = Bench(position_pulses=-3200)
    assert bench.ask("32 6B") == ["32 01 00 00 0C 80 6B"]
    assert bench.ask("33 6B") == ["33 01 00 01 00 00 6B"]
    assert bench.ask("34 6B") == ["34 01 00 01 00 00 6B"]
    assert bench.ask("36 6B") == ["36 01 00 01 00 00 6B"]


def test_speed_reading_as_in_the_manual(bench):
    bench.tell("F6 01 05 DC 00 00 6B")
    assert bench.ask("35 6B") == ["35 01 05 DC 6B"]


def test_the_manual_position_move_ends_40_turns_and_a_half_back(bench):
    bench.tell("FD 01 0F A0 00 00 01 FA 00 00 00 6B")
    assert bench.after(5000).ask("32 6B") == ["32 01 00 01 FA 00 6B"]
    assert bench.drive.position_counts == -129_536 * 65536 // 3200


def test_power_up_status_is_the_manuals_sample():
    bench = Bench(homed=False, position_pulses=12345)
    assert bench.ask("3A 6B") == ["3A 83 6B"]
    assert bench.ask("36 6B") == ["36 00 00 00 00 00 6B"]
    assert bench.ask("50 00 6B") == ["50 02 6B"]
    assert bench.ask("3A 6B") == ["3A 03 6B"]


# --- framing --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "request_hex",
    [
        "36 6C",  # checksum
        "36",  # no checksum
        "6B",
        "36 00 6B",  # too long
        "F3 AB 01 6B",  # too short
        "F3 AA 01 00 6B",  # argument
        "43 7B 6B",
        "7E 6B",  # unknown
        "A6 69 00 01 6B",  # one manual's misprint of 46
        "FD 01 0F A0 00 00 01 FA 00 00 00 6A",
        "FD 01 0F A0 00 00 01 FA 00 00 6B",
        "FD 01 0F A0 00 00 01 FA 00 00 00 00 6B",
        "FD 01 0F A0 00 6B",
        "48 D1 00 6B",
    ],
)
def test_format_errors_change_nothing(bench, request_hex):
    assert bench.ask(request_hex) == [EE]
    assert not bench.drive.moving
    assert bench.ask("36 6B") == ["36 00 00 00 00 00 6B"]


def test_empty_frame_is_a_format_error(bench):
    assert bench.ask(Frame(0x100, b"")) == [EE]


def test_second_packet_without_the_first(bench):
    assert bench.ask(Frame(0x101, bytes.fromhex("FD 00 01 00 6B"))) == [EE]


def test_lost_second_packet_then_a_whole_command(bench):
    bench.tell("FD 00 00 64 00 00 00 19")
    assert bench.ask(TO_2_TURNS) == [EE, "FD 02 6B"]
    assert bench.after(3000).drive.position_counts == 2 * 65536


def test_another_command_between_the_packets_breaks_it(bench):
    bench.tell("FD 00 00 64 00 00 00 19")
    assert bench.ask("36 6B") == [EE, "36 00 00 00 00 00 6B"]
    assert bench.ask(Frame(0x101, bytes.fromhex("FD 00 01 00 6B"))) == [EE]
    assert not bench.drive.moving


@pytest.mark.parametrize(
    "second",
    [
        Frame(0x102, bytes.fromhex("FD 00 01 00 6B")),  # number skipped
        Frame(0x101, bytes.fromhex("FE 00 01 00 6B")),  # another function
        Frame(0x101, bytes.fromhex("FD 00 01 00")),  # no checksum
        Frame(0x101, b""),
    ],
)
def test_wrong_second_packets(bench, second):
    bench.tell("FD 00 00 64 00 00 00 19")
    assert bench.ask(second) == [EE]
    assert not bench.drive.moving


def test_checksum_in_every_packet_is_refused(bench):
    bench.tell("FD 00 00 64 00 00 00 6B", Frame(0x101, bytes.fromhex("FD 19 00 01 00 6B")))
    assert bench.heard() == [EE]


@pytest.mark.parametrize("can_id", [0x200, 0x10000, 0x10100, 0x1FFFFFFF])
def test_other_identifiers_meet_silence(bench, can_id):
    assert bench.ask(Frame(can_id, bytes.fromhex("36 6B"))) == []


def test_broadcasts_are_obeyed_silently_but_address_1_answers_the_trigger():
    for address, answers in ((1, ["FF 02 6B"]), (2, [])):
        bench = Bench(settings=Settings(address=address)).tell("F6 00 00 64 00 00 6B", address=0)
        bench.tell("36 6B", address=0)
        bench.tell("7E 6B", address=0)
        assert bench.heard() == []
        assert bench.drive.moving
        bench.tell("FF 66 6B", address=0)
        assert bench.heard() == answers


def test_who_is_there():
    bench = Bench(settings=Settings(address=9)).tell("15 6B", address=0)
    ((ready_ns, frame),) = bench.drive.outbox
    assert frame == Frame(0x900, bytes.fromhex("15 09 6B"))
    assert 200_000 <= ready_ns <= 400_000


# --- motion ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "pulses"), [(0, 1600 + 3200), (1, 3200), (2, 800 + 3200)])
def test_modes_relative_absolute_and_measured(bench, mode, pulses):
    bench.ask("FD 00 00 3C 00 00 00 06 40 01 00 6B")  # 1600 pulses at 60 rpm take 500 ms
    bench.wait(250)
    bench.tell(f"FD 00 00 3C 00 00 00 0C 80 {mode:02X} 00 6B")
    assert bench.after(5000).drive.position_counts == pulses * 65536 // 3200


def test_fast_position_moves_as_set_up(bench):
    bench.tell("F1 03 20 64 00 00 6B")
    for turns in (1, 2):
        assert bench.ask("FC 00 00 0C 80 6B") == ["FC 02 6B"]
        assert bench.after(10_000).drive.position_counts == turns * 65536
    assert bench.tell("F1 03 20 64 01 00 6B", "FC FF FF F3 80 6B").after(10_000).drive.position_counts == -65536


def test_fast_position_may_be_relative_whatever_was_set_up(bench):
    bench.drive.fast_is_relative = True
    bench.tell("F1 03 20 64 01 00 6B")
    for turns in (1, 2):
        assert bench.ask("FC 00 00 0C 80 6B") == ["FC 02 6B"]
        assert bench.after(10_000).drive.position_counts == turns * 65536


def test_speed_is_clamped_by_firmware():
    for firmware, limit in (("new", 6000), ("old", 3000)):
        bench = Bench(firmware=firmware)
        assert bench.tell("F6 00 FF FF 00 00 6B").after(1).drive.shaft.speed_at(bench.now_ns) == limit


@pytest.mark.parametrize(
    "request_hex",
    [
        "FD 02 00 64 00 00 00 19 00 01 00 6B",  # direction
        "FD 00 00 64 00 00 00 19 00 03 00 6B",  # mode
        "FD 00 00 64 00 00 00 19 00 01 02 6B",  # sync
        "F6 02 00 64 00 00 6B",
        "F3 AB 02 00 6B",
        "9A 04 00 6B",
        "AE 4B 00 00 6B",
        "46 69 00 02 6B",
        "11 18 7E 00 0A 6B",
        "11 18 43 00 0A 6B",
        "4C AE 00 09 00 00 1E 00 00 27 10 01 2C 03 20 00 3C 00 6B",
    ],
)
def test_bad_parameters(bench, request_hex):
    assert bench.ask(request_hex) == [request_hex[:2] + " E2 6B"]
    assert not bench.drive.moving


@pytest.mark.parametrize("request_hex", [TO_2_TURNS, "F6 00 00 64 00 00 6B", "9A 02 00 6B"])
def test_a_disabled_drive_refuses(bench, request_hex):
    bench.tell("F3 AB 00 00 6B")
    assert bench.ask(request_hex) == [request_hex[:2] + " E2 6B"]


def test_synchronous_start_takes_the_latest(bench):
    assert bench.ask("FD 00 00 64 00 00 00 19 00 01 01 6B") == ["FD 02 6B"]
    assert bench.tell("FD 00 00 64 00 00 00 0C 80 01 01 6B").after(1000).drive.position_counts == 0
    assert bench.ask("FF 66 6B") == ["FF 02 6B"]
    assert bench.after(3000).drive.position_counts == 65536
    bench.tell("FE 98 00 6B", "FF 66 6B")
    assert not bench.drive.moving


def test_old_firmware_may_refuse_retargeting():
    bench = Bench(firmware="old", retarget="reject")
    assert bench.ask(TO_2_TURNS) == ["FD 02 6B"]
    assert bench.ask(TO_2_TURNS) == ["FD E2 6B"]
    assert bench.after(3000).ask(TO_2_TURNS) == ["FD 02 6B"]


def test_old_firmware_knows_less():
    bench = Bench(firmware="old", homed=False)
    assert bench.ask("1F 6B") == ["1F 7D 6F 6B"]
    assert bench.ask("21 6B") == ["21 00 00 F2 30 00 00 00", "1: 21 64 00 00 F2 30 6B"]
    assert bench.ask("3A 6B") == ["3A 03 6B"]  # no bit for lost power
    for request_hex in ("F1 03 20 64 00 00 6B", "FC 00 00 0C 80 6B", "26 6B", "39 6B", "3C 6B", "15 6B",
                        "16 6B", "50 00 6B", "68 38 01 00 00 13 88 6B", "11 18 3A 00 0A 6B"):  # fmt: skip
        assert bench.ask(request_hex) == [EE]
    assert bench.ask("FD 00 00 64 00 00 00 19 00 02 00 6B") == ["FD E2 6B"]  # no mode 02


@pytest.mark.parametrize(
    ("response", "acknowledged", "completed", "stop_acknowledged"),
    [(0, False, False, False), (1, True, False, True), (2, False, True, False), (3, True, True, True),
     (4, False, True, True)],
)  # fmt: skip
def test_response_modes(response, acknowledged, completed, stop_acknowledged):
    bench = Bench(settings=Settings(response=response))
    assert bench.ask(TO_2_TURNS) == (["FD 02 6B"] if acknowledged else [])
    assert bench.wait(2000) == (["FD 9F 6B"] if completed else [])
    assert bench.after(2000).ask("FE 98 00 6B") == (["FE 02 6B"] if stop_acknowledged else [])
    assert bench.ask("36 6B") == ["36 00 00 02 00 00 6B"]
    assert bench.ask("36 6C") == [EE]


def test_completion_comes_when_the_target_is_reached_and_only_once():
    bench = Bench(settings=Settings(response=3))
    bench.tell(TO_2_TURNS).wait(600)
    bench.ask("FD 00 00 64 00 00 00 00 00 01 00 6B")
    assert bench.wait(599) == []
    assert bench.wait(5) == ["FD 9F 6B"]


def test_lagging_shaft_settles_before_it_is_reached():
    bench = Bench(settings=Settings(response=3), lag_s=0.05)
    assert bench.tell(TO_2_TURNS).wait(1205) == ["FD 02 6B"]
    assert not bench.drive.reached
    assert bench.wait(1000) == ["FD 9F 6B"]
    assert bench.drive.reached


# --- settings -------------------------------------------------------------------------------------------


def test_block_read_back_and_rewritten_turns_answers_off_in_volatile_memory_only(bench):
    block = bytearray(bench.body("42 6C 6B")[2:])
    assert len(block) == 28
    block[7] = block[16] = 0
    block[18] = 0  # response mode
    assert bench.ask(b"\x48\xd1\x00" + bytes(block) + b"\x6b") == ["48 02 6B"]
    assert bench.ask("FE 98 00 6B") == []
    assert bench.body("42 6C 6B")[2:] == bytes(replace(Settings(), response=0).pack())
    bench.restart()
    assert bench.ask("FE 98 00 6B") == ["FE 02 6B"]


def test_block_with_store_survives_power_loss(bench):
    data = bytearray(Settings(response=3, microstep=32).pack())
    data[7] = data[16] = 0
    assert bench.ask(b"\x48\xd1\x01" + bytes(data) + b"\x6b") == ["48 02 6B"]
    bench.restart()
    assert bench.body("42 6C 6B")[2:] == Settings(response=3, microstep=32).pack()


def test_block_with_impossible_values_is_refused(bench):
    data = bytearray(Settings(response=9).pack())
    assert bench.ask(b"\x48\xd1\x00" + bytes(data) + b"\x6b") == ["48 E2 6B"]


def test_microsteps_change_what_a_pulse_is(bench):
    assert bench.tell("84 8A 00 20 6B", TO_2_TURNS).after(3000).drive.position_counts == 65536
    bench.tell("84 8A 00 00 6B")
    assert bench.drive.settings.pulses_per_revolution == 51_200


def test_new_address(bench):
    """The answer still bears the old one, as in the manual's example (quoted by emm-stepper, which awaits it so)."""
    bench.tell("AE 4B 01 07 6B")
    assert bench.drive.outbox[0][1].can_id == 0x100
    assert bench.heard() == ["AE 02 6B"]
    assert bench.ask("36 6B") == []
    bench.tell("36 6B", address=7)
    assert bench.drive.outbox[0][1].can_id == 0x700


def test_periodic_reports_keep_their_own_clock(bench):
    bench.tell("11 18 3A 00 0A 6B", "11 18 36 00 14 6B")
    frames = bench.wait(100.5)
    assert frames.count("3A 03 6B") == 10
    assert frames.count("36 00 00 00 00 00 6B") == 5
    bench.tell("11 18 3A 00 00 6B")
    assert bench.wait(100).count("3A 03 6B") == 0


def test_power_makes_it_forget_reports_and_what_waits_for_its_start(bench):
    bench.tell("11 18 36 00 0A 6B", "FD 00 00 64 00 00 00 19 00 01 01 6B")
    bench.restart()
    assert bench.wait(100) == []
    bench.tell("FF 66 6B")
    assert not bench.drive.moving


def test_reports_at_a_clock_that_is_wrong_and_the_acknowledgement_of_a_manual(bench):
    bench.drive.report_clock, bench.drive.bare_report_ack = 1.01, True
    assert bench.ask("11 18 3A 00 0A 6B") == ["11 6B"]
    assert bench.wait(1000).count("3A 03 6B") == 99
    assert bench.ask("11 18 77 00 0A 6B") == ["11 E2 6B"]


# --- homing, stall, power -------------------------------------------------------------------------------


def homing_bench(**options):
    bench = Bench(
        position_pulses=3200,
        homing=Homing(mode=2, direction=1, rpm=60, timeout_ms=5000),
        settings=Settings(**options),
    )
    bench.drive.shaft.low = 0
    return bench


def test_collision_homing_ends_at_the_stop_and_counts_from_there():
    bench = homing_bench(response=3)
    bench.drive.shaft.low = -1600 * TURN // 3200
    assert bench.ask("9A 02 00 6B") == ["9A 02 6B"]
    assert bench.ask("3B 6B") == ["3B 07 6B"]
    assert bench.ask(TO_2_TURNS) == ["FD E2 6B"]
    assert bench.wait(1700) == ["9A 9F 6B"]
    assert bench.ask("3B 6B") == ["3B 03 6B"]
    assert bench.drive.position_counts == bench.drive.target_counts == 0
    assert bench.drive.shaft.position_at(bench.now_ns) == -TURN // 2
    assert bench.ask("3A 6B") == ["3A 03 6B"]


def test_homing_without_a_stop_fails_after_its_time(bench):
    assert bench.tell("9A 02 00 6B").after(9_999).ask("3B 6B") == ["3B 07 6B"]
    assert bench.after(2).ask("3B 6B") == ["3B 0B 6B"]
    assert not bench.drive.moving
    bench.tell("9A 02 00 6B")
    assert bench.ask("3B 6B") == ["3B 07 6B"]


def test_homing_aborted():
    bench = homing_bench()
    assert bench.tell("9A 02 00 6B").after(300).ask("9C 48 6B") == ["9C 02 6B"]
    assert bench.ask("3B 6B") == ["3B 03 6B"]
    assert not bench.drive.moving
    bench.tell("9A 02 00 6B", "FE 98 00 6B")
    assert bench.ask("3B 6B") == ["3B 0B 6B"]


@pytest.mark.parametrize(("mode", "turns"), [(0, 1), (1, 0)])
def test_single_turn_homing(mode, turns):
    bench = Bench(position_pulses=2400, homing=Homing(direction=1))
    assert bench.tell(f"9A {mode:02X} 00 6B").after(3000).drive.shaft.position_at(bench.now_ns) == turns * TURN
    assert bench.drive.position_counts == 0
    assert bench.ask(f"9A {mode:02X} 00 6B") == ["9A 12 6B"]


def test_stall_trips_the_protection_which_can_be_cleared():
    bench = Bench(settings=Settings(stall_ms=1000))
    bench.tell("F6 00 00 64 00 00 6B").wait(100)
    bench.drive.block_shaft(bench.now_ns)
    held = bench.drive.position_counts
    assert bench.after(20).ask("3A 6B") == ["3A 05 6B"]  # enabled, stalled
    assert bench.drive.position_counts == held
    assert bench.after(1000).ask("3A 6B") == ["3A 0D 6B"]  # protection tripped (drives-checked)
    assert bench.ask(TO_2_TURNS) == ["FD E2 6B"]
    assert bench.ask("0E 52 6B") == ["0E 02 6B"]
    assert bench.ask(TO_2_TURNS) == ["FD 02 6B"]
    assert bench.drive.position_counts == held


def test_without_stall_protection_the_error_grows():
    bench = Bench(settings=Settings(stall_mode=0))
    bench.tell(TO_2_TURNS)
    bench.drive.block_shaft(bench.now_ns)
    assert bench.after(60_000).ask("37 6B") == ["37 00 00 02 00 00 6B"]
    assert bench.ask("3A 6B") == ["3A 05 6B"]


def test_shaft_leaves_a_stop_where_the_ramp_comes_back():
    bench = Bench(settings=Settings(stall_mode=0))
    bench.drive.shaft.high = TURN
    assert bench.tell(TO_2_TURNS).after(3000).drive.position_counts == 65536
    assert bench.drive.stalled
    assert bench.tell("FD 00 00 64 00 00 00 00 00 01 00 6B").after(600).drive.position_counts == 65536
    assert bench.after(300).drive.position_counts == 65536 // 2
    assert not bench.drive.stalled
    positions, _ = bench.drive.shaft.history(bench.drive.shaft.changes_ns())
    assert positions.max() == 1.0
