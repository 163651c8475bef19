"""What fixes wander beside the path is shared out between them and the Doppler velocities that the path follows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from smoother.arrays import Array
from smoother.estimate.fixes.offset import Drift
from smoother.estimate.fixes.slow_errors import DOPPLER, SlowVelocity
from smoother.estimate.output import trajectory as output
from smoother.estimate.output.wander import likeliest_sigma, most_probable, moved, unaided
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import Simulation, simulate_preset

TAU = 60.0  # s
WHITE = 0.01  # m


def gauss_markov(rng: np.random.Generator, t: Array, sigma: float, tau: float) -> Array:
    out = np.zeros((len(t), 2))
    out[0] = sigma * rng.normal(size=2)
    for k, h in enumerate(np.diff(t)):
        keep = np.exp(-h / tau)
        out[k + 1] = keep * out[k] + sigma * np.sqrt(1.0 - keep**2) * rng.normal(size=2)
    return out


def seen(sigma: float, seed: int, duration: float = 1200.0) -> tuple[Drift, Array]:
    """Means every 2 s of an offset of `sigma` m beside a path that followed Doppler; and the way that is Doppler's."""
    rng, fine = np.random.default_rng(seed), np.arange(0.0, duration, 0.2)
    own = gauss_markov(rng, fine, sigma, TAU)
    way = np.cumsum(gauss_markov(rng, fine, DOPPLER.sigma, DOPPLER.tau), axis=0) * 0.2
    every = slice(None, None, 10)
    t = fine[every]
    drift = (own + way)[every] + WHITE * rng.normal(size=(len(t), 2))
    return Drift(t, drift, np.zeros(len(t)), np.full(len(t), WHITE**2)), way[every]


def as_gaussian_process(drift: Drift, sigma: float, slow: SlowVelocity) -> tuple[Array, Array]:
    """Own offset and way (B, 2) by conditioning on all that was seen at once: no states, no steps."""
    t = drift.t - drift.t[0]
    lag = np.abs(t[:, None] - t[None, :])
    own = sigma**2 * np.exp(-lag / TAU)

    def e(x: Array) -> Array:
        return np.asarray(np.exp(-x / slow.tau))

    # covariance of the ways that a stationary velocity adds up to until two times, from its double integral
    first = np.minimum(t[:, None], t[None, :])
    way = slow.sigma**2 * slow.tau * (2.0 * first + slow.tau * (e(t[:, None]) + e(t[None, :]) - 1.0 - e(lag)))
    way = way + 1e6  # it may begin anywhere, as `most_probable` has it
    weights = np.linalg.solve(own + way + np.diag(drift.white), drift.drift)
    return own @ weights, way @ weights


def test_the_most_probable_is_what_conditioning_on_everything_gives() -> None:
    drift, _ = seen(0.3, 1, duration=120.0)
    uneven = np.sort(np.random.default_rng(2).choice(len(drift.t), 40, replace=False))
    few = Drift(*(values[uneven] for values in (drift.t, drift.drift, drift.walk, drift.white)))
    own, way, _ = most_probable(few, 0.3, TAU)
    wanted_own, wanted_way = as_gaussian_process(few, 0.3, DOPPLER)
    np.testing.assert_allclose(own, wanted_own, atol=2e-5)
    np.testing.assert_allclose(way, wanted_way, atol=2e-5)


def test_its_velocity_is_the_slope_of_its_way() -> None:
    drift, _ = seen(0.1, 3)
    moved_n, faster_n = moved(drift, unaided(drift, TAU), t := np.arange(100.0, 1000.0, 0.5))
    np.testing.assert_allclose(np.gradient(moved_n[:, :2], t, axis=0)[1:-1], faster_n[1:-1, :2], atol=3e-4)
    assert not moved_n[:, 2].any() and not faster_n[:, 2].any()
    _, way, velocity = most_probable(drift, likeliest_sigma(drift, TAU), TAU)
    cubic = CubicHermiteSpline(drift.t, way, velocity)
    np.testing.assert_allclose(moved_n[:, :2], cubic(t), atol=1e-12)
    np.testing.assert_allclose(faster_n[:, :2], cubic(t, nu=1), atol=1e-12)


@pytest.mark.parametrize("sigma", [0.03, 0.2, 1.5])
def test_the_sigma_of_the_fixes_own_is_found(sigma: float) -> None:
    found = [likeliest_sigma(seen(sigma, seed)[0], TAU) for seed in range(8)]
    assert float(np.exp(np.mean(np.log(found)))) == pytest.approx(sigma, rel=0.25)


def test_where_fixes_hardly_wander_most_is_dopplers_and_where_they_do_hardly_anything() -> None:
    for sigma, left in ((0.02, 0.1), (0.1, 0.5)):
        off, before = [], []
        for seed in range(6):
            drift, way = seen(sigma, seed)
            found = moved(drift, unaided(drift, TAU), drift.t)[0][:, :2]
            before.append(np.var(way, axis=0))
            off.append(np.var(found - way, axis=0))
        assert np.sqrt(np.mean(off) / np.mean(before)) < left
    drift, _ = seen(1.5, 1)
    moves = np.ptp(moved(drift, unaided(drift, TAU), drift.t)[0][:, :2], axis=0)
    assert np.all(moves < 0.5 * np.ptp(drift.drift, axis=0))


def test_before_and_after_the_nodes_it_stays() -> None:
    drift, _ = seen(0.05, 1, duration=200.0)
    moved_n, faster_n = moved(drift, unaided(drift, TAU), np.array([-9.0, 0.0, float(drift.t[-1]), 500.0]))
    np.testing.assert_array_equal(moved_n[[0, 3]], moved_n[[1, 2]])
    assert not faster_n[[0, 3]].any() and faster_n[1, 0] != 0.0


@pytest.fixture(scope="module")
def wandering() -> Simulation:
    """A receiver whose fixes hardly wander, beside Doppler velocities that do."""
    slow = {"gnss_velocity_lasting": DOPPLER.sigma, "gnss_velocity_tau": DOPPLER.tau}
    return simulate_preset("kart", 3, duration=300.0, gnss_offset_horizontal=0.02, **slow)


def beside_the_path(session: Session) -> float:
    """Rms, m, of the level offset that is left of the fixes."""
    keyframes = GraphSmoother().estimate(session).report.keyframes
    assert keyframes is not None and keyframes.gps_offset_n is not None
    return float(np.sqrt(np.mean(keyframes.gps_offset_n[:, :2] ** 2)))


def test_a_path_follows_fixes_that_wander_less_than_its_doppler(
    wandering: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = prepare(wandering.raw)
    shared = beside_the_path(session)
    monkeypatch.setattr(output, "share_wander", lambda state, *_: state)
    assert shared < 0.5 * beside_the_path(session)


def test_without_doppler_nothing_is_shared(wandering: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(output, "share_wander", refuse)
    session = prepare(wandering.raw)
    none = replace(session.gnss, velocity_n=np.full_like(session.gnss.velocity_n, np.nan))
    assert GraphSmoother().estimate(replace(session, gnss=none)).report.mode == "full"
