"""Check of a recording before driving: rates, gaps, fixes, clipping and vibration, in a second.

A finding is `ok`, a `warning` (the result will be poorer) or a `stop` (the data would be useless). Units are SI.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, are_near
from smoother.disc import pieces, release
from smoother.estimate.initial.align import aligned, beginning
from smoother.estimate.preprocess.gains import is_on_wheel, without_the_wheels
from smoother.fit.running import running_mean
from smoother.samples import (
    DEAD_AXES,
    IMU_AXES_UNKNOWN,
    IMU_INCOMPLETE,
    GnssFixes,
    Problem,
    RawImu,
    RawMag,
    RawSession,
    are_gaps,
    usual_step,
)
from smoother.session.checks.imu import dead_axes
from smoother.session.clock import are_fix_gaps, regularize
from smoother.units import DEG, STANDARD_GRAVITY
from smoother.words import counted, span

SMOOTHING = 0.5  # s; quicker than this is vibration, slower is the motion of the kart
ENOUGH = 1 << 20  # samples whose slow part is kept, an hour and a half at 200 Hz; of more each n-th
SMALLEST_ACCEL_RANGE = 2.0 * STANDARD_GRAVITY  # of the MEMS sensors on the market
SMALLEST_GYRO_RANGE = 250.0 * DEG
_OWN_LOGGER = (".klg", "out.txt", "simulation")  # ends of inputs of this project's loggers, all with a motion sensor
_WITH_SENSOR = (*_OWN_LOGGER, "imu.csv", "imu.csv.gz")  # ends of inputs that promise a motion sensor
USELESS = ("imu_missing", "imu_too_slow", "imu_implausible")  # problems of the reader that explain missing samples
_UNUSED = (IMU_AXES_UNKNOWN, IMU_INCOMPLETE, "imu_unused", "imu_empty", "imu_folder")  # a sensor is there, but not read
SPEED_NEAR = 1.0  # s; a receiver may send its velocity less often than its position
WHEEL_SAMPLES = 1 << 18  # used to detect a logger on the steering wheel, twenty minutes at 200 Hz
NO_SENSOR = "no motion sensor"
FARTHER_AWAY = "mount the logger farther from the engine"
_JUDGED_HERE = ("gps_gap", "imu_gap", DEAD_AXES)  # problems of the reader that have findings of their own below


@dataclass(frozen=True)
class CheckLimits:
    """Limits of the findings; beyond those named `stop` the data is useless."""

    shortest: float = 10.0  # s of fixes; too short for a rate
    fix_rate: float = 4.0  # Hz; a kart goes 5 m between two fixes at 5 Hz
    fix_gap: float = 1.0  # s
    fix_gap_stop_share: float = 0.2  # of the recording spent in gaps
    accuracy: float = 5.0  # m, median as reported
    accuracy_stop: float = 20.0  # m
    satellites: float = 6.0
    imu_rate: float = 90.0  # Hz; engine vibration folds into the kart's motion below it
    imu_rate_stop: float = 20.0  # Hz; cannot be integrated
    imu_gap: float = 0.05  # s; a shorter one is bridged without loss
    imu_gap_stop_share: float = 0.05  # of the samples lost
    clipped: float = 0.001  # share of samples
    clipped_stop: float = 0.02
    accel_vibration: float = 8.0  # m/s^2 rms over the three axes; a rigidly mounted logger on a kart has about 4
    accel_bent: float = 25.0  # m/s^2 rms; stronger and clipped vibration biases gravity
    bent_gravity: tuple[float, float] = (0.45, 2.0)  # of the standard, then
    gyro_vibration: float = 120.0 * DEG  # rad/s rms; about 95 deg/s was seen on a kart that still could be smoothed
    gravity: tuple[float, float] = (0.75, 1.6)  # of the standard, slow specific force at its 20th percentile
    turn_rate: float = 10.0  # rad/s, slow rate rms; above it the file is most likely in deg/s


@dataclass(frozen=True)
class Finding:
    """`level` is ok, warning or stop; `text` is a sentence with its remedy."""

    level: str
    topic: str
    text: str


@dataclass(frozen=True)
class Check:
    """All findings about a recording and the measures behind them.

    is_gps_only: there is no motion sensor, or the unusable one of another logger.
    """

    name: str
    findings: tuple[Finding, ...]
    measures: dict[str, float]
    is_gps_only: bool = False

    @property
    def is_good(self) -> bool:
        """Whether no finding is a stop."""
        return all(finding.level != "stop" for finding in self.findings)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why not to drive, empty if good."""
        return tuple(finding.text for finding in self.findings if finding.level == "stop")


Part = tuple[list[Finding], dict[str, float]]  # findings and measures of one sensor


def check(raw: RawSession, limits: CheckLimits | None = None) -> Check:
    """Judge a recording as it was read."""
    limits = CheckLimits() if limits is None else limits
    gps_only = _is_gps_only(raw)
    imu = _only_gnss(raw.problems) if gps_only else _check_imu(raw.imu, limits, _is_of(raw, _OWN_LOGGER))
    parts = [_check_gnss(raw.gnss, limits), imu, _check_mag(raw.mag)]
    if raw.imu is not None and len(raw.gnss):
        parts += [_check_clocks(raw.gnss, raw.imu), _check_axes(raw, raw.imu)]
    judged = (*_JUDGED_HERE, *USELESS) if gps_only else _JUDGED_HERE
    notes = [Finding("warning", "file", p.text) for p in raw.problems if p.code not in judged]
    findings = [finding for found, _ in parts for finding in found]
    measures = {name: value for _, measured in parts for name, value in measured.items()}
    return Check(raw.name, (*findings, *notes), measures, gps_only)


def _is_gps_only(raw: RawSession) -> bool:
    """Whether the recording can have fixes only; an unusable motion sensor of this project's logger is a fault."""
    if raw.imu is not None or _is_of(raw, _OWN_LOGGER):
        return False
    promised = raw.mag is not None or _is_of(raw, _WITH_SENSOR)
    return not promised or _why_useless(raw.problems) != NO_SENSOR


def _is_of(raw: RawSession, ends: tuple[str, ...]) -> bool:
    return any(name.lower().endswith(ends) for name in raw.inputs)


def _why_useless(problems: tuple[Problem, ...]) -> str:
    """The reader's reason why a motion sensor has no usable samples."""
    for problem in problems:
        reason = problem.text.removesuffix(": smoothed from GPS alone").partition(": ")[2]
        if problem.code in USELESS and reason:
            return reason if problem.code == "imu_too_slow" else f"the motion sensor cannot be used ({reason})"
    is_there = any(problem.code in _UNUSED for problem in problems)
    return "the motion sensor cannot be used" if is_there else NO_SENSOR


def _only_gnss(problems: tuple[Problem, ...]) -> Part:
    text = f"{_why_useless(problems)}; the GPS alone gives no roll, pitch or sideslip"
    return ([Finding("warning", "IMU", text)], {})


def _check_gnss(fixes: GnssFixes, limits: CheckLimits) -> Part:
    if len(fixes) < 2:
        text = "no GPS fix; wait in the open until the receiver has found its satellites"
        return ([Finding("stop", "GPS", text)], {"fixes": float(len(fixes))})
    lasts, limit = float(fixes.t[-1] - fixes.t[0]), max(limits.fix_gap, 2.5 * float(np.median(np.diff(fixes.t))))
    interval, without = _interval_and_gaps(fixes.t, limit)
    steps = np.diff(fixes.t)
    gaps = steps[are_fix_gaps(steps)]  # as the reader counts them
    measures = {
        "duration_s": lasts,
        "fixes": float(len(fixes)),
        "fix_rate_hz": 1.0 / interval,
        "fix_gaps": float(gaps.size),
        "fix_gap_longest_s": float(np.max(gaps, initial=0.0)),
        "fix_gap_share": float(np.sum(without)) / lasts,
        "accuracy_median_m": _median(fixes.sigma_horizontal),
        "satellites_median": _median(_known_satellites(fixes)),
        "speed_known_share": float(np.mean(_have_speed(fixes))),
        "top_speed_mps": _top_speed(fixes),
    }
    return (list(_judge_gnss(measures, limits)), measures)


def _judge_gnss(measures: dict[str, float], limits: CheckLimits) -> Iterator[Finding]:
    if measures["duration_s"] < limits.shortest:
        text = f"only {measures['duration_s']:.2g} s of fixes, too short to judge; record a minute"
        yield Finding("stop", "GPS", text)
    rate = measures["fix_rate_hz"]
    text = f"{counted(int(measures['fixes']), 'fix')} in {measures['duration_s']:.0f} s, {rate:.3g} a second"
    slow = rate < limits.fix_rate
    yield Finding("warning" if slow else "ok", "GPS", text + ("; set the receiver to 5 Hz or more" if slow else ""))
    if measures["fix_gaps"]:
        lost = measures["fix_gap_share"] > limits.fix_gap_stop_share
        text = f"{counted(int(measures['fix_gaps']), 'gap')}, the longest {measures['fix_gap_longest_s']:.1f} s"
        yield Finding("stop" if lost else "warning", "GPS", text + "; give the antenna a free view of the sky")
    accuracy = measures["accuracy_median_m"]
    if np.isfinite(accuracy):
        level = "ok" if accuracy <= limits.accuracy else "warning" if accuracy <= limits.accuracy_stop else "stop"
        remedy = "" if level == "ok" else "; wait for better reception, or move the antenna"
        yield Finding(level, "GPS", f"the receiver reports an accuracy of {accuracy:.1f} m{remedy}")
    if measures["satellites_median"] < limits.satellites:
        text = f"only {measures['satellites_median']:.0f} satellites; the antenna needs a free view of the sky"
        yield Finding("warning", "GPS", text)
    if measures["speed_known_share"] < 0.5:
        yield Finding("warning", "GPS", "no speed and course in most fixes; switch on RMC or VTG sentences")


def _check_imu(imu: RawImu | None, limits: CheckLimits, is_own: bool) -> Part:
    if imu is None or len(imu.t) < 2:
        return ([Finding("stop", "IMU", "no usable motion sensor; only the GPS could be smoothed")], {})
    lasts = float(imu.t[-1] - imu.t[0])
    interval, gaps = _samples_and_gaps(imu)
    force = _motion(imu.accel, imu.accel_scale, interval, imu.accel_full_scale, SMALLEST_ACCEL_RANGE)
    turn = _motion(imu.gyro, imu.gyro_scale, interval, imu.gyro_full_scale, SMALLEST_GYRO_RANGE)
    measures = {
        "imu_rate_hz": 1.0 / interval,
        "imu_gaps": float(gaps.size),
        "imu_gap_longest_s": float(np.max(gaps, initial=0.0)),
        "imu_gap_share": float(np.sum(gaps - interval)) / lasts,
        "accel_clipped_share": force.clipped,
        "gyro_clipped_share": turn.clipped,
        "accel_vibration_mps2": force.vibration,
        "gyro_vibration_dps": turn.vibration / DEG,
        "slow_force_mps2": float(np.percentile(np.linalg.norm(force.slow, axis=1), 20)),
        "slow_turn_rate_dps": _rms(turn.slow - np.median(turn.slow, axis=0)) / DEG,
    }
    findings = [*_judge_imu_timing(measures, limits, is_own), *_judge_imu_values(measures, limits)]
    return ([*findings, *_dead_axes(imu)], measures)


def _judge_imu_timing(measures: dict[str, float], limits: CheckLimits, is_own: bool) -> Iterator[Finding]:
    """is_own: recorded by a logger of this project, whose card may lose samples."""
    rate = measures["imu_rate_hz"]
    level = "ok" if rate >= limits.imu_rate else "warning" if rate >= limits.imu_rate_stop else "stop"
    yield Finding(level, "IMU", f"{rate:.0f} samples a second" + ("" if level == "ok" else "; 100 or more are wanted"))
    if measures["imu_gaps"]:
        lost = measures["imu_gap_share"] > limits.imu_gap_stop_share
        long = measures["imu_gap_longest_s"] > limits.imu_gap
        text = f"{counted(int(measures['imu_gaps']), 'gap')}, the longest {span(measures['imu_gap_longest_s'])}"
        level = "stop" if lost else "warning" if long else "ok"
        remedy = "; try another card" if is_own and (lost or long) else ", of samples that were lost"
        yield Finding(level, "IMU", text + remedy)


def _judge_imu_values(measures: dict[str, float], limits: CheckLimits) -> Iterator[Finding]:
    for sensor, words in (("accel", "acceleration"), ("gyro", "turn rate")):
        share = measures[f"{sensor}_clipped_share"]
        if share > limits.clipped:
            text = f"{100 * share:.2g} % of the {words} samples are clipped; set a wider range, or {FARTHER_AWAY}"
            yield Finding("stop" if share > limits.clipped_stop else "warning", "IMU", text)
    accel, gyro = measures["accel_vibration_mps2"], measures["gyro_vibration_dps"]
    strong = accel > limits.accel_vibration or gyro * DEG > limits.gyro_vibration
    remedy = "; mount the logger on the frame, away from the engine" if strong else ""
    yield Finding("warning" if strong else "ok", "IMU", f"vibration {accel:.1f} m/s² and {gyro:.0f} deg/s rms{remedy}")
    gravity, (low, high) = measures["slow_force_mps2"] / STANDARD_GRAVITY, limits.gravity
    if not low <= gravity <= high:
        reads = f"the accelerometer reads {measures['slow_force_mps2']:.2f} m/s² where 9.8 is due"
        least, most = limits.bent_gravity
        if accel > limits.accel_bent and least <= gravity <= most:
            text = f"{reads}, as where vibration is clipped; set a wider range, or {FARTHER_AWAY}"
            yield Finding("warning", "IMU", text)
        else:
            yield Finding("stop", "IMU", f"{reads}; is it in another unit?")
    if measures["slow_turn_rate_dps"] * DEG > limits.turn_rate:
        yield Finding("stop", "IMU", "the gyroscope turns faster than any kart; is it in deg/s instead of rad/s?")


def _dead_axes(imu: RawImu) -> Iterator[Finding]:
    for sensor, axis in dead_axes(imu):
        yield Finding("stop", "IMU", f"the {axis} axis of the {sensor} never changes; check the wiring")


def _check_mag(mag: RawMag | None) -> Part:
    if mag is None or len(mag.t) < 2:
        return ([Finding("ok", "compass", "none; it is not needed")], {})
    rate = 1.0 / float(np.median(np.diff(mag.t)))
    return ([Finding("ok", "compass", f"{rate:.3g} samples a second")], {"mag_rate_hz": rate})


def _check_clocks(fixes: GnssFixes, imu: RawImu) -> Part:
    covered = float(np.mean((fixes.t >= imu.t[0] - 1.0) & (fixes.t <= imu.t[-1] + 1.0)))
    if covered > 0.95:
        return ([], {"fixes_with_imu_share": covered})
    text = f"the motion sensor covers only {100 * covered:.0f} % of the fixes"
    return ([Finding("stop" if covered < 0.5 else "warning", "IMU", text)], {"fixes_with_imu_share": covered})


def _check_axes(raw: RawSession, imu: RawImu) -> Part:
    """Axes that no mounting explains, and a logger on the steering wheel, by the beginning of the recording."""
    found = aligned(imu, raw.gnss)
    problems = () if found is None else found.problems
    is_misnamed = found is not None and found.is_misnamed
    if is_steered := not is_misnamed and is_on_wheel(beginning(imu, WHEEL_SAMPLES), raw.gnss):
        problems = without_the_wheels(problems)
    findings = [Finding("stop", "IMU", problem.text) for problem in problems]
    if not findings and is_steered:
        text = "the logger turns with the steering wheel; roll, yaw and sideslip are the wheel's: mount it on the frame"
        findings.append(Finding("warning", "IMU", text))
    return (findings, {})


def _samples_and_gaps(imu: RawImu) -> tuple[float, Array]:
    """Mean interval of samples (s), and the intervals in which some were lost, by the reader's limit if it has one."""
    if imu.longest_step is not None:
        return _interval_and_gaps(imu.t, imu.longest_step)
    base = regularize(imu.t)
    return _interval_and_gaps(base.t, base.longest_step)


def _interval_and_gaps(t: Array, limit: float) -> tuple[float, Array]:
    """Mean step (s), and the steps longer than `limit` seconds, which are not in the mean unless the rate is lower."""
    gaps, total, count, usual = [], 0.0, 0, usual_step(t)
    for part in pieces(len(t) - 1):
        steps = np.diff(t[part.start : part.stop + 1])
        good = ~are_gaps(steps, usual, limit / usual)
        gaps.append(steps[~good])
        total, count = total + float(np.sum(steps[good])), count + int(np.count_nonzero(good))
        release(t)
    return total / count, np.concatenate(gaps)


@dataclass(frozen=True, eq=False)
class _Motion:
    """Of the samples of a sensor: share clipped, rms of vibration, and slow part (n, 3), thinned, in SI."""

    clipped: float
    vibration: float
    slow: Array


def _motion(values: Array, scale: float, interval: float, full_scale: float | None, smallest_range: float) -> _Motion:
    """Of samples (N, 3), `scale` each, in parts that fit into memory."""
    window, step = max(1, round(SMOOTHING / interval)), max(1, len(values) // ENOUGH)
    lowest, highest = (scale * extreme for extreme in _extremes(values))
    clipped, squares, slow = 0, 0.0, []
    for part in pieces(len(values)):
        begin = max(0, part.start - window)
        around = values[begin : part.stop + window] * scale
        core = slice(part.start - begin, part.stop - begin)
        mean = running_mean(around, window)[core]
        squares += float(np.sum((around[core] - mean) ** 2))
        slow.append(mean[-part.start % step :: step].copy())
        if full_scale is not None:
            clipped += int(np.count_nonzero(np.any(np.abs(around[core]) >= 0.995 * full_scale, axis=1)))
        else:
            since = around[max(core.start - 1, 0) : core.stop]
            clipped += _repeated_ends(since, lowest, highest, 0.95 * smallest_range)
        release(values)
    n = len(values) - (full_scale is None)
    return _Motion(clipped / n, float(np.sqrt(squares / len(values))), np.concatenate(slow))


def _extremes(values: Array) -> tuple[Array, Array]:
    """Least and greatest value of each axis of (N, 3) samples."""
    lowest, highest = values[0], values[0]
    for part in pieces(len(values)):
        lowest = np.minimum(lowest, values[part].min(axis=0))
        highest = np.maximum(highest, values[part].max(axis=0))
        release(values)
    return lowest, highest


def _repeated_ends(values: Array, lowest: Array, highest: Array, least: float) -> int:
    """Number of (N, 3) samples that repeat an extreme of their axis beyond `least`, as when clipped."""
    at_end = (values[1:] == lowest) | (values[1:] == highest)
    repeated = at_end & (values[1:] == values[:-1]) & (np.abs(values[1:]) > least)
    return int(np.count_nonzero(np.any(repeated, axis=1)))


def _known_satellites(fixes: GnssFixes) -> Array:
    count = np.asarray(fixes.num_sv, dtype=np.float64)
    return np.where(count > 0.0, count, np.nan)


def _have_speed(fixes: GnssFixes) -> BoolArray:
    """Mask (N,) of the fixes with a velocity within SPEED_NEAR."""
    return are_near(fixes.t, fixes.t[np.isfinite(fixes.velocity_n[:, 0])], SPEED_NEAR)


def _top_speed(fixes: GnssFixes) -> float:
    speed = np.hypot(fixes.velocity_n[:, 0], fixes.velocity_n[:, 1])
    return float(np.max(speed[np.isfinite(speed)], initial=0.0))


def _median(values: Array | None) -> float:
    known = np.empty(0) if values is None else values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def _rms(values: Array) -> float:
    """Rms over all three axes together of (N, 3) samples."""
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))
