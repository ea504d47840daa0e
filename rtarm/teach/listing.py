"""`rtarm motions`: what motions are kept."""

from __future__ import annotations

from typing import Any

from rich.table import Table
from rich.text import Text

from rtarm.console.errors import Refusal
from rtarm.teach.file import folder, kept, load


def motions() -> list[dict[str, Any]]:
    """Each kept motion by its name; of one that cannot be played the sentence that says why, as `problem`."""
    rows: list[dict[str, Any]] = []
    for path in kept():
        row: dict[str, Any] = {"name": path.stem, "file": str(path)}
        try:
            motion = load(path)
        except Refusal as refused:
            rows.append({**row, "problem": refused.sentence})
            continue
        rows.append(
            {
                **row,
                "arm": motion.arm,
                "joints": list(motion.limits.joints),
                "duration_s": round(motion.duration_s, 3),
                "taught": motion.taught,
            }
        )
    return rows


def table(rows: list[dict[str, Any]]) -> Table | str:
    """The same for people."""
    if not rows:
        return f"No motions are kept in {folder()}: teach one with `rtarm teach NAME`."
    drawn = Table("motion", "arm", "joints", "lasts", "taught", title=f"Motions in {folder()}")
    for row in rows:
        if "problem" in row:
            cells = row["name"], "", row["problem"], "", ""
        else:
            cells = (
                row["name"],
                row["arm"],
                ", ".join(row["joints"]),
                f"{row['duration_s']:.1f} s",
                row["taught"][:16].replace("T", " "),
            )
        drawn.add_row(*map(Text, cells))  # what a file says is no markup
    return drawn
