"""The whole batch against GTSAM itself, and the noise it estimates against the noise that was put in."""

import math
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, L, V, X

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph import inertial, session_rows
from smoother.estimate.graph.batch import Batch, Solved
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.components import (
    OWN_SCATTER,
    USUAL_POSITION,
    USUAL_POSITION_COUNT,
    USUAL_VELOCITY,
    USUAL_VELOCITY_COUNT,
    Scatter,
    unseen_offset,
    update_noise,
)
from smoother.estimate.graph.expected import DopplerNoise, expected_motion
from smoother.estimate.graph.imu import BinnedImu, bin_imu
from smoother.estimate.graph.inertial import inertial_factors
from smoother.estimate.graph.inertial_noise import InertialNoise
from smoother.estimate.graph.inputs import Data, Noise, Priors
from smoother.estimate.graph.preintegration import preintegrate
from smoother.estimate.graph.row_components import posterior_variance
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.state import (
    ACCEL_BIAS,
    CONSTANTS_SIZE,
    HEADING_OFFSET,
    KEYFRAME_SIZE,
    LEVER_ARM,
    ROW_CONSTANTS_SIZE,
    VELOCITY,
    ChainState,
    Constants,
)
from smoother.estimate.output.residual_statistics import joined, left_of_inertial
from smoother.frames import GRAVITY_N
from smoother.samples import ImuSamples

K, T, N_BINS = 41, 0.2, 10
ARM_S = np.array([0.3, -0.2, 0.4])
MOUNTING = so3.exp(np.array([0.2, -0.4, 2.0]))
STILL = np.array([0, 1, 2, 3])
GYRO_BIAS_MEAN = np.array([0.01, 0.02, -0.015])
TINY = 1e-5  # a sigma that fixes what GTSAM's graph does not have: sensor errors, the slow offset
LATE = 1e-7  # s by which fixes follow their keyframe, so that rounding does not move them to the interval before it


@dataclass(frozen=True, eq=False)
class Problem:
    """A small session whose fixes fall on keyframes, and the state to start from. Latencies are stated to be none."""

    data: Data
    binned: BinnedImu
    priors: Priors
    noise: Noise
    state: ChainState


def problem(
    seed: int = 0, position: float = 0.5, velocity: float = 0.1, K: int = K, shape: np.ndarray | None = None
) -> Problem:
    """Eight seconds (or K keyframes) from a standstill into a bend, in a box mounted anyhow, that shakes by a shape."""
    rng = np.random.default_rng(seed)
    rate_imu = 200.0
    t = np.arange(1, round((K * T + 0.2) * rate_imu) + 1) / rate_imu
    moving = np.clip((t - 1.0) / 0.5, 0.0, 1.0)
    turn = 0.5 * moving * np.sin(0.8 * t)
    yaw = np.cumsum(turn) / rate_imu
    speed = np.cumsum(3.0 * moving * np.cos(0.3 * t)) / rate_imu
    v = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros_like(t)], axis=1)
    p = np.cumsum(v, axis=0) / rate_imu
    R_ns = so3.exp(np.stack([0.0 * yaw, 0.0 * yaw, yaw], axis=1)) @ MOUNTING
    rate_n = np.stack([0.0 * turn, 0.0 * turn, turn], axis=1)
    acceleration = np.gradient(v, t, axis=0)
    noise = Noise(
        InertialNoise(0.1, 0.01, 0.003, 1e-4),
        np.full(3, position),
        np.full(3, velocity),
        np.full(3, TINY),
        T,
        np.full(3, TINY),
    )
    force = np.einsum("nji,nj->ni", R_ns, acceleration - GRAVITY_N) + np.array([0.2, -0.1, 0.15])
    rate = np.einsum("nji,nj->ni", R_ns, rate_n) + GYRO_BIAS_MEAN
    root = np.linalg.cholesky(np.eye(3) if shape is None else shape)
    force += noise.inertial.accel * np.sqrt(rate_imu) * rng.normal(size=force.shape) @ root.T
    rate += noise.inertial.gyro * np.sqrt(rate_imu) * rng.normal(size=rate.shape)
    keyframes = 0.1 + T * np.arange(K)
    i = np.searchsorted(t, keyframes - 1e-9)
    swing = np.cross(rate_n[i], R_ns[i] @ ARM_S)
    fixes = np.arange(0, K - 1, 2)
    data = Data(
        t=keyframes[fixes] + LATE,
        position_n=(p[i] + R_ns[i] @ ARM_S + position * rng.normal(size=(K, 3)))[fixes],
        velocity_n=(v[i] + swing + velocity * rng.normal(size=(K, 3)))[fixes],
        position_scale=np.ones(len(fixes)),
        velocity_scale=np.ones(len(fixes)),
        still=STILL,
    )
    sigma = np.full(CONSTANTS_SIZE, TINY)
    sigma[:2], sigma[LEVER_ARM], sigma[HEADING_OFFSET] = 1e-9, 0.5, 1.0
    state = ChainState(
        keyframes,
        R_ns[i] @ so3.exp(0.05 * rng.normal(size=(K, 3))),
        p[i] + 0.5 * rng.normal(size=(K, 3)),
        v[i] + 0.3 * rng.normal(size=(K, 3)),
        *np.zeros((3, K, 3)),
        Constants(0.0, 0.0, np.zeros(3)),
    )
    binned = bin_imu(ImuSamples(t, force, rate), keyframes, N_BINS, np.zeros(3), np.zeros(3))
    priors = Priors(0.5, 0.05, GYRO_BIAS_MEAN, np.zeros(CONSTANTS_SIZE), sigma)
    return Problem(data, binned, priors, noise, state)


def solve(p: Problem, steps: int = 12) -> tuple[Batch, Solved, gtsam.NonlinearFactorGraph]:
    """Solve far below any sigma; the preintegration stays about the biases of the fourth step. Also returns that."""
    batch = Batch(p.data, p.binned, p.priors)
    state = batch.converge(batch.graph(p.state, p.noise), p.state, p.noise, 4)
    graph = batch.graph(state, p.noise)
    biases = state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)
    factors = inertial_factors(preintegrate(batch.bins(state), p.noise.inertial, *biases))
    for _ in range(steps):
        solved = batch.step(graph, state, p.noise)
        state = solved.state
    assert np.max(np.abs(solved.solution.x)) < 1e-6
    return batch, solved, factors


def sigmas(values: object) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(values, dtype=float))


def doppler_factor(
    k: int, measured: np.ndarray, rate: float, slow: float, gyro_bias: np.ndarray, model: object
) -> object:
    """Velocity of the antenna: v + r up x R l, with r the gyro's turn about up. Keys X V B L.

    rate rad/s is that turn with `gyro_bias` removed; slow is what of it keyframes follow, the slope by the arm.
    """

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: list[np.ndarray] | None) -> np.ndarray:
        R, arm = values.atPose3(X(k)).rotation().matrix(), values.atPoint3(L(0))
        up_s, up, arm_n = R[2], np.array([0.0, 0.0, 1.0]), R @ arm
        turn = rate - up_s @ (values.atConstantBias(B(k)).gyroscope() - gyro_bias)
        if H is not None:
            H[0] = np.zeros((3, 6), order="F")
            H[0][:, :3] = -turn * so3.skew(up) @ so3.skew(arm_n) @ R
            H[1] = np.eye(3, order="F")
            H[2] = np.zeros((3, 6), order="F")
            H[2][:, 3:] = -np.outer(np.cross(up, arm_n), up_s)
            H[3] = np.asfortranarray(slow * so3.skew(up) @ R)
        return values.atVector(V(k)) + turn * np.cross(up, arm_n) - measured

    return gtsam.CustomFactor(model, [X(k), V(k), B(k), L(0)], error)


def reference_graph(p: Problem, batch: Batch, solved: Solved, factors: gtsam.NonlinearFactorGraph):
    """The same session in GTSAM alone."""
    state, graph = solved.state, gtsam.NonlinearFactorGraph(factors)
    path = batch.path(state)
    level = state.constants.level_axes_s
    felt = expected_motion(path, level, p.noise.inertial, None, state.interval)
    rates, slow = felt.turn_rate[::N_BINS], felt.slow.turn_rate[::N_BINS]
    for t, fix, doppler in zip(p.data.t, p.data.position_n, p.data.velocity_n, strict=True):
        k = round((t - state.t[0]) / T)
        graph.add(gtsam.GPSFactorArmCalib(X(k), L(0), fix, sigmas(p.noise.position)))
        graph.add(doppler_factor(k, doppler, rates[k], slow[k], state.gyro_bias_s[k], sigmas(p.noise.velocity)))
    for k in p.data.still:
        graph.add(gtsam.PriorFactorVector(V(k), np.zeros(3), sigmas(np.full(3, 0.02))))
        no_turn = sigmas([3e-4] * 3 + [1e8] * 3)
        graph.add(gtsam.BetweenFactorPose3(X(k), X(k + 1), gtsam.Pose3(), no_turn))
    # the start's weak prior moves along with the state
    pose = gtsam.Pose3(gtsam.Rot3(state.R_ns[0]), state.position_n[0])
    graph.add(gtsam.PriorFactorPose3(X(0), pose, sigmas([3.0] * 3 + [1e4] * 3)))
    graph.add(gtsam.PriorFactorVector(V(0), state.velocity_n[0], sigmas(np.full(3, 1e3))))
    mean = gtsam.imuBias.ConstantBias(np.zeros(3), p.priors.gyro_bias_mean)
    bias_sigma = sigmas(np.repeat([p.priors.accel_bias, p.priors.gyro_bias], 3))
    graph.add(gtsam.PriorFactorConstantBias(B(0), mean, bias_sigma))
    graph.add(gtsam.PriorFactorPoint3(L(0), np.zeros(3), sigmas(np.full(3, 0.5))))
    return graph


@pytest.fixture(scope="module")
def compared() -> tuple[Problem, Solved, gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Our solution with GTSAM's slopes, and GTSAM's graph with its own, from a start off by decimetres and degrees."""
    p = problem()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(inertial, "as_expected", lambda linear, *_: linear)
        batch, solved, factors = solve(p)
    assert np.all(solved.rows["gps_position"].weight == 1.0)  # no outlier: both minimise squares
    assert np.all(solved.rows["gps_velocity"].weight == 1.0)
    graph = reference_graph(p, batch, solved, factors)
    start = gtsam.Values()
    for k, (R, p_n, v_n) in enumerate(zip(p.state.R_ns, p.state.position_n, p.state.velocity_n, strict=True)):
        start.insert(X(k), gtsam.Pose3(gtsam.Rot3(R), p_n))
        start.insert(V(k), v_n)
        start.insert(B(k), gtsam.imuBias.ConstantBias(p.state.accel_bias_s[k], p.state.gyro_bias_s[k]))
    start.insert(L(0), np.zeros(3))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    return p, solved, graph, gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()


class TestAgainstGtsam:
    def test_the_solutions_are_one(self, compared) -> None:
        _, solved, _, values = compared
        state = solved.state
        for k in range(K):
            pose, bias = values.atPose3(X(k)), values.atConstantBias(B(k))
            turn = so3.log(pose.rotation().matrix().T @ state.R_ns[k])
            np.testing.assert_allclose(turn, 0.0, atol=2e-6)
            # the filter of the yaw rate follows the path; GTSAM's factor takes its rate as it is
            np.testing.assert_allclose(pose.translation(), state.position_n[k], atol=5e-5)
            np.testing.assert_allclose(values.atVector(V(k)), state.velocity_n[k], atol=1e-5)
            np.testing.assert_allclose(bias.accelerometer(), state.accel_bias_s[k], atol=5e-5)
            np.testing.assert_allclose(bias.gyroscope(), state.gyro_bias_s[k], atol=1e-6)
        np.testing.assert_allclose(values.atPoint3(L(0)), state.constants.lever_arm_s, atol=5e-5)

    def test_what_is_left_of_inertial_factors_is_their_error(self, compared) -> None:
        _, solved, graph, values = compared
        left = left_of_inertial(solved, slice(None))
        assert {one.count for one in left.values()} == {K - 1} and {one.unit for one in left.values()} == {"sigma"}
        have = (K - 1) * (9 * left["inertial"].rms ** 2 + 6 * left["bias_walk"].rms ** 2)
        want = 2.0 * sum(graph.at(k).error(values) for k in range(K - 1))
        assert have == pytest.approx(want, rel=1e-3)

    def test_what_is_left_of_parts_is_that_of_the_whole(self, compared) -> None:
        solved = compared[1]
        parts = [left_of_inertial(solved, part) for part in (slice(0, 3), slice(3, K + 5), slice(K + 5, K + 9))]
        whole = left_of_inertial(solved, slice(None))
        assert parts[2]["inertial"].count == 0
        for name, one in joined(parts).items():
            assert one.count == whole[name].count
            assert (one.mean, one.rms) == pytest.approx((whole[name].mean, whole[name].rms))

    def test_the_covariances_are_one(self, compared) -> None:
        _, solved, graph, values = compared
        marginals, solution = gtsam.Marginals(graph, values), solved.solution
        for k in range(K):
            keys, parts = [X(k), V(k), B(k)], [slice(0, 6), slice(6, 9), slice(9, 15)]
            joint = marginals.jointMarginalCovariance(keys)
            for a, first in zip(keys, parts, strict=True):
                for b, second in zip(keys, parts, strict=True):
                    want, have = joint.at(a, b), solution.covariance[k, first, second]
                    scale = np.sqrt(np.outer(np.diag(joint.at(a, a)), np.diag(joint.at(b, b))))
                    np.testing.assert_allclose(have / scale, want / scale, atol=1e-4)
        np.testing.assert_allclose(
            solution.constants_covariance[LEVER_ARM, LEVER_ARM],
            marginals.marginalCovariance(L(0)),
            rtol=1e-3,
            atol=1e-7,
        )

    def test_neighbours_and_the_lever_arm_go_together_as_in_gtsam(self, compared) -> None:
        _, solved, graph, values = compared
        marginals, solution = gtsam.Marginals(graph, values), solved.solution
        for k in (0, 7, K - 2):
            joint = marginals.jointMarginalCovariance([X(k), X(k + 1), V(k + 1), L(0)])
            pose, velocity = slice(0, 6), VELOCITY

            def scaled(have: np.ndarray, a: int, b: int, joint=joint) -> tuple[np.ndarray, np.ndarray]:
                scale = np.sqrt(np.outer(np.diag(joint.at(a, a)), np.diag(joint.at(b, b))))
                return have / scale, joint.at(a, b) / scale

            for have, want in (
                scaled(solution.cross[k, pose, pose], X(k), X(k + 1)),
                scaled(solution.cross[k, pose, velocity], X(k), V(k + 1)),
                scaled(solution.constants_cross[k, pose, LEVER_ARM], X(k), L(0)),
            ):
                np.testing.assert_allclose(have, want, atol=1e-4)


def random_solution(n_keyframes: int) -> tuple[np.ndarray, ChainSolution]:
    """Any covariance, dense and as the chain would hold it."""
    n, m, c = KEYFRAME_SIZE, CONSTANTS_SIZE, n_keyframes * KEYFRAME_SIZE
    A = np.random.default_rng(0).normal(size=(c + m, c + m))
    P = A @ A.T / (c + m)
    blocks, k = P[:c, :c].reshape(n_keyframes, n, n_keyframes, n).transpose(0, 2, 1, 3), np.arange(n_keyframes)
    cross = P[:c, c:].reshape(n_keyframes, n, m)
    zeros = np.zeros((n_keyframes, n)), np.zeros(m)
    return P, ChainSolution(*zeros, blocks[k, k], blocks[k[:-1], k[1:]], P[c:, c:], cross)


def test_posterior_variance_of_rows_is_that_of_the_dense_covariance() -> None:
    rng, n, k = np.random.default_rng(1), KEYFRAME_SIZE, np.array([0, 2, 2, 1])
    left, right, constants = (rng.normal(size=(4, 3, size)) for size in (n, n, ROW_CONSTANTS_SIZE))
    rows = Rows("random", k, np.zeros((4, 3)), np.ones((4, 3)), left, right, constants, np.ones(4))
    P, solution = random_solution(4)
    found = posterior_variance(rows, solution)
    for row in range(4):
        J = np.zeros((3, len(P)))
        J[:, k[row] * n : (k[row] + 1) * n], J[:, (k[row] + 1) * n : (k[row] + 2) * n] = left[row], right[row]
        J[:, 4 * n : 4 * n + ROW_CONSTANTS_SIZE] = constants[row]
        np.testing.assert_allclose(found[row], np.diag(J @ P @ J.T))


class TestRobustness:
    def test_a_fix_a_street_away_moves_the_path_by_centimetres(self) -> None:
        clean = problem(1)
        position_n = clean.data.position_n.copy()
        position_n[10] += [30.0, -20.0, 0.0]
        thrown = replace(clean, data=replace(clean.data, position_n=position_n))
        _, want, _ = solve(clean)
        batch = Batch(thrown.data, thrown.binned, thrown.priors)
        found = batch.step(batch.graph(want.state, clean.noise), want.state, clean.noise)
        assert found.rows["gps_position"].weight[10] < 0.01
        moved = np.linalg.norm(found.state.position_n - want.state.position_n, axis=1)
        assert np.max(moved) < 0.3  # far below the sigma of a fix, let alone 36 m

    def test_fixes_within_three_sigma_keep_their_weight(self) -> None:
        _, solved, _ = solve(problem(1))
        assert np.all(solved.rows["gps_position"].weight == 1.0)

    def test_a_session_without_doppler_is_solved_from_positions(self) -> None:
        p = problem(0)
        blind = replace(p, data=replace(p.data, velocity_n=np.full_like(p.data.velocity_n, np.nan)))
        _, solved, _ = solve(blind, steps=20)
        assert np.all(np.isfinite(solved.solution.covariance))
        assert np.all(solved.rows["gps_velocity"].information == 0.0)


def test_what_noise_up_and_down_is_said_to_go_with_does_not_tilt_the_kart() -> None:
    """Noise of force that is the same in all directions, said to go together ahead and upwards, or the opposite.

    Fixes tell nothing of the motion up and down but where it ends. With slopes that contain its noise the two biases
    ahead part by 1.4 sigma, in every session the same way.
    """
    apart = []
    for seed in range(6):
        p, found = problem(seed, velocity=0.02, K=401), []
        rough = np.random.default_rng(100 + seed).normal(size=p.binned.specific_force_s.shape) / np.sqrt(p.binned.dt)
        binned = replace(p.binned, specific_force_s=p.binned.specific_force_s + 0.5 * rough)
        batch = Batch(replace(p.data, velocity_n=p.data.velocity_n * [1.0, 1.0, np.nan]), binned, p.priors)
        for together in (0.3, -0.3):
            shape_b = np.eye(3)
            shape_b[0, 2] = shape_b[2, 0] = together
            shape = tuple(map(tuple, (MOUNTING.T @ shape_b @ MOUNTING).tolist()))
            noise = replace(p.noise, inertial=replace(p.noise.inertial, accel=0.51, accel_shape=shape))
            state = batch.converge(batch.graph(p.state, noise), p.state, noise, 6)
            solved = batch.step(batch.graph(state, noise), state, noise)
            sigma = np.sqrt(MOUNTING[0] @ solved.solution.covariance[200, ACCEL_BIAS, ACCEL_BIAS] @ MOUNTING[0])
            found.append(float(MOUNTING[0] @ solved.state.accel_bias_s[200] / sigma))
        apart.append(found[0] - found[1])
    assert abs(np.mean(apart)) < 0.5


class TestNoise:
    @pytest.mark.parametrize("factor", [1.0 / 3.0, 3.0])
    def test_it_is_found_from_the_residuals_wherever_it_starts(self, factor: float) -> None:
        """A minute with a known noise of everything; started off by a factor of three."""
        p = problem(2, K=301)
        inertial = replace(p.noise.inertial, accel=p.noise.inertial.accel * factor, gyro=p.noise.inertial.gyro * factor)
        noise = replace(
            p.noise, inertial=inertial, position=p.noise.position * factor, velocity=p.noise.velocity / factor
        )
        batch = Batch(p.data, p.binned, p.priors)
        scatter = Scatter(p.noise.inertial.accel, p.noise.inertial.gyro)
        state = batch.converge(batch.graph(p.state, noise), p.state, noise, 5)
        for _ in range(25):  # from above the acceleration's density comes down by a few per cent a round
            solved = batch.step(batch.graph(state, noise), state, noise)
            state, noise = solved.state, update_noise(solved, noise, p.binned, scatter)
        # 150 fixes of 3 components tell their sigma to 4 %; what the solution takes up widens the others. What is usual
        # for receivers counts as a few more residuals, beside the 300 horizontal and 150 vertical ones.
        count = np.array([300.0, 300.0, 150.0])

        def with_the_usual(sigma: Array, usual: Array, worth: float) -> Array:
            return np.sqrt((count * sigma**2 + worth * usual**2) / (count + worth))

        position = with_the_usual(p.noise.position, USUAL_POSITION, USUAL_POSITION_COUNT)
        velocity = with_the_usual(p.noise.velocity, USUAL_VELOCITY, USUAL_VELOCITY_COUNT)
        np.testing.assert_allclose(noise.position, position, rtol=0.15)
        np.testing.assert_allclose(noise.velocity, velocity, rtol=0.25)
        assert noise.inertial.accel == pytest.approx(p.noise.inertial.accel, rel=0.3)
        assert noise.inertial.gyro == pytest.approx(p.noise.inertial.gyro, rel=0.3)

    @pytest.mark.parametrize("force_is_stated", [False, True])
    def test_a_receiver_much_better_than_the_samples_is_found_in_a_few_turns(self, force_is_stated: bool) -> None:
        """Velocities of 0.02 m/s, taken for 0.15, beside force whose noise adds up to 0.32 m/s from one to the next.

        Three hundred of them, of whose noise the residuals have a hundredth. Ratio by ratio it is 0.1 by then.
        """
        p = problem(3, velocity=0.02, K=601)
        rough = np.random.default_rng(7).normal(size=p.binned.specific_force_s.shape) / np.sqrt(p.binned.dt)
        binned = replace(p.binned, specific_force_s=p.binned.specific_force_s + 0.5 * rough)
        data = replace(p.data, velocity_n=p.data.velocity_n * [1.0, 1.0, np.nan])
        noise = replace(p.noise, inertial=replace(p.noise.inertial, accel=0.51), velocity=np.full(3, 0.15))
        batch, scatter = Batch(data, binned, p.priors), Scatter(0.51, p.noise.inertial.gyro)
        state = batch.converge(batch.graph(p.state, noise), p.state, noise, 5)
        doppler = DopplerNoise(0.02, 2.0 * T)
        for _ in range(8):
            solved = batch.step(batch.graph(state, noise), state, noise)
            better = update_noise(solved, noise, binned, scatter, doppler, force_is_stated=force_is_stated)
            state, noise = solved.state, better
        assert 0.01 < noise.velocity[0] < 0.05
        assert noise.inertial.accel == pytest.approx(0.51, rel=1e-9 if force_is_stated else 0.15)

    def test_velocities_that_count_for_nothing_are_as_noisy_as_usual(self) -> None:
        """Every one rejected: nothing is expected of their residuals, and nothing may be divided by that."""
        p = problem(0)
        _, solved, _ = solve(p)
        velocity = solved.rows["gps_velocity"]
        nothing = replace(velocity, weight=np.zeros(len(velocity.weight)))
        solved = replace(solved, rows={**solved.rows, "gps_velocity": nothing})
        scatter = Scatter(p.noise.inertial.accel, p.noise.inertial.gyro)
        noise = update_noise(solved, p.noise, p.binned, scatter, DopplerNoise(0.1, 2.0 * T))
        assert p.noise.velocity[0] < noise.velocity[0] <= USUAL_VELOCITY[0]

    def test_jumps_do_not_make_all_other_fixes_look_worse(self) -> None:
        """Five fixes of 150 that are off by 10 m: by less than 2 % of what the others scatter."""
        p = problem(2, position=0.2, K=301)
        scatter, found = Scatter(p.noise.inertial.accel, p.noise.inertial.gyro), []
        for jump in (0.0, 10.0):
            position_n = p.data.position_n.copy()
            position_n[20::30] += [jump, -jump, 0.0]
            batch, state, noise = Batch(replace(p.data, position_n=position_n), p.binned, p.priors), p.state, p.noise
            for _ in range(6):
                solved = batch.step(batch.graph(state, noise), state, noise)
                state, noise = solved.state, update_noise(solved, noise, p.binned, scatter)
            found.append(noise.position)
        without, with_jumps = found
        np.testing.assert_allclose(with_jumps, without, rtol=0.05)

    @pytest.mark.parametrize("polarised", [False, True])
    def test_directions_in_which_the_box_shakes_more_are_found(self, polarised: bool) -> None:
        """A minute in which force shakes four times as much along one direction as across it, or the same in all."""
        along = np.array([0.6, 0.0, 0.8])
        shape = np.eye(3) + 15.0 * np.outer(along, along) * polarised
        shape *= 3.0 / np.trace(shape)
        p = problem(2, position=0.1, velocity=0.02, K=301, shape=shape)
        scatter = Scatter(p.noise.inertial.accel, p.noise.inertial.gyro)
        batch, noise = Batch(p.data, p.binned, p.priors), p.noise
        state = batch.converge(batch.graph(p.state, noise), p.state, noise, 5)
        for _ in range(8):
            solved = batch.step(batch.graph(state, noise), state, noise)
            state, noise = solved.state, update_noise(solved, noise, p.binned, scatter)
        found = np.array(noise.inertial.accel_shape)
        assert np.trace(found) == pytest.approx(3.0)
        across = (np.trace(found) - along @ found @ along) / 2.0
        ratio = np.sqrt(along @ found @ along / across)
        if polarised:
            assert 2.0 < ratio < 5.0  # 20 residuals of each direction say one
        else:
            np.testing.assert_allclose(found, np.eye(3), atol=0.3)  # 150 fixes: a tenth of a variance

    def test_change_is_the_largest_relative_difference(self) -> None:
        noise = problem().noise
        assert noise.change(noise) == 0.0
        assert noise.change(replace(noise, position=noise.position * [1.0, 1.0, 0.5])) == pytest.approx(np.log(2.0))

    def test_no_estimate_falls_below_the_scatter_of_the_samples(self) -> None:
        p = problem(0)
        _, solved, _ = solve(p)
        better = update_noise(solved, p.noise, p.binned, Scatter(accel=5.0, gyro=0.5))
        assert (better.inertial.accel, better.inertial.gyro) == (OWN_SCATTER * 5.0, OWN_SCATTER * 0.5)

    def test_a_filtered_receiver_wanders_by_what_receivers_wander_though_the_drive_shows_less(self) -> None:
        noise, population = replace(problem().noise, offset_sigma=np.array([0.5, 0.5, 4.0])), np.array([2.0, 2.0, 3.4])
        np.testing.assert_allclose(unseen_offset(noise, population, 1000), [2.0**2 - 0.5**2, 2.0**2 - 0.5**2, 0.0])
        white = replace(noise, position=np.full(3, 2.5), offset_sigma=np.array([0.1, 0.1, 0.2]))
        np.testing.assert_array_equal(unseen_offset(white, population, 1000), np.zeros(3))
        np.testing.assert_array_equal(unseen_offset(white, population, 1000, 0.3), np.zeros(3))
        alone = unseen_offset(white, population, 1000, math.inf)  # without Doppler nothing would show an offset
        np.testing.assert_allclose(alone, population**2 - white.offset_sigma**2)
        few = 20  # whose mean is no judge of an offset of two metres
        np.testing.assert_allclose(unseen_offset(white, population, few), population**2 - white.offset_sigma**2)
        wanders = replace(noise, position=np.full(3, 2.5), offset_sigma=np.array([0.8, 0.8, 1.4]))
        np.testing.assert_allclose(unseen_offset(wanders, population, 1000), population**2 - wanders.offset_sigma**2)
        long = replace(noise, offset_tau_spread=0.2)
        np.testing.assert_array_equal(unseen_offset(long, population, 1000), np.zeros(3))


def test_ground_stands_in_for_heights_where_none_is_near() -> None:
    t = np.arange(0.0, 100.0, 0.2)
    at, height = session_rows.ground.far_from_heights(np.empty((0, 2)), t)
    np.testing.assert_array_equal(at, np.arange(len(t) - 1))
    np.testing.assert_array_equal(height, 0.0)
    heights = np.array([[10.0, 5.0], [11.0, 5.2], [12.0, 900.0], [13.0, 5.1], [14.0, 5.3], [90.0, 7.0]])
    at, height = session_rows.ground.far_from_heights(heights, t)
    np.testing.assert_array_equal(t[at], t[(t > 34.0 + 1e-9) & (t < 70.0 - 1e-9)])
    assert height[0] == pytest.approx(5.3, abs=2.0)  # not 900
    assert height[-1] == pytest.approx(7.0, abs=2.0)
