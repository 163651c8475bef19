"""Errors of velocities that last for a while: what a stand shows of them, and how much a velocity counts for it."""

import math

import numpy as np
import pytest

from smoother.estimate.graph import start
from smoother.estimate.graph.inertial_noise import InertialNoise
from smoother.estimate.graph.lasting import TAU, Memory, counted, lasting_at_rest, shared_out
from smoother.sim.simulation import simulate_preset

from .smoothed import smoothed

EVERY = 0.1
T = EVERY * np.arange(3000)
AT_REST = (T % 100.0) < 40.0


def velocities(white: float, lasting: float, seed: int) -> np.ndarray:
    """Errors (N, 3) m/s, `lasting` of which are forgotten in TAU."""
    rng, kept = np.random.default_rng(seed), math.exp(-EVERY / TAU)
    out = np.empty((len(T), 3))
    out[0] = rng.standard_normal(3)
    for i in range(1, len(T)):
        out[i] = kept * out[i - 1] + math.sqrt(1.0 - kept**2) * rng.standard_normal(3)
    return lasting * out + white * rng.standard_normal((len(T), 3))


class TestAtRest:
    def test_what_lasts_is_found_beside_what_is_white(self) -> None:
        found = [lasting_at_rest(T, velocities(0.05, 0.03, seed), AT_REST) for seed in range(30)]
        assert math.sqrt(np.mean(np.square(found))) == pytest.approx(0.03, rel=0.1)

    def test_white_noise_hardly_ever_seems_to_last(self) -> None:
        found = np.array([lasting_at_rest(T, velocities(0.05, 0.0, seed), AT_REST) for seed in range(60)])
        assert np.mean(found == 0.0) > 0.85
        assert np.max(found) < 0.015

    def test_the_drive_has_no_part_in_it(self) -> None:
        moving = np.where(AT_REST[:, None], velocities(0.05, 0.03, 0), 10.0)
        assert lasting_at_rest(T, moving, AT_REST) == lasting_at_rest(T, velocities(0.05, 0.03, 0), AT_REST)

    def test_nothing_is_made_of_nothing(self) -> None:
        assert lasting_at_rest(T, velocities(0.05, 0.03, 0), np.zeros_like(AT_REST)) == 0.0
        assert lasting_at_rest(T, np.zeros((len(T), 3)), AT_REST) == 0.0  # it holds its speed
        assert lasting_at_rest(T, np.full((len(T), 3), np.nan), AT_REST) == 0.0
        assert lasting_at_rest(T[:1], np.ones((1, 3)), AT_REST[:1]) == 0.0
        assert lasting_at_rest(T[[0, 1, 500, 2900]], np.ones((4, 3)), np.array([True, False, False, True])) == 0.0


def smoothed_walk(sigma: float, lasting: float, density: float, every: float) -> tuple[float, float, float]:
    """Standard deviations, m/s, that a path has in its midst: as it says, as it errs, and of the best of all paths.

    A random walk of `density`, measured every `every` s with errors that last; the path takes them for white noise that
    counts as `counted` says.
    """
    n, walk = 901, density**2 * every
    variance = (counted(sigma, lasting, density, every) * sigma) ** 2
    difference = np.diff(np.eye(n), axis=0)
    stiff = difference.T @ difference / walk
    later = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    errors = sigma**2 * np.eye(n) + lasting**2 * np.exp(-later * every / TAU)
    said = np.linalg.inv(np.eye(n) / variance + stiff)[n // 2]
    best = np.linalg.inv(np.linalg.inv(errors) + stiff)[n // 2, n // 2]
    weights = said / variance
    # the walk errs by its steps from the middle to each time, weighed
    missed = weights - (np.arange(n) == n // 2)
    steps = np.cumsum(missed[::-1])[::-1][1:]
    errs = weights @ errors @ weights + walk * float(steps @ steps)
    return math.sqrt(said[n // 2]), math.sqrt(errs), math.sqrt(best)


class TestCounted:
    @pytest.mark.parametrize("every", [0.2, 0.1, 0.04])
    @pytest.mark.parametrize("density", [0.03, 0.1, 0.3])
    def test_a_path_errs_by_what_it_says_and_hardly_by_more_than_it_must(self, density: float, every: float) -> None:
        for sigma in (0.05, 0.1):
            said, errs, best = smoothed_walk(sigma, 0.5 * sigma, density, every)
            assert errs == pytest.approx(said, rel=1e-3)
            assert best <= errs < 1.09 * best

    def test_white_velocities_count_one_by_one(self) -> None:
        assert counted(0.05, 0.0, 0.1, EVERY) == 1.0

    def test_with_a_long_memory_all_of_it_counts(self) -> None:
        left = math.exp(-EVERY / TAU)
        whole = 0.05**2 + 0.03**2 * (1.0 + left) / (1.0 - left)
        assert (0.05 * counted(0.05, 0.03, 1e-4, EVERY)) ** 2 == pytest.approx(whole, rel=0.01)

    def test_the_quicker_it_forgets_the_more_a_velocity_counts(self) -> None:
        factors = [counted(0.05, 0.03, accel, EVERY) for accel in (0.01, 0.1, 1.0, 10.0)]
        assert np.all(np.diff(factors) < 0.0)
        assert factors[-1] == pytest.approx(math.hypot(0.05, 0.03) / 0.05, rel=0.01)
        assert Memory.of(0.05, 0.01, EVERY).seconds > 5.0 * Memory.of(0.05, 0.1, EVERY).seconds


def level_density(noise: InertialNoise) -> float:
    """Of the noise of force along the first axis."""
    return noise.accel * math.sqrt(noise.accel_shape[0][0])


class TestSharedOut:
    NOISE, MEMORY = InertialNoise(0.05, 0.001, 0.003, 1e-4), Memory.of(0.05, 0.05, EVERY)

    def test_what_is_moved_is_level(self) -> None:
        force, lasting, moved = shared_out(self.NOISE, 0.02, self.MEMORY, np.eye(3), 0.01)
        covariance = force.accel**2 * np.array(force.accel_shape)
        assert lasting == 0.02
        assert np.trace(force.accel_shape) == pytest.approx(3.0)
        np.testing.assert_allclose(covariance, 0.05**2 * np.eye(3) - moved * np.diag([1.0, 1.0, 0.0]), atol=1e-12)
        assert 0.7 < moved / (2.0 * 0.02**2 / TAU) < 1.0

    def test_some_noise_is_left_to_the_force(self) -> None:
        assert level_density(shared_out(self.NOISE, 0.05, self.MEMORY, np.eye(3), 0.03)[0]) == pytest.approx(0.03)
        assert level_density(shared_out(self.NOISE, 0.05, self.MEMORY, np.eye(3), 0.06)[0]) == pytest.approx(0.05)

    def test_no_more_lasts_than_the_drive_shows(self) -> None:
        _, lasting, _ = shared_out(self.NOISE, 0.5, self.MEMORY, np.eye(3), 0.01)
        assert 0.05 < lasting < 0.08

    def test_what_a_path_is_left_with_says_what_it_remembers(self) -> None:
        left = 0.05**2 * (1.0 - self.MEMORY.kept) / (1.0 + self.MEMORY.kept)
        shown = Memory.shown(0.05, left, EVERY)
        assert shown.kept == pytest.approx(self.MEMORY.kept)
        assert shown.density(0.05) == pytest.approx(0.05)
        assert Memory.shown(0.05, 1.0, EVERY).seconds < 1.1 * EVERY  # no sample tells anything


def test_velocities_are_as_sure_as_they_say_where_the_receivers_err_for_a_while(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    changes = {"gnss_rate": 10.0, "gnss_velocity_sigma": 0.06, "gnss_velocity_lasting": 0.04, "imu_accel_noise": 0.02}

    def errs() -> tuple[float, float]:
        """Error of level velocities, m/s rms, and over their sigmas."""
        errors, ratios = [], []
        for seed in (2, 3):
            simulation = simulate_preset("white", seed, duration=150.0, motion_standstill=40.0, **changes)
            s = smoothed(simulation)
            assert s.trajectory.sigmas is not None
            drives = np.hypot(*s.truth.velocity_n[:, :2].T) > 2.0
            error = s.velocity_error_n[drives, :2]
            errors.append(error)
            ratios.append(error / s.trajectory.sigmas.velocity_n[drives, :2])
        rms = (float(np.sqrt(np.mean(np.concatenate(values) ** 2))) for values in (errors, ratios))
        return next(rms), next(rms)

    error, ratio = errs()
    assert 0.7 < ratio < 1.2
    monkeypatch.setattr(start, "lasting_at_rest", lambda *_: 0.0)
    worse, unsure = errs()
    assert unsure > 1.3
    assert error < 0.97 * worse
