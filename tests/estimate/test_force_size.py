"""The delay of the fixes by the size of the force, whatever way the box turns."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.fixes.pieces import fit_path
from smoother.estimate.force_size import MODEL, size_delay
from smoother.estimate.initial.align import align
from smoother.estimate.path_motion import PathMotion
from smoother.prepare import prepare
from smoother.samples import ImuSamples, Session
from smoother.sim.motion import wander
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.units import DEG

SHAKEN = {"imu_anti_alias_hz": None, "imu_gyro_tone": 100.0 * DEG, "imu_accel_tone": 6.0}
ON_WHEEL = {"motion_steering": 4.0 * DEG, "motion_steering_per_curvature": 3.0}


def read(preset: str, seed: int, **changes: object) -> tuple[Simulation, ImuSamples, PathMotion]:
    simulation = simulate_preset(preset, seed, duration=150.0, gnss_outages=(), lever_arm_b=np.zeros(3), **changes)
    session = prepare(simulation.raw)
    assert session.imu is not None
    return simulation, session.imu, driven(session)


def driven(session: Session) -> PathMotion:
    return PathMotion(session.gnss.t, fit_path(session).at(session.gnss.t).velocity_n)


@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
@pytest.mark.parametrize(
    "changes", [{}, ON_WHEEL, {**ON_WHEEL, **SHAKEN, "imu_rate": 25.0}, {**SHAKEN, "imu_rate": 100.0}]
)
def test_the_size_tells_the_delay_as_well_as_it_says(preset: str, changes: dict[str, object]) -> None:
    off, sigmas = [], []
    for seed in range(4):
        simulation, imu, path = read(preset, seed, **changes)
        found = size_delay(imu, path)
        assert found.is_seen
        off.append(found.delay - simulation.scenario.gnss.position_latency)
        sigmas.append(found.sigma)
    assert np.sqrt(np.mean(np.square(off))) < 0.025
    assert np.sqrt(np.mean(np.square(np.divide(off, sigmas)))) < 1.5


def test_a_wheel_that_turns_before_the_kart_does_not_matter() -> None:
    simulation, imu, path = read("kart", 3, **ON_WHEEL)
    late = align(imu, path).lag - simulation.scenario.gnss.position_latency
    assert late > 0.08
    assert abs(size_delay(imu, path).delay - simulation.scenario.gnss.position_latency) < 0.25 * late


def test_a_box_may_swing_in_any_way() -> None:
    _, imu, path = read("kart", 2)
    angles = [wander(float(imu.t[0]), float(imu.t[-1]), 0.8, np.random.default_rng(k), 0.5)(imu.t) for k in range(3)]
    turned = np.einsum("kij,kj->ki", so3.exp(np.column_stack(angles)), imu.specific_force_s)
    swinging = size_delay(replace(imu, specific_force_s=turned), path)
    assert swinging.is_seen
    assert swinging.delay == pytest.approx(size_delay(imu, path).delay, abs=0.012)


def test_vibration_that_is_the_same_in_each_lap_does_not_average_out() -> None:
    """Three times the same drive has three times the laps, and no more to say."""
    _, imu, path = read("kart_harsh", 1, **SHAKEN, imu_rate=25.0)
    last = float(imu.t[-1]) + 0.04
    path = PathMotion(path.t[path.t < last - 1.0], path.velocity_n[path.t < last - 1.0])
    again = [last * k for k in range(3)]
    rates, forces = (np.tile(values, (3, 1)) for values in (imu.angular_rate_s, imu.specific_force_s))
    imu_thrice = replace(
        imu, t=np.concatenate([imu.t + k for k in again]), specific_force_s=forces, angular_rate_s=rates
    )
    path_thrice = PathMotion(np.concatenate([path.t + k for k in again]), np.tile(path.velocity_n, (3, 1)))
    once, thrice = (
        np.sqrt(found.sigma**2 - MODEL**2) for found in (size_delay(imu, path), size_delay(imu_thrice, path_thrice))
    )
    assert thrice > 0.85 * once


def noise(imu: ImuSamples) -> Array:
    return np.asarray(np.random.default_rng(5).normal(size=imu.specific_force_s.shape) * 5.0)


def test_what_has_nothing_to_do_with_the_path_is_not_seen() -> None:
    _, imu, path = read("kart", 2)
    assert not size_delay(replace(imu, specific_force_s=noise(imu) + np.array([0.0, 0.0, 9.8])), path).is_seen
    parked = replace(path, velocity_n=0.01 * path.velocity_n)
    assert not size_delay(imu, parked).is_seen
