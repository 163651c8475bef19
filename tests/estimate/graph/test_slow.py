"""Slow karts: accelerations no larger than the noise of the samples hardly tell how the box lies in the kart."""

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.graph.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG


@pytest.mark.parametrize(("seed", "track", "speed"), [(2, "longmeadow", 4.8), (8, "longmeadow", 6.0)])
def test_the_mounting_s_yaw_of_a_slow_kart_is_within_its_sigma(seed: int, track: str, speed: float) -> None:
    simulation = simulate_preset(
        "kart_harsh",
        seed,
        track=track,
        duration=200.0,
        motion_top_speed=speed,
        gnss_outages=(),
        motion_standstill=None if seed % 2 else 5.0,
    )
    mounting = GraphSmoother().estimate(prepare(simulation.raw)).report.identified["R_bs"]
    error = so3.log(np.asarray(mounting.value) @ simulation.scenario.R_bs.T)[2]
    sigma = np.asarray(mounting.sigma)[2]
    assert abs(error) < 2.0 * sigma
    assert abs(error) < 20.0 * DEG
