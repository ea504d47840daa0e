"""A recording played back in the page, in a real browser."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, DRIVER, Browser
from stack import Process
from virtual import VirtualArm

from rtarm.recording import mcap_writer
from rtarm.recording.mcap_format import Reason
from rtarm.recording.mcap_reader import read
from shm.recording import read_recording
from shm.words import Mode

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(CHROMIUM is None or DRIVER is None, reason="needs Debian's chromium and chromium-driver"),
]


PICTURES = os.environ.get("RTARM_PICTURES")
SPEED, FILM_SPEED = 0.005, 0.012
"""So slow that a busy machine's browser shows the goal in many pictures."""
FILM_BYTES = 600_000


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A goal of episode1 from its beginning to its end, without what was before: the page plays it very slowly."""
    arm = VirtualArm.at_start_of("large")
    arm.play("large")
    arm.end_of(1)
    path = tmp_path_factory.mktemp("page") / "done.mcap"
    whole = read_recording(arm.state)
    records = whole.records[np.argmax(whole.records["mode"] == Mode.EXECUTING) :]
    mcap_writer.write(replace(whole, records=records), Reason("asked", "Asked for by a person."), path)
    arm.close()
    return path


@contextmanager
def playing(recording: Path, speed: float) -> Iterator[str]:
    """The address of a page that plays a recording."""
    with closing(Process("rtarm", "replay", str(recording), "--view", "--speed", str(speed))) as replay:
        yield re.search(r"http://\S+", replay.line_with("plays the recording of episode1")).group()


@pytest.fixture
def page(recorded: Path) -> Iterator[str]:
    """The address of the page that plays it."""
    with playing(recorded, SPEED) as address:
        yield address


@pytest.mark.skipif(PICTURES is None, reason="only with RTARM_PICTURES=docs/pictures")
def test_the_moving_picture_of_the_readme(recorded: Path) -> None:
    path = Path(str(PICTURES), "goal.webp")
    with closing(Browser()) as browser, playing(recorded, FILM_SPEED) as address:
        browser.open(address)
        browser.until(lambda: browser.text("#rt-mode") == "executing")
        browser.film(path, lambda: browser.text("#rt-mode") == "executing", FILM_SPEED)
    assert path.stat().st_size < FILM_BYTES


def test_a_recording_plays_in_the_browser_and_nothing_there_moves_an_arm(page: str, recorded: Path) -> None:
    positions_deg = np.degrees(read(recorded).recording.records["joints"]["measured_position_rad"][:, 0])
    shown_deg: set[float] = set()
    with closing(Browser()) as browser:
        browser.open(page)
        browser.until(lambda: browser.text("#rt-mode") == "executing")

        def goes_on() -> bool:
            shown_deg.add(float(browser.text("[data-measured=joint1]")))
            return len(shown_deg) > 5

        browser.until(goes_on)
        assert positions_deg.min() - 0.006 <= min(shown_deg) and max(shown_deg) <= positions_deg.max() + 0.006
        assert not {"Go there", "Hold", "Stop"} & set(browser.buttons())
