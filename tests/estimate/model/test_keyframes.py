"""Keyframes: evenly over the session, and where the path is read, if that is evenly spaced too."""

import math

import numpy as np
import pytest

from smoother.estimate.model.keyframes import keyframe_times, reading_grid

INTERVAL = 0.2


class TestKeyframeTimes:
    @pytest.mark.parametrize(("start", "end"), [(0.0, 1.0), (-0.6, 10.05), (3.0, 3.01), (5.0, 5.0)])
    def test_they_cover_the_session_evenly_and_are_two_at_least(self, start: float, end: float) -> None:
        t = keyframe_times(start, end, 0.2)
        assert len(t) >= 2
        assert t[0] == start
        assert end - 1e-6 <= t[-1] < end + 0.2 + 1e-6
        np.testing.assert_allclose(np.diff(t), 0.2)

    def test_a_session_of_whole_intervals_gets_no_keyframe_too_many(self) -> None:
        assert len(keyframe_times(0.1, 0.1 + 0.2 * 3000, 0.2)) == 3001

    def test_they_are_where_the_path_is_read_and_still_cover_the_session(self) -> None:
        read_at = 7.13 + INTERVAL * np.arange(3000)
        t = keyframe_times(6.6, 607.4, INTERVAL, read_at)
        assert 6.6 - INTERVAL < t[0] <= 6.6
        assert t[-1] >= 607.4
        assert apart(read_at, t) < 1e-6


def apart(read_at: np.ndarray, t: np.ndarray) -> float:
    """Largest distance of a time from the nearest keyframe."""
    return float(np.max(np.min(np.abs(read_at[:, None] - t), axis=1)))


class TestReadingGrid:
    @pytest.mark.parametrize("every", [0.2, 0.4, 1.0])
    @pytest.mark.parametrize("drift", [0.0, 200e-6, -200e-6])
    def test_a_clock_that_drifts_takes_the_grid_with_it(self, every: float, drift: float) -> None:
        read_at = 3.07 + every * (1.0 + drift) * np.arange(600.0 / every)
        origin, interval = reading_grid(read_at, INTERVAL)
        assert interval == pytest.approx(INTERVAL * (1.0 + drift), rel=1e-9)
        np.testing.assert_allclose((read_at - origin) / interval, np.round((read_at - origin) / interval), atol=1e-6)

    def test_outages_and_jitter_do_not_move_it_by_more_than_their_mean(self) -> None:
        rng = np.random.default_rng(0)
        read_at = 3.07 + INTERVAL * 1.0001 * np.arange(3000) + 0.005 * rng.normal(size=3000)
        read_at = np.delete(read_at, [*range(700, 800), *range(1500, 1507), *rng.integers(0, 3000, 300)])
        origin, interval = reading_grid(read_at, INTERVAL)
        phase = ((read_at - origin) / interval + 0.5) % 1.0 - 0.5
        assert abs(phase.mean()) < 1e-3
        assert abs(np.polyfit(read_at - read_at[0], phase, 1)[0]) * 600.0 < 5e-3

    @pytest.mark.parametrize("rate", [4.0, 8.0, 10.0, 18.0, 25.0])
    def test_a_rate_that_reads_all_over_the_intervals_keeps_the_one_asked_for(self, rate: float) -> None:
        origin, interval = reading_grid(3.07 + np.arange(6000) / rate, INTERVAL)
        assert math.isnan(origin)
        assert interval == INTERVAL

    def test_times_at_random_keep_it_too(self) -> None:
        read_at = np.sort(np.random.default_rng(1).uniform(0.0, 600.0, 600))
        origin, interval = reading_grid(read_at, INTERVAL)
        assert math.isnan(origin)
        assert interval == INTERVAL
        t = keyframe_times(-0.6, 600.2, INTERVAL, read_at)
        np.testing.assert_array_equal(t, keyframe_times(-0.6, 600.2, INTERVAL))
