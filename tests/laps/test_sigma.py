"""How sure times, offsets and places of laps are: against formulas, with errors whose covariance is written down."""

from collections.abc import Callable

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.delta import _variances
from smoother.laps.results import FixPath, GivenLines
from smoother.laps.sigma import TRACK_TAU, OffsetModel, position_errors
from smoother.trajectory import EstimateReport, Identified, Trajectory

Fixes = Callable[..., FixPath]
SPEED = 15.0  # m/s, of the circle
GATE = GivenLines(np.array([[0.0, -54.0], [0.0, -66.0]]))  # across the circle, where it runs north


class Independent:
    """Position errors of 0.3 m, independent at all times and of direction."""

    def covariance(self, t: Array, direction_n: Array) -> Array:
        return np.where(t[:, None] == t[None, :], 0.09, 0.0) * (direction_n @ direction_n.T)


@pytest.fixture(scope="module")
def sure(circle: Trajectory) -> Trajectory:
    return Trajectory(**{**vars(circle), "joint": Independent()})


def test_a_delta_has_the_sigma_of_its_four_crossings(sure: Trajectory, fixes: Fixes) -> None:
    found = analyse(sure, fixes(sure), LapOptions(lines=GATE, ties_laps=False))
    assert found.traces is not None
    other = next(i for i, lap in enumerate(found.laps) if lap.is_timed and i != found.reference_lap)
    middle = found.traces.delta_sigma[other, 20:-20]
    np.testing.assert_allclose(middle, 2.0 * 0.3 / SPEED, rtol=0.02)


def test_a_line_that_stands_askew_times_by_the_speed_over_it(sure: Trajectory, fixes: Fixes) -> None:
    askew = GivenLines(np.array([[6.0, -54.0], [-6.0, -66.0]]))  # 45 degrees to the track
    laps = [lap for lap in analyse(sure, fixes(sure), LapOptions(lines=askew, ties_laps=False)).laps if lap.is_timed]
    wanted = np.sqrt(2.0) * 0.3 / (SPEED * np.cos(np.pi / 4.0))
    assert [lap.sigma for lap in laps] == pytest.approx([wanted] * len(laps), rel=0.02)
    assert len(laps) >= 4


def test_the_gap_to_the_best_laps_sector_has_the_errors_of_both(circle: Trajectory, fixes: Fixes) -> None:
    class Alike:
        """Errors that are one at the same place of any lap, and independent of those elsewhere."""

        def covariance(self, t: Array, direction_n: Array) -> Array:
            along = direction_n @ direction_n.T
            return np.where(along > 0.9, 0.09, 0.0)

    sectors = (np.array([[54.0, 0.0], [66.0, 0.0]]),)
    known = Trajectory(**{**vars(circle), "joint": Alike()})
    found = analyse(known, fixes(known), LapOptions(lines=GivenLines(GATE.start, sectors)))
    for lap in found.laps:
        if lap.is_timed:
            np.testing.assert_allclose(lap.sector_sigma, np.sqrt(2.0) * 0.3 / SPEED, rtol=0.02)
            np.testing.assert_allclose(lap.sector_gap_sigma, 0.0, atol=2e-3)  # what laps have in common cancels


@pytest.mark.parametrize("counting", [[True, True, True, True], [True, False, True, True]])
def test_offsets_from_the_mean_of_laps_have_the_variance_of_that_difference(counting: list[bool]) -> None:
    rng = np.random.default_rng(5)
    root, some = rng.normal(size=(4, 4)), np.array(counting)
    covariance = root @ root.T
    mean = some / some.sum()
    for lap in range(4):
        to_mean = np.eye(4)[lap] - mean
        assert _variances(covariance, some)[0, lap] == pytest.approx(to_mean @ covariance @ to_mean)
        apart = [np.eye(4)[lap] - np.eye(4)[other] for other in np.flatnonzero(some) if other != lap]
        half = 0.5 * np.mean([one @ covariance @ one for one in apart])
        assert _variances(covariance, some)[1, lap] == pytest.approx(half)


def test_the_fast_part_of_an_error_is_forgotten_in_a_second() -> None:
    t, north = np.array([0.0, 0.5, 30.0]), np.tile([1.0, 0.0, 0.0], (3, 1))
    covariance = OffsetModel(t, np.full(3, 0.2), 0.0, 60.0).covariance(t, north)
    np.testing.assert_allclose(covariance[0], 0.04 * np.exp(-t / TRACK_TAU), rtol=1e-12)


def test_measured_speed_lets_the_offset_walk_by_its_noise_at_every_fix(circle: Trajectory) -> None:
    noise = {"gps_velocity_noise": Identified([0.3, 0.3, 0.5], None, "m/s", True, "identified")}
    full = Trajectory(**{**vars(circle), "report": EstimateReport(mode="full", identified=noise)})
    errors, source = position_errors(full, 0.2)
    assert isinstance(errors, OffsetModel) and source == "model"
    assert errors.walk == pytest.approx(0.3**2 * 0.2)  # m^2/s
