"""The motion prior against matrix exponentials, its own stationary state, and polynomials."""

import numpy as np
import pytest
from scipy.linalg import expm

from smoother.estimate.fixes.path_graph import WhiteJerk, quintic_basis

# a kart, a walker, a sparse log where the acceleration is forgotten at once, and a car that hardly accelerates
PRIORS = [
    WhiteJerk(6.0, 15.0, 8.0),
    WhiteJerk(0.5, 1.0, 0.5),
    WhiteJerk(40.0, 15.0, 9.0),
    WhiteJerk(0.2, 25, 1),
]
STEPS = np.array([0.01, 0.09, 0.25, 0.6])


def rates(prior: WhiteJerk) -> np.ndarray:
    decay = np.clip(0.5 * (prior.density / prior.acceleration) ** 2, 0.3, 5.0)
    stiffness = np.clip((prior.acceleration / prior.velocity) ** 2, 0.01, 6.0)
    return np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -stiffness, -decay]])


@pytest.mark.parametrize("prior", PRIORS)
def test_transition_is_the_matrix_exponential(prior: WhiteJerk) -> None:
    for step, transition in zip(STEPS, prior.discrete(STEPS)[0], strict=True):
        np.testing.assert_allclose(transition, expm(rates(prior) * step), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("prior", PRIORS)
def test_covariance_is_van_loans_integral(prior: WhiteJerk) -> None:
    for step, covariance in zip(STEPS, prior.discrete(STEPS)[1], strict=True):
        F = rates(prior)
        drive = np.zeros((3, 3))
        drive[2, 2] = prior.density**2
        both = expm(np.block([[-F, drive], [np.zeros((3, 3)), F.T]]) * step)
        # Van Loan's own rounding: its smallest entry, dt^5 / 20, comes out of numbers near 1
        np.testing.assert_allclose(covariance, both[3:, 3:].T @ both[:3, 3:], rtol=1e-6, atol=1e-14)


@pytest.mark.parametrize("prior", PRIORS)
def test_the_root_is_that_of_the_inverse_of_the_covariance(prior: WhiteJerk) -> None:
    transition, root = prior.whitened(STEPS)
    expected, covariance = prior.discrete(STEPS)
    np.testing.assert_allclose(transition, expected)
    whitened = root @ covariance @ root.transpose(0, 2, 1)
    np.testing.assert_allclose(whitened, np.broadcast_to(np.eye(3), whitened.shape), atol=1e-9)


def test_velocity_and_acceleration_keep_their_stationary_spread() -> None:
    prior = WhiteJerk(6.0, 12.0, 7.0)
    stationary = np.diag([12.0**2, 7.0**2])
    step = np.array([0.3])
    transition, covariance = (part[0, 1:, 1:] for part in prior.discrete(step))
    np.testing.assert_allclose(transition @ stationary @ transition.T + covariance, stationary, rtol=1e-9, atol=1e-9)


def test_quintic_basis_reproduces_every_quintic_polynomial() -> None:
    coefficients = np.random.default_rng(3).normal(size=6)
    curve = [np.polynomial.Polynomial(coefficients).deriv(k) for k in range(3)]
    ends = np.array([[p(t) for p in curve] for t in (0.4, 0.65)])
    fraction = np.linspace(0.0, 1.0, 7)
    left, right = quintic_basis(fraction, np.full(7, 0.25))
    between = left @ ends[0] + right @ ends[1]
    np.testing.assert_allclose(between, np.stack([p(0.4 + 0.25 * fraction) for p in curve], axis=1), rtol=1e-9)


def test_quintic_basis_is_what_the_prior_expects_between_two_known_states() -> None:
    """Conditional mean in the middle of an interval short against the damping, from transition and covariance."""
    prior = WhiteJerk(50.0, 1000.0, 500.0)  # all but undamped
    half = np.array([0.1])
    Phi, Q = (part[0] for part in prior.discrete(half))
    whole = Phi @ Q @ Phi.T + Q
    gain = Q @ Phi.T @ np.linalg.inv(whole)
    left, right = quintic_basis(np.array([0.5]), np.array([0.2]))
    for found, expected in ((gain, right[0]), (Phi - gain @ Phi @ Phi, left[0])):
        size = np.abs(expected).max(axis=1, keepdims=True)
        np.testing.assert_allclose(found / size, expected / size, atol=0.01)
