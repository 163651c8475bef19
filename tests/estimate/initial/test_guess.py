"""What is known before the first solve."""

from dataclasses import replace

from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.initial.guess import make_start
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset


def test_a_stated_delay_of_positions_does_not_make_the_velocities_seem_early() -> None:
    simulation = simulate_preset("kart", 5, duration=80.0, motion_standstill=None, gnss_outages=())
    session, gnss = prepare(simulation.raw), simulation.scenario.gnss
    timing = replace(session.config.gps, position_latency=gnss.position_latency)
    stated = replace(session, config=replace(session.config, gps=timing))
    position, velocity = make_start(stated, GraphOptions()).priors.constants[:2]
    assert position == gnss.position_latency
    assert abs(velocity - gnss.velocity_latency) < 0.06
    assert abs(velocity - make_start(session, GraphOptions()).priors.constants[1]) < 0.01
