"""The project for Python programs: read a session, smooth it, time its laps, compare it with a truth, write it.

    session = read(Path("session"))
    trajectory = smooth(session)
    analysis = laps(session, trajectory)
    write_results(Path("results"), session, trajectory, analysis)

These names do not change when the readers and the estimator behind them are rebuilt. Arguments and results are the
plain types of :mod:`smoother.samples`, :mod:`smoother.trajectory` and :mod:`smoother.laps.results`; frames, units and
signs are those of :mod:`smoother.frames`. Flawed data does not raise: it is reported in `problems` of the session and
of `trajectory.report`. Unusable data raises :class:`smoother.errors.SmootherError`, one line: what, where, remedy.

A session is always passed as it was read. Where the smoother found that a clock of the recording stepped, rows have the
corrected times, and every function that is given both session and trajectory corrects those of the session.

Heavy imports happen inside the functions, so that `smooth --help` does not wait for GTSAM and matplotlib.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smoother.errors import UsageError

if TYPE_CHECKING:
    from smoother.arrays import Array
    from smoother.estimate.judge.evaluate import Errors as Errors
    from smoother.estimate.judge.evaluate import Evaluation as Evaluation
    from smoother.estimate.judge.quality import Quality as Quality
    from smoother.estimate.output.short_graph import ShortGraph as ShortGraph
    from smoother.frames import Origin
    from smoother.laps.results import GivenLines, LapAnalysis, ReferenceLine
    from smoother.samples import RawSession, Session
    from smoother.sim.simulation import Simulation
    from smoother.trajectory import Trajectory
    from smoother.utc_clock import UtcClock

__all__ = [
    "assess",
    "baseline",
    "errors_between",
    "evaluate",
    "gps_alone",
    "laps",
    "prepared",
    "read",
    "read_raw",
    "read_truth",
    "resample",
    "short_graph",
    "simulate",
    "smooth",
    "summary",
    "write_results",
    "write_session",
    "write_tables",
]

Progress = Callable[[str, float], None]
"""Is called with the stage and the share of it that is done, 0 to 1."""

TRAJECTORY, FIXES, BASELINE = "trajectory.csv", "gps.csv", "baseline.csv"
SUMMARY, PAGE = "summary.json", "report.html"


def read(path: Path, recording: int | None = None) -> Session:
    """Return the session in a folder or file of any format that `smooth` reads, its calibration.toml applied.

    recording: which recording of a card with several, from 1. Raises SessionError where nothing usable is left, and
    ConfigError for a session.toml or calibration.toml that is wrong.
    """
    from smoother.calibration import find_calibration

    file = path if recording is None else _recording(path, recording)
    return prepared(read_raw(file), find_calibration(file if file.is_dir() else file.parent))


def read_raw(path: Path) -> RawSession:
    """Return the session as it was recorded, to be changed and given to :func:`prepared`; raises as :func:`read`."""
    from smoother.session.load import load_raw

    return load_raw(path)


def prepared(raw: RawSession, calibration: Path | None = None, *, even_times: bool = False) -> Session:
    """Return a recorded, simulated or self-made session with `n` at its first good fix and `calibration` applied.

    A gyroscope in deg/s is found by the motion of the fixes and converted, as is an accelerometer in g. even_times:
    replace stamps as the readers of files do: samples by an even clock, fixes by the receiver's own times.
    Raises SessionError without two usable fixes, ConfigError for a calibration.toml that is wrong.
    """
    from smoother.estimate.initial.align import in_known_units
    from smoother.prepare import prepare

    return prepare(in_known_units(_with_even_times(raw) if even_times else raw), calibration)


def _with_even_times(raw: RawSession) -> RawSession:
    from smoother.session.clock import regularize, true_fix_times

    imu = None if raw.imu is None else replace(raw.imu, t=regularize(raw.imu.t).t)
    if raw.gnss.unix_s is None:
        return replace(raw, imu=imu)
    return replace(raw, imu=imu, gnss=replace(raw.gnss, t=true_fix_times(raw.gnss.t, raw.gnss.unix_s)[0]))


def _recording(path: Path, number: int) -> Path:
    from smoother.session.load import recordings

    found = recordings(path)
    if not 1 <= number <= len(found):
        raise UsageError(f"{path}: holds {len(found)} recordings of the logger, so there is no recording {number}")
    return found[number - 1].paths[0]


def simulate(
    preset: str, seed: int, *, track: str = "larkfield", duration: float = 600.0, **figures: Any
) -> Simulation:
    """Return a simulated session: `raw` is what was recorded, `truth` and `scenario` what was true.

    preset: white, kart, kart_harsh, ..; duration: s. figures: any figure of the simulator, `gnss_rate=10.0` for the
    field `rate` of the receiver's errors; `smooth simulate --list` names them all. A seed has one session.
    """
    from smoother.sim.simulation import simulate_preset

    return simulate_preset(preset, seed, track=track, duration=duration, **figures)


def write_session(simulation: Simulation, folder: Path) -> None:
    """Write imu.csv, gps.csv, mag.csv, wheel_speed.csv, and truth.csv and truth_laps.csv beside them, into `folder`."""
    from smoother.sim.record import write_csv

    write_csv(simulation, folder)


def smooth(
    session: Session,
    rate: float = 50.0,
    solver: str = "batch",
    *,
    wheels: bool = True,
    imu: bool = True,
    without: Collection[str] = (),
    progress: Progress | None = None,
) -> Trajectory:
    """Return the smoothed trajectory of the antenna in `n`, with sigmas and all that was identified.

    rate: rows a second, Hz; laps need 25 or more. solver: "batch" or "isam2". wheels: the kart points nearly along its
    path. imu: use the motion sensor; without it, as for a session that has none, attitude is NaN and `report.mode` is
    "gps-only". without: names of factors to leave out (docs/estimation.md lists them), to see what they are worth.
    """
    from smoother.estimate.smoother import GraphOptions, GraphSmoother

    options = GraphOptions(rate=rate, solver=solver, wheels=wheels, without=frozenset(without))
    smoother = GraphSmoother(options, progress=progress)
    return smoother.estimate(session if imu else replace(session, imu=None))


def short_graph(session: Session, begin: float, lasts: float) -> ShortGraph:
    """Return the graph of `lasts` seconds of a session from `begin` s on, all of it as factors of GTSAM, to look at.

    It has `factors(values)`, the gtsam.NonlinearFactorGraph of each row of the table in docs/estimation.md, the
    `values` to begin with, `step(values)` of the loop that solves sessions, and `covariances(values)` by its sweep.
    """
    from smoother.estimate.output.short_graph import short_graph as graph_of

    return graph_of(session, begin, lasts)


def baseline(session: Session, rate: float = 50.0, **options: Any) -> Trajectory:
    """Return the trajectory of the older method: Madgwick's attitude filter and a six-state Kalman filter.

    options: fields of `BaselineOptions` (smoother/estimate/baseline/baseline.py): alpha m^2/s^4, accel_covariance
    "in motion" or "at rest", use_magnetometer. Heights and sigmas of attitude are NaN.
    """
    from smoother.estimate.baseline.baseline import BaselineOptions, ThesisBaseline

    return ThesisBaseline(BaselineOptions(rate=rate, **options)).estimate(session)


def gps_alone(session: Session, rate: float = 50.0) -> Trajectory:
    """Return the fixes joined by straight lines: a row at each fix and `rate` rows a second; no sigmas, no attitude."""
    from smoother.estimate.baseline.baseline import GpsAlone

    return GpsAlone(rate).estimate(session)


def resample(trajectory: Trajectory, t: Array) -> Trajectory:
    """Return the trajectory at times t (N,) s inside its span; raises ValueError outside.

    Position by cubic Hermite, attitude along the shortest rotation, the rest linearly.
    """
    from smoother.estimate.output.resample import resample as resampled

    return resampled(trajectory, t)


def laps(
    session: Session,
    trajectory: Trajectory,
    line: str | Array | GivenLines | None = None,
    *,
    folder: Path | None = None,
    reference: ReferenceLine | None = None,
) -> LapAnalysis:
    """Return laps, sectors, corners and the reference line of a trajectory with 25 rows a second or more.

    line: start/finish: "lat,lon;lat,lon", a track file or the name of a known track; its two ends (2, 2) m in `n`; or
    GivenLines with sectors. Without, a line is found where the path returns. folder: of the session, for the track that
    its session.toml names and for official.csv. reference: a line to measure distance along. Without laps, `laps` of
    the result is empty and its `problems` give the reason.
    """
    from smoother.laps.results import GivenLines
    from smoother.laps.stage import Stated, analyse_rows, fix_path, options_on, read_stated, tracks_from

    stated = Stated() if folder is None else read_stated(session.config, folder, folder)
    if isinstance(line, str):
        stated = Stated(tracks_from(line), stated.official)
    options = replace(options_on(trajectory, session.origin, stated), reference=reference)
    if line is not None and not isinstance(line, str):
        options = replace(options, lines=line if isinstance(line, GivenLines) else GivenLines(line))
    return analyse_rows(trajectory, fix_path(session), options)


def read_truth(folder: Path, origin: Origin) -> Trajectory:
    """Return truth.csv of a folder as a trajectory in the `n` of `origin`, NaN for what it does not hold."""
    from smoother.session.truth import load_truth

    return load_truth(folder, origin)


def evaluate(trajectory: Trajectory, truth: Trajectory, skip: float = 0.0) -> Evaluation:
    """Return rms errors (`_m`, `_mps`, `_deg`), shares within one and two sigma, and NEES against a truth.

    skip: s to leave out at the start of what both cover. Quantities that one of them does not know are NaN.
    """
    from smoother.estimate.judge.evaluate import evaluate as evaluated

    return evaluated(trajectory, truth, skip)


def errors_between(trajectory: Trajectory, truth: Trajectory) -> Errors:
    """Return trajectory minus truth of two trajectories with the same times t (N,) s.

    position_n and velocity_n (N, 3) m and m/s, euler (N, 3) rad; NaN where unknown.
    """
    from smoother.estimate.judge.evaluate import errors_between as between

    return between(trajectory, truth)


def assess(session: Session, trajectory: Trajectory) -> Quality:
    """Return the verdict of the quality gate: `passed`, and `reasons` where it did not. No truth is needed."""
    from smoother.estimate.judge.quality import assess as assessed

    return assessed(session, trajectory)


def write_results(
    folder: Path,
    session: Session,
    trajectory: Trajectory,
    laps: LapAnalysis | None = None,
    baseline: Trajectory | None = None,
) -> dict[str, object]:
    """Write trajectory.csv, gps.csv, summary.json and report.html into `folder`; return the summary.

    laps: adds laps.csv and the laps of report and trajectory. baseline: adds baseline.csv. The command `smooth` writes
    the same tables, and figures as files beside them.
    """
    from smoother.report.files import write_json
    from smoother.report.page import Report, write_page

    folder.mkdir(parents=True, exist_ok=True)
    quality = assess(session, trajectory)
    write_tables(folder, session, trajectory, laps, baseline)
    document = summary(session, trajectory, quality, laps)
    write_json(folder / SUMMARY, document)
    write_page(folder / PAGE, Report(session, trajectory, baseline, laps, quality))
    return document


def write_tables(
    folder: Path,
    session: Session,
    trajectory: Trajectory,
    laps: LapAnalysis | None = None,
    baseline: Trajectory | None = None,
    every: int = 1,
) -> UtcClock | None:
    """Write trajectory.csv, gps.csv, and laps.csv and baseline.csv where there are any; return the clock of `utc`.

    every: of the rows every n-th is written.
    """
    from smoother.estimate.preprocess.clock import utc_clock
    from smoother.laps.document import lap_table
    from smoother.laps.stage import LAPS, lap_columns
    from smoother.report.files import write_csv, write_fixes, write_trajectory

    rows, clock = trajectory.every(every), utc_clock(session, trajectory)
    columns = lap_columns(laps, trajectory, rows.t)
    write_trajectory(folder / TRAJECTORY, rows, session.origin, clock, columns, session.channels)
    if laps is not None:
        write_csv(folder / LAPS, lap_table(laps))
    write_fixes(folder / FIXES, session, trajectory.report.fixes)
    if baseline is not None:
        write_trajectory(folder / BASELINE, baseline, session.origin, clock)
    return clock


def summary(
    session: Session,
    trajectory: Trajectory,
    quality: Quality,
    laps: LapAnalysis | None = None,
    every: int = 1,
    timings: Mapping[str, float] | None = None,
    options: Mapping[str, object] | None = None,
) -> dict[str, object]:
    """Return what summary.json holds, without the list of input files.

    session, every: as for :func:`write_tables`. timings: s of each stage; options: those of the estimate.
    """
    from smoother.laps.stage import lap_documents
    from smoother.report.summary import summary as document_of

    rows = trajectory.every(every)
    document = document_of(session, rows, quality, timings or {}, options or {}, laps)
    return document if laps is None else document | lap_documents(laps, trajectory, session)
