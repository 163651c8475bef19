"""Units of the inertial samples by their usual size, of all and of stretches."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import RawImu
from smoother.session.plausible import (
    are_in_milli_g,
    implausible_units,
    turned_to_metres,
    turned_to_radians,
)
from smoother.units import DEG, STANDARD_GRAVITY

RATE, LASTS = 100, 120  # Hz, s


def samples(rest: float = LASTS / 3) -> tuple[Array, Array]:
    """Specific force (N, 3) m/s^2 and rate (N, 3) rad/s of a kart that stands for the first `rest` s."""
    rng = np.random.default_rng(2)
    n = RATE * LASTS
    driven = (np.arange(n) > RATE * rest)[:, None]
    force = [0.0, 0.0, STANDARD_GRAVITY] + np.where(driven, 4.0, 0.02) * rng.standard_normal((n, 3))
    rate = np.where(driven, 0.5, 0.003) * rng.standard_normal((n, 3))
    return np.asarray(force), rate


@pytest.mark.parametrize(("factor", "is_taken"), [(1.0, False), (1.0 / DEG, True), (131.0 / DEG, False)])
def test_rates_as_large_as_of_a_kart_in_degrees_are_taken_for_such(factor: float, is_taken: bool) -> None:
    rate = samples()[1]
    given = factor * rate
    said = turned_to_radians(given, "imu.csv")
    np.testing.assert_allclose(given, rate if is_taken else factor * rate)
    assert [problem.code for problem in said] == ["imu_gyro_unit"] * is_taken


@pytest.mark.parametrize(
    ("factor", "is_milli", "is_taken"),
    [
        (1e3 / DEG, True, True),
        (1e3 / DEG, False, False),
        (1.0 / DEG, True, True),
        (1.0, True, False),
        (1e6, True, False),
    ],
)
def test_rates_in_thousandths_of_a_degree_are_taken_for_such_beside_forces_in_mg(
    factor: float, is_milli: bool, is_taken: bool
) -> None:
    rate = samples()[1]
    given = factor * rate
    said = turned_to_radians(given, "imu.csv", is_milli=is_milli)
    np.testing.assert_allclose(given, rate if is_taken else factor * rate)
    assert [problem.code for problem in said] == ["imu_gyro_unit"] * is_taken


@pytest.mark.parametrize(
    "unit", [1.0, 1e3, 1.0 / STANDARD_GRAVITY, 100.0 / STANDARD_GRAVITY, 1e3 / STANDARD_GRAVITY, 1e-3]
)
@pytest.mark.parametrize("rest", [0.0, 40.0, 100.0])
def test_forces_as_small_as_gravity_in_g_are_taken_for_such(unit: float, rest: float) -> None:
    force = samples(rest)[0]
    given, t = unit * force, np.arange(len(force)) / RATE
    said = turned_to_metres(given, t, "imu.csv")
    is_taken = unit in (1.0 / STANDARD_GRAVITY, 1e3 / STANDARD_GRAVITY)
    assert are_in_milli_g(unit * force, t) is (unit == 1e3 / STANDARD_GRAVITY)
    np.testing.assert_allclose(given, force if is_taken else unit * force)
    assert [problem.code for problem in said] == ["imu_accel_unit"] * is_taken


@pytest.mark.filterwarnings("error")
def test_numbers_that_no_sensor_writes_have_no_say_in_units() -> None:
    force, rate = samples(rest=30.0)
    t = np.arange(len(force)) / RATE
    in_g, in_degrees = force / STANDARD_GRAVITY, rate / DEG
    for values in (in_g, in_degrees):
        values[::20, 2] = 1e308
    assert [problem.code for problem in turned_to_metres(in_g, t, "imu.csv")] == ["imu_accel_unit"]
    assert [problem.code for problem in turned_to_radians(in_degrees, "imu.csv")] == ["imu_gyro_unit"]


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0, 4.0])
def test_forces_without_gravity_are_not_taken_for_g(size: float) -> None:
    t = np.arange(RATE * LASTS) / RATE
    bends = np.column_stack([np.sin(0.7 * t), 0.2 + np.cos(0.9 * t), np.zeros(t.size)])
    force = size * bends + 0.1 * np.random.default_rng(4).standard_normal(bends.shape)
    assert turned_to_metres(force, t, "imu.csv") == []
    assert len(list(implausible_units(RawImu(t, force, 0.1 * bends)))) == 1


def test_a_whole_recording_in_another_unit_is_named() -> None:
    force, rate = samples()
    t = np.arange(len(force)) / RATE
    assert not list(implausible_units(RawImu(t, force, rate)))
    assert [text[:9] for text in implausible_units(RawImu(t, force / STANDARD_GRAVITY, rate / DEG))] == [
        "typically"
    ] * 2


def test_vibration_is_no_unit_where_its_mean_is_gravity() -> None:
    force, rate = samples()
    t = np.arange(len(force)) / RATE
    shaken = force + 60.0 * np.random.default_rng(4).standard_normal((len(force), 3)) * (t > 20.0)[:, None]
    assert not list(implausible_units(RawImu(t, shaken, rate)))
    assert ["ax, ay, az" in text for text in implausible_units(RawImu(t, 100.0 * shaken, rate))] == [True]
