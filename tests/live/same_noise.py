"""The batch smoother with the noise of the live one.

P_lag - P_batch is the variance of their difference only if both are of one model (Hausman 1978): two estimates of the
sigma of the fixes' slow offset, of a minute each, differ by as much as the few per cent that are compared.
"""

import numpy as np

from smoother.estimate.factors.graph import build_graph
from smoother.estimate.initial.guess import make_start, problem_of
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.model.noise import Noise
from smoother.estimate.output.estimated import estimated, known_from
from smoother.estimate.output.mounting import fit_mounting
from smoother.estimate.output.trajectory import build_trajectory
from smoother.estimate.solvers.batch import step
from smoother.estimate.solvers.identify import Sigmas, Solution, moved
from smoother.estimate.solvers.variance_components import components_of
from smoother.live.lag import LagOptions, LagStart
from smoother.samples import Session
from smoother.trajectory import Trajectory

SETTLED = 0.02  # sigmas that the batch smoother's last step may move it by
STEPS = 12
NONE = 1e-6  # m/s^2, sigma of an effect that is left out


def batch_with_noise_of(session: Session, start: LagStart) -> Trajectory:
    """Return the batch smoother's trajectory of a session with the noise that the live smoother uses."""
    options, error = GraphOptions(), LagOptions().sensor_error
    begun = make_start(session, options)
    # vibration that pushes is for those who have a whole session
    spread = {"accel_scale": np.full(6, error), "gyro_scale": np.full(3, error), "rectification": np.full(6, NONE)}
    fixes = start.position_sigma, start.velocity_sigma, start.offset_sigma, start.offset_tau
    noise, problem = Noise(start.inertial, *fixes, constants=spread), problem_of(begun)
    state = problem.state
    for _ in range(STEPS):
        graph = build_graph(problem.binned, problem.measured, noise, problem.priors, state)
        taken = step(graph, state.values())
        state, covariances = taken.after, taken.chain().covariances()
        if moved(taken, Sigmas.of(covariances)) < SETTLED:
            break
    found = components_of(graph, taken, covariances, problem.binned)
    solution = Solution(graph, taken, taken.chain(), covariances, found)
    known = known_from(solution, problem.priors, begun, session.config)
    mounting, population = (
        fit_mounting(solution.state, start.R_bs),
        np.sqrt(start.offset_sigma**2 + start.unseen_offset),
    )
    return build_trajectory(session, estimated(solution, known), mounting, begun.fine, options.rate, population)
