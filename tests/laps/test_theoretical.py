"""The theoretical best: what it is of noisy times, and honest on simulated karts (short for
benchmarks/theoretical_best.py)."""

import importlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.cli.lap_tables import _sectors
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.document import lap_rows
from smoother.laps.results import FixPath, GivenLines, LapAnalysis
from smoother.laps.theoretical import candidates, least_sum
from smoother.report.files import to_json
from smoother.trajectory import Trajectory

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
Made = Callable[..., Trajectory]
Fixes = Callable[..., FixPath]
TURN = 25.0  # s for the first round of the circle
GATES = GivenLines(
    np.array([[0.0, -50.0], [0.0, -70.0]]),
    (np.array([[50.0, 0.0], [70.0, 0.0]]), np.array([[0.0, 50.0], [0.0, 70.0]])),
)


class Wandering:
    """Errors of `shared` m that all positions have in common, and of `own` m that are forgotten within seconds."""

    def __init__(self, shared: float, own: float) -> None:
        self.shared, self.own = shared, own

    def covariance(self, t: Array, direction_n: Array) -> Array:
        kept = self.shared**2 + self.own**2 * np.exp(-np.abs(t[:, None] - t) / 2.0)
        return np.asarray(kept * (direction_n @ direction_n.T))


def rounds(make: Made, fixes: Fixes, pace: Callable[[Array], Array], joint: Wandering) -> LapAnalysis:
    """Rounds of a circle at `pace` times the usual turns a second, at any number of turns; three sectors."""
    t = np.arange(0.0, 160.0, 0.02)
    turns = np.zeros(len(t))
    for i in range(1, len(t)):
        turns[i] = turns[i - 1] + 0.02 / TURN * float(pace(turns[i - 1 : i])[0])
    angle = 2.0 * np.pi * (turns - 0.3)
    path = make(t, 60.0 * np.stack([-np.cos(angle), -np.sin(angle)], axis=1))
    return analyse(Trajectory(**{**vars(path), "joint": joint}), fixes(path), LapOptions(lines=GATES))


def test_where_one_lap_has_all_the_best_sectors_the_theoretical_best_is_that_lap(make: Made, fixes: Fixes) -> None:
    found = rounds(make, fixes, lambda turns: 1.0 + 0.1 * np.exp(-(((turns - 3.0) / 0.8) ** 6)), Wandering(2.0, 0.05))
    said = found.statistics
    assert said is not None and len(found.sector_lines) == 2
    assert said.theoretical_raw == pytest.approx(said.best, abs=1e-9)
    assert said.theoretical == pytest.approx(said.best, abs=1e-9)
    assert said.theoretical_sigma == pytest.approx(said.best_sigma, rel=1e-6)


def test_an_offset_that_all_laps_share_is_no_doubt_about_the_theoretical_best(make: Made, fixes: Fixes) -> None:
    def pace(turns: Array) -> Array:
        return 1.0 + 0.03 * np.sin(2.0 * np.pi * turns * 1.13)

    said = [rounds(make, fixes, pace, Wandering(shared, 0.05)).statistics for shared in (0.0, 3.0)]
    assert said[0] is not None and said[1] is not None
    assert said[0].theoretical_raw < said[0].best - 0.1
    for one in said:
        assert one.theoretical_raw <= one.theoretical <= one.best
        assert one.theoretical == pytest.approx(one.theoretical_raw, abs=0.01)  # far apart: no luck to speak of
        assert 0.003 < one.theoretical_sigma < 0.02  # 0.05 m at 15 m/s at each of the six crossings
    assert said[1].theoretical_sigma == pytest.approx(said[0].theoretical_sigma, rel=0.2)


def test_a_sector_is_compared_with_the_best_laps_without_the_offset_that_both_share(make: Made, fixes: Fixes) -> None:
    found = rounds(make, fixes, lambda turns: 1.0 + 0.1 * np.exp(-(((turns - 3.0) / 0.8) ** 6)), Wandering(2.0, 0.05))
    assert found.statistics is not None and found.statistics.best_lap is not None
    for i, lap in enumerate(found.laps):
        if lap.is_timed and i == found.statistics.best_lap:
            np.testing.assert_array_equal(lap.sector_gap_sigma, 0.0)
        elif lap.is_timed:
            assert np.all(lap.sector_sigma > 0.1)  # 2 m at 15 m/s, at lines that are passed in other directions
            # 0.05 m at each of four crossings at 15 m/s, and 2 m at speeds that differ by up to a tenth
            assert np.all(lap.sector_gap_sigma < 0.03) and np.all(lap.sector_gap_sigma > 0.002)
    laps = json.loads(to_json(lap_rows(found)))
    said = dict(_sectors(laps))["sectors"]
    assert "S3 ± 0.0" in said and "same sector of the best lap" in said


def times_of(rng: np.random.Generator, laps: int, spread: float) -> tuple[Array, Array, Array]:
    """Seen and true sector times (laps, 3) s, and the covariance of the crossings: each its own error of 0.05 s, all
    passages of a line one of 0.2 s."""
    lines = np.tile([0, 1, 2, 0], laps)
    covariance = 0.05**2 * np.eye(len(lines)) + 0.2**2 * (lines[:, None] == lines)
    error = rng.multivariate_normal(np.zeros(len(lines)), covariance, method="cholesky").reshape(laps, 4)
    moved = np.array([error[:, [0, 3]].mean(), error[:, 1].mean(), error[:, 2].mean(), error[:, [0, 3]].mean()])
    true = 15.0 + spread * rng.standard_normal((laps, 3))
    return true + np.diff(error, axis=1), true + np.diff(moved), covariance


@pytest.mark.parametrize("laps", [3, 12, 30])
def test_the_least_of_noisy_times_is_not_taken_for_the_least_of_the_true_ones(laps: int) -> None:
    rng = np.random.default_rng(7)
    errors, scaled, plain = [], [], []
    for _ in range(150):
        seen, true, covariance = times_of(rng, laps, 0.08)
        chosen = candidates(seen)
        assert set(seen.argmin(axis=0)) <= set(chosen)
        crossings = np.concatenate([4 * lap + np.arange(4) for lap in chosen])
        kept = covariance[np.ix_(crossings, crossings)]
        value, sigma = least_sum(seen, chosen, kept, np.full(len(crossings), 20.0), is_closed=True)
        errors.append(value - true.min(axis=0).sum())
        scaled.append(errors[-1] / sigma)
        plain.append(seen.min(axis=0).sum() - true.min(axis=0).sum())
    assert np.mean(plain) < -0.06
    # the spread of the true times is itself told by few times that are as much noise
    assert abs(np.mean(errors)) < 0.5 * abs(np.mean(plain))
    assert np.sqrt(np.mean(np.square(errors))) < 0.8 * np.sqrt(np.mean(np.square(plain)))
    assert 0.8 < np.sqrt(np.mean(np.square(scaled))) < 1.25


def test_a_lap_slowed_in_one_sector_hardly_changes_anything() -> None:
    changes = []
    for seed in range(20):
        seen, _, covariance = times_of(np.random.default_rng(seed), 10, 0.08)
        slowed = seen.copy()
        slowed[seen[:, 1].argmax(), 1] += 6.0
        values = [
            least_sum(times, np.arange(10), covariance, np.full(40, 20.0), is_closed=True)[0]
            for times in (seen, slowed)
        ]
        changes.append(values[1] - values[0])
    assert np.abs(np.mean(changes)) < 0.03  # 0.08 s are the luck of a sector, taken out only if the spread is known


def test_the_same_laps_say_the_same_every_time() -> None:
    seen, _, covariance = times_of(np.random.default_rng(9), 10, 0.08)
    first, again = (least_sum(seen, np.arange(10), covariance, np.full(40, 20.0), is_closed=True) for _ in range(2))
    assert first == again


@pytest.fixture(scope="module")
def bench() -> Iterator[ModuleType]:
    """The benchmark as a module; its own folder is on the path only as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("theoretical_best")


def test_the_theoretical_best_of_karts_has_a_correct_sigma(bench: ModuleType) -> None:
    scoring = importlib.import_module("scoring")
    scores: list[Any] = [bench.run(case) for case in scoring.cases("kart", range(340, 349), 240.0)]
    error, sigma = np.array([s.error for s in scores]), np.array([s.sigma for s in scores])
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.4  # of nine, one in a hundred is more
    assert np.sqrt(np.mean(error**2)) < 0.06  # 0.09 s as the plain sum, and where each sector is mended alone
    assert np.mean(sigma) < 0.06
    assert all(s.raw - 1e-9 <= s.said <= s.best + 1e-9 for s in scores)
    assert sum(s.said < s.best - 0.005 for s in scores) >= 7  # it is there to show what more there is
