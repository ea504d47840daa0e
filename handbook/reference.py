"""The reference pages, each with the function that makes it."""

from collections.abc import Callable

from handbook import commands, configuration, faults, figures, memory, ros, stability, states

PAGES: dict[str, Callable[[], str]] = {
    "commands.md": commands.build,
    "configuration.md": configuration.build,
    "faults.md": faults.build,
    "figures.md": figures.build,
    "memory.md": memory.build,
    "ros.md": ros.build,
    "stability.md": stability.build,
    "states.md": states.build,
}
