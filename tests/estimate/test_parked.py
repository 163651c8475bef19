"""Karts that do not drive: the nose may point anywhere, and nothing tells the constants. Both must be said."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.config import Mounting
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.units import ANY_ANGLE, DEG

LATENCY, ARM = 0.25, 0.5  # s and m, sigmas of the priors


def parked(preset: str, seed: int, **changes: object) -> tuple[Simulation, Session]:
    """A minute of a kart that stands, or does what `changes` say."""
    simulation = simulate_preset(preset, seed, duration=60.0, **{"motion_driving": False, **changes})  # type: ignore[arg-type]
    return simulation, prepare(simulation.raw)


@pytest.mark.parametrize(
    ("preset", "seed", "changes"),
    [
        ("white", 0, {}),  # with a calibrated compass: it says where the box points, but not where the kart does
        ("kart", 1, {}),
        ("kart_harsh", 0, {}),
        ("kart", 0, {"motion_driving": True, "motion_top_speed": 1.5, "motion_standstill": 30.0}),  # pushed
    ],
)
def test_a_kart_that_does_not_drive_may_point_anywhere_and_identifies_no_constants(
    preset: str, seed: int, changes: dict[str, object]
) -> None:
    _, session = parked(preset, seed, **changes)
    found = GraphSmoother().estimate(session)
    assert found.sigmas is not None
    assert np.all(found.sigmas.attitude[:, 2] > 100.0 * DEG)
    assert np.all(found.sigmas.attitude[:, 2] <= ANY_ANGLE)
    told = found.report.identified
    for name in ("gps_position_latency", "gps_velocity_latency", "gps_velocity_response", "lever_arm_b", "R_bs"):
        assert not told[name].observable, name
        assert told[name].source == "default", name
    assert told["gps_position_latency"].sigma == pytest.approx(LATENCY)
    assert told["gps_velocity_latency"].sigma == pytest.approx(LATENCY)
    np.testing.assert_allclose(told["lever_arm_b"].sigma, ARM)  # type: ignore[arg-type]
    assert np.asarray(told["R_bs"].sigma)[2] > 100.0 * DEG


def test_that_the_mounting_is_stated_does_not_say_where_a_parked_kart_points() -> None:
    simulation, session = parked("kart", 1)
    mounting = Mounting(R_bs=simulation.scenario.R_bs)
    found = GraphSmoother().estimate(replace(session, config=replace(session.config, mounting=mounting)))
    assert found.sigmas is not None
    assert np.all(found.sigmas.attitude[:, 2] > 100.0 * DEG)
    assert np.all(found.sigmas.attitude[:, :2] < 10.0 * DEG)
    assert found.report.identified["R_bs"].observable
