"""Lags and gains of stretches against motions that are known."""

import numpy as np
import pytest

from smoother.arrays import Array, IntArray
from smoother.estimate.preprocess.clock import fit_drift
from smoother.estimate.preprocess.streams import Measured, PathMotion, Streams, averages_of, compare_streams
from smoother.samples import ImuSamples

LASTS, LATE = 300.0, 0.23
TURNED = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # R_bs
NONE = np.zeros(3)


def motion(t: Array) -> tuple[Array, Array]:
    """Velocity (N, 3) m/s of a drive whose bends are all different, and forward and left force and yaw rate (N, 3)."""
    periods, sizes = np.array([5.3, 7.9, 13.7]), np.array([0.5, 0.6, 0.8])
    angles = 2.0 * np.pi * t[:, None] / periods
    yaw, turn = np.sin(angles) @ sizes, np.cos(angles) @ (sizes * 2.0 * np.pi / periods)
    speed, push = 13.0 + 4.0 * np.sin(2.0 * np.pi * t / 9.1), 4.0 * 2.0 * np.pi / 9.1 * np.cos(2.0 * np.pi * t / 9.1)
    velocity = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros_like(t)], axis=1)
    return velocity, np.stack([push, speed * turn, turn], axis=1)


def compared(
    seed: int = 1, noise: float = 1.0, rate: float = 5.0, late: float = LATE, gain: float = 1.0, turned: Array = TURNED
) -> Streams:
    """A drive whose samples, of a sensor mounted by TURNED, have noise, m/s^2 and tenths of a rad/s, of each sample."""
    rng = np.random.default_rng(seed)
    t, fixes = np.arange(0.0, LASTS, 0.01), np.arange(2.0, LASTS - 2.0, 1.0 / rate)
    axes = gain * motion(t)[1]
    force = np.stack([axes[:, 0], axes[:, 1], np.full_like(t, 9.81)], axis=1) @ turned
    turn = np.stack([np.zeros_like(t), np.zeros_like(t), axes[:, 2]], axis=1) @ turned
    shaken = rng.normal(0.0, noise, (2, len(t), 3))
    imu = ImuSamples(t, force + shaken[0], turn + 0.1 * shaken[1])
    path = PathMotion(fixes, motion(fixes - late)[0] + rng.normal(0.0, 0.02, (len(fixes), 3)))
    use: IntArray = np.arange(len(fixes))
    found = compare_streams(Measured(averages_of(imu), TURNED, NONE), path, use, 0.1)
    assert found is not None
    return found


@pytest.mark.parametrize("rate", [5.0, 25.0])
def test_lags_are_as_far_off_as_they_say_and_noise_does_not_draw_them(rate: float) -> None:
    off = np.concatenate([(found.lag - LATE) / found.sigma for found in (compared(k, 3.0, rate) for k in range(4))])
    assert off.shape == (4 * 30, 3)
    assert np.all(np.abs(np.mean(off, axis=0)) < 0.5)
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.4


def test_gain() -> None:
    twice, noisy = compared(gain=2.0), compared(noise=8.0)
    assert np.median(twice.gain, axis=0) == pytest.approx([2.0, 2.0, 2.0], rel=0.03)
    assert np.median(noisy.gain, axis=0) == pytest.approx([1.0, 1.0, 1.0], rel=0.1)


def test_a_mirrored_axis_has_no_lag() -> None:
    mirrored = compared(turned=np.diag([1.0, -1.0, 1.0]) @ TURNED)
    assert not mirrored.is_known[:, 1].any() and mirrored.is_known[:, [0, 2]].all()


def test_a_lag_of_seconds_is_found_from_the_usual_one() -> None:
    assert np.median(compared(late=1.9).lag, axis=0) == pytest.approx([1.9, 1.9, 1.9], abs=0.02)


def test_lags_that_do_not_change_have_no_drift() -> None:
    drift = fit_drift(compared(noise=3.0))
    assert not drift.is_sure
    assert (
        abs(drift.value) < 4.0 * drift.sigma < 0.05 / (LASTS - 10.0)
    )  # between the middles of the first and the last stretch
