"""Residuals and Jacobians of everything that is not inertial, on the whole session at once.

A measurement may fall anywhere between two keyframes, whose cubic Hermite curve it reads. So it touches the two
keyframes around it and the session's constants, and a latency is only a shift of the time at which the curve is read.

Residuals are prediction minus measurement, in the unit of the measurement; `sigma` whitens them.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.estimate.graph.arm import arm_axes, arm_axes_at, course
from smoother.estimate.graph.claims import ALIKE, Claims
from smoother.estimate.graph.expected import ExpectedMotion, Motion
from smoother.estimate.graph.heading import Heading
from smoother.estimate.graph.imu import DensePath, at_times, attitude_at
from smoother.estimate.graph.response import response_of
from smoother.estimate.graph.state import (
    COURSE_DELAY,
    DOPPLER_BIAS,
    EVENNESS,
    GYRO_BIAS,
    HEADING_OFFSET,
    KEYFRAME_SIZE,
    LEVER_ARM,
    OFFSET,
    POSITION_LATENCY,
    ROTATION,
    ROW_CONSTANTS_SIZE,
    TRANSLATION,
    VELOCITY,
    VELOCITY_LATENCY,
    VELOCITY_RESPONSE,
    ChainState,
    Constants,
)
from smoother.frames import UP_N, wrap_angle


@dataclass(frozen=True, eq=False)
class Rows:
    """N measurements of r components between keyframes `interval` (N,) and `interval + 1`.

    residual, sigma (N, r); left, right (N, r, 18) Jacobians by the keyframes; constants (N, r, 16). A component that
    was not measured has infinite sigma. `name` labels statistics; weight (N,) is the robust weight, 1 where none is.
    """

    name: str
    interval: np.ndarray
    residual: Array
    sigma: Array
    left: Array
    right: Array
    constants: Array
    weight: Array

    @property
    def information(self) -> Array:
        """Weight of each component, (N, r): robust weight over variance."""
        return self.weight[:, None] / self.sigma**2

    @property
    def are_alike(self) -> bool:
        """Whether Jacobians and sigmas are broadcast, one for all, and all weigh the same."""
        one_for_all = (values.strides[0] == 0 for values in (self.left, self.right, self.constants, self.sigma))
        return all(one_for_all) and bool(np.all(self.weight == 1.0))


@dataclass(frozen=True, eq=False)
class Bracket:
    """Where times fall in the chain: interval (N,), share (N,) of it gone by, and its length T, s."""

    interval: np.ndarray
    share: Array
    length: float


def bracket(state: ChainState, t: Array) -> Bracket:
    """Return the intervals that hold the times t (N,); times beyond the chain count to its first or last interval."""
    T = state.interval
    u = (t - state.t[0]) / T
    interval = np.clip(np.floor(u).astype(np.int64), 0, len(state.t) - 2)
    return Bracket(interval, np.clip(u - interval, 0.0, 1.0), T)


def hermite_position(b: Bracket) -> tuple[Array, Array, Array, Array]:
    """Weights (N,) of left position, left velocity, right position, right velocity in the position between."""
    s, T = b.share, b.length
    h01 = s**2 * (3.0 - 2.0 * s)
    return 1.0 - h01, T * s * (1.0 - s) ** 2, h01, -T * s**2 * (1.0 - s)


def hermite_velocity(b: Bracket) -> tuple[Array, Array, Array, Array]:
    """Weights (N,) of left position, left velocity, right position, right velocity in the velocity between."""
    s, T = b.share, b.length
    d01 = 6.0 * s * (1.0 - s) / T
    return -d01, 1.0 - 4.0 * s + 3.0 * s**2, d01, s * (3.0 * s - 2.0)


def position_rows(
    state: ChainState,
    path: DensePath,
    felt: ExpectedMotion,
    t: Array,
    measured_n: Array,
    sigma: Array,
    offset_latency: float,
) -> Rows:
    """GPS position: antenna position plus slow offset. t (N,) stamps; measured_n (N, 3), NaN unknown; sigma (N, 3) m.

    felt, at the edges of the path: only this motion swings the antenna, the noise of the gyro does not. Nor do roll and
    pitch: a kart's rates of these are smaller than that noise, and multiplying the unknown height of the antenna by it
    would seem to observe it. The slope by the latency is along this motion too (:func:`_along`).

    The offset belongs to the receiver and does not move with the latency: it is read at t - offset_latency, a constant,
    or at the nearer end of the interval around the fix where that is outside. (Reading that rough process at a moving
    time would make the fit of the latency overshoot.)
    """
    at = t - state.constants.position_latency
    b, R_ns = bracket(state, at), attitude_at(path, at)
    stamp_share = np.clip((t - offset_latency - state.t[b.interval]) / b.length, 0.0, 1.0)
    stamp = Bracket(b.interval, stamp_share, b.length)
    R_arm = arm_axes_at(path, state.constants, at, R_ns)
    arm_n = np.einsum("nij,j->ni", R_arm, state.constants.lever_arm_s)
    swing_n = np.cross(_about_up(path, felt.slow, at), arm_n)
    weights = hermite_position(b)
    residual = _on_curve(state, b, weights) + arm_n + _between(stamp, state.offset_n) - measured_n
    left, right, constants = empty_jacobians(len(t), 3)
    _put_curve(left, right, state, b, weights)
    if not state.constants.is_steered:
        _put_turn(left, right, state, b, -so3.skew(arm_n))
    left[:, :, OFFSET] = (1.0 - stamp_share)[:, None, None] * np.eye(3)
    right[:, :, OFFSET] = stamp_share[:, None, None] * np.eye(3)
    constants[:, :, POSITION_LATENCY] = -(_along(state, path, felt, b, weights) + swing_n)[:, :, None]
    constants[:, :, LEVER_ARM] = R_arm
    return _rows("gps_position", b, residual, sigma, left, right, constants)


def antenna_jacobian(state: ChainState, t: Array) -> tuple[IntArray, Array, Array, Array]:
    """How the antenna's position in n at times t (N,) depends on the keyframes around them and on the constants.

    Returns interval (N,), and Jacobians (N, 3, 18) by its left and right keyframe and (N, 3, 16) by the row constants.
    """
    b = bracket(state, t)
    R_left, R_right = state.R_ns[b.interval], state.R_ns[b.interval + 1]
    R_ns = R_left @ so3.exp(b.share[:, None] * so3.log(R_left.transpose(0, 2, 1) @ R_right))
    left, right, constants = empty_jacobians(len(t), 3)
    _put_curve(left, right, state, b, hermite_position(b))
    if state.constants.is_steered:
        axes = arm_axes(state)
        constants[:, :, LEVER_ARM] = _between(b, axes.reshape(-1, 9)).reshape(-1, 3, 3)
    else:
        _put_turn(left, right, state, b, -so3.skew(R_ns @ state.constants.lever_arm_s))
        constants[:, :, LEVER_ARM] = R_ns
    return b.interval, left, right, constants


def velocity_rows(
    state: ChainState, path: DensePath, felt: ExpectedMotion, t: Array, measured_n: Array, sigma: Array
) -> Rows:
    """GPS Doppler velocity of the antenna. t (N,) stamps; measured_n (N, 3), NaN unknown; sigma (N, 3) m/s.

    felt as in :func:`position_rows`; slopes by the latency and the arm are of it. (The noise of the path's own
    acceleration would make the latency seem better known than it is, and draw it away.) The second derivative of
    velocity, level, which the receiver's response multiplies, is of it too. Upwards there is no slope by the latency: a
    kart on its tyres bounces ten times a second, and fixes that see little of it would be moved in time until they fit.
    """
    session = state.constants
    at = t - session.velocity_latency
    b, R_ns = bracket(state, at), attitude_at(path, at)
    R_arm = arm_axes_at(path, session, at, R_ns)
    rate_n, arm_n = _about_up(path, felt, at), np.einsum("nij,j->ni", R_arm, session.lever_arm_s)
    swing_n, answer = np.cross(rate_n, arm_n), response_of(path, felt, session, at)
    weights = hermite_velocity(b)
    acceleration_n = _along(state, path, felt, b, weights)
    slow_n = _about_up(path, felt.slow, at)
    swinging_n = np.cross(slow_n, np.cross(slow_n, arm_n))
    antenna_n = _on_curve(state, b, weights) + swing_n
    shown_n, by_course_n = _with_late_course(session, path, felt.slow, at, antenna_n)
    seen_n = shown_n + answer.beyond_n + session.doppler_bias_n
    left, right, constants = empty_jacobians(len(t), 3)
    _put_curve(left, right, state, b, weights)
    if not session.is_steered:  # else neither the arm nor its turning is of the box
        # a tilt turns the arm, but not the axis it swings about, which is up
        turning = so3.skew(rate_n)
        _put_turn(left, right, state, b, -turning @ so3.skew(arm_n))
        # the rate is measured minus bias, and the swing is minus [l]x times it
        left[:, :, GYRO_BIAS] = np.cross(arm_n, UP_N)[:, :, None] * R_ns[:, None, 2, :]
    constants[:, :, DOPPLER_BIAS] = np.eye(3)
    constants[:, :2, VELOCITY_LATENCY] = -(acceleration_n + swinging_n)[:, :2, None]
    constants[:, :, LEVER_ARM] = so3.skew(slow_n) @ R_arm
    constants[:, :, VELOCITY_RESPONSE] = answer.slope_n[:, :, None]
    constants[:, :, EVENNESS] = answer.by_evenness_n[:, :, None]
    constants[:, :, COURSE_DELAY] = by_course_n[:, :, None]
    return _rows("gps_velocity", b, seen_n - measured_n, sigma, left, right, constants)


def _with_late_course(
    session: Constants, path: DensePath, motion: Motion, at: Array, antenna_n: Array
) -> tuple[Array, Array]:
    """Return velocities (N, 3) of the antenna at times `at` (N,) with the course of course_delay before, and their
    slope by it (N, 3). The course is that of `motion`, at the edges of the path: the keyframes' own would shake.
    """
    arm_n = arm_axes_at(path, session, path.t, path.R_ns) @ session.lever_arm_s
    turning = np.stack([-arm_n[:, 1], arm_n[:, 0]], axis=1) * motion.turn_rate[:, None]
    headed = course(motion.velocity_n[:, :2] + turning)
    then = at - session.course_delay
    angle = np.interp(then, path.t, headed) - np.interp(at, path.t, headed)
    rate = np.interp(then, path.t, np.gradient(headed, path.t[1] - path.t[0]))
    cos, sin, (x, y, z) = np.cos(angle), np.sin(angle), antenna_n.T
    shown_n = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)
    left_n = np.stack([-shown_n[:, 1], shown_n[:, 0], np.zeros(len(at))], axis=1)
    return shown_n, -rate[:, None] * left_n


def heading_rows(state: ChainState, heading: Heading) -> Rows:
    """Heading of the magnetic field. Only the turn about up is asked for: a bad field must never tilt the kart."""
    interval, offset = heading.interval, state.constants.heading_offset if heading.has_offset else 0.0
    field_n = np.einsum("nij,nj->ni", state.R_ns[interval], heading.field_s)
    residual = np.arctan2(field_n[:, 1], field_n[:, 0]) - heading.field_yaw - offset
    left, right, constants = empty_jacobians(len(interval), 1)
    left[:, 0, ROTATION] = state.R_ns[interval][:, 2, :]  # the third row of R_ns takes a turn in s to its part about up
    constants[:, :, HEADING_OFFSET] = -1.0 if heading.has_offset else 0.0
    residual = wrap_angle(residual)[:, None]
    sigma = np.ones_like(residual) * np.reshape(heading.sigma, (-1, 1))
    return Rows("heading", interval, residual, sigma, left, right, constants, np.ones(len(interval)))


def standstill_rows(state: ChainState, interval: np.ndarray, sigma_speed: float, sigma_turn: float) -> Rows:
    """Zero velocity at the left keyframe and no turn to the right one, in the intervals (N,) that stand still."""
    R_left, R_right = state.R_ns[interval], state.R_ns[interval + 1]
    turn = R_left.transpose(0, 2, 1) @ R_right
    left, right, constants = empty_jacobians(len(interval), 6)
    left[:, 0:3, VELOCITY] = np.eye(3)
    left[:, 3:6, ROTATION] = -turn.transpose(0, 2, 1)
    right[:, 3:6, ROTATION] = np.eye(3)
    residual = np.concatenate([state.velocity_n[interval], so3.log(turn)], axis=1)
    sigma = np.broadcast_to([sigma_speed] * 3 + [sigma_turn] * 3, residual.shape)
    return Rows("standstill", interval, residual, sigma, left, right, constants, np.ones(len(interval)))


def ground_rows(state: ChainState, sigma: float, at: IntArray, height: Array) -> Rows:
    """Height at the keyframes `at` (n,), far from fixes that have one: `height` (n,) m in n, less the slow offset.

    The samples alone would let it run away, by kilometres within minutes, and take the digits of all else with it. The
    offset upwards stands for the hills here, and how high they are is found as the receiver's would be. sigma m.
    """
    left, right, constants = empty_jacobians(len(at), 1)
    left[:, 0, OFFSET.start + 2] = 1.0
    left[:, 0, TRANSLATION] = state.R_ns[at, 2, :]  # a step is in the axes of the pose
    residual = (state.position_n[at, 2] + state.offset_n[at, 2] - height)[:, None]
    return Rows("ground", at, residual, np.full((len(at), 1), sigma), left, right, constants, np.ones(len(at)))


def offset_rows(
    state: ChainState, sigma: Array, tau: float, claims: Claims = ALIKE, late: float = 0.0
) -> tuple[Rows, Rows]:
    """First-order Gauss-Markov process of the GPS offset: its start, and its steps. sigma (3,) m, tau s.

    o_{k+1} = phi o_k + w, phi = exp(-T/tau), var w = sigma^2 (1 - phi^2). Source: Gelb 1974, 3.8. claims, of fixes late
    by `late` s: in parts of sigma, how large it is in stretches, between which it is another.
    """
    n = len(state.t) - 1
    share, anew = claims.between(state.t, late) if len(claims.renewed) else (claims.share, np.zeros(1, dtype=np.bool_))
    phi = np.where(anew, 0.0, np.exp(-state.interval / tau))[:, None]
    left, right, constants = empty_jacobians(len(phi), 3)  # of all alike, one stands for all
    left[:, :, OFFSET], right[:, :, OFFSET] = -phi[:, :, None] * np.eye(3), np.eye(3)
    residual = state.offset_n[1:] - phi * state.offset_n[:-1]
    step = np.broadcast_to(sigma * share[:, None] * np.sqrt(1.0 - phi**2), residual.shape)
    left, right, constants = (np.broadcast_to(block, (n, *block.shape[1:])) for block in (left, right, constants))
    steps = Rows("gps_offset", np.arange(n), residual, step, left, right, constants, np.ones(n))
    left, right, constants = empty_jacobians(1, 3)
    left[:, :, OFFSET] = np.eye(3)
    at_first = share[0] * sigma[None]
    start = Rows("gps_offset_start", np.zeros(1, int), state.offset_n[:1], at_first, left, right, constants, np.ones(1))
    return start, steps


def prior_row(name: str, residual: Array, sigma: Array, part: slice) -> Rows:
    """Prior on one part of the first keyframe. residual, sigma (r,)."""
    left, right, constants = empty_jacobians(1, residual.size)
    left[0, :, part] = np.eye(residual.size)
    return Rows(name, np.zeros(1, int), residual[None], sigma[None], left, right, constants, np.ones(1))


def after_step(rows: Rows, step: Array, constants_step: Array) -> Rows:
    """Return the rows with the residual that the linear model predicts after a step (K, 18) and (31,)."""
    k = rows.interval
    moved = np.einsum("nri,ni->nr", rows.left, step[k]) + np.einsum("nri,ni->nr", rows.right, step[k + 1])
    return replace(rows, residual=rows.residual + moved + rows.constants @ constants_step[:ROW_CONSTANTS_SIZE])


def _rows(name: str, b: Bracket, residual: Array, sigma: Array, left: Array, right: Array, constants: Array) -> Rows:
    unknown = ~np.isfinite(residual)
    return Rows(
        name,
        b.interval,
        np.where(unknown, 0.0, residual),
        np.where(unknown | ~np.isfinite(sigma), np.inf, sigma),
        left,
        right,
        constants,
        np.ones(len(residual)),
    )


def empty_jacobians(n: int, r: int) -> tuple[Array, Array, Array]:
    """Zeros for the Jacobians of n rows of r components by left and right keyframe and by the row constants."""
    return np.zeros((n, r, KEYFRAME_SIZE)), np.zeros((n, r, KEYFRAME_SIZE)), np.zeros((n, r, ROW_CONSTANTS_SIZE))


def _between(b: Bracket, values: Array) -> Array:
    share = b.share[:, None]
    return np.asarray((1.0 - share) * values[b.interval] + share * values[b.interval + 1])


def _about_up(path: DensePath, motion: Motion, t: Array) -> Array:
    """Angular rate (N, 3) rad/s in n at times t (N,): about up alone."""
    return np.asarray(np.interp(t, path.t, motion.turn_rate)[:, None] * UP_N)


def _along(state: ChainState, path: DensePath, felt: ExpectedMotion, b: Bracket, weights: tuple[Array, ...]) -> Array:
    """Rate (N, 3) at which what `weights` make of the keyframes changes as these move on along the motion `felt`.

    By the Jacobian of the keyframes themselves: positions and velocities that are all late by the same time are then
    as good as keyframes that are all early by it, to which only the inertial samples object. Fixes and Doppler alone
    know how late one is behind the other a hundred times better than how late both are; with slopes that do not fit
    together, a thousandth of a second there (a Doppler that is filtered differently) is a hundredth of one here.

    Without what is too quick for keyframes to follow: taken at these, it goes with what the curve misses between them.
    """
    of_motion = felt.slow.velocity_n, felt.slow.acceleration_n
    velocity_n, acceleration_n = (at_times(path, values, state.t) for values in of_motion)
    return _weighed(b, weights, velocity_n, acceleration_n)


def _on_curve(state: ChainState, b: Bracket, weights: tuple[Array, ...]) -> Array:
    """Position or velocity (N, 3) on the cubic through the keyframes, by the weights of :func:`hermite_position`."""
    return _weighed(b, weights, state.position_n, state.velocity_n)


def _weighed(b: Bracket, weights: tuple[Array, ...], values: Array, slopes: Array) -> Array:
    left_value, left_slope, right_value, right_slope = (w[:, None] for w in weights)
    k = b.interval
    by_left = left_value * values[k] + left_slope * slopes[k]
    return np.asarray(by_left + right_value * values[k + 1] + right_slope * slopes[k + 1])


def _put_curve(left: Array, right: Array, state: ChainState, b: Bracket, weights: tuple[Array, ...]) -> None:
    left_p, left_v, right_p, right_v = (w[:, None, None] for w in weights)
    left[:, :, TRANSLATION] = left_p * state.R_ns[b.interval]
    right[:, :, TRANSLATION] = right_p * state.R_ns[b.interval + 1]
    left[:, :, VELOCITY] = left_v * np.eye(3)
    right[:, :, VELOCITY] = right_v * np.eye(3)


def _put_turn(left: Array, right: Array, state: ChainState, b: Bracket, by_turn_n: Array) -> None:
    """Jacobian (N, r, 3) by a small turn in n, shared between the ends in proportion to time."""
    left[:, :, ROTATION] = (1.0 - b.share)[:, None, None] * (by_turn_n @ state.R_ns[b.interval])
    right[:, :, ROTATION] = b.share[:, None, None] * (by_turn_n @ state.R_ns[b.interval + 1])
