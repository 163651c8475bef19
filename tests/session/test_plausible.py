"""Units of the inertial samples by their usual size."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.checks.imu import USABLE
from smoother.units import DEG, STANDARD_GRAVITY

from .checked import checked

RATE, LASTS = 100, 120  # Hz, s


def samples(rest: float = LASTS / 3) -> tuple[Array, Array]:
    """Specific force (N, 3) m/s^2 and rate (N, 3) rad/s of a kart that stands for the first `rest` s."""
    rng = np.random.default_rng(2)
    n = RATE * LASTS
    driven = (np.arange(n) > RATE * rest)[:, None]
    force = [0.0, 0.0, STANDARD_GRAVITY] + np.where(driven, 4.0, 0.02) * rng.standard_normal((n, 3))
    rate = np.where(driven, 0.5, 0.003) * rng.standard_normal((n, 3))
    return np.asarray(force), rate


FIXES = GnssFixes(np.arange(2.0), *(np.array([45.0, 45.1]) for _ in range(3)), np.zeros((2, 3)))


def judged(force: Array, rate: Array) -> tuple[RawImu | None, list[Problem]]:
    recording, problems = checked(USABLE, FIXES, RawImu(np.arange(len(force)) / RATE, force, rate))
    return recording.imu, problems


def codes(problems: list[Problem]) -> list[str]:
    return [problem.code for problem in problems]


@pytest.mark.parametrize(("factor", "is_taken"), [(1.0, False), (1.0 / DEG, True)])
def test_rates_as_large_as_of_a_kart_in_degrees_are_taken_for_such(factor: float, is_taken: bool) -> None:
    force, rate = samples()
    imu, problems = judged(force, factor * rate)
    assert imu is not None and codes(problems) == ["imu_gyro_unit"] * is_taken
    np.testing.assert_allclose(imu.gyro * imu.gyro_scale, rate)


def test_rates_that_no_unit_explains_leave_the_fixes() -> None:
    force, rate = samples()
    imu, problems = judged(force, 131.0 / DEG * rate)
    assert imu is None and codes(problems) == ["imu_implausible"] and "are gx, gy, gz in rad/s?" in problems[0].text


@pytest.mark.parametrize(("forces", "is_taken"), [(1e3 / STANDARD_GRAVITY, True), (1.0, False)])
def test_rates_in_thousandths_of_a_degree_are_taken_for_such_beside_forces_in_mg(forces: float, is_taken: bool) -> None:
    force, rate = samples()
    imu, problems = judged(forces * force, 1e3 / DEG * rate)
    assert codes(problems) == (["imu_accel_unit", "imu_gyro_unit"] if is_taken else ["imu_implausible"])
    assert (imu is not None) == is_taken
    if imu is not None:
        np.testing.assert_allclose(imu.gyro * imu.gyro_scale, rate)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1.0 / STANDARD_GRAVITY, 100.0 / STANDARD_GRAVITY, 1e3 / STANDARD_GRAVITY])
@pytest.mark.parametrize("rest", [0.0, 40.0, 100.0])
def test_forces_as_small_as_gravity_in_g_are_taken_for_such(unit: float, rest: float) -> None:
    force, rate = samples(rest)
    imu, problems = judged(unit * force, rate)
    is_taken = unit in (1.0 / STANDARD_GRAVITY, 1e3 / STANDARD_GRAVITY)
    assert codes(problems) == ["imu_accel_unit" if is_taken else "imu_implausible"] * (unit != 1.0)
    assert (imu is not None) == (is_taken or unit == 1.0)
    if imu is not None:
        np.testing.assert_allclose(imu.accel * imu.accel_scale, force)


@pytest.mark.filterwarnings("error")
def test_numbers_that_no_sensor_writes_have_no_say_in_units() -> None:
    force, rate = samples(rest=30.0)
    in_g, in_degrees = force / STANDARD_GRAVITY, rate / DEG
    for values in (in_g, in_degrees):
        values[::20, 2] = 1e308
    assert codes(judged(in_g, in_degrees)[1]) == ["imu_accel_unit", "imu_gyro_unit"]


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0, 4.0])
def test_forces_without_gravity_are_not_taken_for_g(size: float) -> None:
    t = np.arange(RATE * LASTS) / RATE
    bends = np.column_stack([np.sin(0.7 * t), 0.2 + np.cos(0.9 * t), np.zeros(t.size)])
    force = size * bends + 0.1 * np.random.default_rng(4).standard_normal(bends.shape)
    assert codes(judged(force, 0.1 * bends)[1]) == ["imu_implausible"]


def test_vibration_is_no_unit_where_its_mean_is_gravity() -> None:
    force, rate = samples()
    t = np.arange(len(force)) / RATE
    shaken = force + 60.0 * np.random.default_rng(4).standard_normal((len(force), 3)) * (t > 20.0)[:, None]
    assert judged(shaken, rate)[1] == []
    (problem,) = judged(100.0 * shaken, rate)[1]
    assert "ax, ay, az" in problem.text
