"""`python -m handbook FOLDER` writes the reference pages into a folder, which is docs/reference (`make reference`)."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from handbook.reference import PAGES


def main(folder: str) -> None:
    """Write every page."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"  # nobody need hear of the node that is asked what it offers
    for name, build in PAGES.items():
        Path(folder, name).write_text(build(), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
