"""What is known between keyframes, against what their joint covariance and the noise of the samples say."""

from dataclasses import replace

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph.batch import Solved
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.output.dense_rows import DenseRows, _between_samples, _bridge
from smoother.estimate.graph.imu import BinnedImu
from smoother.estimate.graph.inertial import LinearInertial
from smoother.estimate.graph.inertial_noise import InertialNoise
from smoother.estimate.graph.inputs import Noise
from smoother.estimate.graph.state import (
    CONSTANTS_SIZE,
    KEYFRAME_SIZE,
    LEVER_ARM,
    TRANSLATION,
    VELOCITY,
    ChainState,
    Constants,
)
from smoother.estimate.output.uncertainty import bend_covariance, track_variance, uncertainty_of

K, T = 4, 0.2
TIMES = np.linspace(0.0, (K - 1) * T, K)
MOVED = slice(TRANSLATION.start, VELOCITY.stop)


def chain(R_ns: Array) -> ChainState:
    at_rest = np.zeros((K, 3))
    return ChainState(TIMES, R_ns, at_rest, at_rest, at_rest, at_rest, at_rest, Constants(0.0, 0.0, at_rest[0]))


def test_between_two_known_ends_velocity_is_unsure_by_the_integral_of_the_noise() -> None:
    rng = np.random.default_rng(3)
    R_ns, shape = so3.exp(rng.normal(size=(K, 3))), ((0.5, 0.0, 0.0), (0.0, 1.0, 0.2), (0.0, 0.2, 1.5))
    steps = 2000  # of white force, from one keyframe to the next
    dt = T / steps
    velocity = dt * np.tri(steps)  # at the end of each step, of the force in each
    position = dt * np.tri(steps) @ velocity
    ends, halfway = np.stack([velocity[-1], position[-1]]), velocity[steps // 2 - 1]
    left = halfway - halfway @ ends.T @ np.linalg.solve(ends @ ends.T, ends)
    no, density = np.zeros((K - 1, 1, 3)), 0.7
    binned = BinnedImu(TIMES, T, no, no, np.zeros(K - 1))
    noise = InertialNoise(density, 1.0, 0.0, 0.0, accel_shape=shape)
    want = density**2 / dt * (left @ left) * R_ns[:-1] @ np.array(shape) @ R_ns[:-1].transpose(0, 2, 1)
    np.testing.assert_allclose(_between_samples(binned, noise, R_ns)[:-1], want, atol=5e-3 * want.max())


def test_the_bend_is_the_covariance_of_the_cubic_less_the_mean_of_its_ends() -> None:
    rng = np.random.default_rng(4)
    R_ns = so3.exp(rng.normal(size=(K, 3)))
    root = rng.normal(size=(K * KEYFRAME_SIZE, 2 * K * KEYFRAME_SIZE)) * 1e-2
    joint = (root @ root.T).reshape(K, KEYFRAME_SIZE, K, KEYFRAME_SIZE)
    k, m = np.arange(K), CONSTANTS_SIZE
    own, cross = joint[k, :, k], joint[k[:-1], :, k[1:]]
    no = np.zeros((K, KEYFRAME_SIZE))
    solution = ChainSolution(no, np.zeros(m), own, cross, np.eye(m), np.zeros((K, KEYFRAME_SIZE, m)))
    errors = root.reshape(K, KEYFRAME_SIZE, -1)
    position, velocity = R_ns @ errors[:, TRANSLATION], errors[:, VELOCITY]
    halfway = 1.5 / T * (position[1:] - position[:-1]) - 0.25 * (velocity[1:] + velocity[:-1])
    bend = bend_covariance(chain(R_ns), solution)
    for i in range(K - 1):
        middle, first, second = (x @ x.T for x in (halfway[i], velocity[i], velocity[i + 1]))
        np.testing.assert_allclose(bend[i], middle - 0.5 * (first + second), rtol=1e-9, atol=1e-12)


def test_the_line_is_that_of_the_antenna_whose_arm_errs_with_the_motion() -> None:
    rng = np.random.default_rng(6)
    state = chain(so3.exp(rng.normal(size=(K, 3))))
    state = replace(state, constants=replace(state.constants, lever_arm_s=np.array([-0.5, 0.4, 0.3])))
    size, m = K * KEYFRAME_SIZE, CONSTANTS_SIZE
    root = rng.normal(size=(size + m, 2 * size)) * 1e-2
    of_keyframes, of_constants = root[:size].reshape(K, KEYFRAME_SIZE, -1), root[size:]
    own, cross = (
        np.einsum("kir,kjr->kij", one, other)
        for one, other in ((of_keyframes, of_keyframes), (of_keyframes[:-1], of_keyframes[1:]))
    )
    no = np.zeros((K, KEYFRAME_SIZE))
    with_constants = np.einsum("kir,jr->kij", of_keyframes, of_constants)
    solution = ChainSolution(no, np.zeros(m), own, cross, of_constants @ of_constants.T, with_constants)
    step, line = 1e-3, np.empty((K, 2, 2 * size))
    for i, error in enumerate(step * root.T):
        moved = state.retract(error[:size].reshape(K, KEYFRAME_SIZE), error[size:])
        antenna = moved.position_n + moved.R_ns @ moved.constants.lever_arm_s + moved.offset_n
        line[:, :, i] = (antenna - state.position_n - state.R_ns @ state.constants.lever_arm_s)[:, :2] / step
    variance = track_variance(state, solution)
    np.testing.assert_allclose(variance[:, 0], 0.5 * np.sum(line**2, axis=(1, 2)), rtol=1e-3)
    np.testing.assert_allclose(variance[:-1, 1], 0.5 * np.sum(line[:-1] * line[1:], axis=(1, 2)), rtol=2e-3, atol=1e-4)


def test_the_antenna_errs_with_attitude_motion_and_arm() -> None:
    """Turning, by numerical slopes of where the antenna is and how fast it goes; the rate itself is held."""
    rng = np.random.default_rng(8)
    R_ns = so3.exp(rng.normal(size=3)) @ so3.exp(T * np.arange(K)[:, None] * np.array([0.3, -0.2, 1.5]))
    arm_s, size, m = np.array([-0.5, 0.4, 0.3]), K * KEYFRAME_SIZE, CONSTANTS_SIZE
    state = chain(R_ns)
    state = replace(state, constants=replace(state.constants, lever_arm_s=arm_s))
    root = rng.normal(size=(size + m, 2 * size)) * 1e-2
    of_keyframes, of_constants = root[:size].reshape(K, KEYFRAME_SIZE, -1), root[size:]
    own = np.einsum("kir,kjr->kij", of_keyframes, of_keyframes)
    cross = np.einsum("kir,kjr->kij", of_keyframes[:-1], of_keyframes[1:])
    with_constants = np.einsum("kir,jr->kij", of_keyframes, of_constants)
    no = np.zeros((K, KEYFRAME_SIZE))
    solution = ChainSolution(no, np.zeros(m), own, cross, of_constants @ of_constants.T, with_constants)
    solved = Solved(state, state, solution, LinearInertial(np.empty((K - 1, 15, 46))), {})
    antenna = uncertainty_of(solved, None).antenna
    for k in range(K):
        turn_n = R_ns[k] @ [0.3, -0.2, 1.5]

        def errors(x: Array, R: Array = R_ns[k], turn_n: Array = turn_n) -> Array:
            turned = so3.exp(R @ x[0:3])
            arm_n = R @ (arm_s + x[9:12])
            return np.concatenate([R @ x[0:3], x[6:9] + turned @ np.cross(turn_n, arm_n), R @ x[3:6] + turned @ arm_n])

        J = so3.numerical_jacobian(errors, np.zeros(12))
        moved = J @ np.concatenate([of_keyframes[k, :9], of_constants[LEVER_ARM]])
        np.testing.assert_allclose(antenna[k], moved @ moved.T, rtol=1e-5, atol=1e-8)


def test_the_line_is_unsure_by_the_walk_of_the_offset_but_for_what_a_fix_tells_of_it() -> None:
    rng, n, sigma, tau, white, before = np.random.default_rng(5), 400_000, 2.0, 60.0, 0.2, 0.15
    phi = np.exp(-0.5 * T / tau)  # to the middle of the interval, and on
    start = sigma * rng.normal(size=n)
    middle = phi * start + sigma * np.sqrt(1.0 - phi**2) * rng.normal(size=n)
    end = phi * middle + sigma * np.sqrt(1.0 - phi**2) * rng.normal(size=n)
    walked = middle - 0.5 * (start + end)
    noise_of_fix = white**2 + np.var(walked)  # all of it, as it is found from residuals
    gain = before**2 / (before**2 + noise_of_fix)
    error = before * rng.normal(size=n)  # of the line, that of the graph, before the fix
    seen = walked + white * rng.normal(size=n)
    after = error + gain * (seen - error)
    line = (1.0 - gain) * before**2
    noise = Noise(
        InertialNoise(0.5, 0.01, 0.0, 0.0),
        np.full(3, np.sqrt(noise_of_fix)),
        np.full(3, 0.1),
        np.full(3, sigma),
        tau,
        np.zeros(3),
    )
    want = np.var(after - walked) - line
    np.testing.assert_allclose(_bridge(np.array([line]), noise, T), want, rtol=0.05)
    assert want < 0.8 * np.var(walked)


def test_who_does_not_know_when_does_not_know_how_fast_either() -> None:
    """A sample that is true 10 ms later has the velocity of then: of a kart that brakes at 5 m/s^2 and turns at 10."""
    rows = DenseRows.empty(1)
    for values in rows.sigmas.values():
        values[...] = 0.05
    rows.velocity_n[...], rows.R_nb[...] = [0.0, 20.0, 0.0], so3.exp(np.array([0.0, 0.0, np.pi / 2.0]))
    rows.acceleration_b[...] = [-5.0, 10.0, 0.0]
    rows.unsure_of_time(slice(0, 1), 0.01)
    beside = 0.05
    np.testing.assert_allclose(rows.sigmas["position_n"], [[beside, np.hypot(beside, 0.2), beside]])
    np.testing.assert_allclose(rows.sigmas["velocity_n"], [[np.hypot(beside, 0.1), np.hypot(beside, 0.05), beside]])
    np.testing.assert_allclose(rows.sigmas["speed"], [np.hypot(beside, 0.05)])
    np.testing.assert_array_equal(rows.sigmas["attitude"], beside)


def test_who_does_not_know_when_does_not_know_where_the_nose_is() -> None:
    rows = DenseRows.empty(1)
    for values in rows.sigmas.values():
        values[...] = 0.05
    rows.velocity_n[...], rows.acceleration_b[...], rows.R_nb[...] = 0.0, 0.0, np.eye(3)
    rows.angular_rate_b[...] = [0.0, 0.5, 2.0]
    rows.unsure_of_time(slice(0, 1), 0.0, 0.1)
    np.testing.assert_allclose(rows.sigmas["attitude"], [[0.05, np.hypot(0.05, 0.05), np.hypot(0.05, 0.2)]])
