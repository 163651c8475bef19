"""Initial alignment of the baseline: gyro bias, and up, north and forward in sensor axes.

The thesis finds them in 30 s at rest with a magnetometer, with axes of the sensor along those of the kart. Where a
session offers less, a substitute is used and reported:

    nothing at rest      level by the mean force, gyro bias by the mean rate less the net turn of the course
    no magnetometer      north by comparing the first minute's accelerations with those of the fixes
    mounting unknown     the kart stands level at rest; forward is where it goes on straights
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.fit.gyro_bias import fit_gyro_bias
from smoother.fit.levelling import levelled
from smoother.fit.standstill import session_standstill
from smoother.frames import rotation_from_euler, wrap_angle
from smoother.samples import GnssFixes, ImuSamples, Problem, Session
from smoother.units import DEG

MOVING = 5.0  # m/s; above, the course of a fix is good to a few degrees
STRAIGHT = 10.0 * DEG  # rad/s about up
FIRST_MOTION = 60.0  # s of driving by which north is found without a magnetometer: long enough to average corners
SETTING_OFF = 3.0  # s before that, while the kart gathers speed
FEWEST = 10  # fixes on straights, or spans of acceleration, for a direction
TURN_SPAN = 0.5  # s over which a turn is measured, against noise
SPAN = 1.0  # s over which velocity changes are compared


@dataclass(frozen=True, eq=False)
class RestState:
    """gyro_bias (3,) rad/s; mean_force (3,) m/s^2; R_ls (3, 3) from sensor axes to level ones of the same heading;
    is_at_rest (N,) of the samples; start (s, s): the rest that the session begins with, or its first second.
    """

    gyro_bias: Array
    mean_force: Array
    R_ls: Array
    is_at_rest: BoolArray
    start: tuple[float, float]
    problems: tuple[Problem, ...]


@dataclass(frozen=True, eq=False)
class Course:
    """Velocity of the fixes: t (M,) s; velocity (M, 2) m/s north and west."""

    t: Array
    velocity: Array

    @property
    def is_moving(self) -> BoolArray:
        """Fast enough for a course, (M,)."""
        return np.asarray(np.hypot(self.velocity[:, 0], self.velocity[:, 1]) > MOVING)

    @property
    def yaw(self) -> Array:
        """Direction of travel (M,) rad, anticlockwise from north."""
        return np.arctan2(self.velocity[:, 1], self.velocity[:, 0])


def course_of(fixes: GnssFixes, position: Array) -> Course:
    """Velocity as the receiver sent it, else by differences of position (M, 2) over two seconds."""
    velocity = fixes.velocity_n[:, :2]
    known = np.all(np.isfinite(velocity), axis=1)
    if len(fixes) > 1:
        low = np.searchsorted(fixes.t, fixes.t - SPAN - 1e-6)
        high = np.minimum(np.searchsorted(fixes.t, fixes.t + SPAN + 1e-6, side="right") - 1, len(fixes) - 1)
        span = np.maximum(fixes.t[high] - fixes.t[low], 1e-3)
        differenced = (position[high] - position[low]) / span[:, None]
    else:
        differenced = np.zeros_like(position)
    return Course(fixes.t, np.where(known[:, None], velocity, differenced))


def rest_state(session: Session, imu: ImuSamples, course: Course) -> RestState:
    """Gyro bias and level from rest, or from their substitutes."""
    is_at_rest = session_standstill(session)
    start = _start(imu.t, is_at_rest)
    if np.count_nonzero(is_at_rest) >= 2:
        force = np.mean(imu.specific_force_s[is_at_rest], axis=0)
        bias = fit_gyro_bias(imu.angular_rate_s, is_at_rest).bias
        return RestState(bias, force, levelled(force), is_at_rest, start, ())
    force = np.mean(imu.specific_force_s, axis=0)
    bias = np.mean(imu.angular_rate_s, axis=0) - _mean_turn(imu, course) * force / np.linalg.norm(force)
    text = "the kart never stood still; level and gyro bias of the baseline come from means over the drive"
    return RestState(bias, force, levelled(force), is_at_rest, start, (Problem("baseline_no_standstill", text),))


def _mean_turn(imu: ImuSamples, course: Course) -> float:
    """Mean rate of the course about up, rad/s, over the time the IMU covers."""
    inside = course.is_moving & (course.t >= imu.t[0]) & (course.t <= imu.t[-1])
    yaw = np.unwrap(course.yaw[inside])
    return float((yaw[-1] - yaw[0]) / (imu.t[-1] - imu.t[0])) if yaw.size > 1 else 0.0


def _start(imu_t: Array, is_at_rest: BoolArray) -> tuple[float, float]:
    """First and last time (s) of the rest that a session starts with, or of its first second."""
    begins = np.flatnonzero(is_at_rest & (imu_t < imu_t[0] + 1.0))
    if begins.size == 0:
        return float(imu_t[0]), float(imu_t[0] + 1.0)
    moved = np.flatnonzero(~is_at_rest[begins[0] :])
    last = begins[0] + moved[0] - 1 if moved.size else len(imu_t) - 1
    return float(imu_t[begins[0]]), float(imu_t[last])


def north_from_motion(t: Array, acceleration: Array, course: Course) -> float | None:
    """Angle (rad) from level axes of unknown heading to north, or None without enough motion.

    acceleration (N, 2) m/s^2 at t (N,) s in those axes. Changes of velocity over SPAN seconds by fixes and by
    accelerometer differ by that turn alone; the first FIRST_MOTION seconds of driving count.
    """
    fix_t, own, fixes = velocities_at_fixes(t, acceleration, course)
    is_moving = np.hypot(fixes[:, 0], fixes[:, 1]) > MOVING
    if not np.any(is_moving):
        return None
    moves = fix_t[np.argmax(is_moving)]
    use = np.flatnonzero((fix_t > moves - SETTING_OFF) & (fix_t < moves + FIRST_MOTION))
    later = np.searchsorted(fix_t, fix_t[use] + SPAN - 1e-6)
    use, later = use[later < fix_t.size], later[later < fix_t.size]
    if use.size < FEWEST:
        return None
    as_complex = np.array([1.0, 1.0j])  # the quotient of two such vectors is a turn
    match = np.sum(((fixes[later] - fixes[use]) @ as_complex) * np.conj((own[later] - own[use]) @ as_complex))
    return float(np.angle(match)) if abs(match) > 0.0 else None


def velocities_at_fixes(t: Array, acceleration: Array, course: Course) -> tuple[Array, Array, Array]:
    """Times (M,) of the fixes inside t (N,), and there the integral of acceleration (N, 2) and the fixes' velocity."""
    velocity = np.cumsum(acceleration * np.diff(t, prepend=t[0])[:, None], axis=0)
    inside = (course.t >= t[0]) & (course.t <= t[-1])
    fix_t = course.t[inside]
    own = np.stack([np.interp(fix_t, t, column) for column in velocity.T], axis=-1)
    return fix_t, own, course.velocity[inside]


def forward_of_box(t: Array, yaw_l: Array, course: Course, duration: float) -> float | None:
    """Heading (rad) of the levelled sensor in the kart: median of its yaw less the course on straights, or None.

    yaw_l (N,) rad of the levelled sensor axes at t (N,) s; only the first `duration` seconds of driving count.
    """
    inside = course.is_moving & (course.t >= t[0]) & (course.t <= t[-1])
    if np.count_nonzero(inside) < FEWEST:
        return None
    inside &= course.t <= course.t[inside][0] + duration
    yaw = np.unwrap(yaw_l)
    turn = np.interp(course.t + 0.5 * TURN_SPAN, t, yaw) - np.interp(course.t - 0.5 * TURN_SPAN, t, yaw)
    straight = inside & (np.abs(turn) < STRAIGHT * TURN_SPAN)
    chosen = straight if np.count_nonzero(straight) >= FEWEST else inside
    difference = wrap_angle(np.interp(course.t[chosen], t, yaw) - course.yaw[chosen])
    middle = np.arctan2(np.mean(np.sin(difference)), np.mean(np.cos(difference)))
    return float(wrap_angle(middle + np.median(wrap_angle(difference - middle))))


def turned_about_up(angle: float) -> Array:
    """Return Rz(angle), (3, 3)."""
    return rotation_from_euler(np.asarray(0.0), np.asarray(0.0), np.asarray(angle))
