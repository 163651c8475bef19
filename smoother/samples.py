"""What sensors deliver: raw (in counts, axes s) and calibrated (SI, axes s), as different types.

RawSession is what a reader returns; `smoother.calibration.Calibration.apply` turns it into a Session, which is all an
estimator ever sees. Everything stays in sensor axes s, because the mounting of the logger is an unknown that the
estimator finds; only its result is in body axes b.

All arrays are float64 and read-only; times are seconds on one clock per session, strictly increasing.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.arrays import Array, BoolArray, freeze, frozen, frozen_int, median, require_increasing
from smoother.config import SessionConfig
from smoother.disc import pieces
from smoother.frames import Origin, geodetic_to_nwu

SENSOR_AXES = 3
GAP_STEPS = 1.5  # usual steps, beyond which a sample is missing
BESIDE = 16  # steps before or after one, that tell the rate there
SLOWEST_STEP = 0.0525  # s; twenty samples a second, with some jitter: fewer do not tell how a kart moves

IMU_BEFORE_FIXES, IMU_AFTER_FIXES = "imu_before_fixes", "imu_after_fixes"  # by the stamps of both, as they were read
IMU_AXES_UNKNOWN, IMU_INCOMPLETE = "imu_axes_unknown", "imu_incomplete"  # codes of motion sensors that are not used
DEAD_AXES = "imu_axis_dead"  # code of the problem that axes of the inertial sensor never change


@dataclass(frozen=True)
class Problem:
    """A flaw of the data that was handled: a machine-readable code, a sentence for people, and a count."""

    code: str
    text: str
    count: int = 1


def usual_step(t: Array) -> float:
    """Return the usual step of times t (N,) s, N > 1: the median; of hours, that of the medians of their parts.

    All differences of a day, and a copy to sort them in, would be a quarter of a gigabyte.
    """
    parts = pieces(len(t) - 1)
    return median(np.array([median(np.diff(t[part.start : part.stop + 1])) for part in parts]))


def usual_steps(steps: Array, usual: float) -> Array:
    """Return the usual step (N,) s where each of `steps` (N,) s between samples is, of which `usual` s is the median.

    A sensor or its logger may go on more slowly, as a telephone that got warm: where steps are alike for a while that
    is the rate, and no samples are lost. Slower than SLOWEST_STEP they do not count.
    """
    local = np.full(len(steps), usual)
    long = np.flatnonzero(steps > GAP_STEPS * usual)
    for part in pieces(len(long), 1 << 16):  # steps whose neighbours are looked at together
        for beside in (np.arange(BESIDE + 1), np.arange(-BESIDE, 1)):
            some = long[part]
            some = some[(some + beside[0] >= 0) & (some + beside[-1] < len(steps))]
            short, middle, tall = np.percentile(steps[some[:, None] + beside], [20.0, 50.0, 80.0], axis=1)
            # ratio of the long ones among these to the short ones; between samples lost by chance it is more
            is_rate = (tall < 1.6 * short) & (middle > GAP_STEPS * usual) & (middle <= SLOWEST_STEP)
            local[some[is_rate]] = middle[is_rate]
    return local


def are_gaps(steps: Array, usual: float, times: float) -> BoolArray:
    """Mask (N,) of the steps s that are longer than `times` the :func:`usual_steps`."""
    return np.asarray(steps > times * usual_steps(steps, usual))


@dataclass(frozen=True)
class Sampling:
    """Time from sample to sample, s, rms over the time that there are any; sigma, s, of when they were taken."""

    every: float
    stamp_sigma: float = 0.0


@dataclass(frozen=True, eq=False)
class RawImu:
    """Inertial samples as logged. t (N,) s; accel, gyro (N, 3) counts in s; temperature (N,) deg C, NaN where unknown.

    accel_scale is m/s^2 per count, gyro_scale rad/s per count (1.0 for files in SI). Full scale in SI, or None if
    the file does not say; clipping is judged by it. longest_step s: in a longer interval samples were lost, as the
    reader found from the stamps before it evened them out, or they come more slowly for a while (:func:`usual_steps`);
    None where this is unknown. stamp_sigma s: of when samples were taken, where their stamps are too coarse to say.
    """

    t: Array
    accel: Array
    gyro: Array
    accel_scale: float = 1.0
    gyro_scale: float = 1.0
    accel_full_scale: float | None = None
    gyro_full_scale: float | None = None
    temperature: Array | None = None
    longest_step: float | None = None
    stamp_sigma: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, t=(None,), accel=(len(self.t), 3), gyro=(len(self.t), 3))
        if self.temperature is not None:
            freeze(self, temperature=(len(self.t),))
        require_increasing(self.t, "RawImu.t")


@dataclass(frozen=True, eq=False)
class RawMag:
    """Magnetometer as logged. t (N,) s; field (N, 3) in any unit, axes s."""

    t: Array
    field: Array

    def __post_init__(self) -> None:
        freeze(self, t=(None,), field=(len(self.t), 3))
        require_increasing(self.t, "RawMag.t")


@dataclass(frozen=True, eq=False)
class WheelSpeed:
    """Speed by the turning of a wheel, as logged: t (N,) s; speed (N,) m/s, never negative."""

    t: Array
    speed: Array

    def __post_init__(self) -> None:
        freeze(self, t=(None,), speed=(len(self.t),))
        require_increasing(self.t, "WheelSpeed.t")


@dataclass(frozen=True, eq=False)
class Channel:
    """A quantity that was logged beside the motion, as engine speed: t (N,) s; values (N,), none of them NaN.

    name : of its column in tables, lower case with the unit at its end, as water_temp_c. unit : as people write it, "".
    """

    name: str
    unit: str
    t: Array
    values: Array

    def __post_init__(self) -> None:
        freeze(self, t=(None,), values=(len(self.t),))
        require_increasing(self.t, "Channel.t")

    def between(self, begin: float, end: float) -> "Channel":
        """Return what was logged after begin and before end, s."""
        inside = (self.t > begin) & (self.t < end)
        return replace(self, t=self.t[inside], values=self.values[inside])

    def at(self, t: Array) -> Array:
        """Values (M,) at times t (M,) s: between neighbours, of a gear or a switch the last one; NaN in gaps."""
        if len(self.t) < 2:
            return np.full(t.shape, np.nan)
        steps = np.diff(self.t)
        longest = max(2.5 * median(steps), 1.5)  # 2.5 usual steps; intervals under 1.5 s are no gap in any channel
        after = np.clip(np.searchsorted(self.t, t, side="right"), 1, len(self.t) - 1)
        # at most 12 different whole values: a gear or a switch, which is not interpolated
        if np.unique(self.values).size <= 12 and np.all(self.values == np.round(self.values)):
            values = self.values[np.where(t >= self.t[-1], after, after - 1)]
        else:
            values = np.interp(t, self.t, self.values)
        known = (steps[after - 1] <= longest) & (t >= self.t[0]) & (t <= self.t[-1])
        return np.where(known, values, np.nan)


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """Calibrated inertial samples. t (N,) s; specific_force_s (N, 3) m/s^2; angular_rate_s (N, 3) rad/s; axes s.

    A sample holds the mean over the interval that ends at its time. Full scales, longest_step and stamp_sigma as in
    :class:`RawImu`.
    """

    t: Array
    specific_force_s: Array
    angular_rate_s: Array
    accel_full_scale: float | None = None
    gyro_full_scale: float | None = None
    longest_step: float | None = None
    stamp_sigma: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, t=(None,), specific_force_s=(len(self.t), 3), angular_rate_s=(len(self.t), 3))
        require_increasing(self.t, "ImuSamples.t")

    @property
    def interval(self) -> float:
        """Usual time from sample to sample, s."""
        return usual_step(self.t)

    @property
    def sampling(self) -> Sampling:
        """Interval of the samples, and the sigma of their times."""
        usual, squares, total = self.interval, 0.0, 0.0
        for part in pieces(len(self.t) - 1):
            steps = np.diff(self.t[part.start : part.stop + 1])
            local = usual_steps(steps, usual)
            sampled = np.minimum(steps, local)
            squares, total = squares + float(local**2 @ sampled), total + float(np.sum(sampled))
        return Sampling(math.sqrt(squares / total), self.stamp_sigma)

    def between(self, start: float, end: float) -> "ImuSamples":
        """Return the samples with start <= t < end."""
        return self.rows(slice(*np.searchsorted(self.t, [start, end])))

    def rows(self, rows: slice) -> "ImuSamples":
        """Return some of the samples."""
        force, rate = self.specific_force_s[rows], self.angular_rate_s[rows]
        return replace(self, t=self.t[rows], specific_force_s=force, angular_rate_s=rate)


@dataclass(frozen=True, eq=False)
class MagSamples:
    """Magnetic field, t (N,) s, field_s (N, 3) in axes s. Unit field if `is_calibrated`, else any unit."""

    t: Array
    field_s: Array
    is_calibrated: bool = False

    def __post_init__(self) -> None:
        freeze(self, t=(None,), field_s=(len(self.t), 3))
        require_increasing(self.t, "MagSamples.t")


_ABOVE_ZERO = ("sigma_horizontal", "sigma_up", "sigma_velocity", "hdop")
_OPTIONAL_COLUMNS = ("speed", "course_deg", "sigma_horizontal", "sigma_up", "sigma_velocity", "hdop", "unix_s")


@dataclass(frozen=True, eq=False)
class GnssFixes:
    """Position fixes, one row each, NaN where a column is unknown.

    t (N,) s receive time on the session clock; lat_deg, lon_deg, alt_m (N,) WGS-84 (alt NaN if unknown);
    velocity_n (N, 3) m/s (components NaN if unknown); speed (N,) m/s and course_deg (N,) clockwise from north, as sent;
    sigma_horizontal, sigma_up (N,) m and sigma_velocity (N,) m/s per axis, as reported by the receiver; hdop (N,);
    num_sv (N,) satellites, -1 unknown; fix (N,) quality, >= 1 usable; unix_s (N,) the receiver's own UTC. A sigma
    or an hdop that is not above zero is none, and unknown.
    """

    t: Array
    lat_deg: Array
    lon_deg: Array
    alt_m: Array
    velocity_n: Array
    speed: Array | None = None
    course_deg: Array | None = None
    sigma_horizontal: Array | None = None
    sigma_up: Array | None = None
    sigma_velocity: Array | None = None
    hdop: Array | None = None
    unix_s: Array | None = None
    num_sv: np.ndarray | None = None
    fix: np.ndarray | None = None

    def __post_init__(self) -> None:
        n = len(self.t)
        freeze(self, t=(n,), lat_deg=(n,), lon_deg=(n,), alt_m=(n,), velocity_n=(n, 3))
        for name in _OPTIONAL_COLUMNS:
            value = getattr(self, name)
            value = np.full(n, np.nan) if value is None else value
            value = np.where(np.less_equal(value, 0.0), np.nan, value) if name in _ABOVE_ZERO else value
            object.__setattr__(self, name, frozen(value, (n,), f"GnssFixes.{name}"))
        for name, unknown in (("num_sv", -1), ("fix", 1)):
            value = getattr(self, name)
            value = np.full(n, unknown) if value is None else value
            object.__setattr__(self, name, frozen_int(value, (n,), f"GnssFixes.{name}"))
        require_increasing(self.t, "GnssFixes.t")

    def __len__(self) -> int:
        return len(self.t)

    def position_n(self, origin: Origin) -> Array:
        """Positions in n, (N, 3) m; an unknown height counts as the origin's and has Up NaN."""
        known = np.isfinite(self.alt_m)
        position = geodetic_to_nwu(self.lat_deg, self.lon_deg, np.where(known, self.alt_m, origin.alt_m), origin)
        position[~known, 2] = np.nan
        return position

    @property
    def unix_at_zero(self) -> float | None:
        """UTC, seconds since 1970, at t = 0 by the stamps of the fixes; None where none says when it was true."""
        difference = np.empty(0) if self.unix_s is None else self.unix_s - self.t
        known = np.isfinite(difference)
        return float(np.median(difference[known])) if known.any() else None

    def select(self, keep: np.ndarray) -> "GnssFixes":
        """Return the rows chosen by a mask (N,) bool or by indices."""
        names = ("t", "lat_deg", "lon_deg", "alt_m", "velocity_n", *_OPTIONAL_COLUMNS, "num_sv", "fix")
        return GnssFixes(**{name: getattr(self, name)[keep] for name in names})


@dataclass(frozen=True, eq=False)
class RawSession:
    """One recording as read: sensors in counts and axes s, fixes in degrees, and what was flawed."""

    name: str
    gnss: GnssFixes
    imu: RawImu | None = None
    mag: RawMag | None = None
    mag_calibration_field: Array | None = None  # (K, 3) magcalib.txt: the field while turned in every direction, axes s
    config: SessionConfig = field(default_factory=SessionConfig)
    inputs: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    unix_at_zero: float | None = None  # UTC, seconds since 1970, at t = 0
    wheel_speed: WheelSpeed | None = None
    channels: tuple[Channel, ...] = ()


@dataclass(frozen=True)
class AppliedValue:
    """A value that was applied to the samples: flat or nested numbers, sigma if known, and the file it is from."""

    quantity: str
    value: tuple[object, ...]
    sigma: tuple[object, ...] | None
    unit: str
    source: str


@dataclass(frozen=True, eq=False)
class Session:
    """One recording, calibrated: what every estimator is given. Axes s, SI; `origin` places n."""

    name: str
    gnss: GnssFixes
    origin: Origin
    imu: ImuSamples | None = None
    mag: MagSamples | None = None
    config: SessionConfig = field(default_factory=SessionConfig)
    inputs: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    unix_at_zero: float | None = None
    calibration: tuple[AppliedValue, ...] = ()
    wheel_speed: WheelSpeed | None = None
    channels: tuple[Channel, ...] = ()

    @property
    def fix_position_n(self) -> Array:
        """Positions of the fixes in n, (N, 3) m, Up NaN where the height is unknown."""
        return self.gnss.position_n(self.origin)
