import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother import so3
from smoother.config import MagnetometerUse, Mounting, SessionConfig
from smoother.estimate.baseline.baseline import BaselineOptions, GpsAlone, ThesisBaseline
from smoother.estimate.judge.evaluate import evaluate
from smoother.frames import euler_from_rotation, rotation_from_euler
from smoother.prepare import prepare
from smoother.sim.motion import Motion
from smoother.sim.scenario import GnssErrors, ImuErrors, MagErrors, Scenario
from smoother.sim.simulation import simulate, simulate_preset
from smoother.units import DEG

SEED = 40
# What the thesis' gains spoil in corners is known (tests below); the rest of the pipeline shows with gentle ones.
GENTLE = BaselineOptions(beta=0.01, zeta=0.0)


def truth_of(simulation, session):
    t = np.arange(session.gnss.t[0], session.gnss.t[-1], 0.02)
    return simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, session.origin)


def simulated(preset="white", seed=SEED, duration=100.0, **changes):
    simulation = simulate_preset(preset, seed, duration=duration, **changes)
    session = prepare(simulation.raw)
    return session, truth_of(simulation, session), simulation


@pytest.fixture(scope="module")
def white():
    return simulated(duration=150.0)


@pytest.fixture(scope="module")
def estimate(white):
    return ThesisBaseline().estimate(white[0])


def codes(trajectory):
    return [problem.code for problem in trajectory.report.problems]


def ideal(**changes):
    """A drive seen by perfect sensors in a box mounted anyhow."""
    values = {
        "duration": 60.0,
        "motion": Motion(standstill=10.0),
        "imu": ImuErrors(),
        "gnss": GnssErrors(white_horizontal=0.01, velocity_sigma=0.01),
        "mag": MagErrors(calibration_points=200),
        **changes,
    }
    simulation = simulate(Scenario(**values), np.random.default_rng(1))
    session = prepare(simulation.raw)
    return session, truth_of(simulation, session)


def test_rows_run_from_the_first_to_the_last_fix_without_a_hole(white, estimate):
    session, _, _ = white
    assert estimate.t[0] == session.gnss.t[0]
    assert 0.0 <= session.gnss.t[-1] - estimate.t[-1] < 0.02
    np.testing.assert_allclose(np.diff(estimate.t), 0.02, atol=1e-9)
    assert np.all(np.isfinite(estimate.position_n[:, :2]))
    assert np.all(np.isfinite(estimate.velocity_n[:, :2]))
    assert np.all(np.isfinite(estimate.R_nb))
    assert np.all(np.isfinite(estimate.acceleration_b))
    assert np.all(np.isfinite(estimate.angular_rate_b))


def test_what_it_does_not_estimate_is_nan(estimate):
    assert np.all(np.isnan(estimate.position_n[:, 2]))
    assert np.all(np.isnan(estimate.velocity_n[:, 2]))
    assert np.all(np.isnan(estimate.sigmas.attitude))
    assert np.all(np.isnan(estimate.sigmas.track))


def test_on_the_white_preset_it_beats_the_fixes_and_its_sigma_is_honest(white, estimate):
    session, truth, _ = white
    alone, found = evaluate(GpsAlone().estimate(session), truth), evaluate(estimate, truth)
    assert found.horizontal_rms_m < alone.horizontal_rms_m
    assert 0.5 < found.coverage_1sigma < 0.85  # 0.683; errors stay for seconds, so one session scatters
    assert estimate.report.problems == ()
    assert estimate.report.mode == "full"


def test_the_thesis_gains_lose_the_attitude_in_corners_and_gentle_ones_do_not(white, estimate):
    session, truth, _ = white
    gentle = evaluate(ThesisBaseline(GENTLE).estimate(session), truth)
    thesis = evaluate(estimate, truth)
    assert max(gentle.roll_rms_deg, gentle.pitch_rms_deg, gentle.yaw_rms_deg) < 6.0
    assert max(thesis.roll_rms_deg, thesis.pitch_rms_deg) > 10.0
    assert gentle.horizontal_rms_m < 0.85 * thesis.horizontal_rms_m


def test_with_the_noise_measured_at_rest_it_drowns_as_the_thesis_did(white):
    session, truth, _ = white
    drowned = ThesisBaseline(BaselineOptions(accel_covariance="at rest")).estimate(session)
    assert (
        evaluate(drowned, truth).horizontal_rms_m > 3.0 * evaluate(GpsAlone().estimate(session), truth).horizontal_rms_m
    )


@pytest.mark.parametrize("seed", range(3))
def test_perfect_sensors_in_any_mounting_give_the_attitude_of_the_kart(seed):
    rng = np.random.default_rng(seed)
    R_bs = so3.exp(rng.uniform(-2.0, 2.0, 3))
    session, truth = ideal(R_bs=R_bs)
    found = evaluate(ThesisBaseline(GENTLE).estimate(session), truth)
    # the kart leans and slides a few degrees, which the rest at the start and straights cannot tell from the mounting
    assert max(found.roll_rms_deg, found.pitch_rms_deg) < 5.0
    assert found.yaw_rms_deg < 5.0
    assert found.horizontal_rms_m < 0.5
    assert found.horizontal_velocity_rms_mps < 0.7


def test_yaw_is_true_and_not_magnetic():
    inclination, strength, declination = 60.0 * DEG, 50.0, 20.0 * DEG  # 20 degrees east
    field = strength * np.array(
        [
            np.cos(inclination) * np.cos(declination),
            -np.cos(inclination) * np.sin(declination),
            -np.sin(inclination),
        ]
    )
    session, truth = ideal(mag=MagErrors(calibration_points=200, field_n=field))
    aligned = Mounting(R_bs=np.eye(3))  # else the mounting takes the declination up
    stated = SessionConfig(magnetometer=MagnetometerUse(declination_deg=20.0), mounting=aligned)
    found = ThesisBaseline(GENTLE).estimate(replace(session, config=stated))
    assert evaluate(found, truth).yaw_rms_deg < 5.0
    ignored = SessionConfig(magnetometer=MagnetometerUse(declination_deg=0.0), mounting=aligned)
    assert evaluate(ThesisBaseline(GENTLE).estimate(replace(session, config=ignored)), truth).yaw_rms_deg > 18.0


def test_accelerations_and_rates_are_the_karts_with_gravity_removed():
    R_bs = rotation_from_euler(np.asarray(0.4), np.asarray(-0.3), np.asarray(2.0))
    session, truth = ideal(R_bs=R_bs)
    found = ThesisBaseline(GENTLE).estimate(session)
    rows = slice(0, min(len(found), len(truth)))
    known = truth.t[rows] > 1.0
    acceleration = (found.acceleration_b[rows] - truth.acceleration_b[rows])[known]
    rate = (found.angular_rate_b[rows] - truth.angular_rate_b[rows])[known]
    assert np.sqrt(np.mean(acceleration**2)) < 0.6  # 3 degrees of tilt are 0.5 m/s^2
    assert np.sqrt(np.mean(rate**2)) < 3.0 * DEG


def test_a_configured_mounting_is_used_as_it_is(white):
    session, _, _ = white
    R_bs = rotation_from_euler(np.asarray(0.0), np.asarray(0.0), np.asarray(1.0))
    plain = ThesisBaseline().estimate(replace(session, config=SessionConfig(mounting=Mounting(R_bs=np.eye(3)))))
    turned = ThesisBaseline().estimate(replace(session, config=SessionConfig(mounting=Mounting(R_bs=R_bs))))
    np.testing.assert_allclose(turned.R_nb @ R_bs, plain.R_nb, atol=1e-9)
    np.testing.assert_allclose(turned.position_n, plain.position_n)


# ---- sessions that offer less ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["settings", "absent", "uncalibrated"])
def test_without_a_calibrated_magnetometer_north_comes_from_motion(how):
    changes = {"absent": {"mag": None}, "uncalibrated": {"mag_calibration_points": 0}}.get(how, {})
    session, truth, _ = simulated(**changes)
    if how == "settings":
        session = replace(session, config=SessionConfig(magnetometer=MagnetometerUse(use=False)))
    found = ThesisBaseline(GENTLE).estimate(session)
    assert codes(found) == ["baseline_no_magnetometer"]
    assert evaluate(found, truth).yaw_rms_deg < 8.0
    assert evaluate(found, truth).horizontal_rms_m < 2.5


def test_without_a_standstill_the_substitute_is_reported():
    session, truth, _ = simulated(motion_standstill=None)
    found = ThesisBaseline().estimate(session)
    assert "baseline_no_standstill" in codes(found)
    assert evaluate(found, truth).horizontal_rms_m < 5.0


def test_without_doppler_it_works_as_the_thesis_did():
    session, truth, _ = simulated(gnss_velocity=False)
    found = evaluate(ThesisBaseline().estimate(session), truth)
    assert found.horizontal_rms_m < evaluate(GpsAlone().estimate(session), truth).horizontal_rms_m


def test_without_an_imu_the_fixes_alone_are_filtered():
    session, truth, _ = simulated(imu=None)
    found = ThesisBaseline().estimate(session)
    assert found.report.mode == "gps-only"
    assert codes(found) == ["baseline_no_imu"]
    assert np.all(np.isnan(found.R_nb))
    assert np.all(np.isnan(found.acceleration_b))
    assert np.all(np.isfinite(found.position_n[:, :2]))
    assert evaluate(found, truth).horizontal_rms_m < 4.0


@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
def test_harsh_sessions_give_every_row_a_finite_position(preset):
    session, _, _ = simulated(preset, SEED, 100.0)
    found = ThesisBaseline().estimate(session)
    assert np.all(np.isfinite(found.position_n[:, :2]))
    assert np.all(found.sigmas.position_n[:, :2] > 0.0)
    assert np.all(found.sigmas.speed > 0.0)


def test_a_kart_that_never_moves_stays_where_it_is():
    session, _, _ = simulated("white", SEED, 60.0, motion_driving=False)
    found = ThesisBaseline().estimate(session)
    assert np.max(np.abs(found.position_n[1000:, :2])) < 10.0  # 2.5 m fixes about an origin that is itself one
    assert "baseline_no_forward" in codes(found)
    tilt = np.stack(euler_from_rotation(found.R_nb[-1]))[:2]
    assert np.all(np.abs(tilt) < 3.0 * DEG)


def test_attitude_is_nan_where_the_imu_was_silent_for_long(white):
    session, _, _ = white
    keep = (session.imu.t < 60.0) | (session.imu.t > 64.0)
    imu = replace(
        session.imu,
        t=session.imu.t[keep],
        specific_force_s=session.imu.specific_force_s[keep],
        angular_rate_s=session.imu.angular_rate_s[keep],
    )
    found = ThesisBaseline().estimate(replace(session, imu=imu))
    silent = (found.t > 61.0) & (found.t < 63.0)
    assert np.all(np.isnan(found.R_nb[silent]))
    assert np.all(np.isfinite(found.position_n[silent, :2]))
    assert np.all(np.isfinite(found.R_nb[found.t < 60.0]))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_handful_of_fixes_is_enough_to_return_something(white, count):
    session, _, _ = white
    few = replace(session, gnss=session.gnss.select(np.arange(count) + 300))
    found = ThesisBaseline().estimate(few)
    assert len(found) == round((few.gnss.t[-1] - few.gnss.t[0]) * 50.0) + 1
    assert np.all(np.isfinite(found.position_n[:, :2]))


def test_it_needs_no_more_than_the_protocol():
    baseline = ThesisBaseline()
    assert baseline.name == "baseline"
    assert baseline.options.rate == 50.0
    assert (baseline.options.beta, baseline.options.zeta) == (0.13, 0.04)


def test_the_default_alpha_is_the_one_that_the_recorded_sweep_found():
    with (Path(__file__).parents[3] / "docs" / "tables" / "baseline_alpha.csv").open(encoding="utf-8") as file:
        sweep = [row for row in csv.DictReader(file) if row["alpha"] != "fixes alone"]
    best = float(min(sweep, key=lambda row: float(row["score"]))["alpha"])
    assert BaselineOptions().alpha == best


def test_real_recordings_end_in_a_bounded_track(data_directory):
    from smoother.session.load import load_raw

    folders = [data_directory / name for name in ("kart_adria_first_half", "car_comma2k19", "bicycle_neo6m")]
    if not all(folder.is_dir() for folder in folders):
        pytest.skip("not all recordings are there")
    for folder in folders:
        session = prepare(load_raw(folder))
        found = ThesisBaseline().estimate(session)
        fixes = session.fix_position_n[:, :2]
        at_fixes = np.stack([np.interp(session.gnss.t, found.t, found.position_n[:, i]) for i in range(2)], axis=1)
        assert np.max(np.linalg.norm(at_fixes - fixes, axis=1)) < 10.0
