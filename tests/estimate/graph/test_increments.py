"""Residuals and Jacobians of the intervals against GTSAM's own factors, and their matrices against numbers."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X

from smoother import so3
from smoother.estimate.graph.chain import inverse_of_lower
from smoother.estimate.graph.imu import BinnedImu
from smoother.estimate.graph.increments import (
    Increments,
    as_expected,
    in_left_axes,
    increments,
    left_jacobian_inverse,
    linearize_increments,
    right_jacobian,
    slope_of_inverse,
)
from smoother.estimate.graph.inertial import inertial_factors
from smoother.estimate.graph.inertial_noise import InertialNoise
from smoother.estimate.graph.preintegration import preintegrate
from smoother.estimate.graph.state import ChainState, Constants
from smoother.frames import GRAVITY_N

K, T, N_BINS = 4, 0.2, 5
NOISE = InertialNoise(0.3, 0.02, 0.01, 0.002)
BIASES = np.array([0.1, -0.2, 0.15]), np.array([0.02, -0.05, 0.03])
# columns of a linearised CombinedImuFactor, whose keys are X V X V B B, in the order of left and right keyframe
COLUMNS = np.r_[0:6, 6:9, 18:24, 9:15, 15:18, 24:30]
TURNS = [0.0, 1e-9, 1e-3, 0.0099, 0.0101, 0.099, 0.101, 0.5, 2.0, 3.0]


class Drive:
    """Intervals of random motion, and keyframes that disagree with it by `crooked` rad, m and m/s."""

    def __init__(self, seed: int, crooked: float) -> None:
        rng = np.random.default_rng(seed)
        force = rng.normal(size=(K - 1, N_BINS, 3)) * 2.0 + [1.0, 3.0, 9.8]
        rate = rng.normal(size=(K - 1, N_BINS, 3)) * 0.2 + [0.1, -0.2, 1.5]
        self.binned = BinnedImu(T * np.arange(K), T / N_BINS, force, rate, np.zeros(K - 1))
        self.measured = preintegrate(self.binned, NOISE, *BIASES)
        states = [gtsam.NavState(gtsam.Rot3(so3.exp(rng.normal(size=3))), rng.normal(size=3), 5.0 * rng.normal(size=3))]
        for measured in self.measured:
            states.append(measured.predict(states[-1], gtsam.imuBias.ConstantBias(*BIASES)))
        self.state = ChainState(
            self.binned.t,
            np.array([s.attitude().matrix() for s in states]) @ so3.exp(crooked * rng.normal(size=(K, 3))),
            np.array([s.position() for s in states]) + crooked * rng.normal(size=(K, 3)),
            np.array([s.velocity() for s in states]) + crooked * rng.normal(size=(K, 3)),
            BIASES[0] + 0.05 * rng.normal(size=(K, 3)),
            BIASES[1] + 0.01 * rng.normal(size=(K, 3)),
            np.zeros((K, 3)),
            Constants(0.0, 0.0, np.zeros(3)),
        )

    def values(self) -> gtsam.Values:
        values, s = gtsam.Values(), self.state
        for k in range(K):
            values.insert(X(k), gtsam.Pose3(gtsam.Rot3(s.R_ns[k]), s.position_n[k]))
            values.insert(V(k), s.velocity_n[k])
            values.insert(B(k), gtsam.imuBias.ConstantBias(s.accel_bias_s[k], s.gyro_bias_s[k]))
        return values

    def increments(self) -> Increments:
        return increments(self.binned, *BIASES)


@pytest.mark.parametrize("seed", range(2))
def test_increments_are_gtsam_s(seed: int) -> None:
    drive = Drive(seed, 0.0)
    done = drive.increments()
    for k, measured in enumerate(drive.measured):
        np.testing.assert_allclose(so3.exp(done.turn[k]), measured.deltaRij().matrix(), atol=1e-13)
        np.testing.assert_allclose(done.shift[k], [measured.deltaPij(), measured.deltaVij()], atol=1e-13)


@pytest.mark.parametrize("crooked", [0.0, 0.01, 1.0])
@pytest.mark.parametrize("seed", range(2))
def test_residuals_and_jacobians_are_gtsam_s(seed: int, crooked: float) -> None:
    drive = Drive(seed, crooked)
    factors, values, J = inertial_factors(drive.measured), drive.values(), np.zeros((K - 1, 15, 30))
    linear = linearize_increments(drive.increments(), drive.state)
    linear.put(J, slice(0, K - 1))
    for k in range(K - 1):
        factor = factors.at(k)
        np.testing.assert_allclose(linear.residual[k], factor.unwhitenedError(values), atol=1e-11)
        whitened = factor.linearize(values).augmentedJacobian()[:, COLUMNS]
        np.testing.assert_allclose(J[k], np.linalg.solve(factor.noiseModel().R(), whitened), atol=1e-10)


@pytest.mark.parametrize("expected", [1.0, 0.3, 0.0])
@pytest.mark.parametrize("seed", range(2))
def test_attitudes_turn_what_the_path_is_expected_to_feel(seed: int, expected: float) -> None:
    """Both ends turned by the same small turn in n: change of the residual of velocity, in n.

    expected: share of what the keyframes accelerate by that is not noise.
    """
    drive, J = Drive(seed, 0.0), np.zeros((K - 1, 15, 30))
    accel_bias, gyro_bias = (np.tile(bias, (K, 1)) for bias in BIASES)  # so that keyframes and samples agree
    state = replace(drive.state, accel_bias_s=accel_bias, gyro_bias_s=gyro_bias)
    R, change = state.R_ns, np.diff(state.velocity_n, axis=0)
    linear = linearize_increments(drive.increments(), state)
    as_expected(linear, state, expected * change / T).put(J, slice(0, K - 1))
    assert np.all(np.abs(change[:, 2]) > 0.01)  # it does not stay level
    for k in range(K - 1):
        turned = R[k + 1] @ (J[k, 6:9, 0:3] @ R[k].T + J[k, 6:9, 15:18] @ R[k + 1].T)
        felt = expected * change[k] - T * GRAVITY_N
        np.testing.assert_allclose(turned, -so3.skew(felt), atol=1e-9)


def test_a_kart_that_stays_level_has_gtsam_s_slopes() -> None:
    drive = Drive(0, 0.0)
    velocity_n, position_n = drive.state.velocity_n.copy(), drive.state.position_n.copy()
    velocity_n[:, 2] = 0.3  # a slope
    position_n[:, 2] = 0.3 * drive.state.t
    state = replace(drive.state, velocity_n=velocity_n, position_n=position_n)
    linear = linearize_increments(drive.increments(), state)
    found = as_expected(linear, state, np.diff(velocity_n, axis=0) / T)
    for rows in (0, 2):  # turn and velocity; position as at steady acceleration
        np.testing.assert_allclose(found.by_rotation_left[:, rows], linear.by_rotation_left[:, rows], atol=1e-12)


def test_a_kart_that_accelerates_steadily_as_expected_has_gtsam_s_slopes() -> None:
    drive = Drive(1, 0.0)
    acceleration_n, t = np.array([4.0, -7.0, 0.5]), drive.state.t[:, None]
    state = replace(
        drive.state,
        velocity_n=drive.state.velocity_n[0] + acceleration_n * t,
        position_n=drive.state.position_n[0] + drive.state.velocity_n[0] * t + 0.5 * acceleration_n * t**2,
    )
    linear = linearize_increments(drive.increments(), state)
    found = as_expected(linear, state, np.tile(acceleration_n, (K - 1, 1)))
    np.testing.assert_allclose(found.by_rotation_left, linear.by_rotation_left, atol=1e-12)


def test_a_part_of_the_intervals_is_that_part_of_all() -> None:
    drive, J, some = Drive(0, 0.01), np.zeros((K - 1, 15, 30)), np.zeros((1, 15, 30))
    linear = linearize_increments(drive.increments(), drive.state)
    linear.put(J, slice(0, K - 1))
    linear.put(some, slice(1, 2))
    np.testing.assert_array_equal(some, J[1:2])


def test_whitening_belongs_to_the_covariance_that_gtsam_gives_its_residuals() -> None:
    drive = Drive(0, 0.0)
    covariance = np.array([m.preintMeasCov() for m in drive.measured])
    white = in_left_axes(drive.increments(), inverse_of_lower(np.linalg.cholesky(covariance)), slice(0, K - 1))
    for W, measured in zip(white, drive.measured, strict=True):
        np.testing.assert_allclose(W @ measured.residualCovariance() @ W.T, np.eye(15), atol=1e-9)


@pytest.mark.parametrize("angle", TURNS)
class TestMatricesOfATurn:
    def turn(self, angle: float) -> np.ndarray:
        return angle * np.array([2.0, -1.0, 2.0]) / 3.0

    def test_the_right_jacobian_is_the_numerical_one(self, angle: float) -> None:
        turn = self.turn(angle)
        J = so3.numerical_jacobian(lambda d: so3.log(so3.exp(turn).T @ so3.exp(turn + d)), np.zeros(3), step=1e-5)
        np.testing.assert_allclose(right_jacobian(turn), J, atol=1e-9)

    def test_the_inverse_of_the_left_one_undoes_it(self, angle: float) -> None:
        turn = self.turn(angle)
        np.testing.assert_allclose(left_jacobian_inverse(turn) @ right_jacobian(turn).T, np.eye(3), atol=1e-12)

    def test_the_slope_of_the_inverse_is_the_numerical_one(self, angle: float) -> None:
        vector = np.array([1.0, -2.0, 0.5])
        J = so3.numerical_jacobian(lambda w: left_jacobian_inverse(w) @ vector, self.turn(angle), step=1e-5)
        np.testing.assert_allclose(slope_of_inverse(self.turn(angle), vector), J, atol=1e-9)
