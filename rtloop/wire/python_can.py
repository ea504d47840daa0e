"""Opening a bus of python-can: any of its interfaces, as the section `bus.python_can` of the arm file says."""

import contextlib
import importlib
import inspect
import logging
import re
from typing import TYPE_CHECKING, Any

from config.budget import cycle_frames
from config.errors import did_you_mean
from config.python_can import PythonCan
from config.schema import ArmConfig
from rtloop.system import realtime
from rtloop.wire.bridge import Bridge, Traffic
from rtloop.wire.refusal import WireRefused

if TYPE_CHECKING:
    import can

BELOW_THE_CYCLE = 20
"""How far the priority of the bridge's threads is below the cycle's: below the reader, which only passes bytes on."""
LINUX_CLASSES = frozenset(("gs_usb", "socketcan"))
"""Interfaces whose error frames carry Linux's classes, made by the device or by the system."""
ADVICE = {
    "gs_usb": "`pip install gs_usb` and `sudo apt install libusb-1.0-0`; or take the kernel's own driver gs_usb, which "
    "is quicker (interface socketcan)",
    "pcan": "PEAK's library PCANBasic, which comes with PEAK's driver for Linux; or take the kernel's own driver "
    "peak_usb, which is quicker (interface socketcan)",
    "slcan": "`pip install pyserial`",
    "serial": "`pip install pyserial`",
    "robotell": "`pip install pyserial`",
}
"""What an interface of python-can needs to be installed."""
_LOOKED_FOR = re.compile(r"""kwargs(?:\.get\(|\.pop\(|\[)\s*["'](\w+)["']""")


def open_python_can(arm: ArmConfig) -> Bridge:
    """Open the arm's bus through python-can; raises WireRefused."""
    settings = arm.bus.python_can
    assert settings is not None  # the schema makes sure of that
    try:
        import can
    except ImportError:
        raise WireRefused(
            "python-can is not installed, and bus.interface python-can needs it: `pip install python-can`."
        ) from None
    log = logging.getLogger("can")
    log.handlers, log.propagate = [logging.NullHandler()], False  # what matters becomes a sentence of rtarm's own
    cycle = cycle_frames(arm)
    options = all_options(arm)
    _refuse_unknown_options(settings, _bus_class(settings.interface), options)
    channel = options.pop("channel", None)
    try:
        bus = can.Bus(channel=channel, interface=settings.interface, ignore_config=True, **options)
    except Exception as problem:  # whatever the interface's own library raises
        raise _refusal(arm, settings.interface, problem) from None
    traffic = Traffic(arm.control.period_ns * 1e-9, sum(frames.count for frames in cycle if frames.from_host))
    return Bridge(
        bus,
        traffic,
        tells_classes=settings.interface in LINUX_CLASSES,
        prepare=lambda: realtime.prepare_helper(arm.realtime, below=BELOW_THE_CYCLE),
    )


def all_options(arm: ArmConfig) -> dict[str, Any]:
    """Arguments for python-can: from the sections of the arm file, and the options that the user has added."""
    settings = arm.bus.python_can
    assert settings is not None
    options: dict[str, Any] = {"channel": arm.bus.resolved_channel, "bitrate": arm.bus.bitrate}
    if settings.interface == "gs_usb" and arm.bus.resolved_channel.isdecimal():
        options["index"] = int(arm.bus.resolved_channel)
    return {**options, **settings.options}


def _bus_class(interface: str) -> "type[can.BusABC]":
    """The class of a python-can interface; raises WireRefused."""
    from can.interfaces import BACKENDS

    if interface not in BACKENDS:
        raise WireRefused(
            f"bus.python_can.interface is {interface}, which python-can does not know"
            f"{did_you_mean(interface, BACKENDS)}: it knows {', '.join(sorted(BACKENDS))}."
        )
    module, name = BACKENDS[interface]
    try:
        found: type[can.BusABC] = getattr(importlib.import_module(module), name)
    except Exception as problem:
        raise WireRefused(
            f"python-can's {interface} cannot be loaded ({_text(problem)}): {_advice(interface)}."
        ) from None
    return found


def _refuse_unknown_options(settings: PythonCan, bus_class: "type[can.BusABC]", options: dict[str, Any]) -> None:
    """Raise WireRefused for an unknown option: most classes ignore unknown arguments, so a typo would go unnoticed.

    Removes `bitrate` from `options` if the class does not take it.
    """
    known = known_options(bus_class)
    for name in settings.options:
        if name not in known:
            allowed = ", ".join(sorted(known - {"channel", "bitrate"}))
            raise WireRefused(
                f"bus.python_can.{name} is no option of python-can's {settings.interface}: it takes {allowed}."
            )
    takes_all = any(p.kind is p.VAR_KEYWORD for p in inspect.signature(bus_class).parameters.values())
    if "bitrate" not in known and not takes_all:
        del options["bitrate"]


def known_options(bus_class: "type[can.BusABC]") -> set[str]:
    """Options of a class of python-can: its named arguments, and those that its source looks up in `kwargs`."""
    known: set[str] = set()
    for owner in bus_class.__mro__:
        if "__init__" in vars(owner) and owner is not object:
            known.update(inspect.signature(owner).parameters)
        with contextlib.suppress(OSError, TypeError):  # no source
            known.update(_LOOKED_FOR.findall(inspect.getsource(owner)))
    return known - {"self", "args", "kwargs"}


def _refusal(arm: ArmConfig, interface: str, problem: Exception) -> WireRefused:
    channel, said = arm.bus.resolved_channel, _text(problem)
    import can

    lacks = isinstance(problem, can.CanInterfaceNotImplementedError | ImportError)
    if lacks or any(word in said.lower() for word in ("library", "backend")):
        return WireRefused(f"python-can's {interface} cannot be used here ({said}): {_advice(interface)}.")
    return WireRefused(
        f"python-can's {interface} cannot open {channel} ({said}): check that the adapter is plugged in, that you may "
        "use it and that no other program does, and what bus.channel and bus.python_can say."
    )


def _advice(interface: str) -> str:
    needs = ADVICE.get(interface)
    return f"it needs {needs}" if needs else f"see python-can's page on {interface} for what it needs"


def _text(problem: Exception) -> str:
    """The text of an exception, as a part of a sentence."""
    said = " ".join(str(problem).split()).rstrip(".")
    return said or type(problem).__name__
