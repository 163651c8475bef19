"""A short drive as the logger sends it, simulated once."""

from dataclasses import dataclass

import pytest

from smoother.session.log_frames import encode_frames
from smoother.sim.record_log import drive_records
from smoother.sim.simulation import Simulation, simulate_preset


@dataclass(frozen=True)
class Drive:
    """A simulation and its bytes on the line."""

    simulation: Simulation
    stream: bytes


@pytest.fixture(scope="session")
def drive() -> Drive:
    simulation = simulate_preset("kart", 5, duration=60.0)
    return Drive(simulation, encode_frames(drive_records(simulation)))
