"""When results beside a session are taken as they are, and when they are made anew."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from smoother.cli.pipeline import Options, files_beside, smooth_session
from smoother.cli.results import results_of

LONG_AGO = 1.6e9


def replaced_by_an_older_one(session: Path) -> None:
    path = session / "gps.csv"
    rows = path.read_text().splitlines(keepends=True)
    path.write_text("".join(rows[:-20]))
    os.utime(path, (LONG_AGO, LONG_AGO))


def an_older_one_came(session: Path) -> None:
    path = session / "session.toml"
    path.write_text('[session]\ntitle = "wet"\n')
    os.utime(path, (LONG_AGO, LONG_AGO))


def calibrated_above(session: Path) -> None:
    (session.parent / "calibration.toml").write_text("")
    os.utime(session.parent / "calibration.toml", (LONG_AGO, LONG_AGO))


@pytest.fixture
def smoothed(monday: Path) -> Path:
    """A session of a real box, so without its truth, that nobody calibrated."""
    for name in ("truth.csv", "calibration.toml"):
        (monday / name).unlink(missing_ok=True)
    smooth_session(monday, None, Options(baseline=False, figures=False))
    return monday


def written(session: Path) -> int:
    return (session / "smoothed" / "summary.json").stat().st_mtime_ns


def test_results_of_what_is_there_are_taken_as_they_are(smoothed: Path) -> None:
    before = written(smoothed)
    assert results_of(smoothed) == (smoothed / "smoothed", True)
    assert written(smoothed) == before
    document = json.loads((smoothed / "smoothed" / "summary.json").read_text())
    assert document["files"] == files_beside(smoothed)


@pytest.mark.parametrize(
    "change", [lambda s: (s / "mag.csv").unlink(), replaced_by_an_older_one, an_older_one_came, calibrated_above]
)
def test_results_are_made_anew_where_a_file_came_or_went_or_is_another(
    smoothed: Path, change: Callable[[Path], None]
) -> None:
    before = written(smoothed)
    change(smoothed)
    results_of(smoothed)
    assert written(smoothed) > before
    now = written(smoothed)
    results_of(smoothed)
    assert written(smoothed) == now


def test_results_of_an_earlier_version_count_by_their_time(smoothed: Path) -> None:
    path = smoothed / "smoothed" / "summary.json"
    document = json.loads(path.read_text())
    del document["files"]
    path.write_text(json.dumps(document))
    before = written(smoothed)
    results_of(smoothed)
    assert written(smoothed) == before
