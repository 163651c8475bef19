"""The inertial part of the graph: GTSAM's CombinedImuFactor over every interval, linearised into the chain."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import pieces
from smoother.estimate.graph.chain import ChainSolution, ChainSystem, inverse_of_lower
from smoother.estimate.graph.imu import BinnedImu, shaken
from smoother.estimate.graph.increments import as_expected, felt_by, in_left_axes, increments, linearize_increments
from smoother.estimate.graph.inertial_noise import InertialNoise, Shape, shared_densities
from smoother.estimate.graph.preintegration import preintegrate
from smoother.estimate.graph.state import (
    ACCEL_ERROR,
    CONSTANTS_SIZE,
    KEYFRAME_SIZE,
    RECTIFICATION,
    ROTATION,
    TRANSLATION,
    VELOCITY,
    ChainState,
    Constants,
)

_INERTIAL = slice(0, 15)
_ERRORS = slice(ACCEL_ERROR.start, RECTIFICATION.stop)
_MOTION, _MOVED, _BIASES = slice(0, 9), slice(3, 9), slice(9, 15)  # rows of rotation, position, velocity; of biases
_LEFT, _RIGHT, _BY_ERRORS = slice(0, 15), slice(15, 30), slice(30, 45)  # columns of a factor's Jacobian,
_RESIDUAL = 45  # and of its residual beside it
_WIDTH = _RESIDUAL + 1
PIECE = 128  # intervals whose matrices stay in the processor's cache
# ratio of densities, and of variances by direction, up to which covariances are scaled: to 3 % of a variance. Further
# off the samples are preintegrated again
CLOSE, ALIKE = 1.6, 1.3


def inertial_factors(
    measured: Sequence[gtsam.PreintegratedCombinedMeasurements], first: int = 0
) -> gtsam.NonlinearFactorGraph:
    """Return a CombinedImuFactor for each interval between keyframes first, first + 1, ..."""
    graph = gtsam.NonlinearFactorGraph()
    x, v, b = X(first), V(first), B(first)
    for k, preintegrated in enumerate(measured):
        graph.add(gtsam.CombinedImuFactor(x + k, v + k, x + k + 1, v + k + 1, b + k, b + k + 1, preintegrated))
    return graph


@dataclass(frozen=True, eq=False)
class LinearInertial:
    """Whitened factors (K-1, 15, 46): jacobian (K-1, 15, 45), of which left and right are by the inertial part of the
    ends and errors by scale, misalignment and rectification, and beside it residual (K-1, 15).
    """

    whitened: Array

    @property
    def jacobian(self) -> Array:
        """Jacobian (K-1, 15, 45) by left, right and errors."""
        return self.whitened[:, :, : _BY_ERRORS.stop]

    @property
    def residual(self) -> Array:
        """Residuals (K-1, 15)."""
        return self.whitened[:, :, _RESIDUAL]

    @property
    def left(self) -> Array:
        """Jacobian (K-1, 15, 15) by the left keyframes."""
        return self.jacobian[:, :, _LEFT]

    @property
    def right(self) -> Array:
        """Jacobian (K-1, 15, 15) by the right keyframes."""
        return self.jacobian[:, :, _RIGHT]

    @property
    def errors(self) -> Array:
        """Jacobian (K-1, 15, 15) by scale, misalignment and rectification."""
        return self.jacobian[:, :, _BY_ERRORS]


class InertialGraph:
    """CombinedImuFactors of all intervals, preintegrated once about one pair of biases: by GTSAM, and linearised here.

    binned with sensor errors as in `constants` taken out; biases (3,) m/s^2 and rad/s to preintegrate about.
    """

    def __init__(
        self, binned: BinnedImu, noise: InertialNoise, accel_bias: Array, gyro_bias: Array, constants: Constants
    ) -> None:
        measured = preintegrate(binned, noise, accel_bias, gyro_bias)
        self.constants = constants
        self.noise = noise
        self._binned = binned
        self._increments = increments(binned, accel_bias, gyro_bias)
        self._covariance = np.array([m.preintMeasCov() for m in measured])
        self._force = binned.specific_force_s.mean(axis=1)
        self._shaken = shaken(binned)
        self._accel_bias = accel_bias
        self._own_whitening = self._whitening(noise)
        self._last_whitening = noise, self._own_whitening

    def serves(self, noise: InertialNoise) -> bool:
        """Whether `noise` is so close to what was preintegrated with that correcting the covariances will do.

        For walks it always does: within an interval, biases hardly move anything but themselves. Where force is noisier
        than elsewhere they are scaled by as much as that may be, to 3 % of a variance as well.
        """
        densities = [noise.accel / self.noise.accel, noise.gyro / self.noise.gyro]
        densities += [one / two for one, two in zip(noise.calm, self.noise.calm, strict=True)]
        shapes: list[float] = []
        for one, two in ((noise.accel_shape, self.noise.accel_shape), (noise.gyro_shape, self.noise.gyro_shape)):
            shapes += np.sqrt(np.linalg.eigvals(np.linalg.solve(two, one)).real).tolist()
        return all(
            1.0 / most < ratio < most for ratios, most in ((densities, CLOSE), (shapes, ALIKE)) for ratio in ratios
        )

    def linearize(self, state: ChainState, noise: InertialNoise, acceleration_n: Array | None = None) -> LinearInertial:
        """Linearise. Rows: rotation, position, velocity, bias of force, bias of rate; whitened with `noise`.

        Errors of scale act like a bias in proportion to the mean force and rate of the interval, rectification to the
        power of its vibration. Force and rate are those of the keyframes (:func:`felt_by`): a scale multiplies what was
        there to measure. By the measured ones it would multiply their noise too, which is in the residual as well, and
        the fit would make the scale small to make the noise small (errors in variables; Fuller 1987). What attitudes
        turn is likewise free of the noise where acceleration_n (K-1, 3) m/s^2 is given, the expected means over the
        intervals (:func:`as_expected`); with None it is what the samples say.
        """
        n, whitening = len(self._covariance), self._whitening_with(noise)
        felt = felt_by(state)
        linear = LinearInertial(np.empty((n, 15, _WIDTH)))
        bare = linearize_increments(self._increments, state)
        if acceleration_n is not None:
            bare = as_expected(bare, state, acceleration_n)
        J, errors = np.zeros((min(PIECE, n), 15, _WIDTH)), state.constants.as_vector() - self.constants.as_vector()
        for here in pieces(n, PIECE):
            some = J[: here.stop - here.start]
            bare.put(some[:, :, : _RIGHT.stop], here)
            self._put_errors(some, state, felt, here)
            np.add(bare.residual[here], some[:, :, _BY_ERRORS] @ errors[_ERRORS], out=some[:, :, _RESIDUAL])
            np.matmul(whitening[here], some, out=linear.whitened[here])
        return linear

    def _put_errors(self, J: Array, state: ChainState, felt: tuple[Array, Array], here: slice) -> None:
        """Fill in the columns (n, 15, 15) of J by scale, misalignment and rectification, from those by the biases.

        felt: force and rate (K-1, 3) in s.
        """
        axes, n = state.constants.level_axes_s, len(J)
        force, rate = felt[0][here] @ axes[:2].T, felt[1][here] @ axes[2]
        by_force = J[:, _MOTION, 9:12, None] * force[:, None, None, :]
        J[:, _MOTION, 30:36] = by_force.reshape(n, 9, 6)
        J[:, _MOTION, 36:39] = J[:, _MOTION, 12:15] * rate[:, None, None]
        rectified = J[:, _MOTION, 9:12, None] * self._shaken[here, None, None, :]
        J[:, _MOTION, 39:45] = rectified.reshape(n, 9, 6)

    def _whitening_with(self, noise: InertialNoise) -> Array:
        """Matrices (K-1, 15, 15) that whiten residuals with `noise`."""
        if noise == self.noise:
            return self._own_whitening
        last, whitening = self._last_whitening
        if noise == last:  # steps of the last turns, which find no noise
            return whitening
        try:
            whitening = self._whitening(noise)
            self._last_whitening = noise, whitening
            return whitening
        except np.linalg.LinAlgError:  # scaling is an approximation, and some covariances have little to spare
            return self._own_whitening / min(noise.accel / self.noise.accel, noise.gyro / self.noise.gyro)

    def _whitening(self, noise: InertialNoise) -> Array:
        """Likewise, by covariances for densities that are not far from those preintegrated with."""
        T, out = self._increments.T, np.empty_like(self._covariance)
        force, rate = self._more_white(noise)
        walked = T * np.repeat([now**2 - was**2 for now, was in zip(noise.walks, self.noise.walks, strict=True)], 3)
        for here in pieces(len(out), PIECE):
            covariance = self._covariance[here]
            if noise != self.noise:
                more = _force_covariance(force[here], T) + _rate_covariance(
                    rate[here], self._force[here] - self._accel_bias, T
                )
                covariance = covariance + more
                np.einsum("kii->ki", covariance)[:, _BIASES] += walked
            out[here] = in_left_axes(self._increments, inverse_of_lower(np.linalg.cholesky(covariance)), here)
        return out

    def _more_white(self, noise: InertialNoise) -> tuple[Array, Array]:
        """Spectral densities (K-1, 3, 3) of force and rate by which `noise` exceeds what was preintegrated with."""
        was, now = shared_densities(self._binned, self.noise), shared_densities(self._binned, noise)
        shapes = (noise.accel_shape, self.noise.accel_shape), (noise.gyro_shape, self.noise.gyro_shape)
        force, rate = (
            np.multiply.outer(one**2, np.array(shape)) - np.multiply.outer(two**2, np.array(before))
            for one, two, (shape, before) in zip(now, was, shapes, strict=True)
        )
        return force, rate


def set_apart(
    linear: LinearInertial, at: BoolArray, state: ChainState, noise: InertialNoise, sigma: Array, duration: Array
) -> None:
    """Make the factors `at` (K-1,) say nothing of how the motion went on from left to right keyframe, in place.

    The right one stays where it is, give or take sigma (9,) rad, m and m/s. Biases walk on, for duration (K-1,) s.
    """
    walk = np.repeat([noise.accel_bias_walk, noise.gyro_bias_walk], 3) * np.sqrt(duration[:, None])
    pull = np.zeros((len(walk), 6, 6))
    np.einsum("kii->ki", pull)[...] = 1.0 / walk
    J = np.zeros((np.count_nonzero(at), 15, _WIDTH))
    J[:, _MOTION, _RIGHT][:, :, _MOTION] = np.diag(1.0 / sigma)
    J[:, _BIASES, _LEFT][:, :, _BIASES] = pull[at]
    J[:, _BIASES, _RIGHT][:, :, _BIASES] = -pull[at]
    biases = np.concatenate([state.accel_bias_s, state.gyro_bias_s], axis=1)
    J[:, _BIASES, _RESIDUAL] = (-np.diff(biases, axis=0) / walk)[at]
    linear.whitened[at] = J


def inertial_after_step(linear: LinearInertial, at: IntArray, solution: ChainSolution) -> Array:
    """Residuals (N, 15) of the factors `at` (N,) that the linear model predicts after the step of `solution`."""
    moved = np.ones((len(at), _WIDTH))  # the last one takes the residual as it was
    moved[:, _LEFT], moved[:, _RIGHT] = solution.x[at, _INERTIAL], solution.x[at + 1, _INERTIAL]
    moved[:, _BY_ERRORS] = solution.constants[_ERRORS]
    return np.asarray((linear.whitened[at] @ moved[:, :, None])[:, :, 0])


def add_inertial(system: ChainSystem, linear: LinearInertial) -> None:
    """Add the normal equations of the inertial factors to the system, in place."""
    n = len(linear.whitened)
    by_left, by_right = np.empty((min(PIECE, n), 15, _WIDTH)), np.empty((min(PIECE, n), 15, _WIDTH - 15))
    for here in pieces(n, PIECE):
        J, after, some = linear.whitened[here], slice(here.start + 1, here.stop + 1), slice(0, here.stop - here.start)
        product = np.matmul(J[:, :, _LEFT].transpose(0, 2, 1), J, out=by_left[some])
        system.diagonal[here, _INERTIAL, _INERTIAL] += product[:, :, _LEFT]
        system.upper[here, _INERTIAL, _INERTIAL] += product[:, :, _RIGHT]
        system.border[here, _INERTIAL, _ERRORS] += product[:, :, _BY_ERRORS]
        system.rhs[here, _INERTIAL] -= product[:, :, _RESIDUAL]
        product = np.matmul(J[:, :, _RIGHT].transpose(0, 2, 1), J[:, :, 15:], out=by_right[some])
        system.diagonal[after, _INERTIAL, _INERTIAL] += product[:, :, :15]
        system.border[after, _INERTIAL, _ERRORS] += product[:, :, 15:-1]
        system.rhs[after, _INERTIAL] -= product[:, :, -1]
        own = J[:, :, _BY_ERRORS.start :].reshape(-1, _WIDTH - _BY_ERRORS.start)
        corner = own.T @ own
        system.corner[_ERRORS, _ERRORS] += corner[:-1, :-1]
        system.rhs_constants[_ERRORS] -= corner[:-1, -1]


def empty_system(n_keyframes: int) -> ChainSystem:
    """Return normal equations without any factor."""
    n, m = KEYFRAME_SIZE, CONSTANTS_SIZE
    return ChainSystem(
        np.zeros((n_keyframes, n, n)),
        np.zeros((n_keyframes - 1, n, n)),
        np.zeros((n_keyframes, n, m)),
        np.zeros((m, m)),
        np.zeros((n_keyframes, n)),
        np.zeros(m),
    )


@dataclass(frozen=True, eq=False)
class VarianceComponent:
    """Weighted squared residuals that one source of noise answers for, and how many independent ones they amount to.

    Of each of N intervals (N,), three residuals in each; and of all of them by direction (3, 3), whitened with the
    shape that the noise was given: squares_in over redundancy_in is what it lacks, their traces are the sums.
    """

    squares_of: Array
    redundancy_of: Array
    squares_in: Array
    redundancy_in: Array

    @property
    def squares(self) -> float:
        """Of all intervals together."""
        return float(np.sum(self.squares_of))

    @property
    def redundancy(self) -> float:
        """Of all intervals together."""
        return float(np.sum(self.redundancy_of))


def inertial_components(
    state: ChainState,
    linear: LinearInertial,
    solution: ChainSolution,
    density: tuple[Array, Array],
    shape: tuple[Shape, Shape],
    use: BoolArray,
) -> tuple[VarianceComponent, VarianceComponent]:
    """Split the inertial residuals between the noise of force and that of rate, over the intervals `use` (K-1,).

    density: of force, m/s^2/sqrt(Hz), and of rate, rad/s/sqrt(Hz), (K-1,) each; shape: of both, in s. The residuals are
    those that the linear model predicts after the step of `solution`.

    White force of a density and shape moves velocity and position in a known way, V, which is only a part of a
    factor's covariance: a turn by white rate turns the force and moves as well. With S the square-root information over
    the whole covariance, force weighs the whitened residual e by W = S V S': it answers for e' W e, of which
    tr(W (1 - C)) is expected, C being the covariance that the solution leaves in e. Only white rate turns: its part is
    the rotation alone. Source: Foerstner 1979.
    """
    at = np.flatnonzero(use)
    figures = [
        _weighed(state, linear, solution, at[part], (density[0][at[part]], density[1][at[part]]), shape)
        for part in (list(pieces(len(at), PIECE)) or [slice(0)])
    ]
    force, of_force, rate, of_rate = (np.concatenate(values) for values in zip(*figures, strict=True))
    return _component(force, of_force), _component(rate, of_rate)


def _component(squares: Array, redundancy: Array) -> VarianceComponent:
    """Component of intervals with squares and redundancies by direction, (N, 3, 3)."""
    traces = np.einsum("kii->k", squares), np.einsum("kii->k", redundancy)
    return VarianceComponent(*traces, squares.sum(axis=0), redundancy.sum(axis=0))


def _weighed(
    state: ChainState,
    linear: LinearInertial,
    solution: ChainSolution,
    at: IntArray,
    density: tuple[Array, Array],
    shape: tuple[Shape, Shape],
) -> tuple[Array, Array, Array, Array]:
    """Squares and redundancies (N, 3, 3) of force and of rate, of the factors `at` (N,), whitened with the shapes."""
    root, T = _root_information(state, linear, at), state.interval
    force, rate = np.linalg.cholesky(np.array(shape))
    by_motion = force.T @ root[:, :, _MOVED].reshape(-1, 15, 2, 3).transpose(0, 2, 3, 1)
    unwhiten = np.linalg.solve(root.transpose(0, 2, 1), np.linalg.solve(rate, np.eye(15)[ROTATION]).T)
    of = np.concatenate([by_motion.reshape(-1, 6, 15), unwhiten.transpose(0, 2, 1)], axis=1)
    left = _posterior_covariance(linear, solution, at, of)
    weighed = np.einsum("kri,ki->kr", of, inertial_after_step(linear, at, solution))
    moved, turned = weighed[:, :6].reshape(-1, 2, 3), weighed[:, 6:] / (density[1] * np.sqrt(T))[:, None]
    # of position and velocity, from white force of density one
    together = density[0][:, None, None] ** 2 * np.array([[T**3 / 3.0, T**2 / 2.0], [T**2 / 2.0, T]])
    lost = left[:, :6, :6].reshape(-1, 2, 3, 2, 3)
    expected = np.einsum("kab,kaim,kbjm->kij", together, by_motion, by_motion)
    expected -= np.einsum("kab,kaibj->kij", together, lost)
    of_turn = np.eye(3) - left[:, 6:, 6:] / (density[1] ** 2 * T)[:, None, None]
    return np.einsum("kab,kai,kbj->kij", together, moved, moved), expected, _outer(turned), of_turn


def _outer(values: Array) -> Array:
    return np.asarray(values[:, :, None] * values[:, None, :])


def _root_information(state: ChainState, linear: LinearInertial, at: IntArray) -> Array:
    """Square root (N, 15, 15) of the information of the factors `at` (N,).

    A row block of the factor before whitening is Jr^-1 for rotation, R_i^T R_j for translation, R_i^T for velocity and
    one for the biases; the whitened Jacobian divided by it is the root itself.
    """
    R_i, R_j = state.R_ns[at], state.R_ns[at + 1]
    relative = R_i.transpose(0, 2, 1) @ R_j
    root = linear.right[at]  # Jr^-1 is one to first order in the residual
    root[:, :, TRANSLATION] = root[:, :, TRANSLATION] @ relative.transpose(0, 2, 1)
    root[:, :, VELOCITY] = root[:, :, VELOCITY] @ R_i
    return root


def _force_covariance(q: Array, T: float) -> Array:
    """Covariance (K, 15, 15) of a factor from white force alone, spectral density q (K, 3, 3), over T s."""
    V = np.zeros((len(q), 15, 15))
    V[:, TRANSLATION, TRANSLATION] = (T**3 / 3.0) * q
    V[:, TRANSLATION, VELOCITY] = V[:, VELOCITY, TRANSLATION] = (T**2 / 2.0) * q
    V[:, VELOCITY, VELOCITY] = T * q
    return V


def _rate_covariance(q: Array, force: Array, T: float) -> Array:
    """Covariance (K, 15, 15) of a factor from white rate, spectral density q (K, 3, 3), over T s, at mean force (K, 3).

    A turn e leans the force, which accelerates by -[f]x e.
    """
    lean = -so3.skew(force)
    moved, square = lean @ q, lean @ q @ lean.transpose(0, 2, 1)
    V = np.zeros((len(q), 15, 15))
    V[:, ROTATION, ROTATION] = T * q
    V[:, VELOCITY, ROTATION], V[:, TRANSLATION, ROTATION] = (T**2 / 2.0) * moved, (T**3 / 6.0) * moved
    for part in (VELOCITY, TRANSLATION):
        V[:, ROTATION, part] = V[:, part, ROTATION].transpose(0, 2, 1)
    V[:, VELOCITY, VELOCITY], V[:, TRANSLATION, TRANSLATION] = (T**3 / 3.0) * square, (T**5 / 20.0) * square
    V[:, TRANSLATION, VELOCITY] = V[:, VELOCITY, TRANSLATION] = (T**4 / 8.0) * square
    return V


def _posterior_covariance(linear: LinearInertial, solution: ChainSolution, at: IntArray, of: Array) -> Array:
    """Covariance (N, r, r) that the solution leaves in `of` (N, r, 15) times the residuals of the factors `at` (N,)."""
    J = of @ linear.jacobian[at]
    left, right, errors = J[:, :, _LEFT], J[:, :, _RIGHT], J[:, :, _BY_ERRORS]
    S, C = solution.constants_covariance[_ERRORS, _ERRORS], solution.constants_cross[:, _INERTIAL, _ERRORS]
    P_left, P_right, cross = (
        block[k, _INERTIAL, _INERTIAL]
        for block, k in ((solution.covariance, at), (solution.covariance, at + 1), (solution.cross, at))
    )
    right_t, errors_t = right.transpose(0, 2, 1), errors.transpose(0, 2, 1)
    mixed = left @ cross @ right_t + (left @ C[at] + right @ C[at + 1]) @ errors_t
    own = left @ P_left @ left.transpose(0, 2, 1) + right @ P_right @ right_t + errors @ S @ errors_t
    return np.asarray(own + mixed + mixed.transpose(0, 2, 1))
