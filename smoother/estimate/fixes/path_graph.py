"""The linear graph of a path through fixes: nodes that move by white jerk, the fixes, and their slow errors.

A node has 13 unknowns in n: position, velocity, acceleration, and two slow errors of the fixes, Gauss-Markov processes:
an offset (fix = position + offset) and a change of their latency, s (a fix stamped t was true at t - latency). The
constants of a session are the lag of Doppler velocity behind position and Doppler's bias. All of it is rows as in the
graph of a session (factors/rows.py), which GTSAM eliminates.
"""

from dataclasses import dataclass, replace
from math import factorial

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.factors.gaussian import columns_of
from smoother.estimate.factors.rows import Rows, along_direction, rows_of, speeds_alone
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE
from smoother.estimate.solvers.batch import solve_rows
from smoother.estimate.solvers.covariance import Chain, Covariances

NODE_SIZE = 13
POSITION, VELOCITY, ACCELERATION, OFFSET = (slice(3 * i, 3 * i + 3) for i in range(4))
LATENCY, SLOW = slice(12, 13), slice(9, 13)
MOTION = np.stack([[axis, 3 + axis, 6 + axis] for axis in range(3)])  # columns of each axis
LAG, BIAS = "velocity_latency", "doppler_bias"  # names of the constants among those of a session
KINDS = ("position", "height", "velocity", "climb")  # of measurements; each has a noise of its own
LEVEL, UP = slice(0, 2), slice(2, 3)
ORDER = 3  # position, velocity, acceleration
TERMS = 26  # of the power series, which hold to 1e-9 for steps up to 0.6 s
# 1/s, 1/s^2: where the series hold and the chain stays well conditioned
DECAYS, STIFFNESSES = (0.3, 5.0), (0.01, 6.0)
NANOSECOND_DIGITS = 9


# Motion along one axis: white jerk over tenths of a second. Over seconds acceleration and velocity return to zero, as
# on a closed track, so that gaps stay bounded.


@dataclass(frozen=True)
class WhiteJerk:
    """Stationary velocity process `v'' + decay v' + stiffness v = white jerk` of one axis.

    density m/s^3/sqrt(Hz); velocity m/s and acceleration m/s^2, the stationary standard deviations: var(a) =
    S / (2 decay) and var(v) = var(a) / stiffness, with S the squared density (harmonic oscillator in white noise, e.g.
    Särkkä & Solin 2019, 4.3 and 6.2).
    """

    density: float
    velocity: float
    acceleration: float

    def discrete(self, dt: Array) -> tuple[Array, Array]:
        """Transition of the state over steps dt (K,) s, and its covariance from a known state, (K, 3, 3) each.

        Both come out of one matrix exponential. Source: Van Loan 1978.
        """
        decay = float(np.clip(0.5 * (self.density / self.acceleration) ** 2, *DECAYS))
        stiffness = float(np.clip((self.acceleration / self.velocity) ** 2, *STIFFNESSES))
        rates = np.zeros((2 * ORDER, 2 * ORDER))
        rates[ORDER:, ORDER:] = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -stiffness, -decay]]).T
        rates[:ORDER, :ORDER] = -rates[ORDER:, ORDER:].T
        rates[2, 5] = self.density**2
        terms, power = [], np.eye(2 * ORDER)
        for k in range(TERMS):
            terms.append(power / factorial(k))
            power = power @ rates
        series = np.vander(dt, TERMS, increasing=True) @ np.reshape(terms, (TERMS, -1))
        both = series.reshape(-1, 2 * ORDER, 2 * ORDER)
        transition = both[:, ORDER:, ORDER:].transpose(0, 2, 1)
        return transition, np.asarray(transition @ both[:, :ORDER, ORDER:])

    def whitened(self, dt: Array) -> tuple[Array, Array]:
        """Transition (K, 3, 3) and root W (K, 3, 3) of its information, W'W, taken at the scale of each step, because
        the covariance spans dt^5 to dt.
        """
        some, which = np.unique(np.round(dt, NANOSECOND_DIGITS), return_inverse=True)  # receivers are punctual
        transition, covariance = self.discrete(some)
        scale = some[:, None] ** np.array([-2.5, -1.5, -0.5])
        root: Array = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance * scale[:, :, None] * scale[:, None, :])))
        return transition[which], (root * scale[:, None, :])[which]


def quintic_basis(fraction: Array, step: Array, components: tuple[int, ...] = (0, 1, 2)) -> tuple[Array, Array]:
    """Weights of the states at both ends of an interval for what lies between: the conditional mean of white jerk.

    fraction (N,) 0..1 of the interval, step (N,) s; components of what is wanted, n of position, velocity and
    acceleration. Returns two (N, n, 3), [i, j] the weight of component j of the left and of the right end.
    Source: quintic Hermite interpolation; Barfoot, State Estimation for Robotics, 2nd ed., 11.1.4 (white jerk).
    """
    left, right = np.zeros((ORDER, ORDER, 6)), np.zeros((ORDER, ORDER, 6))
    left[0] = np.array([[1.0, 0, 0, -10, 15, -6], [0, 1, 0, -6, 8, -3], [0, 0, 0.5, -1.5, 1.5, -0.5]])
    right[0] = np.array([[0.0, 0, 0, 10, -15, 6], [0, 0, 0, -4, 7, -3], [0, 0, 0, 0.5, -1, 0.5]])
    for coefficients in (left, right):
        for i in (1, 2):
            coefficients[i, :, :-1] = coefficients[i - 1, :, 1:] * np.arange(1, 6)
    wanted = np.asarray(components)
    exponent = np.arange(ORDER)[None, :] - wanted[:, None]
    unit = np.where(step > 0.0, step, 1.0)[:, None, None] ** exponent
    powers = np.vander(fraction, 6, increasing=True)
    shape = (fraction.size, wanted.size, ORDER)
    return tuple((powers @ c[wanted].reshape(-1, 6).T).reshape(shape) * unit for c in (left, right))


@dataclass(frozen=True, eq=False)
class Nodes:
    """Values of all unknowns: t (K,) s, x (K, 13), lag s, bias (3,) m/s."""

    t: Array
    x: Array
    lag: float
    bias: Array

    def without_latency_change(self, t: Array) -> Array:
        """Times (N,) s at which the positions of times t (N,) s were true if the latency changes as in the nodes."""
        changed = np.maximum.accumulate(self.t + self.x[:, LATENCY.start])
        return np.interp(t, changed, self.t)


@dataclass(frozen=True, eq=False)
class PathPrior:
    """Everything assumed about the unknowns: motion (level, up), slow errors, the start, the constants.

    slow_sigma (4,) of the slow errors: offset per axis, m, and latency, s; slow_tau (4,) s; start_sigma (3,) m about
    start (3,) m; lag s: mean and sigma; bias_sigma m/s, about zero. A sigma of zero: it is known.
    """

    motion: tuple[WhiteJerk, WhiteJerk]
    slow_sigma: Array
    slow_tau: Array
    start: Array
    start_sigma: Array
    lag: tuple[float, float]
    bias_sigma: float

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the constants that are solved for."""
        sigmas = {LAG: self.lag[1], BIAS: self.bias_sigma}
        return tuple(name for name, sigma in sigmas.items() if sigma > 0.0)


@dataclass(frozen=True, eq=False)
class Measured:
    """M fixes: true_t (M,) s, when their positions were true; position_n, velocity_n (M, 3), NaN where unknown; speed
    (M,) m/s, which counts where no velocity is known.
    """

    true_t: Array
    position_n: Array
    velocity_n: Array
    speed: Array | None = None


@dataclass(frozen=True, eq=False)
class Solution:
    """Unknowns after a step, and covariances."""

    nodes: Nodes
    lag_sigma: float
    bias_sigma: Array
    covariances: Covariances


def solve(nodes: Nodes, fixes: list[Rows], prior: list[Rows], unknown: tuple[str, ...]) -> Solution:
    """One step from `nodes`, at which all rows are linearised. Raises IndeterminateError for unusable numbers."""
    moved, constants, net = solve_rows([*prior, *fixes], len(nodes.t), unknown)
    covariances = Chain.of(net, columns_of(unknown), np.zeros(CONSTANTS_SIZE)).covariances()
    sigma = np.sqrt(np.diag(covariances.constants))
    after = replace(
        nodes,
        x=nodes.x + moved,
        lag=nodes.lag + float(constants[COLUMNS[LAG]][0]),
        bias=nodes.bias + constants[COLUMNS[BIAS]],
    )
    return Solution(after, float(sigma[COLUMNS[LAG]][0]), sigma[COLUMNS[BIAS]], covariances)


def fix_rows(nodes: Nodes, fixes: Measured) -> list[Rows]:
    """Rows of each of KINDS, (M, 2) or (M, 1), with a sigma of 1 where measured, linearised at `nodes`.

    Positions are true at true_t, velocities the lag earlier.
    """
    then = nodes.without_latency_change(fixes.true_t)
    x, k, left, right = _between(nodes, then, 0)
    p = _value(x, k, left, right)
    step = (nodes.t[k + 1] - nodes.t[k])[:, None]
    rate = _value(*_between(nodes, then, 1)) + (x[k + 1, OFFSET] - x[k, OFFSET]) / step
    by_latency = -rate / (1.0 + (x[k + 1, LATENCY] - x[k, LATENCY]) / step)
    share = np.clip((then[:, None] - nodes.t[k, None]) / step, 0.0, 1.0)
    left[:, :, LATENCY.start], right[:, :, LATENCY.start] = (1.0 - share) * by_latency, share * by_latency
    v_rows = _between(nodes, fixes.true_t - nodes.lag, 1)
    v, a = _value(*v_rows), _value(*_between(nodes, fixes.true_t - nodes.lag, 2))
    only = speeds_alone(fixes.velocity_n, fixes.speed)
    velocity_n = np.where(only[:, None] * np.array([1.0, 1.0, 0.0]) > 0.0, 0.0, fixes.velocity_n)
    out = []
    for name, axes, residual, (_, at, by_left, by_right) in (
        ("position", LEVEL, p - fixes.position_n, (x, k, left, right)),
        ("height", UP, p - fixes.position_n, (x, k, left, right)),
        ("velocity", LEVEL, v + nodes.bias - velocity_n, v_rows),
        ("climb", UP, v + nodes.bias - velocity_n, v_rows),
    ):
        constants = {}
        if by_left is v_rows[2]:
            bias = np.broadcast_to(np.eye(3)[axes], (len(at), len(residual[0, axes]), 3))
            constants = {LAG: -a[:, axes, None], BIAS: bias}
        rows = rows_of(name, at, residual[:, axes], 1.0, by_left[:, axes], by_right[:, axes], constants)
        if name == "velocity" and fixes.speed is not None:
            rows = along_direction(rows, only, fixes.speed)
        out.append(rows)
    return out


def _between(nodes: Nodes, t: Array, component: int) -> tuple[Array, IntArray, Array, Array]:
    """Position with offset, velocity or acceleration (component 0, 1, 2) at t (N,) s: nodes, interval and Jacobians."""
    k = np.clip(np.searchsorted(nodes.t, t, side="right") - 1, 0, len(nodes.t) - 2).astype(np.int64)
    step = nodes.t[k + 1] - nodes.t[k]
    fraction = np.clip((t - nodes.t[k]) / step, 0.0, 1.0)
    sides = [np.zeros((len(t), 3, NODE_SIZE)) for _ in range(2)]
    bases = quintic_basis(fraction, step, (component,))
    for side, basis, share in zip(sides, bases, (1.0 - fraction, fraction), strict=True):
        for axis in range(3):
            side[:, axis, MOTION[axis]] = basis[:, 0]
            if component == 0:
                side[:, axis, OFFSET.start + axis] = share
    return nodes.x, k, sides[0], sides[1]


def _value(x: Array, k: IntArray, left: Array, right: Array) -> Array:
    return np.asarray(np.einsum("nai,ni->na", left, x[k]) + np.einsum("nai,ni->na", right, x[k + 1]))


def prior_rows(nodes: Nodes, prior: PathPrior) -> list[Rows]:
    """Rows of the motion ("jerk_level" (K-1, 6), "jerk_up" (K-1, 3)), slow errors (K-1, 4), start and constants."""
    x, dt, every = nodes.x, np.diff(nodes.t), np.arange(len(nodes.t) - 1, dtype=np.int64)
    out = []
    for name, motion, axes in (("jerk_level", prior.motion[0], (0, 1)), ("jerk_up", prior.motion[1], (2,))):
        transition, root = motion.whitened(dt)
        back = root @ transition
        left, right = np.zeros((2, len(dt), 3 * len(axes), NODE_SIZE))
        for i, axis in enumerate(axes):
            own = slice(3 * i, 3 * i + 3)
            left[:, own, MOTION[axis]], right[:, own, MOTION[axis]] = -back, root
        residual = _value(x, every, left, right)
        out.append(rows_of(name, every, residual, 1.0, left, right))
    keep = np.exp(-dt[:, None] / prior.slow_tau)
    left, right = np.zeros((2, len(dt), 4, NODE_SIZE))
    left[:, :, SLOW], right[:, :, SLOW] = -keep[:, :, None] * np.eye(4), np.eye(4)
    driven = x[1:, SLOW] - keep * x[:-1, SLOW]
    sigma = np.sqrt(-np.expm1(-2.0 * dt[:, None] / prior.slow_tau)) * prior.slow_sigma
    out.append(rows_of("slow_errors", every, driven, sigma, left, right))
    usual = [(m.velocity, m.acceleration) for m in (prior.motion[0], *prior.motion)]
    sigma = np.concatenate([prior.start_sigma, *np.transpose(usual), prior.slow_sigma])
    start = x[0] - np.concatenate([prior.start, np.zeros(NODE_SIZE - 3)])
    first, none = np.zeros(1, np.int64), np.zeros((1, NODE_SIZE, NODE_SIZE))
    out.append(rows_of("start", first, start[None], sigma, np.eye(NODE_SIZE)[None], none))
    constants = {LAG: np.eye(4)[None, :, :1], BIAS: np.eye(4)[None, :, 1:]}
    known = np.concatenate([[nodes.lag - prior.lag[0]], nodes.bias])[None]
    sigma = np.array([prior.lag[1] or np.inf, *[prior.bias_sigma or np.inf] * 3])
    none = np.zeros((1, 4, NODE_SIZE))
    out.append(rows_of("constants", first, known, sigma, none, none, constants))
    return out
