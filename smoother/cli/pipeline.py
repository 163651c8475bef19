"""One session from disk to disk: read, calibrate, estimate, judge, write. Called by every command that needs a result.

Heavy imports happen inside the functions, so that `smooth --help` does not wait for GTSAM and matplotlib.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from smoother import api
from smoother.cli.directories import (
    BASELINE,
    FIGURE_NAMES,
    FIGURES,
    PAGE,
    STALE,
    SUMMARY,
    TRAJECTORY,
    another_recording,
    differ,
    exports_in,
    holds_results,
    output_directory,
    session_directory,
    unwritable,
    warn_removed,
)
from smoother.cli.output import Progress, no_progress, plain, warn
from smoother.documents import staged
from smoother.errors import ConfigError, SessionError, SmootherError, UsageError
from smoother.laps.stage import Stated, analyse_session, read_stated, steps
from smoother.units import KMH
from smoother.words import duration

if TYPE_CHECKING:
    from smoother.estimate.judge.quality import Quality
    from smoother.laps.results import LapAnalysis
    from smoother.samples import RawSession, Session
    from smoother.trajectory import Trajectory
    from smoother.utc_clock import UtcClock

SHOWN_ROWS = 600_000  # three hours at 50 Hz; a day is drawn with six rows a second


@dataclass(frozen=True)
class Options:
    """Options of smoothing: `rate` in Hz of the rows; solver batch or isam2; which extras are written.

    figures : the report and, unless `pictures` is off, its figures as files, which take half as long again.
    """

    rate: float = 50.0
    solver: str = "batch"
    baseline: bool = True
    figures: bool = True
    pictures: bool = True


@dataclass
class Stopwatch:
    """Seconds per stage, in the order in which they were run."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what happens inside."""
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


@dataclass(frozen=True, eq=False)
class Estimates:
    """The estimates of a session, in memory. smoothed has the rows laps are timed on, `every` n-th is written.

    files : bytes of every file that lay there, by :func:`files_beside`.
    """

    session: Session
    smoothed: Trajectory
    baseline: Trajectory | None
    quality: Quality
    laps: LapAnalysis | None = None
    every: int = 1
    files: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Result:
    """The results of a session, on disk: `main_file` is the one to open first."""

    document: dict[str, object]
    quality: Quality
    directory: Path
    main_file: Path
    clock: UtcClock | None = None


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name the session in errors about its files: gps.csv becomes a/run1/gps.csv."""
    try:
        yield
    except (SessionError, ConfigError) as error:
        text, directory = str(error), session_directory(path)
        file, colon, rest = text.partition(":")
        names = tuple(str(SmootherError(str(name))) for name in (path, directory))  # as errors write names
        if Path(file).is_absolute() or text.startswith(names):
            raise
        if colon and file and (directory / file).exists():
            named = f"{directory / file}:{rest}"
        else:
            own = (path.resolve().name.partition(".")[0], directory.resolve().name)  # the session needs no second name
            named = f"{path}:{rest}" if colon and file in own else f"{path}: {text}"
        raise type(error)(named) from error


def read(path: Path) -> RawSession:
    """Read a session. Raises SmootherError in one line with file and remedy, also for a folder of results."""
    from smoother.estimate.initial.align import in_known_units
    from smoother.session.load import load_raw

    require_recording(path)
    with naming(path):
        return in_known_units(load_raw(path))


def require_recording(path: Path) -> None:
    """Raise UsageError for a folder of results or a file in one: its tables could be read as fixes."""
    if holds_results(session_directory(path)):
        what = "holds results, not a recording" if path.is_dir() else "is inside results and is no recording"
        raise UsageError(f"{path}: {what}; name the folder it was made from")


def files_beside(path: Path) -> dict[str, int]:
    """Return the bytes of every file that a session may be made from, by their names as seen from its folder.

    A calibration.toml in the folder above is one.
    """
    from smoother.calibration import find_calibration
    from smoother.session.files import list_files

    files = list_files(path)
    calibration = find_calibration(files.directory)
    names = {*files.names, *(() if calibration is None else (os.path.relpath(calibration, files.directory),))}
    return {name: (files.directory / name).stat().st_size for name in sorted(names)}


def calibrated(raw: RawSession, directory: Path) -> Session:
    """Return the session with calibration.toml applied: that of its directory, else of the directory above."""
    from smoother.calibration import find_calibration
    from smoother.prepare import prepare

    return prepare(raw, find_calibration(directory))


def require_usable_beside(raw: RawSession, path: Path) -> None:
    """Raise SmootherError where a calibration, a track or official times beside a recording cannot be read."""
    from smoother.calibration import find_calibration, load_calibration

    directory = session_directory(path)
    if (calibration := find_calibration(directory)) is not None:
        load_calibration(calibration)
    read_stated(raw.config, directory, path)


def estimate(session: Session, options: Options, watch: Stopwatch, progress: Progress = no_progress) -> Estimates:
    """Run smoother and baseline, and judge the result; its session has the corrected times."""
    from smoother.disc import settle

    with watch.stage("smoothing"):
        every = steps(options.rate)
        smoothed = api.smooth(session, options.rate * every, options.solver, progress=progress)
    settle(session.imu, smoothed)
    baseline = None
    if options.baseline:
        progress("baseline", 0.0)
        with watch.stage("baseline"):
            baseline = api.baseline(session, options.rate)
    quality = api.assess(session, smoothed)
    settle(session.imu, smoothed, baseline)
    return Estimates(session, smoothed, baseline, quality, every=every)


def smooth_session(path: Path, out: Path | None, options: Options, progress: Progress = no_progress) -> Result:
    """Smooth one session and write all results into `out`, by default as `usual_output`."""
    with naming(path):
        return _smooth_session(path, out, options, progress)


def _smooth_session(path: Path, out: Path | None, options: Options, progress: Progress) -> Result:
    watch = Stopwatch()
    progress("reading", 0.0)
    with watch.stage("reading"):
        raw, files = read(path), files_beside(path)
    with watch.stage("preparing"):
        session = calibrated(raw, session_directory(path))
        stated = read_stated(session.config, session_directory(path), path)
    directory = output_directory(path, out, session.name)
    estimates = with_laps(estimate(session, options, watch, progress), stated, watch, progress)
    estimates = replace(estimates, files=files)
    earlier = [name for name in STALE if (directory / name).is_file()]
    exports = exports_in(directory)
    other = another_recording(directory, raw, is_renamed=out is None)
    try:
        with staged(directory, SUMMARY, STALE) as staging:
            result = write(estimates, staging, options, watch, progress)
            is_new = exports and differ(staging, directory)
    except OSError as error:
        raise unwritable(directory, error) from error
    if other is not None:
        warn(f"{directory}: held the results of another recording ({other}), which were replaced; --out DIR keeps both")
    else:
        warn_removed(directory, [name for name in earlier if not (directory / name).exists()])
    if is_new:
        left = ", ".join(exports)
        warn(f"{directory}: {left} of an earlier run was kept and has its results; export again")
    return replace(result, directory=directory, main_file=directory / result.main_file.relative_to(staging))


def with_laps(estimates: Estimates, stated: Stated, watch: Stopwatch, progress: Progress = no_progress) -> Estimates:
    """Add the laps."""
    from smoother.disc import settle

    progress("laps", 0.0)
    with watch.stage("laps"):
        laps = analyse_session(estimates.session, estimates.smoothed, stated)
        settle(estimates.smoothed)
        return replace(estimates, laps=laps)


def write(
    estimates: Estimates, directory: Path, options: Options, watch: Stopwatch, progress: Progress = no_progress
) -> Result:
    """Write the tables, the figures and the summary; results of an earlier run that no longer hold are removed."""
    from smoother.disc import settle
    from smoother.report.files import write_json

    smoothed, baseline = estimates.smoothed, estimates.baseline
    progress("writing", 0.0)
    with watch.stage("writing"):
        session, every = estimates.session, estimates.every
        clock = api.write_tables(directory, session, smoothed, estimates.laps, baseline, every)
        if baseline is None:
            (directory / BASELINE).unlink(missing_ok=True)
    settle(smoothed, baseline)
    with watch.stage("figures"):
        shown = _shown(estimates) if options.figures else None
        _write_figures(shown, heading(estimates), directory, options, progress)
        settle(smoothed, baseline)
    with watch.stage("report"):
        main_file = _write_page(shown, directory)
    settle(smoothed, baseline)
    document = _summary(estimates, options, watch)
    write_json(directory / SUMMARY, document)
    return Result(document, estimates.quality, directory, main_file, clock)


def _write_figures(shown: Estimates | None, title: str, directory: Path, options: Options, progress: Progress) -> None:
    if shown is None or not options.pictures:
        for name in FIGURE_NAMES:
            (directory / FIGURES / f"{name}.png").unlink(missing_ok=True)
        return
    from smoother.report.drawing import Shown
    from smoother.report.figures import save_figures

    drawn = Shown(shown.session, shown.smoothed, shown.baseline, title)
    save_figures(drawn, directory / FIGURES, lambda share: progress("figures", share))


def _write_page(shown: Estimates | None, directory: Path) -> Path:
    """Write the report; return the file to open first, which without figures is the table."""
    if shown is None:
        return directory / TRAJECTORY
    from smoother.report.page import Report, write_page

    report = Report(shown.session, shown.smoothed, shown.baseline, shown.laps, shown.quality)
    write_page(directory / PAGE, report)
    return directory / PAGE


def _shown(estimates: Estimates) -> Estimates:
    """The estimates with at most SHOWN_ROWS rows, for figures."""
    smoothed, baseline = estimates.smoothed, estimates.baseline
    few = smoothed.every(-(-len(smoothed) // SHOWN_ROWS))
    few_baseline = None if baseline is None else baseline.every(-(-len(baseline) // SHOWN_ROWS))
    return replace(estimates, smoothed=few, baseline=few_baseline)


def heading(estimates: Estimates) -> str:
    """Return the line that names a session everywhere: its title, length, distance and top speed."""
    from smoother.laps.top_speed import top_speed
    from smoother.report.summary import distance_driven

    smoothed = estimates.smoothed
    length, kilometres = duration(float(smoothed.t[-1] - smoothed.t[0])), distance_driven(smoothed) / 1000.0
    name, top = estimates.session.config.title or estimates.session.name, top_speed(smoothed, estimates.laps).speed
    return f"{plain(name)} · {length}, {kilometres:.2f} km, top speed {top / KMH:.1f} km/h"


def _summary(made: Estimates, options: Options, watch: Stopwatch) -> dict[str, object]:
    asked = {"rate_hz": options.rate, "solver": options.solver, "baseline": options.baseline}
    document = api.summary(made.session, made.smoothed, made.quality, made.laps, made.every, watch.seconds, asked)
    return document | {"files": dict(made.files)}
