"""The table of modes in docs/explanation/architecture.md is that of rtloop.memory.modes."""

import re
from pathlib import Path

from rtloop.memory.modes import ALLOWED

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "architecture.md"


def test_the_table_of_modes_is_that_of_the_code() -> None:
    section = PAGE.read_text(encoding="utf-8").split("\n## Modes\n")[1].split("\n## ")[0]
    rows = [line.split("|")[1:3] for line in section.splitlines() if line.startswith("| `")]
    written = {re.findall(r"`(\w+)`", mode)[0]: re.findall(r"`(\w+)`", to) for mode, to in rows}
    assert written == {mode.name.lower(): [to.name.lower() for to in goes_to] for mode, goes_to in ALLOWED.items()}
