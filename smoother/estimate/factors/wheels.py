"""Wheels roll along the kart (non-holonomic factor), and a sensor counts their turns (wheel speed).

Sideslip is the angle from the heading to the course. Four constants describe its mean: an angle, and coefficients of
lateral acceleration, of its rate, and of curvature (the IMU is ahead of the rear axle). The rest is a Gauss-Markov
process whose sigma grows with lateral acceleration. The factor ties yaw to the course where the kart drives.

A wheel's speed has a scale, because its circumference is entered by hand; a slip in proportion to forward acceleration,
and to the square of lateral acceleration, because a sliding tyre turns by the cosine of its sideslip; and the lateral
distance of the wheel times the turn rate."""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.factors.rows import Between, Rows, no_jacobian, rows_of
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.state import KEYFRAME_SIZE, ROTATION, VELOCITY, State
from smoother.frames import UP_N, wrap_angle
from smoother.samples import WheelSpeed

SLIDING, MARGIN = np.radians(20.0), 1.0  # rad beside the usual slip, of a slide or a spin, and s around it
SLIDING_SIGMAS = 3.0  # tolerance of the slip, beyond SLIDING
MOST_SLIDING = 0.2  # of the time at speed; a logger with more is not fixed to the chassis
LARGEST_SCATTER = np.radians(4.0)  # scatter of the slip of a logger on the chassis
WEIGHT_SIGMA = np.radians(1.0)  # error of a slip that reduces its weight to a quarter
FEWEST_KEYFRAMES = 100  # keyframes at speed
MOVING = 4.0  # m/s, above which a course is defined
LATERAL_NOISE = 0.05  # m/s, white lateral velocity from bumps
SLIP_TIME = 2.0  # s, time constant of the process: a corner
# m/s^2 of lateral acceleration and m/s^3 of its rate at which the process has its sigma, and the share of that on
# straights: a hard corner of a kart, turning in, and 0.2 deg
USUAL_LATERAL, USUAL_JERK, STRAIGHT = 10.0, 25.0, 0.3


@dataclass(frozen=True, eq=False)
class Slip:
    """Sideslip beyond its constants at the keyframes, divided by the relative sigma `level` (K,) of the process.

    value (K,) rad; own (K,) rad: white noise of a keyframe; Jacobians by_keyframe (K, 18), by_constants (K, 4).
    """

    value: Array
    own: Array
    level: Array
    by_keyframe: Array
    by_constants: Array


def slip_of(state: State, motion: LowPassedMotion) -> Slip:
    """Return the sideslip at the keyframes of `state`."""
    along, velocity_n = motion.at(state.t), state.velocity_n
    ahead_n = state.R_ns @ state.geometry.level_axes_s[0]
    speed = np.maximum(np.hypot(velocity_n[:, 0], velocity_n[:, 1]), MOVING)
    left_n = np.cross(UP_N, velocity_n) / speed[:, None]
    lateral = np.sum(left_n * along.acceleration_n, axis=1)
    later = np.sum(left_n * along.jerk_n, axis=1)
    level = np.sqrt(STRAIGHT**2 + (lateral / USUAL_LATERAL) ** 2 + (later / USUAL_JERK) ** 2)
    design = np.column_stack([np.ones(len(speed)), lateral, later, lateral / speed**2])
    course = np.arctan2(velocity_n[:, 1], velocity_n[:, 0]) - np.arctan2(ahead_n[:, 1], ahead_n[:, 0])
    by_keyframe = np.zeros((len(speed), KEYFRAME_SIZE))
    by_keyframe[:, ROTATION], by_keyframe[:, VELOCITY] = -state.R_ns[:, 2, :], left_n / speed[:, None]
    return Slip(
        wrap_angle(course - design @ state.constants["slip"]) / level,
        LATERAL_NOISE / speed / level,
        level,
        by_keyframe / level[:, None],
        -design / level[:, None],
    )


def rolling(slip: Slip, moves: BoolArray, variance: Array, interval: float) -> BoolArray | None:
    """Keyframes (K,) at which wheels roll, by the slip of a solution without wheels; None where the factor does not
    apply: where the IMU turns relative to the path, as on a steering wheel, or slips more than a chassis does.

    moves (K,): keyframes at speed; variance (K,): of slip.value, by the errors of that solution. interval s.
    """
    if np.count_nonzero(moves) < FEWEST_KEYFRAMES:
        return None
    angle = slip.value * slip.level
    angle = wrap_angle(angle - np.median(angle[moves]))
    rolls = without_slides(angle, moves, SLIDING_SIGMAS * slip.level * np.sqrt(variance), interval)
    if np.count_nonzero(rolls) < (1.0 - MOST_SLIDING) * np.count_nonzero(moves):
        return None
    weight = 1.0 / (variance[rolls] + WEIGHT_SIGMA**2)
    design = slip.by_constants[rolls] * np.sqrt(weight)[:, None]
    value = angle[rolls] / slip.level[rolls]
    fit = np.linalg.lstsq(design, value * np.sqrt(weight), rcond=None)[0]
    beyond = np.minimum((value - slip.by_constants[rolls] @ fit) ** 2, SLIDING**2) - variance[rolls]
    sigma = np.sqrt(max(float(np.average(beyond, weights=weight**2)), 0.0))
    return None if sigma > LARGEST_SCATTER else rolls


def without_slides(angle: Array, moves: BoolArray, unsure: Array | float, interval: float) -> BoolArray:
    """Keyframes (K,) at speed without a slide or spin around them.

    angle (K,) rad: sideslip beyond the usual; moves (K,): keyframes at speed; unsure rad: its tolerance.
    """
    sliding = moves & (np.abs(angle) > SLIDING + unsure)
    around = np.convolve(sliding, np.ones(2 * round(MARGIN / interval) + 1), "same") > 0.5
    return np.asarray(moves & ~around)


def slip_rows(slip: Slip, rolls: BoolArray, sigma: float, interval: float) -> tuple[Rows, Rows]:
    """The process: its starts, and its steps, rad.

    rolls (K,): keyframes at which the wheels roll. sigma rad at the level of a hard corner; interval s. The process
    needs no variable. Source: Gelb 1974, 3.8.
    """
    phi = np.exp(-interval / SLIP_TIME)
    steps = np.flatnonzero(rolls[:-1] & rolls[1:])
    starts = steps[np.diff(steps, prepend=-2) > 1]
    left, right = no_jacobian(len(starts), 1)
    left[:, 0] = slip.by_keyframe[starts]
    spread = np.sqrt(sigma**2 + slip.own[starts] ** 2)
    start = _rows("slip_start", starts, slip.value[starts], spread, left, right, slip.by_constants[starts])
    left, right = no_jacobian(len(steps), 1)
    left[:, 0], right[:, 0] = -phi * slip.by_keyframe[steps], slip.by_keyframe[steps + 1]
    spread = np.sqrt(sigma**2 * (1.0 - phi**2) + slip.own[steps + 1] ** 2 + phi**2 * slip.own[steps] ** 2)
    by_constants = slip.by_constants[steps + 1] - phi * slip.by_constants[steps]
    value = slip.value[steps + 1] - phi * slip.value[steps]
    return start, _rows("slip", steps, value, spread, left, right, by_constants)


def _rows(name: str, at: IntArray, value: Array, sigma: Array, left: Array, right: Array, by_constants: Array) -> Rows:
    return rows_of(name, at, value[:, None], sigma[:, None], left, right, {"slip": by_constants[:, None, :]})


USUAL_WHEEL_SPEED = 0.1  # m/s, sigma of a reading before the recording decides it
# s: errors of a tyre last (a real car's are correlated by 0.3 after 1 s, 0.16 after 2 s): more readings would only seem
# to tell more
EVERY = 2.0
AVERAGED = 0.1  # s of samples in a reading; the motion in it is nearly even
SLOWEST = 2.0  # m/s, below which teeth pass too rarely, or the wheel is locked


def readings_of(wheel: WheelSpeed) -> WheelSpeed:
    """Return a reading every EVERY s: the mean of the samples of AVERAGED s, none where one of these is too slow."""
    t = wheel.t
    first = np.flatnonzero(np.diff(np.floor((t - t[0]) / EVERY), prepend=-1.0))
    end = np.searchsorted(t, t[first] + AVERAGED)
    sums = np.cumsum(np.vstack([np.zeros(3), np.column_stack([t, wheel.speed, wheel.speed < SLOWEST])]), axis=0)
    mean = (sums[end] - sums[first]) / (end - first)[:, None]
    turns = mean[:, 2] == 0.0
    return WheelSpeed(mean[turns, 0], mean[turns, 1])


def wheel_speed_rows(state: State, motion: LowPassedMotion, t: Array, measured: Array, sigma: float) -> Rows:
    """Residual (1 + scale + slip . (a, l^2)) (|v(t)| - side w) - z, m/s; a forward and l lateral acceleration, w turn
    rate about up.

    t (N,) s: stamps; measured (N,) m/s; sigma m/s.
    """
    scale, slip, side = state.constant("wheel_scale"), state.constants["wheel_slip"], state.constant("wheel_side")
    between, along = Between.at(state, t), motion.at(t)
    weights = between.of_velocity()
    speed, forward_n = _speed_and_direction(between.value(weights))
    path_n = _speed_and_direction(along.velocity_n)[1]
    by_slip = np.column_stack(
        [np.sum(path_n * along.acceleration_n, axis=1), np.cross(path_n, along.acceleration_n)[:, 2] ** 2]
    )
    of_wheel, turned = speed - side * along.turn_rate, 1.0 + scale + by_slip @ slip
    left, right = no_jacobian(len(t), 3)
    between.put_value(left, right, weights)
    by_velocity = (turned[:, None] * forward_n)[:, None, :]
    constants = {
        "wheel_scale": of_wheel[:, None, None],
        "wheel_slip": (by_slip * of_wheel[:, None])[:, None, :],
        "wheel_side": (-turned * along.turn_rate)[:, None, None],
    }
    residual = (turned * of_wheel - measured)[:, None]
    left, right = by_velocity @ left, by_velocity @ right
    return rows_of("wheel_speed", between.interval, residual, sigma, left, right, constants)


def _speed_and_direction(velocity_n: Array) -> tuple[Array, Array]:
    """Speed (N,) m/s and direction (N, 3) in n; at rest the direction is nothing."""
    speed = np.linalg.norm(velocity_n, axis=1)
    return speed, velocity_n / np.maximum(speed, SLOWEST)[:, None]
