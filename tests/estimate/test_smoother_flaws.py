"""The smoother on sessions with something missing, wrong or in the wrong place: no harm, and said."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.frames import euler_from_rotation, wrap_angle
from smoother.prepare import prepare
from smoother.samples import ImuSamples, MagSamples
from smoother.sim.scenario import Interval, Jump
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import BOX_ON_WHEEL
from smoother.units import DEG

from .smoothed import Smoothed, horizontal_rms, smoothed


def flawed(**changes: object) -> Smoothed:
    return smoothed(simulate_preset("white", 4, duration=90.0, motion_standstill=5.0, **changes))


@pytest.fixture(scope="module")
def clean() -> Smoothed:
    return flawed()


class TestFlaws:
    """Each flaw alone, on white noise with Doppler, against the same session without it."""

    def test_an_outage_of_ten_seconds_is_bridged(self, clean: Smoothed) -> None:
        s = flawed(gnss_outages=(Interval(50.0, 10.0),))
        inside = (s.trajectory.t > 50.0) & (s.trajectory.t < 60.0)
        # no fix for 150 m and a corner or two, and all of it at the accuracy of the inertial sensor
        assert horizontal_rms(s.error_n[inside]) < horizontal_rms(clean.error_n) + 1.0
        assert np.max(np.linalg.norm(s.error_n[inside, :2], axis=1)) < 3.0
        sigma = s.trajectory.sigmas
        assert sigma is not None
        middle = np.searchsorted(s.trajectory.t, 55.0)
        assert np.all(sigma.position_n[middle, :2] > np.median(sigma.position_n[:, :2], axis=0))

    def test_jumps_of_thirty_metres_are_rejected(self, clean: Smoothed) -> None:
        starts = (15.0, 27.0, 40.0, 52.0, 61.0, 77.0)
        jumps = tuple(Jump(start, 0.9, np.array([30.0 * np.cos(start), 30.0 * np.sin(start), 0.0])) for start in starts)
        s = flawed(gnss_jumps=jumps)
        assert horizontal_rms(s.error_n) < horizontal_rms(clean.error_n) + 0.2
        fixes = s.trajectory.report.fixes
        assert fixes is not None
        t = s.session.gnss.t[fixes.index]
        thrown = np.any([(t >= start) & (t < start + 0.9) for start in starts], axis=0)
        assert np.count_nonzero(thrown) > 20
        assert np.all(fixes.weight[thrown] < 0.3)
        assert np.mean(fixes.weight[~thrown] > 0.9) > 0.95

    def test_a_sensor_that_warms_up_tilts_no_attitude(self, clean: Smoothed) -> None:
        """By 0.3 m/s^2 to the end of the drive; by 1 m/s^2 errors of roll and pitch are 2.6 sigmas."""
        imu = clean.session.imu
        assert imu is not None
        warm = (1.0 - np.exp(-(imu.t - imu.t[0]) / 30.0))[:, None]
        drifting = imu.specific_force_s + 0.3 * warm * [1.0, -0.7, 0.4]
        session = replace(clean.session, imu=replace(imu, specific_force_s=drifting))
        known = smoothed(clean.simulation, session)
        sigma = known.trajectory.sigmas
        assert sigma is not None
        assert np.sqrt(np.mean((known.euler_error[:, :2] / sigma.attitude[:, :2]) ** 2)) < 1.6

    def test_without_a_magnetometer_only_the_yaw_at_rest_suffers(self, clean: Smoothed) -> None:
        s = flawed(mag=None)
        assert s.trajectory.report.mode == "full"
        assert horizontal_rms(s.error_n) < horizontal_rms(clean.error_n) + 0.2
        driving = s.trajectory.t > 20.0
        assert np.sqrt(np.mean(s.euler_error[driving, 2] ** 2)) < 0.5 * DEG

    def test_a_useless_magnetometer_is_left_out_and_named(self, clean: Smoothed) -> None:
        mag = clean.session.mag
        assert mag is not None
        nonsense = MagSamples(mag.t, np.random.default_rng(0).normal(size=mag.field_s.shape))
        s = smoothed(clean.simulation, replace(clean.session, mag=nonsense))
        assert "magnetometer_unused" in [p.code for p in s.trajectory.report.problems]
        driving = s.trajectory.t > 20.0
        assert np.sqrt(np.mean(s.euler_error[driving, 2] ** 2)) < 0.5 * DEG

    def test_a_gap_of_the_inertial_samples_is_bridged_with_a_larger_sigma(self, clean: Smoothed) -> None:
        s = flawed(imu_gaps=(Interval(50.0, 1.0),))
        assert s.trajectory.report.mode == "full"
        assert horizontal_rms(s.error_n) < horizontal_rms(clean.error_n) + 0.2
        assert np.max(np.linalg.norm(s.error_n[:, :2], axis=1)) < 3.0
        sigma, at = s.trajectory.sigmas, np.searchsorted(s.trajectory.t, [40.0, 50.5])
        assert sigma is not None
        assert sigma.speed[at[1]] > 1.5 * sigma.speed[at[0]]

    def test_clipped_samples_do_little_harm(self, clean: Smoothed) -> None:
        s = flawed(imu_accel_range=0.7 * 9.80665 + 9.80665, imu_gyro_range=1.2)
        assert horizontal_rms(s.error_n) < 2.0 * horizontal_rms(clean.error_n) + 0.3


class TestDegrading:
    """Whatever is missing: the result is no worse than the fixes, and says what it is."""

    def test_without_inertial_samples_the_fixes_are_smoothed_alone(self) -> None:
        s = smoothed(simulate_preset("white", 4, duration=100.0, imu=None, mag=None))
        assert s.trajectory.report.mode == "gps-only"
        assert horizontal_rms(s.error_n) < horizontal_rms(s.raw_error_n)

    @pytest.mark.parametrize("kind", ["stuck", "dead", "noise", "late", "mirrored", "half as large"])
    def test_a_sensor_that_is_wrong_does_no_harm(self, kind: str) -> None:
        simulation = simulate_preset("white", 4, duration=100.0, motion_standstill=5.0, mag=None)
        session = prepare(simulation.raw)
        assert session.imu is not None
        t, force, rate = session.imu.t, session.imu.specific_force_s, session.imu.angular_rate_s
        rng = np.random.default_rng(0)
        wrong = {
            "stuck": ImuSamples(t, np.tile([0.0, 0.0, 9.80665], (len(t), 1)), np.zeros_like(rate)),
            "dead": ImuSamples(t, np.zeros_like(force), np.zeros_like(rate)),
            "noise": ImuSamples(t, 10.0 * rng.normal(size=force.shape), rng.normal(size=rate.shape)),
            "late": ImuSamples(t + 5.0, force, rate),
            "mirrored": ImuSamples(t, force * [1.0, -1.0, 1.0], rate),
            "half as large": ImuSamples(t, 0.5 * force, rate),
        }
        s = smoothed(simulation, replace(session, imu=wrong[kind]))
        assert np.all(np.isfinite(s.trajectory.position_n))
        assert horizontal_rms(s.error_n) < horizontal_rms(s.raw_error_n)
        told = {p.code: p.text for p in s.trajectory.report.problems}
        if kind in ("stuck", "dead", "noise", "late"):
            assert s.trajectory.report.mode == "gps-only"
            assert "one clock" in told["imu_unusable"] and "[gps] position_latency" in told["imu_unusable"]

    @pytest.mark.parametrize("of_another_drive", [False, True])
    def test_samples_of_another_drive_are_detected_with_one_fix_in_five_seconds(self, of_another_drive: bool) -> None:
        simulation = simulate_preset("kart", 71, duration=200.0, imu_accel_noise=0.9, track="tinbarn")
        session = prepare(simulation.raw)
        rare = session.gnss.select(np.arange(8, len(session.gnss), 25))
        if of_another_drive:
            other = simulate_preset("kart", 72, duration=200.0, imu_accel_noise=0.9, track="larkfield")
            session = replace(session, imu=prepare(other.raw).imu)
        s = smoothed(simulation, replace(session, gnss=rare, mag=None))
        assert s.trajectory.report.mode == ("gps-only" if of_another_drive else "full")
        told = {p.code for p in s.trajectory.report.problems}
        assert ("imu_unusable" in told) == of_another_drive

    def test_with_one_fix_in_ten_seconds_the_sensor_shows_the_bends_between(self) -> None:
        """Of the laps such fixes show little: alone they are 9 m/s off."""
        simulation = simulate_preset("kart", 71, duration=250.0, track="tinbarn")
        session = prepare(simulation.raw)
        rare = session.gnss.select(np.arange(8, len(session.gnss), 50))
        s = smoothed(simulation, replace(session, gnss=rare, mag=None))
        assert s.trajectory.report.mode == "full"
        assert s.trajectory.report.problems == ()
        driving = np.linalg.norm(s.velocity_error_n[:, :2], axis=1)[s.trajectory.t > 15.0]
        assert np.sqrt(np.mean(driving**2)) < 0.8

    def test_a_kart_that_never_moved_stays_where_it_is(self) -> None:
        s = smoothed(simulate_preset("white", 4, duration=28.0))
        assert np.max(np.abs(s.velocity_error_n)) < 0.5
        assert horizontal_rms(s.error_n) < horizontal_rms(s.raw_error_n)

    def test_a_handful_of_fixes_is_no_reason_to_fail(self) -> None:
        simulation = simulate_preset("white", 4, duration=60.0, motion_standstill=5.0)
        session = prepare(simulation.raw)
        few = replace(session, gnss=session.gnss.select(np.arange(100, 106)))
        trajectory = GraphSmoother().estimate(few)
        assert trajectory.report.mode == "gps-only"
        assert np.all(np.isfinite(trajectory.position_n[:, :2]))
        assert [p.text.partition(" are")[0] for p in trajectory.report.problems if p.code == "gps_too_few"] == [
            "6 fixes"
        ]

    def test_seconds_together_that_are_too_few_are_not_called_none(self) -> None:
        session = prepare(simulate_preset("white", 4, duration=60.0, motion_standstill=5.0, mag=None).raw)
        assert session.imu is not None
        trajectory = GraphSmoother().estimate(replace(session, imu=session.imu.between(20.0, 24.5)))
        told = {p.code: p.text for p in trajectory.report.problems}
        assert trajectory.report.mode == "gps-only" and "imu_elsewhere" not in told
        assert "only 4.5 s in common (at least 5)" in told["imu_too_short"]

    def test_inertial_samples_of_another_day_do_no_harm(self) -> None:
        simulation = simulate_preset("white", 4, duration=60.0, motion_standstill=5.0, mag=None)
        session = prepare(simulation.raw)
        assert session.imu is not None
        imu = session.imu
        other = replace(session, imu=ImuSamples(imu.t + 1e5, imu.specific_force_s, imu.angular_rate_s))
        s = smoothed(simulation, other)
        assert "imu_elsewhere" in [p.code for p in s.trajectory.report.problems]
        assert horizontal_rms(s.error_n) < horizontal_rms(s.raw_error_n)

    @pytest.mark.parametrize(("density", "is_said"), [(0.0, False), (1.5, True)])
    def test_samples_that_shake_more_than_a_road_makes_them_are_named(self, density: float, is_said: bool) -> None:
        simulation = simulate_preset("white", 4, duration=100.0, motion_standstill=5.0, mag=None)
        session = prepare(simulation.raw)
        assert session.imu is not None
        rate = 1.0 / float(np.median(np.diff(session.imu.t)))
        push = density * np.sqrt(rate) * np.random.default_rng(0).normal(size=session.imu.specific_force_s.shape)
        shaken = replace(session.imu, specific_force_s=session.imu.specific_force_s + push)
        found = GraphSmoother(GraphOptions()).estimate(replace(session, imu=shaken))
        assert found.report.mode == "full"
        assert ("imu_shaken" in [p.code for p in found.report.problems]) is is_said

    def test_inertial_samples_that_end_half_way_leave_the_rest_to_the_fixes(self) -> None:
        simulation = simulate_preset("white", 4, duration=100.0, motion_standstill=5.0, mag=None)
        session = prepare(simulation.raw)
        assert session.imu is not None
        s = smoothed(simulation, replace(session, imu=session.imu.between(0.0, 50.0)))
        late = s.trajectory.t > 55.0
        assert np.all(np.isfinite(s.trajectory.position_n))
        assert horizontal_rms(s.error_n[late]) < horizontal_rms(s.raw_error_n)


def test_a_lever_arm_longer_than_a_kart_is_accepted_only_where_it_is_stated() -> None:
    arm_b = np.array([3.5, 0.0, 0.0])
    session = prepare(simulate_preset("kart", 2, duration=100.0, gnss_outages=(), lever_arm_b=arm_b).raw)
    found = GraphSmoother().estimate(session).report
    assert found.mode == "gps-only"
    assert [p.text for p in found.problems if p.code == "arm_too_long"] != []
    mounting = replace(session.config.mounting, lever_arm_b=arm_b)
    stated = GraphSmoother().estimate(replace(session, config=replace(session.config, mounting=mounting))).report
    assert stated.mode == "full"


SHAKEN = {"imu_rate": 100.0, "imu_anti_alias_hz": None, "imu_gyro_tone": 60.0 * DEG, "imu_accel_tone": 6.0}
WHEEL = {"motion_steering": 5.0 * DEG, "motion_steering_per_curvature": 3.0}


def test_speeds_that_the_logger_averages_are_asked_about_and_without_them_the_sensor_is_used() -> None:
    """Over a second, beside courses that are not: no delay of both explains it, and a long arm nearly does."""
    session = prepare(simulate_preset("kart", 2, duration=100.0, gnss_outages=()).raw)
    fixes = session.gnss
    speed = np.hypot(fixes.velocity_n[:, 0], fixes.velocity_n[:, 1])
    averaged = np.convolve(np.append(np.full(4, speed[0]), speed), np.full(5, 0.2), "valid")
    velocity_n = fixes.velocity_n * (averaged / np.maximum(speed, 1e-6))[:, None]
    velocity_n[:, 2] = np.nan
    found = GraphSmoother().estimate(replace(session, gnss=replace(fixes, velocity_n=velocity_n))).report
    (said,) = [p.text for p in found.problems if p.code == "arm_too_long"]
    assert "leave speed and course out of the file" in said
    without = replace(fixes, velocity_n=np.full_like(velocity_n, np.nan))
    assert GraphSmoother().estimate(replace(session, gnss=without)).report.mode == "full"


def test_a_logger_on_the_steering_wheel_is_reported_and_widens_roll_and_yaw() -> None:
    changes = {"motion_standstill": None, "motion_steering": 10.0 * DEG}
    simulation = simulate_preset("kart", 1, duration=100.0, **changes)
    found = GraphSmoother().estimate(prepare(simulation.raw))
    assert [problem.code for problem in found.report.problems] == [BOX_ON_WHEEL]
    assert found.sigmas is not None
    driving, true = found.speed > 5.0, simulation.truth.at(found.t).R_nb
    for i, wheel_turns_it in enumerate((True, False, True)):
        error = wrap_angle(euler_from_rotation(found.R_nb)[i] - euler_from_rotation(true)[i])[driving]
        sigma = found.sigmas.attitude[driving, i]
        assert (np.median(sigma) > 5.0 * DEG) == wheel_turns_it
        # 100 s of a hand on the wheel, which has another place each 0.15 s: 2 % at one sigma, 1 % at two
        assert np.mean(np.abs(error) < sigma) == pytest.approx(0.68, abs=0.06 if wheel_turns_it else 0.25)
        assert np.mean(np.abs(error) < 2.0 * sigma) == pytest.approx(0.955, abs=0.03 if wheel_turns_it else 0.05)


@pytest.mark.parametrize("name", ["sigma_horizontal", "sigma_up", "sigma_velocity"])
def test_fixes_that_report_a_sigma_of_nothing_count_as_those_that_report_none(name: str) -> None:
    session = prepare(simulate_preset("kart", 3, duration=40.0).raw)
    nothing, unknown = (
        GraphSmoother().estimate(
            replace(session, gnss=replace(session.gnss, **{name: np.full(len(session.gnss), value)}))
        )
        for value in (0.0, np.nan)
    )
    np.testing.assert_array_equal(nothing.position_n, unknown.position_n)


def test_fixes_that_scatter_without_doppler_may_wander_unseen() -> None:
    """Nothing shows it: a few decimetres of sigma were said of places that were metres off."""
    ratio = []
    for seed in (11, 12, 13):
        changes = {"gnss_white_horizontal": 1.5, "gnss_offset_horizontal": 2.0, "gnss_velocity": False}
        found = smoothed(simulate_preset("kart", seed, duration=150.0, gnss_outages=(), **changes))
        assert found.trajectory.sigmas is not None
        ratio.append(found.error_n[:, :2] / found.trajectory.sigmas.position_n[:, :2])
    assert np.sqrt(np.mean(np.concatenate(ratio) ** 2)) < 1.3
