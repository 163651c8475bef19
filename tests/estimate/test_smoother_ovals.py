"""Ovals: turn rate and push hardly vary, and what tells delays, antenna and sensor errors apart is little."""

import numpy as np
import pytest

from smoother.estimate.smoother import GraphSmoother

from .roads import FORCE_NOISE, LATENCY, RATE, hilly_oval


@pytest.mark.parametrize(("hills", "height"), [(0.0, 0.35)])
def test_delays_do_not_run_away_on_an_oval_over_hills(hills: float, height: float) -> None:
    """The antenna is above the box, as nobody knows: hills swing it, and something else has to answer for that."""
    report = GraphSmoother().estimate(hilly_oval(hills, height).session).report
    for name in ("gps_position_latency", "gps_velocity_latency"):
        found = report.identified[name]
        assert isinstance(found.value, float)
        assert isinstance(found.sigma, float)
        assert abs(found.value - LATENCY) < 3.0 * found.sigma
        assert abs(found.value - LATENCY) < 0.02
    noise = report.identified["accel_noise"].value
    assert isinstance(noise, float)
    assert noise < 2.0 * FORCE_NOISE / np.sqrt(RATE)
