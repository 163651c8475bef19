"""Laps of real karts that others recorded, against the times their loggers stored. Fixes alone, to be quick."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother import api
from smoother.arrays import Array
from smoother.cli.pipeline import calibrated, read
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.results import FixPath, GivenLines, Lap, LapAnalysis
from smoother.laps.stage import Stated, fix_path, options_on
from smoother.laps.tracks import TrackFile, line_from_text, load_tracks
from smoother.samples import Session
from smoother.trajectory import Trajectory

# of the recordings' own timing lines, VBO minutes turned into degrees
LIGNANO = line_from_text("45.732813667,13.073286833;45.732663833,13.073297667")
MASSA = line_from_text("44.831659,11.223826;44.831816383,11.223441617")


def smoothed(directory: Path) -> tuple[Session, Trajectory]:
    session = calibrated(read(directory), directory)
    return session, api.smooth(session, imu=False)


def stored(directory: Path, name: str, column: str = "lap_time_s") -> Array:
    return pl.read_csv(directory / name, comment_prefix="#")[column].to_numpy()


def line_at(path: FixPath, times: Array) -> Array:
    """Ends (2, 2) m of a line of 20 m across the way, through where the path was in the median of some times (K,) s."""
    before, at, after = (
        np.stack([np.interp(times + by, path.t, axis) for axis in path.position_n.T], axis=-1)
        for by in (-0.2, 0.0, 0.2)
    )
    ahead = np.median(after - before, axis=0)
    across = 10.0 * np.array([-ahead[1], ahead[0]]) / np.linalg.norm(ahead)
    return np.median(at, axis=0) + np.stack([across, -across])


def analysed(session: Session, trajectory: Trajectory, *tracks: TrackFile) -> LapAnalysis:
    return analyse(trajectory, fix_path(session), options_on(trajectory, session.origin, Stated(tracks)))


def timed(analysis: LapAnalysis) -> list[Lap]:
    return [lap for lap in analysis.laps if lap.is_timed]


def test_okc_gives_the_thirteen_laps_its_logger_stored(data_directory: Path) -> None:
    directory = data_directory / "kart_okc_doves"
    session, trajectory = smoothed(directory)
    tracks = load_tracks(directory / "track_OKC.json")
    given, found = analysed(session, trajectory, *tracks), analyse(trajectory, fix_path(session), LapOptions())
    times = stored(directory, "laps_logged.csv")
    assert given.track == "Normal"  # of the three layouts of the file
    assert [lap.time for lap in timed(given)] == pytest.approx(times, abs=0.030)
    assert [lap.raw_time for lap in timed(given)] == pytest.approx(times, abs=0.005)
    assert len(timed(found)) == 13


@pytest.mark.parametrize(
    ("name", "line", "limit"),
    [("kart_lignano_racebox", LIGNANO, 0.03), ("kart_massafinalese_racechrono", MASSA, 0.01)],
)
def test_no_lap_of_a_recording_is_missing(data_directory: Path, name: str, line: TrackFile, limit: float) -> None:
    session, trajectory = smoothed(data_directory / name)
    laps = timed(analysed(session, trajectory, line))
    times = stored(data_directory / name, "laps_from_gps.csv")
    assert len(laps) == len(times)
    assert np.abs(np.array([lap.time for lap in laps]) - times).max() < limit
    slow = times > 1.5 * np.median(times)
    assert [("pit" in lap.reasons) for lap in laps] == slow.tolist()


def test_adria_has_its_five_laps_with_nothing_given_and_their_times_where_its_logger_timed(
    data_directory: Path,
) -> None:
    directory = data_directory / "kart_adria_first_half"
    session, trajectory = smoothed(directory)
    path = fix_path(session)
    assert len(timed(analyse(trajectory, path, LapOptions()))) == 5
    times, starts = stored(directory, "laps_logged.csv"), stored(directory, "laps_logged.csv", "start_s")
    line = GivenLines(line_at(path, starts))
    laps = timed(analyse(trajectory, path, LapOptions(lines=line)))
    assert [lap.time for lap in laps] == pytest.approx(
        times, abs=0.1
    )  # its line is not stored, only when it was passed
