"""A simulated session: an ordinary RawSession, and beside it the truth and every value an estimator must find.

simulation = simulate_preset("kart", seed=3, track="tinbarn", duration=200.0, gnss_velocity=False)
session = prepare(simulation.raw)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from smoother.arrays import Array
from smoother.config import SessionConfig
from smoother.frames import to_left
from smoother.samples import RawSession
from smoother.sim.motion import MARGIN, Motion, drive, wander
from smoother.sim.presets import draw_scenario
from smoother.sim.scenario import Scenario, with_changes
from smoother.sim.sensors import (
    SimulatedGnss,
    SimulatedImu,
    Wheel,
    earth_field_n,
    simulate_gnss,
    simulate_imu,
    simulate_mag,
    simulate_mag_calibration,
    simulate_wheel_speed,
)
from smoother.sim.track import TRACKS, Track
from smoother.sim.truth import Clock, Truth


@dataclass(frozen=True, eq=False)
class Simulation:
    """What came out of a scenario. `raw` is all that an estimator may see.

    The times of `truth` are on the session's clock, like those of `raw`. field_n (3,) uT is the Earth's magnetic
    field. `imu` and `gnss` hold the samples again with the true biases, offsets and times behind each.
    """

    raw: RawSession
    truth: Truth
    scenario: Scenario
    field_n: Array
    imu: SimulatedImu | None
    gnss: SimulatedGnss

    @property
    def track(self) -> Track:
        """The track driven."""
        return TRACKS[self.scenario.track]

    def lap_crossings(self) -> Array:
        """Session times (K,) s at which the antenna crosses the start/finish line, within the session."""
        crossings = self.truth.crossings(self.track.start_line, self.scenario.lever_arm_b)
        start, end = self.truth.clock.to_session(np.array([0.0, self.scenario.duration]))
        return np.asarray(crossings[(crossings >= start) & (crossings <= end)])


def simulate(scenario: Scenario, rng: np.random.Generator) -> Simulation:
    """Return the session of a scenario. Motion and each sensor draw from streams of their own."""
    motion_rng, imu_rng, gnss_rng, mag_rng, steering_rng, wheel_rng = rng.spawn(6)
    imu_errors, mag_errors = scenario.imu, scenario.mag
    clock = Clock() if imu_errors is None else Clock(imu_errors.clock_offset, imu_errors.clock_drift)
    truth = drive(TRACKS[scenario.track], scenario.motion, scenario.duration, motion_rng, clock)
    field_n = _field_n(scenario)
    R_bs, duration = scenario.R_bs, scenario.duration
    wheel = _wheel(scenario.motion, truth, duration, steering_rng)
    imu = None if imu_errors is None else simulate_imu(truth, imu_errors, R_bs, duration, imu_rng, wheel)
    gnss = simulate_gnss(truth, scenario.gnss, scenario.lever_arm_b, duration, scenario.start_unix, gnss_rng)
    mag, calibration = None, None
    if mag_errors is not None:
        reading_rng, calibration_rng = mag_rng.spawn(2)
        mag = simulate_mag(truth, mag_errors, field_n, R_bs, duration, reading_rng, wheel)
        calibration = simulate_mag_calibration(mag_errors, field_n, calibration_rng)
    has_wheel = scenario.wheel.rate > 0.0
    raw = RawSession(
        name=f"{scenario.name}-{scenario.track}",
        gnss=gnss.fixes,
        imu=None if imu is None else imu.raw,
        mag=mag,
        mag_calibration_field=calibration,
        config=SessionConfig(imu_delay=None if imu_errors is None else imu_errors.filter_delay),
        inputs=("simulation",),
        unix_at_zero=scenario.start_unix - clock.offset,
        wheel_speed=simulate_wheel_speed(truth, scenario.wheel, duration, wheel_rng) if has_wheel else None,
    )
    return Simulation(raw, truth, scenario, field_n, imu, gnss)


def _wheel(motion: Motion, truth: Truth, duration: float, rng: np.random.Generator) -> Wheel | None:
    """The steering wheel with the logger on it; None for a logger on the frame."""
    if motion.steering == 0.0:
        return None
    angle = wander(-MARGIN, duration + MARGIN, motion.steering_length, rng, motion.steering)
    if motion.steering_per_curvature != 0.0:
        time = np.arange(-MARGIN, duration + MARGIN, 0.05)  # s; steering is slower than 10 Hz
        bend = motion.steering_per_curvature * _curvature(truth, truth.clock.to_session(time))
        angle = make_interp_spline(time, angle(time) + bend, k=5)
    return Wheel(angle, np.array([-np.cos(motion.column), 0.0, np.sin(motion.column)]))


def _curvature(truth: Truth, t: Array) -> Array:
    """1/m (N,) of the path at session times t (N,) s, positive to the left; less below the speed of a walk."""
    states = truth.at(np.clip(t, truth.first, truth.last))
    velocity, change = states.velocity_n, states.acceleration_n
    across = to_left(velocity, change)
    return np.asarray(across / np.maximum(np.hypot(velocity[:, 0], velocity[:, 1]), 2.0) ** 3)  # m/s


def simulate_preset(
    preset: str, seed: int, *, track: str = "larkfield", duration: float = 600.0, **changes: Any
) -> Simulation:
    """Return a session of a preset; the same seed always gives the same session.

    `changes` set single figures after the preset's draw, `gnss_rate=10.0` for the field `rate` of the receiver's
    errors and so on (see :func:`smoother.sim.scenario.with_changes`); all others keep the values of that seed.
    """
    draw_rng, noise_rng = np.random.default_rng(seed).spawn(2)
    return simulate(with_changes(draw_scenario(preset, draw_rng, track, duration), changes), noise_rng)


def _field_n(scenario: Scenario) -> Array:
    if scenario.mag is not None and scenario.mag.field_n is not None:
        return scenario.mag.field_n
    return earth_field_n(TRACKS[scenario.track].origin, scenario.start_unix)
