"""An IMU in another unit is found by the motion of the path: converted where the unit is known, not used otherwise."""

import dataclasses

import numpy as np
import pytest

from smoother.estimate.initial.align import in_known_units
from smoother.samples import RawSession
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG


@pytest.fixture(scope="module")
def kart() -> RawSession:
    return simulate_preset("kart", 4, duration=60.0).raw


def scaled(raw: RawSession, accel: float = 1.0, gyro: float = 1.0) -> RawSession:
    assert raw.imu is not None
    imu = dataclasses.replace(
        raw.imu, accel_scale=accel * raw.imu.accel_scale, gyro_scale=gyro * raw.imu.gyro_scale, gyro_full_scale=gyro
    )
    return dataclasses.replace(raw, imu=imu)


@pytest.mark.parametrize(("accel", "gyro"), [(1.0, 1.0), (1.2, 1.5), (0.85, 0.7)])
def test_a_sensor_that_is_right_or_nearly_so_stays(kart: RawSession, accel: float, gyro: float) -> None:
    raw = scaled(kart, accel, gyro)
    assert in_known_units(raw) is raw


@pytest.mark.parametrize(
    ("gyro", "unit"),
    [(DEG, "rad/s where deg/s belong"), (1 / DEG, "deg/s where rad/s"), (1e3, "thousandths of a")],
)
def test_a_gyroscope_in_a_known_unit_is_converted_and_reported(kart: RawSession, gyro: float, unit: str) -> None:
    raw = in_known_units(scaled(kart, gyro=gyro))
    assert raw.imu is not None and kart.imu is not None
    assert raw.imu.gyro_scale == pytest.approx(kart.imu.gyro_scale) and raw.imu.gyro_full_scale == pytest.approx(1.0)
    (problem,) = [p for p in raw.problems if p not in kart.problems]
    assert problem.code == "imu_gyro_unit" and unit in problem.text


@pytest.mark.parametrize(
    ("accel", "gyro", "said"),
    [
        (1.0, 0.1, "times that of the course of the fixes; are gx, gy, gz in rad/s?"),
        (1.0, 10.0, "times that of the course of the fixes; are gx, gy, gz in rad/s?"),
        (2.0, 1.0, "times gravity; are ax, ay, az in m/s^2?"),
        (0.5, 1.0, "times gravity; are ax, ay, az in m/s^2?"),
    ],
)
def test_a_sensor_that_is_off_by_any_other_factor_is_left_out_and_reported(
    kart: RawSession, accel: float, gyro: float, said: str
) -> None:
    raw = in_known_units(scaled(kart, accel, gyro))
    assert raw.imu is None
    assert said in raw.problems[-1].text and raw.problems[-1].text.endswith(": smoothed from GPS alone")


def test_samples_that_have_nothing_to_do_with_the_fixes_are_left_for_the_smoother(kart: RawSession) -> None:
    assert kart.imu is not None
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(kart.imu.gyro.shape) / kart.imu.gyro_scale
    raw = dataclasses.replace(kart, imu=dataclasses.replace(kart.imu, gyro=0.01 * noise))
    assert in_known_units(raw) is raw


def test_without_velocities_nothing_is_judged(kart: RawSession) -> None:
    still = dataclasses.replace(kart.gnss, velocity_n=np.full((len(kart.gnss), 3), np.nan))
    raw = scaled(dataclasses.replace(kart, gnss=still), gyro=0.1)
    assert in_known_units(raw) is raw
