"""Mounting of the sensor in the kart, from the path: heading and level, on average.

A kart slides and leans in proportion to its acceleration, so the mounting is the attitude at zero acceleration: the
intercept of a robust line through sideslip and roll over lateral acceleration, and through pitch over forward
acceleration. A mean would carry the bias of a track with more turns to one side. Up is normal to the road along the
path, which climbs as the velocity does; across it roads are level on average.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother import so3
from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray
from smoother.estimate.model.imu import are_observed
from smoother.estimate.model.state import State
from smoother.estimate.preprocess.streams import MIN_SPEED
from smoother.fit.running import gaussian_mean
from smoother.frames import wrap_angle
from smoother.trajectory import Keyframes
from smoother.units import ANY_ANGLE, DEG

MEMORY = 10.0  # s, correlation time of slip, lean and errors of attitude: a corner or two
ROUGH = np.pi / 4.0  # sigma about each axis of a mounting that could not be fitted
SLOWEST = 2.5  # m/s, for slow drives
MIN_KEYFRAMES = 100  # at speed
SWING_SPAN = 2.0  # s; a steering wheel moves faster, slide, lean and errors of attitude slower
SWING = 2.5 * DEG  # of roll within that time: cars have 0.1 deg, loggers on a wheel 4 to 6
ROAD_SLOPE = 0.05  # of roads from one place to another, without heights
STEERED = 0.6  # least correlation of that with slip


@dataclass(frozen=True, eq=False)
class FittedMounting:
    """R_bs (3, 3), sigma (3,) rad about axes of b, whether it is known, and whether from the attitudes themselves.

    by_wheels: the heading is that of the slip of the wheels, one of the graph's constants.
    """

    R_bs: Array
    sigma: Array
    is_observable: bool
    is_fitted: bool = False
    by_wheels: bool = False


def are_at_speed(state: State) -> BoolArray:
    """Mask (K,) of the keyframes at a speed that shows the mounting."""
    level = np.hypot(state.velocity_n[:, 0], state.velocity_n[:, 1])
    driven = level > 1.5 * MIN_SPEED
    return np.asarray(driven if np.count_nonzero(driven) >= MIN_KEYFRAMES else level > SLOWEST)


def fit_mounting(
    state: State, rough_R_bs: Array, missing: Array | None = None, height_sigma: float | None = 0.0
) -> FittedMounting:
    """Refine a rough mounting by the estimated attitude and velocity of all keyframes at speed.

    missing (K-1,): share of each interval without samples; in a gap of them attitudes are interpolated. height_sigma,
    m: of the height from the first of them to the last; None where no fix has a height.
    """
    use = _are_fitted(state, missing)
    if np.count_nonzero(use) < MIN_KEYFRAMES:
        return FittedMounting(rough_R_bs, np.full(3, ROUGH), False)
    acceleration_n = np.gradient(state.velocity_n, state.t, axis=0)[use]
    R_sn = state.R_ns[use].transpose(0, 2, 1)
    velocity_s = np.einsum("kij,kj->ki", R_sn, state.velocity_n[use] * [1.0, 1.0, 0.0])
    slope = state.velocity_n[use, 2] / np.hypot(state.velocity_n[use, 0], state.velocity_n[use, 1])
    up_s, acceleration_s = R_sn[:, :, 2], np.einsum("kij,kj->ki", R_sn, acceleration_n)
    R_bs, sigma, memory = rough_R_bs, np.zeros(3), max(1, round(MEMORY / state.interval))
    for _ in range(4):  # small angles: a turn of the mounting changes what counts as forward and left
        velocity_b, up_b, acceleration_b = (x @ R_bs.T for x in (velocity_s, up_s, acceleration_s))
        one = np.ones(len(velocity_b))
        lateral = np.stack([one, acceleration_b[:, 1]], axis=1)
        forward = np.stack([one, acceleration_b[:, 0]], axis=1)
        # turning the body axes by w about b moves a vector v in b by -w x v
        fits = [
            _first_of_line(lateral, up_b[:, 1], memory),
            _first_of_line(forward, slope - up_b[:, 0], memory),
            _first_of_line(lateral, np.arctan2(velocity_b[:, 1], velocity_b[:, 0]), memory),
        ]
        turn = np.array([fit[0] for fit in fits])
        sigma = np.array([fit[1] for fit in fits])
        R_bs = so3.exp(-turn * [-1.0, -1.0, 1.0]) @ R_bs
    sigma[1] = np.hypot(sigma[1], _slope_sigma(state, use, height_sigma))
    return FittedMounting(R_bs, sigma, is_observable=True, is_fitted=True)


def _are_fitted(state: State, missing: Array | None) -> BoolArray:
    """Mask (K,) of the keyframes that a mounting is fitted to: at speed, with samples."""
    use = are_at_speed(state)
    return use if missing is None else use & are_observed(missing)


def _slope_sigma(state: State, driven: BoolArray, height_sigma: float | None) -> float:
    """Sigma of the mean slope of the road, rad: laps return to their start, roads lead elsewhere."""
    length = float(np.sum(np.hypot(state.velocity_n[driven, 0], state.velocity_n[driven, 1]))) * state.interval
    if height_sigma is not None:
        return height_sigma / length
    first, last = state.position_n[driven][[0, -1], :2]
    return ROAD_SLOPE * min(float(np.linalg.norm(last - first)) / length, 1.0)


def along_wheels(mounting: FittedMounting, state: State, variance: float) -> FittedMounting:
    """Return `mounting` with the heading by the slip, of variance `variance` rad^2.

    It turns about the up of the mounting: the level axes of the alignment may be some degrees off level.
    """
    offset, axis_b = state.constants["slip"][0], mounting.R_bs @ state.geometry.level_axes_s[0]
    turned = so3.exp(np.array([[0.0, 0.0, offset]]))[0]
    ahead_b = turned @ (axis_b * [1.0, 1.0, 0.0])
    turn = so3.exp(np.array([[0.0, 0.0, -np.arctan2(ahead_b[1], ahead_b[0])]]))[0]
    sigma = np.array([*mounting.sigma[:2], np.sqrt(variance)])
    return replace(mounting, R_bs=turn @ mounting.R_bs, sigma=sigma, by_wheels=True)


def without_heading(mounting: FittedMounting) -> FittedMounting:
    """Return `mounting` of a kart that hardly drove: its heading is unknown, also with a stated mounting."""
    stated = mounting.is_observable and not mounting.is_fitted
    return replace(mounting, sigma=np.array([*mounting.sigma[:2], ANY_ANGLE]), is_observable=stated)


def swing_on_the_wheel(keyframes: Keyframes, *, is_steered: bool = False) -> Array | None:
    """Rms angles (3,) rad about the axes of b between kart and a logger on the steering wheel; None for others.

    The column leans to the driver, so that the logger rolls to the side it turns to; a kart rolls to the other side.
    is_steered: the samples show a wheel, so that no significance of the swing is required.
    """
    level = np.hypot(keyframes.velocity_n[:, 0], keyframes.velocity_n[:, 1])
    driving = level > 1.5 * MIN_SPEED
    if np.count_nonzero(driving) < MIN_KEYFRAMES:
        return None
    velocity_b = np.einsum("kji,kj->ki", keyframes.R_nb[:, :2], keyframes.velocity_n[:, :2])
    lean, slip = keyframes.R_nb[:, 2, 1], np.unwrap(np.arctan2(velocity_b[:, 1], velocity_b[:, 0]))
    width = 0.5 * SWING_SPAN / float(keyframes.t[1] - keyframes.t[0])
    quick_lean, quick_slip = ((values - gaussian_mean(values, width))[driving] for values in (lean, slip))
    unsure = float(np.median(np.einsum("kii->ki", keyframes.covariance[driving, 0:3, 0:3])[:, :2]))
    swing = float(np.std(quick_lean))
    together = np.corrcoef(quick_lean, quick_slip)[0, 1]
    is_swung = swing > SWING and (is_steered or swing**2 > 2.0 * unsure) and together > STEERED
    if not is_swung:
        return None
    return np.array([np.std(lean[driving]), 0.0, np.std(wrap_angle(slip[driving]))])


def _first_of_line(design: Array, angle: Array, memory: int) -> tuple[float, float]:
    """First coefficient of a line with Cauchy weights, and its sigma. design (N, 2), angle (N,).

    memory: number of samples beyond which errors are independent. Source of the sigma: the sandwich of M-estimation
    (Huber 1981, 7.6) with the autocovariances summed up to the first that is not positive (Geyer 1992).
    """
    line, residual, weight = _robust_line(design, angle)
    slope = weight * (2.0 * weight - 1.0)  # of weight times residual
    bread = np.linalg.inv((design * slope[:, None]).T @ design)
    pull = (design * (weight * residual)[:, None]) @ bread[0]
    return float(line[0]), float(np.sqrt(_variance_of_sum(pull, memory)))


def _robust_line(design: Array, angle: Array) -> tuple[Array, Array, Array]:
    """Coefficients (c,) of a line with Cauchy weights, residuals (N,) and weights (N,). design (N, c), angle (N,)."""
    weight = np.ones(len(angle))
    for _ in range(8):
        normal = (design * weight[:, None]).T @ design
        line = np.linalg.solve(normal, (design * weight[:, None]).T @ angle)
        residual = angle - design @ line
        scale = MAD_TO_SIGMA * np.median(np.abs(residual)) + 1e-9
        weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2)
    return np.asarray(line), residual, weight


def _variance_of_sum(pull: Array, memory: int) -> float:
    """Variance of the sum of N correlated values (N,) of mean zero."""
    total = float(pull @ pull)
    for lag in range(1, min(memory, len(pull) - 1) + 1):
        together = float(pull[lag:] @ pull[:-lag])
        if together <= 0.0:
            break
        total += 2.0 * together
    return total
