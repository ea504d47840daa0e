"""The soak's own judgement: it finds what grows, and nothing where nothing does."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from soak import Record, Sample, growth, report

HOUR_S = 3600.0


def samples(
    *, seconds: float, mb_per_hour: float = 0.0, files_per_hour: float = 0.0, shm_mb_per_hour: float = 0.0, pid: int = 7
) -> list[Sample]:
    """One process that grows, in the noise of a real one."""
    noise = np.random.default_rng(1)
    found = []
    for at_s in np.arange(0.0, seconds, 5.0):
        hours = at_s / HOUR_S
        of = {
            "pid": pid,
            "own_mb": 50.0 + mb_per_hour * hours + noise.normal(0.0, 0.2),
            "pss_mb": 60.0,
            "files": 20 + int(files_per_hour * hours),
            "threads": 3,
        }
        shm_mb = 10.0 + shm_mb_per_hour * hours
        found.append(Sample(float(at_s), {"front": of}, shm_mb, (10.0, 50.0, 900.0), 600, 0))
    return found


def test_what_stays_as_it_is_is_flat() -> None:
    rows, leaks = growth(samples(seconds=HOUR_S))
    assert leaks == []
    assert any("front (7) | own_mb" in row and "flat" in row for row in rows)


@pytest.mark.parametrize(
    ("grows", "what"),
    [
        ({"mb_per_hour": 12.0}, "own_mb grows"),
        ({"files_per_hour": 20.0}, "files grows"),
        ({"shm_mb_per_hour": 12.0}, "/dev/shm"),
    ],
)
def test_what_grows_is_found(grows: dict[str, float], what: str) -> None:
    _, leaks = growth(samples(seconds=HOUR_S, **grows))
    assert len(leaks) == 1
    assert what in leaks[0]
    text, well = report(Record(samples=samples(seconds=HOUR_S, **grows)), 60.0, 1, [])
    assert not well
    assert "FAILED" in text


def test_what_is_given_back_in_between_does_not_grow() -> None:
    """Found by a soak of 60 minutes: two levels, taken in turn, the higher one more often towards the end."""
    found = samples(seconds=HOUR_S)
    for number, sample in enumerate(found):
        if number > 360 and number % 5:
            sample.of["front"]["own_mb"] += 10.5
    assert growth(found)[1] == []


def test_a_short_life_is_judged_by_nothing() -> None:
    assert growth(samples(seconds=160.0, mb_per_hour=1000.0)) == ([], [])


@pytest.mark.parametrize(("mb_per_hour", "found"), [(0.0, 0), (60.0, 1)])
def test_many_short_lives_are_judged_together(mb_per_hour: float, found: int) -> None:
    many = []
    for pid in range(8):
        life = samples(seconds=280.0, mb_per_hour=mb_per_hour, pid=pid)
        many += [Sample(s.at_s + 300.0 * pid, s.of, s.shm_mb, s.lateness_us, s.cycles, s.missed) for s in life]
    rows, leaks = growth(many)
    assert any("front (8 lives) | own_mb" in row for row in rows)
    assert len([leak for leak in leaks if "own_mb" in leak]) == found
