"""The one table of all checks: name, why it matters, and the function that looks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from config.schema import ArmConfig
from rtarm.doctor import adapters, kernel, memory, permissions, processors, software
from rtarm.doctor.finding import Found
from rtarm.doctor.machine import Machine, settled


@dataclass(frozen=True)
class Check:
    """A check; `why` is one sentence for people, and stands in docs/guides/doctor.md."""

    name: str
    why: str
    look: Callable[[Machine, ArmConfig | None], Found]

    def run(self, machine: Machine, arm: ArmConfig | None) -> Found:
        """What was found on this machine, for this arm."""
        return settled(lambda: self.look(machine, arm))


CHECKS: tuple[Check, ...] = (
    Check(
        "real-time priority",
        "Without it any busy program delays control cycles by milliseconds.",
        permissions.real_time_priority,
    ),
    Check(
        "locked memory",
        "A page that has to be fetched delays a cycle.",
        permissions.locked_memory,
    ),
    Check(
        "real-time throttling",
        "Linux leaves real-time threads a share of each second; the control cycle needs a few percent of it.",
        permissions.real_time_throttling,
    ),
    Check(
        "threads above",
        "A thread of higher real-time priority delays a cycle for as long as it computes.",
        permissions.threads_above,
    ),
    Check(
        "preemption",
        "Where the kernel can be interrupted only at some places, a cycle waits until it comes to one.",
        kernel.preemption,
    ),
    Check("timers", "Without high-resolution timers a cycle wakes up at the next tick only.", kernel.timers),
    Check("clock source", "A slow clock costs microseconds at each of the cycle's looks at it.", kernel.clock_source),
    Check(
        "moved pages",
        "A page that the kernel moves faults at its next use, even if it is locked.",
        kernel.moved_pages,
    ),
    Check("trace events", "`rtarm why-late` reads them, to say what kept a late cycle waiting.", kernel.trace_events),
    Check(
        "clock governor",
        "A processor that slows its clock down between cycles begins each of them slowly.",
        processors.governor,
    ),
    Check(
        "sleep states",
        "From a deep sleep a processor needs tens to hundreds of µs to wake up.",
        processors.sleep_states,
    ),
    Check(
        "own processor",
        "On a processor that nobody else uses there is nothing to wait for.",
        processors.own_processor,
    ),
    Check("interrupts", "An interrupt on the cycle's processor delays the cycle.", processors.interrupts),
    Check("load", "Caches, memory and the ROS process are shared with whatever else runs.", processors.load),
    Check("heat", "A hot processor is slowed down, or stopped for moments, whatever runs on it.", processors.heat),
    Check(
        "virtual machine",
        "The host stops a virtual processor when it wants to, and passes USB on late.",
        processors.virtual_machine,
    ),
    Check(
        "container",
        "A limit of processor time stops the ROS process for up to 100 ms at a stretch, and permissions are cut.",
        permissions.container,
    ),
    Check("swap", "A process that was swapped out waits for the disk.", memory.swap),
    Check("shared memory", "The arm's memory files lie there, and the middleware's too.", memory.shared_memory),
    Check("disk", "A full disk leaves no room for compiled code, and every start compiles anew.", memory.disk),
    Check("adapter's port", "The arm is reached through it.", adapters.port),
    Check(
        "latency timer",
        "An FTDI chip holds received bytes back for so long, 16 ms as it comes; rtarm wants each cycle's at once.",
        adapters.latency_timer,
    ),
    Check(
        "serial workers",
        "Received bytes wait for a thread of the kernel, which a busy program keeps from its turn for 3 ms and more.",
        adapters.serial_workers,
    ),
    Check("USB power", "An adapter that was put to sleep answers late, or disappears.", adapters.usb_power),
    Check("port grabbers", "They speak to adapters that are none of theirs, or take them over.", adapters.grabbers),
    Check(
        "CAN interface",
        "A queue shorter than a cycle's frames loses some, and an interface in trouble sends none.",
        adapters.can_bus,
    ),
    Check("ROS network", "MoveIt finds the arm through it.", software.ros),
    Check("Python", "The cycle is compiled by numba from Python.", software.python),
    Check("compiled cycle", "The first start waits for the compiler.", software.compiled_cycle),
)
