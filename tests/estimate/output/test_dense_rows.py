"""What is known between keyframes, against what their joint covariance and the noise of the samples say."""

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.model.noise import InertialNoise
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE, KEYFRAME_SIZE, TRANSLATION, VELOCITY, State
from smoother.estimate.output.dense_rows import DenseRows, _between_samples
from smoother.estimate.output.estimated import antenna_covariance, bend_covariance, track_variance
from smoother.estimate.solvers.covariance import Covariances

from .still_state import state_of

K, T = 4, 0.2
TIMES = np.linspace(0.0, (K - 1) * T, K)


def drawn(rng: np.random.Generator) -> tuple[Array, Covariances]:
    """Errors of a random joint distribution as square root (K 18 + C, r), and its covariances."""
    root = rng.normal(size=(K * KEYFRAME_SIZE + CONSTANTS_SIZE, 2 * K * KEYFRAME_SIZE)) * 1e-2
    x, c = root[: K * KEYFRAME_SIZE].reshape(K, KEYFRAME_SIZE, -1), root[K * KEYFRAME_SIZE :]
    own, neighbours = np.einsum("kir,kjr->kij", x, x), np.einsum("kir,kjr->kij", x[:-1], x[1:])
    return root, Covariances(own, neighbours, c @ c.T, np.einsum("kir,jr->kij", x, c))


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
    root, covariances = drawn(rng)
    errors = root[: K * KEYFRAME_SIZE].reshape(K, KEYFRAME_SIZE, -1)
    position, velocity = R_ns @ errors[:, TRANSLATION], errors[:, VELOCITY]
    halfway = 1.5 / T * (position[1:] - position[:-1]) - 0.25 * (velocity[1:] + velocity[:-1])
    bend = bend_covariance(state_of(TIMES, R_ns), covariances)
    for i in range(K - 1):
        middle, first, second = (x @ x.T for x in (halfway[i], velocity[i], velocity[i + 1]))
        np.testing.assert_allclose(bend[i], middle - 0.5 * (first + second), rtol=1e-9, atol=1e-12)


def antenna(state: State, k: int, x: Array) -> Array:
    """Error in n (12,) of attitude, velocity and position of the antenna and of the line, by a tangent (18 + C,)."""
    R, arm_s = state.R_ns[k], state.constants["lever_arm"]
    turned, arm_n = so3.exp(R @ x[0:3]), R @ (arm_s + x[KEYFRAME_SIZE:][COLUMNS["lever_arm"]])
    position = R @ x[TRANSLATION] + turned @ arm_n - R @ arm_s
    velocity = x[VELOCITY] + turned @ np.cross(R @ TURN, arm_n)
    return np.concatenate([R @ x[0:3], velocity, position, position + x[15:18]])


TURN = np.array([0.3, -0.2, 1.5])


def test_antenna_and_line_err_with_attitude_motion_and_arm() -> None:
    """By numerical slopes of where the antenna is and how fast it goes; the rate itself is held."""
    rng = np.random.default_rng(8)
    R_ns = so3.exp(rng.normal(size=3)) @ so3.exp(T * np.arange(K)[:, None] * TURN)
    state = state_of(TIMES, R_ns, lever_arm=np.array([-0.5, 0.4, 0.3]))
    root, covariances = drawn(rng)
    found, track, size = antenna_covariance(state, covariances, None), track_variance(state, covariances), KEYFRAME_SIZE
    errors = np.empty((K, 12, root.shape[1]))
    for k in range(K):
        J = so3.numerical_jacobian(lambda x, k=k: antenna(state, k, x), np.zeros(size + CONSTANTS_SIZE))
        errors[k] = J @ np.concatenate([root[k * size : (k + 1) * size], root[K * size :]])
    wanted = np.einsum("kir,kjr->kij", errors[:, :9], errors[:, :9])
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-8)
    line = errors[:, 9:11]
    np.testing.assert_allclose(track[:, 0], 0.5 * np.sum(line**2, axis=(1, 2)), rtol=1e-5)
    np.testing.assert_allclose(track[:-1, 1], 0.5 * np.sum(line[:-1] * line[1:], axis=(1, 2)), rtol=1e-4, atol=1e-7)


def test_uncertain_times_widen_the_sigma_of_velocity() -> None:
    """A sample that is true 10 ms later has the velocity of then: of a kart that brakes at 5 m/s^2 and turns at 10."""
    rows = DenseRows.empty(1)
    for values in rows.sigmas.values():
        values[...] = 0.05
    rows.velocity_n[...], rows.R_nb[...] = [0.0, 20.0, 0.0], so3.exp(np.array([0.0, 0.0, np.pi / 2.0]))
    rows.acceleration_b[...] = [-5.0, 10.0, 0.0]
    rows.add_time_uncertainty(slice(0, 1), 0.01)
    beside = 0.05
    np.testing.assert_allclose(rows.sigmas["position_n"], [[beside, np.hypot(beside, 0.2), beside]])
    np.testing.assert_allclose(rows.sigmas["velocity_n"], [[np.hypot(beside, 0.1), np.hypot(beside, 0.05), beside]])
    np.testing.assert_allclose(rows.sigmas["speed"], [np.hypot(beside, 0.05)])
    np.testing.assert_array_equal(rows.sigmas["attitude"], beside)


def test_uncertain_times_widen_the_sigma_of_heading() -> None:
    rows = DenseRows.empty(1)
    for values in rows.sigmas.values():
        values[...] = 0.05
    rows.velocity_n[...], rows.acceleration_b[...], rows.R_nb[...] = 0.0, 0.0, np.eye(3)
    rows.angular_rate_b[...] = [0.0, 0.5, 2.0]
    rows.add_time_uncertainty(slice(0, 1), 0.0, 0.1)
    np.testing.assert_allclose(rows.sigmas["attitude"], [[0.05, np.hypot(0.05, 0.05), np.hypot(0.05, 0.2)]])
