"""What the smoother finds out about box, receiver and noise, on simulated sessions whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.config import GnssTiming, ImuNoise, Mounting, SessionConfig
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.motion import Stop
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.units import DEG

from .smoothed import kart, smoothed, white


class TestIdentified:
    def test_latencies_mounting_and_level_lever_arm_are_found(self) -> None:
        s = kart()
        found, scenario = s.trajectory.report.identified, s.simulation.scenario
        for name, true in (
            ("gps_position_latency", scenario.gnss.position_latency),
            ("gps_velocity_latency", scenario.gnss.velocity_latency),
        ):
            assert found[name].observable
            assert found[name].value == pytest.approx(true, abs=0.02)
        np.testing.assert_allclose(found["lever_arm_b"].value[:2], scenario.lever_arm_b[:2], atol=0.15)
        turn = so3.log(np.array(found["R_bs"].value) @ scenario.R_bs.T)
        assert np.linalg.norm(turn) < 2.0 * DEG

    @pytest.mark.parametrize("askew", [0.0, 0.02])
    def test_the_sigma_of_the_mounting_contains_misaligned_axes(self, askew: float) -> None:
        # by how much all axes of a sensor are turned in its case no drive can show; that they are out of square, it can
        signs, normalised = np.random.default_rng(0), []
        for seed in (3, 4, 5):
            crooked = [np.eye(3) + askew * signs.choice([-1.0, 1.0], (3, 3)) for _ in range(2)]
            simulation = simulate_preset(
                "kart", seed, duration=120.0, imu_accel_matrix=crooked[0], imu_gyro_matrix=crooked[1]
            )
            mounting = GraphSmoother().estimate(prepare(simulation.raw)).report.identified["R_bs"]
            sigma, turn = np.array(mounting.sigma), np.array(mounting.value) @ simulation.scenario.R_bs.T
            assert np.all((sigma > 0.9 * DEG) if askew else (sigma < 0.65 * DEG))
            normalised.append(so3.log(turn) / sigma)
        assert 0.4 < np.sqrt(np.mean(np.square(normalised))) < 1.5  # nine angles

    def test_what_was_stated_is_kept_and_called_configured(self) -> None:
        simulation = simulate_preset("kart", 3, duration=60.0)
        scenario = simulation.scenario
        config = SessionConfig(
            mounting=Mounting(scenario.lever_arm_b, scenario.R_bs),
            imu=ImuNoise(accel_noise=0.3, gyro_noise=0.02),
            gps=GnssTiming(scenario.gnss.position_latency, scenario.gnss.velocity_latency),
        )
        s = smoothed(simulation, replace(prepare(simulation.raw), config=config))
        found = s.trajectory.report.identified
        for name in (
            "gps_position_latency",
            "gps_velocity_latency",
            "lever_arm_b",
            "R_bs",
            "accel_noise",
            "gyro_noise",
        ):
            assert found[name].source == "configured", name
        assert found["gps_position_latency"].value == pytest.approx(scenario.gnss.position_latency, abs=1e-4)
        assert found["gps_velocity_latency"].value == pytest.approx(scenario.gnss.velocity_latency, abs=1e-4)
        np.testing.assert_allclose(found["lever_arm_b"].value, scenario.lever_arm_b, atol=1e-3)
        np.testing.assert_allclose(found["R_bs"].value, scenario.R_bs, atol=1e-9)
        assert (found["accel_noise"].value, found["gyro_noise"].value) == (0.3, 0.02)

    def test_noise_is_that_of_the_simulation(self) -> None:
        found = white(0, True).trajectory.report.identified
        assert found["accel_noise"].value == pytest.approx(0.05, rel=0.3)
        assert found["gyro_noise"].value == pytest.approx(0.2 * DEG, rel=0.3)
        np.testing.assert_allclose(found["gps_position_noise"].value[:2], 2.5, rtol=0.1)
        np.testing.assert_allclose(found["gps_velocity_noise"].value[:2], 0.15, rtol=0.1)


def test_every_value_has_a_sigma_and_is_within_it() -> None:
    """Noise, wander, slip and iron, as delays and arm: what was found, less the truth, over its own sigma."""
    normalised, white = [], []
    for preset, seed in (("kart", 31), ("kart", 32), ("kart", 33), ("kart_harsh", 34)):
        simulation = simulate_preset(preset, seed, duration=150.0)
        scenario, gnss = simulation.scenario, simulation.scenario.gnss
        found = GraphSmoother().estimate(prepare(simulation.raw)).report.identified
        for name, value in found.items():
            assert value.sigma is not None, name
            assert np.all(np.isfinite(value.sigma)) and np.all(np.asarray(value.sigma) > 0.0), name
        assert scenario.mag is not None
        motion, iron = scenario.motion, scenario.mag.soft_iron
        for name, level, true in (
            ("gps_position_noise", slice(None), [gnss.white_horizontal, gnss.white_horizontal, gnss.white_up]),
            ("gps_velocity_noise", slice(0, 2), gnss.velocity_sigma),
            ("gps_offset_sigma", slice(None), [gnss.offset_horizontal, gnss.offset_horizontal, gnss.offset_up]),
            ("gps_offset_tau", slice(None), gnss.offset_tau),
            ("slip_sigma", slice(None), 10.0 * motion.slip_per_acceleration * motion.slip_sigma),
            ("mag_hard_iron", slice(None), scenario.mag.hard_iron_s),
            ("mag_soft_iron", slice(None), np.linalg.inv(iron) * np.linalg.det(iron) ** (1.0 / 3.0)),
            ("mag_heading_offset", slice(None), 0.0),
        ):
            value, sigma = (np.atleast_1d(figure)[level] for figure in (found[name].value, found[name].sigma))
            normalised.append(np.ravel((value - np.asarray(true)) / sigma))
            assert np.max(np.abs(normalised[-1])) < 2.6, (preset, seed, name)
        white.append(np.ravel(found["gps_position_noise"].value)[0] / gnss.white_horizontal)
    assert 0.3 < np.sqrt(np.mean(np.concatenate(normalised) ** 2)) < 1.2
    for seed in (35, 36, 37, 38, 39, 40):  # of one it is known to a twentieth
        simulation = simulate_preset("kart", seed, duration=150.0)
        found = GraphSmoother().estimate(prepare(simulation.raw)).report.identified["gps_position_noise"]
        white.append(np.ravel(found.value)[0] / simulation.scenario.gnss.white_horizontal)
    # a twentieth of the noise would be the way that the wander goes between keyframes
    assert np.mean(white[:3] + white[4:]) == pytest.approx(1.0, abs=0.035)


def test_what_a_parked_kart_shows_is_no_iron_and_no_slip() -> None:
    """Of noise alone a fit makes iron, four sigmas off."""
    for seed in (8, 9):
        found = GraphSmoother().estimate(
            prepare(simulate_preset("kart", seed, duration=60.0, motion_standstill=60.0).raw)
        )
        assert not {"mag_hard_iron", "mag_soft_iron"} & set(found.report.identified)
    crawl = GraphSmoother().estimate(prepare(simulate_preset("kart", 32, duration=60.0, motion_top_speed=4.0).raw))
    slip = crawl.report.identified.get("slip_sigma")
    assert slip is None or (slip.source, slip.observable) == ("default", False)


def low_passed(values: np.ndarray, dt: float, tau: float) -> np.ndarray:
    """Values (N, c), dt s apart, behind a low-pass of first order that begins settled."""
    share, out = 1.0 - np.exp(-dt / tau), values.copy()
    for i in range(1, len(values)):
        out[i] = out[i - 1] + share * (values[i] - out[i - 1])
    return out


def behind_low_pass(simulation: Simulation, session: Session, tau: float) -> Session:
    """The session with its Doppler behind a low-pass of first order, whose time constant is a part of its delay."""
    timing, truth, dt = simulation.gnss.velocity_time, simulation.truth, 0.005
    assert len(session.gnss.t) == len(timing)
    t = np.arange(truth.first, timing[-1], dt)
    true_n = truth.antenna_velocity_n(t, simulation.scenario.lever_arm_b)
    late_n = low_passed(true_n, dt, tau) - true_n
    late_n[:, 2] = 0.0
    added = np.column_stack([np.interp(timing, t, late_n[:, i]) for i in range(3)])
    return replace(session, gnss=replace(session.gnss, velocity_n=session.gnss.velocity_n + added))


def test_a_receiver_that_responds_slowly_is_found_and_its_delay_is_not_drawn_away() -> None:
    tau = 0.15
    simulation = simulate_preset("kart", 6, duration=150.0, gnss_velocity_sigma=0.03, imu_accel_noise=0.05)
    slow = behind_low_pass(simulation, prepare(simulation.raw), tau)
    found = smoothed(simulation, slow).trajectory.report.identified
    value, delay = found["gps_velocity_response"], found["gps_velocity_latency"]
    assert value.observable
    assert value.value == pytest.approx(0.5 * tau**2, rel=0.3)
    # 6 ms short where samples are as good as these; of karts' own samples 1.3 sigmas
    assert delay.value == pytest.approx(simulation.scenario.gnss.velocity_latency + tau, abs=8e-3)


def test_a_receiver_far_slower_than_others_is_no_worse() -> None:
    """Its response is 35 sigmas of what receivers have; held near that, speed would be 1 m/s off."""
    tau = 0.6
    simulation = simulate_preset("kart", 6, duration=150.0)
    session = prepare(simulation.raw)
    plain, slow = smoothed(simulation, session), smoothed(simulation, behind_low_pass(simulation, session, tau))
    value = slow.trajectory.report.identified["gps_velocity_response"]
    assert value.observable
    assert value.value == pytest.approx(0.5 * tau**2, rel=0.15)
    late = slow.trajectory.report.identified["gps_position_latency"]
    assert abs(late.value - simulation.scenario.gnss.position_latency) < 3.0 * late.sigma
    driven = plain.trajectory.t > 20.0
    rms = [float(np.sqrt(np.mean(s.velocity_error_n[driven, :2] ** 2))) for s in (slow, plain)]
    assert rms[0] < 1.7 * rms[1]  # a low-pass takes information too; it was ten times


def test_a_bounce_on_the_tyres_draws_no_delay() -> None:
    """Eleven times a second, and the receiver says how fast it goes up: half a wave is 45 ms."""
    simulation = simulate_preset("kart", 1, duration=120.0, gnss_has_vertical_velocity=True, gnss_outages=())
    session, pace, speed = prepare(simulation.raw), 2.0 * np.pi * 11.0, 0.27
    imu, fixes, receiver = session.imu, session.gnss, simulation.scenario.gnss
    assert imu is not None
    bounce = speed * pace * np.cos(pace * imu.t)[:, None] * simulation.scenario.R_bs[2]
    velocity_n = fixes.velocity_n.copy()
    velocity_n[:, 2] += speed * np.sin(pace * (fixes.t - receiver.velocity_latency))
    shaken = replace(
        session,
        imu=replace(imu, specific_force_s=imu.specific_force_s + bounce),
        gnss=replace(fixes, velocity_n=velocity_n),
    )
    identified = GraphSmoother().estimate(shaken).report.identified
    assert identified["gps_position_latency"].value == pytest.approx(receiver.position_latency, abs=0.015)
    assert identified["gps_velocity_latency"].value == pytest.approx(receiver.velocity_latency, abs=0.012)


def test_a_receiver_that_holds_its_place_at_rest_is_no_better_than_it_drives() -> None:
    """Many do: waits of a session, repeated to the last digit, said that fixes are good to centimetres."""
    stops = tuple(Stop(40.0 * k, 20.0) for k in range(1, 5))
    simulation = simulate_preset("kart", 4, duration=200.0, motion_stops=stops, gnss_outages=())
    session = prepare(simulation.raw)
    rests = np.hypot(*simulation.truth.at(session.gnss.t - 0.2).velocity_n[:, :2].T) < 0.05
    begins = rests & ~np.append(False, rests[:-1])
    last = np.maximum.accumulate(np.where(begins | ~rests, np.arange(len(rests)), 0))
    gnss, sent = session.gnss, np.where(rests[:, None], 0.0, session.gnss.velocity_n)
    holds = replace(
        gnss, lat_deg=gnss.lat_deg[last], lon_deg=gnss.lon_deg[last], alt_m=gnss.alt_m[last], velocity_n=sent
    )
    plain, held = (smoothed(simulation, s) for s in (session, replace(session, gnss=holds)))
    for name in ("gps_position_noise", "gps_velocity_noise"):
        one, other = (s.trajectory.report.identified[name].value for s in (plain, held))
        assert other[0] == pytest.approx(one[0], rel=0.2)
    drives = plain.trajectory.speed > 2.0
    one, other = (np.sqrt(np.mean(s.velocity_error_n[drives, :2] ** 2)) for s in (plain, held))
    assert other < 1.1 * one


def test_fixes_far_apart_tell_their_noise_from_a_wandering_offset() -> None:
    changes = {"gnss_rate": 0.5, "gnss_white_horizontal": 1.5, "gnss_white_up": 2.5}
    found = smoothed(simulate_preset("kart", 4, duration=300.0, **changes))
    noise = np.asarray(found.trajectory.report.identified["gps_position_noise"].value)
    assert noise[0] == pytest.approx(1.5, rel=0.25)


def test_rare_fixes_are_not_reported_without_an_offset() -> None:
    changes = {"gnss_rate": 1.0, "gnss_white_horizontal": 3.0, "gnss_white_up": 5.0}
    found = [smoothed(simulate_preset("kart", seed, duration=300.0, **changes)) for seed in (4, 5)]
    ratio = []
    for each in found:
        assert each.trajectory.sigmas is not None
        ratio.append(each.error_n[:, :2] / each.trajectory.sigmas.position_n[:, :2])
    assert np.sqrt(np.mean(np.concatenate(ratio) ** 2)) < 1.5


def test_noise_of_a_kart_that_never_drives_is_that_of_all_its_rows() -> None:
    """Where nothing was asked the slow error of the fixes took all of theirs, step by step, without an end."""
    found = GraphSmoother().estimate(prepare(simulate_preset("white", 11, duration=30.0).raw)).report.identified
    # half a minute can not show that there is none; it is no more than that of all receivers
    np.testing.assert_array_less(found["gps_offset_sigma"].value, np.array([2.0, 2.0, 3.4]) + 1e-9)
    np.testing.assert_allclose(np.asarray(found["gps_position_noise"].value)[:2], 2.5, rtol=0.2)
