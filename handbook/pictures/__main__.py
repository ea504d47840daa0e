"""`python -m handbook.pictures FOLDER` draws the pictures into a folder, which is docs/pictures (`make reference`)."""

from __future__ import annotations

import sys
from pathlib import Path

from handbook.pictures import PICTURES


def main(folder: str) -> None:
    """Draw every picture."""
    for name, draw in PICTURES.items():
        Path(folder, name).write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
