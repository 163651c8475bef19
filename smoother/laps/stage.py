"""The lap analysis of a session: what is stated about the track, the analysis, and its tables. Heavy imports are inside
the functions, so that the command line starts quickly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from smoother.errors import ConfigError, SmootherError, UsageError

if TYPE_CHECKING:
    from smoother.arrays import Array
    from smoother.config import SessionConfig
    from smoother.frames import Origin
    from smoother.laps.analysis import LapOptions
    from smoother.laps.document import LapColumns
    from smoother.laps.own_lines import OwnLine
    from smoother.laps.results import FixPath, LapAnalysis
    from smoother.laps.sigma import Drift
    from smoother.laps.tracks import TrackFile
    from smoother.samples import Problem, Session
    from smoother.trajectory import Trajectory

LAPS, OFFICIAL = "laps.csv", "official.csv"
LEAST_RATE = 25.0  # Hz; at lower rates interpolation errs by centimetres
USUAL_RATE = 50.0  # Hz; higher rates do not improve laps
Document = dict[str, object]


def steps(rate: float) -> int:
    """Return the multiple of `rate` at which the session has to be estimated for lap timing."""
    return 1 if rate >= LEAST_RATE else int(-(-LEAST_RATE // rate))


@dataclass(frozen=True)
class Stated:
    """Stated tracks and official times of a session, checked before smoothing.

    problems : of statements that could not be used.
    """

    tracks: tuple[TrackFile, ...] = ()
    official: tuple[float, ...] = ()
    own: tuple[OwnLine, ...] = ()
    problems: tuple[Problem, ...] = ()


def read_stated(config: SessionConfig, directory: Path, recording: Path | None = None) -> Stated:
    """Return tracks and times of session.toml and official.csv, and without a track those of the recording.

    Raises SmootherError when a named file is unusable.
    """
    tracks = () if config.track is None else _named(config.track, directory)
    own = () if tracks or recording is None else _own(recording)
    official = _official(directory / OFFICIAL) or (() if recording is None else _of_beacon(recording))
    return Stated(tracks, official, own, () if tracks else _only_a_name(config.track))


def _named(track: str, directory: Path) -> tuple[TrackFile, ...]:
    """The tracks that session.toml names, none for an unknown name; ConfigError for one similar to a known track."""
    from smoother.laps.tracks import named_tracks, nearest_known

    tracks = named_tracks(track, directory)
    if not tracks and (near := nearest_known(track)) is not None:
        raise ConfigError(f"session.toml: [session] track {track!r} is not known; did you mean {near!r}?")
    return tracks


def _only_a_name(track: str | None) -> tuple[Problem, ...]:
    """The problem of a track with a name but without lines."""
    from smoother.laps.tracks import library
    from smoother.samples import Problem

    if track is None or not track.strip():
        return ()
    text = f"session.toml: track {track!r} is taken as a name only; a line comes with {', '.join(library())} or a file"
    return (Problem("track_unknown", f'{text} (track = "name.geojson")'),)


def _official(path: Path) -> tuple[float, ...]:
    if not path.is_file():
        return ()
    from smoother.laps.official import load_official

    return load_official(path)


def _foreign_file(recording: Path, *kinds: str) -> tuple[str, Path] | None:
    """The recording of another logger in a file or a folder, with its kind, if that is one of `kinds`."""
    from smoother.session.files import list_files

    try:
        files = list_files(recording).foreign_files()
    except SmootherError:  # results alone, or a folder of several recordings
        return None
    return files[0] if files and files[0][0] in kinds else None


def _of_beacon(recording: Path) -> tuple[float, ...]:
    """The lap times of the logger itself, where the recording contains them."""
    found = _foreign_file(recording, "xrk", "table")
    if found is None:
        return ()
    from smoother.session.readers.sets import beacon_times

    return beacon_times(*found)


def _own(recording: Path) -> tuple[OwnLine, ...]:
    """The lines in the recording: those of a VBO."""
    found = _foreign_file(recording, "vbo")
    if found is None:
        return ()
    from smoother.laps.own_lines import OwnLine
    from smoother.session.readers.vbo import own_lines

    orders = own_lines(found[1])
    return tuple(OwnLine(o[0].kind, tuple((line.first_deg, line.second_deg) for line in o)) for o in orders)


def tracks_from(text: str) -> tuple[TrackFile, ...]:
    """Return the tracks that --line selects: "lat,lon;lat,lon", a track file (`#name` picks one of several), or a known
    track."""
    from smoother.laps.tracks import ENDINGS, library, line_from_text, load_tracks, named_tracks, nearest_known

    path, _, chosen = text.partition("#")
    if Path(path).is_file() or path.lower().endswith(ENDINGS):
        return load_tracks(Path(path), chosen)
    if tracks := named_tracks(text, Path()):
        return tracks
    if ";" in text:
        return (line_from_text(text),)
    near = nearest_known(text)
    raise UsageError(
        f'--line {text}: neither a track file, nor "lat,lon;lat,lon", nor one of the tracks known here '
        f"({', '.join(library())})" + ("" if near is None else f"; did you mean {near}?")
    )


def fix_path(session: Session) -> FixPath:
    """Return the fixes of a session as the analysis needs them."""
    import numpy as np

    from smoother.laps.results import FixPath

    position = session.fix_position_n[:, :2]
    known = np.isfinite(position).all(axis=1)
    return FixPath(session.gnss.t[known], position[known])


def analyse_session(session: Session, smoothed: Trajectory, stated: Stated) -> LapAnalysis:
    """Return the laps of a smoothed session."""
    return analyse_rows(smoothed, fix_path(session), options_on(smoothed, session.origin, stated))


def analyse_rows(smoothed: Trajectory, fixes: FixPath, options: LapOptions) -> LapAnalysis:
    """Return the laps of a trajectory of any rate; its row values are those of :func:`analysed_rows`."""
    from smoother.laps.analysis import analyse

    return analyse(analysed_rows(smoothed), fixes, options)


def analysed_rows(smoothed: Trajectory) -> Trajectory:
    """Return the rows for the analysis, thinned to USUAL_RATE."""
    import numpy as np

    from smoother.arrays import median

    rate = 1.0 / median(np.diff(smoothed.t)) if len(smoothed) > 1 else USUAL_RATE
    return smoothed.every(max(1, int(rate / USUAL_RATE + 0.01)))


def options_on(smoothed: Trajectory, origin: Origin, stated: Stated, drift: Drift | None = None) -> LapOptions:
    """Return the options that follow from the stated tracks; of several layouts the matching one."""
    from smoother.laps.analysis import LapOptions
    from smoother.laps.circuit import find_circuit
    from smoother.laps.path import plan_path
    from smoother.samples import Problem

    if not stated.tracks and not stated.own:
        return LapOptions(official=stated.official, drift=drift, problems=stated.problems)
    if not stated.tracks:
        from smoother.laps.own_lines import trusted_lines

        lines = trusted_lines(stated.own, origin, plan_path(analysed_rows(smoothed)))
        problems = (*stated.problems, lines) if isinstance(lines, Problem) else stated.problems
        given = None if isinstance(lines, Problem) else lines
        return LapOptions(lines=given, official=stated.official, drift=drift, problems=problems)
    from smoother.laps.tracks import layout_on

    curve = None
    if len(stated.tracks) > 1:
        circuit = find_circuit(plan_path(analysed_rows(smoothed)), None, None, LapOptions().shortest)
        curve = None if isinstance(circuit, Problem) else circuit.curve
    return LapOptions(lines=layout_on(stated.tracks, origin, curve), official=stated.official, drift=drift)


def drift_of_session(smoothed: Trajectory) -> Drift | None:
    """Return how the position error changes with time, to be stored; None where it is unknown."""
    from smoother.laps.sigma import drift_of

    if smoothed.joint is None:
        return None
    return drift_of(smoothed.joint, float(smoothed.t[0]), float(smoothed.t[-1]))


def lap_columns(analysis: LapAnalysis | None, smoothed: Trajectory, t: Array) -> LapColumns | None:
    """Return the lap columns of trajectory.csv at times t (N,)."""
    from smoother.laps.document import row_columns

    return None if analysis is None else row_columns(analysis, analysed_rows(smoothed).t, t)


def lap_documents(analysis: LapAnalysis, smoothed: Trajectory, session: Session) -> Document:
    """Return the laps of summary.json: `laps`, the rows of laps.csv, and `lap_analysis`, the rest."""
    from smoother.laps.document import analysis_document, lap_rows

    drift = drift_of_session(smoothed)
    return {"laps": lap_rows(analysis), "lap_analysis": analysis_document(analysis, session.origin, drift)}
