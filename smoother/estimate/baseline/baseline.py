"""The thesis' pipeline from a calibrated session to a trajectory, as a reference; and the fixes alone.

Gyro bias, level and north at rest; Madgwick's filter; specific force rotated into North-West-Up; the six-state Kalman
filter forwards in time. Calibration and fixes are the smoother's. As in the thesis, a fix counts as true at the moment
it was received, Doppler velocity is no measurement, and the antenna sits on the IMU.

It has no estimate of height, nor a sigma of attitude; these are NaN.
"""

from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.disc import pieces, release, roomy
from smoother.estimate.baseline import alignment
from smoother.estimate.baseline.kalman import (
    KalmanInput,
    KalmanOutput,
    accel_covariance_at_rest,
    accel_covariance_in_motion,
    fix_variance,
    run_kalman,
)
from smoother.estimate.baseline.madgwick import BETA, ZETA, run_madgwick
from smoother.estimate.baseline.steps import Steps, average_into_steps, nearest
from smoother.estimate.output.resample import between_rows, bracket
from smoother.fit.ellipsoid import FitError
from smoother.fit.levelling import yaw_from_field
from smoother.fit.magnetic_model import session_declination
from smoother.frames import GRAVITY_N, euler_from_rotation
from smoother.samples import MagSamples, Problem, Session
from smoother.trajectory import EstimateReport, Sigmas, Trajectory

UNITY = np.array([1.0, 0.0, 0.0, 0.0])
UNITY.flags.writeable = False
LONGEST_STEP = 0.5  # s, gap of the IMU over which its turn is still integrated
UNKNOWN_ACCEL = 50.0  # m/s^2, sigma of the acceleration where neither motion nor rest shows one


@dataclass(frozen=True)
class BaselineOptions:
    """rate Hz of filter and rows; alpha m^2/s^4 per step, eq. 2.54; beta rad/s and zeta rad/s^2, listing 5.G.

    alpha: the best over simulated sessions of all presets (benchmarks/baseline_alpha.py; docs/tables).
    accel_covariance: eq. 2.67 "in motion", or "at rest" as the thesis has it; see kalman.py.
    """

    rate: float = 50.0
    alpha: float = 3.16
    beta: float = BETA
    zeta: float = ZETA
    accel_covariance: Literal["in motion", "at rest"] = "in motion"


@dataclass(frozen=True, eq=False)
class Inertial:
    """The IMU's part, at its P steps: R_ns (P, 3, 3), acceleration_n (P, 3) m/s^2; R_bs (3, 3) and gyro_bias (3,)."""

    steps: Steps
    R_ns: Array
    acceleration_n: Array
    R_bs: Array
    gyro_bias: Array
    problems: tuple[Problem, ...]


class ThesisBaseline:
    """Madgwick attitude and a six-state Kalman filter, after the thesis."""

    name = "baseline"

    def __init__(self, options: BaselineOptions | None = None) -> None:
        """Take the tuned defaults, or `options`."""
        self.options = BaselineOptions() if options is None else options

    def estimate(self, session: Session) -> Trajectory:
        """Return rows at `rate` from the first to the last fix; see the module's text for what is NaN."""
        started = perf_counter()
        fixes, options = session.gnss, self.options
        position = session.fix_position_n[:, :2]
        course = alignment.course_of(fixes, position)
        inertial = _inertial(session, course, options)
        oriented = perf_counter()
        t = fixes.t[0] + np.arange(int((fixes.t[-1] - fixes.t[0]) * options.rate + 1e-6) + 1) / options.rate
        filtered = run_kalman(_measurements(session, position, inertial, course, t, options), options.alpha)
        timings = {"attitude": oriented - started, "kalman": perf_counter() - oriented}
        return _trajectory(t, filtered, inertial, timings)


# ---- the IMU --------------------------------------------------------------------------------------------------------

_NO_IMU = Problem("baseline_no_imu", "no usable IMU; the baseline filters the fixes alone")
_NO_MAGNETOMETER = Problem(
    "baseline_no_magnetometer", "no calibrated magnetometer; north of the baseline comes from the first minute's motion"
)
_NO_NORTH = Problem("baseline_no_north", "too little motion to find north; the baseline's heading is arbitrary")
_NO_FORWARD = Problem(
    "baseline_no_forward",
    "too little motion to find forward; the baseline assumes that the x axis of the logger points forward",
)


def _inertial(session: Session, course: alignment.Course, options: BaselineOptions) -> Inertial | None:
    """Attitude and acceleration at the steps; None without an IMU, or without a force."""
    imu = session.imu
    if imu is None or len(imu.t) < 2:
        return None
    try:
        rest = alignment.rest_state(session, imu, course)
    except FitError:
        return None
    steps = average_into_steps(imu, rest.is_at_rest, float(session.gnss.t[0]), 1.0 / options.rate)
    mag = _usable_magnetometer(session)
    R_ns, problems = _attitude(session, steps, mag, rest, options)
    acceleration_n = roomy(steps.specific_force_s.shape)
    for part in pieces(len(R_ns)):
        acceleration_n[part] = np.einsum("nij,nj->ni", R_ns[part], steps.specific_force_s[part]) + GRAVITY_N
        release(R_ns, steps)
    if mag is None:
        north = alignment.north_from_motion(steps.t, acceleration_n[:, :2], course)
        problems += () if north is not None else (_NO_NORTH,)
        turn = alignment.turned_about_up(north or 0.0)
        for part in pieces(len(R_ns)):
            R_ns[part], acceleration_n[part] = turn @ R_ns[part], acceleration_n[part] @ turn.T
            release(R_ns, acceleration_n)
    R_bs, mounting_problems = _mounting(session, steps.t, R_ns, rest, course, mag is not None)
    problems = rest.problems + problems + mounting_problems
    return Inertial(steps, R_ns, acceleration_n, R_bs, rest.gyro_bias, problems)


def _usable_magnetometer(session: Session) -> MagSamples | None:
    """Only a calibrated field points north: hard iron is as strong as the Earth's field."""
    mag = session.mag
    if mag is None or session.config.magnetometer.use is False:
        return None
    return mag if mag.is_calibrated and len(mag.t) else None


def _attitude(
    session: Session, steps: Steps, mag: MagSamples | None, rest: alignment.RestState, options: BaselineOptions
) -> tuple[Array, tuple[Problem, ...]]:
    """R_ns (P, 3, 3); without a magnetometer its yaw starts at zero."""
    declination, field, yaw = 0.0, None, 0.0
    problems: tuple[Problem, ...] = (_NO_MAGNETOMETER,)
    if mag is not None:
        declination, problems = session_declination(session)
        field = _field_at(steps.t, mag)
        yaw = _starting_yaw(mag, rest)
    # As in listing 5.G all readings are first turned by the attitude at the start, and the filter begins at unity.
    R_0s = alignment.turned_about_up(yaw) @ rest.R_ls
    force = _turned(steps.specific_force_s, np.zeros(3), R_0s)
    rate = _turned(steps.angular_rate_s, rest.gyro_bias, R_0s)
    field = None if field is None else field @ R_0s.T
    after, _ = run_madgwick(
        np.minimum(steps.interval, LONGEST_STEP), force, rate, field, UNITY, options.beta, options.zeta
    )
    # The filter knows the attitude at the end of each step; half way there it was between two of them.
    R_ns, before = roomy((len(after), 3, 3)), UNITY
    for part in pieces(len(after)):
        middle = after[part] + np.vstack([before, after[part.start : part.stop - 1]])
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        # Its x axis is magnetic north, which lies the declination east of true north.
        R_ns[part] = alignment.turned_about_up(-declination) @ so3.from_quaternion_wxyz(middle) @ R_0s
        before = after[part.stop - 1].copy()
        release(R_ns, after)
    return R_ns, problems


def _turned(values: Array, bias: Array, R: Array) -> Array:
    """Vectors (P, 3) without their bias (3,), in the axes that R (3, 3) takes them to."""
    out = roomy(values.shape)
    for part in pieces(len(values)):
        out[part] = (values[part] - bias) @ R.T
        release(out, values)
    return out


def _field_at(t: Array, mag: MagSamples) -> Array:
    """Field (P, 3) at every step, between readings by straight lines, NaN before the first and after the last.

    Listing 5.G corrects with the field only at the samples that brought a reading, one in ten.
    """
    columns = [np.interp(t, mag.t, column, left=np.nan, right=np.nan) for column in mag.field_s.T]
    return np.stack(columns, axis=-1)


def _starting_yaw(mag: MagSamples, rest: alignment.RestState) -> float:
    """Yaw from magnetic north by eq. 2.32, over the rest at the start if there is one."""
    i, j = np.searchsorted(mag.t, rest.start)
    first = min(int(i), len(mag.t) - 1)
    try:
        return yaw_from_field(np.mean(mag.field_s[first : max(int(j), first + 1)], axis=0), rest.mean_force)
    except FitError:
        return 0.0


def _mounting(
    session: Session, t: Array, R_ns: Array, rest: alignment.RestState, course: alignment.Course, has_north: bool
) -> tuple[Array, tuple[Problem, ...]]:
    """R_bs as configured, else level at rest and forward along the straights."""
    if session.config.mounting.R_bs is not None:
        return np.asarray(session.config.mounting.R_bs, dtype=np.float64), ()
    yaw_l = np.empty(len(R_ns))
    for part in pieces(len(R_ns)):
        yaw_l[part] = euler_from_rotation(R_ns[part] @ rest.R_ls.T)[2]
        release(R_ns)
    duration = np.inf if has_north else alignment.FIRST_MOTION  # without north, yaw drifts away later
    heading = alignment.forward_of_box(t, yaw_l, course, duration)
    if heading is None:
        return rest.R_ls, (_NO_FORWARD,)
    return alignment.turned_about_up(heading) @ rest.R_ls, ()


# ---- the filter -----------------------------------------------------------------------------------------------------


def _measurements(
    session: Session,
    position: Array,
    inertial: Inertial | None,
    course: alignment.Course,
    t: Array,
    options: BaselineOptions,
) -> KalmanInput:
    fixes, period = session.gnss, 1.0 / options.rate
    at_step = np.clip(np.rint((fixes.t - t[0]) / period).astype(np.int64), 0, len(t) - 1)
    acceleration, covariance = np.full((len(t), 2), np.nan), np.eye(2)
    if inertial is not None:
        acceleration = inertial.steps.on_clock(inertial.acceleration_n[:, :2], len(t))
        covariance = _accel_covariance(inertial, course, options)
    return KalmanInput(
        step=period,
        acceleration=acceleration,
        accel_covariance=covariance,
        at_step=at_step,
        delay=fixes.t - t[at_step],
        position=position,
        fix_variance=fix_variance(fixes, position),
    )


def _accel_covariance(inertial: Inertial, course: alignment.Course, options: BaselineOptions) -> Array:
    steps, acceleration = inertial.steps, inertial.acceleration_n[:, :2]
    if options.accel_covariance == "at rest":
        found = accel_covariance_at_rest(acceleration, steps.is_at_rest)
    else:
        found = accel_covariance_in_motion(steps.t, acceleration, course, steps.period)
    return UNKNOWN_ACCEL**2 * np.eye(2) if found is None else found


# ---- the result -----------------------------------------------------------------------------------------------------


def _trajectory(t: Array, filtered: KalmanOutput, inertial: Inertial | None, timings: dict[str, float]) -> Trajectory:
    n = len(t)
    if inertial is not None:
        R_nb, acceleration_b, angular_rate_b = _body_motion(inertial, t)
    else:
        unknown = np.full((n, 3), np.nan)
        R_nb, acceleration_b, angular_rate_b = np.full((n, 3, 3), np.nan), unknown, unknown
    for values in (R_nb, acceleration_b, angular_rate_b):
        values.flags.writeable = False
    problems = (_NO_IMU,) if inertial is None else inertial.problems
    return Trajectory(
        t=t,
        position_n=_with_unknown_up(filtered.position),
        velocity_n=_with_unknown_up(filtered.velocity),
        R_nb=R_nb,
        acceleration_b=acceleration_b,
        angular_rate_b=angular_rate_b,
        sigmas=_sigmas(filtered),
        report=EstimateReport(problems=problems, timings=timings, mode="gps-only" if inertial is None else "full"),
    )


def _body_motion(inertial: Inertial, t: Array) -> tuple[Array, Array, Array]:
    """R_nb (K, 3, 3), kinematic acceleration and rate (K, 3) in b at t, NaN farther than LONGEST_STEP from a step."""
    n, steps, R_sb = len(t), inertial.steps, inertial.R_bs.T
    R_nb, acceleration_b, angular_rate_b, at = roomy((n, 3, 3)), roomy((n, 3)), roomy((n, 3)), steps.t
    for part in pieces(n):
        near = nearest(at, t[part])
        away = (t[part] - at[near])[:, None]
        is_known = np.abs(away) <= LONGEST_STEP
        rate_s = steps.angular_rate_s[near] - inertial.gyro_bias
        R_ns = inertial.R_ns[near]
        acceleration_s = np.einsum("nji,nj->ni", R_ns, inertial.acceleration_n[near])
        turned = R_ns @ so3.exp(np.clip(away, -LONGEST_STEP, LONGEST_STEP) * rate_s)
        R_nb[part] = np.where(is_known[:, :, None], turned @ R_sb, np.nan)
        acceleration_b[part] = np.where(is_known, acceleration_s @ R_sb, np.nan)
        angular_rate_b[part] = np.where(is_known, rate_s @ R_sb, np.nan)
        release(R_nb, acceleration_b, angular_rate_b, inertial)
    return R_nb, acceleration_b, angular_rate_b


def _with_unknown_up(horizontal: Array) -> Array:
    out = roomy((len(horizontal), 3))
    for part in pieces(len(horizontal)):
        out[part, :2], out[part, 2] = horizontal[part], np.nan
        release(out, horizontal)
    out.flags.writeable = False
    return out


def _sigmas(filtered: KalmanOutput) -> Sigmas:
    """Sigmas of the Kalman filter, which assumes independent errors of the fixes; none of attitude."""
    n = len(filtered.position)
    position, velocity, of_speed = roomy((n, 2)), roomy((n, 2)), roomy(n)
    for part in pieces(n):
        variance, v = filtered.velocity_covariance[part], filtered.velocity[part]
        speed = np.hypot(v[:, 0], v[:, 1])[:, None]
        along = np.where(speed > 0.0, v / np.where(speed > 0.0, speed, 1.0), [1.0, 0.0])
        position[part] = np.sqrt(np.einsum("kii->ki", filtered.position_covariance[part]))
        velocity[part] = np.sqrt(np.einsum("kii->ki", variance))
        of_speed[part] = np.sqrt(np.einsum("ki,kij,kj->k", along, variance, along))
        release(position, velocity, of_speed, filtered)
    unknown = _with_unknown_up(np.broadcast_to(np.nan, (n, 2)))
    of_speed.flags.writeable = False
    return Sigmas(
        position_n=_with_unknown_up(position),
        velocity_n=_with_unknown_up(velocity),
        speed=of_speed,
        attitude=unknown,
        track=np.full(n, np.nan),
    )


class GpsAlone:
    """Straight lines between the fixes as received, without correction of the latency."""

    name = "GPS alone"

    def __init__(self, rate: float = 50.0) -> None:
        """`rate`: rows per second, Hz, besides one row at each fix."""
        self._rate = rate

    def estimate(self, session: Session) -> Trajectory:
        """Return the fixes joined by straight lines; heights and velocities likewise where they are known."""
        fixes = fixes_as_trajectory(session)
        first, last = fixes.t[0], fixes.t[-1]
        grid = first + np.arange(int((last - first) * self._rate) + 1) / self._rate
        t = np.union1d(grid, fixes.t)
        t = t[np.concatenate([[True], np.diff(t) > 1e-9])]
        place = bracket(fixes.t, t)
        return _gps_trajectory(t, between_rows(fixes.position_n, place), between_rows(fixes.velocity_n, place))


def fixes_as_trajectory(session: Session) -> Trajectory:
    """Return the fixes themselves, one row each; velocity from speed and course where no components were sent."""
    fixes = session.gnss
    return _gps_trajectory(fixes.t, session.fix_position_n, fixes.velocity_n)


def _gps_trajectory(t: Array, position_n: Array, velocity_n: Array) -> Trajectory:
    n = len(t)
    unknown = np.full((n, 3), np.nan)
    report = EstimateReport(mode="gps-only")
    return Trajectory(t, position_n, velocity_n, np.full((n, 3, 3), np.nan), unknown, unknown, report=report)
