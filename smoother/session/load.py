"""From a directory, or one file of it, to a RawSession: find the files, read them, put them on one clock.

A format is one entry of `FORMATS`; the first that recognises what lies in the directory reads it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smoother.config import SessionConfig
from smoother.errors import SessionError
from smoother.samples import GnssFixes, Problem, RawImu, RawMag, RawSession
from smoother.session.csv_form import read_fixes, read_imu, read_mag
from smoother.session.settings import load_settings
from smoother.session.tables import read_header

SLOWEST_IMU = 20.0  # Hz, median; below, a kart's motion between samples is lost (contract, section 3)
FEWEST_IMU_SAMPLES = 100
TABLE_SUFFIXES = (".csv", ".csv.gz")


@dataclass(frozen=True)
class SessionFiles:
    """The files of one session directory. `chosen` is the file a person named, or None for the directory."""

    directory: Path
    names: tuple[str, ...]
    chosen: str | None = None

    def find(self, *stems_and_suffixes: tuple[str, tuple[str, ...]]) -> Path | None:
        """The first file with that stem and one of the suffixes, in any case of letters."""
        for stem, suffixes in stems_and_suffixes:
            for suffix in suffixes:
                for name in self.names:
                    if name.lower() == stem + suffix:
                        return self.directory / name
        return None


@dataclass(frozen=True, eq=False)
class Recording:
    """What one format made of a directory, before the settings and the clock."""

    gnss: GnssFixes
    inputs: tuple[str, ...]
    problems: tuple[Problem, ...]
    imu: RawImu | None = None
    imu_file: str = "imu.csv"
    gnss_file: str = "gps.csv"
    mag: RawMag | None = None


@dataclass(frozen=True)
class Format:
    """One way a session may be recorded: whether it is there, and how to read it."""

    name: str
    recognises: Callable[[SessionFiles], bool]
    read: Callable[[SessionFiles], Recording]


def load_raw(path: Path) -> RawSession:
    """Read the session at `path`, a directory or one file of it.

    Flaws that could be lived with are in `problems`. Raises SessionError, one line with file and remedy, where
    nothing usable is left: no known file, no fix, files on clocks that do not overlap; ConfigError for settings.
    """
    files = _list_files(path)
    for form in FORMATS:
        if form.recognises(files):
            return _finish(files, form.read(files))
    raise SessionError(
        f"{path}: no recording found; expected out.txt, gps.csv or *.nmea (with imu.csv if there is an IMU)"
    )


def _list_files(path: Path) -> SessionFiles:
    if not path.exists():
        raise SessionError(f"{path}: no such file or directory")
    directory = path if path.is_dir() else path.parent
    try:
        names = tuple(sorted(entry.name for entry in directory.iterdir() if entry.is_file()))
    except OSError as error:
        raise SessionError(f"{directory}: cannot be listed ({error.strerror})") from error
    return SessionFiles(directory, names, None if path.is_dir() else path.name)


def _finish(files: SessionFiles, recording: Recording) -> RawSession:
    settings = files.find(("session", (".toml",)))
    config = SessionConfig() if settings is None else load_settings(settings)
    problems = list(recording.problems)
    imu = _usable_imu(recording, problems)
    _require_overlap(recording, imu)
    return RawSession(
        name=_session_name(files),
        gnss=recording.gnss,
        imu=imu,
        mag=recording.mag,
        config=config,
        inputs=recording.inputs if settings is None else (*recording.inputs, settings.name),
        problems=tuple(problems),
    )


def _session_name(files: SessionFiles) -> str:
    return files.directory.resolve().name or "session"


def _usable_imu(recording: Recording, problems: list[Problem]) -> RawImu | None:
    imu, file = recording.imu, recording.imu_file
    if imu is None:
        problems.append(Problem("imu_missing", "no IMU recorded: smoothed from GPS alone"))
        return None
    if imu.t.size < FEWEST_IMU_SAMPLES:
        text = f"{file}: only {imu.t.size} usable samples: smoothed from GPS alone"
        problems.append(Problem("imu_missing", text))
        return None
    rate = 1.0 / float(np.median(np.diff(imu.t)))
    if rate < SLOWEST_IMU:
        text = f"{file}: {rate:.1f} samples a second are too slow for a kart's motion (at least {SLOWEST_IMU:.0f})"
        problems.append(Problem("imu_too_slow", f"{text}: smoothed from GPS alone"))
        return None
    return imu


def _require_overlap(recording: Recording, imu: RawImu | None) -> None:
    gnss = recording.gnss
    if len(gnss) == 0:
        reasons = "; ".join(p.text for p in recording.problems if p.code.startswith("gps_"))
        raise SessionError(
            f"{recording.gnss_file}: no usable fix{f' ({reasons})' if reasons else ''}; "
            "the antenna needs a view of the sky before the start"
        )
    if imu is not None and (gnss.t[-1] < imu.t[0] or imu.t[-1] < gnss.t[0]):
        raise SessionError(
            f"{recording.imu_file} ({imu.t[0]:.1f} to {imu.t[-1]:.1f} s) and {recording.gnss_file} "
            f"({gnss.t[0]:.1f} to {gnss.t[-1]:.1f} s) do not overlap in time; t_s must be one clock in both"
        )


def _has_tables(files: SessionFiles) -> bool:
    return _fix_table(files) is not None


def _fix_table(files: SessionFiles) -> Path | None:
    if files.chosen is not None and files.chosen.lower().endswith(TABLE_SUFFIXES):
        path = files.directory / files.chosen
        if "lat_deg" in read_header(path):
            return path
    return files.find(("gps", TABLE_SUFFIXES))


def _read_tables(files: SessionFiles) -> Recording:
    fix_table = _fix_table(files)
    assert fix_table is not None
    gnss, problems = read_fixes(fix_table)
    inputs = [fix_table.name]
    imu, mag = None, None
    if (imu_table := files.find(("imu", TABLE_SUFFIXES))) is not None:
        imu, imu_problems = read_imu(imu_table)
        problems += imu_problems
        inputs.insert(0, imu_table.name)
    if (mag_table := files.find(("mag", TABLE_SUFFIXES))) is not None:
        mag, mag_problems = read_mag(mag_table)
        problems += mag_problems
        inputs.append(mag_table.name)
    return Recording(
        gnss,
        tuple(inputs),
        tuple(problems),
        imu,
        imu_table.name if imu_table else "imu.csv",
        fix_table.name,
        mag,
    )


FORMATS: tuple[Format, ...] = (Format("CSV", _has_tables, _read_tables),)
