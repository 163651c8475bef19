"""Units of the inertial samples by their usual size, of all and of stretches."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import Problem, RawImu
from smoother.session.plausible import (
    SHORTEST_UNIT,
    are_exchanged,
    are_in_milli_g,
    implausible_units,
    turned_to_metres,
    turned_to_radians,
    without_other_units,
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


def judged(force: Array, rate: Array, scale: float = 1.0) -> tuple[RawImu, list[Problem]]:
    """What is left of samples that are written as counts of `scale`."""
    problems: list[Problem] = []
    imu = RawImu(np.arange(len(force)) / RATE, force / scale, rate / scale, scale, scale)
    return without_other_units(imu, "imu.csv", problems), problems


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


@pytest.mark.parametrize("of_force", [1.0, 1.0 / STANDARD_GRAVITY, 1e3])
@pytest.mark.parametrize("of_rate", [1.0, 1.0 / DEG, 131.0 / DEG])
@pytest.mark.parametrize("rest", [0.0, 40.0, 100.0])
def test_forces_and_rates_are_exchanged_where_gravity_is_with_the_rates(
    of_force: float, of_rate: float, rest: float
) -> None:
    force, rate = samples(rest)
    t = np.arange(len(force)) / RATE
    assert not are_exchanged(of_force * force, of_rate * rate, t)
    force[RATE * 30 : RATE * 40, 2] *= -1.0  # turned over in the hand
    known = np.ones(len(t), dtype=np.bool_) if rest else t > 50.0
    assert are_exchanged(rate[known], force[known], t[known])
    assert not are_exchanged(rate[:50], force[:50], t[:50]), "too few to tell"


@pytest.mark.parametrize("force_unit", [1.0, 1.0 / STANDARD_GRAVITY])
def test_a_circle_that_is_driven_all_the_time_is_not_gravity(force_unit: float) -> None:
    """At 9.8 deg/s, written in deg/s, the rates are as large; gravity is where it belongs."""
    force, rate = samples(rest=0.0)
    rate += [0.0, 0.0, STANDARD_GRAVITY * DEG]
    assert not are_exchanged(force_unit * force, rate / DEG, np.arange(len(force)) / RATE)


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
    assert are_exchanged(rate, np.where(in_g > 1e300, in_g, force), t)
    assert [problem.code for problem in turned_to_metres(in_g, t, "imu.csv")] == ["imu_accel_unit"]
    assert [problem.code for problem in turned_to_radians(in_degrees, "imu.csv")] == ["imu_gyro_unit"]


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0, 4.0])
def test_forces_without_gravity_are_not_taken_for_g(size: float) -> None:
    t = np.arange(RATE * LASTS) / RATE
    bends = np.column_stack([np.sin(0.7 * t), 0.2 + np.cos(0.9 * t), np.zeros(t.size)])
    force = size * bends + 0.1 * np.random.default_rng(4).standard_normal(bends.shape)
    assert turned_to_metres(force, t, "imu.csv") == []
    assert len(list(implausible_units(RawImu(t, force, 0.1 * bends)))) == 1


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_samples_of_a_kart_that_stands_and_drives_all_stay(scale: float) -> None:
    imu, problems = judged(*samples(), scale)
    assert problems == [] and len(imu.t) == RATE * LASTS


@pytest.mark.parametrize("scale", [1.0, 1e-3])
@pytest.mark.parametrize(("begin", "end"), [(62, 93), (63, 92), (0, 31)])
@pytest.mark.parametrize(
    ("of_force", "of_rate", "said"),
    [
        (1.0 / STANDARD_GRAVITY, 1.0, "m/s^2, where gravity alone gives 9.8; are ax, ay, az in m/s^2? "),
        (1.0, 1.0 / DEG, "rad/s, which no kart turns; are gx, gy, gz in rad/s? "),
    ],
)
def test_a_stretch_in_another_unit_is_left_out_and_said(
    of_force: float, of_rate: float, said: str, scale: float, begin: int, end: int
) -> None:
    force, rate = samples(rest=31.0 if begin else 0.0)
    other = slice(RATE * begin, RATE * end)
    force[other] *= of_force
    rate[other] *= of_rate
    imu, problems = judged(force, rate, scale)
    assert not np.any((imu.t > begin - 0.01) & (imu.t < end)), "all of it, though it begins within a window"
    assert len(imu.t) >= RATE * (LASTS - 31 - 20), "no more than two windows beside it"
    assert [(p.code, p.count) for p in problems] == [("imu_unit_changes", RATE * LASTS - len(imu.t))]
    assert problems[0].text.startswith("imu.csv: from ") and said in problems[0].text


def test_a_stop_between_is_of_the_stretch() -> None:
    """In deg/s, a kart that stands for ten seconds turns as fast as one that drives in rad/s."""
    force, rate = samples()
    rate[RATE * 70 : RATE * 80] = 0.003 * np.random.default_rng(3).standard_normal((RATE * 10, 3))
    rate[RATE * 60 :] /= DEG
    imu, problems = judged(force, rate)
    assert imu.t[-1] <= 60.0 and len(problems) == 1


@pytest.mark.parametrize(
    ("spin", "begin", "end", "why"),
    [
        (12.0, 10, 18, "a box that is spun in the hand"),
        (15.0, 62, 64, "a kart that spins round itself"),
        (9.0, 50, 110, "a box on a steering wheel that is never still"),
    ],
)
def test_turning_fast_is_no_unit(spin: float, begin: int, end: int, why: str) -> None:
    force, rate = samples()
    if end - begin > SHORTEST_UNIT:
        rate *= 8.0
    rate[RATE * begin : RATE * end, 2] = spin
    imu, problems = judged(force, rate)
    assert problems == [] and len(imu.t) == RATE * LASTS, why


def test_a_box_that_is_thrown_is_no_unit() -> None:
    force, rate = samples()
    force[RATE * 62 : RATE * 64] *= 0.1
    imu, problems = judged(force, rate)
    assert problems == [] and len(imu.t) == RATE * LASTS


def test_samples_of_which_hardly_any_would_be_left_all_stay() -> None:
    force, rate = samples(rest=0.0)
    for begin in range(5, LASTS, 15):
        force[RATE * begin : RATE * (begin + 5)] /= STANDARD_GRAVITY
    imu, problems = judged(force, rate)
    assert problems == [] and len(imu.t) == RATE * LASTS


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
    imu, problems = judged(shaken, rate)
    assert problems == [] and len(imu.t) == RATE * LASTS
    assert not list(implausible_units(RawImu(t, shaken, rate)))
    assert ["ax, ay, az" in text for text in implausible_units(RawImu(t, 100.0 * shaken, rate))] == [True]
