"""Receivers whose corrections come and go: what they claim, and what comes of a session of both kinds of fixes."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.fixes.claims import ALIKE, claims_of
from smoother.prepare import prepare
from smoother.samples import GnssFixes, Session
from smoother.sim.simulation import Simulation, simulate_preset

from ..smoothed import horizontal_rms, smoothed

CENTIMETRES, METRES = 0.02, 1.5
LOST = 80.0  # s


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 7, duration=140.0, mag=None)


def with_corrections(simulation: Simulation) -> Session:
    """The session with positions to the centimetre, and a receiver that says so, until LOST."""
    session = prepare(simulation.raw)
    fixes, late = session.gnss, simulation.scenario.gnss.position_latency
    true = simulation.truth.trajectory(fixes.t - late, simulation.scenario.lever_arm_b, session.origin).position_n
    noise = 0.015 * np.random.default_rng(0).normal(size=true.shape)
    corrected = (fixes.t < LOST) & np.isfinite(true).all(axis=1)
    off = np.where(corrected[:, None], true + noise - session.fix_position_n, 0.0)
    north = off[:, 0] / 111_194.9
    west = off[:, 1] / (111_194.9 * np.cos(np.radians(fixes.lat_deg)))
    moved = replace(
        fixes,
        lat_deg=fixes.lat_deg + north,
        lon_deg=fixes.lon_deg - west,
        alt_m=fixes.alt_m + off[:, 2],
        sigma_horizontal=np.where(corrected, CENTIMETRES, METRES),
    )
    return replace(session, gnss=moved)


def claiming(fixes: GnssFixes, reported: np.ndarray) -> GnssFixes:
    return replace(fixes, sigma_horizontal=reported)


def test_stretches_are_cut_where_corrections_come_and_go(simulation: Simulation) -> None:
    fixes = prepare(simulation.raw).gnss
    n = len(fixes)
    reported = np.where((np.arange(n) >= 100) & (np.arange(n) < 200), CENTIMETRES, METRES)
    reported[300] = 20.0 * METRES  # one fix is no stretch
    claims = claims_of(claiming(fixes, reported))
    np.testing.assert_array_equal(claims.renewed, [fixes.t[[99, 100]], fixes.t[[199, 200]]])
    np.testing.assert_allclose(claims.share, [1.0, CENTIMETRES / METRES, 1.0])
    assert claims_of(claiming(fixes, np.where(np.arange(n) < 100, METRES, 3.0 * METRES))) is ALIKE
    assert claims_of(claiming(fixes, np.where(np.arange(n) < 100, METRES, 10.0 * METRES))) is ALIKE  # trees, no phases
    assert claims_of(replace(fixes, sigma_horizontal=None)) is ALIKE


def test_the_wander_begins_anew_and_is_as_large_as_claimed(simulation: Simulation) -> None:
    fixes = prepare(simulation.raw).gnss
    keyframes, middle = 0.2 * np.arange(31), 3.0
    t = np.array([middle - 2.0, middle - 1.0, middle - 0.6, middle - 0.4, middle - 0.2, middle - 0.1])
    t = np.concatenate([t, 2.0 * middle - t[::-1]]) + 0.3
    few = replace(fixes.select(np.arange(12)), t=t, sigma_horizontal=np.repeat([CENTIMETRES, METRES], 6))
    share, anew = claims_of(few).between(keyframes, 0.3)
    assert share[0] == CENTIMETRES / METRES
    assert share[-1] == 1.0
    assert np.any(anew)
    assert np.all(share[anew] == 1.0)
    assert np.all(np.abs(keyframes[:-1][anew] - middle) < 0.4)


def test_a_line_goes_on_where_corrections_are_lost(simulation: Simulation) -> None:
    s = smoothed(simulation, with_corrections(simulation))
    t, sigma = s.trajectory.t, s.trajectory.sigmas
    assert sigma is not None
    before, after = (t > 20.0) & (t < LOST - 1.0), t > LOST + 1.0
    assert horizontal_rms(s.error_n[before]) < 0.1
    assert horizontal_rms(s.error_n[after]) < 1.2  # 4.3 with one slow error of all fixes
    z = s.error_n[after, :2] / sigma.position_n[after, :2]
    assert np.sqrt(np.mean(z**2)) < 1.5
    assert np.median(sigma.track[after]) > 3.0 * np.median(sigma.track[before])
