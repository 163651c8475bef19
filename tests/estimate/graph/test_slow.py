"""Slow karts: accelerations no larger than the noise of the samples hardly tell how the box lies in the kart."""

import numpy as np

from smoother import so3
from smoother.estimate.graph.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

SEEDS = (2, 3, 4, 6, 7, 8, 9, 10)
BY_CHANCE = 2.6  # sigmas, beyond which one of a hundred is


def mounting_yaw(seed: int, speed: float) -> tuple[float, float]:
    """Error and sigma of the mounting's yaw, rad, of 200 s of a kart that is hardly driven at `speed` m/s."""
    simulation = simulate_preset(
        "kart_harsh",
        seed,
        track="longmeadow",
        duration=200.0,
        motion_top_speed=speed,
        gnss_outages=(),
        motion_standstill=None if seed % 2 else 5.0,
    )
    mounting = GraphSmoother().estimate(prepare(simulation.raw)).report.identified["R_bs"]
    error = so3.log(np.asarray(mounting.value) @ simulation.scenario.R_bs.T)[2]
    return float(error), float(np.asarray(mounting.sigma)[2])


def test_the_mounting_s_yaw_of_a_slow_kart_is_within_its_sigma() -> None:
    found = np.array([mounting_yaw(seed, 6.0 if seed % 3 == 0 else 4.8) for seed in SEEDS])
    error, sigma = found.T
    assert np.all(np.abs(error) < BY_CHANCE * sigma)
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.4
    assert np.sqrt(np.mean(error**2)) < 16.0 * DEG
