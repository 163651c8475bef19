"""Single samples that no motion makes: left out and counted; what a kart does to a sensor is left as it is."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.checks.imu import IMU_CHECKS
from smoother.session.checks.spikes import MOST_SPIKES
from smoother.session.load import load_raw

from .checked import checked, of_code

RATE = 200.0
FIXES = GnssFixes(np.arange(2.0), *(np.array([45.0, 45.1]) for _ in range(3)), np.zeros((2, 3)))


def without_spikes(imu: RawImu) -> tuple[RawImu, list[Problem]]:
    recording, problems = checked(of_code(IMU_CHECKS, "imu_spikes"), FIXES, imu)
    return recording.samples, problems


def driven(vibration: float = 3.0, count: int = 20_000) -> RawImu:
    """Samples of a kart that shakes by `vibration` m/s^2."""
    rng = np.random.default_rng(5)
    accel = vibration * rng.standard_normal((count, 3)) + [0.0, 0.0, 9.8]
    return RawImu(np.arange(count) / RATE, accel, 0.1 * rng.standard_normal((count, 3)))


def with_values(imu: RawImu, sensor: str, rows: Array, axis: int, value: object) -> RawImu:
    values = np.array(getattr(imu, sensor))
    values[rows, axis] = value
    return replace(imu, **{sensor: values})


@pytest.mark.parametrize(
    ("sensor", "value", "vibration"),
    [
        ("accel", 900.0, 3.0),
        ("accel", -156.9, 3.0),
        ("accel", 900.0, 10.0),  # as harsh as simulated karts are
        ("gyro", 34.9, 3.0),
        ("gyro", -17.4, 3.0),
    ],
)
@pytest.mark.parametrize("burst", [1, 2, 3])
def test_values_that_stick_out_alone_are_left_out_and_counted(
    sensor: str, value: float, vibration: float, burst: int
) -> None:
    clean = driven(vibration)
    rows = (np.arange(250, 20_000, 500)[:, None] + np.arange(burst)).ravel()
    imu, problems = without_spikes(with_values(clean, sensor, rows, 1, value))
    assert [(problem.code, problem.count) for problem in problems] == [("imu_spikes", rows.size)]
    others = np.setdiff1d(np.arange(clean.t.size), rows)
    np.testing.assert_array_equal(imu.t, clean.t[others])
    np.testing.assert_array_equal(getattr(imu, sensor), getattr(clean, sensor)[others])


def test_counts_of_a_sensor_are_judged_in_si() -> None:
    clean = driven()
    counts = RawImu(clean.t, np.round(clean.accel * 200), np.round(clean.gyro * 1000), 1 / 200, 1 / 1000)
    assert without_spikes(counts)[0] is counts
    _, problems = without_spikes(with_values(counts, "accel", np.array([700]), 2, 32767.0))
    assert [problem.count for problem in problems] == [1]


@pytest.mark.parametrize(("sensor", "value"), [("accel", 14.0), ("accel", -12.0), ("gyro", 2.0), ("gyro", -1.6)])
def test_of_a_sensor_that_is_hardly_shaken_less_sticks_out(sensor: str, value: float) -> None:
    """A car: sixty such samples in a quarter of an hour put the delays of the GPS off by ten of their sigmas."""
    clean, rows = driven(0.2), np.arange(250, 20_000, 500)
    clean = replace(clean, gyro=0.1 * clean.gyro)
    imu, problems = without_spikes(with_values(clean, sensor, rows, 1, value))
    assert [problem.count for problem in problems] == [rows.size]
    np.testing.assert_array_equal(imu.t, np.delete(clean.t, rows))


def test_a_knock_may_be_a_single_sample_of_a_slow_sensor() -> None:
    calm = driven(0.2, 3000)
    slow = with_values(replace(calm, t=8.0 * calm.t), "accel", np.array([700, 1500]), 2, 14.0)
    assert without_spikes(slow)[0] is slow


def hit() -> RawImu:
    """A hit on a kerb of 25 g in one sample, that rings on."""
    imu = driven()
    ringing = 250.0 * np.exp(-np.arange(12) / 2.0) * np.cos(np.arange(12) * 1.9)
    return with_values(imu, "accel", 1000 + np.arange(12), 2, ringing)


def clipped() -> RawImu:
    """Vibration of 20 g at the edges of a range of 16 g."""
    imu = driven(vibration=200.0)
    return replace(imu, accel=np.clip(imu.accel, -156.9, 156.9))


def shaken_now_and_then() -> RawImu:
    """An engine that shakes the box to its edges for a tenth of a second in ten."""
    imu = driven()
    rows = (np.arange(100, 20_000, 2000)[:, None] + np.arange(20)).ravel()
    rng = np.random.default_rng(8)
    return with_values(imu, "accel", rows, 0, np.clip(200.0 * rng.standard_normal(rows.size), -156.9, 156.9))


def many() -> RawImu:
    """More spikes than a good recording has."""
    return with_values(driven(), "accel", np.arange(10, 20_000, 10), 0, 900.0)


@pytest.mark.parametrize("make", [driven, hit, clipped, shaken_now_and_then, many])
def test_what_a_kart_does_to_a_sensor_stays_as_it_is(make: object) -> None:
    assert MOST_SPIKES < 0.1
    imu = make()  # type: ignore[operator]
    kept, problems = without_spikes(imu)
    assert kept is imu and not problems


def test_no_real_recording_has_any(data_directory: object) -> None:
    tables = sorted(data_directory.glob("*/imu.csv"))  # type: ignore[attr-defined]
    sessions = [table.parent for table in tables if (table.parent / "gps.csv").exists()]
    assert sessions
    for session in sessions:
        assert "imu_spikes" not in [problem.code for problem in load_raw(session).problems], session
