"""What keeps a thread from its work: one cause for each nanosecond, and the word for it."""

from __future__ import annotations

from enum import Enum


class Cause(Enum):
    """The value is the name in JSON."""

    TIMER_IDLE = "timer_late_out_of_idle"
    MASKED = "interrupts_off"
    STOOD_STILL = "machine_stood_still"
    INTERRUPT = "interrupt"
    SOFTIRQ = "softirq"
    TASK = "other_task"
    IDLE_EXIT = "out_of_idle"
    MIGRATION = "migration"
    PAGE_FAULT = "page_fault"
    STOPPED = "stopped"
    BLOCKED = "blocked"
    OWN = "own_work"
    UNKNOWN = "unknown"


WORDS: dict[Cause, str] = {
    Cause.TIMER_IDLE: "timer late out of idle",
    Cause.MASKED: "interrupts off, or the machine stood still",
    Cause.STOOD_STILL: "the host took the processor away",
    Cause.INTERRUPT: "interrupt",
    Cause.SOFTIRQ: "softirq",
    Cause.TASK: "another task",
    Cause.IDLE_EXIT: "woken, coming out of idle",
    Cause.MIGRATION: "moved to another processor",
    Cause.PAGE_FAULT: "page fault",
    Cause.STOPPED: "stopped",
    Cause.BLOCKED: "waited within the kernel",
    Cause.OWN: "our own work",
    Cause.UNKNOWN: "unknown",
}
MEANINGS: dict[Cause, str] = {
    Cause.TIMER_IDLE: "The processor was idle when the cycle was due, and its timer interrupt came late.",
    Cause.MASKED: "The processor was in the named task when the cycle was due, and took no timer interrupt.",
    Cause.STOOD_STILL: "Nothing happened on the processor, and the host counted time that it took (steal).",
    Cause.INTERRUPT: "The handler of an interrupt ran on the cycle's processor.",
    Cause.SOFTIRQ: "Work that an interrupt had left behind ran on the cycle's processor.",
    Cause.TASK: "The cycle was ready to run, and the named task had its processor.",
    Cause.IDLE_EXIT: "The cycle was ready to run, and its processor was still on the way out of idle.",
    Cause.MIGRATION: "The same, on another processor than before.",
    Cause.PAGE_FAULT: "The cycle touched a page that the kernel had to fetch first.",
    Cause.STOPPED: "A signal or a debugger had stopped the process.",
    Cause.BLOCKED: "The cycle waited in a system call for something else than its timer.",
    Cause.OWN: "The cycle itself ran: what it computes, or its way out of the sleep.",
    Cause.UNKNOWN: "What was seen does not tell.",
}
