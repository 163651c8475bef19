"""A motion sensor that stalls repeats its last sample; a kart that stands may do so too."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import api
from smoother.arrays import Array
from smoother.session.checks.imu import frozen
from smoother.session.recorded import Recording
from smoother.sim.simulation import Simulation

DURATION = 60.0


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return api.simulate("kart", 4, duration=DURATION, motion_standstill=None, gnss_outages=())


def recording(simulation: Simulation, begin: float, end: float, *sensors: str) -> Recording:
    """The session with some sensors stalled from begin to end, s."""
    imu = simulation.raw.imu
    assert imu is not None

    def stalled(values: Array) -> Array:
        out = np.array(values)
        out[(imu.t > begin) & (imu.t < end)] = values[np.searchsorted(imu.t, begin)]
        return out

    changes = {name: stalled(getattr(imu, name)) for name in sensors}
    return Recording(simulation.raw.gnss, "gps.csv", (), (), replace(imu, **changes), "imu.csv")


@pytest.mark.parametrize("sensors", [("accel", "gyro"), ("accel",), ("gyro",)])
def test_a_sensor_that_stalls_while_the_kart_drives_is_left_out(
    simulation: Simulation, sensors: tuple[str, ...]
) -> None:
    found = frozen(recording(simulation, 20.0, 25.0, *sensors))
    assert found is not None and found.drop is not None
    t = recording(simulation, 0.0, 0.0).samples.t
    inside = (t > 20.02) & (t < 25.0)
    assert np.all(found.drop[inside])
    assert not np.any(found.drop[(t < 19.98) | (t > 25.02)])


def test_a_short_repetition_and_a_whole_session_that_moves_are_nothing(simulation: Simulation) -> None:
    assert frozen(recording(simulation, 20.0, 20.8, "accel", "gyro")) is None
    assert frozen(recording(simulation, 0.0, 0.0)) is None


def test_at_rest_nothing_need_change() -> None:
    parked = api.simulate("white", 4, duration=40.0, motion_driving=False)
    assert frozen(recording(parked, 10.0, 30.0, "accel", "gyro")) is None
