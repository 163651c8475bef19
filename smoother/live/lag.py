"""The smoother of the last seconds: GTSAM's IncrementalFixedLagSmoother, a keyframe for each fix.

Unknowns as in the batch graph: pose T_ns, velocity, biases and slow GPS offset of each keyframe, and here also the
constants that a live stream has to find while it runs: both latencies and the lever arm. They stay in the window, so
that what the stream says about them adds up. A keyframe stands where the Doppler velocity of its fix was true; position
is read `velocity latency - position latency` later, along the motion of the keyframe.

Between keyframes and now the inertial samples alone carry the state on.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, O, V, X

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph.imu import InertialNoise, bin_imu, preintegrate
from smoother.frames import GRAVITY_N
from smoother.samples import ImuSamples

_CONSTANTS = 5  # position latency, velocity latency, lever arm
# Steps, in rad, m, m/s, m/s^2, rad/s, s, m, beyond which GTSAM linearises a variable again: a third of its sigma
_RELINEARIZE = {
    "x": [0.005] * 3 + [0.3] * 3,
    "v": [0.1] * 3,
    "b": [0.05] * 3 + [0.005] * 3,
    "o": [1e6] * 3,
    "c": [0.005] * 2 + [0.05] * 3,
}
_AVERAGED = 0.1  # s each side of a keyframe over which force and rate are averaged: a receiver follows no vibration


@dataclass(frozen=True, eq=False)
class LagOptions:
    """lag s: what is older is marginalised. longest_step s between keyframes without fixes. bin s, of the inertial
    samples. robust: residuals beyond this many sigmas lose weight (Cauchy). Prior sigmas of the start, SI."""

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


@dataclass(frozen=True, eq=False)
class LagStart:
    """Where a stream begins. R_ns (3, 3), position_n of the IMU, velocity_n, biases (3,) at t s, the first keyframe.

    R_bs (3, 3); latencies s; lever_arm_s (3,) m; inertial densities; position_sigma, velocity_sigma, offset_sigma (3,)
    m, m/s, m; offset_tau s.
    """

    t: float
    R_ns: Array
    position_n: Array
    velocity_n: Array
    accel_bias_s: Array
    gyro_bias_s: Array
    R_bs: Array
    position_latency: float
    velocity_latency: float
    lever_arm_s: Array
    inertial: InertialNoise
    position_sigma: Array
    velocity_sigma: Array
    offset_sigma: Array
    offset_tau: float


@dataclass(frozen=True, eq=False)
class LagState:
    """The newest state. t s; R_nb (3, 3) of the kart; position_n, velocity_n (3,) of the antenna; sigmas:
    attitude_sigma (3,) rad about the axes of b, velocity_sigma, position_sigma (3,) m/s, m; delay s since the keyframe.
    """

    t: float
    R_nb: Array
    position_n: Array
    velocity_n: Array
    attitude_sigma: Array
    velocity_sigma: Array
    position_sigma: Array
    delay: float


@dataclass(frozen=True, eq=False)
class _Reading:
    """Motion at a keyframe that the rows of a fix are linear in: mean force and turn rate about up, in s."""

    force_s: Array
    skew_rate_s: Array


class FixedLag:
    """The window. Samples and fixes go in, in the order of their times; `state` is the newest estimate."""

    def __init__(self, start: LagStart, options: LagOptions | None = None) -> None:
        self._start, self._options = start, options or LagOptions()
        self._smoother = gtsam.IncrementalFixedLagSmoother(self._options.lag, _parameters())
        self._k = 0
        self._t = start.t
        self._imu: list[ImuSamples] = []
        self._newest = start.t
        self._covariance: Array | None = None  # of the newest keyframe, once somebody asked for it
        self._ahead_of: Any = None  # motion since the newest keyframe
        self.fixes_used = self.fixes_late = 0
        self._begin()

    @property
    def t(self) -> float:
        """Time of the newest keyframe, s."""
        return self._t

    @property
    def latencies(self) -> tuple[float, float]:
        """Position and velocity latency as estimated now, s."""
        return float(self._constants[0]), float(self._constants[1])

    @property
    def lever_arm_b(self) -> Array:
        """IMU to antenna (3,) m in b, as estimated now."""
        return np.asarray(self._start.R_bs @ self._constants[2:])

    def add_imu(self, imu: ImuSamples) -> None:
        """Take in samples; where fixes fail for long, keyframes without any are made."""
        self._imu.append(imu)
        self._newest = float(imu.t[-1])
        while self._newest - self._t > self._options.longest_step + 1.0:
            self._extend(self._t + self._options.longest_step, None, None)
        self._carry_on(imu)

    def add_fix(self, t: float, position_n: Array, velocity_n: Array, scale: float = 1.0) -> None:
        """Take in a fix stamped t s: position_n, velocity_n (3,), NaN where unknown. scale multiplies its sigmas."""
        at = t - self._start.velocity_latency
        if at < self._t + self._options.shortest_step or at > self._newest:
            self.fixes_late += 1
            return
        while at - self._t > 1.5 * self._options.longest_step:
            self._extend(self._t + self._options.longest_step, None, None)
        self.fixes_used += 1
        self._extend(at, (position_n, velocity_n), scale)

    def state(self) -> LagState:
        """Return the newest state, carried on by inertial samples to the last of them."""
        now = self._ahead_of.predict(self._nav_state, self._bias)
        R_ns, R_bs = now.attitude().matrix(), self._start.R_bs
        arm_s = self._constants[2:]
        rate_s = self._last_rate - self._bias.gyroscope()
        delay = self._newest - self._t
        P = self._covariance = self._newest_covariance() if self._covariance is None else self._covariance
        turned = P[:3, :3] + self._start.inertial.gyro**2 * delay * np.eye(3)
        swing = R_ns @ np.cross(rate_s, arm_s)
        by_tilt = -so3.skew(GRAVITY_N) @ R_ns * delay
        velocity = P[6:9, 6:9] + self._start.inertial.accel**2 * delay * np.eye(3) + by_tilt @ P[:3, :3] @ by_tilt.T
        return LagState(
            self._newest,
            R_ns @ R_bs.T,
            now.position() + R_ns @ arm_s,
            now.velocity() + swing,
            np.sqrt(np.diag(R_bs @ turned @ R_bs.T)),
            np.sqrt(np.diag(velocity)),
            np.sqrt(np.diag(R_ns @ P[3:6, 3:6] @ R_ns.T)),
            delay,
        )

    # ---- inside -----------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        s, o = self._start, self._options
        pose = gtsam.Pose3(gtsam.Rot3(s.R_ns), s.position_n)
        self._nav_state = gtsam.NavState(pose, s.velocity_n)
        self._bias = gtsam.imuBias.ConstantBias(s.accel_bias_s, s.gyro_bias_s)
        self._constants = np.array([s.position_latency, s.velocity_latency, *s.lever_arm_s])
        self._offset = np.zeros(3)
        self._last_rate = s.gyro_bias_s
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        sigmas = (
            np.repeat([o.attitude, o.position], 3),
            np.full(3, o.velocity),
            np.repeat([o.accel_bias, o.gyro_bias], 3),
            s.offset_sigma,
            np.array([o.latency, o.latency, *np.full(3, o.lever_arm)]),
        )
        models = [gtsam.noiseModel.Diagonal.Sigmas(sigma) for sigma in sigmas]
        nothing = gtsam.imuBias.ConstantBias(np.zeros(3), s.gyro_bias_s)
        graph.add(gtsam.PriorFactorPose3(X(0), pose, models[0]))
        graph.add(gtsam.PriorFactorVector(V(0), s.velocity_n, models[1]))
        graph.add(gtsam.PriorFactorConstantBias(B(0), nothing, models[2]))
        graph.add(gtsam.PriorFactorVector(O(0), np.zeros(3), models[3]))
        arm_free = np.array([s.position_latency, s.velocity_latency, 0.0, 0.0, 0.0])
        graph.add(gtsam.PriorFactorVector(C(0), arm_free, models[4]))
        values.insert(X(0), pose)
        values.insert(V(0), s.velocity_n)
        values.insert(B(0), self._bias)
        values.insert(O(0), np.zeros(3))
        values.insert(C(0), self._constants)
        self._update(graph, values)

    def _extend(self, t: float, fix: tuple[Array, Array] | None, scale: float | None) -> None:
        """Add a keyframe at t, with a fix or without one."""
        s, k = self._start, self._k
        imu = self._between(self._t, t)
        n_bins = max(1, round((t - self._t) / self._options.bin))
        binned = bin_imu(imu, np.array([self._t, t]), n_bins, self._bias.accelerometer(), self._bias.gyroscope())
        measured = preintegrate(binned, s.inertial, self._bias.accelerometer(), self._bias.gyroscope())[0]
        predicted = measured.predict(self._nav_state, self._bias)
        phi = float(np.exp(-(t - self._t) / s.offset_tau))
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(gtsam.CombinedImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), measured))
        graph.add(_wander(O(k), O(k + 1), phi, s.offset_sigma))
        values.insert(X(k + 1), predicted.pose())
        values.insert(V(k + 1), predicted.velocity())
        values.insert(B(k + 1), self._bias)
        values.insert(O(k + 1), phi * self._offset)
        if fix is not None:
            reading = self._reading(t, predicted.attitude().matrix())
            factor = self._fix_factor(k + 1, fix, reading, scale or 1.0)
            if factor is not None:
                graph.add(factor)
        self._k, self._t = k + 1, t
        self._update(graph, values)
        self._forget(t - 2.0 * _AVERAGED)

    def _fix_factor(
        self, k: int, fix: tuple[Array, Array], reading: _Reading, scale: float
    ) -> gtsam.NonlinearFactor | None:
        """One factor for position and velocity: GTSAM calls Python for each. Its rows are whitened there."""
        s, keys = self._start, [X(k), V(k), B(k), O(k), C(0)]
        measured, sigma = np.concatenate(fix), scale * np.concatenate([s.position_sigma, s.velocity_sigma])
        known = np.flatnonzero(np.isfinite(measured))
        if known.size == 0:
            return None
        error = partial(_error, keys, measured, sigma, known, reading, s.velocity_latency, self._options.robust)
        return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(known.size), keys, error)

    def _update(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        k = self._k
        stamps = {X(k): self._t, V(k): self._t, B(k): self._t, O(k): self._t, C(0): self._t}
        self._smoother.update(graph, values, stamps)
        smoother = self._smoother
        pose, velocity = smoother.calculateEstimatePose3(X(k)), smoother.calculateEstimateVector(V(k))
        self._nav_state = gtsam.NavState(pose, velocity)
        self._bias = smoother.calculateEstimateConstantBias(B(k))
        self._offset, self._constants = smoother.calculateEstimateVector(O(k)), smoother.calculateEstimateVector(C(0))
        self._covariance = None
        self._ahead_of = gtsam.PreintegratedCombinedMeasurements(_carrying(self._start.inertial), self._bias)
        for imu in self._imu:
            self._carry_on(imu)

    def _newest_covariance(self) -> Array:
        """Covariance (9, 9) of the newest keyframe's pose and velocity; between the two it is not needed."""
        P = np.zeros((9, 9))
        P[:6, :6] = self._smoother.marginalCovariance(X(self._k))
        P[6:, 6:] = self._smoother.marginalCovariance(V(self._k))
        return P

    def _carry_on(self, imu: ImuSamples) -> None:
        """Integrate samples after the newest keyframe, as they are."""
        done = self._t + self._ahead_of.deltaTij()
        first = int(np.searchsorted(imu.t, done, side="right"))
        steps = np.diff(imu.t[first:], prepend=done)
        rows = zip(imu.specific_force_s[first:], imu.angular_rate_s[first:], steps.tolist(), strict=True)
        for force, rate, step in rows:
            if step > 1e-9:
                self._ahead_of.integrateMeasurement(force, rate, min(step, 0.5))
        if len(steps):
            self._last_rate = imu.angular_rate_s[-1]

    def _between(self, start: float, end: float) -> ImuSamples:
        parts = [part for part in self._imu if part.t[-1] > start - 0.1 and part.t[0] < end + 0.1]
        parts = parts or self._imu[-1:]
        return ImuSamples(
            np.concatenate([part.t for part in parts]),
            np.concatenate([part.specific_force_s for part in parts]),
            np.concatenate([part.angular_rate_s for part in parts]),
            parts[-1].accel_full_scale,
            parts[-1].gyro_full_scale,
        )

    def _forget(self, before: float) -> None:
        self._imu = [part for part in self._imu if part.t[-1] > before - 0.2]

    def _reading(self, t: float, R_ns: Array) -> _Reading:
        imu = self._between(t - _AVERAGED, t + _AVERAGED)
        near = np.abs(imu.t - t) <= _AVERAGED
        near = near if np.any(near) else np.ones(len(imu.t), dtype=np.bool_)
        rate = imu.angular_rate_s[near].mean(axis=0) - self._bias.gyroscope()
        up_s = R_ns[2]
        return _Reading(
            imu.specific_force_s[near].mean(axis=0) - self._bias.accelerometer(), so3.skew(up_s * (up_s @ rate))
        )


def _parameters() -> gtsam.ISAM2Params:
    parameters, thresholds = gtsam.ISAM2Params(), gtsam.ISAM2ThresholdMap()
    for symbol, limit in _RELINEARIZE.items():
        thresholds.insert((symbol, np.array(limit)))
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = 1
    return parameters


def _carrying(noise: InertialNoise) -> gtsam.PreintegrationCombinedParams:
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(-float(GRAVITY_N[2]))
    params.setAccelerometerCovariance(np.eye(3) * noise.accel**2)
    params.setGyroscopeCovariance(np.eye(3) * noise.gyro**2)
    return params


def _wander(left: int, right: int, phi: float, sigma: Array) -> gtsam.NonlinearFactor:
    """Step of the first-order Gauss-Markov offset of the fixes: linear, stated about zero. Source: Gelb 1974, 3.8."""
    model = gtsam.noiseModel.Diagonal.Sigmas(sigma * np.sqrt(1.0 - phi**2))
    factor = gtsam.JacobianFactor(left, -phi * np.eye(3), right, np.eye(3), np.zeros(3), model)
    about = gtsam.Values()
    about.insert(left, np.zeros(3))
    about.insert(right, np.zeros(3))
    return gtsam.LinearContainerFactor(factor, about)


def _error(keys, measured, sigma, known, reading, latency, robust, this, values, jacobians):  # type: ignore[no-untyped-def]
    """What GTSAM calls: whitened residual (r,), and Jacobians (r, .) by the five variables, if it wants them."""
    pose = values.atPose3(keys[0])
    predicted, blocks = fix_rows(
        pose.rotation().matrix(),
        pose.translation(),
        values.atVector(keys[1]),
        values.atVector(keys[3]),
        values.atVector(keys[4]),
        reading,
        latency,
    )
    whitened = np.zeros(6)
    whitened[known] = (predicted - measured)[known] / sigma[known]
    weight = np.empty(6)  # Cauchy's, of position and of velocity each
    weight[:3] = 1.0 / (1.0 + whitened[:3] @ whitened[:3] / robust**2)
    weight[3:] = 1.0 / (1.0 + whitened[3:] @ whitened[3:] / robust**2)
    root = np.sqrt(weight)
    if jacobians is not None:
        scale = (root / sigma)[known, None]
        for i, block in enumerate(blocks):
            jacobians[i] = np.asfortranarray(block[known] * scale)
    return (root * whitened)[known]


_EYE = np.eye(3)


def fix_rows(
    R_ns: Array, p: Array, v: Array, offset: Array, constants: Array, reading: _Reading, latency: float
) -> tuple[Array, tuple[Array, Array, Array, Array, Array]]:
    """Predicted position and velocity (6,) of a fix, and Jacobians (6, .) by pose, velocity, biases, offset, constants.

    latency s, of the velocity when the keyframe was placed. The rate in `reading` is held: the bias of the gyro moves
    the antenna's swing by a centimetre a second.
    """
    arm, turning = constants[2:], reading.skew_rate_s
    swing = turning @ arm
    late, late_velocity = latency - constants[0], latency - constants[1]
    a = R_ns @ reading.force_s + GRAVITY_N
    swung = arm + late * swing
    by_pose, by_velocity, by_offset, by_constants = (np.zeros((6, n)) for n in (6, 3, 3, _CONSTANTS))
    by_pose[:3, :3] = -R_ns @ so3.skew(swung + 0.5 * late**2 * reading.force_s)
    by_pose[:3, 3:] = R_ns
    by_pose[3:, :3] = -R_ns @ so3.skew(swing + late_velocity * reading.force_s)
    by_velocity[:3], by_velocity[3:] = late * _EYE, _EYE
    by_offset[:3] = _EYE
    by_constants[:3, 0] = -(v + a * late) - R_ns @ swing
    by_constants[3:, 1] = -a
    by_constants[:3, 2:] = R_ns @ (_EYE + late * turning)
    by_constants[3:, 2:] = R_ns @ turning
    predicted = np.concatenate(
        [p + v * late + 0.5 * a * late**2 + R_ns @ swung + offset, v + a * late_velocity + R_ns @ swing]
    )
    return predicted, (by_pose, by_velocity, _NO_BIAS, by_offset, by_constants)


_NO_BIAS = np.zeros((6, 6))
_NO_BIAS.flags.writeable = False
