"""Data types refuse what cannot be, and fill in what was not said."""

import tracemalloc

import numpy as np
import pytest

from smoother.frames import Origin
from smoother.samples import (
    BESIDE,
    GnssFixes,
    ImuSamples,
    MagSamples,
    RawImu,
    RawMag,
    Session,
    are_gaps,
    usual_steps,
)

ORIGIN = Origin(45.0, 12.0, 30.0)


def fixes(n: int = 4, **columns: np.ndarray) -> GnssFixes:
    step = 1e-5 * np.arange(n)
    base = {
        "t": np.arange(n) * 0.2,
        "lat_deg": 45.0 + step,
        "lon_deg": 12.0 + step,
        "alt_m": np.full(n, 30.0),
        "velocity_n": np.ones((n, 3)),
    }
    return GnssFixes(**{**base, **columns})


def test_samples_are_copied_and_read_only() -> None:
    t, force, rate = np.arange(3.0), np.zeros((3, 3)), np.zeros((3, 3))
    imu = ImuSamples(t, force, rate)
    force[0] = 7.0
    assert imu.specific_force_s[0, 0] == 0.0
    for array in (imu.t, imu.specific_force_s, imu.angular_rate_s):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_the_usual_interval_is_the_median_whatever_gaps_there_are() -> None:
    t = np.cumsum(np.random.default_rng(1).choice([0.004, 0.005, 0.006, 3.0], size=1000))
    imu = ImuSamples(t, np.zeros((1000, 3)), np.zeros((1000, 3)))
    assert imu.interval == np.median(np.diff(t))


def test_the_usual_interval_of_hours_is_found_without_copies_of_all_times() -> None:
    n = 3_000_000
    nothing = np.broadcast_to(0.0, (n, 3))
    imu = ImuSamples(np.arange(n) / 200.0, nothing, nothing)
    tracemalloc.start()
    interval = imu.interval
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert interval == pytest.approx(0.005)
    assert peak < 0.5 * imu.t.nbytes


def test_samples_that_come_more_slowly_for_a_while_are_no_gaps() -> None:
    steps = np.concatenate([np.full(500, 0.005), np.full(100, 0.02), np.full(500, 0.005), [0.02], np.full(99, 0.005)])
    local = usual_steps(steps, 0.005)
    np.testing.assert_array_equal(local, np.where(np.arange(1200) // 100 == 5, 0.02, 0.005))
    np.testing.assert_array_equal(np.flatnonzero(are_gaps(steps, 0.005, 1.5)), [1100])
    imu = ImuSamples(np.cumsum(steps), np.zeros((1200, 3)), np.zeros((1200, 3)))
    slow, fast = 100 * 0.02, 1099 * 0.005
    assert imu.interval == pytest.approx(0.005)
    assert imu.sampling.every == pytest.approx(np.sqrt((slow * 0.02**2 + fast * 0.005**2) / (slow + fast)), rel=0.01)


@pytest.mark.parametrize("lost", [0.1, 0.5, 0.8])
def test_samples_lost_by_chance_are_no_lower_rate(lost: float) -> None:
    kept = np.flatnonzero(np.random.default_rng(2).random(20_000) > lost)
    assert np.mean(usual_steps(np.diff(0.005 * kept), 0.005) > 0.005) < 0.01


def test_samples_too_slow_for_a_kart_or_too_few_are_gaps() -> None:
    few = np.concatenate([np.full(200, 0.005), np.full(BESIDE // 2, 0.02), np.full(200, 0.005)])
    slow = np.concatenate([np.full(200, 0.005), np.full(100, 0.08)])
    for steps in (few, slow):
        assert np.all(usual_steps(steps, 0.005) == 0.005)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda t, x: ImuSamples(t, x, x), "ImuSamples"),
        (lambda t, x: RawImu(t, x, x), "RawImu"),
        (lambda t, x: MagSamples(t, x), "MagSamples"),
        (lambda t, x: RawMag(t, x), "RawMag"),
    ],
)
def test_every_sensor_refuses_wrong_shapes_and_times_that_stand_or_run_back(make, name) -> None:
    make(np.arange(3.0), np.zeros((3, 3)))
    for wrong in (np.zeros((2, 3)), np.zeros((3, 2)), np.zeros(9)):
        with pytest.raises(ValueError, match=rf"{name}\.\w+ has shape"):
            make(np.arange(3.0), wrong)
    for t in ([0.0, 1.0, 1.0], [0.0, 2.0, 1.0]):
        with pytest.raises(ValueError, match=rf"{name}\.t is not strictly increasing"):
            make(np.array(t), np.zeros((3, 3)))
    with pytest.raises(ValueError, match=rf"{name}\.t holds a time that is not finite"):
        make(np.array([0.0, np.nan, 1.0]), np.zeros((3, 3)))


def test_raw_temperature_must_have_a_value_for_each_sample() -> None:
    x = np.zeros((3, 3))
    assert RawImu(np.arange(3.0), x, x, temperature=[20.0, np.nan, 21.0]).temperature is not None
    with pytest.raises(ValueError, match="temperature has shape"):
        RawImu(np.arange(3.0), x, x, temperature=np.zeros(2))


def test_between_keeps_the_start_drops_the_end_and_carries_the_ranges() -> None:
    t = np.arange(10.0)
    imu = ImuSamples(t, np.tile(t[:, None], 3), np.zeros((10, 3)), 100.0, 8.0)
    part = imu.between(2.0, 5.0)
    np.testing.assert_array_equal(part.t, [2.0, 3.0, 4.0])
    np.testing.assert_array_equal(part.specific_force_s[:, 0], [2.0, 3.0, 4.0])
    assert (part.accel_full_scale, part.gyro_full_scale) == (100.0, 8.0)
    assert len(imu.between(20.0, 30.0).t) == 0


def test_columns_of_fixes_that_were_not_given_are_unknown() -> None:
    gnss = fixes(3)
    for name in ("speed", "course_deg", "sigma_horizontal", "sigma_up", "sigma_velocity", "hdop", "unix_s"):
        assert np.all(np.isnan(getattr(gnss, name)))
    np.testing.assert_array_equal(gnss.num_sv, [-1, -1, -1])
    np.testing.assert_array_equal(gnss.fix, [1, 1, 1])
    assert len(gnss) == 3


def test_a_column_of_the_wrong_length_is_refused() -> None:
    for name in ("hdop", "num_sv", "alt_m"):
        with pytest.raises(ValueError, match=f"GnssFixes.{name} has shape"):
            fixes(3, **{name: np.zeros(2)})


def test_positions_of_fixes_are_north_west_up_of_the_origin() -> None:
    gnss = fixes(2, lat_deg=np.array([45.0, 45.001]), lon_deg=np.array([12.0, 12.0]), alt_m=np.array([30.0, 32.0]))
    position = gnss.position_n(ORIGIN)
    np.testing.assert_allclose(position[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(position[1], [111.13, 0.0, 2.0], atol=0.01)


def test_an_unknown_height_costs_up_only() -> None:
    position = fixes(2, alt_m=np.array([np.nan, 30.0])).position_n(ORIGIN)
    assert np.isnan(position[0, 2])
    assert np.all(np.isfinite(position[0, :2]))
    assert np.all(np.isfinite(position[1]))


@pytest.mark.parametrize("choice", [np.array([True, False, True, False]), np.array([0, 2])])
def test_select_takes_the_same_rows_of_every_column(choice: np.ndarray) -> None:
    count = np.arange(4)
    gnss = fixes(4, hdop=count + 1.0, num_sv=count, fix=count + 1, unix_s=1e9 + count)
    part = gnss.select(choice)
    np.testing.assert_array_equal(part.t, gnss.t[[0, 2]])
    np.testing.assert_array_equal(part.velocity_n, gnss.velocity_n[[0, 2]])
    np.testing.assert_array_equal(part.hdop, [1.0, 3.0])
    np.testing.assert_array_equal(part.num_sv, [0, 2])
    np.testing.assert_array_equal(part.fix, [1, 3])
    np.testing.assert_array_equal(part.unix_s, [1e9, 1e9 + 2])


def test_a_session_places_its_fixes_in_its_own_frame() -> None:
    session = Session("name", fixes(3), ORIGIN)
    np.testing.assert_array_equal(session.fix_position_n, session.gnss.position_n(ORIGIN))


@pytest.mark.parametrize("name", ["sigma_horizontal", "sigma_up", "sigma_velocity", "hdop"])
def test_a_sigma_of_nothing_is_unknown(name: str) -> None:
    given = np.array([0.0, -1.0, np.nan, 2.0])
    np.testing.assert_array_equal(getattr(fixes(4, **{name: given}), name), [np.nan, np.nan, np.nan, 2.0])
    np.testing.assert_array_equal(given, [0.0, -1.0, np.nan, 2.0])
