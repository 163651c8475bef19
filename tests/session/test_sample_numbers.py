"""Samples lost among others that jitter by a good part of a period: each gets the number of its period."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.session.clock import find_gaps, regularize
from smoother.session.sample_numbers import number_samples

JITTERS = {
    "normal": lambda rng, size: rng.standard_normal(size),
    "late": lambda rng, size: np.abs(rng.standard_normal(size)),
    "far": lambda rng, size: 0.7 * rng.exponential(1.0, size),
}


def with_losses(count: int, period: float, share: float, seed: int) -> tuple[Array, Array]:
    """Numbers and true times of steady samples of which a share is lost, by chance."""
    number = np.flatnonzero(np.random.default_rng(seed).random(count) >= share)
    return np.asarray(number - number[0], dtype=np.float64), np.asarray(700.0 + (1.0 + 50e-6) * period * number)


def stamped(true: Array, period: float, kind: str, jitter: float) -> Array:
    """Stamps of samples taken at the true times, rounded to a ten-thousandth of a period, in order."""
    late = jitter * period * JITTERS[kind](np.random.default_rng(5), true.size)
    stamps = np.sort(np.round((true + late) / period, 4)) * period
    return np.asarray(np.maximum.accumulate(stamps) + 1e-7 * period * np.arange(true.size))


@pytest.mark.parametrize("kind", JITTERS)
@pytest.mark.parametrize(("count", "period"), [(1000, 0.2), (2000, 0.1), (20_000, 0.005)])
@pytest.mark.parametrize("share", [0.03, 0.1, 0.2])
def test_lost_samples_are_seen_through_jitter_of_a_fifth_of_a_period(
    kind: str, count: int, period: float, share: float
) -> None:
    _, true = with_losses(count, period, share, 7)
    base = regularize(stamped(true, period, kind, 0.2))
    off = (base.t - true - np.median(base.t - true)) / period
    assert base.is_steady and base.period == pytest.approx(period, rel=2e-4)
    assert np.std(off) < 0.1  # up to several periods where steps of the lag alone are looked for
    assert np.mean(np.abs(off) > 0.5) < 0.01  # single samples beside a lost one may change places with it
    assert abs(np.count_nonzero(find_gaps(base)) - np.count_nonzero(np.diff(true) > 1.5 * period)) < 0.02 * true.size


def test_numbers_tell_where_samples_were_lost() -> None:
    number, true = with_losses(3000, 0.2, 0.1, 3)
    found = number_samples(stamped(true, 0.2, "late", 0.2), 0.22)
    assert found is not None and found.period == pytest.approx(0.2, rel=2e-4)
    assert np.count_nonzero(np.diff(found.number) != np.diff(number)) <= 0.01 * number.size
    assert not np.any(found.after_hole)


def test_samples_held_up_together_keep_their_numbers_and_holes_may_be_of_any_length() -> None:
    number, true = with_losses(3000, 0.1, 0.05, 4)
    true[2000:] += 2.34
    number[2000:] += 23
    stamps = stamped(true, 0.1, "late", 0.1)
    stamps[1000:1007] = stamps[1007] - 0.002 * np.arange(7, 0, -1)
    found = number_samples(stamps, 0.1)
    assert found is not None and np.flatnonzero(found.after_hole).tolist() == [2000]
    wrong = np.flatnonzero(np.diff(found.number) != np.diff(number))
    assert np.count_nonzero(np.abs(wrong - 1003) > 10) <= 3  # where it was lost, of those held up, nothing tells
    assert np.max(np.abs(np.diff(regularize(stamps).t)[1999] - (true[2000] - true[1999]))) < 0.05


@pytest.mark.parametrize("rate", [60.0, 75.0, 80.0, 85.0])
def test_a_slower_rate_than_that_of_the_ticks_is_no_loss(rate: float) -> None:
    """Stamps of 80 samples a second, on ticks of 10 ms, are as those of a hundred of which each fifth is lost."""
    true = 3.0 + np.arange(20_000) / rate
    stamps = np.floor(true / 0.01) * 0.01 + 3e-4 * np.random.default_rng(1).random(true.size)
    base = regularize(stamps)
    assert base.period == pytest.approx(1.0 / rate, rel=5e-3)
    assert np.std(base.t - true) * rate < 0.03 and not np.any(find_gaps(base))


@pytest.mark.parametrize(("count", "share"), [(1500, 0.2), (20_000, 0.2), (20_000, 0.5)])
def test_a_sampling_that_adds_up_has_no_numbers(count: int, share: float) -> None:
    rng = np.random.default_rng(2)
    t = np.cumsum(0.1 * (1.0 + share * rng.uniform(-1.0, 1.0, count)))
    assert number_samples(t, 0.1) is None
    steps = np.where(rng.random(count) < 0.1, 1.5, 1.0) + 0.02 * rng.standard_normal(count)
    assert number_samples(np.cumsum(0.1 * steps), 0.105) is None
