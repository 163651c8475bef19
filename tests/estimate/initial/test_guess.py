"""What is known before the first solve."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.factors.graph import MAX_LATENCY, GraphOptions
from smoother.estimate.initial.guess import keyframe_times, make_start
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset


def test_a_stated_delay_of_positions_does_not_make_the_velocities_seem_early() -> None:
    simulation = simulate_preset("kart", 5, duration=80.0, motion_standstill=None, gnss_outages=())
    session, gnss = prepare(simulation.raw), simulation.scenario.gnss
    timing = replace(session.config.gps, position_latency=gnss.position_latency)
    stated = replace(session, config=replace(session.config, gps=timing))
    priors, usual = (make_start(given, GraphOptions()).priors.constants for given in (stated, session))
    velocity = priors["velocity_latency"][0][0]
    assert priors["position_latency"][0][0] == gnss.position_latency
    assert abs(velocity - gnss.velocity_latency) < 0.06
    assert abs(velocity - usual["velocity_latency"][0][0]) < 0.01


@pytest.mark.parametrize(("begin", "end"), [(0.0, 1.0), (3.0, 3.01), (5.0, 5.0), (0.0, 0.2 * 3000)])
def test_keyframes_cover_all_that_fixes_may_be_read_at(begin: float, end: float) -> None:
    t = keyframe_times(begin, end, 0.2)
    assert len(t) >= 2
    assert t[0] == begin - MAX_LATENCY
    assert end + 0.2 - 1e-6 <= t[-1] < end + 0.4 + 1e-6
    np.testing.assert_allclose(np.diff(t), 0.2)
