"""A clock that ran fast or slow for a while, in samples and fixes alike, beside the receiver's UTC."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import Beside, GnssFixes, Problem, RawImu, WheelSpeed
from smoother.session.pace import with_even_pace
from smoother.sim.simulation import simulate_preset

BEGIN, END = 60.0, 120.0  # s


def run_fast(t: Array, by: float) -> Array:
    return np.asarray(t + by * np.clip(t - BEGIN, 0.0, END - BEGIN))


def recording(seed: int, preset: str = "kart", **changes: float) -> tuple[GnssFixes, RawImu, Beside]:
    raw = simulate_preset(preset, seed, duration=180.0, **changes).raw
    assert raw.imu is not None and raw.mag is not None
    return raw.gnss, raw.imu, Beside(raw.mag, WheelSpeed(raw.mag.t, np.full(len(raw.mag.t), 10.0)))


def fast(of: tuple[GnssFixes, RawImu, Beside], by: float) -> tuple[GnssFixes, RawImu, Beside]:
    gnss, imu, beside = of
    return (
        replace(gnss, t=run_fast(gnss.t, by)),
        replace(imu, t=run_fast(imu.t, by)),
        beside.retimed(lambda t: run_fast(t, by)),
    )


@pytest.mark.parametrize("seed", [31, 32])
@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
@pytest.mark.parametrize("by", [0.01, -0.01, 0.003])
def test_a_minute_of_another_pace_is_taken_out_of_all_sensors(seed: int, preset: str, by: float) -> None:
    problems: list[Problem] = []
    true = recording(seed, preset)
    found = with_even_pace(*fast(true, by), "gps.csv", problems)
    found_beside, true_beside = found[2], true[2]
    pairs = [(found[0], true[0]), (found[1], true[1]), (found_beside.mag, true_beside.mag)]
    for one, other in [*pairs, (found_beside.wheel_speed, true_beside.wheel_speed)]:
        assert one is not None and other is not None
        assert np.max(np.abs(one.t - other.t)) < 0.03 + 2.5 * abs(by)  # a knot is 5 s, of stamps that jitter
        assert np.all(np.diff(one.t) > 0.0)
    assert [problem.code for problem in problems] == ["clock_pace"]
    assert (
        f"{100 * abs(by):.1g} % {'fast' if by > 0 else 'slow'} from " in problems[0].text or "0.99" in problems[0].text
    )


def test_fixes_once_a_second_show_it_too() -> None:
    true = recording(33, gnss_rate=1.0)
    found = with_even_pace(*fast(true, 0.01), "gps.csv", [])
    assert found[1] is not None and np.max(np.abs(found[1].t - true[1].t)) < 0.05


@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
def test_a_clock_that_runs_evenly_stays_as_it_is(preset: str) -> None:
    for seed in (34, 35):
        true = recording(seed, preset)
        problems: list[Problem] = []
        assert with_even_pace(*true, "gps.csv", problems) == true and not problems


def test_fixes_that_waited_in_a_queue_do_not_move_the_samples() -> None:
    gnss, imu, beside = recording(36)
    late = replace(gnss, t=run_fast(gnss.t, 0.01))
    assert with_even_pace(late, imu, beside, "gps.csv", []) == (late, imu, beside)


def test_utc_that_ran_away_is_said_and_not_followed() -> None:
    gnss, imu, beside = recording(37)
    assert gnss.unix_s is not None
    wrong = replace(gnss, unix_s=gnss.unix_s + run_fast(gnss.t, 0.03) - gnss.t)
    problems: list[Problem] = []
    assert with_even_pace(wrong, imu, beside, "gps.csv", problems) == (wrong, imu, beside)
    assert [problem.code for problem in problems] == ["clock_pace_doubtful"]


@pytest.mark.parametrize("step", [0.5, -0.5, 3.0])
def test_a_clock_that_was_set_is_none_that_ran_otherwise(step: float) -> None:
    gnss, imu, beside = recording(38)
    assert gnss.unix_s is not None
    was_set = replace(gnss, unix_s=gnss.unix_s + step * (gnss.t > 90.0))
    assert with_even_pace(was_set, imu, beside, "gps.csv", []) == (was_set, imu, beside)


def test_without_utc_nothing_is_changed() -> None:
    gnss, imu, beside = fast(recording(39), 0.01)
    unknown = replace(gnss, unix_s=np.full(len(gnss), np.nan))
    assert with_even_pace(unknown, imu, beside, "gps.csv", []) == (unknown, imu, beside)
