"""The graph of a session: options, measurements, priors, the table of factors, and the function that builds the graph.

The inertial factors and the priors are GTSAM's own. Every other factor is one vectorised function; the table defines
which of them a session has and whether they are robust.
"""

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.errors import UsageError
from smoother.estimate.factors.constraints import ground_rows, heading_rows, standstill_rows
from smoother.estimate.factors.gnss import offset_rows, offset_start_rows, position_rows, velocity_rows
from smoother.estimate.factors.imu import imu_factors, preintegrate
from smoother.estimate.factors.motion_prior import Unsampled, motion_prior_rows
from smoother.estimate.factors.rows import Rows, robust, with_sigma
from smoother.estimate.factors.wheels import USUAL_WHEEL_SPEED, slip_of, slip_rows, wheel_speed_rows
from smoother.estimate.model.heading import Heading
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import CONSTANTS, KEYS, Sigma, State
from smoother.samples import WheelSpeed
from smoother.units import DEG

ANYWHERE = np.repeat([3.0, 1e4], 3)  # rad, m: uninformative prior of the first pose
ANY_SPEED = 1e3  # m/s, likewise
MAX_LATENCY = 0.6  # s; the slowest known receiver has 0.58 s
FIXES_BETWEEN = 2  # from keyframe to keyframe, if there are so many in the longest interval
LEAST_INTERVAL = 0.08  # s between keyframes; of less, too few bins would remain


@dataclass(frozen=True)
class GraphOptions:
    """Options of the graph, in SI; where each figure comes from.

    rate Hz: rows of the trajectory a second. solver: "batch", or "isam2", which goes through the session as a stream.
    in_step: a force that is late behind the rate is taken to its time.
    wheels: the kart is asked to point nearly along its path.
    without: names of factors of the table (factors/graph.py) that are left out.
    keyframe_interval s: 0.2 is one keyframe to a fix of a 5 Hz receiver; less beyond 10 Hz (:meth:`for_fixes`).
    bin_interval s: of the averaged inertial samples.
    accel_bias_sigma, gyro_bias_sigma: priors; zero-g tolerance of the MPU9250, 0.6-0.8 m/s^2, and what the alignment
        leaves of the gyroscope's bias.
    accel_bias_walk, gyro_bias_walk: temperature drift of the same part while it warms up.
    sigmas: of the priors of the constants, by name (model/state.py).
    offset_sigma (3,) m, offset_tau s: slow offset of the fixes of receivers in general.
    identification_span s: the busiest stretch as long as this shows constants and noise before the whole is solved.
    """

    rate: float = 50.0
    solver: str = "batch"
    in_step: bool = True
    wheels: bool = True
    without: frozenset[str] = frozenset()
    keyframe_interval: float = 0.2
    bin_interval: float = 0.02
    accel_bias_sigma: float = 0.5
    gyro_bias_sigma: float = 2.0 * DEG
    accel_bias_walk: float = 0.003
    gyro_bias_walk: float = 0.006 * DEG
    sigmas: dict[str, Sigma] = field(default_factory=lambda: {c.name: c.sigma for c in CONSTANTS})
    offset_sigma: tuple[float, float, float] = (2.0, 2.0, 3.4)
    offset_tau: float = 60.0
    identification_span: float = 120.0

    def for_fixes(self, t: Array) -> "GraphOptions":
        """Return the options for fixes at t (N,) s: no more than FIXES_BETWEEN of them from one keyframe to the next.

        A cubic of 0.2 s is stiffer than five good velocities in it: what it misses of the motion would pass for noise.
        """
        spacing = float(median(np.diff(t))) if len(t) > 1 else math.inf
        interval = max(FIXES_BETWEEN * spacing, LEAST_INTERVAL)
        return replace(self, keyframe_interval=interval) if interval < 0.99 * self.keyframe_interval else self


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measurements besides the inertial samples, on their clock.

    t (N,) s: stamps of the fixes. position_n m, velocity_n m/s (N, 3): NaN where unknown.
    position_scale, velocity_scale (N,): factors of the session's sigmas.
    speed (N,) m/s: used where no velocity is known.
    still (S,): intervals at rest.
    rejected (N,): fixes whose positions are not used.
    heading: of the magnetometer.
    rolls (K,): keyframes at which wheels roll, None without the factor.
    ground: keyframes far from any fix with a height, and the nearest height, m.
    unsampled: intervals without inertial samples.
    wheel_speed: readings of a wheel's speed, far enough apart to be independent.
    """

    t: Array
    position_n: Array
    velocity_n: Array
    position_scale: Array
    velocity_scale: Array
    still: IntArray
    speed: Array | None = None
    rejected: BoolArray | None = None
    heading: Heading | None = None
    rolls: BoolArray | None = None
    ground: tuple[IntArray, Array] | None = None
    unsampled: Unsampled | None = None
    wheel_speed: WheelSpeed | None = None

    def of(self, fixes: BoolArray) -> "Measurements":
        """With some of the fixes (N,) alone."""
        names = ("t", "position_n", "velocity_n", "position_scale", "velocity_scale")
        parts: dict[str, Any] = {name: getattr(self, name)[fixes] for name in names}
        parts |= {
            name: None if (whole := getattr(self, name)) is None else whole[fixes] for name in ("speed", "rejected")
        }
        return replace(self, **parts)

    def are_between(self, t: Array, first: int, last: int) -> BoolArray:
        """Mask (N,) of the fixes between the keyframes first to last, exclusive, at any possible latency.

        t (K,) s: of the keyframes.
        """
        return are_inside(self.t, t[first:last])

    def between(self, t: Array, first: int, last: int) -> "Measurements":
        """Of the keyframes first to last, exclusive, of t (K,) s.

        Without heading and wheels, which join where attitudes are known.
        """
        ground, wheel = self.ground, self.wheel_speed
        if ground is not None:
            inside = (ground[0] >= first) & (ground[0] < last - 1)
            ground = (ground[0][inside] - first, ground[1][inside]) if np.any(inside) else None
        return replace(
            self.of(self.are_between(t, first, last)),
            still=self.still[(self.still >= first) & (self.still < last - 1)] - first,
            unsampled=None if self.unsampled is None else self.unsampled.between(first, last),
            heading=None,
            rolls=None,
            ground=ground,
            wheel_speed=None if wheel is None else readings_inside(wheel, t[first:last]),
        )


def are_inside(stamps: Array, t: Array) -> BoolArray:
    """Mask (N,) of the stamps (N,) s between keyframes at t (K,) s, at any possible latency."""
    return np.asarray((stamps > t[0] + MAX_LATENCY) & (stamps < t[-1]))


def readings_inside(wheel: WheelSpeed, t: Array) -> WheelSpeed:
    """Return the readings between keyframes at t (K,) s."""
    inside = are_inside(wheel.t, t)
    return WheelSpeed(wheel.t[inside], wheel.speed[inside])


@dataclass(frozen=True, eq=False)
class Priors:
    """Prior knowledge: accel_bias m/s^2 and gyro_bias rad/s, sigmas of the first biases, about zero and
    gyro_bias_mean (3,); constants: mean and sigma by name; held_s (3,): direction of the lever arm that is held at its
    mean. has_height: some fix has a height. drives: the kart drove fast enough to identify the constants.
    """

    accel_bias: float
    gyro_bias: float
    gyro_bias_mean: Array
    constants: dict[str, tuple[Array, Array]]
    held_s: Array | None = None
    has_height: bool = True
    drives: bool = True


HELD = 1e-4  # m, sigma of a held value
ABSENT = 1e-5  # m from interval to interval, sigma of a slow error that is left out


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of a factor: measurements, noise, priors, a state and the low-passed motion along it."""

    measured: Measurements
    noise: Noise
    priors: Priors
    state: State
    motion: LowPassedMotion


@dataclass(frozen=True)
class Factor:
    """A line of the table: its rows for given inputs, and whether its loss is robust.

    left_out: sigma of all rows where the factor is left out. A measurement then has no weight; a process, the only
    factor of an unknown, holds it at zero. usual: initial sigma of its rows, which have the name of the factor; it
    is identified from the residuals (Noise.sigmas). units: those of rows whose residuals are reported, by their names.
    """

    name: str
    rows: Callable[[Inputs], Iterable[Rows]]
    is_robust: bool = False
    left_out: float = np.inf
    usual: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def as_left_out(self) -> "Factor":
        """The factor with the sigma that it has where it is left out."""
        return replace(self, rows=lambda x: (with_sigma(rows, self.left_out) for rows in self.rows(x)))


def _position(x: Inputs) -> Iterable[Rows]:
    m = x.measured
    sigma = m.position_scale[:, None] * x.noise.position
    usual = float(x.priors.constants["position_latency"][0][0])
    position_n = m.position_n if m.rejected is None else np.where(m.rejected[:, None], np.nan, m.position_n)
    yield position_rows(x.state, x.motion, m.t, position_n, sigma, usual)


def _velocity(x: Inputs) -> Iterable[Rows]:
    m = x.measured
    sigma = m.velocity_scale[:, None] * x.noise.velocity
    yield velocity_rows(x.state, x.motion, m.t, m.velocity_n, sigma, m.speed)


def _offset(x: Inputs) -> Iterable[Rows]:
    yield offset_start_rows(x.state, x.noise.offset_sigma)
    yield offset_rows(x.state, x.noise.offset_sigma, x.noise.offset_tau)


def _heading(x: Inputs) -> Iterable[Rows]:
    h = x.measured.heading
    if h is not None:
        yield heading_rows(x.state, h.interval, h.field_s, h.field_yaw, h.sigma, h.has_offset)


def _wheels(x: Inputs) -> Iterable[Rows]:
    if x.measured.rolls is not None and x.noise.slip is not None:
        yield from slip_rows(slip_of(x.state, x.motion), x.measured.rolls, x.noise.slip, x.state.interval)


def _wheel_speed(x: Inputs) -> Iterable[Rows]:
    wheel = x.measured.wheel_speed
    if wheel is not None:
        sigma = x.noise.sigmas.get("wheel_speed", USUAL_WHEEL_SPEED)
        yield wheel_speed_rows(x.state, x.motion, wheel.t, wheel.speed, sigma)


def _standstill(x: Inputs) -> Iterable[Rows]:
    if len(x.measured.still):
        yield standstill_rows(x.state, x.measured.still)


def _ground(x: Inputs) -> Iterable[Rows]:
    if x.measured.ground is not None:
        yield ground_rows(x.state, *x.measured.ground)


def _motion_prior(x: Inputs) -> Iterable[Rows]:
    if x.measured.unsampled is not None and len(x.measured.unsampled.at):
        walks = x.noise.inertial
        yield motion_prior_rows(x.state, x.measured.unsampled, walks.accel_bias_walk, walks.gyro_bias_walk)


TABLE = (
    Factor("motion_prior", _motion_prior),
    Factor("gps_position", _position, is_robust=True, units={"gps_position": "m"}),
    Factor("gps_velocity", _velocity, is_robust=True, units={"gps_velocity": "m/s"}),
    Factor("gps_offset", _offset, left_out=ABSENT),
    Factor("heading", _heading, units={"heading": "rad"}),
    Factor("wheels", _wheels, is_robust=True, units={"slip": "rad"}),
    Factor("standstill", _standstill, units={"standstill": "m/s, rad"}),
    Factor("ground", _ground),
    Factor("wheel_speed", _wheel_speed, is_robust=True, usual=USUAL_WHEEL_SPEED, units={"wheel_speed": "m/s"}),
)


def table_without(names: Collection[str]) -> tuple[Factor, ...]:
    """The table with some factors left out. Raises UsageError for an unknown name."""
    known = [factor.name for factor in TABLE]
    for name in sorted(set(names) - set(known)):
        raise UsageError(f"no factor is called {name!r}; there are {', '.join(known)}")
    return tuple(factor.as_left_out() if factor.name in names else factor for factor in TABLE)


@dataclass(frozen=True, eq=False)
class Graph:
    """The graph of a session for one noise: GTSAM's own factors, of the samples of the intervals `sampled` in `imu`,
    priors in `prior`, and all others by :meth:`rows`. state: times and geometry.
    """

    imu: gtsam.NonlinearFactorGraph
    prior: gtsam.NonlinearFactorGraph
    sampled: IntArray
    preintegrated: list[gtsam.PreintegratedCombinedMeasurements]
    measured: Measurements
    noise: Noise
    priors: Priors
    state: State
    table: tuple[Factor, ...] = TABLE

    def prior_variances(self) -> Array:
        """Variances (C,) of the priors of all constants."""
        return np.concatenate([_prior_sigma(c.name, self.priors, self.noise) ** 2 for c in CONSTANTS])

    def rows(self, state: State) -> list[Rows]:
        """All rows of the table, linearised at `state`, with robust weights."""
        motion = LowPassedMotion(state, self.noise.inertial.accel, self.noise.inertial.gyro)
        inputs = Inputs(self.measured, self.noise, self.priors, state, motion)
        return [robust(r) if f.is_robust else r for f in self.table for r in f.rows(inputs) if len(r.interval)]


def build_graph(
    binned: BinnedImu,
    measured: Measurements,
    noise: Noise,
    priors: Priors,
    state: State,
    table: tuple[Factor, ...] = TABLE,
) -> Graph:
    """Return the graph of a session or of a part of it: IMU samples preintegrated about the mean biases of `state`."""
    biases = state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)
    preintegrated = preintegrate(binned, noise.inertial, *biases)
    sampled = np.arange(len(state.t) - 1)
    if measured.unsampled is not None:
        sampled = np.delete(sampled, measured.unsampled.at)
    imu, prior = imu_factors(preintegrated, sampled), _prior_factors(priors, noise, state)
    return Graph(imu, prior, sampled, preintegrated, measured, noise, priors, state, table)


def with_same_samples(graph: Graph, measured: Measurements, noise: Noise, priors: Priors, state: State) -> Graph:
    """Return the graph for other measurements, noise of them and priors; the samples keep their noise."""
    noise = replace(noise, inertial=graph.noise.inertial)
    prior = _prior_factors(priors, noise, state)
    return replace(graph, measured=measured, noise=noise, priors=priors, prior=prior, state=state)


def _prior_factors(priors: Priors, noise: Noise, state: State) -> gtsam.NonlinearFactorGraph:
    graph, pose = gtsam.NonlinearFactorGraph(), gtsam.Pose3(gtsam.Rot3(state.R_ns[0]), state.position_n[0])
    graph.add(gtsam.PriorFactorPose3(X(0), pose, _diagonal(ANYWHERE)))
    graph.add(gtsam.PriorFactorVector(V(0), state.velocity_n[0], _diagonal(np.full(3, ANY_SPEED))))
    bias = gtsam.imuBias.ConstantBias(np.zeros(3), priors.gyro_bias_mean)
    sigma = np.repeat([priors.accel_bias, priors.gyro_bias], 3)
    graph.add(gtsam.PriorFactorConstantBias(B(0), bias, _diagonal(sigma)))
    for constant in CONSTANTS:
        mean = priors.constants[constant.name][0]
        information = np.diag(1.0 / np.square(_prior_sigma(constant.name, priors, noise)))
        if constant.name == "lever_arm" and priors.held_s is not None:
            information += np.outer(priors.held_s, priors.held_s) / HELD**2
        known = gtsam.noiseModel.Gaussian.Information(information)
        graph.add(gtsam.PriorFactorVector(KEYS[constant.name], mean, known))
    return graph


def _prior_sigma(name: str, priors: Priors, noise: Noise) -> Array:
    sigma = priors.constants[name][1]
    return np.asarray(np.minimum(sigma, noise.constants.get(name, np.inf)))  # held constants stay held


def _diagonal(sigma: Array) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigma, dtype=np.float64))
