"""How well a session determines its noise, from the residuals of a solved graph."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from smoother.estimate.fixes.reported_noise import hidden_wander
from smoother.estimate.model.noise import InertialNoise, Noise
from smoother.estimate.model.state import KEYFRAME_SIZE, OFFSET
from smoother.estimate.output.residuals import corners, noise_uncertainty
from smoother.estimate.solvers.variance_components import RowComponent, SampleComponent
from smoother.fit.noise_spread import ANY_NOISE, Residuals, of_force, of_positions, of_rate, of_velocities

N, INTERVAL, SHARE = 600, 0.2, 0.25
LEFT = {"force": 0.2, "rate": 0.05, "position": 0.7, "velocity": 0.8}  # shares of the noise in the residuals


def noise() -> Noise:
    third = np.full(3, 0.5)
    return Noise(InertialNoise(0.2, 0.01, 1e-3, 1e-4), third, third, np.array([2.0, 2.0, 3.0]), 60.0)


def samples(left: float) -> SampleComponent:
    each = np.full(N, 3.0 * left)
    return SampleComponent(each, each, np.eye(3), np.eye(3))


def fixes(left: float, known: int = N) -> RowComponent:
    """Level components of the first `known` fixes; nothing upwards."""
    each = np.zeros((N, 3))
    each[:known, :2] = left
    return RowComponent(each, each)


def told(velocities: int = N) -> Any:
    """Of a graph with a fix at a quarter of each interval."""
    left, right = np.zeros((N, 3, KEYFRAME_SIZE)), np.zeros((N, 3, KEYFRAME_SIZE))
    left[:, :, OFFSET], right[:, :, OFFSET] = (1.0 - SHARE) * np.eye(3), SHARE * np.eye(3)
    solution = SimpleNamespace(
        components=SimpleNamespace(
            force=samples(LEFT["force"]),
            rate=samples(LEFT["rate"]),
            position=fixes(LEFT["position"]),
            velocity=fixes(LEFT["velocity"], velocities),
        ),
        noise=noise(),
        state=SimpleNamespace(t=INTERVAL * np.arange(N + 1), interval=INTERVAL),
        step=SimpleNamespace(rows={"gps_position": SimpleNamespace(left=left, right=right, residual=np.zeros((N, 3)))}),
        graph=SimpleNamespace(measured=SimpleNamespace(rolls=None)),
    )
    return noise_uncertainty(solution, np.ones(4))  # type: ignore[arg-type]


def residuals(left: float, of_each: int) -> Residuals:
    return Residuals(np.full(N, of_each * left), np.full(N, of_each * left), float(of_each * N))


def test_each_noise_is_identified_by_its_own_residuals() -> None:
    found = told()
    assert found.accel == pytest.approx(of_force(residuals(LEFT["force"], 3), has_doppler=True))
    assert found.gyro == pytest.approx(of_rate(residuals(LEFT["rate"], 3)))
    assert found.position[:2] == pytest.approx(of_positions(residuals(LEFT["position"], 2)))
    assert found.velocity[:2] == pytest.approx(of_velocities(residuals(LEFT["velocity"], 2)))
    assert (found.position[2], found.velocity[2]) == (ANY_NOISE, ANY_NOISE)  # nothing was measured upwards


def test_few_velocities_do_not_tell_force_from_the_wander_of_positions() -> None:
    assert told(velocities=N // 3).accel > 2.0 * told().accel


def test_a_walk_is_off_its_line_as_a_bridge_is() -> None:
    """Against walks that are drawn: their variance at a quarter of the way, given both ends."""
    rng, steps, density = np.random.default_rng(1), 40, 2.0 * 2.0**2 / 60.0
    walk = np.cumsum(rng.normal(0.0, np.sqrt(density * INTERVAL / steps), (20_000, steps)), axis=1)
    at = walk[:, round(SHARE * steps) - 1] - SHARE * walk[:, -1]
    assert told().wandered[0] == pytest.approx(np.var(at), rel=0.05)


def test_what_is_hidden_is_that_of_its_noise_and_length() -> None:
    given = noise()
    expected = hidden_wander(given.position, given.velocity, INTERVAL, N * INTERVAL, given.offset_tau)
    assert told().hidden == pytest.approx(expected)


def test_a_corner_counts_once_however_long_it_lasts() -> None:
    t = np.linspace(0.0, 100.0, 1000)
    assert corners(np.where(t < 1.0, 0.0, 8.0)) == 1
    assert corners(8.0 * np.sin(2.0 * np.pi * 0.05 * t)) == 10
