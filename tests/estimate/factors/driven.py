"""A small session with every kind of measurement, along a smooth drive: what the factors are tested on."""

import numpy as np
from scipy.integrate import cumulative_simpson

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.factors.graph import Inputs, Measurements, Priors
from smoother.estimate.factors.motion_prior import Unsampled
from smoother.estimate.model.heading import Heading
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.noise import InertialNoise, Noise
from smoother.estimate.model.state import CONSTANTS, Geometry, State
from smoother.samples import WheelSpeed

T, K, FINE = 0.2, 60, 20
MOUNTING = so3.exp(np.array([0.2, -0.3, 0.5]))  # R_bs


def driven_state(rng: np.random.Generator, *, is_steered: bool = False) -> State:
    """A kart in a slow bend of changing radius, whose box lies askew; all constants differ from zero."""
    fine = T / FINE * np.arange(FINE * (K - 1) + 1)
    yaw = 0.4 * fine + 0.3 * np.sin(0.25 * fine)
    speed = 12.0 + 2.0 * np.sin(0.3 * fine)
    velocity_n = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), 0.3 * np.sin(0.2 * fine)])
    position_n = np.add(cumulative_simpson(velocity_n, x=fine, axis=0, initial=0.0), [10.0, -20.0, 1.0])
    t, yaw, velocity_n, position_n = (values[::FINE] for values in (fine, yaw, velocity_n, position_n))
    R_nb = so3.exp(yaw[:, None] * [0.0, 0.0, 1.0]) @ so3.exp(np.array([0.02, -0.03, 0.0]))
    constants = {c.name: 0.1 * rng.standard_normal(c.size) for c in CONSTANTS}
    constants |= {"position_latency": np.array([0.07]), "velocity_latency": np.array([0.15])}
    constants |= {"slip": np.array([0.02, 0.002, 0.0004, 0.3]), "velocity_response": np.array([0.004])}
    constants |= {"wheel_slip": np.array([0.004, 1e-4])}
    return State(
        t,
        R_nb @ MOUNTING,
        position_n,
        velocity_n,
        0.1 * rng.standard_normal((K, 3)),
        0.01 * rng.standard_normal((K, 3)),
        np.cumsum(0.1 * rng.standard_normal((K, 3)), axis=0),
        constants,
        Geometry(MOUNTING, is_steered),
    )


def inputs(rng: np.random.Generator, *, is_steered: bool = False) -> Inputs:
    """All that the factors of the table read, at a state near to what was measured."""
    state = driven_state(rng, is_steered=is_steered)
    t = rng.uniform(state.t[12], state.t[-12], 40)  # the filter of the motion has ends
    at = np.arange(5, 50, 9)
    heading = Heading(at, rng.standard_normal((len(at), 3)), 0.3, 0.05, 0.5)
    velocity_n = _at(state.t, state.velocity_n, t) + 0.1 * rng.standard_normal((len(t), 3))
    measured = Measurements(
        t,
        _at(state.t, state.position_n, t) + 0.2 * rng.standard_normal((len(t), 3)),
        np.where(np.arange(len(t))[:, None] % 4 == 0, np.nan, velocity_n),
        rng.uniform(1.0, 2.0, len(t)),
        rng.uniform(1.0, 2.0, len(t)),
        np.array([2, 3, 40]),
        speed=np.hypot(velocity_n[:, 0], velocity_n[:, 1]),  # alone at one fix in four
        heading=heading,
        rolls=np.ones(K, dtype=np.bool_),
        wheel_speed=WheelSpeed(
            np.sort(t), 1.03 * np.interp(np.sort(t), state.t, np.linalg.norm(state.velocity_n, axis=1))
        ),
        ground=(np.array([7, 30]), np.array([0.5, 1.0])),
        unsampled=Unsampled.of(np.isin(np.arange(K - 1), [20, 21, 35]).astype(np.float64), state, t, follows=True),
    )
    noise = Noise(
        InertialNoise(0.2, 0.01, 0.003, 1e-4),
        np.array([0.2, 0.2, 0.4]),
        np.array([0.15, 0.15, 0.3]),
        np.array([2.0, 2.0, 3.0]),
        60.0,
        slip=0.01,
    )
    return Inputs(measured, noise, priors(), state, LowPassedMotion(state, 1e-3, 1e-4))


def priors() -> Priors:
    """Wide ones."""
    constants = {c.name: (np.zeros(c.size), np.ones(c.size)) for c in CONSTANTS}
    return Priors(0.5, 0.03, np.zeros(3), constants, MOUNTING[2])


def _at(t: Array, values: Array, when: Array) -> Array:
    return np.stack([np.interp(when, t, values[:, i]) for i in range(values.shape[1])], axis=1)
