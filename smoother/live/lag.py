"""Fixed-lag smoother: the graph of the batch smoother in a moving window.

With each fix, keyframes are added up to the newest sample, and one Gauss-Newton step is taken. Keyframes older than the
lag are marginalised into a prior of the first remaining keyframe and the constants. Constants stay in the window, so
that their information accumulates. With the `wheels` factor they are held at the values of the identification, except
those that the factor determines, and their covariance is added, as in the batch smoother.

From the newest keyframe to now one more IMU factor predicts the state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.estimate.factors.gaussian import columns_of
from smoother.estimate.factors.gnss import arm_axes
from smoother.estimate.factors.graph import MAX_LATENCY, Measurements, Priors
from smoother.estimate.factors.imu import imu_factors, preintegrate, preintegration_parameters
from smoother.estimate.factors.rows import Between
from smoother.estimate.model.imu import bin_imu
from smoother.estimate.model.noise import InertialNoise, Noise
from smoother.estimate.model.state import State
from smoother.estimate.output.dense_rows import without_noise
from smoother.estimate.output.estimated import antenna_covariance
from smoother.estimate.solvers.batch import Step, step
from smoother.estimate.solvers.covariance import Covariances
from smoother.estimate.solvers.identify import FREE
from smoother.live.lag_graph import Marginal, WindowGraph, extrapolated, joined_states, predicted
from smoother.samples import ImuSamples

LAG = 4.0  # s; older keyframes are marginalised
CONTEXT = 10.0  # s of earlier keyframes, used by the low-pass of the motion
LONGEST_STEP = 1.0  # s without a fix, after which keyframes are added
BIN = 0.04  # s, of the inertial samples between keyframes


@dataclass(frozen=True, eq=False)
class LagStart:
    """Start of a stream: keyframes `before` its window, their marginal on its first keyframe and the constants, and
    the noise and the priors of their graph. held (C, C): covariance of the constants where these are held, else None.

    R_bs (3, 3), with mounting_sigma (3,) rad about the axes of b. unseen_offset (3,) m^2: variance of the
    unobservable part of the offset, as in the batch smoother: in the sigmas of positions, in no factor.
    """

    before: State
    known: Marginal
    noise: Noise
    priors: Priors
    held: Array | None
    R_bs: Array
    mounting_sigma: Array
    unseen_offset: Array

    @property
    def t(self) -> float:
        """Time of the first keyframe, s."""
        return float(self.known.at.t[0])


@dataclass(frozen=True, eq=False)
class LagState:
    """The newest state. t s; R_nb (3, 3) of the kart; position_n, velocity_n (3,) of the antenna; sigmas:
    attitude_sigma (3,) rad about the axes of b, velocity_sigma, position_sigma (3,) m/s, m; delay s since the newest
    fix was true. unseen_offset (3,) m^2 is the unobservable part of the variance of positions.
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
    """The window. Samples and fixes are added in the order of their times; `state` is the newest estimate."""

    def __init__(self, start: LagStart) -> None:
        self._start = start
        self._before, self._state, self._past = start.before, start.known.at, start.known
        self._interval, self._keyframes = start.before.interval, 0  # since the start
        self._preintegrated: list[gtsam.PreintegratedCombinedMeasurements] = []
        self._imu: list[ImuSamples] = []
        self._newest = self._solved = start.t  # newest sample; stamp of the newest fix in the solution
        nothing, one = np.full((1, 3), np.nan), np.ones(1)
        # an empty fix as a placeholder
        self._fixes = Measurements(self._state.t, nothing, nothing, one, one, np.empty(0, np.int64))
        self._taken: Step | None = None
        self._known: Covariances | None = None  # after that step, computed on demand
        self._now: LagState | None = None  # likewise
        self.fixes_used = self.fixes_late = 0

    @property
    def t(self) -> float:
        """Time of the newest keyframe, s."""
        return float(self._state.t[-1])

    @property
    def newest(self) -> float:
        """Time of the newest sample, s."""
        return self._newest

    @property
    def latencies(self) -> tuple[float, float]:
        """Position and velocity latency as estimated now, s."""
        return self._state.constant("position_latency"), self._state.constant("velocity_latency")

    def add_imu(self, imu: ImuSamples) -> None:
        """Add samples; in long outages, keyframes without fixes are added."""
        self._imu.append(imu)
        self._newest = float(imu.t[-1])
        self._advance()

    def add_fix(self, t: float, position_n: Array, velocity_n: Array) -> None:
        """Add a fix stamped t s: position_n, velocity_n (3,), NaN where unknown."""
        times, first = t - np.array(self.latencies), self._state.t[0]
        is_ahead = np.max(times) > self._newest + MAX_LATENCY  # no latency explains that
        if is_ahead or t <= self._fixes.t[-1] or np.all(times < first):
            self.fixes_late += 1
            return
        self.fixes_used += 1
        fixes = self._fixes
        self._fixes = replace(
            fixes,
            t=np.append(fixes.t, t),
            # earlier fixes are in the prior
            position_n=np.vstack([fixes.position_n, position_n if times[0] >= first else np.full(3, np.nan)]),
            velocity_n=np.vstack([fixes.velocity_n, velocity_n if times[1] >= first else np.full(3, np.nan)]),
            position_scale=np.append(fixes.position_scale, 1.0),
            velocity_scale=np.append(fixes.velocity_scale, 1.0),
        )
        self._advance()

    def state(self) -> LagState | None:
        """Return the newest state, predicted to the last sample; None before the first fix."""
        if self._now is None and self._taken is not None:
            if self._known is None:
                chain, held = self._taken.chain(), self._start.held
                self._known = (chain if held is None else chain.with_constants(held, columns_of(FREE))).covariances()
            self._now = self._state_now(self._known)
        return self._now

    # ---- inside -----------------------------------------------------------------------------------------------------

    def _state_now(self, known: Covariances) -> LagState:
        last = self._state.part(slice(-1, None))
        two, known = extrapolated(last, known, self._preintegrated_since(), self._newest)
        R_ns, R_bs, unseen = two.R_ns[-1], self._start.R_bs, self._start.unseen_offset
        arm_n = (arm_axes(Between.at(two, two.t)) @ two.constants["lever_arm"])[-1]
        rate_n, of_rate = rate_without_noise(joined(self._imu), two, self._start.noise.inertial)
        P, in_b, by_rate = antenna_covariance(two, known, None)[-1], R_bs @ R_ns.T, so3.skew(arm_n)
        return LagState(
            self._newest,
            R_ns @ R_bs.T,
            two.position_n[-1] + arm_n,
            two.velocity_n[-1] + np.cross(rate_n, arm_n),
            np.sqrt(np.diag(in_b @ P[:3, :3] @ in_b.T) + self._start.mounting_sigma**2),
            np.sqrt(np.diag(P[3:6, 3:6] + by_rate @ of_rate @ by_rate.T)),
            np.sqrt(np.diag(P[6:, 6:]) + unseen),
            unseen,
            self._newest - float(self._fixes.t[self._are_reached()][-1]) + self.latencies[1],
        )

    def _are_reached(self) -> BoolArray:
        """Mask of the fixes between keyframes; later ones wait for samples."""
        return np.asarray(self._fixes.t - min(self.latencies) <= self.t)

    def _advance(self) -> None:
        """Add keyframes and solve, after samples reached a keyframe with a new fix before it, or after LONGEST_STEP."""
        self._now = None
        steps = int((self._newest - 0.01 - self.t) / self._interval)  # s from the newest keyframe to now
        end = self.t + steps * self._interval
        new = self._fixes.t[(self._fixes.t > self._solved) & (self._fixes.t - min(self.latencies) <= end)]
        if (steps and len(new)) or steps * self._interval >= LONGEST_STEP:
            self._solved = float(np.max(new, initial=self._solved))
            self._extend(steps)
            self._solve()

    def _extend(self, steps: int) -> None:
        """Predict keyframes from the newest one on."""
        t: Array = self._start.t + self._interval * np.arange(self._keyframes, self._keyframes + steps + 1.0)
        biases, bins = (self._state.accel_bias_s[-1], self._state.gyro_bias_s[-1]), max(1, round(self._interval / BIN))
        # the vibration of the session is unknown here: average noise
        binned = replace(bin_imu(joined(self._imu), t, bins, *biases), rough=None)
        offset = float(np.exp(-self._interval / self._start.noise.offset_tau))
        for k, measured in enumerate(preintegrate(binned, self._start.noise.inertial, *biases), 1):
            self._state = predicted(self._state, measured, t[k], offset)
            self._preintegrated.append(measured)
        self._keyframes += steps
        # s before the newest keyframe, from which the rate of the samples is computed
        self._imu = [part for part in self._imu if part.t[-1] > self.t - 2.0]

    def _preintegrated_since(self) -> gtsam.PreintegratedCombinedMeasurements:
        """The preintegrated samples since the newest keyframe."""
        imu, noise = joined([part for part in self._imu if part.t[-1] > self.t]), self._start.noise.inertial
        bias = gtsam.imuBias.ConstantBias(self._state.accel_bias_s[-1], self._state.gyro_bias_s[-1])
        parameters = preintegration_parameters(noise.accel, noise.gyro, noise)
        measured = gtsam.PreintegratedCombinedMeasurements(parameters, bias)
        new = slice(int(np.searchsorted(imu.t, self.t, side="right")), None)
        steps = np.diff(imu.t[new], prepend=self.t).tolist()
        for force, rate, dt in zip(imu.specific_force_s[new], imu.angular_rate_s[new], steps, strict=True):
            measured.integrateMeasurement(force, rate, dt)
        return measured

    def _solve(self) -> None:
        """Take a step, and marginalise keyframes older than the lag."""
        intervals, self._past = np.arange(len(self._preintegrated)), self._past.moved_to(self._state.part(slice(0, 1)))
        graph = WindowGraph(
            imu_factors(self._preintegrated, intervals),
            self._past.factors(),
            intervals,
            self._preintegrated,
            self._fixes.of(self._are_reached()),
            self._start.noise,
            self._start.priors,
            self._state,
            before=self._before,
        )
        taken = step(graph, self._state.values())
        self._state, self._taken, self._known = taken.after, taken, None
        leave = len(intervals) - round(LAG / self._interval)
        if leave > 0:
            self._marginalise(taken, leave)

    def _marginalise(self, taken: Step, leave: int) -> None:
        """Marginalise the first keyframes of the window and their measurements."""
        self._past = Marginal.of(taken, self._past.factors(), leave)
        fixes, at = self._fixes, taken.state
        by_position, by_velocity = (
            (Between.at(at, fixes.t - at.constant(name)).interval < leave)[:, None]
            for name in ("position_latency", "velocity_latency")
        )
        self._fixes = replace(
            fixes,
            position_n=np.where(by_position, np.nan, fixes.position_n),
            velocity_n=np.where(by_velocity, np.nan, fixes.velocity_n),
        ).of(fixes.t >= min(at.t[leave] - 1.0, fixes.t[-1]))  # s before the window; at least the newest fix is kept
        before = joined_states(self._before, self._state.part(slice(0, leave)))
        self._before = before.part(slice(-round(CONTEXT / self._interval), None))
        self._state, self._preintegrated = self._state.part(slice(leave, None)), self._preintegrated[leave:]


def rate_without_noise(imu: ImuSamples, state: State, noise: InertialNoise) -> tuple[Array, Array]:
    """Angular rate (3,) rad/s in n at the last sample, where the last keyframe of `state` is, and its covariance."""
    axes, dt = state.geometry.level_axes_s, float(np.mean(np.diff(imu.t)))
    variances = noise.gyro**2 / dt * np.diag(axes @ np.array(noise.gyro_shape) @ axes.T)
    measured = (imu.angular_rate_s - state.gyro_bias_s[-1]) @ axes.T
    rates, left = without_noise(measured, variances, dt, np.ones(3, dtype=np.bool_))
    to_n = state.R_ns[-1] @ axes.T
    return to_n @ rates[-1], (to_n * left) @ to_n.T


def joined(parts: Sequence[ImuSamples]) -> ImuSamples:
    """Return samples that came in parts, one after the other, as one."""
    return ImuSamples(
        np.concatenate([part.t for part in parts]),
        np.concatenate([part.specific_force_s for part in parts]),
        np.concatenate([part.angular_rate_s for part in parts]),
        parts[-1].accel_full_scale,
        parts[-1].gyro_full_scale,
    )
