"""From a recording, as one format read it, to the RawSession: settings, one time base, checks, what can be used.

Sentences name the file that values came from. What format it has, nothing here asks.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from smoother.arrays import median
from smoother.config import SessionConfig
from smoother.disc import kept, release, settle
from smoother.errors import SessionError
from smoother.samples import IMU_AXES_UNKNOWN, IMU_INCOMPLETE, GnssFixes, Problem, RawSession
from smoother.session.checks.imu import IMU_CHECKS, USABLE
from smoother.session.checks.table import run
from smoother.session.checks.times import GAPS, TOGETHER, WHEEL_CHECKS
from smoother.session.clock import describe_time_base, regularize, true_fix_times
from smoother.session.files import SessionFiles
from smoother.session.recorded import Recording
from smoother.session.settings import load_settings

__all__ = ["Recording", "finish"]

MANY_HEIGHTS = 50  # of which two would differ by a digit if they were measured
NO_RECEPTION = ("gps_no_fix", "gps_null_island")  # what a receiver writes that does not see its satellites
# said of files whose columns may be right all the same
OF_NO_COLUMN = ("gps_row_cut", "gps_row_damaged", "gps_time_unit", "gps_repeated_time")
FEWEST_FIXES_FOR_CLOCK = 32


def finish(files: SessionFiles, recording: Recording) -> RawSession:
    """Apply session.toml and the clock; see to it that what is left can be used.

    Raises SessionError where it cannot: no fix, or fixes and samples that never run together; ConfigError for settings.
    """
    settings = files.find("session.toml")
    config = SessionConfig() if settings is None else load_settings(settings)
    recording = replace(recording, gnss=_without_fillers(recording.gnss))
    _require_fixes(recording)
    problems = [*recording.problems, *_missing_heights(recording)]
    for step in (_with_even_samples, _with_even_fixes, partial(run, IMU_CHECKS)):
        recording, said = step(recording)
        problems += said
    if recording.imu is not None:
        recording, said = _without_filter_delay(recording, config.imu_delay)
        problems += said
        config = replace(config, imu_delay=config.imu_delay if recording.imu_delay is None else recording.imu_delay)
    if recording.imu is not None:
        _require_overlap(recording)
        recording, said = run(TOGETHER, recording)
        problems += said
        settle(recording.imu)
    recording, said = run(WHEEL_CHECKS, recording)
    problems += said
    gnss, mag = recording.gnss, recording.mag
    return RawSession(
        name=files.session_name(),
        gnss=gnss,
        imu=recording.imu,
        mag=None if mag is None or mag.t.size == 0 else replace(mag, t=regularize(mag.t).t),
        wheel_speed=recording.wheel_speed,
        channels=recording.channels,
        mag_calibration_field=recording.mag_calibration_field,
        config=config,
        inputs=recording.inputs if settings is None else (*recording.inputs, settings.name),
        problems=tuple(problems),
        unix_at_zero=recording.unix_at_zero if (by_fixes := gnss.unix_at_zero) is None else by_fixes,
    )


def _require_fixes(recording: Recording) -> None:
    if len(recording.gnss) == 0:
        against = [problem for problem in recording.problems if problem.code.startswith("gps_")]
        reasons = "; ".join(problem.text.partition(": ")[2] for problem in against)
        searched = all(problem.code in (*NO_RECEPTION, *OF_NO_COLUMN) for problem in against)
        remedy = "the antenna needs a free view of the sky before the start" if searched else "mend those columns"
        raise SessionError(f"{recording.gnss_file}: no usable fix{f' ({reasons})' if reasons else ''}; {remedy}")


def _without_fillers(gnss: GnssFixes) -> GnssFixes:
    """The fixes without heights, or speeds upwards, that are all 0: what a table has where nothing was measured.

    Taken for measured, they would be the surest of all. Of a height that never changes, only the first one counts.
    """
    velocity_n = gnss.velocity_n
    if np.nanmax(np.abs(velocity_n[:, 2]), initial=0.0) == 0.0:
        velocity_n = np.column_stack([velocity_n[:, :2], np.full(len(gnss), np.nan)])
    alt_m = gnss.alt_m if np.nanmax(np.abs(gnss.alt_m), initial=0.0) > 0.0 else np.full(len(gnss), np.nan)
    known = np.flatnonzero(np.isfinite(alt_m))
    if known.size >= MANY_HEIGHTS and np.all(alt_m[known] == alt_m[known[0]]):
        alt_m = np.where(np.arange(len(alt_m)) == known[0], alt_m, np.nan)
    return replace(gnss, velocity_n=velocity_n, alt_m=alt_m)


def _missing_heights(recording: Recording) -> Iterator[Problem]:
    if not np.any(np.isfinite(recording.gnss.alt_m)):
        text = (
            f"{recording.gnss_file}: no fix has a height; how high the track lies is unknown, and how steep a road is "
            "that climbs all the way. All that is level is as good"
        )
        yield Problem("gps_no_height", text)


def _with_even_samples(recording: Recording) -> tuple[Recording, list[Problem]]:
    """The inertial samples on an even time base; none, with the reason, if they are unusable."""
    imu = recording.imu
    if imu is None:
        is_there = any(problem.code in (IMU_AXES_UNKNOWN, IMU_INCOMPLETE) for problem in recording.problems)
        text = "no IMU that can be used" if is_there else "no IMU recorded"
        return recording, [Problem("imu_missing", f"{text}: smoothed from GPS alone")]
    if len(imu.t) == 0:
        text = f"{recording.imu_file}: no usable sample: smoothed from GPS alone"
        return replace(recording, imu=None), [Problem("imu_missing", text)]
    base = regularize(imu.t)
    imu = replace(imu, t=kept(base.t), longest_step=base.longest_step)
    release(imu)
    recording, problems = run(USABLE, replace(recording, imu=imu))
    release(imu)
    of_times = [] if recording.imu is None else describe_time_base(base, "imu", recording.imu_file)
    return recording, [*problems, *of_times]


def _with_even_fixes(recording: Recording) -> tuple[Recording, list[Problem]]:
    """The fixes at the receiver's own times, by its UTC or else by its steady rate; a constant latency remains."""
    gnss = recording.gnss
    assert gnss.unix_s is not None
    t, by_utc = true_fix_times(gnss.t, gnss.unix_s)
    if not by_utc and len(gnss) >= FEWEST_FIXES_FOR_CLOCK:
        t = regularize(gnss.t).t
    return run(GAPS, replace(recording, gnss=replace(gnss, t=t)))


def _without_filter_delay(recording: Recording, delay: float | None) -> tuple[Recording, list[Problem]]:
    """The samples when they were true, by the delay (s) that session.toml states.

    They count as means over the time since the one before, and so as true half of that before their stamps already.
    """
    imu = recording.samples
    if delay is None or len(imu.t) < 2:
        return recording, []
    if recording.imu_delay is not None:
        text = f"session.toml: [imu] delay is not used; {recording.imu_file} says what its filter was"
        return recording, [Problem("imu_delay_known", text)]
    return replace(recording, imu=replace(imu, t=imu.t - (delay - 0.5 * median(np.diff(imu.t))))), []


def _require_overlap(recording: Recording) -> None:
    """Raise SessionError if samples and fixes never run together."""
    imu_t, t = recording.samples.t, recording.gnss.t
    if t[-1] < imu_t[0] or imu_t[-1] < t[0]:
        raise SessionError(
            f"{recording.imu_file} ({imu_t[0]:.1f} to {imu_t[-1]:.1f} s) and {recording.gnss_file} "
            f"({t[0]:.1f} to {t[-1]:.1f} s) do not overlap in time; t_s must be one clock in both"
        )
