"""The table of fusion.md section 4, written out a second time and compared."""

import numpy as np
import pytest

from smoother.errors import UsageError
from smoother.sim.presets import PRESETS, draw_scenario
from smoother.units import DEG, STANDARD_GRAVITY

G = STANDARD_GRAVITY
SEEDS = range(60)

#                        white                kart                        kart_harsh
IMU = {
    "rate": (200.0, 200.0, 200.0),
    "accel_noise": (0.05, 0.15, 0.5),
    "gyro_noise": (0.2 * DEG, 0.7 * DEG, 3.0 * DEG),
    "accel_tone": (0.5, 4.0, 8.0),
    "gyro_tone": (2.0 * DEG, 30.0 * DEG, 90.0 * DEG),
    "accel_bias_walk": (0.002, 0.003, 0.005),
    "gyro_bias_walk": (0.003 * DEG, 0.005 * DEG, 0.01 * DEG),
    "accel_range": (None, 16.0 * G, 8.0 * G),
    "gyro_range": (None, 1000.0 * DEG, 500.0 * DEG),
    "jitter": (0.0, 1e-3, 4e-3),
}
GNSS = {
    "rate": (5.0, 5.0, 5.0),
    "velocity": (True, True, True),
    "has_vertical_velocity": (False, False, False),
    "white_horizontal": (2.5, 0.2, 0.3),
    "white_up": (4.3, 0.35, 0.5),
    "offset_horizontal": (0.0, 2.0, 3.0),
    "offset_up": (0.0, 3.4, 5.0),
    "velocity_sigma": (0.15, 0.15, 0.25),
}
STANDSTILL = (30.0, 5.0, None)


def all_of(preset, duration=600.0):
    return [draw_scenario(preset, np.random.default_rng(seed), duration=duration) for seed in SEEDS]


@pytest.mark.parametrize(("column", "preset"), list(enumerate(PRESETS)))
def test_fixed_figures_are_those_of_the_table(column, preset):
    for scenario in all_of(preset)[:3]:
        for group, table in (("imu", IMU), ("gnss", GNSS)):
            actual = {name: getattr(getattr(scenario, group), name) for name in table}
            assert actual == {name: row[column] for name, row in table.items()}
        assert scenario.motion.standstill == STANDSTILL[column]
        assert (scenario.mag.rate, scenario.mag.noise) == (10.0, 0.02)
        assert scenario.mag.engine_disturbance == (0.0, 0.05, 0.2)[column]
        if column:
            assert scenario.gnss.offset_tau == (60.0, 40.0)[column - 1]
        assert (scenario.motion.rpm_low, scenario.motion.rpm_high) == (6000.0, 16000.0)
        assert len(scenario.imu.harmonics) == 3  # the tone and two harmonics


@pytest.mark.parametrize(("column", "preset"), list(enumerate(PRESETS)))
def test_biases_scales_and_misalignments_have_the_size_of_the_table_and_any_sign(column, preset):
    accel, gyro = (0.2, 0.3, 0.5)[column], (1.0, 5.0, 10.0)[column] * DEG
    scale, misalignment = (0.0, 0.01, 0.02)[column], (0.0, 0.5, 1.0)[column] * DEG
    off_diagonal = ~np.eye(3, dtype=bool)
    for imu in (s.imu for s in all_of(preset)):
        np.testing.assert_allclose(np.abs(imu.accel_bias), accel)
        np.testing.assert_allclose(np.abs(imu.gyro_bias), gyro)
        for matrix in (imu.accel_matrix, imu.gyro_matrix):
            np.testing.assert_allclose(np.abs(np.diag(matrix) - 1.0), scale, atol=1e-12)
            np.testing.assert_allclose(np.abs(matrix[off_diagonal]), misalignment)
    signs = np.array([np.sign(s.imu.gyro_bias) for s in all_of(preset)])
    assert np.all(np.abs(np.mean(signs, axis=0)) < 0.5)
    drifts = [s.imu.clock_drift for s in all_of(preset)]
    np.testing.assert_allclose(np.abs(drifts), (0.0, 50e-6, 200e-6)[column])


@pytest.mark.parametrize(
    ("preset", "position", "extra"), [("kart", (0.05, 0.2), (0.04, 0.14)), ("kart_harsh", (0.05, 0.4), (0.0, 0.2))]
)
def test_latencies_fill_their_ranges(preset, position, extra):
    first = np.array([s.gnss.position_latency for s in all_of(preset)])
    more = np.array([s.gnss.velocity_latency for s in all_of(preset)]) - first
    for values, (low, high) in ((first, position), (more, extra)):
        assert low <= np.min(values) < low + 0.15 * (high - low)
        assert high - 0.15 * (high - low) < np.max(values) <= high


@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
def test_lever_arm_components_lie_between_two_and_six_decimetres(preset):
    arms = np.array([s.lever_arm_b for s in all_of(preset)])
    assert 0.2 <= np.min(np.abs(arms)) < 0.23 and 0.57 < np.max(np.abs(arms)) <= 0.6
    assert np.all(np.abs(np.mean(np.sign(arms), axis=0)) < 0.5)


def test_white_is_level_aligned_prompt_and_complete():
    for s in all_of("white")[:5]:
        np.testing.assert_allclose(s.R_bs, np.eye(3), atol=1e-15)
        np.testing.assert_array_equal(s.lever_arm_b, 0.0)
        assert (s.gnss.position_latency, s.gnss.velocity_latency) == (0.0, 0.0)
        assert (s.gnss.hacc_factor, s.gnss.sacc_factor) == (1.0, 1.0)
        assert (s.gnss.outages, s.gnss.jumps, s.imu.gaps) == ((), (), ())
        assert s.mag.calibration_points > 0 and np.all(s.mag.hard_iron_s == 0.0)


def test_kart_is_tilted_by_at_most_30_degrees_and_turned_anyhow():
    up = np.array([s.R_bs[2, 2] for s in all_of("kart")])
    tilt = np.degrees(np.arccos(up))
    assert np.max(tilt) <= 30.0 and np.max(tilt) > 25.0 and np.min(tilt) < 5.0
    yaw = np.degrees([np.arctan2(s.R_bs[1, 0], s.R_bs[0, 0]) for s in all_of("kart")])
    assert np.min(yaw) < -140.0 and np.max(yaw) > 140.0


def test_the_harsh_preset_has_any_mounting():
    up = np.array([s.R_bs[2, 2] for s in all_of("kart_harsh")])
    assert np.min(up) < -0.9 and np.max(up) > 0.9
    for s in all_of("kart_harsh"):
        np.testing.assert_allclose(s.R_bs @ s.R_bs.T, np.eye(3), atol=1e-12)


def test_kart_reports_wrong_accuracies_and_harsh_none():
    factors = np.array([(s.gnss.hacc_factor, s.gnss.sacc_factor) for s in all_of("kart")])
    assert 0.5 <= np.min(factors) < 0.6 and 1.9 < np.max(factors) <= 2.0
    assert all(s.gnss.hacc_factor is None and s.gnss.sacc_factor is None for s in all_of("kart_harsh"))


def test_outages_jumps_and_gaps_are_as_many_and_as_large_as_in_the_table():
    for s in all_of("kart"):
        assert [o.duration for o in s.gnss.outages] == [5.0]
        assert s.gnss.jumps == () and s.imu.gaps == ()
    for s in all_of("kart_harsh"):
        assert len(s.gnss.outages) == 3 and all(5.0 <= o.duration <= 20.0 for o in s.gnss.outages)
        sizes = [np.linalg.norm(j.offset_n) for j in s.gnss.jumps]
        assert len(sizes) == 10 and min(sizes) >= 10.0 and max(sizes) <= 50.0
        assert [gap.duration for gap in s.imu.gaps] == [0.15]
        for interval in (*s.gnss.outages, *s.gnss.jumps, *s.imu.gaps):
            assert interval.start > 0.0 and interval.start + interval.duration < s.duration


def test_harsh_figures_fit_into_a_short_session():
    for s in all_of("kart_harsh", duration=20.0):
        lost = sum(o.duration for o in s.gnss.outages)
        assert lost < 0.8 * 20.0


def test_draws_of_one_seed_repeat_and_another_seed_differs():
    first, again, other = (draw_scenario("kart", np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.lever_arm_b, again.lever_arm_b)
    np.testing.assert_array_equal(first.R_bs, again.R_bs)
    assert first.gnss.position_latency == again.gnss.position_latency != other.gnss.position_latency


def test_unknown_preset_names_those_there_are():
    with pytest.raises(UsageError, match="white, kart, kart_harsh"):
        draw_scenario("rental", np.random.default_rng(0))
