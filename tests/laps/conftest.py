"""Trajectories made up for the lap analysis: any plan path as an estimator would return it, and a simulated track."""

from collections.abc import Callable

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps.results import FixPath
from smoother.sim.motion import Motion, drive
from smoother.sim.track import TRACKS
from smoother.sim.truth import Truth
from smoother.trajectory import EstimateReport, Sigmas, Trajectory

RATE = 50.0  # Hz
RADIUS, SPEED = 60.0, 15.0  # m, m/s, of the circle
Made = Callable[..., Trajectory]


def made(t: Array, position: Array, *, mode: str = "gps-only", track: float = 0.05) -> Trajectory:
    """The trajectory through positions (N, 2) m at even times t (N,) s, with sigmas, attitude along the path."""
    n = len(t)
    velocity = np.gradient(position, t, axis=0, edge_order=2)
    acceleration = np.gradient(velocity, t, axis=0)
    yaw = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    c, s, o, l = np.cos(yaw), np.sin(yaw), np.zeros(n), np.ones(n)
    R_nb = np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, l], -1)], axis=1)
    acceleration_n = np.concatenate([acceleration, np.zeros((n, 1))], axis=1)
    rate = np.stack([o, o, np.gradient(yaw, t)], axis=1)
    level = np.zeros((n, 1))
    sigmas = Sigmas(
        np.full((n, 3), 2.0), np.full((n, 3), 0.1), np.full(n, 0.1), np.full((n, 3), 0.01), np.full(n, track)
    )
    return Trajectory(
        t,
        np.concatenate([position, level], axis=1),
        np.concatenate([velocity, level], axis=1),
        R_nb,
        np.einsum("nji,nj->ni", R_nb, acceleration_n),
        rate,
        sigmas,
        EstimateReport(mode=mode),
    )


def along(corners: Array, speed: float, laps: float, rate: float = RATE) -> tuple[Array, Array]:
    """Times (N,) and positions (N, 2) of a drive at constant speed round a closed smooth curve through `corners`."""
    from scipy.interpolate import CubicSpline

    ends = np.concatenate([corners, corners[:1]])
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
    curve = CubicSpline(chord, ends, bc_type="periodic")
    fine = np.linspace(0.0, chord[-1], 20_000)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve(fine), axis=0), axis=1))])
    t = np.arange(0.0, laps * arc[-1] / speed, 1.0 / rate)
    return t, curve(np.interp(np.mod(speed * t, arc[-1]), arc, fine))


@pytest.fixture(scope="session")
def make() -> Made:
    return made


@pytest.fixture(scope="session")
def round_trip() -> Callable[..., tuple[Array, Array]]:
    return along


@pytest.fixture(scope="session")
def circle() -> Trajectory:
    """Five and a half laps of a circle, anticlockwise from its southernmost point."""
    t = np.arange(0.0, 5.5 * 2.0 * np.pi * RADIUS / SPEED, 1.0 / RATE)
    angle = SPEED / RADIUS * t
    return made(t, RADIUS * np.stack([-np.cos(angle), -np.sin(angle)], axis=1))


@pytest.fixture(scope="session")
def larkfield() -> Truth:
    """Three and a half laps of the simulator's first track, from a standing start."""
    return drive(TRACKS["larkfield"], Motion(standstill=5.0), 210.0, np.random.default_rng(4))


@pytest.fixture(scope="session")
def driven(larkfield: Truth) -> Trajectory:
    """The truth of larkfield as an estimate with sigmas."""
    t = np.arange(0.2, 209.5, 1.0 / RATE)
    true = larkfield.trajectory(t, np.zeros(3))
    n = len(t)
    sigmas = Sigmas(
        np.full((n, 3), 2.0), np.full((n, 3), 0.1), np.full(n, 0.1), np.full((n, 3), 0.01), np.full(n, 0.05)
    )
    return Trajectory(**{**vars(true), "sigmas": sigmas, "report": EstimateReport(mode="full")})


def fixes_of(trajectory: Trajectory, every: int = 10) -> FixPath:
    return FixPath(trajectory.t[::every], trajectory.position_n[::every, :2])


@pytest.fixture(scope="session")
def fixes() -> Callable[..., FixPath]:
    return fixes_of
