"""Checks of the processors: how fast they run, how deep they sleep, and what else uses them."""

from __future__ import annotations

import contextlib
import re

from config.schema import ArmConfig
from rtarm.doctor import adapters
from rtarm.doctor.finding import Found, Write, bad, note, ok, warn
from rtarm.doctor.kernel import boot_with
from rtarm.doctor.machine import Machine, Unknown
from rtarm.doctor.permissions import granted, in_container, wanted

CPU = "/sys/devices/system/cpu"
STEADY_GOVERNOR = "performance"
RAISING_GOVERNOR = "schedutil"
"""Goes to the highest clock whenever a real-time thread runs."""
QUICK_WAKE_US = 20
MUCH_STEAL = 0.01
STEAL_FIELD = 7
COUNTED_FIELDS = 8
"""The first eight times of /proc/stat are all the time there is; guests' time is part of the first two."""
LATENCY_RULE = (
    r"""echo 'KERNEL=="cpu_dma_latency", GROUP="dialout", MODE="0660"' | sudo tee /etc/udev/rules.d/90-rtarm.rules"""
    " && sudo udevadm control --reload && sudo udevadm trigger --name-match=cpu_dma_latency"
)


def _processors(machine: Machine) -> list[str]:
    return [name for name in machine.names(CPU) if re.fullmatch(r"cpu[0-9]+", name)]


def governor(machine: Machine, _arm: ArmConfig | None) -> Found:
    files = [f"{CPU}/{name}/cpufreq/scaling_governor" for name in _processors(machine)]
    found = {file: machine.text(file) for file in files if machine.exists(file)}
    if not found:
        return note("unknown: the kernel does not govern the clock here (the firmware or the host does)")
    said = ", ".join(sorted(set(found.values())))
    fix = tuple(Write(file, STEADY_GOVERNOR) for file, name in found.items() if name != STEADY_GOVERNOR)
    if not fix:
        return ok(said)
    if set(found.values()) <= {STEADY_GOVERNOR, RAISING_GOVERNOR}:
        return note(f"{said} (raises the clock while real-time threads run)", fix=fix)
    return warn(said, fix=fix)


def sleep_states(machine: Machine, arm: ArmConfig | None) -> Found:
    latency_us, deepest = _deepest_sleep(machine)
    sleep = f"deepest sleep {deepest}, {latency_us} µs to wake up from" if deepest else "no sleep states"
    refusal = granted(machine, arm).latency_refusal
    if refusal is None:
        return ok(f"{sleep}; the control process may forbid it while it runs")
    said = f"{sleep}; /dev/cpu_dma_latency may not be held ({refusal})"
    if latency_us <= QUICK_WAKE_US:
        return ok(said)
    mend = "# start the container with: docker run --device=/dev/cpu_dma_latency …"
    return warn(said, mend if in_container(machine) else LATENCY_RULE)


def _deepest_sleep(machine: Machine) -> tuple[int, str]:
    """Time to wake up (µs) and name of the deepest sleep state that is allowed."""
    states = []
    for processor in _processors(machine):
        folder = f"{CPU}/{processor}/cpuidle"
        for state in machine.names(folder) if machine.exists(folder) else []:
            if not machine.exists(f"{folder}/{state}/disable") or machine.number(f"{folder}/{state}/disable") == 0:
                states.append((machine.number(f"{folder}/{state}/latency"), machine.text(f"{folder}/{state}/name")))
    return max(states, default=(0, ""))


def own_processor(machine: Machine, arm: ArmConfig | None) -> Found:
    online = machine.cpus(f"{CPU}/online")
    isolated = machine.cpus(f"{CPU}/isolated") if machine.exists(f"{CPU}/isolated") else frozenset()
    cpu = wanted(arm).cpu
    if cpu is None:
        if isolated:
            said = f"{_listed(isolated)} isolated, but the arm file leaves realtime.cpu out"
            return note(said, f"# in the arm file: realtime: {{cpu: {max(isolated)}}}")
        if len(online) < 4:
            return ok(f"any of {_listed(online)}; too few to give one away")
        last = max(online)
        given = f"{_isolation(machine, last)}\n# and in the arm file: realtime: {{cpu: {last}}}"
        return note(f"any of {_listed(online)}; none is isolated", given)
    refusal = granted(machine, arm).cpu_refusal
    if cpu not in online or refusal is not None:
        why = f"may not be used ({refusal})" if cpu in online else f"is not there, only {_listed(online)}"
        return bad(f"realtime.cpu is {cpu}, which {why}", "# in the arm file: leave realtime.cpu out, or name another")
    if cpu in isolated:
        return ok(f"{cpu}, isolated")
    return note(f"{cpu}, not isolated: others may run there too", _isolation(machine, cpu))


def _isolation(machine: Machine, cpu: int) -> str:
    parameters = f"isolcpus=managed_irq,domain,{cpu} nohz_full={cpu} rcu_nocbs={cpu} irqaffinity=0"
    return boot_with(machine, parameters if cpu else parameters.removesuffix(" irqaffinity=0"))


def _listed(cpus: frozenset[int]) -> str:
    return ("CPU " if len(cpus) == 1 else "CPUs ") + (", ".join(str(cpu) for cpu in sorted(cpus)) or "none")


def interrupts(machine: Machine, arm: ArmConfig | None) -> Found:
    cpu = wanted(arm).cpu
    numbers = [name for name in machine.names("/proc/irq") if name.isdecimal()]
    own: list[str] = []
    with contextlib.suppress(Unknown):  # the adapter is not plugged in, as "adapter's port" says
        own = adapters.interrupt_numbers(machine, arm)
    said = [f"adapter's interrupt {irq} on CPU {_cpus_of(machine, irq)}" for irq in own]
    balancing = "irqbalance" in machine.process_names().values()
    said.append("irqbalance moves interrupts" if balancing else "no irqbalance")
    if cpu is None:
        return ok(", ".join(said))
    if balancing:
        keep_off = f"echo IRQBALANCE_BANNED_CPULIST={cpu} | sudo tee -a /etc/default/irqbalance"
        return warn(f"{', '.join(said)}, also to CPU {cpu}", f"{keep_off} && sudo systemctl restart irqbalance")
    disturbing = [irq for irq in numbers if irq not in own and _cpus_of(machine, irq) == str(cpu)]
    if not disturbing:
        return ok(", ".join([*said, f"no other interrupt on CPU {cpu} alone"]))
    others = sorted(machine.cpus(f"{CPU}/online") - {cpu})
    if not others:
        return ok(", ".join([*said, "there is one processor for all"]))
    targets = " ".join(f"/proc/irq/{irq}/smp_affinity_list" for irq in disturbing)
    return note(
        ", ".join([*said, f"interrupts {', '.join(disturbing)} arrive on CPU {cpu}"]),
        f"echo {','.join(map(str, others))} | sudo tee {targets}",
    )


def _cpus_of(machine: Machine, irq: str) -> str:
    for name in ("effective_affinity_list", "smp_affinity_list"):
        with contextlib.suppress(Unknown):
            found = machine.text(f"/proc/irq/{irq}/{name}")
            if found:
                return found
    return "unknown"


def load(machine: Machine, _arm: ArmConfig | None) -> Found:
    count = len(machine.cpus(f"{CPU}/online"))
    words = machine.text("/proc/loadavg").split()
    try:
        average = float(words[0])
    except (ValueError, IndexError):
        raise Unknown("/proc/loadavg cannot be understood") from None
    said = f"{count} processor{'s' if count != 1 else ''}, load {average:.2f}"
    if count == 1:
        return warn(said, "# use a machine with two processors or more: the ROS process and interrupts need one")
    return note(said, "top   # says who") if average > count else ok(said)


def heat(machine: Machine, _arm: ArmConfig | None) -> Found:
    throttled = 0
    counted = False
    for processor in _processors(machine):
        for name in ("core_throttle_count", "package_throttle_count"):
            file = f"{CPU}/{processor}/thermal_throttle/{name}"
            if machine.exists(file):
                counted, throttled = True, max(throttled, machine.number(file))
    hot = _hot_zones(machine)
    mend = "# clean fans and heat sinks, give the machine air, or lower its highest clock"
    if hot:
        return warn(", ".join(hot), mend)
    if throttled:
        return warn(f"throttled {throttled} times since the machine was started", mend)
    if counted:
        return ok("never throttled since the machine was started")
    if _zones(machine):
        return ok("cooler than where throttling begins")
    return note("unknown: the kernel shows neither counters nor temperatures")


def _zones(machine: Machine) -> list[str]:
    folder = "/sys/class/thermal"
    names = machine.names(folder) if machine.exists(folder) else []
    return [f"{folder}/{name}" for name in names if name.startswith("thermal_zone")]


def _hot_zones(machine: Machine) -> list[str]:
    """Thermal zones at or above the temperature at which the kernel slows the processors down."""
    found = []
    for zone in _zones(machine):
        for name in machine.names(zone):
            with contextlib.suppress(Unknown):  # some sensors cannot be read at times
                if re.fullmatch(r"trip_point_[0-9]+_type", name) and machine.text(f"{zone}/{name}") == "passive":
                    limit = machine.number(f"{zone}/{name.removesuffix('type')}temp")
                    now = machine.number(f"{zone}/temp")
                    if 0 < limit <= now:
                        kind = machine.text(f"{zone}/type")
                        found.append(f"{kind} {now / 1000:.0f} °C, slowed down from {limit / 1000:.0f}")
    return found


def virtual_machine(machine: Machine, _arm: ArmConfig | None) -> Found:
    stolen = _stolen_share(machine)
    kind = _virtual_kind(machine)
    if kind is None and stolen == 0:
        return ok("none")
    said = f"{kind or 'unnamed hypervisor'}, {stolen:.2%} of the time taken by the host since the start"
    pin = "# on the host: give each virtual CPU a processor of its own, or run the arm on a real machine"
    return warn(said, pin) if stolen > MUCH_STEAL else note(said, pin)


def _virtual_kind(machine: Machine) -> str | None:
    if "microsoft" in machine.text("/proc/version").lower():
        return "WSL"
    if re.search(r"^flags\s*:.*\bhypervisor\b", machine.text("/proc/cpuinfo"), re.MULTILINE):
        return "virtual machine"
    with contextlib.suppress(Unknown):
        return machine.text("/sys/hypervisor/type")
    return "virtual machine" if machine.exists("/proc/device-tree/hypervisor") else None


def _stolen_share(machine: Machine) -> float:
    words = machine.text("/proc/stat").split()[1 : 1 + COUNTED_FIELDS]
    if len(words) < COUNTED_FIELDS or not all(re.fullmatch("[0-9]{1,20}", word) for word in words):
        raise Unknown("/proc/stat cannot be understood")
    times = [int(word) for word in words]
    return times[STEAL_FIELD] / max(sum(times), 1)
