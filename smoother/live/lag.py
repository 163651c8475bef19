"""The smoother of the last seconds: GTSAM's IncrementalFixedLagSmoother, a keyframe for each fix.

Unknowns as in the batch graph: pose T_ns, velocity, biases and slow GPS offset of each keyframe, and the constants that
a live stream has to find while it runs, see lag_rows.py. They stay in the window, so that what the stream says about
them adds up. A keyframe stands where the Doppler velocity of its fix was true; position is read `velocity latency -
position latency` later, along the motion of the keyframe. Errors of scale are felt as a bias that changes with the
motion, so the biases here are those felt in the interval that follows their keyframe.

Between keyframes and now the inertial samples alone carry the state on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, O, V, X

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.model.imu import bin_imu
from smoother.estimate.model.inertial_noise import InertialNoise
from smoother.frames import GRAVITY_N
from smoother.live import lag_rows as rows
from smoother.samples import ImuSamples

# Steps, in rad, m, m/s, m/s^2, rad/s, s, m, beyond which GTSAM linearises a variable again: a third of its sigma
_RELINEARIZE = {
    "x": [0.005] * 3 + [0.3] * 3,
    "v": [0.1] * 3,
    "b": [0.05] * 3 + [0.005] * 3,
    "o": [1e6] * 3,
    "c": [0.005] * 2 + [0.05] * 6 + [1e6] * 9,
}
_AVERAGED = 0.1  # s each side of a keyframe over which force and rate are averaged: a receiver follows no vibration
_HELD = 1e-3  # m; the height of the antenna, which the drive does not show, does not move by a digit
_ROTATION, _POSITION, _VELOCITY, _BIASES = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 15)
_CONSTANTS = slice(15, 15 + rows.CONSTANTS)


@dataclass(frozen=True, eq=False)
class LagOptions:
    """lag s: what is older is marginalised. longest_step s between keyframes without fixes. bin s, of the inertial
    samples. robust: residuals beyond this many sigmas lose weight (Cauchy). Prior sigmas of the start, SI; those of the
    constants as in the batch graph.
    """

    lag: float = 4.0
    longest_step: float = 1.0
    shortest_step: float = 0.09
    bin: float = 0.04
    robust: float = 4.0
    attitude: float = 0.5
    position: float = 20.0
    velocity: float = 5.0
    accel_bias: float = 0.5
    gyro_bias: float = 0.035
    latency: float = 0.25
    lever_arm: float = 0.5
    doppler_bias: float = 0.03
    sensor_error: float = 0.01


@dataclass(frozen=True, eq=False)
class LagStart:
    """Where a stream begins. R_ns (3, 3), position_n of the IMU, velocity_n, biases (3,) at t s, the first keyframe.

    R_bs (3, 3), with mounting_sigma (3,) rad about the axes of b; latencies s; lever_arm_s (3,) m; inertial densities;
    position_sigma, velocity_sigma, offset_sigma (3,) m, m/s, m; offset_tau s. unseen_offset (3,) m^2: variance of what
    the data cannot tell of the offset, as in the batch smoother: in the sigmas of positions, in no factor.
    """

    t: float
    R_ns: Array
    position_n: Array
    velocity_n: Array
    accel_bias_s: Array
    gyro_bias_s: Array
    R_bs: Array
    mounting_sigma: Array
    position_latency: float
    velocity_latency: float
    lever_arm_s: Array
    inertial: InertialNoise
    position_sigma: Array
    velocity_sigma: Array
    offset_sigma: Array
    offset_tau: float
    unseen_offset: Array


@dataclass(frozen=True, eq=False)
class LagState:
    """The newest state. t s; R_nb (3, 3) of the kart; position_n, velocity_n (3,) of the antenna; sigmas:
    attitude_sigma (3,) rad about the axes of b, velocity_sigma, position_sigma (3,) m/s, m; delay s since the keyframe.
    unseen_offset (3,) m^2 is the part of the positions' variance that no data can take away.
    """

    t: float
    R_nb: Array
    position_n: Array
    velocity_n: Array
    attitude_sigma: Array
    velocity_sigma: Array
    position_sigma: Array
    unseen_offset: Array
    delay: float


class FixedLag:
    """The window. Samples and fixes go in, in the order of their times; `state` is the newest estimate."""

    def __init__(self, start: LagStart, options: LagOptions | None = None) -> None:
        self._start, self._options = start, options or LagOptions()
        self._smoother = gtsam.IncrementalFixedLagSmoother(self._options.lag, _parameters())
        self._k = 0
        self._t = start.t
        self._imu: list[ImuSamples] = []
        self._newest = start.t
        self._covariance: Array | None = None  # of the newest keyframe and the constants, once somebody asked for it
        self.fixes_used = self.fixes_late = 0
        self._begin()

    @property
    def t(self) -> float:
        """Time of the newest keyframe, s."""
        return self._t

    @property
    def latencies(self) -> tuple[float, float]:
        """Position and velocity latency as estimated now, s."""
        return float(self._constants[rows.POSITION_LATENCY]), float(self._constants[rows.VELOCITY_LATENCY])

    @property
    def lever_arm_b(self) -> Array:
        """IMU to antenna (3,) m in b, as estimated now."""
        return np.asarray(self._start.R_bs @ self._constants[rows.LEVER_ARM])

    def add_imu(self, imu: ImuSamples) -> None:
        """Take in samples; where fixes fail for long, keyframes without any are made."""
        self._imu.append(imu)
        self._newest = float(imu.t[-1])
        while self._newest - self._t > self._options.longest_step + 1.0:
            self._extend(self._t + self._options.longest_step, None)
        self._carry_on(imu)

    def add_fix(self, t: float, position_n: Array, velocity_n: Array) -> None:
        """Take in a fix stamped t s: position_n, velocity_n (3,), NaN where unknown."""
        at = t - self._start.velocity_latency
        if at < self._t + self._options.shortest_step or at > self._newest:
            self.fixes_late += 1
            return
        while at - self._t > 1.5 * self._options.longest_step:
            self._extend(self._t + self._options.longest_step, None)
        self.fixes_used += 1
        self._extend(at, np.concatenate([position_n, velocity_n]))

    def state(self) -> LagState:
        """Return the newest state, carried on by inertial samples to the last of them."""
        now = self._ahead_of.predict(self._nav_state, self._bias)
        R_ns, R_bs = now.attitude().matrix(), self._start.R_bs
        arm_s = self._constants[rows.LEVER_ARM]
        swing_s = np.cross(self._last_rate - self._bias.gyroscope(), arm_s)
        P = self._carried_covariance(now, R_ns, swing_s)
        turned = R_ns.T @ P[:3, :3] @ R_ns
        return LagState(
            self._newest,
            R_ns @ R_bs.T,
            now.position() + R_ns @ arm_s,
            now.velocity() + R_ns @ swing_s,
            np.sqrt(np.diag(R_bs @ turned @ R_bs.T) + self._start.mounting_sigma**2),
            np.sqrt(np.diag(P[6:, 6:])),
            np.sqrt(np.diag(P[3:6, 3:6]) + self._start.unseen_offset),
            self._start.unseen_offset,
            self._newest - self._t,
        )

    # ---- inside -----------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        s, o = self._start, self._options
        pose = gtsam.Pose3(gtsam.Rot3(s.R_ns), s.position_n)
        self._nav_state = gtsam.NavState(pose, s.velocity_n)
        self._bias = gtsam.imuBias.ConstantBias(s.accel_bias_s, s.gyro_bias_s)
        self._felt = np.zeros((6, rows.CONSTANTS))
        self._offset = np.zeros(3)
        self._last_rate = s.gyro_bias_s
        self._constants = np.zeros(rows.CONSTANTS)
        self._constants[:5] = [s.position_latency, s.velocity_latency, *s.lever_arm_s]
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        sigmas = [np.repeat([o.attitude, o.position], 3), np.full(3, o.velocity), s.offset_sigma]
        models = [gtsam.noiseModel.Diagonal.Sigmas(sigma) for sigma in sigmas]
        graph.add(gtsam.PriorFactorPose3(X(0), pose, models[0]))
        graph.add(gtsam.PriorFactorVector(V(0), s.velocity_n, models[1]))
        graph.add(gtsam.PriorFactorVector(O(0), np.zeros(3), models[2]))
        mean, covariance = self._constants_prior()
        graph.add(gtsam.PriorFactorVector(C(0), mean, gtsam.noiseModel.Gaussian.Covariance(covariance)))
        values.insert(X(0), pose)
        values.insert(V(0), s.velocity_n)
        values.insert(O(0), np.zeros(3))
        values.insert(C(0), self._constants)
        self._update(graph, values)

    def _constants_prior(self) -> tuple[Array, Array]:
        """Mean (17,) and covariance (17, 17). The height of the antenna is held, as in the batch graph."""
        s, o = self._start, self._options
        mean, sigma = np.zeros(rows.CONSTANTS), np.full(rows.CONSTANTS, o.sensor_error)
        mean[:2] = s.position_latency, s.velocity_latency
        sigma[:2], sigma[rows.DOPPLER_BIAS] = o.latency, o.doppler_bias
        covariance = np.diag(sigma**2)
        level = np.diag([o.lever_arm**2, o.lever_arm**2, _HELD**2])
        covariance[rows.LEVER_ARM, rows.LEVER_ARM] = s.R_bs.T @ level @ s.R_bs
        return mean, covariance

    def _extend(self, t: float, fix: Array | None) -> None:
        """Add a keyframe at t, with a fix (6,) or without one."""
        s, k = self._start, self._k
        n_bins = max(1, round((t - self._t) / self._options.bin))
        accel_bias, gyro_bias = self._bias.accelerometer(), self._bias.gyroscope()
        edges = np.array([self._t, t])
        binned = bin_imu(self._between(self._t, t), edges, n_bins, accel_bias, gyro_bias)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        force, rate = binned.specific_force_s[0].mean(axis=0), binned.angular_rate_s[0].mean(axis=0)
        felt = rows.felt_errors(s.R_bs, force - accel_bias, rate - gyro_bias)
        self._add_bias(graph, felt, t - self._t)
        at_mean = self._bias.vector() + felt @ self._constants
        bias = gtsam.imuBias.ConstantBias(at_mean[:3], at_mean[3:])
        measured = rows.preintegrated(binned, s.inertial, at_mean[:3], at_mean[3:])
        predicted = measured.predict(self._nav_state, bias)
        phi = float(np.exp(-(t - self._t) / s.offset_tau))
        graph.add(gtsam.ImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(k), measured))
        graph.add(rows.offset_step(O(k), O(k + 1), phi, s.offset_sigma))
        values.insert(B(k), bias)
        values.insert(X(k + 1), predicted.pose())
        values.insert(V(k + 1), predicted.velocity())
        values.insert(O(k + 1), phi * self._offset)
        if fix is not None and np.any(np.isfinite(fix)):
            graph.add(self._fix_factor(k + 1, fix, self._reading(t, predicted.attitude().matrix())))
        self._felt, self._k, self._t = felt, k + 1, t
        self._update(graph, values)
        self._forget(t - 2.0 * _AVERAGED)

    def _add_bias(self, graph: gtsam.NonlinearFactorGraph, felt: Array, step: float) -> None:
        """Add what is known of the bias that the interval from the newest keyframe feels."""
        s, o, k = self._start, self._options, self._k
        if k == 0:
            sigma, mean = np.repeat([o.accel_bias, o.gyro_bias], 3), np.concatenate([np.zeros(3), s.gyro_bias_s])
            graph.add(rows.bias_start(B(0), C(0), mean, sigma, felt))
            return
        walk = np.repeat([s.inertial.accel_bias_walk, s.inertial.gyro_bias_walk], 3) * np.sqrt(step)
        graph.add(rows.bias_step(B(k - 1), B(k), C(0), felt - self._felt, walk))

    def _fix_factor(self, k: int, fix: Array, reading: rows.Reading) -> gtsam.NonlinearFactor:
        """One factor for position and velocity: GTSAM calls Python for each. Its rows are whitened there."""
        s, keys = self._start, [X(k), V(k), O(k), C(0)]
        sigma, known = np.concatenate([s.position_sigma, s.velocity_sigma]), np.flatnonzero(np.isfinite(fix))
        error = rows.FixError(keys, fix, sigma, known, reading, s.velocity_latency, self._options.robust)
        return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(known.size), keys, error)

    def _update(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        k, smoother = self._k, self._smoother
        stamps = dict.fromkeys((X(k), V(k), O(k), C(0), *([B(k - 1)] if k else [])), self._t)
        smoother.update(graph, values, stamps)
        pose, velocity = smoother.calculateEstimatePose3(X(k)), smoother.calculateEstimateVector(V(k))
        self._nav_state = gtsam.NavState(pose, velocity)
        self._offset, self._constants = smoother.calculateEstimateVector(O(k)), smoother.calculateEstimateVector(C(0))
        if k:
            felt = smoother.calculateEstimateConstantBias(B(k - 1)).vector() - self._felt @ self._constants
            self._bias = gtsam.imuBias.ConstantBias(felt[:3], felt[3:])
        self._covariance = None
        noise = self._start.inertial
        self._ahead_of = gtsam.PreintegratedImuMeasurements(rows.carrying(noise.accel, noise.gyro), self._bias)
        for imu in self._imu:
            self._carry_on(imu)

    def _joint_covariance(self) -> Array:
        """Covariance (32, 32) of errors in n of attitude, position, velocity, then biases and constants."""
        k = self._k
        keys = [X(k), V(k), B(k - 1), C(0)] if k else [X(k), V(k), C(0)]
        P = self._smoother.getISAM2().jointMarginalCovariance(keys).fullMatrix()
        if k == 0:  # nothing is known of the bias yet
            P = np.insert(np.insert(P, [9] * 6, 0.0, axis=0), [9] * 6, 0.0, axis=1)
        J, R_ns = np.eye(len(P)), self._nav_state.attitude().matrix()
        J[_ROTATION, _ROTATION] = J[_POSITION, _POSITION] = R_ns
        J[_BIASES, _CONSTANTS] = -self._felt
        return np.asarray(J @ P @ J.T)

    def _carried_covariance(self, now: gtsam.NavState, R_ns: Array, swing_s: Array) -> Array:
        """Covariance (9, 9) of errors in n of attitude, antenna position and antenna velocity at `now`."""
        if self._covariance is None:
            self._covariance = self._joint_covariance()
        dt = self._newest - self._t
        by_force = now.velocity() - self._nav_state.velocity() - GRAVITY_N * dt
        moved = now.position() - self._nav_state.position() - self._nav_state.velocity() * dt - 0.5 * GRAVITY_N * dt**2
        F = np.zeros((9, len(self._covariance)))
        F[:, :9] = np.eye(9)
        F[_VELOCITY, _ROTATION], F[_POSITION, _ROTATION] = -so3.skew(by_force), -so3.skew(moved)
        F[_POSITION, _VELOCITY] = np.eye(3) * dt
        F[_POSITION, 9:12], F[_VELOCITY, 9:12], F[_ROTATION, 12:15] = -0.5 * dt**2 * R_ns, -dt * R_ns, -dt * R_ns
        # more and more turned by the bias of the rate, the force pushes elsewhere
        F[_VELOCITY, 12:15] = dt / 2.0 * so3.skew(by_force) @ R_ns
        F[_POSITION, 12:15] = dt / 3.0 * so3.skew(moved) @ R_ns
        noise, Q = self._start.inertial, np.zeros((9, 9))
        Q[_ROTATION, _ROTATION], Q[_VELOCITY, _VELOCITY] = (np.eye(3) * d**2 * dt for d in (noise.gyro, noise.accel))
        Q[_POSITION, _POSITION] = Q[_VELOCITY, _VELOCITY] * dt**2 / 3.0
        Q[_POSITION, _VELOCITY] = Q[_VELOCITY, _POSITION] = Q[_VELOCITY, _VELOCITY] * dt / 2.0
        H, by_arm = np.eye(9), np.zeros((9, rows.CONSTANTS))
        arm_s, rate_s = self._constants[rows.LEVER_ARM], self._last_rate - self._bias.gyroscope()
        H[_POSITION, _ROTATION] = -so3.skew(R_ns @ arm_s)
        H[_VELOCITY, _ROTATION] = -so3.skew(R_ns @ swing_s)
        by_arm[_POSITION, rows.LEVER_ARM], by_arm[_VELOCITY, rows.LEVER_ARM] = R_ns, R_ns @ so3.skew(rate_s)
        J = H @ F
        J[:, _CONSTANTS] += by_arm
        return np.asarray(J @ self._covariance @ J.T + H @ Q @ H.T)

    def _carry_on(self, imu: ImuSamples) -> None:
        """Integrate samples after the newest keyframe, as they are but for the errors of scale."""
        done = self._t + self._ahead_of.deltaTij()
        first = int(np.searchsorted(imu.t, done, side="right"))
        if first == len(imu.t):
            return
        steps = np.diff(imu.t[first:], prepend=done)
        axes, constants = self._start.R_bs, self._constants
        accel_error = constants[rows.ACCEL_ERROR].reshape(3, 2) @ axes[:2]
        force = imu.specific_force_s[first:]
        rate = imu.angular_rate_s[first:]
        force = force - (force - self._bias.accelerometer()) @ accel_error.T
        rate = rate - np.outer((rate - self._bias.gyroscope()) @ axes[2], constants[rows.GYRO_ERROR])
        for f, w, step in zip(force, rate, steps.tolist(), strict=True):
            if step > 1e-9:
                self._ahead_of.integrateMeasurement(f, w, min(step, 0.5))
        self._last_rate = rate[-1]

    def _between(self, start: float, end: float) -> ImuSamples:
        parts = [part for part in self._imu if part.t[-1] > start - 0.1 and part.t[0] < end + 0.1]
        parts = parts or self._imu[-1:]
        return joined(parts)

    def _forget(self, before: float) -> None:
        self._imu = [part for part in self._imu if part.t[-1] > before - 0.2]

    def _reading(self, t: float, R_ns: Array) -> rows.Reading:
        imu = self._between(t - _AVERAGED, t + _AVERAGED)
        near = np.abs(imu.t - t) <= _AVERAGED
        near = near if np.any(near) else np.ones(len(imu.t), dtype=np.bool_)
        rate = imu.angular_rate_s[near].mean(axis=0) - self._bias.gyroscope()
        up_s = R_ns[2]
        return rows.Reading(
            imu.specific_force_s[near].mean(axis=0) - self._bias.accelerometer(), so3.skew(up_s * (up_s @ rate))
        )


def _parameters() -> gtsam.ISAM2Params:
    parameters, thresholds = gtsam.ISAM2Params(), gtsam.ISAM2ThresholdMap()
    for symbol, limit in _RELINEARIZE.items():
        thresholds.insert((symbol, np.array(limit)))
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = 1
    parameters.findUnusedFactorSlots = True  # else the list of factors grows as long as the stream goes on
    return parameters


def joined(parts: Sequence[ImuSamples]) -> ImuSamples:
    """Return samples that came in parts, one after the other, as one."""
    return ImuSamples(
        np.concatenate([part.t for part in parts]),
        np.concatenate([part.specific_force_s for part in parts]),
        np.concatenate([part.angular_rate_s for part in parts]),
        parts[-1].accel_full_scale,
        parts[-1].gyro_full_scale,
    )
