"""A recording as a picture: of every size of arm, beside the recording, over nothing but a picture of ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result
from virtual import VirtualArm, recording_of

from rtarm.recording import mcap_writer, plot
from rtarm.recording.mcap_format import Loaded, Reason
from rtarm.recording.story import UNLED
from shm.recording import Recording, record_dtype
from shm.words import Fault

Rtarm = Callable[..., Result]
NOW = Reason("asked", "Asked for by a person.")
BEGINNINGS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@pytest.fixture(scope="module")
def moving() -> Recording:
    return recording_of(VirtualArm.amid("large", 200))


@pytest.fixture
def a_file(moving: Recording, tmp_path: Path) -> Path:
    path = tmp_path / "moving.mcap"
    mcap_writer.write(moving, NOW, path)
    return path


def with_joints(recording: Recording, count: int) -> Recording:
    """The same of an arm of so many joints, all like the first of it."""
    records = np.zeros(len(recording.records), record_dtype(count))
    for name in records.dtype.names or ():
        if name != "joints":
            records[name] = recording.records[name]
    records["joints"] = recording.records["joints"][:, np.arange(count) % len(recording.joints)]
    return Recording(
        **{**vars(recording), "records": records, "joints": tuple(f"${number}^joint" for number in range(count))}
    )


@pytest.mark.parametrize("count", [1, 6, 9, 32])
def test_every_joint_has_its_two_panels(moving: Recording, count: int) -> None:
    figure = plot.draw(Loaded(with_joints(moving, count), NOW, ""))
    figure.canvas.draw()
    assert len(figure.axes) == 2 * count + 2
    lines = [axes for axes in figure.axes if len(axes.lines) >= 2]
    assert len(lines) >= count
    named = [axes.get_ylabel().partition("\n")[0].replace("\\", "") for axes in figure.axes]
    assert [name for name in named if name.endswith("joint")] == [f"${number}^joint" for number in range(count)]


def test_what_is_drawn_is_what_was_commanded_and_measured(moving: Recording) -> None:
    figure = plot.draw(Loaded(moving, NOW, ""))
    position = next(axes for axes in figure.axes if axes.get_ylabel().startswith("joint2"))
    commanded, measured = position.lines[:2]
    rows = moving.records["joints"][:, 1]
    led = ~np.isin(moving.records["mode"], UNLED)
    assert led.any() and not led.all()
    ought_deg = np.degrees(np.where(led, rows["commanded_position_rad"], np.nan))
    assert np.array_equal(commanded.get_ydata(), ought_deg, equal_nan=True)
    assert set(measured.get_ydata()) <= set(np.degrees(rows["measured_position_rad"]))


def test_modes_and_faults_are_marked(moving: Recording) -> None:
    records = moving.records.copy()
    at = len(records) - 50
    records["fault"][at:], records["fault_ns"][at:] = Fault.WIRE, records["monotonic_ns"][at]
    events = moving.events[:1].copy()
    events["kind"], events["code"], events["monotonic_ns"] = 2, Fault.WIRE, records["monotonic_ns"][at]
    figure = plot.draw(Loaded(Recording(**{**vars(moving), "records": records, "events": events}), NOW, "torn"))
    for axes in figure.axes:
        (mark,) = [line for line in axes.lines if line.get_linestyle() == "--" and len(line.get_xdata()) == 2]
        assert list(mark.get_xdata()) == [0.0, 0.0]  # times count from the fault
    words = [text.get_text() for text in figure.axes[0].texts]
    assert "executing" in words
    assert "The file is damaged: torn" in figure.get_suptitle()


def test_no_peak_is_lost_in_a_long_recording() -> None:
    values = np.zeros(1_000_000)
    values[[123_456, 654_321]] = [5.0, -7.0]
    times, shown = plot._thinned(np.arange(1_000_000.0), values)
    assert len(shown) <= plot.MOST_POINTS + 1000
    assert (shown.max(), shown.min()) == (5.0, -7.0)
    assert np.all(np.diff(times) >= 0)


@pytest.mark.parametrize("suffix", plot.FORMATS)
def test_a_picture_is_written_and_written_again(rtarm: Rtarm, a_file: Path, suffix: str) -> None:
    path = a_file.with_suffix(suffix)
    for _ in range(2):
        result = rtarm("plot", str(a_file), "-o", str(path))
        assert (result.exit_code, result.stdout.strip(), result.stderr) == (0, str(path), "")
    assert path.read_bytes().startswith(BEGINNINGS[suffix])
    assert sorted(one.name for one in a_file.parent.iterdir()) == sorted([a_file.name, path.name])


def test_it_lies_beside_the_recording(rtarm: Rtarm, a_file: Path) -> None:
    result = rtarm("plot", str(a_file))
    assert (result.exit_code, result.stdout.strip()) == (0, str(a_file.with_suffix(".png")))


@pytest.mark.parametrize(
    ("make_it", "said"),
    [
        (lambda path: path.write_text("mine"), "is there and no picture of `rtarm plot`, so it is kept"),
        (lambda path: path.mkdir(), "is a folder: name a file in it"),
        (lambda path: path.symlink_to("/dev/null"), "is a link, a device or a pipe"),
    ],
    ids=["text", "folder", "link"],
)
def test_nothing_but_a_picture_of_ours_is_replaced(
    rtarm: Rtarm, a_file: Path, make_it: Callable[[Path], None], said: str
) -> None:
    path = a_file.with_suffix(".png")
    make_it(path)
    before = path.lstat()
    result = rtarm("plot", str(a_file))
    assert (result.exit_code, result.stdout) == (1, "")
    assert said in result.stderr and len(result.stderr.splitlines()) == 1
    assert path.lstat() == before


def test_a_name_that_is_no_picture_is_refused(rtarm: Rtarm, a_file: Path) -> None:
    result = rtarm("plot", str(a_file), "-o", "picture.gif")
    assert (result.exit_code, "let it end in .png, .svg or .pdf" in result.stderr) == (1, True)


def test_a_folder_that_is_not_there_is_refused(rtarm: Rtarm, a_file: Path) -> None:
    result = rtarm("plot", str(a_file), "-o", str(a_file.parent / "none" / "a.png"))
    assert (result.exit_code, "cannot be written (No such file or directory)" in result.stderr) == (1, True)
