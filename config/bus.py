"""The section `bus` of an arm file: the CAN bus, its adapter, and how drives are spoken to."""

from __future__ import annotations

import re
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from config.python_can import PythonCan
from config.section import Section, refuse
from config.serial_adapters import SERIAL_ADAPTERS

AMBIGUOUS_SLCAN_BITRATES = (750_000, 800_000)
"""S7 is 800 kbit/s in LAWICEL, USBtin and Nakakiyo firmware and 750 kbit/s in the canable original."""

LOWEST_CAN_BITRATE, HIGHEST_CAN_BITRATE = 10_000, 1_000_000
"""Bit rates of classic CAN."""

INTERFACE_NAME = re.compile(r"(?!\.\.?$)[^\s/:]{1,15}")
"""What Linux takes as the name of a network interface (IFNAMSIZ)."""

SERIAL_BAUDS = (
    9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 500_000, 576_000, 921_600, 1_000_000,
    1_152_000, 1_500_000, 2_000_000, 2_500_000, 3_000_000, 3_500_000, 4_000_000,
)  # fmt: skip
"""Serial speeds that Linux knows by name (termios B9600 … B4000000)."""


class BusConfig(Section):
    """A CAN bus and the adapter it is reached through; of an arm with several buses one entry of a list."""

    name: str | None = Field(
        default=None,
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,15}$",
        description="Name of the bus where the arm has several, by which its joints name it: a letter, then letters, "
        "digits and _, at most 16.",
    )
    interface: Literal["slcan", "seeedstudio", "ch340-at", "socketcan", "python-can", "mock"] = Field(
        description="How the bus is reached: slcan, seeedstudio (Seeed and Waveshare USB-CAN-A) and ch340-at (the "
        "adapters of RobStride and CyberGear drives) are serial CAN adapters, socketcan is a CAN interface of the "
        "system, python-can any interface of that library (see python_can), mock is no bus at all."
    )
    channel: str | None = Field(
        default=None,
        min_length=1,
        description="Device of a serial adapter, such as /dev/ttyACM0, or the interface, such as can0 (socketcan), or "
        "what python-can calls it, such as PCAN_USBBUS1.",
    )
    usb_index: int | None = Field(
        default=None,
        ge=0,
        le=255,
        description="Short for channel: n means /dev/ttyUSB<n> (a serial adapter), can<n> (socketcan), or with "
        "python-can PCAN_USBBUS<n> (pcan), device number n (gs_usb), or what the interface's name says.",
    )
    bitrate: int = Field(default=500_000, gt=0, description="CAN bit rate (bit/s); the drives' menu must agree.")
    serial_baud: int | Literal["cdc"] = Field(
        default="cdc",
        description="Speed of the serial line to the adapter (baud) where it is a true UART; cdc where the "
        "adapter is a USB device for which the number means nothing. Left out, it is 2000000 with seeedstudio and "
        "921600 with ch340-at.",
    )
    load_limit: float = Field(
        default=0.85,
        gt=0,
        le=1,
        description="Highest planned bus load (share of the bit rate, worst-case bit stuffing); the rest is "
        "for bring-up, diagnosis and repeated frames.",
    )
    acknowledge: bool = Field(
        default=False,
        description="Whether drives acknowledge motion commands; false turns it off at bring-up, in the "
        "drives' volatile memory only.",
    )
    positions: Literal["polled", "reported"] = Field(
        default="polled",
        description="How positions are read: polled asks every drive in every cycle, reported lets each drive send its "
        "position by itself (X42S and Y42 generation), which bring-up sets in the drives' volatile memory only.",
    )

    position_command: Literal["FD", "FC"] = Field(
        default="FD",
        description="How targets are sent: FD carries speed, ramp and target in two frames; FC (firmware 2.0.0 and "
        "newer) the target alone in one, with a speed and a ramp that were set before. Rougher, and only where "
        "bring-up finds that a drive takes FC as absolute: see docs/hardware/streaming.md.",
    )

    python_can: PythonCan | None = Field(
        default=None,
        description="With interface python-can: which of its interfaces, and options of that, each as python-can calls "
        "it.",
    )

    @model_validator(mode="before")
    @classmethod
    def _adapter_knows_its_baud(cls, values: Any) -> Any:
        if isinstance(values, dict) and isinstance(interface := values.get("interface"), str):
            adapter = SERIAL_ADAPTERS.get(interface)
            if adapter is not None and adapter.serial_baud != "cdc":
                return {"serial_baud": adapter.serial_baud, **values}
        return values

    @field_validator("interface", mode="before")
    @classmethod
    def _kind_rather_than_name(cls, value: Any) -> Any:
        if isinstance(value, str) and re.fullmatch(r"v?can\d*", value):
            raise refuse(
                "",
                f"interface is {value}, but CAN interfaces of the system are reached by socketcan: set interface to "
                "socketcan, and channel to its name, such as can0.",
            )
        return value

    @field_validator("serial_baud", mode="before")
    @classmethod
    def _known_baud(cls, value: Any) -> Any:
        if value == "cdc" or (type(value) is int and value in SERIAL_BAUDS):
            return value
        allowed = ", ".join(str(baud) for baud in SERIAL_BAUDS)
        raise refuse(
            "",
            f"serial_baud is {value!r}, but a serial line knows {allowed}; choose the one your adapter is "
            "set to, or cdc if it is a USB device without a true UART.",
        )

    @model_validator(mode="after")
    def _consistent(self) -> BusConfig:
        if (self.interface == "python-can") != (self.python_can is not None):
            raise self._refuse_half_of_python_can()
        if self.interface == "mock":
            for field in ("channel", "usb_index"):
                value = getattr(self, field)
                if value is not None:
                    raise refuse(
                        field,
                        f"{field} is {value!r}, but interface mock opens no device; remove {field}, or set "
                        "interface to slcan or socketcan.",
                    )
            for field, default in (("positions", "polled"), ("position_command", "FD")):
                value = getattr(self, field)
                if value != default:
                    raise refuse(
                        field,
                        f"{field} is {value}, but interface mock has no drives that could do that; remove {field}, or "
                        "set interface to slcan or socketcan.",
                    )
            return self
        if self.channel is not None and self.usb_index is not None:
            raise refuse(
                "usb_index",
                f"usb_index {self.usb_index} ({self._indexed}) and channel {self.channel} both "
                "name the adapter, and only one may; remove one of them.",
            )
        if self.channel is None and self.usb_index is None:
            device, such_as, one = "name of the CAN interface", "can0", "can1"
            if self.interface in SERIAL_ADAPTERS:
                device, such_as, one = "adapter's device", SERIAL_ADAPTERS[self.interface].device, "/dev/ttyUSB1"
            elif self.interface == "python-can":
                device = "name that python-can has for the adapter"
                such_as, one = "PCAN_USBBUS1", "PCAN_USBBUS1 with pcan"
            raise refuse(
                "interface",
                f"interface {self.interface} needs the {device} and the file names none; add channel "
                f"(such as {such_as}) or usb_index (1 means {one}).",
            )
        if self.interface == "socketcan":
            self._refuse_what_no_can_interface_has()
        elif self.interface == "python-can":
            self._refuse_what_python_can_has_not()
        else:
            self._refuse_what_its_adapter_has_not()
        return self

    def _refuse_what_no_can_interface_has(self) -> None:
        if not INTERFACE_NAME.fullmatch(self.resolved_channel):
            raise refuse(
                "channel",
                f"channel is {self.resolved_channel!r}, but a CAN interface has a name of 1 to 15 characters without "
                "/ such as can0; name one of those `ip link` shows, or set interface to slcan for a serial adapter.",
            )
        if self.serial_baud != "cdc":
            raise refuse(
                "serial_baud",
                f"serial_baud is {self.serial_baud}, but interface socketcan has no serial line; remove serial_baud.",
            )
        self._refuse_no_classic_bitrate()

    def _refuse_no_classic_bitrate(self) -> None:
        if not LOWEST_CAN_BITRATE <= self.bitrate <= HIGHEST_CAN_BITRATE:
            raise refuse(
                "bitrate",
                f"bitrate is {self.bitrate}, but classic CAN has {LOWEST_CAN_BITRATE} to {HIGHEST_CAN_BITRATE} bit/s; "
                "choose the one the drives are set to.",
            )

    def _refuse_half_of_python_can(self) -> PydanticCustomError:
        if self.python_can is None:
            return refuse(
                "interface",
                "interface python-can does not say which of python-can's interfaces; add python_can: "
                "{interface: pcan}, or another that python-can knows.",
            )
        return refuse(
            "python_can",
            f"python_can stands beside interface {self.interface}, which does not use python-can; remove it, or set "
            "interface to python-can.",
        )

    def _refuse_what_python_can_has_not(self) -> None:
        assert self.python_can is not None
        name = self.python_can.interface
        if self.channel is None and self.usb_index is not None and self.python_can.indexed(self.usb_index) is None:
            allowed = "PCAN_USBBUS1 to PCAN_USBBUS16" if name == "pcan" else "no adapters by number"
            raise refuse(
                "usb_index",
                f"usb_index is {self.usb_index}, but python-can's {name} has {allowed}; name the adapter as channel, "
                "by python-can's name for it.",
            )
        if self.serial_baud != "cdc":
            raise refuse(
                "serial_baud",
                f"serial_baud is {self.serial_baud}, but python-can's interfaces have names of their own for it; "
                "remove it and set python_can.tty_baudrate (slcan).",
            )
        self._refuse_no_classic_bitrate()

    def _refuse_what_its_adapter_has_not(self) -> None:
        if self.interface == "slcan" and self.bitrate in AMBIGUOUS_SLCAN_BITRATES:
            raise refuse(
                "bitrate",
                f"bitrate is {self.bitrate}, which no SLCAN command names for certain (S7 is 800000 in some "
                "adapters and 750000 in others); set the drives to 500000 or 1000000 and use that.",
            )
        adapter = SERIAL_ADAPTERS[self.interface]
        if self.bitrate not in adapter.bitrates:
            allowed = ", ".join(str(bitrate) for bitrate in adapter.bitrates)
            raise refuse(
                "bitrate",
                f"bitrate is {self.bitrate}, but {adapter.name} offers {allowed}; choose the one the "
                "drives are set to.",
            )

    @property
    def reported(self) -> bool:
        """Whether drives send their positions by themselves."""
        return self.positions == "reported"

    @property
    def fast_targets(self) -> bool:
        """Whether targets are sent with FC."""
        return self.position_command == "FC"

    @property
    def spoken(self) -> str:
        """The interface whose language the adapter hears, from the control process itself or from python-can for it."""
        return self.interface if self.python_can is None else self.python_can.interface

    @property
    def _indexed(self) -> str:
        if self.python_can is not None and self.usb_index is not None:
            return str(self.python_can.indexed(self.usb_index))
        return f"can{self.usb_index}" if self.interface == "socketcan" else f"/dev/ttyUSB{self.usb_index}"

    @property
    def resolved_channel(self) -> str:
        """The device or interface to open; `mock` where there is none."""
        if self.channel is not None:
            return self.channel
        return "mock" if self.usb_index is None else self._indexed
