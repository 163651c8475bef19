"""A recording as one format read it, and the RawSession that it becomes: settings, one time base, what can be used.

Sentences name the file that values came from. What format it has, nothing here asks.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, median
from smoother.config import SessionConfig
from smoother.disc import kept, release, settle
from smoother.errors import SessionError
from smoother.samples import (
    IMU_AFTER_FIXES,
    IMU_AXES_UNKNOWN,
    IMU_BEFORE_FIXES,
    IMU_INCOMPLETE,
    Beside,
    Channel,
    GnssFixes,
    Problem,
    RawImu,
    RawMag,
    RawSession,
    WheelSpeed,
)
from smoother.session.clock import LARGEST_DRIFT, are_fix_gaps, describe_time_base, regularize, true_fix_times
from smoother.session.counts import with_range_by_path
from smoother.session.days import longest_recording
from smoother.session.files import SessionFiles
from smoother.session.frozen import without_frozen_sensor
from smoother.session.inertial import FEWEST_IMU_SAMPLES
from smoother.session.leap_seconds import with_learnt_leap_seconds
from smoother.session.pace import with_even_pace
from smoother.session.plausible import implausible_units, without_other_units
from smoother.session.settings import load_settings
from smoother.session.spikes import without_spikes
from smoother.session.standing import dead_problems, stuck_problems, without_frozen
from smoother.session.time_unit import LONGEST_PERIOD
from smoother.session.turned import without_turned, without_turned_about
from smoother.session.utc_leaps import leaps
from smoother.session.week_rollover import with_present_dates
from smoother.session.wheel_speed import usable_wheel_speed
from smoother.words import counted, span

SLOWEST_IMU = 20.0  # Hz; below, a kart's motion between samples is lost (contract, section 3)
SAME_RATE = 0.02  # share; a clock or its digits may make 20 Hz a little less
SLOWEST_FIXES = 20.0  # s from one to the next; likewise
MANY_HEIGHTS = 50  # of which two would differ by a digit if they were measured
NO_RECEPTION = ("gps_no_fix", "gps_null_island")  # what a receiver writes that does not see its satellites
# said of files whose columns may be right all the same
OF_NO_COLUMN = (
    *("gps_row_cut", "gps_header_again", "gps_time_unit", "gps_clock_set_back", "gps_blocks_moved"),
    "gps_repeated_time",
)
FEWEST_FIXES_FOR_CLOCK = 32
LEAST_AT_ODDS, FEW_AT_ODDS = 10.0, 0.01  # s beyond what clocks drift, and share of the fixes, worth a word
LEAST_UNFIXED = (10.0, 0.05)  # s and share of the IMU's recording, before the first fix or after the last


@dataclass(frozen=True, eq=False)
class Recording:
    """What one format made of a directory, before settings and time base. The file names are for sentences."""

    gnss: GnssFixes
    gnss_file: str
    inputs: tuple[str, ...]
    problems: tuple[Problem, ...]
    imu: RawImu | None = None
    imu_file: str = ""
    mag: RawMag | None = None
    mag_calibration_field: Array | None = None
    unix_at_zero: float | None = None  # where the file tells it, but not with each fix
    imu_delay: float | None = None  # s, of the low-pass before the sampling, where the file tells it; it is taken off
    wheel_speed: WheelSpeed | None = None
    channels: tuple[Channel, ...] = ()


def finish(files: SessionFiles, recording: Recording) -> RawSession:
    """Apply session.toml and the clock; see to it that what is left can be used.

    Raises SessionError where it cannot: no fix, or fixes and samples that never run together; ConfigError for settings.
    """
    recording = replace(recording, gnss=_without_fillers(recording.gnss))
    settings = files.find("session.toml")
    config = SessionConfig() if settings is None else load_settings(settings)
    _require_fixes(recording)
    problems = [*recording.problems, *_missing_heights(recording)]
    dated = with_present_dates(recording.gnss, recording.gnss_file, time.time(), config.date, problems)
    recording = replace(recording, gnss=with_learnt_leap_seconds(dated, recording.gnss_file, problems))
    imu = _usable_imu(recording, problems)
    beside = Beside(_evened_mag(recording.mag), recording.wheel_speed, recording.channels)
    gnss, imu, beside = with_even_pace(recording.gnss, imu, beside, recording.gnss_file, problems)
    gnss = _with_true_times(replace(recording, gnss=gnss), problems)
    gnss, imu, beside = longest_recording(gnss, imu, beside, recording.gnss_file, problems)
    imu = _if_enough(imu, recording.imu_file, " in the recording that is used", problems)
    if imu is not None:
        imu = with_range_by_path(imu, gnss, recording.imu_file, problems)
        imu = without_spikes(imu, recording.imu_file, problems)
        problems += dead_problems(imu, recording.imu_file)
        imu = without_frozen(imu, gnss, recording.imu_file, problems)
        imu = without_frozen_sensor(imu, gnss, recording.imu_file, problems)
        imu = _if_enough(imu, recording.imu_file, " in which neither sensor stands still", problems)
    if imu is not None:
        imu = _without_filter_delay(imu, recording, config.imu_delay, problems)
        config = replace(config, imu_delay=config.imu_delay if recording.imu_delay is None else recording.imu_delay)
        imu = without_other_units(imu, recording.imu_file, problems)
        imu = without_turned(imu, gnss, recording.imu_file, problems)
        imu = without_turned_about(imu, gnss, recording.imu_file, problems)
        imu = _if_enough(imu, recording.imu_file, " in which units and mounting are those of most", problems)
    if imu is not None:
        problems += stuck_problems(imu, gnss, recording.imu_file)
        _compare_times(recording, imu, gnss, problems)
        settle(imu)
    mag = beside.mag
    return RawSession(
        name=files.session_name(),
        gnss=gnss,
        imu=imu,
        mag=None if mag is None or mag.t.size == 0 else mag,
        wheel_speed=usable_wheel_speed(beside.wheel_speed, gnss, has_imu=imu is not None, problems=problems),
        channels=beside.channels,
        mag_calibration_field=recording.mag_calibration_field,
        config=config,
        inputs=recording.inputs if settings is None else (*recording.inputs, settings.name),
        problems=tuple(problems),
        unix_at_zero=recording.unix_at_zero if (told := gnss.unix_at_zero) is None else told,
    )


def _without_filter_delay(imu: RawImu, recording: Recording, delay: float | None, problems: list[Problem]) -> RawImu:
    """The samples when they were true, by the delay (s) that session.toml states.

    They count as means over the time since the one before, and so as true half of that before their stamps already.
    """
    if delay is None or len(imu.t) < 2:
        return imu
    if recording.imu_delay is not None:
        text = f"session.toml: [imu] delay is not used; {recording.imu_file} says what its filter was"
        problems.append(Problem("imu_delay_known", text))
        return imu
    return replace(imu, t=imu.t - (delay - 0.5 * median(np.diff(imu.t))))


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


def _usable_imu(recording: Recording, problems: list[Problem]) -> RawImu | None:
    """The inertial samples on an even time base; None, with the reason in `problems`, if they are of no use."""
    imu, file = recording.imu, recording.imu_file
    if imu is None:
        is_there = any(problem.code in (IMU_AXES_UNKNOWN, IMU_INCOMPLETE) for problem in problems)
        text = "no IMU that can be used" if is_there else "no IMU recorded"
        problems.append(Problem("imu_missing", f"{text}: smoothed from GPS alone"))
        return None
    base = regularize(imu.t)
    reasons = list(_reasons_against(imu, base.period))
    release(imu)
    for code, reason in reasons:
        problems.append(Problem(code, f"{file}: {reason}: smoothed from GPS alone"))
        return None
    problems += describe_time_base(base, "imu", file)
    imu = replace(imu, t=kept(base.t), longest_step=base.longest_step)
    release(imu)
    return imu


def _if_enough(imu: RawImu | None, file: str, which: str, problems: list[Problem]) -> RawImu | None:
    """The samples; None, said in `problems`, if hardly any are left; `which` completes what they are."""
    if imu is None or imu.t.size >= FEWEST_IMU_SAMPLES:
        return imu
    text = f"{file}: only {counted(imu.t.size, 'usable sample')}{which}: smoothed from GPS alone"
    problems.append(Problem("imu_missing", text))
    return None


def _reasons_against(imu: RawImu, period: float) -> Iterator[tuple[str, str]]:
    """Problem codes and reasons why the inertial samples cannot be used at all."""
    if imu.t.size < FEWEST_IMU_SAMPLES:
        yield "imu_missing", f"only {counted(imu.t.size, 'usable sample')}"
        return
    if period * SLOWEST_IMU > 1.0 + SAME_RATE:
        asked = "; is t_s in seconds?" if period > LONGEST_PERIOD else ""
        rates = f"{1 / period:.3g} samples a second, {SLOWEST_IMU:.0f} are needed"
        yield "imu_too_slow", f"the motion sensor is too slow ({rates}{asked})"
    for reason in implausible_units(imu):
        yield "imu_implausible", reason


def _evened_mag(mag: RawMag | None) -> RawMag | None:
    if mag is None or mag.t.size == 0:
        return None
    return replace(mag, t=regularize(mag.t).t)


def _with_true_times(recording: Recording, problems: list[Problem]) -> GnssFixes:
    """The fixes at the receiver's own times, by its UTC or else by its steady rate; a constant latency remains."""
    gnss = recording.gnss
    assert gnss.unix_s is not None
    t, by_utc, delay_steps = true_fix_times(gnss.t, gnss.unix_s, None if recording.imu is None else recording.imu.t)
    problems += _delay_steps(delay_steps, recording.gnss_file)
    if not by_utc and len(gnss) >= FEWEST_FIXES_FOR_CLOCK:
        t = regularize(gnss.t).t
    problems += _utc_at_odds(recording)
    steps = np.diff(t)
    if steps.size:
        if (usual := float(np.median(steps))) > SLOWEST_FIXES:
            text = f"{recording.gnss_file}: a fix only every {usual:.0f} s; is t_s in seconds?"
            problems.append(Problem("gps_too_slow", text))
        gaps = steps[are_fix_gaps(steps)]
        if gaps.size:
            text = f"{recording.gnss_file}: {counted(gaps.size, 'gap')} in the fixes, the longest {span(gaps.max())}"
            problems.append(Problem("gps_gap", text, int(gaps.size)))
    return replace(gnss, t=t)


def _delay_steps(steps: Sequence[tuple[float, float]], file: str) -> Iterator[Problem]:
    """What to say where fixes come later, or sooner, from about some moment on: steps of when and by how much, s."""
    for at, by in steps:
        text = (
            f"from about {at:.0f} s on the fixes come {abs(by):.3f} s {'later' if by > 0.0 else 'earlier'} than before"
        )
        text += " behind their UTC, by which their times were mended; the delay that is given is that of most of them"
        yield Problem("gps_delay_steps", f"{file}: {text}")


def _utc_at_odds(recording: Recording) -> Iterator[Problem]:
    """What to say where the UTC of some fixes is that of another time than the others', by their t_s."""
    gnss = recording.gnss
    assert gnss.unix_s is not None
    known = np.isfinite(gnss.unix_s)
    if np.count_nonzero(known) < FEWEST_FIXES_FOR_CLOCK:
        return
    ahead = (gnss.unix_s - gnss.t)[known]
    ahead -= np.median(ahead)
    drift = LARGEST_DRIFT * float(gnss.t[-1] - gnss.t[0])
    odd = np.abs(ahead) > LEAST_AT_ODDS + 2.0 * drift
    count = int(np.count_nonzero(odd))
    if count > FEW_AT_ODDS * ahead.size:
        text = f"UTC of {counted(count, 'fix')} is {np.median(ahead[odd]):+.0f} s off that of the others by their times"
        yield Problem("gps_utc_at_odds", f"{recording.gnss_file}: {text}; one of the two clocks was set anew", count)
        return
    yield from _utc_set(gnss.t[known], gnss.unix_s[known], recording.gnss_file)


def _utc_set(t: Array, unix_s: Array, file: str) -> Iterator[Problem]:
    """What to say where one of the two clocks, stamps t (N,) s or UTC (N,) s, leapt against the other for good."""
    for leap in leaps(t, unix_s):
        at = f"at {t[leap.row]:.0f} s"
        if leap.set == "either":
            text = f"UTC leaps by {leap.by:+.2f} s against t_s in the gap {at}: one of the two was set anew"
            yield Problem(
                "gps_utc_set", f"{file}: {text}; if it was t_s and is not taken out, the lap across is off by as much"
            )
        elif leap.set == "utc":
            text = f"UTC leaps by {leap.by:+.2f} s {at}, and t_s does not; times of day are off by as much there"
            yield Problem("gps_utc_set", f"{file}: {text}")
        else:
            text = (
                f"t_s leaps by {-leap.by:+.2f} s {at}, and UTC does not; if not taken out, the lap across is off by it"
            )
            yield Problem("gps_clock_set", f"{file}: {text}")


def _compare_times(recording: Recording, imu: RawImu, gnss: GnssFixes, problems: list[Problem]) -> None:
    """Raise SessionError if IMU and fixes never run together; say where one of them ran on without the other."""
    if gnss.t[-1] < imu.t[0] or imu.t[-1] < gnss.t[0]:
        raise SessionError(
            f"{recording.imu_file} ({imu.t[0]:.1f} to {imu.t[-1]:.1f} s) and {recording.gnss_file} "
            f"({gnss.t[0]:.1f} to {gnss.t[-1]:.1f} s) do not overlap in time; t_s must be one clock in both"
        )
    outside = int(np.count_nonzero((gnss.t < imu.t[0]) | (gnss.t > imu.t[-1])))
    if outside > 0.01 * len(gnss):
        text = f"{recording.gnss_file}: {outside} of {len(gnss)} fixes lie before or after the IMU's recording"
        problems.append(Problem("gps_outside_imu", text, outside))
    problems += _without_fixes(recording, imu, gnss)


def _without_fixes(recording: Recording, imu: RawImu, gnss: GnssFixes) -> Iterator[Problem]:
    """What to say where the IMU runs long before the first fix or on after the last: no result is given there."""
    seconds, share = LEAST_UNFIXED
    least = max(seconds, share * (imu.t[-1] - imu.t[0]))
    before, after = gnss.t[0] - imu.t[0], imu.t[-1] - gnss.t[-1]
    if before > least:
        text = f"the first fix comes {before:.0f} s after the IMU's first sample; nothing is smoothed before it"
        yield Problem(IMU_BEFORE_FIXES, f"{recording.gnss_file}: {text}")
    if after > least:
        text = f"the last fix comes {after:.0f} s before the IMU's last sample; nothing is smoothed after it"
        yield Problem(IMU_AFTER_FIXES, f"{recording.gnss_file}: {text}; did the GPS stop?")
