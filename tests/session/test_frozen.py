"""A sensor that stands still while the other goes on, and what only looks like one."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.checks.imu import IMU_CHECKS, is_level
from smoother.session.checks.spans import constant_runs

from .checked import checked, of_code

RATE, LASTS = 100.0, 60.0  # Hz, s
T = np.arange(round(RATE * LASTS)) / RATE


def samples(seed: int = 1) -> tuple[Array, Array]:
    """Specific force (N, 3) m/s^2 and rate (N, 3) rad/s of a kart that drives."""
    rng = np.random.default_rng(seed)
    turn = np.sin(T / 3.0)
    force = np.stack([np.cos(T / 2.0), 8.0 * turn, np.full(T.size, 9.8)], axis=1) + 0.5 * rng.standard_normal(
        (T.size, 3)
    )
    rate = np.stack([0.0 * turn, 0.0 * turn, 0.8 * turn], axis=1) + 0.05 * rng.standard_normal((T.size, 3))
    return force, rate


def fixes(speed: float = 12.0) -> GnssFixes:
    t = np.arange(0.0, LASTS, 0.2)
    zero = np.zeros(t.size)
    return GnssFixes(
        t=t,
        lat_deg=45.0 + speed * t / 111_195.0,
        lon_deg=zero + 12.0,
        alt_m=zero,
        velocity_n=np.stack([zero + speed, zero, zero], axis=1),
        num_sv=np.full(t.size, 9),
        fix=np.ones(t.size, dtype=np.int64),
    )


def judged(force: Array, rate: Array, speed: float = 12.0) -> tuple[RawImu, list[Problem]]:
    return left(RawImu(T, force, rate), speed)


def left(imu: RawImu, speed: float = 12.0) -> tuple[RawImu, list[Problem]]:
    recording, problems = checked(of_code(IMU_CHECKS, "imu_sensor_frozen"), fixes(speed), imu)
    return recording.samples, problems


def longest_at_level(rate: Array) -> bool:
    """Whether the longest run of the rates about the vertical is at a level of the sensor."""
    runs = constant_runs(T, rate[:, 2:])
    longest = max(runs, key=lambda run: run[1] - run[0])
    assert longest[1] - longest[0] > 100
    return is_level(rate[:, 2:], runs, longest)


def frozen(values: Array, begin: float, end: float, axes: slice = slice(0, 3)) -> Array:
    first, last = round(begin * RATE), round(end * RATE)
    values = values.copy()
    values[first:last, axes] = values[first, axes]
    return values


@pytest.mark.parametrize("lasts", [0.4, 3.0, 20.0])
@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope"])
def test_a_sensor_that_stands_still_while_the_kart_drives_is_left_out_and_said(sensor: str, lasts: float) -> None:
    force, rate = samples()
    if sensor == "accelerometer":
        force = frozen(force, 20.0, 20.0 + lasts)
    else:
        rate = frozen(rate, 20.0, 20.0 + lasts)
    imu, problems = judged(force, rate)
    lost = round(lasts * RATE) - 1
    assert imu.t.size == T.size - lost and not np.any((imu.t > 20.005) & (imu.t < 19.995 + lasts))
    assert [(p.code, p.count) for p in problems] == [("imu_sensor_frozen", lost)]
    assert f"the {sensor} stands still for " in problems[0].text and "from 20.0 s on" in problems[0].text


def test_stretches_are_summed() -> None:
    force, rate = samples()
    for begin in (10.0, 25.0, 40.0):
        force = frozen(force, begin, begin + 2.01)
    _, problems = judged(force, rate)
    assert "stands still for 6 s in 3 parts, the first at 10.0 s of the drive" in problems[0].text


def coarse(values: Array, step: float) -> Array:
    return np.round(values / step) * step


def held(values: Array, times: int) -> Array:
    return np.repeat(values[::times], times, axis=0)


F, W = samples()
QUIET = coarse(F * np.where((T > 20.0) & (T < 24.0), [[1e-3], [1.0], [1.0]], 1.0).T, 0.5)
PUSHED_OUT = np.clip(F + 100.0 * ((T > 20.0) & (T < 23.0))[:, None] * [0.0, 1.0, 0.0], -30.0, 30.0)


@pytest.mark.parametrize(
    ("force", "rate", "speed", "why"),
    [
        (frozen(F, 20.0, 26.0), W, 0.5, "at rest nothing need change"),
        (frozen(F, 20.0, 20.2), W, 12.0, "for a fifth of a second"),
        (frozen(F, 20.0, 21.0, slice(1, 2)), W, 12.0, "one axis for a second"),
        (frozen(F, 20.0, 35.0, slice(1, 2)), W, 12.0, "an axis at fault is named and not bridged"),
        (coarse(F, 2.0), W, 12.0, "coarse steps"),
        (F, coarse(0.05 * W, 0.02), 12.0, "a gyroscope that says 0 on straights"),
        (held(F, 4), W, 12.0, "an accelerometer at a quarter of the rate"),
        (held(F, 50), held(W, 10), 12.0, "both slow"),
        (held(F, 50), W, 12.0, "an accelerometer twice a second"),
        (QUIET, W, 12.0, "coarse steps, and nothing happens for a while"),
        (PUSHED_OUT, W, 12.0, "the end of its range for seconds"),
        (np.clip(F, -3.0, 3.0), np.clip(W, -0.3, 0.3), 12.0, "the ends of their ranges"),
        (frozen(F, 20.0, 26.0), frozen(W, 20.0, 26.0), 12.0, "both together are another matter"),
    ],
)
def test_what_repeats_itself_need_not_stand_still(force: Array, rate: Array, speed: float, why: str) -> None:
    imu, problems = judged(force, rate, speed)
    assert problems == [] and imu.t.size == T.size, why


def test_an_accelerometer_that_is_held_may_stand_still_too() -> None:
    imu, problems = judged(frozen(held(F, 4), 20.0, 23.0), W)
    assert len(problems) == 1 and imu.t.size == T.size - problems[0].count
    assert 290 <= problems[0].count <= 310


def steps_of_turn(noise: float, quiet: float = 0.0) -> Array:
    """Rates (N, 3) rad/s of a kart that goes straight for half of the time, with noise in bends and `quiet` between."""
    bend = np.maximum(0.0, np.sin(T * 1.2)) * np.sign(np.sin(T * 0.6))
    rng = np.random.default_rng(5)
    turn = np.stack([0.0 * bend, 0.0 * bend, bend], axis=1)
    return turn + np.where(bend[:, None] == 0.0, quiet, noise) * rng.standard_normal((T.size, 3))


def dead_band(values: Array, band: float) -> Array:
    return np.where(np.abs(values) < band, 0.0, values)


@pytest.mark.parametrize(
    ("rate", "why"),
    [
        (dead_band(steps_of_turn(0.004), 0.05), "all axes say 0 on straights"),
        (dead_band(steps_of_turn(0.04), 0.03), "one does"),
        (
            np.add(dead_band(steps_of_turn(0.004), 0.05), [0.01, -0.02, 0.03]),
            "another value, its bias taken off",
        ),
        (coarse(np.add(steps_of_turn(0.004), 0.01), 0.03), "steps that are coarse"),
    ],
)
def test_a_gyroscope_that_says_the_same_on_every_straight_does_not_stand_still(rate: Array, why: str) -> None:
    imu, problems = judged(F, rate)
    assert problems == [] and imu.t.size == T.size, why
    assert longest_at_level(rate)


@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope"])
@pytest.mark.parametrize("value", [0.0, -0.001])
def test_a_sensor_that_fails_again_and_again_stands_still(sensor: str, value: float) -> None:
    force, rate = samples()
    values = force if sensor == "accelerometer" else rate
    for begin in (1000, 2000, 3000, 4000):
        values[begin : begin + 100] = value
    imu, problems = judged(force, rate)
    assert [problem.code for problem in problems] == ["imu_sensor_frozen"] and imu.t.size == T.size - 4 * 99


def test_a_gyroscope_with_a_dead_band_may_stand_still_too() -> None:
    rate = dead_band(steps_of_turn(0.004), 0.05)
    stop = int(np.argmax(rate[:, 2] > 0.9))
    rate[stop : stop + 900] = rate[stop]
    imu, problems = judged(F, rate)
    assert [problem.code for problem in problems] == ["imu_sensor_frozen"] and imu.t.size == T.size - 899
    assert not longest_at_level(rate)


def test_one_long_stretch_at_a_value_that_is_met_for_moments_elsewhere_counts() -> None:
    rate = dead_band(steps_of_turn(0.004), 0.05)
    stop = int(np.argmax(rate[1000:, 2] == 0.0)) + 1000
    rate[stop : stop + 2000] = 0.0
    imu, problems = judged(F, rate)
    assert [problem.code for problem in problems] == ["imu_sensor_frozen"] and imu.t.size < T.size - 1990


def test_a_stretch_ends_at_a_hole_in_the_samples() -> None:
    rate = W.copy()
    rate[1990:2010] = rate[1990]
    t = np.where(T < 20.0, T, T + 5.0)
    imu, problems = left(RawImu(t, F, rate))
    assert imu.t.size == T.size and problems == []


def test_temperatures_of_samples_that_stay_are_kept() -> None:
    imu = RawImu(T, frozen(F, 20.0, 23.0), W, temperature=T)
    kept, _ = left(imu)
    assert kept.t.size == T.size - 299 and kept.temperature is not None
    np.testing.assert_array_equal(kept.temperature, kept.t)
