"""Information bound of a simulated session: the accuracy no unbiased estimator can beat, from truth and true noise.

The batch problem is linearised at the truth: inertial errors propagate from keyframe to keyframe, fixes and Doppler
velocities measure at keyframes of their own times, latencies and lever arm are unknown constants, biases walk, the slow
GPS offset is a Gauss-Markov process. Its information matrix does not depend on the measured values, and the inverse is
the smallest covariance (Cramer-Rao). Nothing here knows what a smoother identifies; its linear algebra is its own
(chain.py). Outages and gaps of the session count, jumps count as lost fixes, the magnetometer is not used.

Errors are truth minus estimate: attitude in n (`R_true = exp(phi) @ R_estimate`), velocity and position of the IMU in
n, biases in s. Source: Van Trees, Bell & Tian 2013, 4.2.3; error dynamics of Groves 2013, 14.2.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from chain import ChainSolution, ChainSystem, solve_chain
from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.frames import GRAVITY_N, euler_jacobian
from smoother.sim.scenario import Interval
from smoother.sim.simulation import Simulation
from smoother.sim.truth import TruthStates

SETTLING = 10.0  # s of motion before errors count: alignment in motion needs some
RELATIVE_INTERVAL = 1.0  # s, over which the change of position is judged
UNSEEN_ACCEL, UNSEEN_GYRO = 10.0, 1.0  # m/s^2, rad/s: what a kart may do during a gap of the inertial samples

_ATTITUDE, _VELOCITY, _POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
_ACCEL_BIAS, _GYRO_BIAS, _OFFSET = slice(9, 12), slice(12, 15), slice(15, 18)
_INERTIAL, _SIZE = slice(0, 15), 18
_POSITION_LATENCY, _VELOCITY_LATENCY, _ARM = 0, 1, slice(2, 5)
_ACCEL_MATRIX, _GYRO_MATRIX = slice(5, 14), slice(14, 23)
_PLAIN_CONSTANTS, _ALL_CONSTANTS = 5, 23

_SUBSTEPS = 8  # to an interval between keyframes: 25 ms, over which a kart's force hardly turns
_MERGED = 0.02  # s; keyframes are not put closer together than this
_TINY = 1e-4  # m or m/s: stands for an error that is exactly zero


@dataclass(frozen=True)
class BoundOptions:
    """What the bound's estimator is given beforehand: sigmas of its weak priors, SI, and what it has to find.

    imu_matrix: scale factors and misalignments are unknowns too, with their true sizes as prior; without, they are
    known. standstill: zero velocity and rate are known while the kart stands.
    """

    accel_bias: float = 0.5
    gyro_bias: float = 0.2
    lever_arm: float = 0.5
    latency: float = 0.25
    attitude: float = 3.0
    imu_matrix: bool = False
    standstill: bool = False


@dataclass(frozen=True, eq=False)
class Bound:
    """Smallest standard deviations. t (K,) s, the epochs of the fixes; of the antenna and the kart at these times:

    velocity (K,) m/s and position (K,) m, horizontal, root of the sum over both axes; attitude (K, 3) rad of roll,
    pitch, yaw; track (K,) m per axis, of position plus offset; relative (K,) m, horizontal, of the change of position
    over the second that follows, NaN at the end. Latencies s, lever_arm_b (3,) m.
    """

    t: Array
    velocity: Array
    position: Array
    attitude: Array
    track: Array
    relative: Array
    position_latency: float
    velocity_latency: float
    lever_arm_b: Array

    def rms(self, start: float, end: float, left_out: Sequence[tuple[float, float]] = ()) -> "BoundRms":
        """Root mean squares over start <= t <= end without the stretches left_out; NaN where nothing is known."""
        inside = within(self.t, start, end, left_out)
        later = inside & within(self.t + RELATIVE_INTERVAL, start, end, left_out)

        def rms(values: Array, where: BoolArray = inside) -> float:
            known = values[where & np.isfinite(values)]
            return float(np.sqrt(np.mean(known**2))) if known.size else np.nan

        roll, pitch, yaw = (rms(self.attitude[:, i]) for i in range(3))
        return BoundRms(
            rms(self.velocity),
            rms(self.relative, later),
            roll,
            pitch,
            yaw,
            rms(self.position),
            rms(self.track),
            self.position_latency,
            self.velocity_latency,
            self.lever_arm_b,
        )


@dataclass(frozen=True, eq=False)
class BoundRms:
    """A Bound over a stretch of time: one figure for each quantity, in its units."""

    velocity: float
    relative: float
    roll: float
    pitch: float
    yaw: float
    position: float
    track: float
    position_latency: float
    velocity_latency: float
    lever_arm_b: Array


def scored_span(simulation: Simulation) -> tuple[float, float]:
    """Return first and last session time at which errors count: SETTLING after the kart drives off, to the last fix."""
    standstill = simulation.scenario.motion.standstill or 0.0
    start = float(simulation.truth.clock.to_session(np.asarray(standstill + SETTLING)))
    return start, float(simulation.gnss.position_time[-1])


def within(t: Array, start: float, end: float, left_out: Sequence[tuple[float, float]] = ()) -> BoolArray:
    """Mask (N,) of the times t (N,) in start..end that fall into none of the stretches (start, end) left out."""
    inside = (t >= start) & (t <= end)
    for first, last in left_out:
        inside &= (t < first) | (t > last)
    return np.asarray(inside)


def information_bound(simulation: Simulation, options: BoundOptions | None = None) -> Bound:
    """Return the bound of a simulated session. Raises ValueError without inertial samples or with under two fixes."""
    system, states, is_epoch = information_system(simulation, options or BoundOptions())
    return _bound(simulation, states, solve_chain(system), is_epoch)


def information_system(simulation: Simulation, options: BoundOptions) -> tuple[ChainSystem, TruthStates, BoolArray]:
    """Return the information of a session, the true states of its keyframes, and which of these are epochs of fixes.

    Unknowns of a keyframe: attitude, velocity, position, biases, offset, 3 each; constants: two latencies, lever arm.
    Raises ValueError as :func:`information_bound`.
    """
    if simulation.scenario.imu is None or len(simulation.gnss.position_time) < 2:
        raise ValueError("the bound is of a session with inertial samples and fixes")
    t, is_epoch = _keyframe_times(simulation)
    states = simulation.truth.at(t)
    system = _empty_system(len(t), _ALL_CONSTANTS if options.imu_matrix else _PLAIN_CONSTANTS)
    _add_priors(system, simulation, options)
    _add_motion(system, simulation, t)
    _add_fixes(system, simulation, states)
    if options.standstill:
        _add_standstill(system, simulation, states)
    return system, states, is_epoch


def _keyframe_times(simulation: Simulation) -> tuple[Array, BoolArray]:
    """Times (K,) s at which positions and velocities are true, lost ones too, and which are those of positions."""
    errors, clock = simulation.scenario.gnss, simulation.truth.clock
    assert simulation.imu is not None
    first, last = clock.to_session(simulation.imu.true_time[[0, -1]])
    epoch = clock.to_session(np.arange(0.0, simulation.scenario.duration + 0.5 / errors.rate, 1.0 / errors.rate))
    epoch = epoch[(epoch >= first - 0.5 / errors.rate) & (epoch <= last)]
    of_velocity = epoch - (errors.velocity_latency - errors.position_latency)
    near = np.abs(
        of_velocity[:, None] - epoch[np.clip(np.searchsorted(epoch, of_velocity)[:, None] + [-1, 0], 0, len(epoch) - 1)]
    )
    of_velocity = of_velocity[(of_velocity > epoch[0]) & (near.min(axis=1) > _MERGED)]
    t = np.concatenate([epoch, of_velocity])
    order = np.argsort(t, kind="stable")
    return t[order], order < len(epoch)


def _empty_system(n: int, m: int) -> ChainSystem:
    shapes = (n, _SIZE, _SIZE), (n - 1, _SIZE, _SIZE), (n, _SIZE, m), (m, m), (n, _SIZE), (m,)
    return ChainSystem(*(np.zeros(shape) for shape in shapes))


def _add_priors(system: ChainSystem, simulation: Simulation, options: BoundOptions) -> None:
    scenario = simulation.scenario
    sigma = np.repeat([options.attitude, 1e3, 1e4, options.accel_bias, options.gyro_bias], 3)
    sigma = np.concatenate([sigma, _offset_sigma(simulation)])
    system.diagonal[0] += np.diag(sigma**-2)
    constants = np.repeat([options.latency, options.lever_arm], [2, 3])
    if options.imu_matrix:
        assert scenario.imu is not None
        for matrix in (scenario.imu.accel_matrix, scenario.imu.gyro_matrix):
            crooked = np.abs(matrix - np.eye(3))
            scale = np.sqrt(np.mean(np.diag(crooked) ** 2))
            misalignment = np.sqrt(np.sum(crooked[~np.eye(3, dtype=bool)] ** 2) / 6.0)
            size = np.where(np.eye(3, dtype=bool), scale, misalignment)
            constants = np.concatenate([constants, np.maximum(size, 1e-6).ravel()])
    system.corner[...] += np.diag(constants**-2)


def _offset_sigma(simulation: Simulation) -> Array:
    errors = simulation.scenario.gnss
    return np.maximum([errors.offset_horizontal, errors.offset_horizontal, errors.offset_up], _TINY)


def _add_motion(system: ChainSystem, simulation: Simulation, t: Array) -> None:
    """Add the steps from keyframe to keyframe: `x[k+1] = transition x[k] + input constants + noise`."""
    m = system.corner.shape[0]
    transition, noise, by_matrix = _inertial_step(simulation, t, with_matrix=m == _ALL_CONSTANTS)
    scale = 1.0 / np.sqrt(np.einsum("kii->ki", noise))  # to correlations, which invert well
    correlation = noise * scale[:, :, None] * scale[:, None, :]
    information = np.linalg.inv(correlation) * scale[:, :, None] * scale[:, None, :]
    _add_step(system, transition, information, by_matrix, _INERTIAL)

    decay = np.exp(-np.diff(t) / simulation.scenario.gnss.offset_tau)
    step = _offset_sigma(simulation) ** 2 * (1.0 - decay**2)[:, None]
    eye = np.eye(3)
    _add_step(system, decay[:, None, None] * eye, eye / step[:, :, None], np.zeros((len(decay), 3, m)), _OFFSET)


def _add_step(system: ChainSystem, transition: Array, information: Array, by_constants: Array, part: slice) -> None:
    """Add factors `right - transition left - by_constants c`, one for each interval, on one part of the keyframes."""
    weighted = transition.transpose(0, 2, 1) @ information
    system.diagonal[:-1, part, part] += weighted @ transition
    system.diagonal[1:, part, part] += information
    system.upper[:, part, part] -= weighted
    system.border[:-1, part] += weighted @ by_constants
    system.border[1:, part] -= information @ by_constants
    system.corner[...] += np.einsum("kri,krs,ksj->ij", by_constants, information, by_constants, optimize=True)


def _inertial_step(simulation: Simulation, t: Array, *, with_matrix: bool) -> tuple[Array, Array, Array]:
    """Transition (K-1, 15, 15) of the inertial errors, covariance of the noise on the way, effect of the constants.

    attitude' = -R (gyro bias + noise), velocity' = -f x attitude - R (accel bias + noise), position' = velocity, with
    the specific force f in n; midpoint rule over substeps, exact in the noise of position.
    """
    errors, R_bs = simulation.scenario.imu, simulation.scenario.R_bs
    assert errors is not None
    n, m = len(t) - 1, _ALL_CONSTANTS if with_matrix else _PLAIN_CONSTANTS
    h = np.diff(t) / _SUBSTEPS
    accel, gyro = _densities(simulation, t)
    total = np.tile(np.eye(15), (n, 1, 1))
    noise, constants = np.zeros((n, 15, 15)), np.zeros((n, 15, m))
    for j in range(_SUBSTEPS):
        states = simulation.truth.at(t[:-1] + (j + 0.5) * h)
        R_ns = states.R_nb @ R_bs
        step = _substep(R_ns, states.acceleration_n - GRAVITY_N, h)
        total, constants = step @ total, step @ constants
        noise = step @ noise @ step.transpose(0, 2, 1) + _substep_noise(simulation, accel, gyro, h)
        if with_matrix:
            _add_matrix_input(constants, states, R_ns, R_bs, h)
    return total, noise, constants


def _substep(R_ns: Array, force_n: Array, h: Array) -> Array:
    h = h[:, None, None]
    turn = -so3.skew(force_n)
    step = np.tile(np.eye(15), (len(R_ns), 1, 1))
    step[:, _ATTITUDE, _GYRO_BIAS] = -h * R_ns
    step[:, _VELOCITY, _ATTITUDE], step[:, _POSITION, _ATTITUDE] = h * turn, 0.5 * h**2 * turn
    step[:, _VELOCITY, _ACCEL_BIAS], step[:, _POSITION, _ACCEL_BIAS] = -h * R_ns, -0.5 * h**2 * R_ns
    step[:, _VELOCITY, _GYRO_BIAS] = -0.5 * h**2 * turn @ R_ns
    step[:, _POSITION, _VELOCITY] = h * np.eye(3)
    return step


def _substep_noise(simulation: Simulation, accel: Array, gyro: Array, h: Array) -> Array:
    errors = simulation.scenario.imu
    assert errors is not None
    noise = np.zeros((len(h), 15, 15))
    for part, other, variance in (
        (_ATTITUDE, _ATTITUDE, gyro**2 * h),
        (_VELOCITY, _VELOCITY, accel**2 * h),
        (_VELOCITY, _POSITION, accel**2 * h**2 / 2.0),
        (_POSITION, _VELOCITY, accel**2 * h**2 / 2.0),
        (_POSITION, _POSITION, accel**2 * h**3 / 3.0),
        (_ACCEL_BIAS, _ACCEL_BIAS, max(errors.accel_bias_walk, 1e-6) ** 2 * h),
        (_GYRO_BIAS, _GYRO_BIAS, max(errors.gyro_bias_walk, 1e-8) ** 2 * h),
    ):
        noise[:, part, other] = variance[:, None, None] * np.eye(3)
    return noise


def _densities(simulation: Simulation, t: Array) -> tuple[Array, Array]:
    """True densities (K-1,) of force and rate in each interval, larger where samples are lost.

    An unseen acceleration of rms a over a fraction u of an interval T is worth a density a * u * sqrt(T).
    """
    errors = simulation.scenario.imu
    assert errors is not None
    gaps = [_session_interval(simulation, gap) for gap in errors.gaps]
    lost = sum(
        (np.clip(np.minimum(t[1:], end) - np.maximum(t[:-1], start), 0.0, None) for start, end in gaps),
        np.zeros(len(t) - 1),
    )
    worth = lost / np.sqrt(np.diff(t))
    accel = np.hypot(max(errors.accel_noise, 1e-4), UNSEEN_ACCEL * worth)
    return accel, np.hypot(max(errors.gyro_noise, 1e-7), UNSEEN_GYRO * worth)


def _session_interval(simulation: Simulation, interval: Interval) -> tuple[float, float]:
    ends = np.array([interval.start, interval.start + interval.duration])
    start, end = simulation.truth.clock.to_session(ends)
    return float(start), float(end)


def _add_matrix_input(constants: Array, states: TruthStates, R_ns: Array, R_bs: Array, h: Array) -> None:
    """Scale and misalignment: row i of the matrix times the true vector is added to component i of the sample."""
    force_s, rate_s = states.specific_force_b @ R_bs, states.angular_rate_b @ R_bs
    by_accel = -np.einsum("kri,kj->krij", R_ns, force_s).reshape(len(h), 3, 9)
    by_gyro = -np.einsum("kri,kj->krij", R_ns, rate_s).reshape(len(h), 3, 9)
    h = h[:, None, None]
    constants[:, _VELOCITY, _ACCEL_MATRIX] += h * by_accel
    constants[:, _POSITION, _ACCEL_MATRIX] += 0.5 * h**2 * by_accel
    constants[:, _ATTITUDE, _GYRO_MATRIX] += h * by_gyro


def _add_fixes(system: ChainSystem, simulation: Simulation, states: TruthStates) -> None:
    errors, gnss = simulation.scenario.gnss, simulation.gnss
    kept = ~np.any(gnss.jump_n != 0.0, axis=1)
    sigma = np.maximum([errors.white_horizontal, errors.white_horizontal, errors.white_up], _TINY)
    at = kept & (gnss.position_time <= states.t[-1])
    _add_positions(system, simulation, gnss.position_time[at], _nearest(states.t, gnss.position_time[at]), sigma)
    if errors.velocity:
        axes = 3 if errors.has_vertical_velocity else 2
        at = kept & (gnss.velocity_time >= states.t[0]) & (gnss.velocity_time <= states.t[-1])
        _add_velocities(system, simulation, gnss.velocity_time[at], _nearest(states.t, gnss.velocity_time[at]), axes)


def _add_positions(system: ChainSystem, simulation: Simulation, t: Array, keyframe: IntArray, sigma: Array) -> None:
    states, arm_b = simulation.truth.at(t), simulation.scenario.lever_arm_b
    by_keyframe, by_constants = np.zeros((len(t), 3, _SIZE)), np.zeros((len(t), 3, system.corner.shape[0]))
    by_keyframe[:, :, _POSITION], by_keyframe[:, :, _OFFSET] = np.eye(3), np.eye(3)
    by_keyframe[:, :, _ATTITUDE] = -so3.skew(states.R_nb @ arm_b)
    by_constants[:, :, _POSITION_LATENCY] = -states.antenna_velocity_n(arm_b)
    by_constants[:, :, _ARM] = states.R_nb
    _add_rows(system, keyframe, by_keyframe, by_constants, sigma)


def _add_velocities(system: ChainSystem, simulation: Simulation, t: Array, keyframe: IntArray, axes: int) -> None:
    states, arm_b, R_bs = simulation.truth.at(t), simulation.scenario.lever_arm_b, simulation.scenario.R_bs
    swing_b = np.cross(states.angular_rate_b, arm_b)
    by_keyframe, by_constants = np.zeros((len(t), 3, _SIZE)), np.zeros((len(t), 3, system.corner.shape[0]))
    by_keyframe[:, :, _VELOCITY] = np.eye(3)
    by_keyframe[:, :, _ATTITUDE] = -so3.skew(np.einsum("nij,nj->ni", states.R_nb, swing_b))
    by_keyframe[:, :, _GYRO_BIAS] = states.R_nb @ so3.skew(arm_b) @ R_bs
    lift_b = np.cross(states.angular_acceleration_b, arm_b) + np.cross(states.angular_rate_b, swing_b)
    acceleration_n = states.acceleration_n + np.einsum("nij,nj->ni", states.R_nb, lift_b)
    by_constants[:, :, _VELOCITY_LATENCY] = -acceleration_n
    by_constants[:, :, _ARM] = states.R_nb @ so3.skew(states.angular_rate_b)
    sigma = np.full(axes, max(simulation.scenario.gnss.velocity_sigma, _TINY))
    _add_rows(system, keyframe, by_keyframe[:, :axes], by_constants[:, :axes], sigma)


def _add_standstill(system: ChainSystem, simulation: Simulation, states: TruthStates) -> None:
    """Zero velocity and zero rate (of the gyro minus its bias) at the keyframes where the kart stands."""
    still = (np.linalg.norm(states.velocity_n, axis=1) < 1e-3) & (np.linalg.norm(states.angular_rate_b, axis=1) < 1e-4)
    keyframe = np.flatnonzero(still)
    errors = simulation.scenario.imu
    assert errors is not None
    rate_sigma = max(errors.gyro_noise, 1e-5) / np.sqrt(float(np.median(np.diff(states.t))))
    by_keyframe = np.zeros((len(keyframe), 6, _SIZE))
    by_keyframe[:, 0:3, _VELOCITY], by_keyframe[:, 3:6, _GYRO_BIAS] = np.eye(3), np.eye(3)
    by_constants = np.zeros((len(keyframe), 6, system.corner.shape[0]))
    _add_rows(system, keyframe, by_keyframe, by_constants, np.repeat([1e-3, rate_sigma], 3))


def _add_rows(system: ChainSystem, keyframe: IntArray, by_keyframe: Array, by_constants: Array, sigma: Array) -> None:
    weighted = (by_keyframe / sigma[:, None] ** 2).transpose(0, 2, 1)
    np.add.at(system.diagonal, keyframe, weighted @ by_keyframe)
    np.add.at(system.border, keyframe, weighted @ by_constants)
    system.corner[...] += np.einsum("nri,r,nrj->ij", by_constants, sigma**-2, by_constants, optimize=True)


def _nearest(t: Array, wanted: Array) -> IntArray:
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    return np.asarray(np.where(wanted - t[after - 1] < t[after] - wanted, after - 1, after), dtype=np.int64)


def _bound(simulation: Simulation, states: TruthStates, solution: ChainSolution, is_epoch: BoolArray) -> Bound:
    """Read the covariance of what people look at: antenna, kart axes."""
    arm_b, R_bs = simulation.scenario.lever_arm_b, simulation.scenario.R_bs
    P, S, X = solution.covariance, solution.constants_covariance, solution.constants_cross
    R, m = states.R_nb, len(S)
    swing_n = np.einsum("nij,nj->ni", R, np.cross(states.angular_rate_b, arm_b))
    J, C = np.zeros((len(R), 3, 3, _SIZE)), np.zeros((len(R), 3, 3, m))  # position, velocity, Euler angles
    J[:, 0, :, _POSITION], J[:, 0, :, _ATTITUDE] = np.eye(3), -so3.skew(R @ arm_b)
    C[:, 0, :, _ARM] = R
    J[:, 1, :, _VELOCITY], J[:, 1, :, _ATTITUDE] = np.eye(3), -so3.skew(swing_n)
    J[:, 1, :, _GYRO_BIAS] = R @ so3.skew(arm_b) @ R_bs
    C[:, 1, :, _ARM] = R @ so3.skew(states.angular_rate_b)
    J[:, 2, :, _ATTITUDE] = euler_jacobian(R) @ R.transpose(0, 2, 1)
    track = J[:, 0].copy()
    track[:, :, _OFFSET] = np.eye(3)

    def variance(by_keyframe: Array, by_constants: Array) -> Array:
        cross = np.einsum("kri,kim,krm->kr", by_keyframe, X, by_constants, optimize=True)
        own = np.einsum("kri,kij,krj->kr", by_keyframe, P, by_keyframe, optimize=True)
        return np.asarray(own + 2.0 * cross + np.einsum("krm,mn,krn->kr", by_constants, S, by_constants, optimize=True))

    position, velocity, attitude = (variance(J[:, i], C[:, i]) for i in range(3))
    sigma = np.sqrt(np.diag(S))
    return Bound(
        t=states.t[is_epoch],
        velocity=np.sqrt(velocity[:, 0] + velocity[:, 1])[is_epoch],
        position=np.sqrt(position[:, 0] + position[:, 1])[is_epoch],
        attitude=np.sqrt(attitude)[is_epoch],
        track=np.sqrt(0.5 * variance(track, C[:, 0])[:, :2].sum(axis=1))[is_epoch],
        relative=_relative_sigma(states.t, solution, J[:, 0, :2], C[:, 0, :2])[is_epoch],
        position_latency=float(sigma[_POSITION_LATENCY]),
        velocity_latency=float(sigma[_VELOCITY_LATENCY]),
        lever_arm_b=sigma[_ARM],
    )


def _relative_sigma(t: Array, solution: ChainSolution, J: Array, C: Array) -> Array:
    """Sigma (K,) of the change of `J x + C c` (K, r) over RELATIVE_INTERVAL, root of the sum over r; NaN at the end.

    Given the constants the keyframes are a Markov chain, so that the covariance of two distant ones follows from those
    of neighbours: P(k, k+2) = P(k, k+1) P(k+1)^-1 P(k+1, k+2), and so on.
    """
    n = len(t)
    S, X = solution.constants_covariance, solution.constants_cross
    gain = X @ np.linalg.inv(S)
    P = solution.covariance - gain @ X.transpose(0, 2, 1)
    neighbour = solution.cross - gain[:-1] @ X[1:].transpose(0, 2, 1)
    onward = _solve_scaled(P[:-1], neighbour)  # P(k)^-1 P(k, k+1)
    later = np.searchsorted(t, t + RELATIVE_INTERVAL - 0.5 * _MERGED)  # a clock may drift by 0.2 ms a second
    cross = P.copy()  # P(k, k + j), j = 0 at first
    reached = np.arange(n)
    while np.any(on := (reached < later) & (reached < n - 1)):
        cross[on] = cross[on] @ onward[reached[on]]
        reached[on] += 1
    met = (later < n) & (reached == later)
    met[met] = np.abs(t[later[met]] - t[met] - RELATIVE_INTERVAL) < 0.5 * _MERGED
    k, j = np.flatnonzero(met), later[met]
    by_constants = C[j] - C[k] + J[j] @ gain[j] - J[k] @ gain[k]  # gain c: the mean of a keyframe given the constants
    variance = np.einsum("nri,nij,nrj->n", J[k], P[k], J[k], optimize=True)
    variance += np.einsum("nri,nij,nrj->n", J[j], P[j], J[j], optimize=True)
    variance -= 2.0 * np.einsum("nri,nij,nrj->n", J[k], cross[k], J[j], optimize=True)
    variance += np.einsum("nrm,mp,nrp->n", by_constants, S, by_constants, optimize=True)
    sigma = np.full(n, np.nan)
    sigma[met] = np.sqrt(variance)
    return sigma


def _solve_scaled(P: Array, rhs: Array) -> Array:
    scale = 1.0 / np.sqrt(np.einsum("kii->ki", P))[:, :, None]
    return np.asarray(scale * np.linalg.solve(P * scale * scale.transpose(0, 2, 1), scale * rhs))
