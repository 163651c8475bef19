"""Simulated sessions with what the smoother makes of them and the truth beside it; some made once for many tests."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.frames import wrap_angle
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A simulated session with what was made of it, and the truth at its rows."""

    simulation: Simulation
    session: Session
    trajectory: Trajectory
    truth: Trajectory

    @property
    def error_n(self) -> np.ndarray:
        """Position error (N, 3) m."""
        return self.trajectory.position_n - self.truth.position_n

    @property
    def euler_error(self) -> np.ndarray:
        """Roll, pitch, yaw error (N, 3) rad."""
        return wrap_angle(self.trajectory.euler - self.truth.euler)

    @property
    def velocity_error_n(self) -> np.ndarray:
        """Velocity error (N, 3) m/s."""
        return self.trajectory.velocity_n - self.truth.velocity_n

    @property
    def raw_error_n(self) -> np.ndarray:
        """Error of the fixes where they claim to be, (N, 3) m."""
        return self.session.fix_position_n - self.truth_at(self.session.gnss.t).position_n

    def truth_at(self, t: np.ndarray) -> Trajectory:
        """Truth of the antenna at t (N,) s."""
        return self.simulation.truth.trajectory(t, self.simulation.scenario.lever_arm_b, self.session.origin)


def horizontal_rms(error_n: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(error_n[:, :2] ** 2, axis=1))))


def smoothed(simulation: Simulation, session: Session | None = None, options: GraphOptions | None = None) -> Smoothed:
    session = prepare(simulation.raw) if session is None else session
    trajectory = GraphSmoother(options or GraphOptions()).estimate(session)
    arm = simulation.scenario.lever_arm_b
    return Smoothed(simulation, session, trajectory, simulation.truth.trajectory(trajectory.t, arm, session.origin))


@cache
def white(seed: int, doppler: bool) -> Smoothed:
    return smoothed(simulate_preset("white", seed, duration=200.0, gnss_velocity=doppler))


@cache
def kart(seed: int = 1) -> Smoothed:
    return smoothed(simulate_preset("kart", seed, duration=150.0))
