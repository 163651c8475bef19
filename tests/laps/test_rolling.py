"""The rolling best: without the luck of the fastest of many windows, and never beyond the end of a recording."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.path import plan_path
from smoother.laps.reference import Curve
from smoother.laps.results import FixPath, GivenLines, LapAnalysis, Reason, Statistics
from smoother.laps.rolling import rolling_best
from smoother.trajectory import Trajectory

Made = Callable[..., Trajectory]
Fixes = Callable[..., FixPath]
GATE = GivenLines(np.array([[0.0, -50.0], [0.0, -70.0]]))
ROUND, RADIUS = 25.0, 60.0  # s, m
OFF, TAU = 0.5, 2.0  # m, s: errors of positions and how long they last


class Wander:
    """Errors of OFF m to each side that are forgotten within TAU s."""

    def covariance(self, t: Array, direction_n: Array) -> Array:
        return np.asarray(OFF**2 * np.exp(-np.abs(t[:, None] - t) / TAU) * (direction_n @ direction_n.T))


def wander(n: int, rng: np.random.Generator) -> Array:
    """Errors (n,) m of one axis at 50 rows a second, as :class:`Wander` has them."""
    keeps = float(np.exp(-0.02 / TAU))
    noise = rng.standard_normal(n) * OFF * np.sqrt(1.0 - keeps**2)
    noise[0] = OFF * rng.standard_normal()
    out = np.empty(n)
    last = 0.0
    for k, each in enumerate(noise):
        last = keeps * last + each
        out[k] = last
    return out


def circling(make: Made, turns: Callable[[Array], Array], seed: int | None, duration: float = 180.0) -> Trajectory:
    """A circle, at time t turned `turns(t)` times, seen with errors drawn by `seed`, without any for None."""
    t = np.arange(0.0, duration, 0.02)
    angle = 2.0 * np.pi * (turns(t) - 0.3)
    drive = make(t, RADIUS * np.stack([-np.cos(angle), -np.sin(angle)], axis=1))
    rng = np.random.default_rng(seed)
    off = np.zeros((len(t), 3))
    if seed is not None:
        off[:, :2] = np.stack([wander(len(t), rng) for _ in range(2)], axis=1)
    return replace(drive, position_n=drive.position_n + off, joint=Wander())


def statistics(drive: Trajectory, fixes: Fixes) -> Statistics:
    found: LapAnalysis = analyse(drive, fixes(drive), LapOptions(lines=GATE))
    assert found.statistics is not None
    return found.statistics


def uneven(t: Array) -> Array:
    """A driver whose pace goes up and down by half a percent within the laps, never the same way."""
    return t / ROUND + 0.002 * np.sin(t / 11.0) + 0.0015 * np.sin(t / 17.0 + 1.0)


def test_the_rolling_best_is_not_the_least_of_all_noisy_windows(make: Made, fixes: Fixes) -> None:
    true = statistics(circling(make, uneven, None), fixes).rolling_raw
    said = [statistics(circling(make, uneven, seed), fixes) for seed in range(16)]
    error = np.array([one.rolling - true for one in said])
    luck = np.array([one.rolling_raw - true for one in said])
    z = error / np.array([one.rolling_sigma for one in said])
    assert np.mean(luck) < -0.05
    assert abs(np.mean(error)) < 0.025
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(luck**2))
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.4
    for one in said:
        assert one.rolling_raw <= one.rolling <= one.best + 1e-9


def test_a_stretch_that_was_faster_for_a_reason_stays_so(make: Made, fixes: Fixes) -> None:
    def once_quick(t: Array) -> Array:  # a second gained from 88 to 108 s, in the middle of two laps
        return t / ROUND + 0.02 * (1.0 + np.tanh((t - 98.0) / 5.0))

    true = statistics(circling(make, once_quick, None), fixes)
    assert true.rolling_raw < ROUND - 0.9
    said = statistics(circling(make, once_quick, 3), fixes)
    assert said.rolling == pytest.approx(true.rolling_raw, abs=3.0 * said.rolling_sigma)
    assert said.rolling_sigma < 0.06


def test_no_window_ends_after_the_recording(make: Made, fixes: Fixes) -> None:
    """Where it ends, between two places at which laps are compared, the next of them was never reached."""
    for duration in (150.0, 150.04, 150.08, 150.12):
        said = statistics(circling(make, lambda t: t / ROUND, None, duration), fixes)
        assert said.rolling_raw == pytest.approx(ROUND, abs=0.005)


def test_with_one_lap_that_counts_it_is_as_it_was_timed(make: Made, fixes: Fixes) -> None:
    said = statistics(circling(make, lambda t: t / ROUND, 1, 60.0), fixes)
    assert said.counted == 1
    assert said.rolling == said.rolling_raw and said.rolling_sigma > 0.0


@pytest.mark.parametrize("broken", [2, 3])
def test_no_window_goes_over_a_lap_that_left_the_track(make: Made, fixes: Fixes, broken: int) -> None:
    """Whether it begins or ends on that lap: from the third lap to the fourth it is five seconds shorter."""
    drive = circling(make, lambda t: t / ROUND, None)
    found = analyse(drive, fixes(drive), LapOptions(lines=GATE))
    assert found.traces is not None and found.reference is not None
    earlier = np.where(np.arange(len(found.laps)) > 2, 5.0, 0.0)[:, None]
    traces = replace(found.traces, t=found.traces.t - earlier)
    curve, path = Curve(found.reference), plan_path(drive)
    assert rolling_best(found.laps, traces, curve, path, None).raw == pytest.approx(ROUND - 5.0, abs=0.005)
    reasons: tuple[Reason, ...] = ("short-cut",)
    laps = tuple(replace(lap, reasons=reasons) if i == broken else lap for i, lap in enumerate(found.laps))
    assert rolling_best(laps, traces, curve, path, None).raw == pytest.approx(ROUND, abs=0.005)
