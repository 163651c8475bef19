"""Rotations against formulas, round trips and an independent library (scipy)."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from smoother import so3


def random_rotations(n: int, seed: int = 0) -> np.ndarray:
    return Rotation.random(n, np.random.default_rng(seed)).as_matrix()  # a keyword only since SciPy 1.15


def test_skew_is_the_cross_product() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose(np.einsum("...ij,...j->...i", so3.skew(a), b), np.cross(a, b), atol=1e-15)


def test_a_quarter_turn_about_up_takes_forward_to_left() -> None:
    R = so3.exp(np.array([0.0, 0.0, np.pi / 2.0]))
    np.testing.assert_allclose(R @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


# across both sides of the switch from the series (1e-4 rad) and up to half a turn
ANGLES = [0.0, 1e-12, 1e-6, 0.9e-4, 1.1e-4, 1e-2, 1.0, 3.0, np.pi - 1e-7]


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_the_matrix_exponential(angle: float) -> None:
    axis = np.array([0.48, -0.6, 0.64])
    np.testing.assert_allclose(so3.exp(angle * axis), expm(so3.skew(angle * axis)), rtol=0.0, atol=2e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_log_takes_exp_back(angle: float) -> None:
    axes = np.random.default_rng(2).normal(size=(20, 3))
    w = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    np.testing.assert_allclose(so3.log(so3.exp(w)), w, rtol=0.0, atol=1e-14)


def test_log_is_exact_at_half_a_turn_where_either_sign_will_do() -> None:
    axes = np.concatenate([np.eye(3), np.random.default_rng(3).normal(size=(20, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    w = so3.log(so3.exp(np.pi * axes))
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), np.pi, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.sum(w * axes, axis=1)), np.pi, atol=1e-12)


def test_log_returns_the_shortest_way_round() -> None:
    np.testing.assert_allclose(so3.log(so3.exp(np.array([0.0, 3.5, 0.0]))), [0.0, 3.5 - 2.0 * np.pi, 0.0], atol=1e-14)


def test_log_and_quaternion_agree_with_scipy() -> None:
    R = random_rotations(200)
    reference = Rotation.from_matrix(R)
    np.testing.assert_allclose(so3.log(R), reference.as_rotvec(), atol=1e-12)
    q = reference.as_quat(scalar_first=True, canonical=True)
    np.testing.assert_allclose(so3.quaternion_wxyz(R), q, atol=1e-14)


def test_quaternion_and_matrix_are_one_another_also_at_half_turns() -> None:
    R = np.concatenate([random_rotations(100), so3.exp(np.pi * np.eye(3)), np.eye(3)[None]])
    q = so3.quaternion_wxyz(R)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-15)
    assert np.all(q[:, 0] >= 0.0)
    np.testing.assert_allclose(so3.from_quaternion_wxyz(q), R, atol=1e-14)
    np.testing.assert_allclose(so3.from_quaternion_wxyz(-q), R, atol=1e-14)


def test_leading_shape_is_carried_through() -> None:
    w = np.random.default_rng(4).normal(size=(2, 3, 4, 3))
    R = so3.exp(w)
    assert R.shape == (2, 3, 4, 3, 3)
    assert so3.log(R).shape == w.shape
    assert so3.quaternion_wxyz(R).shape == (2, 3, 4, 4)
    assert so3.normalized(R).shape == R.shape


def test_normalized_leaves_rotations_and_mends_noisy_ones() -> None:
    R = random_rotations(50)
    np.testing.assert_allclose(so3.normalized(R), R, atol=1e-14)
    noisy = so3.normalized(R + 1e-3 * np.random.default_rng(5).normal(size=R.shape))
    np.testing.assert_allclose(noisy @ noisy.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(noisy), 1.0, atol=1e-14)
    assert np.max(np.linalg.norm(so3.log(R.transpose(0, 2, 1) @ noisy), axis=1)) < 5e-3


def test_normalized_of_a_single_reflection_is_a_rotation() -> None:
    assert np.linalg.det(so3.normalized(np.diag([1.0, 1.0, -0.1]))) == pytest.approx(1.0)


def test_normalized_does_not_change_its_argument() -> None:
    R = np.eye(3) + 0.01
    before = R.copy()
    so3.normalized(R)
    np.testing.assert_array_equal(R, before)


def test_numerical_jacobian_of_a_known_function() -> None:
    x = np.array([0.3, -0.8])
    J = so3.numerical_jacobian(lambda x: np.array([x[0] ** 2, np.sin(x[1]), x[0] * x[1]]), x)
    np.testing.assert_allclose(J, [[0.6, 0.0], [0.0, np.cos(-0.8)], [-0.8, 0.3]], atol=1e-9)


def test_a_turn_on_the_right_moves_a_rotated_vector_by_minus_R_skew() -> None:
    R, v = random_rotations(1, seed=6)[0], np.array([0.2, -1.3, 0.7])
    J = so3.numerical_jacobian(lambda w: R @ so3.exp(w) @ v, np.zeros(3))
    np.testing.assert_allclose(J, -R @ so3.skew(v), atol=1e-9)


def test_an_axial_matrix_is_the_sum_of_its_three_parts() -> None:
    rng = np.random.default_rng(5)
    w, (a, b, c) = rng.normal(size=(4, 3)), rng.normal(size=(3, 4))
    for k, have in enumerate(so3.axial(w, a, b, c)):
        np.testing.assert_allclose(have, a[k] * np.eye(3) + b[k] * so3.skew(w[k]) + c[k] * np.outer(w[k], w[k]))


def test_a_quaternion_does_not_depend_on_what_else_is_in_the_stack() -> None:
    turns = np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 1.0], [0.0, 2.0, 0.5]])
    half_a_turn = so3.exp(np.array([[np.pi, 0.0, 0.0]]))
    alone, together = (
        so3.quaternion_wxyz(so3.exp(turns)),
        so3.quaternion_wxyz(np.concatenate([so3.exp(turns), half_a_turn])),
    )
    np.testing.assert_allclose(alone, together[:3], atol=1e-15)
