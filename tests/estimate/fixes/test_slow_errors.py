"""What laps say of the slow errors of positions and of Doppler, which a drift alone does not tell apart."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import api
from smoother.arrays import Array
from smoother.estimate.fixes.slow_errors import DOPPLER, SlowErrors, SlowVelocity, slow_errors
from smoother.estimate.output import trajectory as output
from smoother.estimate.output.joint import WithUnseen
from smoother.fit.lap_registration import LapRegistration, register_laps
from smoother.samples import Session
from smoother.sim.simulation import simulate_preset

LAP, LAPS, STATIONS = 50.0, 12, 20  # s


def gauss_markov(t: Array, sigma: float, tau: float, rng: np.random.Generator) -> Array:
    """A process (N, 2) at times t (N,) s, even."""
    keep = np.exp(-(t[1] - t[0]) / tau)
    out = sigma * rng.standard_normal((len(t), 2))
    for k in range(1, len(t)):
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * out[k]
    return out


def found(
    sigma: float, doppler: SlowVelocity, *, walk: float = 0.0, knows: float = 1.0, again: float = 0.0, seeds: int = 24
) -> Array:
    """Sigmas found (seeds, 2), m and m/s, of laps of a driver who differs by 0.1 m.

    walk m^2/s: of the path, of which the solution knows a share; again m: what comes again in every lap.
    """
    out, t = [], np.arange(0.0, LAP * LAPS, 0.5)
    crossed = LAP * (np.arange(LAPS)[:, None] + np.arange(STATIONS) / STATIONS)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        own = gauss_markov(t, sigma, 100.0, rng)
        way = np.cumsum(gauss_markov(t, doppler.sigma, doppler.tau, rng) * 0.5, axis=0)
        way += np.cumsum(np.sqrt(0.5 * walk) * rng.standard_normal((len(t), 2)), axis=0)
        drift = own - way + again * np.sin(2.0 * np.pi * 3.0 * t / LAP)[:, None]
        moved = own.reshape(LAPS, -1, 2).mean(axis=1) + 0.1 * rng.standard_normal((LAPS, 2))
        laps = LapRegistration(0.1, 0.1, sigma, 0.1, 100.0, 0.1, LAP, moved, 0.1, crossed)
        errors = slow_errors(laps, t, drift, knows * walk * LAP)
        out.append([errors.sigma, errors.doppler.sigma])
    return np.array(out)


@pytest.mark.parametrize(("sigma", "doppler"), [(0.3, 0.03), (0.2, 0.01), (1.0, 0.05)])
def test_laps_tell_both_errors_apart(sigma: float, doppler: float) -> None:
    both = found(sigma, SlowVelocity(doppler, DOPPLER.tau))
    np.testing.assert_allclose(np.exp(np.mean(np.log(both), axis=0)), [sigma, doppler], rtol=0.3)
    assert np.all(np.std(np.log(both), axis=0) < 0.4)


def test_what_comes_again_in_every_lap_adds_up_to_nothing() -> None:
    doppler = SlowVelocity(0.01, DOPPLER.tau)
    np.testing.assert_allclose(found(0.1, doppler, again=1.0, seeds=6), found(0.1, doppler, seeds=6), rtol=0.05)


def test_what_the_solution_explains_is_not_the_slow_error_of_doppler() -> None:
    none = SlowVelocity(1e-6, DOPPLER.tau)
    knows, does_not = (found(0.3, none, walk=0.3**2 / LAP, knows=share)[:, 1] for share in (1.0, 0.0))
    assert np.mean(np.log(knows / does_not)) < -0.5


def test_how_much_drivers_differ_is_not_wander() -> None:
    both = found(0.03, SlowVelocity(0.03, DOPPLER.tau))
    assert np.exp(np.mean(np.log(both[:, 0]))) < 0.07


def test_a_prior_that_a_solution_has_had_is_not_counted_again() -> None:
    errors = SlowErrors(0.5, 60.0, DOPPLER)
    assert errors.beyond(100.0) == pytest.approx(0.5, rel=1e-3)
    assert 1.0 / errors.beyond(1.0) ** 2 + 1.0 == pytest.approx(4.0)
    assert errors.beyond(0.4) > 10.0


def test_of_two_errors_the_smaller_one_decides_how_far_a_place_changes() -> None:
    apart = np.array([1.0, 50.0, 1e5])
    small = SlowErrors(0.1, 60.0, SlowVelocity(1.0, 30.0)).parted(apart)
    np.testing.assert_allclose(small, -2.0 * 0.1**2 * np.expm1(-apart / 60.0), rtol=0.05)
    none = SlowErrors(100.0, 60.0, SlowVelocity(1e-4, 30.0))
    np.testing.assert_allclose(none.parted(apart[:2]), none.doppler.way(apart[:2]), rtol=0.01)


def test_a_covariance_with_both_errors_is_one_and_changes_by_what_is_left() -> None:
    class Known:
        """Known to 2 m, the same at all times."""

        def covariance(self, t: Array, direction_n: Array) -> Array:
            return np.asarray(4.0 * direction_n @ direction_n.T)

    errors = SlowErrors(0.4, 100.0, SlowVelocity(0.03, 30.0))
    t = np.linspace(0.0, 900.0, 120)
    P = WithUnseen(Known(), np.zeros(3), 4.0, errors).covariance(t, np.tile([1.0, 0.0, 0.0], (len(t), 1)))
    assert np.min(np.linalg.eigvalsh(P)) > -1e-9
    changed = P[0, 0] + P[7, 7] - 2.0 * P[0, 7]
    assert changed == pytest.approx(float(errors.parted(t[7:8])[0]), rel=0.1)


def change_of(t: Array, position_n: Array) -> float:
    found = register_laps(t, position_n[:, :2])
    assert found is not None
    return float(np.sqrt(np.mean(np.diff(found.translation_n, axis=0) ** 2)))


@pytest.fixture(scope="module")
def drifting() -> Session:
    """Seven laps of a receiver whose fixes are better than its Doppler, which is off slowly."""
    slow = {"gnss_velocity_lasting": 0.04, "gnss_velocity_tau": 30.0}
    simulation = simulate_preset("kart", 7, duration=400.0, gnss_offset_horizontal=0.2, gnss_outages=(), **slow)
    return api.prepared(simulation.raw)


def test_a_path_comes_again_like_the_fixes_and_not_like_its_doppler(
    drifting: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    fixes = change_of(drifting.gnss.t, drifting.fix_position_n)
    one = api.smooth(drifting)
    assert change_of(one.t, one.position_n) < 1.1 * fixes
    monkeypatch.setattr(output, "register_laps", lambda *_: None)
    other = api.smooth(drifting)
    assert change_of(other.t, other.position_n) > 1.5 * fixes


@pytest.mark.parametrize("imu", [True, False])
def test_the_wander_that_laps_show_is_reported_and_its_time_is_not(drifting: Session, imu: bool) -> None:
    found = api.smooth(drifting, imu=imu).report.identified
    assert found["gps_offset_sigma"].source == "identified" or not found["gps_offset_sigma"].observable
    assert not found["gps_offset_tau"].observable
    value, sigma = found["gps_offset_change"].value, found["gps_offset_change"].sigma
    assert isinstance(value, float) and isinstance(sigma, float)
    assert abs(np.log(value / 0.2)) < 1.0 and 0.1 < sigma / value < 0.8


def test_sessions_without_laps_say_nothing_of_a_change_per_lap(drifting: Session) -> None:
    keep = drifting.gnss.t < 90.0
    short = replace(drifting, gnss=drifting.gnss.select(keep))
    assert "gps_offset_change" not in api.smooth(short, imu=False).report.identified


def test_over_an_outage_nothing_is_dopplers(drifting: Session) -> None:
    t = drifting.gnss.t
    cut = replace(drifting, gnss=drifting.gnss.select((t < 180.0) | (t > 195.0)))
    found = api.smooth(cut)
    assert isinstance(found.joint, WithUnseen) and found.joint.errors is None
    assert "gps_offset_change" in found.report.identified
