"""A sensor that stands still while the other goes on, and what only looks like one."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.frozen import without_frozen_sensor

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
    problems: list[Problem] = []
    return without_frozen_sensor(RawImu(T, force, rate), fixes(speed), "imu.csv", problems), problems


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
    assert "stands still for 6 s of the drive, in 3 stretches, the first from 10.0 s on" in problems[0].text


def test_one_axis_that_stands_still_for_seconds_is_left_out() -> None:
    force, rate = samples()
    imu, problems = judged(frozen(force, 20.0, 26.0, slice(0, 1)), rate)
    assert imu.t.size == T.size - 599 and "x of the accelerometer stands still" in problems[0].text


def coarse(values: Array, step: float) -> Array:
    return np.round(values / step) * step


def held(values: Array, times: int) -> Array:
    return np.repeat(values[::times], times, axis=0)


F, W = samples()


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
