"""The section `bus.python_can`: what it takes, how the adapter is named, what is refused, and overriding it."""

import pytest

from config.budget import check_budget
from config.errors import ConfigError
from config.loader import arm_hash, load_arm, parse_overrides


def arm(python_can, **bus):
    bus = {"interface": "python-can", "channel": "here", **bus}
    return load_arm("episode1", overrides={"bus": {**bus, "python_can": python_can}})


def test_options_are_kept_as_they_are_written():
    options = {"sleep_after_open": 0.5, "rtscts": True, "tty_baudrate": 1_000_000, "frame_type": "EXT"}
    section = arm({"interface": "slcan", **options}).bus.python_can
    assert dict(section.options) == options
    assert section.interface == "slcan"


def test_an_arm_is_another_one_with_other_options():
    hashes = {
        arm_hash(arm({"interface": "virtual", **more})) for more in ({}, {"rx_queue_size": 1}, {"rx_queue_size": 2})
    }
    assert len(hashes) == 3


@pytest.mark.parametrize(
    ("interface", "index", "channel"),
    [
        ("pcan", 1, "PCAN_USBBUS1"),
        ("pcan", 16, "PCAN_USBBUS16"),
        ("gs_usb", 0, "0"),
        ("robotell", 3, "/dev/ttyUSB3"),
        ("slcan", 0, "/dev/ttyUSB0"),
        ("socketcan", 2, "can2"),
    ],
)
def test_an_index_means_what_the_interface_counts(interface, index, channel):
    bus = {"interface": "python-can", "usb_index": index, "python_can": {"interface": interface}}
    assert load_arm("episode1", overrides={"bus": bus}).bus.resolved_channel == channel


def test_no_serial_line_limits_the_cycle():
    check_budget(arm({"interface": "slcan", "tty_baudrate": 9600}))


@pytest.mark.parametrize(
    ("python_can", "bus", "sentence"),
    [
        ({}, {}, "interface is missing; add it"),
        ({"interface": "Peak"}, {}, "which is not allowed; one of python-can's interfaces"),
        ({"interface": 3}, {}, "interface is 3, but must be text"),
        (3, {}, "python_can is 3, but must be a group of fields"),
        ({"interface": "seeedstudio"}, {}, "send each frame only once, so a command"),
        ({"interface": "pcan", "channel": "x"}, {}, "channel does not stand here: name the adapter as bus.channel"),
        ({"interface": "pcan", "bitrate": 1}, {}, "bitrate does not stand here: the bit rate is bus.bitrate"),
        ({"interface": "pcan", "fd": True}, {}, "fd does not stand here: the drives speak classic CAN"),
        ({"interface": "pcan", "timing": {"brp": 1}}, {}, "timing is a group or a list, but an option of python-can"),
        ({"interface": "pcan", "state": None}, {}, "state is left empty, but an option of python-can is"),
        ({"interface": "pcan"}, {"serial_baud": 115_200}, "python_can.tty_baudrate (slcan)"),
        ({"interface": "pcan"}, {"bitrate": 2_000_000}, "classic CAN has 10000 to 1000000 bit/s"),
        ({"interface": "pcan"}, {"channel": None, "usb_index": 0}, "pcan has PCAN_USBBUS1 to PCAN_USBBUS16"),
        ({"interface": "kvaser"}, {"channel": None, "usb_index": 0}, "kvaser has no adapters by number"),
        (
            {"interface": "pcan"},
            {"channel": None, "usb_index": None},
            "needs the name that python-can has for the adapter",
        ),
        ({"interface": "pcan"}, {"interface": "slcan"}, "python_can stands beside interface slcan"),
        (None, {}, "interface python-can does not say which of python-can's interfaces"),
    ],
)
def test_what_is_refused_and_why(python_can, bus, sentence):
    with pytest.raises(ConfigError) as refused:
        arm(python_can, **bus)
    assert sentence in str(refused.value)


@pytest.fixture
def file(tmp_path):
    """An arm file on a PEAK adapter with options of its own."""
    import yaml

    from config.loader import ARMS_FOLDER

    values = yaml.safe_load((ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8"))
    values["bus"] = {
        "interface": "python-can",
        "channel": "PCAN_USBBUS1",
        "python_can": {"interface": "pcan", "auto_reset": True, "device_id": 7},
    }
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(values), encoding="utf-8")
    return path


def test_another_interface_leaves_the_options_of_the_file_s_behind(file):
    overrides = parse_overrides(["bus.python_can.interface=slcan", "bus.python_can.rtscts=true", "bus.channel=/dev/x"])
    bus = load_arm(file, overrides=overrides).bus
    assert (bus.python_can.interface, dict(bus.python_can.options)) == ("slcan", {"rtscts": True})
    bus = load_arm(file, overrides=parse_overrides(["bus.python_can.device_id=8"])).bus
    assert dict(bus.python_can.options) == {"auto_reset": True, "device_id": 8}


def test_an_arm_on_python_can_may_be_driven_through_something_else(file):
    overrides = {"bus": {"interface": "slcan", "channel": "/dev/ttyACM0"}}
    assert load_arm(file, overrides=overrides).bus.python_can is None


def test_an_arm_behind_a_serial_line_may_be_driven_through_python_can():
    """Its own speed is an option of the interface then."""
    assert load_arm("episode1").bus.serial_baud != "cdc"
    assert arm({"interface": "slcan"}).bus.serial_baud == "cdc"
