"""The inertial factors in the chain against GTSAM itself, against numbers, and against the formula."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X

from smoother import so3
from smoother.estimate.graph import inertial
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.components import LOCAL_BOUNDS
from smoother.estimate.graph.imu import BinnedImu, corrected
from smoother.estimate.graph.increments import felt_by
from smoother.estimate.graph.inertial import (
    InertialGraph,
    LinearInertial,
    _force_covariance,
    _posterior_covariance,
    _rate_covariance,
    _root_information,
    add_inertial,
    empty_system,
    inertial_after_step,
    inertial_components,
    inertial_factors,
    set_apart,
)
from smoother.estimate.graph.inertial_noise import ROUND, InertialNoise, LocalLevel, Shape
from smoother.estimate.graph.preintegration import preintegrate
from smoother.estimate.graph.state import (
    ACCEL_ERROR,
    CONSTANTS_SIZE,
    GYRO_ERROR,
    KEYFRAME_SIZE,
    RECTIFICATION,
    TRANSLATION,
    VELOCITY,
    ChainState,
    Constants,
)
from smoother.frames import GRAVITY_N

K, T, N_BINS, INERTIAL = 5, 0.2, 10, 15
NOISE = InertialNoise(0.3, 0.02, 0.01, 0.002)
FLATTER: Shape = ((0.9, -0.1, 0.05), (-0.1, 1.1, 0.0), (0.05, 0.0, 1.0))
POLARISED: Shape = ((0.6, 0.1, 0.6), (0.1, 0.4, 0.3), (0.6, 0.3, 2.0))
ALL, BIASES = np.arange(K - 1), ("accel_bias_s", "gyro_bias_s")


def drive(seed: int, crooked: float = 0.01) -> tuple[ChainState, BinnedImu]:
    """A few intervals of random motion; keyframes disagree with it by random steps of `crooked`."""
    rng = np.random.default_rng(seed)
    t = T * np.arange(K)
    force = rng.normal(size=(K - 1, N_BINS, 3)) * 2.0 + [1.0, 3.0, 9.8]
    rate = rng.normal(size=(K - 1, N_BINS, 3)) * 0.2 + [0.1, -0.2, 0.8]
    rough = np.array([[0.4, 1.2], [1.6, 0.5], [0.7, 2.0], [1.3, 0.3]])
    binned = BinnedImu(t, T / N_BINS, force, rate, np.zeros(K - 1), rough)
    accel_bias = 0.2 * rng.normal(size=3) + 0.01 * rng.normal(size=(K, 3))
    gyro_bias = 0.05 * rng.normal(size=3) + 0.002 * rng.normal(size=(K, 3))
    state = gtsam.NavState(gtsam.Rot3(so3.exp(rng.normal(size=3))), 10.0 * rng.normal(size=3), 5.0 * rng.normal(size=3))
    states = [state]
    for k, measured in enumerate(preintegrate(binned, NOISE, accel_bias[:-1], gyro_bias[:-1])):
        states.append(measured.predict(states[-1], gtsam.imuBias.ConstantBias(accel_bias[k], gyro_bias[k])))
    R = np.array([s.attitude().matrix() for s in states]) @ so3.exp(crooked * rng.normal(size=(K, 3)))
    p = np.array([s.position() for s in states]) + crooked * rng.normal(size=(K, 3))
    v = np.array([s.velocity() for s in states]) + crooked * rng.normal(size=(K, 3))
    chain = ChainState(t, R, p, v, accel_bias, gyro_bias, np.zeros((K, 3)), Constants(0.0, 0.0, np.zeros(3)))
    return chain, binned


def biases_of(state: ChainState) -> tuple[np.ndarray, np.ndarray]:
    """One pair of biases, (3,) each, that the whole chain is preintegrated about."""
    return state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)


def inertial_graph(state: ChainState, binned: BinnedImu, noise: InertialNoise = NOISE) -> InertialGraph:
    return InertialGraph(binned, noise, *biases_of(state), state.constants)


def linearized(state: ChainState, binned: BinnedImu) -> LinearInertial:
    return inertial_graph(state, binned).linearize(state, NOISE)


def values_of(state: ChainState) -> gtsam.Values:
    values = gtsam.Values()
    for k, (R, p, v) in enumerate(zip(state.R_ns, state.position_n, state.velocity_n, strict=True)):
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(R), p))
        values.insert(V(k), v)
        values.insert(B(k), gtsam.imuBias.ConstantBias(state.accel_bias_s[k], state.gyro_bias_s[k]))
    return values


@pytest.mark.parametrize("piece", [2, 3, 128])
@pytest.mark.parametrize("seed", range(3))
def test_residuals_weigh_what_gtsam_says_they_weigh(seed: int, piece: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inertial, "PIECE", piece)
    state, binned = drive(seed)
    measured = preintegrate(binned, NOISE, *biases_of(state))
    factors, linear, values = inertial_factors(measured), linearized(state, binned), values_of(state)
    for k in range(K - 1):
        assert 0.5 * np.sum(linear.residual[k] ** 2) == pytest.approx(factors.at(k).error(values), rel=1e-9)


@pytest.mark.parametrize("shape", [ROUND, FLATTER])
@pytest.mark.parametrize("ratio", [1.0 / 1.5, 1.5])
def test_another_noise_is_a_scaled_covariance(ratio: float, shape: Shape) -> None:
    """Up to the ratio that counts as near, scaling is as good as preintegrating again."""
    state, binned = drive(0)
    binned = replace(binned, missing=np.array([0.0, 0.3, 0.2, 0.0]))
    noise = replace(NOISE, accel=NOISE.accel * ratio, gyro=NOISE.gyro / ratio, accel_shape=shape, gyro_shape=shape)
    graph = inertial_graph(state, binned)
    assert graph.serves(noise)
    assert not graph.serves(replace(noise, accel=NOISE.accel * 2.0))
    assert not graph.serves(replace(noise, gyro_shape=POLARISED))
    have, want = graph.linearize(state, noise), inertial_graph(state, binned, noise).linearize(state, noise)
    for k in range(K - 1):
        H, exact = have.left[k].T @ have.left[k], want.left[k].T @ want.left[k]
        scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
        # a shape turns with the box, here by 0.15 rad within an interval, which scaling leaves out
        near = 0.025 if shape == ROUND else 0.04
        np.testing.assert_allclose(H / scale, exact / scale, atol=near)
        assert np.sum(have.residual[k] ** 2) == pytest.approx(np.sum(want.residual[k] ** 2), rel=near)


@pytest.mark.parametrize("seed", range(3))
def test_jacobians_are_the_numerical_ones_of_the_chain_s_own_retraction(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inertial, "as_expected", lambda linear, *_: linear)
    state, binned = drive(seed)
    graph = inertial_graph(state, binned)
    linear = graph.linearize(state, NOISE)

    def residual(x: np.ndarray) -> np.ndarray:
        step = np.zeros((K, KEYFRAME_SIZE))
        step[:, :INERTIAL] = x.reshape(K, INERTIAL)
        return graph.linearize(state.retract(step, np.zeros(CONSTANTS_SIZE)), NOISE).residual

    J = so3.numerical_jacobian(residual, np.zeros(K * INERTIAL), step=1e-6).reshape(K - 1, INERTIAL, K, INERTIAL)
    for k in range(K - 1):
        scale = np.max(np.abs(linear.right[k]), axis=1, keepdims=True)  # rows are whitened, each by its own sigma
        np.testing.assert_allclose(linear.left[k] / scale, J[k, :, k] / scale, atol=1e-5)
        np.testing.assert_allclose(linear.right[k] / scale, J[k, :, k + 1] / scale, atol=1e-5)


def calmed(bins: np.ndarray) -> np.ndarray:
    """Bins (K-1, n, 3) that differ less from the mean of their interval."""
    mean = bins.mean(axis=1, keepdims=True)
    return np.asarray(mean + 0.3 * (bins - mean))


def test_errors_of_scale_move_the_residual_as_predicted() -> None:
    state, binned = drive(0)
    rng = np.random.default_rng(1)
    axes_s = so3.exp(np.array([0.2, -0.1, 0.5]))  # the kart of `drive` turns mostly about the last of them
    zeros = np.zeros((K, 3))  # a scale acts on what is felt; taken out of the samples it acts on their biases too
    constants = replace(state.constants, level_axes_s=axes_s)
    state = replace(state, accel_bias_s=zeros, gyro_bias_s=zeros, constants=constants)
    binned = replace(
        binned, specific_force_s=calmed(binned.specific_force_s), angular_rate_s=calmed(binned.angular_rate_s)
    )
    base = linearized(state, binned)
    for part in (ACCEL_ERROR, GYRO_ERROR, RECTIFICATION):
        step = np.zeros(CONSTANTS_SIZE)
        step[part] = 0.01 * rng.normal(size=part.stop - part.start)
        errors = Constants.from_vector(step, state.constants.level_axes_s)
        moved = linearized(state, corrected(binned, errors))
        want = moved.residual - base.residual
        have = base.errors @ step[ACCEL_ERROR.start : RECTIFICATION.stop]
        # an error acts on each bin, the model on their mean; here neighbouring bins differ by 0.6 m/s^2
        assert np.linalg.norm(have - want) < 0.15 * np.linalg.norm(want)


def smooth_drive(n: int) -> tuple[ChainState, BinnedImu]:
    """n keyframes of a motion that changes slowly, and what perfect sensors measure of it."""
    t = T * np.arange(n)
    middle = (np.arange((n - 1) * N_BINS) + 0.5) * T / N_BINS
    force = np.column_stack([2.0 * np.sin(1.1 * middle), 4.0 * np.cos(0.7 * middle), np.full(len(middle), 9.8)])
    rate = np.column_stack([0.02 * np.sin(middle), 0.02 * np.cos(middle), 0.8 * np.cos(0.7 * middle)])
    bins = force.reshape(-1, N_BINS, 3), rate.reshape(-1, N_BINS, 3)
    binned = BinnedImu(t, T / N_BINS, *bins, np.zeros(n - 1))
    states, none = [gtsam.NavState()], gtsam.imuBias.ConstantBias()
    for measured in preintegrate(binned, NOISE, np.zeros(3), np.zeros(3)):
        states.append(measured.predict(states[-1], none))
    R, p, v = (
        np.array(x) for x in zip(*((s.attitude().matrix(), s.position(), s.velocity()) for s in states), strict=True)
    )
    zeros = np.zeros((n, 3))
    return ChainState(t, R, p, v, zeros, zeros, zeros, Constants(0.0, 0.0, np.zeros(3))), binned


@pytest.mark.parametrize("ratio", LOCAL_BOUNDS)
def test_force_that_is_noisier_in_places_is_a_scaled_covariance(ratio: float) -> None:
    state, binned = drive(1)
    t = 0.5 * (binned.t[1:] + binned.t[:-1])
    noise = replace(NOISE, local=LocalLevel(t, np.where(np.arange(len(t)) == 1, ratio, 1.0)))
    graph = inertial_graph(state, binned)
    assert graph.serves(noise)
    have, want = graph.linearize(state, noise), inertial_graph(state, binned, noise).linearize(state, noise)
    plain = graph.linearize(state, NOISE)
    for k in range(K - 1):
        H, exact, usual = (linear.left[k].T @ linear.left[k] for linear in (have, want, plain))
        scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
        np.testing.assert_allclose(H / scale, exact / scale, atol=0.04)
        assert (np.max(np.abs(H - usual) / scale) > 0.5) == (k == 1)


def test_force_and_rate_by_the_keyframes_are_the_means_of_what_was_there_to_measure() -> None:
    state, binned = smooth_drive(200)
    force, rate = felt_by(state)
    # the box turns by 0.16 rad in an interval, and the force along with it: one per cent of 4 m/s^2
    np.testing.assert_allclose(force, binned.specific_force_s.mean(axis=1), atol=0.04)
    np.testing.assert_allclose(rate, binned.angular_rate_s.mean(axis=1), atol=0.002)


def test_noise_of_the_samples_is_not_taken_for_an_error_of_scale() -> None:
    state, binned = smooth_drive(4000)
    rng = np.random.default_rng(7)
    noise = InertialNoise(0.6, 0.1, 0.01, 0.002)
    scatter = rng.normal(size=(2, *binned.specific_force_s.shape)) / np.sqrt(binned.dt)
    noisy = replace(
        binned,
        specific_force_s=binned.specific_force_s + noise.accel * scatter[0],
        angular_rate_s=binned.angular_rate_s + noise.gyro * scatter[1],
    )
    linear = InertialGraph(noisy, noise, np.zeros(3), np.zeros(3), state.constants).linearize(state, noise)
    J = linear.errors[:, :9, :9].reshape(-1, 9)  # scale and misalignment of force, and scale of rate
    information = J.T @ J
    found = -np.linalg.solve(information, J.T @ linear.residual[:, :9].ravel())
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    assert np.all(np.abs(found) < 4.0 * sigma)
    assert np.all(sigma < 0.03)  # of a scale: by the noisy samples in place of the keyframes it is 14 to 48 %


def test_taking_sensor_errors_out_undoes_them_to_second_order() -> None:
    _, binned = drive(0)
    rng = np.random.default_rng(2)
    axes_s = so3.exp(rng.normal(size=3))
    errors = Constants(0.0, 0.0, np.zeros(3), level_axes_s=axes_s, rectification=rng.normal(size=(3, 2)))
    errors = replace(errors, accel_error=0.02 * rng.normal(size=(3, 2)), gyro_error=0.02 * rng.normal(size=3))
    pushed = np.array([[-0.6, 0.2], [0.6, -0.5], [-0.3, 1.0], [0.3, -0.7]]) @ errors.rectification.T
    wrong = replace(
        binned,
        specific_force_s=binned.specific_force_s @ (np.eye(3) + errors.accel_matrix).T + pushed[:, None],
        angular_rate_s=binned.angular_rate_s @ (np.eye(3) + errors.gyro_matrix).T,
    )
    mended = corrected(wrong, errors)
    np.testing.assert_allclose(mended.specific_force_s, binned.specific_force_s, atol=12.0 * 3.0 * 0.06**2)
    np.testing.assert_allclose(mended.angular_rate_s, binned.angular_rate_s, atol=1.5 * 3.0 * 0.06**2)
    assert np.max(np.abs(wrong.specific_force_s - binned.specific_force_s)) > 10.0 * np.max(
        np.abs(mended.specific_force_s - binned.specific_force_s)
    )


def test_after_a_step_the_residual_is_that_of_the_linear_model() -> None:
    state, binned = drive(0)
    linear = linearized(state, binned)
    rng = np.random.default_rng(3)
    step, constants = rng.normal(size=(K, KEYFRAME_SIZE)), rng.normal(size=CONSTANTS_SIZE)
    _, solution = random_covariance()
    moved = inertial_after_step(linear, ALL[1:], replace(solution, x=step, constants=constants))
    errors = constants[ACCEL_ERROR.start : RECTIFICATION.stop]
    for k, have in zip(ALL[1:], moved, strict=True):
        want = linear.residual[k] + linear.left[k] @ step[k, :INERTIAL] + linear.right[k] @ step[k + 1, :INERTIAL]
        np.testing.assert_allclose(have, want + linear.errors[k] @ errors, rtol=1e-9)


def test_away_from_the_errors_that_were_taken_out_the_residual_is_what_their_slopes_say() -> None:
    state, binned = drive(0)
    graph, errors = inertial_graph(state, binned), 0.01 * np.random.default_rng(4).normal(size=15)
    base, step = graph.linearize(state, NOISE), np.zeros(CONSTANTS_SIZE)
    step[ACCEL_ERROR.start : RECTIFICATION.stop] = errors
    moved = graph.linearize(replace(state, constants=state.constants.retract(step)), NOISE)
    np.testing.assert_allclose(moved.residual, base.residual + base.errors @ errors, rtol=1e-9, atol=1e-9)


def dense_jacobian(linear: LinearInertial) -> np.ndarray:
    """The whole Jacobian ((K-1) * 15, K * 18 + constants)."""
    J, n = np.zeros((K - 1, INERTIAL, K * KEYFRAME_SIZE + CONSTANTS_SIZE)), KEYFRAME_SIZE
    for k in range(K - 1):
        J[k, :, k * n : k * n + INERTIAL] = linear.left[k]
        J[k, :, (k + 1) * n : (k + 1) * n + INERTIAL] = linear.right[k]
        J[k, :, K * n + ACCEL_ERROR.start : K * n + RECTIFICATION.stop] = linear.errors[k]
    return J.reshape((K - 1) * INERTIAL, -1)


def test_the_normal_equations_are_those_of_the_dense_jacobian() -> None:
    state, binned = drive(0)
    linear = linearized(state, binned)
    system = empty_system(K)
    add_inertial(system, linear)
    J = dense_jacobian(linear)
    H, g, n, c = J.T @ J, -J.T @ linear.residual.ravel(), KEYFRAME_SIZE, K * KEYFRAME_SIZE
    blocks, k = H[:c, :c].reshape(K, n, K, n).transpose(0, 2, 1, 3), np.arange(K)
    for have, want in (
        (system.diagonal, blocks[k, k]),
        (system.upper, blocks[k[:-1], k[1:]]),
        (system.border, H[:c, c:].reshape(K, n, -1)),
        (system.corner, H[c:, c:]),
        (system.rhs, g[:c].reshape(K, n)),
        (system.rhs_constants, g[c:]),
    ):
        np.testing.assert_allclose(have, want, rtol=1e-9, atol=1e-9 * np.max(np.abs(want)))


@pytest.mark.parametrize("seed", range(3))
def test_unwhitened_residuals_are_those_of_the_formula(seed: int) -> None:
    """Forster et al. 2017, eq. 45, in axes of the left keyframe: what the keyframes say minus what was integrated."""
    state, binned = drive(seed, crooked=1e-3)
    state = replace(state, **{name: np.tile(b, (K, 1)) for name, b in zip(BIASES, biases_of(state), strict=True)})
    measured = preintegrate(binned, NOISE, *biases_of(state))
    linear = linearized(state, binned)
    found = np.linalg.solve(_root_information(state, linear, ALL), linear.residual[:, :, None])[:, :, 0]
    R, p, v = state.R_ns, state.position_n, state.velocity_n
    for k in range(K - 1):
        Rt = R[k].T
        want = np.concatenate(
            [
                so3.log(measured[k].deltaRij().matrix().T @ Rt @ R[k + 1]),
                Rt @ (p[k + 1] - p[k] - v[k] * T - 0.5 * GRAVITY_N * T**2) - measured[k].deltaPij(),
                Rt @ (v[k + 1] - v[k] - GRAVITY_N * T) - measured[k].deltaVij(),
                state.accel_bias_s[k + 1] - state.accel_bias_s[k],
                state.gyro_bias_s[k + 1] - state.gyro_bias_s[k],
            ]
        )
        # the residual's own turn, some mrad, counts as none: that share of residuals of some mm is left
        np.testing.assert_allclose(found[k], want, atol=2e-5)


def test_the_root_belongs_to_gtsam_s_own_covariance() -> None:
    state, binned = drive(0, crooked=0.0)
    measured = preintegrate(binned, NOISE, *biases_of(state))
    root = _root_information(state, linearized(state, binned), ALL)
    for k in range(K - 1):
        covariance = np.linalg.inv(root[k].T @ root[k])
        # GTSAM keeps the covariance in axes of the right end, turned by 0.15 rad; the isotropic parts agree at once
        R = state.R_ns[k].T @ state.R_ns[k + 1]
        turn = np.eye(INERTIAL)
        turn[TRANSLATION, TRANSLATION] = turn[VELOCITY, VELOCITY] = R
        want = turn @ measured[k].preintMeasCov() @ turn.T
        scale = np.sqrt(np.diag(want))
        np.testing.assert_allclose(covariance / scale / scale[:, None], want / scale / scale[:, None], atol=0.05)


@pytest.mark.parametrize(("shape", "near"), [(ROUND, 0.05), (POLARISED, 0.15)])  # it turns with the box, by 0.15
def test_what_white_force_does_to_a_factor_is_its_covariance_without_rate_noise(shape: Shape, near: float) -> None:
    _, binned = drive(0)
    zeros = np.zeros((K - 1, 3))
    force_only = replace(NOISE, gyro=1e-9, accel_bias_walk=1e-9, gyro_bias_walk=1e-9, accel_shape=shape)
    found = _force_covariance(np.tile(NOISE.accel**2 * np.array(shape), (K - 1, 1, 1)), T)
    for k, measured in enumerate(preintegrate(binned, force_only, zeros, zeros)):
        want = measured.preintMeasCov()
        scale = np.sqrt(np.diag(want)[3:9])
        have = found[k, 3:9, 3:9]
        # GTSAM adds up steps of a tenth of the interval, of which position sees the first ones only from their middle
        np.testing.assert_allclose(have / scale / scale[:, None], want[3:9, 3:9] / scale / scale[:, None], atol=near)


def test_what_white_rate_does_to_a_factor_is_its_covariance_without_noise_of_force() -> None:
    force, n_bins = np.array([1.0, 3.0, 9.8]), 200
    shape = (1, n_bins, 3)
    steady = BinnedImu(np.array([0.0, T]), T / n_bins, np.broadcast_to(force, shape), np.zeros(shape), np.zeros(1))
    rate_only = replace(NOISE, accel=1e-9, accel_bias_walk=1e-9, gyro_bias_walk=1e-9)
    (measured,) = preintegrate(steady, rate_only, np.zeros((1, 3)), np.zeros((1, 3)))
    found, want = _rate_covariance(NOISE.gyro**2 * np.eye(3)[None], force[None], T)[0], measured.preintMeasCov()
    scale = np.sqrt(np.diag(want)[:9] + 1e-30)
    # GTSAM adds up steps of a two hundredth of the interval, each from its beginning
    np.testing.assert_allclose(found[:9, :9] / scale / scale[:, None], want[:9, :9] / scale / scale[:, None], atol=0.03)


def random_covariance() -> tuple[np.ndarray, ChainSolution]:
    """Any covariance, dense and as the chain would hold it."""
    A = np.random.default_rng(0).normal(size=(K * KEYFRAME_SIZE + CONSTANTS_SIZE,) * 2)
    P = A @ A.T / len(A)
    return P, in_blocks(P)


def in_blocks(P: np.ndarray) -> ChainSolution:
    """A dense covariance as the chain would hold it."""
    n, m, c = KEYFRAME_SIZE, CONSTANTS_SIZE, K * KEYFRAME_SIZE
    blocks, k = P[:c, :c].reshape(K, n, K, n).transpose(0, 2, 1, 3), np.arange(K)
    cross = P[:c, c:].reshape(K, n, m)
    empty = np.zeros((K, n)), np.zeros(m)
    return ChainSolution(*empty, blocks[k, k], blocks[k[:-1], k[1:]], P[c:, c:], cross)


def test_posterior_covariance_is_that_of_the_dense_one() -> None:
    state, binned = drive(0)
    linear = linearized(state, binned)
    P, solution = random_covariance()
    some, of = np.array([0, 2, 3]), np.random.default_rng(1).normal(size=(3, 4, INERTIAL))
    found = _posterior_covariance(linear, solution, some, of)
    jacobians = dense_jacobian(linear).reshape(K - 1, INERTIAL, -1)
    for i, k in enumerate(some):
        J = of[i] @ jacobians[k]
        want = J @ P @ J.T
        np.testing.assert_allclose(found[i], want, atol=1e-9 * np.max(np.abs(want)))


class TestVarianceComponents:
    def ratios(self, accel: float, gyro: float) -> list[float]:
        """Root of squares over redundancy, force and rate, when the real noise is `accel`, `gyro` times the assumed."""
        state, binned = drive(0, crooked=0.0)
        linear = linearized(state, binned)
        real = replace(NOISE, accel=NOISE.accel * accel, gyro=NOISE.gyro * gyro)
        true_root = _root_information(state, inertial_graph(state, binned, real).linearize(state, real), ALL)
        root, rng, sums = _root_information(state, linear, ALL), np.random.default_rng(0), np.zeros((2, 2))
        _, solution = random_covariance()
        blocks = {name: 0.0 * value for name, value in vars(solution).items() if value is not None}
        solution = replace(solution, **blocks)
        for _ in range(500):
            noise = np.linalg.solve(true_root, rng.normal(size=(K - 1, INERTIAL, 1)))
            drawn = LinearInertial(np.concatenate([linear.jacobian, root @ noise], axis=2))
            densities = np.full(K - 1, NOISE.accel), np.full(K - 1, NOISE.gyro)
            components = inertial_components(state, drawn, solution, densities, (ROUND, ROUND), ALL >= 0)
            sums += [[c.squares, c.redundancy] for c in components]
        return list(np.sqrt(sums[:, 0] / sums[:, 1]))

    def test_with_the_noise_as_assumed_both_ratios_are_one(self) -> None:
        np.testing.assert_allclose(self.ratios(1.0, 1.0), 1.0, atol=0.03)  # 6000 residuals: 1 %

    def test_each_component_answers_for_its_own_noise(self) -> None:
        force, rate = self.ratios(1.5, 1.0)
        assert force == pytest.approx(1.5, abs=0.1)
        assert rate == pytest.approx(1.0, abs=0.1)
        force, rate = self.ratios(1.0, 1.5)
        assert force == pytest.approx(1.0, abs=0.1)
        assert rate == pytest.approx(1.5, abs=0.1)

    def test_what_a_solution_takes_up_is_not_expected_of_its_residuals(self) -> None:
        state, binned = drive(0, crooked=0.0)
        linear, rng, sums = linearized(state, binned), np.random.default_rng(2), np.zeros((2, 2))
        J, c = dense_jacobian(linear), K * KEYFRAME_SIZE
        prior = np.sqrt(np.diag(J.T @ J) + 1.0)  # as much is known of everything beforehand
        P = np.linalg.inv(J.T @ J + np.diag(prior**2))
        solution, densities = in_blocks(P), (np.full(K - 1, NOISE.accel), np.full(K - 1, NOISE.gyro))
        for _ in range(500):
            noise, before = rng.normal(size=len(J)), rng.normal(size=len(P))
            x = -P @ (J.T @ noise + prior * before)
            drawn = LinearInertial(np.concatenate([linear.jacobian, noise.reshape(K - 1, INERTIAL, 1)], axis=2))
            moved = replace(solution, x=x[:c].reshape(K, -1), constants=x[c:])
            components = inertial_components(state, drawn, moved, densities, (ROUND, ROUND), ALL >= 0)
            sums += [[part.squares, part.redundancy] for part in components]
        np.testing.assert_allclose(sums[:, 0] / sums[:, 1], 1.0, atol=0.08)  # some thousand residuals, twice 2 %
        assert np.all(sums[:, 1] < 0.9 * 500 * 3 * (K - 1))

    def test_without_any_interval_nothing_is_answered_for(self) -> None:
        state, binned = drive(0)
        _, solution = random_covariance()
        none, density = np.zeros(K - 1, dtype=bool), np.ones(K - 1)
        linear, densities = linearized(state, binned), (density, density)
        for component in inertial_components(state, linear, solution, densities, (ROUND, ROUND), none):
            assert component.squares == component.redundancy == 0.0

    def test_directions_add_up_to_the_whole_whatever_the_shape(self) -> None:
        state, binned = drive(1)
        _, solution = random_covariance()
        densities = np.full(K - 1, NOISE.accel), np.full(K - 1, NOISE.gyro)
        linear, shapes = linearized(state, binned), (POLARISED, FLATTER)
        for component in inertial_components(state, linear, solution, densities, shapes, ALL >= 0):
            assert component.squares == pytest.approx(np.trace(component.squares_in))
            assert component.redundancy == pytest.approx(np.trace(component.redundancy_in))
            for by_direction in (component.squares_in, component.redundancy_in):
                np.testing.assert_allclose(by_direction, by_direction.T, rtol=1e-9, atol=1e-9)


def test_keyframes_that_are_set_apart_have_nothing_but_their_biases_in_common() -> None:
    state, binned = drive(9)
    linear, sigma = linearized(state, binned), np.repeat([3.0, 1e4, 1e3], 3)
    before = linear.whitened.copy()
    duration = np.array([T, T, 100.0, T])
    set_apart(linear, np.arange(K - 1) == 2, state, NOISE, sigma, duration)
    np.testing.assert_array_equal(linear.whitened[[0, 1, 3]], before[[0, 1, 3]])
    walk = np.sqrt(100.0) * np.repeat([NOISE.accel_bias_walk, NOISE.gyro_bias_walk], 3)
    np.testing.assert_array_equal(linear.left[2, :9], 0.0)
    np.testing.assert_allclose(linear.right[2, :9, :9], np.diag(1.0 / sigma))
    np.testing.assert_array_equal(linear.residual[2, :9], 0.0)
    step = np.concatenate([values[2] - values[3] for values in (state.accel_bias_s, state.gyro_bias_s)])
    np.testing.assert_allclose(linear.residual[2, 9:], step / walk)
    np.testing.assert_allclose(linear.left[2, 9:, 9:], np.diag(1.0 / walk))
    np.testing.assert_allclose(linear.right[2, 9:, 9:], -np.diag(1.0 / walk))
    np.testing.assert_array_equal(linear.jacobian[2, :, 30:], 0.0)
