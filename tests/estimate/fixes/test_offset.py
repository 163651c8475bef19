"""The slow error of the fixes is found where there is one, of the size and time it has, and nowhere else."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.fixes.offset import (
    ANYWHERE,
    FEWEST,
    PRICE,
    OffsetFit,
    OffsetModel,
    drift_against_doppler,
    fit_offset,
    follows_positions,
    offset_model,
    shows_offset,
    unseen_variance,
)
from smoother.estimate.fixes.path import GnssPath, fit_gnss_path
from smoother.frames import nwu_to_geodetic

Made = tuple[np.ndarray, GnssPath]
USUAL = OffsetModel(np.array([2.0, 2.0, 3.4]), 60.0)
UNFILTERED = {"white": (2.5, 2.5, 4.3)}


@pytest.fixture(scope="module")
def fits(lap_fixes: Callable) -> Callable[..., Made]:
    def make(**changes: object) -> Made:
        made = lap_fixes(**changes)
        return made.session.gnss.t, fit_gnss_path(made.session)

    return make


def fitted(made: Made) -> OffsetFit:
    assert tells(*made)
    return fit_offset(drift_against_doppler(*made))


def tells(fixes_t: np.ndarray, path: GnssPath) -> bool:
    return shows_offset(fixes_t, drift_against_doppler(fixes_t, path), path)


@pytest.fixture(scope="module")
def half_hours(fits: Callable[..., Made]) -> list[Made]:
    """Filtered fixes at 2 Hz with an offset of 2 m and 40 s."""
    return [fits(seed=seed, duration=1800.0, rate=2.0, tau=40.0) for seed in range(4)]


@pytest.mark.parametrize("seed", range(4))
def test_white_fixes_show_no_offset(fits: Callable[..., Made], seed: int) -> None:
    made = fits(seed=seed, duration=300.0, offset=(0.0, 0.0, 0.0), **UNFILTERED)
    # twice the logarithm is chi square with two degrees of freedom at most, and above 2 * PRICE in one of seven; half
    # of these have it at the edge of zero
    assert fitted(made).evidence < 2.0 * PRICE
    assert np.all(offset_model(*made, USUAL, is_filtered=False).sigma <= USUAL.sigma)


def test_most_white_fixes_are_taken_to_have_none(fits: Callable[..., Made]) -> None:
    made = [fits(seed=seed, duration=200.0, offset=(0.0, 0.0, 0.0), **UNFILTERED) for seed in range(10, 18)]
    sigma = [offset_model(*m, USUAL, is_filtered=False).sigma[0] for m in made]
    assert np.count_nonzero(np.array(sigma) < 0.02) >= 7


def test_an_offset_under_white_noise_is_found_where_it_matters(fits: Callable[..., Made]) -> None:
    made = fits(seed=1, duration=600.0, offset=(2.0, 2.0, 3.4), **UNFILTERED)
    assert fitted(made).evidence > 10.0 * PRICE
    sigma = offset_model(*made, USUAL, is_filtered=False).sigma
    assert 1.0 < sigma[0] <= 2.0
    assert sigma[2] / sigma[0] == pytest.approx(1.7)


def test_sigma_and_time_of_a_long_session_are_within_their_spread(half_hours: list[Made]) -> None:
    for made in half_hours:
        found = fitted(made)
        assert found.tau_spread < 0.4
        assert abs(math.log(found.tau / 40.0)) < 3.0 * found.tau_spread
        # 2 sigma^2 / tau is known from every step, sigma from 45 times tau and two axes
        assert found.sigma**2 / found.tau == pytest.approx(2.0**2 / 40.0, rel=0.3)
        assert found.sigma == pytest.approx(2.0, rel=0.4)


def test_the_time_constant_is_observable_in_long_sessions_alone(
    half_hours: list[Made], fits: Callable[..., Made]
) -> None:
    models = [offset_model(*made, USUAL, is_filtered=True) for made in half_hours]
    told = [m for m in models if math.isfinite(m.tau_spread)]
    assert len(told) >= 2
    assert all(m.tau != USUAL.tau and m.tau_spread < 0.3 for m in told)
    assert all(m.tau == USUAL.tau for m in models if not math.isfinite(m.tau_spread))
    ten_minutes = fits(seed=5, duration=600.0, rate=2.0)
    assert math.isinf(offset_model(*ten_minutes, USUAL, is_filtered=True).tau_spread)


@pytest.mark.parametrize(("seed", "duration"), [(1, 800.0), (4, 800.0), (5, 800.0), (1, 1400.0)])
def test_reflections_of_every_lap_are_not_all_that_fixes_wander_by(
    lap_fixes: Callable, seed: int, duration: float
) -> None:
    session = lap_fixes(
        seed=seed, duration=duration, rate=2.0, tau=100.0, white=(0.05, 0.05, 0.1), offset=(1.2, 1.2, 2.0), doppler=0.05
    ).session
    t, rng = session.gnss.t, np.random.default_rng(seed)
    beside_the_stand = np.exp(-0.5 * (((t + 16.0) % 32.0 - 16.0) / 3.0) ** 2)
    off = 3.0 * beside_the_stand * rng.normal(1.0, 0.3, 50)[np.floor((t + 16.0) / 32.0).astype(int)]
    position_n = session.fix_position_n + off[:, None] * np.array([0.8, -0.6, 0.0])
    lat_deg, lon_deg, alt_m = nwu_to_geodetic(position_n, session.origin)
    session = replace(session, gnss=replace(session.gnss, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))
    path = fit_gnss_path(session)
    found = offset_model(t, path, USUAL, is_filtered=True)
    unseen = unseen_variance(found, float(path.position_sigma[0]), USUAL.sigma, len(t))
    assert found.tau == USUAL.tau  # it was 17 to 24 s
    assert found.sigma[0] ** 2 + unseen[0] >= USUAL.sigma[0] ** 2  # it was 1 m, and nothing unseen


@pytest.mark.parametrize("sigma", [0.1, 2.0, 4.0])
@pytest.mark.parametrize("duration", [100.0, 500.0])
def test_the_walk_of_the_offset_is_observable_in_a_minute(
    fits: Callable[..., Made], sigma: float, duration: float
) -> None:
    for seed in range(3):
        made = fits(seed=seed, duration=duration, offset=(sigma, sigma, 1.7 * sigma), tau=60.0, white=(0.05, 0.05, 0.1))
        found = offset_model(*made, USUAL, is_filtered=True)
        # fifty steps of two axes: their variance is known to a fifth, and candidates a quarter apart in sigma; in 2 s
        # an offset of 0.1 m walks 0.03 m and Doppler 0.1 m, of which it may have a part
        assert found.sigma[0] == pytest.approx(sigma, rel=0.5, abs=0.4)
        assert found.tau == USUAL.tau


def test_a_walk_that_fixes_cannot_tell_is_the_usual_one(fits: Callable[..., Made]) -> None:
    assert offset_model(*fits(duration=300.0, doppler=None), USUAL, is_filtered=True) is USUAL
    t, path = fits(duration=2.0 * FEWEST - 10.0)
    few = offset_model(t, path, USUAL, is_filtered=True)
    np.testing.assert_allclose(few.sigma, USUAL.sigma * path.wander)  # as identified with the path


def test_the_drift_is_the_offset_and_what_doppler_adds_up_to(lap_fixes: Callable) -> None:
    made = lap_fixes(seed=3, duration=300.0)
    session = made.session
    seen = drift_against_doppler(session.gnss.t, fit_gnss_path(session))
    offset = np.stack([np.interp(seen.t, session.gnss.t, made.offset_n[:, i]) for i in range(2)], axis=1)
    rest = seen.drift - offset
    steps = rest[10:] - rest[:-10]
    expected = np.mean(np.convolve(seen.walk[1:], np.ones(10), "valid")) + 2.0 * np.mean(seen.white)
    # 29 disjoint steps of 20 s and two axes: their variance is known to 2 / sqrt(58)
    assert 0.5 < np.mean(steps**2) / expected < 1.6


def test_without_doppler_or_with_few_fixes_nothing_is_identified(fits: Callable[..., Made]) -> None:
    alone = fits(duration=300.0, doppler=None)
    assert not tells(*alone)
    assert offset_model(*alone, USUAL, is_filtered=False).sigma[0] == pytest.approx(0.4)
    assert not tells(*fits(duration=2.0 * FEWEST - 10.0))


def test_an_outage_has_no_information(fits: Callable[..., Made]) -> None:
    """Over a gap Doppler cannot be added up: what its path does there must not pass for an offset."""
    made = fits(seed=2, duration=300.0, offset=(0.0, 0.0, 0.0), outages=((100.0, 112.0), (200.0, 206.0)), **UNFILTERED)
    assert fitted(made).evidence < 2.0 * PRICE


@pytest.mark.filterwarnings("error")
def test_a_pause_of_an_hour_leaves_numbers(fits: Callable[..., Made]) -> None:
    made = fits(seed=2, duration=4000.0, outages=((150.0, 3750.0),))
    found = fitted(made)
    assert np.isfinite([found.sigma, found.tau, found.evidence]).all()
    assert np.max(drift_against_doppler(*made).walk) <= 1.1 * ANYWHERE**2


def test_a_path_that_follows_its_fixes_is_no_judge_of_them(fits: Callable[..., Made]) -> None:
    sparse, dense = (fits(seed=1, duration=300.0, rate=rate) for rate in (1.0, 5.0))
    assert follows_positions(*sparse) and not follows_positions(*dense)
    assert not tells(*sparse)
    model = offset_model(*sparse, USUAL, is_filtered=True)
    np.testing.assert_allclose(model.sigma, USUAL.sigma * sparse[1].wander)
    assert 1.0 < model.sigma[0] < 4.0  # it is 2.0
