"""The slow error of Doppler velocities in what is said of positions at several times."""

import numpy as np
import pytest
from scipy.integrate import quad

from smoother.arrays import Array
from smoother.estimate.fixes.slow_errors import DOPPLER
from smoother.estimate.output.joint import POSITION_TAU, WindowsJoint, WithUnseen, wander
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset


class Known:
    """A JointPosition with one error for all times, known to `sigma` m per axis."""

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma

    def covariance(self, t: Array, direction_n: Array) -> Array:
        return np.asarray(self.sigma**2 * direction_n @ direction_n.T)


@pytest.mark.parametrize("apart", [1.0, 20.0, 100.0, 1000.0])
def test_a_position_wanders_as_the_spectrum_of_two_lags(apart: float) -> None:
    c, a = 1.0 / DOPPLER.tau, 1.0 / POSITION_TAU

    def density(w: float) -> float:
        return 2.0 * DOPPLER.sigma**2 * c / ((w**2 + c**2) * (w**2 + a**2)) * 2.0 * (1.0 - np.cos(w * apart)) / np.pi

    wanted = sum(quad(density, low, high, limit=2000)[0] for low, high in ((0.0, 0.02), (0.02, 0.5), (0.5, 20.0)))
    assert float(wander(apart)) == pytest.approx(wanted, rel=1e-4)


def test_over_seconds_it_is_the_error_of_the_velocity_times_the_time() -> None:
    assert float(wander(2.0)) == pytest.approx((2.0 * DOPPLER.sigma) ** 2, rel=0.15)


def test_what_changes_is_less_sure_and_a_place_alone_as_sure_as_it_was() -> None:
    t, north = np.array([0.0, 60.0, 300.0]), np.tile([1.0, 0.0, 0.0], (3, 1))
    P = WithUnseen(Known(2.0), np.zeros(3), 4.0).covariance(t, north)
    np.testing.assert_allclose(np.diag(P), 4.0)
    most = 4.0 / (4.0 + 0.5 * float(wander(np.inf)))
    assert P[0, 0] + P[1, 1] - 2.0 * P[0, 1] == pytest.approx(most * float(wander(60.0)))
    assert np.min(np.linalg.eigvalsh(P)) > 0.0


def test_fixes_without_an_offset_leave_no_room_to_wander() -> None:
    t, level = np.arange(0.0, 600.0, 10.0), np.tile([0.6, 0.8, 0.0], (60, 1))
    P = WithUnseen(Known(0.05), np.zeros(3), 0.05**2).covariance(t, level)
    assert np.min(np.linalg.eigvalsh(P)) > 0.0
    assert P[0, 0] + P[-1, -1] - 2.0 * P[0, -1] < 2.0 * 0.05**2


@pytest.mark.parametrize("has_doppler", [True, False])
def test_a_path_that_followed_doppler_wanders(has_doppler: bool) -> None:
    session = prepare(simulate_preset("kart", 1, duration=60.0, gnss_velocity=has_doppler, gnss_outages=()).raw)
    joint = GraphSmoother().estimate(session).joint
    assert isinstance(joint, WithUnseen)
    assert (joint.variance is not None) == has_doppler


def test_what_no_window_holds_together_shares_the_unseen_offset() -> None:
    directions = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0]])
    P = WithUnseen(WindowsJoint([]), np.array([4.0, 1.0, 9.0]), None).covariance(np.array([0.0, 900.0]), directions)
    np.testing.assert_allclose(P[0, 1], 0.6 * 4.0)
    np.testing.assert_allclose(P[1, 1], 0.36 * 4.0 + 0.64)
