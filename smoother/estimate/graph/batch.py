"""Batch solution of the graph: Gauss-Newton with robust weights, for noise that is given.

GTSAM preintegrates the inertial samples; increments.py and rows.py linearise; chain.py solves the whole chain and
returns the covariance of every keyframe in the same sweep. How noisy the session is, components.py tells by what is
left of such a solution; solve.py takes turns between the two.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, are_near
from smoother.estimate.graph import rows as rw
from smoother.estimate.graph.chain import ChainSolution, ChainSystem, moved_on, solve_chain
from smoother.estimate.graph.expected import DRIVEN_BELOW, DopplerNoise, ExpectedMotion, expected_motion, shown_below
from smoother.estimate.graph.heading import Heading
from smoother.estimate.graph.imu import BinnedImu, DensePath, are_told, corrected, dense_path
from smoother.estimate.graph.inertial import (
    InertialGraph,
    LinearInertial,
    add_inertial,
    empty_system,
    set_apart,
)
from smoother.estimate.graph.inertial_noise import InertialNoise
from smoother.estimate.graph.relaxation import Relaxation
from smoother.estimate.graph.response import low_pass_share
from smoother.estimate.graph.sampled import are_unsampled
from smoother.estimate.graph.slip import (
    Slip,
    SlipNoise,
    is_of_wheels,
    not_doubted_by,
    slip_noise,
    slip_of,
    slip_rows,
)
from smoother.estimate.graph.state import (
    ACCEL_BIAS,
    ACCEL_ERROR,
    CONSTANTS_SIZE,
    GYRO_BIAS,
    GYRO_ERROR,
    LEVER_ARM,
    POSITION_LATENCY,
    RECTIFICATION,
    ROTATION,
    SLIP,
    TRANSLATION,
    VELOCITY,
    VELOCITY_RESPONSE,
    ChainState,
)
from smoother.estimate.graph.upright import along_path_rows, unsteadiness, upright_rows
from smoother.estimate.pauses import NO_PAUSES, Pauses

# A residual beyond this loses weight as (limit / distance)^2: redescending. Of two components the distance is that in
# sigmas; of other numbers it is sqrt(2) times the rms of the components, so that one beyond 2.1 sigma loses weight, and
# three beyond 3.7.
ROBUST_LIMIT = 3.0
CONVERGED = ((ROTATION, 5e-4), (TRANSLATION, 5e-3), (VELOCITY, 5e-3))  # rad, m, m/s: far below any sigma
SENSOR_ERRORS = (ACCEL_ERROR, GYRO_ERROR, RECTIFICATION)
ANYWHERE = np.repeat([3.0, 1e4, 1e3], 3)  # rad, m, m/s: sigmas of motion of which nothing is known
APART = np.repeat([3.0, 1e3, 1e2], 3)  # likewise, beside where the path of the fixes puts a keyframe
LEVELS_SIZE = 11  # densities of force and rate; sigmas of position, velocity and offset per axis
HELD = 1e-4  # m; what is held does not move by a digit
STILL_SPEED = 0.02  # m/s; a chassis on its tyres with the engine idling
STILL_TURN = 3e-4  # rad between keyframes, likewise
# m/sqrt(Hz): what level ground is worth, a height to 2 m in a second. Much less than tracks are level to, since heights
# are near one another for seconds: with this, what is said of climbing holds on tracks that rise by 3.5 m.
LEVEL_GROUND = 2.0
NEAR_FIX = 1.0  # s; beyond, a direction of the path is what the samples add up to
FAR_FROM_HEIGHT = 20.0  # s; for so long the samples alone carry a height
HEIGHTS_AROUND = np.arange(-2, 3)  # whose median is the nearest height: one of them may be wild


@dataclass(frozen=True, eq=False)
class Noise:
    """Everything the graph assumes about noise. Sigmas per axis of n (3,): m for positions, m/s for velocities.

    offset_sigma (3,) m and offset_tau s describe the Gauss-Markov error of the fixes; sensor_error (3,) is the spread
    of the entries of accel_error and gyro_error, scale and misalignment, and of rectification, m/s^2.
    slip is that of the wheels, None where they are not asked.
    offset_tau_spread is the sigma of offset_tau's logarithm where the session tells it, infinite where it is the
    population's. offset_most (3,) m is what offset_sigma may be found to be: of a receiver that fixes carrier phases.
    velocity is what is white of velocities; where errors last, level ones count with `counted` times that (lasting.py).
    """

    inertial: InertialNoise
    position: Array
    velocity: Array
    offset_sigma: Array
    offset_tau: float
    sensor_error: Array
    offset_tau_spread: float = math.inf
    slip: SlipNoise | None = None
    offset_most: Array = field(default_factory=lambda: np.full(3, np.inf))
    counted: float = 1.0

    @property
    def of_velocities(self) -> Array:
        """Sigma (3,) m/s with which a velocity counts."""
        return np.asarray(self.velocity * [self.counted, self.counted, 1.0])

    def change(self, other: "Noise") -> float:
        """Largest relative difference of any sigma or mean density to those of `other`.

        What of the densities goes with vibration takes turns more to come to rest than they do, and moves nothing.
        """
        return float(np.max(np.abs(self.step_from(other))))

    def step_from(self, other: "Noise") -> Array:
        """Steps (LEVELS_SIZE,) of the logarithms of densities and sigmas since `other`."""
        return np.asarray(np.log(self._levels() / other._levels()))

    def moved_by(self, step: Array) -> "Noise":
        """The noise with densities and sigmas of which the logarithms are greater by step (LEVELS_SIZE,)."""
        levels = self._levels() * np.exp(step)
        return replace(
            self,
            inertial=replace(self.inertial, accel=float(levels[0]), gyro=float(levels[1])),
            position=levels[2:5],
            velocity=levels[5:8],
            offset_sigma=levels[8:],
        )

    def _levels(self) -> Array:
        return np.concatenate(
            [[self.inertial.accel, self.inertial.gyro], self.position, self.velocity, self.offset_sigma]
        )


@dataclass(frozen=True, eq=False)
class Priors:
    """What is known beforehand: sigmas of the biases, m/s^2 and rad/s, mean (3,) of the gyro's; constants (30,).

    holds_height: the lever arm's height stays at its mean. A kart leans by few degrees, and how far is hardly better
    known than that: a height fitted to it is drawn to zero and seems to be known. has_height: some fix has a height.
    drives: the kart went at a speed that tells the constants; what they fit at rest is noise, and its covariance too.
    """

    accel_bias: float
    gyro_bias: float
    gyro_bias_mean: Array
    constants: Array
    constants_sigma: Array
    holds_height: bool = False
    has_height: bool = True
    drives: bool = True


@dataclass(frozen=True, eq=False)
class Data:
    """Measurements on the IMU clock. t (N,) stamps of the fixes; position_n, velocity_n (N, 3), NaN where unknown.

    position_scale, velocity_scale (N,) multiply the session's sigmas; still (S,) intervals at rest. doubted (N,): fixes
    whose positions have no weight, whatever their residuals; None where there are none. heights (H, 2): time s and up
    in n, m, of all fixes of the session that have a height; None asks nothing of the ground. sampled (S, 2) s: spans
    that all samples are in, and all fixes, between which nothing is said of the motion; None bridges what is missing.
    pauses: time that is cut out between some of them, for which the biases walk on. lasting m/s: sigma of what lasts of
    the errors of velocities.
    """

    t: Array
    position_n: Array
    velocity_n: Array
    position_scale: Array
    velocity_scale: Array
    still: np.ndarray
    heading: Heading | None = None
    doubted: BoolArray | None = None
    heights: Array | None = None
    sampled: Array | None = None
    pauses: Pauses = NO_PAUSES
    lasting: float = 0.0


@dataclass(frozen=True, eq=False)
class Solved:
    """A linearised, solved graph at `state`: the state itself, its covariances and the rows they came from.

    Residuals of rows are those after the step, those of inertial and slip before it: only some are asked for.
    """

    state: ChainState
    solution: ChainSolution
    inertial: LinearInertial
    rows: dict[str, rw.Rows]
    slip: Slip | None = None


@dataclass(frozen=True, eq=False)
class DrivenMotion:
    """The dense path of a state, and the motion expected along it."""

    path: DensePath
    felt: ExpectedMotion


@dataclass(frozen=True, eq=False)
class Linear:
    """A graph linearised at `state`, not solved: its normal equations, and what they came from."""

    state: ChainState
    system: ChainSystem
    inertial: LinearInertial
    rows: dict[str, rw.Rows]
    slip: Slip | None


class Batch:
    """One session's graph. Data and inertial bins are fixed; states and noise go in and come out."""

    def __init__(self, data: Data, binned: BinnedImu, priors: Priors) -> None:
        self._data = data
        self._binned = binned
        self._priors = priors
        self._told = are_told(binned.missing)

    def graph(self, state: ChainState, noise: Noise) -> InertialGraph:
        """Preintegrate the inertial samples about the mean biases and the sensor errors of `state`."""
        biases = state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)
        return InertialGraph(self.bins(state), noise.inertial, *biases, state.constants)

    def bins(self, state: ChainState) -> BinnedImu:
        """Inertial bins with the state's errors of scale and misalignment and rectified vibration taken out."""
        return corrected(self._binned, state.constants)

    def converge(self, graph: InertialGraph, state: ChainState, noise: Noise, iterations: int) -> ChainState:
        """Gauss-Newton from `state`, at most `iterations` steps, shortened where the constants swing."""
        relaxation = Relaxation()
        for _ in range(iterations):
            state, step = self.move(graph, state, noise, relaxation)
            if converged(step.x):
                break
        return state

    def approach(
        self, graph: InertialGraph, state: ChainState, noise: Noise, near: float, iterations: int
    ) -> ChainState:
        """Gauss-Newton of the keyframes alone, the constants held, until attitudes move by less than `near` rad, rms.

        At most `iterations`. While attitudes are off by degrees, steps of the constants lead astray, and coming back
        takes more steps. With wheels, `state` was found without.
        """
        for i in range(iterations):
            linear = self.linear(graph, state, noise, was_without_wheels=i == 0)
            step = solve_chain(_of_keyframes(linear.system), with_covariance=False)
            state = state.retract(step.x, np.zeros(CONSTANTS_SIZE))
            if math.sqrt(float(np.mean(np.sum(step.x[:, ROTATION] ** 2, axis=1)))) < near:
                break
        return state

    def step(
        self,
        graph: InertialGraph,
        state: ChainState,
        noise: Noise,
        relaxation: Relaxation | None = None,
        held: Array | None = None,
        free: slice | None = None,
        *,
        was_without_wheels: bool = False,
    ) -> Solved:
        """One Gauss-Newton step with its covariance; residuals as :class:`Solved` says.

        relaxation: what the steps before tell of how far to go; None goes all the way.
        held (30, 30) is the covariance of constants that are to stay where they are, all but those that are free.
        was_without_wheels: `state` was found without wheels, which `noise` asks for.
        """
        linear = self.linear(graph, state, noise, was_without_wheels=was_without_wheels)
        solution = solve_chain(linear.system, held=held, free=free)
        return _solved(linear, solution, 1.0 if relaxation is None else relaxation.share(solution))

    def move(
        self, graph: InertialGraph, state: ChainState, noise: Noise, relaxation: Relaxation
    ) -> tuple[ChainState, ChainSolution]:
        """Like :meth:`step`, without a covariance but that of the constants: the state, and the whole step."""
        solution = solve_chain(self.linear(graph, state, noise).system, with_covariance=False)
        share = relaxation.share(solution)
        return state.retract(share * solution.x, share * solution.constants), solution

    def path(self, state: ChainState) -> DensePath:
        """Dense path through the keyframes of `state`."""
        return dense_path(
            self.bins(state), state.R_ns, state.position_n, state.velocity_n, state.accel_bias_s, state.gyro_bias_s
        )

    def motion(self, state: ChainState, noise: Noise) -> DrivenMotion:
        """Return the dense path of `state`, and the motion expected along it."""
        path = self.path(state)
        return DrivenMotion(path, expected_of(self._data, path, state, noise))

    def with_slip(self, solved: Solved, noise: Noise, motion: DrivenMotion) -> Noise:
        """Return the noise with the slip that shows in what was solved without any; motion: that of its state."""
        slip = self._slip(solved.state, motion)
        return replace(noise, slip=slip_noise(slip, solved.solution, solved.state.interval))

    def is_of_wheels(self, state: ChainState, noise: Noise) -> bool:
        """Whether what was solved without wheels slips as the constants say."""
        if noise.slip is None:
            return False
        return is_of_wheels(self._slip(state, self.motion(state, noise)), noise.slip.unsure, state.interval)

    def roll(self, linear: Linear, motion: DrivenMotion, gone: Array, slip_noise: SlipNoise, held: Array) -> Solved:
        """Solve what was linearised without wheels once more with them. motion: that of its state.

        All constants but those of slip go on by gone (30,), as they would without wheels; held (30, 30) is their
        covariance.
        """
        slip = self._slip(linear.state, motion)
        rows = slip_rows_of(slip, linear.state.interval, slip_noise, was_without_wheels=True)
        rw.add_rows(linear.system, rows)
        solution = solve_chain(moved_on(linear.system, gone), held=held, free=SLIP)
        solution = replace(solution, constants=gone + solution.constants)
        return _solved(replace(linear, rows=linear.rows | {r.name: r for r in rows}, slip=slip), solution, 1.0)

    def _slip(self, state: ChainState, motion: DrivenMotion) -> Slip:
        return slip_of(state, motion.path, motion.felt, self._told, are_near(state.t, self._data.t, NEAR_FIX))

    def linear(
        self,
        graph: InertialGraph,
        state: ChainState,
        noise: Noise,
        motion: DrivenMotion | None = None,
        *,
        was_without_wheels: bool = False,
    ) -> Linear:
        """Linearise at `state`. motion: that of it with this noise, where it is known already.

        was_without_wheels: `state` was found without wheels, which `noise` asks for.
        """
        motion = self.motion(state, noise) if motion is None else motion
        path, felt = motion.path, motion.felt
        inertial = graph.linearize(state, noise.inertial, felt.means(self._binned.n_bins))
        if self._data.sampled is not None:
            apart = are_unsampled(self._data.sampled, state.t[:-1], state.t[1:])
            duration = state.interval + self._data.pauses.between(state.t)
            set_apart(inertial, apart, state, noise.inertial, APART, duration)
        rows = {r.name: r for r in session_rows(self._data, self._priors, path, felt, state, noise)}
        slip, share = None, unsteady_share(state, noise)
        if noise.slip is not None or share > 0.0:
            slip = self._slip(state, motion)
        if slip is not None and share > 0.0:
            asked = [upright_rows(state, slip, share)]
            if noise.slip is None:  # which asks for more of the slip
                asked.append(along_path_rows(state, slip, share))
            rows.update({r.name: _robust(r) for r in asked if len(r.interval)})
        if slip is not None and noise.slip is not None:
            of_slip = slip_rows_of(slip, state.interval, noise.slip, was_without_wheels=was_without_wheels)
            rows.update({r.name: r for r in of_slip})
        system = empty_system(len(state.t))
        add_inertial(system, inertial)
        rw.add_rows(system, list(rows.values()))
        prior = self._priors
        difference = state.constants.as_vector() - prior.constants
        rw.add_constants_prior(system, difference, _or_filters(constants_sigma(prior, noise), difference))
        if prior.holds_height:
            up_s = state.constants.level_axes_s[2]
            system.corner[LEVER_ARM, LEVER_ARM] += np.outer(up_s, up_s) / HELD**2
        return Linear(state, system, inertial, rows, slip)


def unsteady_share(state: ChainState, noise: Noise) -> float:
    """Share 0 to 1 of what is asked of attitudes where rates hardly tell them."""
    return 0.0 if state.constants.is_steered else unsteadiness(noise.inertial.gyro)


def slip_rows_of(slip: Slip, interval: float, noise: SlipNoise, *, was_without_wheels: bool) -> list[rw.Rows]:
    """Rows of the slip with robust weights; `interval` s."""
    out = []
    for r in slip_rows(slip, interval, noise.sigma):
        judged = not_doubted_by(slip, noise.unsure, r) if was_without_wheels else r
        out.append(replace(r, weight=_robust(judged).weight))
    return out


def _solved(linear: Linear, solution: ChainSolution, share: float) -> Solved:
    """Return the state after a `share` of the step, with the residuals that :class:`Solved` says."""
    return Solved(
        linear.state.retract(share * solution.x, share * solution.constants),
        solution,
        linear.inertial,
        {name: rw.after_step(r, solution.x, solution.constants) for name, r in linear.rows.items()},
        linear.slip,
    )


def doppler_noise(d: Data, noise: Noise, axis: int = 0) -> DopplerNoise | None:
    """What the session's velocities tell on an axis of n, None where there are none."""
    return DopplerNoise.of(d.t, d.velocity_n[:, axis], float(noise.of_velocities[axis]))


def expected_of(d: Data, path: DensePath, state: ChainState, noise: Noise) -> ExpectedMotion:
    """Return the most probable motion along the dense path of `state`.

    Where it is set apart nothing holds the path: it may leap, by 500 m/s^2 across a hole in an outage, and the spectrum
    of the whole session would be that of the leap. It counts as rest there; no fix is read in it.
    """
    level, up = doppler_noise(d, noise), doppler_noise(d, noise, 2)
    if d.sampled is not None:
        apart = np.repeat(are_unsampled(d.sampled, state.t[:-1], state.t[1:]), (len(path.t) - 1) // (len(state.t) - 1))
        # where samples end, the last keyframe that has some is the first one of the hole, and moves on
        inside = np.append(apart, False) & np.append(False, apart)
        path = replace(
            path,
            acceleration_n=np.where(apart[:, None], 0.0, path.acceleration_n),
            velocity_n=np.where(inside[:, None], 0.0, path.velocity_n),
        )
    c = state.constants
    return expected_motion(
        path,
        c.level_axes_s,
        noise.inertial,
        level,
        state.interval,
        up,
        is_steered=c.is_steered,
        slopes_below=DRIVEN_BELOW if c.is_steered else _shown_below(c.velocity_response),
    )


def _shown_below(response: float) -> float:
    """Frequency, Hz, of what a receiver shows late and little else, by what of its response, s^2, is a filter's."""
    share, _ = low_pass_share(response)
    return shown_below(share * response)


def session_rows(
    d: Data, prior: Priors, path: DensePath, felt: ExpectedMotion, state: ChainState, noise: Noise
) -> list[rw.Rows]:
    """Everything that is not inertial, linearised at `state`, whose dense path is `path`; fixes with robust weights.

    felt: the motion expected along the path.
    """
    position = rw.position_rows(
        state, path, felt, d.t, d.position_n, d.position_scale[:, None] * noise.position, prior.constants[0]
    )
    velocity = rw.velocity_rows(state, path, felt, d.t, d.velocity_n, d.velocity_scale[:, None] * noise.of_velocities)
    out = [
        _robust(position, d.doubted),
        _robust(velocity),
        *rw.offset_rows(state, noise.offset_sigma, noise.offset_tau),
    ]
    bias = np.concatenate([state.accel_bias_s[0], state.gyro_bias_s[0] - prior.gyro_bias_mean])
    sigma = np.repeat([prior.accel_bias, prior.gyro_bias], 3)
    out.append(rw.prior_row("bias_prior", bias, sigma, slice(ACCEL_BIAS.start, GYRO_BIAS.stop)))
    out.append(rw.prior_row("pose_prior", np.zeros(9), ANYWHERE, slice(0, 9)))
    if d.heights is not None:
        at, height = _far_from_heights(d.heights, state.t)
        if len(at):
            out.append(rw.ground_rows(state, LEVEL_GROUND / math.sqrt(state.interval), at, height))
    if len(d.still):
        out.append(rw.standstill_rows(state, d.still, STILL_SPEED, STILL_TURN))
    if d.heading is not None:
        out.append(rw.heading_rows(state, d.heading))
    return out


def _far_from_heights(heights: Array, t: Array) -> tuple[IntArray, Array]:
    """Keyframes of t (K,) s, but the last, that are far from any of the heights (H, 2), and the nearest one (n,) m.

    That of the origin where there is none at all.
    """
    if not len(heights):
        return np.arange(len(t) - 1), np.zeros(len(t) - 1)
    times = heights[:, 0]
    after = np.clip(np.searchsorted(times, t[:-1]), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    near = np.where(np.abs(times[after] - t[:-1]) < np.abs(times[before] - t[:-1]), after, before)
    far = np.flatnonzero(np.abs(times[near] - t[:-1]) > FAR_FROM_HEIGHT)
    around = np.clip(near[far, None] + HEIGHTS_AROUND, 0, len(times) - 1)
    return far, np.median(heights[around, 1], axis=1)


def converged(step: Array) -> bool:
    """Whether a step (K, 18) is too small to matter."""
    return all(float(np.max(np.abs(step[:, part]))) < limit for part, limit in CONVERGED)


def variances(solution: ChainSolution) -> Array:
    """Variances (K, 18) of the keyframes."""
    return np.asarray(np.einsum("kii->ki", solution.covariance))


def moved(solution: ChainSolution, variance: Array) -> float:
    """Root mean square of a step of attitude and velocity, each over its sigma; variance (K, 18)."""
    squares = (np.mean(solution.x[:, part] ** 2 / variance[:, part]) for part in (ROTATION, VELOCITY))
    return math.sqrt(float(max(squares)))


def constants_moved(solution: ChainSolution) -> float:
    """Root mean square of a step of latencies and lever arm, each over its sigma."""
    part = slice(POSITION_LATENCY.start, LEVER_ARM.stop)
    sigma2 = np.diag(solution.constants_covariance)[part]
    return math.sqrt(float(np.mean(solution.constants[part] ** 2 / sigma2)))


def _of_keyframes(system: ChainSystem) -> ChainSystem:
    """Return the system without the constants: they stay where they are."""
    n_keyframes, n = system.rhs.shape
    none = np.empty((n_keyframes, n, 0))
    return replace(system, border=none, corner=np.empty((0, 0)), rhs_constants=np.empty(0))


def constants_sigma(priors: Priors, noise: Noise) -> Array:
    """Prior sigma (30,) of all constants."""
    sigma = priors.constants_sigma.copy()
    for part, spread in zip(SENSOR_ERRORS, noise.sensor_error, strict=True):
        sigma[part] = spread
    return sigma


def _or_filters(sigma: Array, difference: Array) -> Array:
    """Prior sigma (30,) with that of a response which is larger than usual by `difference` (30,), beyond sigma.

    Most receivers hardly filter, some do, over any time: the prior holds as robust rows do, by one over its distance.
    """
    out = sigma.copy()
    out[VELOCITY_RESPONSE] = np.maximum(sigma, difference)[VELOCITY_RESPONSE]
    return out


def _robust(rows: rw.Rows, doubted: BoolArray | None = None) -> rw.Rows:
    finite = np.isfinite(rows.sigma)
    squared = np.where(finite, (rows.residual / np.where(finite, rows.sigma, 1.0)) ** 2, 0.0)
    dimension = np.maximum(finite.sum(axis=1), 1)
    distance = np.sqrt(squared.sum(axis=1) / dimension * 2.0)  # as if of two components
    weight = np.minimum(1.0, (ROBUST_LIMIT / np.maximum(distance, 1e-9)) ** 2)
    return replace(rows, weight=weight if doubted is None else np.where(doubted, 0.0, weight))
