"""The batch smoother with the noise of the live one.

P_lag - P_batch is the variance of their difference only if both are of one model (Hausman 1978): two estimates of the
sigma of the fixes' slow offset, of a minute each, differ by as much as the few per cent that are compared.
"""

import numpy as np

from smoother.estimate.graph.batch import Batch, constants_moved, moved, variances
from smoother.estimate.graph.coarse import near_solution
from smoother.estimate.graph.inputs import Noise
from smoother.estimate.graph.relaxation import Relaxation
from smoother.estimate.graph.start import make_start
from smoother.estimate.output.estimated import are_made_up, estimated
from smoother.estimate.output.mounting import fit_mounting
from smoother.estimate.output.trajectory import build_trajectory
from smoother.estimate.smoother import GraphOptions
from smoother.live.lag import LagOptions, LagStart
from smoother.samples import Session
from smoother.trajectory import Trajectory

SETTLED = 0.02  # sigmas that the batch smoother's last step may move it by
STEPS = 12
NONE = 1e-6  # m/s^2, sigma of an effect that is left out


def batch_with_noise_of(session: Session, start: LagStart) -> Trajectory:
    """Return the batch smoother's trajectory of a session with the noise that the live smoother uses."""
    options = GraphOptions()
    begun = make_start(session, options)
    error = LagOptions().sensor_error
    spread = np.array([error, error, NONE])  # vibration that pushes is for those who have a whole session
    fixes = start.position_sigma, start.velocity_sigma, start.offset_sigma, start.offset_tau
    noise = Noise(start.inertial, *fixes, spread)
    batch, state = Batch(begun.data, begun.binned, begun.priors), near_solution(begun, noise, options.approaches)
    relaxation = Relaxation()
    for turn in range(STEPS):
        solved = batch.step(batch.graph(state, noise), state, noise, relaxation)
        state = solved.state
        step = solved.solution
        if turn > 0 and max(moved(step, variances(step)), constants_moved(step)) < SETTLED:
            break
    mounting, population = fit_mounting(state, start.R_bs), np.sqrt(start.offset_sigma**2 + start.unseen_offset)
    found = estimated(solved, None, are_made_up(begun.fine))
    return build_trajectory(session, found, noise, mounting, begun.fine, begun.priors, options.rate, population)
