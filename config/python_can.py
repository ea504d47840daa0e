"""The section `bus.python_can` of an arm file: which of python-can's interfaces, and what that is told besides."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ConfigDict, Field, model_validator

from config.section import Section, refuse

SERIAL_INTERFACES = frozenset(("slcan", "robotell", "serial"))
INDEXED = {
    **dict.fromkeys(SERIAL_INTERFACES, "/dev/ttyUSB{}"),
    "pcan": "PCAN_USBBUS{}",
    "gs_usb": "{}",
    "socketcan": "can{}",
}
"""What `usb_index` means to an interface."""
PCAN_USB_BUSES = range(1, 17)

_SAID_ELSEWHERE = {
    "channel": "name the adapter as bus.channel or bus.usb_index",
    "bitrate": "the bit rate is bus.bitrate",
    "index": "name the adapter as bus.usb_index",
    "fd": "the drives speak classic CAN, and nothing else is sent",
    "data_bitrate": "the drives speak classic CAN, and nothing else is sent",
}


class PythonCan(Section):
    """An interface of python-can; what stands here besides goes to its class as it is."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True, allow_inf_nan=False)

    interface: str = Field(
        pattern=r"^[a-z][a-z0-9_-]*$",
        description="One of python-can's interfaces, by python-can's own name (pcan, gs_usb, slcan, virtual …); "
        "not seeedstudio, which is an interface of rtarm's own.",
    )

    @property
    def options(self) -> Mapping[str, Any]:
        """What the interface's class is told besides, by its own names."""
        return self.model_extra or {}

    @model_validator(mode="after")
    def _sends_again_what_lost_the_bus(self) -> PythonCan:
        if self.interface == "seeedstudio":
            raise refuse(
                "interface",
                "interface is seeedstudio, but python-can has that adapter send each frame only once, so a command "
                "that loses the bus to an answer would be lost; set bus.interface to seeedstudio, which sends it "
                "again, and remove python_can.",
            )
        return self

    @model_validator(mode="after")
    def _options_are_plain(self) -> PythonCan:
        for name, value in self.options.items():
            if name in _SAID_ELSEWHERE:
                raise refuse(name, f"{name} does not stand here: {_SAID_ELSEWHERE[name]}; remove it.")
            if not isinstance(value, (bool, int, float, str)):
                raise refuse(
                    name,
                    f"{name} is {'left empty' if value is None else 'a group or a list'}, but an option of python-can "
                    "is a number, a text, true or false; write one.",
                )
        return self

    def indexed(self, usb_index: int) -> str | None:
        """The channel that is meant by `usb_index`; None where it means nothing to the interface."""
        if self.interface == "pcan" and usb_index not in PCAN_USB_BUSES:
            return None
        place = INDEXED.get(self.interface)
        return None if place is None else place.format(usb_index)
