"""Holes of the inertial samples while the kart drives: how far off the attitude is, and whether its sigma says so."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from smoother.arrays import Array, BoolArray
from smoother.estimate.smoother import GraphSmoother
from smoother.frames import wrap_angle
from smoother.prepare import prepare
from smoother.samples import RawSession, Session
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

HONEST = 1.4  # rms of errors over sigmas; of some holes of some seconds each, with 2-3 independent values in each


@dataclass(frozen=True, eq=False)
class Holed:
    """Roll, pitch, yaw errors (N, 3) rad and their sigmas at the rows inside the holes of a session."""

    error: Array
    sigma: Array

    @property
    def z(self) -> Array:
        """Rms of errors over sigmas, (3,)."""
        return np.asarray(np.sqrt(np.mean((self.error / self.sigma) ** 2, axis=0)))

    @property
    def rms(self) -> Array:
        """Rms errors, (3,) rad."""
        return np.asarray(np.sqrt(np.mean(self.error**2, axis=0)))


def without(session: Session, holes: list[tuple[float, float]]) -> Session:
    """The session without the inertial samples between begin and end s of each hole."""
    imu = session.imu
    assert imu is not None
    keep = ~_inside(imu.t, holes)
    t, force, rate = imu.t[keep], imu.specific_force_s[keep], imu.angular_rate_s[keep]
    return replace(session, imu=replace(imu, t=t, specific_force_s=force, angular_rate_s=rate))


def _inside(t: Array, holes: list[tuple[float, float]]) -> BoolArray:
    return np.any([(t > begin) & (t < end) for begin, end in holes], axis=0)


def smoothed(preset: str, seed: int, length: float, **changes: object) -> Holed:
    """What the smoother makes of 120 s with three holes."""
    simulation = simulate_preset(
        preset,
        seed,
        duration=120.0,
        motion_standstill=None,
        gnss_outages=(),
        **changes,  # type: ignore[arg-type]
    )
    holes = [(begin, begin + length) for begin in (30.0, 60.0, 90.0)]
    session = without(prepare(simulation.raw), holes)
    found = GraphSmoother().estimate(session)
    assert found.report.mode == "full"
    assert found.sigmas is not None
    inside = _inside(found.t, holes)
    truth = simulation.truth.trajectory(found.t[inside], simulation.scenario.lever_arm_b, session.origin)
    return Holed(wrap_angle(found.euler[inside] - truth.euler), found.sigmas.attitude[inside])


@pytest.mark.parametrize(("length", "yaw"), [(3.0, 4.0), (20.0, 5.0)])
def test_attitudes_in_holes_are_within_their_sigmas(length: float, yaw: float) -> None:
    found = [smoothed("kart", seed, length) for seed in (0, 1)]
    both = Holed(np.concatenate([f.error for f in found]), np.concatenate([f.sigma for f in found]))
    assert np.all(both.z < HONEST)
    assert np.all(both.rms < np.array([2.5, 2.5, yaw]) * DEG)


@pytest.mark.parametrize("rate", [1.0, 25.0])
def test_that_does_not_depend_on_how_often_the_receiver_speaks(rate: float) -> None:
    found = smoothed("kart", 2, 10.0, gnss_rate=rate)
    assert np.all(found.z < HONEST)
    assert np.all(found.rms < np.array([5.0, 5.0, 8.0]) * DEG)


def test_a_good_compass_does_not_turn_a_kart_of_unknown_lean() -> None:
    found = smoothed("white", 0, 10.0)
    assert np.all(found.rms < np.array([3.0, 3.0, 5.0]) * DEG)
    assert np.all(found.z < HONEST)


def _more_slowly(raw: RawSession, times: int) -> RawSession:
    """The session with means of `times` samples in place of these in its second half."""
    imu = raw.imu
    assert imu is not None
    half = len(imu.t) // 2
    end = half + (len(imu.t) - half) // times * times

    def means(values: Array) -> Array:
        return np.concatenate([values[:half], values[half:end].reshape(-1, times, 3).mean(axis=1)])

    t = np.append(imu.t[:half], imu.t[half + times - 1 : end : times])
    return replace(raw, imu=replace(imu, t=t, accel=means(imu.accel), gyro=means(imu.gyro)))


@pytest.mark.parametrize(("times", "largest"), [(1, 0.3), (5, 0.3), (16, 4.0)])
def test_attitudes_are_honest_where_samples_come_more_slowly_from_a_moment_on(times: int, largest: float) -> None:
    """40 Hz tell all that 200 do. 12.5 Hz are holes: attitudes in them have nothing in common with the others."""
    simulation = simulate_preset("white", 31, duration=120.0)
    session = prepare(_more_slowly(simulation.raw, times))
    trajectory = GraphSmoother().estimate(session)
    truth = simulation.truth.trajectory(trajectory.t, simulation.scenario.lever_arm_b, session.origin)
    driving = (trajectory.speed > 5.0) & (trajectory.t > trajectory.t[0] + 10.0)
    assert trajectory.sigmas is not None
    sigma = trajectory.sigmas.attitude[driving]
    z = wrap_angle(trajectory.euler - truth.euler)[driving] / sigma
    assert np.all(np.sqrt(np.mean(z[:, :2] ** 2, axis=0)) < HONEST)
    assert np.median(sigma[:, 0]) < largest * DEG
