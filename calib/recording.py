"""A recording for calibration, with or without GPS, in SI and on an even time base.

Unlike a session it may come from a bench; one sensor is enough.
"""

import datetime as dt
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.calibration import Calibration
from smoother.config import SessionConfig
from smoother.errors import SessionError
from smoother.fit.resting import RestingPosition, resting_positions
from smoother.fit.standstill import detect_standstill, fix_speeds
from smoother.frames import Origin
from smoother.samples import DEAD_AXES, GnssFixes, Problem, RawImu, RawMag
from smoother.session.beside import read_mag
from smoother.session.checks.imu import dead_axes
from smoother.session.clock import regularize
from smoother.session.csv_form import read_fixes, read_imu
from smoother.session.files import SessionFiles, list_files
from smoother.session.log import LogFiles, imu_samples, list_recordings, mag_samples, read_records
from smoother.session.nmea import fixes_from_sentences
from smoother.session.settings import load_settings
from smoother.session.tables import read_header, read_table
from smoother.session.thesis import read_magcalib, read_out
from smoother.units import MICROSECOND
from smoother.words import listed

DRIVING_SPEED = 3.0  # m/s, exceeded for a twentieth of the time in a drive
FEWEST_ROWS = 32
TEMPERATURE_COLUMN = "temp_c"


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording. imu and mag as logged, on even stamps; imu_stamps, mag_stamps (N,) s as they were.

    mag_field (K, 3): readings without times, from magcalib.txt. fixes: None or empty indoors. is_thesis: from out.txt.
    """

    name: str
    imu: RawImu | None = None
    mag: RawMag | None = None
    mag_field: Array | None = None
    fixes: GnssFixes | None = None
    imu_stamps: Array | None = None
    mag_stamps: Array | None = None
    config: SessionConfig = field(default_factory=SessionConfig)
    inputs: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    is_thesis: bool = False

    @property
    def imu_rate(self) -> float:
        """Sampling rate of the inertial samples, Hz."""
        assert self.imu is not None
        return 1.0 / float(np.median(np.diff(self.imu.t)))

    @cached_property
    def force(self) -> Array:
        """Specific force (N, 3) m/s^2 as measured, axes s."""
        assert self.imu is not None
        return np.asarray(self.imu.accel * self.imu.accel_scale)

    @cached_property
    def rate(self) -> Array:
        """Angular rate (N, 3) rad/s as measured, axes s."""
        assert self.imu is not None
        return np.asarray(self.imu.gyro * self.imu.gyro_scale)

    @cached_property
    def origin(self) -> Origin | None:
        """Origin from the fixes; None without fixes."""
        if self.fixes is None or not len(self.fixes):
            return None
        known = self.fixes.alt_m[np.isfinite(self.fixes.alt_m)]
        alt = float(np.median(known)) if known.size else 0.0
        return Origin(float(np.median(self.fixes.lat_deg)), float(np.median(self.fixes.lon_deg)), alt)

    @cached_property
    def date(self) -> dt.date | None:
        """UTC date, from the fixes or from session.toml."""
        if self.fixes is not None and self.fixes.unix_s is not None:
            known = self.fixes.unix_s[np.isfinite(self.fixes.unix_s)]
            if known.size:
                return dt.datetime.fromtimestamp(float(np.median(known)), dt.UTC).date()
        return None if self.config.date is None else dt.date.fromisoformat(self.config.date)

    @cached_property
    def is_driven(self) -> bool:
        """Whether the fixes show a kart on the move, rather than a logger on a bench."""
        if self.fixes is None or self.origin is None or len(self.fixes) < FEWEST_ROWS:
            return False
        speed, _ = fix_speeds(self.fixes, self.origin)
        known = speed[np.isfinite(speed)]
        return bool(known.size and np.percentile(known, 95.0) > DRIVING_SPEED)

    @cached_property
    def is_at_rest(self) -> BoolArray:
        """Mask (N,) of the inertial samples at rest: judged with the fixes in a drive."""
        assert self.imu is not None
        if not self.is_driven:
            return detect_standstill(self.imu.t, self.force, self.rate)
        assert self.fixes is not None and self.origin is not None
        speed, limit = fix_speeds(self.fixes, self.origin)
        return detect_standstill(self.imu.t, self.force, self.rate, self.fixes.t, speed, limit)

    @cached_property
    def positions(self) -> tuple[RestingPosition, ...]:
        """The resting positions with their mean readings."""
        assert self.imu is not None
        return resting_positions(self.imu.t, self.force, self.rate, self.is_at_rest, self.imu.temperature)

    @cached_property
    def longest_rest(self) -> tuple[int, int]:
        """First sample of the longest stretch at rest, and the first after it; (0, 0) if there is none."""
        assert self.imu is not None
        if not self.positions:
            return 0, 0
        longest = max(self.positions, key=lambda position: position.end - position.start)
        i, j = np.searchsorted(self.imu.t, [longest.start, longest.end])
        return int(i), int(j) + 1

    def calibrated(self, calibration: Calibration) -> tuple[Array, Array]:
        """Specific force and angular rate, each (N, 3), calibrated."""
        assert self.imu is not None
        samples = calibration.apply_to_imu(self.imu)
        return samples.specific_force_s, samples.angular_rate_s


def load_recordings(path: Path) -> list[Recording]:
    """Read the recordings of a directory or a file: one, or all on a card of the logger.

    Raises SessionError if no sensor is in it.
    """
    files = list_files(path)
    if not files.logs():
        return [load_recording(path)]
    found = [_read_log(recording) for recording in list_recordings(files.logs())]
    settings = files.find("session.toml")
    config = SessionConfig() if settings is None else load_settings(settings)
    usable = [replace(one, config=config) for one in found if one.imu is not None or one.mag is not None]
    if not usable:
        raise SessionError(f"{path}: no sensor delivered anything; was the logger switched on for long enough?")
    return [_evened(one) for one in usable]


def _read_log(files: LogFiles) -> Recording:
    """One recording of the logger; a bench has no fixes, so the sentences may hold none."""
    name = files.paths[0].name
    records, _ = read_records(files)
    imu, imu_problems = imu_samples(records, name)
    mag, mag_problems = mag_samples(records, name)
    try:
        fixes = fixes_from_sentences(((t * MICROSECOND, text) for t, text in records.sentences), name).gnss
    except SessionError:  # a receiver without a view of the sky sends nothing
        fixes = None
    inputs = tuple(path.name for path in files.paths)
    problems = (*imu_problems, *mag_problems)
    return Recording(files.paths[0].stem, imu, mag, fixes=fixes, inputs=inputs, problems=problems)


def load_recording(path: Path) -> Recording:
    """Read the recording in a directory, or the one a file belongs to. Raises SessionError if no sensor is in it."""
    files = list_files(path)
    settings = files.find("session.toml")
    config = SessionConfig() if settings is None else load_settings(settings)
    found = _read_thesis(files) if files.out_file() is not None else _read_columns(files)
    magcalib = files.find("magcalib.txt", "mag_calib.txt")
    if magcalib is not None:
        readings, problems = read_magcalib(magcalib)
        inputs = (*found.inputs, magcalib.name)
        found = replace(found, mag_field=readings, problems=(*found.problems, *problems), inputs=inputs)
    found = replace(found, name=files.session_name(), config=config)
    if found.imu is None and found.mag is None and found.mag_field is None:
        raise SessionError(
            f"{path}: nothing to calibrate from; wanted imu.csv, mag.csv, magcalib.txt, out.txt or the logger's file"
        )
    return _evened(found)


def _read_thesis(files: SessionFiles) -> Recording:
    file = files.out_file()
    assert file is not None
    out = read_out(file)
    return Recording(
        "", out.imu, out.mag, fixes=out.gnss, inputs=(file.name,), problems=tuple(out.problems), is_thesis=True
    )


def _read_columns(files: SessionFiles) -> Recording:
    imu_file, mag_file, fix_file = files.imu_table(), files.find("mag.csv", "mag.csv.gz"), files.fix_table()
    problems: list[Problem] = []
    imu, mag, fixes = None, None, None
    if imu_file is not None:
        imu, found = read_imu(imu_file)
        problems += found
        imu = replace(imu, temperature=_temperature(imu_file, imu.t))
    if mag_file is not None:
        mag, found = read_mag(mag_file)
        problems += found
    if fix_file is not None:
        fixes, found = read_fixes(fix_file)
        problems += found
    inputs = tuple(file.name for file in (imu_file, mag_file, fix_file) if file is not None)
    return Recording("", imu, mag, fixes=fixes, inputs=inputs, problems=tuple(problems))


def _temperature(path: Path, t: Array) -> Array | None:
    """Temperature (N,) deg C at t (N,) from the column temp_c of an IMU table; None if it has none."""
    if TEMPERATURE_COLUMN not in read_header(path):
        return None
    table = read_table(path, ("t_s", TEMPERATURE_COLUMN))
    at, value = table.column("t_s"), table.column(TEMPERATURE_COLUMN)
    known = np.isfinite(at) & np.isfinite(value)
    if not np.any(known):
        return None
    order = np.argsort(at[known], kind="stable")
    return np.interp(t, at[known][order], value[known][order])


def _evened(found: Recording) -> Recording:
    """The recording with evened stamps, and without sensors with too few samples."""
    imu = found.imu if found.imu is not None and len(found.imu.t) >= FEWEST_ROWS else None
    mag = found.mag if found.mag is not None and len(found.mag.t) else None
    dead = [] if imu is None else [f"{axis} of the {sensor}" for sensor, axis in dead_axes(imu)]
    text = f"{found.name}: {listed(dead)} never changed: nothing about it can be told; check the wiring"
    return replace(
        found,
        problems=(*found.problems, *([Problem(DEAD_AXES, text, len(dead))] if dead else [])),
        imu=None if imu is None else replace(imu, t=regularize(imu.t).t),
        mag=None if mag is None else replace(mag, t=regularize(mag.t).t),
        imu_stamps=None if imu is None else imu.t,
        mag_stamps=None if mag is None else mag.t,
    )
