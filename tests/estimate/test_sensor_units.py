"""A motion sensor in another unit is found by the motion, converted where the unit is known, left out else."""

import dataclasses

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.sensor_units import in_known_units
from smoother.samples import RawSession
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG, STANDARD_GRAVITY


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
def test_a_gyroscope_in_a_known_unit_is_converted_and_said(kart: RawSession, gyro: float, unit: str) -> None:
    raw = in_known_units(scaled(kart, gyro=gyro))
    assert raw.imu is not None and kart.imu is not None
    assert raw.imu.gyro_scale == pytest.approx(kart.imu.gyro_scale) and raw.imu.gyro_full_scale == pytest.approx(1.0)
    (problem,) = [p for p in raw.problems if p not in kart.problems]
    assert problem.code == "imu_gyro_unit" and unit in problem.text


@pytest.mark.parametrize(
    ("accel", "gyro", "said"),
    [
        (1.0, 0.1, "times as fast as the course of the fixes; are gx, gy, gz in rad/s?"),
        (1.0, 10.0, "times as fast as the course of the fixes; are gx, gy, gz in rad/s?"),
        (2.0, 1.0, "times gravity; are ax, ay, az in m/s^2?"),
        (0.5, 1.0, "times gravity; are ax, ay, az in m/s^2?"),
    ],
)
def test_a_sensor_that_is_off_by_any_other_factor_is_left_out_and_said(
    kart: RawSession, accel: float, gyro: float, said: str
) -> None:
    raw = in_known_units(scaled(kart, accel, gyro))
    assert raw.imu is None
    assert said in raw.problems[-1].text and raw.problems[-1].text.endswith(": smoothed from GPS alone")


def shaken(raw: RawSession, rms: float, most: float) -> RawSession:
    """As by an engine, from sample to sample, along the third axis, and clipped upwards at `most` m/s^2."""
    assert raw.imu is not None
    force = raw.imu.accel * raw.imu.accel_scale
    shaken_by = rms * np.random.default_rng(1).standard_normal(len(force))
    down = np.array([0.0, 0.0, 1.0])
    force = np.clip(force + shaken_by[:, None] * down, -np.inf, most)
    imu = dataclasses.replace(raw.imu, accel=force, accel_scale=1.0, accel_full_scale=None)
    return dataclasses.replace(raw, imu=imu)


@pytest.mark.parametrize(
    ("rms", "most", "said"),
    [
        (60.0, 1000.0, "rms: attitude, delays and line are poorer. Damp the box"),
        (60.0, 80.0, "of an axis at the end of the range: attitude, delays and line are poorer. Damp the box, or "),
    ],
)
def test_vibration_is_named_as_what_it_is_and_the_sensor_stays(
    kart: RawSession, rms: float, most: float, said: str
) -> None:
    raw = in_known_units(shaken(kart, rms, most))
    assert raw.imu is not None
    (problem,) = [p for p in raw.problems if p not in kart.problems]
    assert problem.code == "imu_vibration" and said in problem.text


def test_another_unit_is_asked_for_though_the_box_is_shaken(kart: RawSession) -> None:
    raw = in_known_units(scaled(shaken(kart, 60.0, 1000.0), accel=2.0))
    assert raw.imu is None
    assert [p.code for p in raw.problems][-2:] == ["imu_vibration", "imu_implausible"]


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


def by_axis(raw: RawSession, sensor: str, scales: tuple[float, float, float]) -> RawSession:
    assert raw.imu is not None
    values = getattr(raw.imu, sensor) * np.array(scales)
    return dataclasses.replace(raw, imu=dataclasses.replace(raw.imu, **{sensor: values}))


@pytest.mark.parametrize("seed", [6, 7])
@pytest.mark.parametrize(
    ("sensor", "scales"),
    [
        ("gyro", (DEG, DEG, 1.0)),  # as where one axis is in deg/s, and all were divided
        ("gyro", (1.0 / DEG, 1.0, 1.0)),
        ("gyro", (1.0, DEG, 1.0)),
        ("gyro", (1.0, 1.0, 1.0 / DEG)),
        ("accel", (1.0 / STANDARD_GRAVITY, 1.0, 1.0)),
        ("accel", (1.0 / STANDARD_GRAVITY, 1.0 / STANDARD_GRAVITY, 1.0)),
    ],
)
def test_axes_of_one_sensor_in_two_units_are_brought_to_one(
    sensor: str, scales: tuple[float, float, float], seed: int
) -> None:
    right = simulate_preset("kart", seed, duration=90.0, R_bs=so3.exp(np.array([0.04, -0.05, 1.0]))).raw
    raw = in_known_units(by_axis(right, sensor, scales))
    assert raw.imu is not None and right.imu is not None
    scale = getattr(raw.imu, f"{sensor}_scale") / getattr(right.imu, f"{sensor}_scale")
    np.testing.assert_allclose(getattr(raw.imu, sensor) * scale, getattr(right.imu, sensor), rtol=1e-9)
    (problem,) = (problem for problem in raw.problems if problem.code == "imu_axis_unit")
    assert problem.text.startswith(f"only with {sensor[0]}") and problem.text.endswith("taken so")


@pytest.mark.parametrize(("size", "hertz"), [(0.1, 25.0), (0.3, 15.0), (1.0, 8.0)])
def test_a_level_box_that_rocks_on_rubber_is_no_sensor_in_two_units(size: float, hertz: float) -> None:
    """Rocking by `size` deg makes gx and gy scatter tens of times as much as gz."""
    right = simulate_preset("kart", 6, duration=90.0, R_bs=so3.exp(np.array([0.0, 0.0, 1.0])), imu_gyro_tone=0.0).raw
    assert right.imu is not None
    angle = 2.0 * np.pi * hertz * right.imu.t
    rocking = size * DEG * 2.0 * np.pi * hertz * np.column_stack([np.cos(angle), np.sin(1.1 * angle), 0.0 * angle])
    rocked = dataclasses.replace(
        right, imu=dataclasses.replace(right.imu, gyro=right.imu.gyro + rocking / right.imu.gyro_scale)
    )
    assert "imu_axis_unit" not in [problem.code for problem in in_known_units(rocked).problems]


@pytest.mark.parametrize("scales", [(0.5, 1.0, 1.0), (1.0, 0.2, 1.0), (1.0, 1.0, 0.4)])
def test_an_axis_by_any_other_factor_is_not_converted(kart: RawSession, scales: tuple[float, float, float]) -> None:
    raw = in_known_units(by_axis(kart, "accel", scales))
    assert all(problem.code != "imu_axis_unit" for problem in raw.problems)


@pytest.mark.parametrize("preset", ["kart", "kart_harsh", "white"])
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_axes_in_one_unit_stay(preset: str, seed: int) -> None:
    raw = simulate_preset(preset, seed, duration=90.0).raw
    assert in_known_units(raw).imu is raw.imu
