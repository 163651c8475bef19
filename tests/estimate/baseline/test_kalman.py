import numpy as np
import pytest

from smoother.estimate.baseline.kalman import (
    START_ACCELERATION,
    START_POSITION,
    START_VELOCITY,
    KalmanInput,
    run_kalman,
)

H_FIX_AND_IMU = np.zeros((4, 6))  # eq. 2.62
H_FIX_AND_IMU[[0, 1, 2, 3], [0, 1, 4, 5]] = 1.0
H_IMU = H_FIX_AND_IMU[2:]  # eq. 2.65


def model(dt, alpha):
    """A and Q typed from eq. 2.51 and 2.54."""
    A = np.array(
        [
            [1, 0, dt, 0, dt**2 / 2, 0],
            [0, 1, 0, dt, 0, dt**2 / 2],
            [0, 0, 1, 0, dt, 0],
            [0, 0, 0, 1, 0, dt],
            [0, 0, 0, 0, 1, 0],
            [0, 0, 0, 0, 0, 1],
        ]
    )
    a, b, c = dt**4 / 4, dt**3 / 2, dt**2 / 2
    Q = alpha * np.array(
        [
            [a, 0, b, 0, c, 0],
            [0, a, 0, b, 0, c],
            [b, 0, dt**2, 0, dt, 0],
            [0, b, 0, dt**2, 0, dt],
            [c, 0, dt, 0, 1, 0],
            [0, c, 0, dt, 0, 1],
        ]
    )
    return A, Q


def start_covariance():
    sigmas = [START_POSITION] * 2 + [START_VELOCITY] * 2 + [START_ACCELERATION] * 2
    return np.diag(np.square(sigmas))


def random_input(seed, steps=200, delay=0.0):
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(2, 2))
    acceleration = 3.0 * rng.normal(size=(steps, 2))
    acceleration[60:75] = np.nan
    at_step = np.sort(rng.choice(steps, 30, replace=False))
    at_step[0] = 0
    return KalmanInput(
        step=0.02,
        acceleration=acceleration,
        accel_covariance=B @ B.T + 0.1 * np.eye(2),
        at_step=at_step,
        delay=rng.uniform(-0.01, 0.01, 30) * delay,
        position=5.0 * rng.normal(size=(30, 2)),
        fix_variance=rng.uniform(0.1, 9.0, 30),
    )


def textbook(data, alpha):
    """Eq. 2.49-2.69 with 6 x 6 matrices and inverses, as printed."""
    A, Q = model(data.step, alpha)
    X, P = np.zeros(6), start_covariance()
    X[:2] = data.position[0]
    states, covariances = [], []
    for k in range(len(data.acceleration)):
        if k:
            X, P = A @ X, A @ P @ A.T + Q
        fix = np.flatnonzero(data.at_step == k)
        has_imu = np.isfinite(data.acceleration[k, 0])
        R = np.zeros((4, 4))
        R[2:, 2:] = data.accel_covariance
        if fix.size:
            H, Y = H_FIX_AND_IMU, np.concatenate([data.position[fix[0]], data.acceleration[k]])
            R[:2, :2] = data.fix_variance[fix[0]] * np.eye(2)
        else:
            H, Y, R = H_IMU, data.acceleration[k], R[2:, 2:]
        if not has_imu:
            H, Y, R = (H[:2], Y[:2], R[:2, :2]) if fix.size else (None, None, None)
        if H is not None:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            P, X = (np.eye(6) - K @ H) @ P, X + K @ (Y - H @ X)
        states.append(X)
        covariances.append(P)
    return np.array(states), np.array(covariances)


@pytest.mark.parametrize(("alpha", "seed"), [(0.003, 1), (0.3, 2), (30.0, 3), (0.1, 4)])
def test_it_equals_the_printed_six_state_filter_with_its_two_h_and_r_matrices(alpha, seed):
    data = random_input(seed)
    found = run_kalman(data, alpha)
    states, covariances = textbook(data, alpha)
    np.testing.assert_allclose(found.position, states[:, :2], atol=1e-6)
    np.testing.assert_allclose(found.velocity, states[:, 2:4], atol=1e-6)
    np.testing.assert_allclose(found.acceleration, states[:, 4:], atol=1e-6)
    np.testing.assert_allclose(found.position_covariance, covariances[:, :2, :2], rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(found.velocity_covariance, covariances[:, 2:4, 2:4], rtol=1e-5, atol=1e-8)


def test_the_last_state_equals_a_dense_least_squares_solution_of_all_equations():
    data, alpha = random_input(2, steps=40), 0.3
    A, Q = model(data.step, alpha)
    Q = Q + 1e-9 * np.diag([1e-4, 1e-4, 1e-2, 1e-2, 1.0, 1.0])  # eq. 2.54 has rank two; this makes it invertible
    n = len(data.acceleration)
    rows, targets = [], []

    def add(blocks, target, covariance):
        row = np.zeros((len(target), 6 * n))
        for k, block in blocks:
            row[:, 6 * k : 6 * k + 6] = block
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        rows.append(root @ row)
        targets.append(root @ target)

    first = np.zeros(6)
    first[:2] = data.position[0]
    add([(0, np.eye(6))], first, start_covariance())
    for k in range(1, n):
        add([(k, np.eye(6)), (k - 1, -A)], np.zeros(6), Q)
    for k in range(n):
        add([(k, H_IMU)], data.acceleration[k], data.accel_covariance)
    for k, position, variance in zip(data.at_step, data.position, data.fix_variance, strict=True):
        add([(k, H_FIX_AND_IMU[:2])], position, variance * np.eye(2))
    J, z = np.vstack(rows), np.concatenate(targets)
    solution = np.linalg.lstsq(J, z, rcond=None)[0][-6:]
    found = run_kalman(data, alpha)
    # the extra 1e-9 and the condition of the dense matrix leave 1e-4
    np.testing.assert_allclose(found.position[-1], solution[:2], atol=1e-3)
    np.testing.assert_allclose(found.velocity[-1], solution[2:4], atol=1e-3)
    np.testing.assert_allclose(found.acceleration[-1], solution[4:], atol=1e-3)


def motion_of(rng, steps=3000, step=0.02, period=10, sigma_fix=2.0, sigma_accel=0.5, alpha=0.01):
    """A truth drawn from the filter's own model, and its measurements."""
    A, _ = model(step, alpha)
    noise = np.kron([step**2 / 2, step, 1.0], np.ones(2))
    X, states = np.concatenate([np.zeros(2), 5.0 * rng.normal(size=2), rng.normal(size=2)]), []
    for k in range(steps):
        X = A @ X + noise * np.tile(np.sqrt(alpha) * rng.normal(size=2), 3) if k else X
        states.append(X)
    states = np.array(states)
    at_step = np.arange(0, steps, period)
    data = KalmanInput(
        step=step,
        acceleration=states[:, 4:] + sigma_accel * rng.normal(size=(steps, 2)),
        accel_covariance=sigma_accel**2 * np.eye(2),
        at_step=at_step,
        delay=np.zeros(at_step.size),
        position=states[at_step, :2] + sigma_fix * rng.normal(size=(at_step.size, 2)),
        fix_variance=np.full(at_step.size, sigma_fix**2),
    )
    return data, states


def test_its_covariance_is_honest_when_its_model_is_true():
    rng = np.random.default_rng(3)
    nees = []
    for _ in range(20):
        data, states = motion_of(rng)
        found = run_kalman(data, 0.01)
        for k in (1500, 2999):  # seconds apart, longer than the filter remembers
            for error, covariance in (
                (found.position[k] - states[k, :2], found.position_covariance[k]),
                (found.velocity[k] - states[k, 2:4], found.velocity_covariance[k]),
            ):
                nees.append(error @ np.linalg.solve(covariance, error))
    # 80 chi-squares of 2 degrees, pairs of position and velocity correlated: mean 2, deviation at most 0.32
    assert 1.1 < np.mean(nees) < 2.9


def test_it_is_better_than_the_fixes_when_its_model_is_true():
    data, states = motion_of(np.random.default_rng(4))
    found = run_kalman(data, 0.01)
    error = np.sqrt(np.mean((found.position[500:] - states[500:, :2]) ** 2))
    assert error < 0.4 * 2.0


@pytest.mark.parametrize("delay", [-0.01, 0.008])
def test_a_fix_between_two_steps_counts_at_its_own_time(delay):
    steps, speed = 2000, 20.0
    at_step = np.arange(0, steps, 10)
    position = np.stack([speed * (at_step * 0.02 + delay), np.zeros(at_step.size)], axis=1)
    data = KalmanInput(
        0.02, np.zeros((steps, 2)), np.eye(2), at_step, np.full(at_step.size, delay), position, np.ones(at_step.size)
    )
    found = run_kalman(data, 0.01)
    # left out, the position would be off by speed * delay = 0.2 m
    np.testing.assert_allclose(found.position[-1, 0], speed * (steps - 1) * 0.02, atol=1e-3)


def test_without_any_fix_it_dead_reckons_from_zero_with_growing_sigmas():
    data = KalmanInput(
        0.02,
        np.tile([1.0, 0.0], (50, 1)),
        1e-6 * np.eye(2),
        np.zeros(0, dtype=np.int64),
        np.zeros(0),
        np.zeros((0, 2)),
        np.zeros(0),
    )
    found = run_kalman(data, 1e-6)
    np.testing.assert_allclose(found.velocity[-1], [0.98, 0.0], atol=1e-3)
    assert np.sqrt(found.position_covariance[-1, 0, 0]) >= START_POSITION


def test_without_accelerations_the_fixes_alone_are_filtered():
    at_step = np.arange(0, 1000, 10)
    t = at_step * 0.02
    position = np.stack([3.0 * t, -1.0 * t], axis=1)
    data = KalmanInput(
        0.02, np.full((1000, 2), np.nan), np.eye(2), at_step, np.zeros(100), position, np.full(100, 0.01)
    )
    found = run_kalman(data, 0.01)
    np.testing.assert_allclose(found.velocity[-1], [3.0, -1.0], atol=0.01)


def test_two_fixes_in_one_step_both_count():
    one = KalmanInput(0.02, np.zeros((3, 2)), np.eye(2), np.array([0]), np.zeros(1), np.ones((1, 2)), np.full(1, 2.0))
    two = KalmanInput(
        0.02, np.zeros((3, 2)), np.eye(2), np.array([0, 0]), np.zeros(2), np.ones((2, 2)), np.full(2, 2.0)
    )
    ratio = run_kalman(one, 0.1).position_covariance[0, 0, 0] / run_kalman(two, 0.1).position_covariance[0, 0, 0]
    assert abs(ratio - 2.0) < 1e-4
