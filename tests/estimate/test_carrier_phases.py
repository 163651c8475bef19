"""Receivers that fix carrier phases (RTK): their Doppler wanders by more than positions, and must not outvote them."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.config import SessionConfig
from smoother.estimate.initial.guess import make_start
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory

DURATION = 200.0
CENTIMETRES = {
    "gnss_rate": 10.0,
    "gnss_white_horizontal": 0.007,
    "gnss_white_up": 0.012,
    "gnss_offset_horizontal": 0.01,
    "gnss_offset_up": 0.015,
    "gnss_velocity_sigma": 0.03,
    "gnss_hacc_factor": 1.0,
    "gnss_rounding": False,
    "gnss_receive_jitter": 0.0,
    "gnss_outages": (),
}


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 3, duration=DURATION, **CENTIMETRES)


@pytest.fixture(scope="module")
def session(simulation: Simulation) -> Session:
    return with_wandering_doppler(prepare(simulation.raw))


def with_wandering_doppler(session: Session, sigma: float = 0.02, memory: float = 1.0) -> Session:
    """The session with an error of velocity that is forgotten in `memory` s."""
    rng, t = np.random.default_rng(8), session.gnss.t
    keep = np.exp(-np.diff(t) / memory)
    error = np.zeros((len(t), 2))
    error[0] = sigma * rng.standard_normal(2)
    for k in range(1, len(t)):
        error[k] = keep[k - 1] * error[k - 1] + sigma * np.sqrt(1.0 - keep[k - 1] ** 2) * rng.standard_normal(2)
    velocity_n = session.gnss.velocity_n + np.column_stack([error, np.zeros(len(t))])
    return replace(session, gnss=replace(session.gnss, velocity_n=velocity_n))


def off(found: Trajectory, session: Session, simulation: Simulation) -> tuple[float, float]:
    """Rms horizontal error across the path, m, and that north and west in its sigmas.

    Along the path a millisecond by which the delay is unsure is two centimetres.
    """
    rows = (found.t > 20.0) & (found.t < DURATION - 10.0)  # it stands before
    truth = simulation.truth.trajectory(found.t[rows], simulation.scenario.lever_arm_b, session.origin)
    error = (found.position_n[rows] - truth.position_n)[:, :2]
    assert found.sigmas is not None
    ratio = error / found.sigmas.position_n[rows, :2]
    forward = truth.velocity_n[:, :2] / np.hypot(*truth.velocity_n[:, :2].T)[:, None]
    across = error[:, 0] * forward[:, 1] - error[:, 1] * forward[:, 0]
    return float(np.sqrt(np.mean(across**2))), float(np.sqrt(np.mean(ratio**2)))


def test_positions_stay_good_to_centimetres() -> None:
    errors, ratios = [], []
    for seed in (3, 4, 5):
        other = simulate_preset("kart", seed, duration=DURATION, **CENTIMETRES)
        untold = replace(other.raw, config=SessionConfig())  # nobody says what the low-pass of the samples delays
        given = with_wandering_doppler(prepare(untold))
        error, ratio = off(GraphSmoother().estimate(given), given, other)
        errors.append(error)
        ratios.append(ratio)
    assert max(errors) < 0.025  # 0.13 where the Doppler is taken for white and the offset for free
    assert np.sqrt(np.mean(np.square(ratios))) < 2.2


@pytest.mark.parametrize("rate", [2.0, 5.0, 10.0])
def test_an_accuracy_that_the_fixes_contradict_is_not_used(rate: float) -> None:
    simulation = simulate_preset("kart", 3, duration=DURATION, gnss_rate=rate, gnss_outages=())
    raw = simulation.raw
    boasting = prepare(replace(raw, gnss=replace(raw.gnss, sigma_horizontal=np.full(len(raw.gnss), 0.014))))
    assert np.isinf(make_start(boasting, GraphOptions()).noise.offset_most).all()
    _, ratio = off(GraphSmoother().estimate(boasting), boasting, simulation)
    assert ratio < 2.5


def test_without_a_reported_accuracy_nothing_is_assumed(session: Session) -> None:
    silent = replace(session, gnss=replace(session.gnss, sigma_horizontal=np.full(len(session.gnss), np.nan)))
    assert np.isinf(make_start(silent, GraphOptions()).noise.offset_most).all()
    assert make_start(session, GraphOptions()).noise.offset_most[0] < 0.05
