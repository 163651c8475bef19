"""All rows of a session at one state but the inertial ones, with robust weights, and the motion expected along it.

rows.py has the formula of each kind of row; here is which of them a session has, and how much each of them counts.
"""

import math
from dataclasses import replace

import numpy as np

from smoother.arrays import BoolArray
from smoother.estimate.factors import ground
from smoother.estimate.graph import rows as rw
from smoother.estimate.graph.expected import DRIVEN_BELOW, DopplerNoise, ExpectedMotion, expected_motion, shown_below
from smoother.estimate.graph.imu import DensePath
from smoother.estimate.graph.inputs import Data, Noise, Priors
from smoother.estimate.graph.response import low_pass_share
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.sampled import are_unsampled
from smoother.estimate.graph.slip import (
    Slip,
    SlipNoise,
    not_doubted_by,
    slip_rows,
)
from smoother.estimate.graph.state import (
    ACCEL_BIAS,
    GYRO_BIAS,
    ChainState,
)
from smoother.estimate.graph.upright import along_path_rows, unsteadiness, upright_rows

# A residual beyond this loses weight as (limit / distance)^2: redescending. Of two components the distance is that in
# sigmas; of other numbers it is sqrt(2) times the rms of the components, so that one beyond 2.1 sigma loses weight, and
# three beyond 3.7.
ROBUST_LIMIT = 3.0
ANYWHERE = np.repeat([3.0, 1e4, 1e3], 3)  # rad, m, m/s: sigmas of motion of which nothing is known
STILL_SPEED = 0.02  # m/s; a chassis on its tyres with the engine idling
STILL_TURN = 3e-4  # rad between keyframes, likewise
# m/sqrt(Hz): what level ground is worth, a height to 2 m in a second. Much less than tracks are level to, since heights
# are near one another for seconds: with this, what is said of climbing holds on tracks that rise by 3.5 m.
LEVEL_GROUND = 2.0
FAR_FROM_HEIGHT = ground.FAR_FROM_HEIGHT  # s; for so long the samples alone carry a height


def unsteady_share(state: ChainState, noise: Noise) -> float:
    """Share 0 to 1 of what is asked of attitudes where rates hardly tell them."""
    return 0.0 if state.constants.is_steered else unsteadiness(noise.inertial.gyro)


def slip_rows_of(slip: Slip, interval: float, noise: SlipNoise, *, was_without_wheels: bool) -> list[Rows]:
    """Rows of the slip with robust weights; `interval` s."""
    out = []
    for r in slip_rows(slip, interval, noise.sigma):
        judged = not_doubted_by(slip, noise.unsure, r) if was_without_wheels else r
        out.append(replace(r, weight=robust(judged).weight))
    return out


def steadying_rows(state: ChainState, slip: Slip, share: float, *, with_path: bool) -> list[Rows]:
    """Return rows that hold roll and pitch where rates hardly tell them, and with_path yaw, too.

    share, 0 to 1, of their weight: see :func:`unsteady_share`.
    """
    rows = [upright_rows(state, slip, share)]
    if with_path:
        rows.append(along_path_rows(state, slip, share))
    return [robust(r) for r in rows if len(r.interval)]


def doppler_noise(d: Data, noise: Noise, axis: int = 0) -> DopplerNoise | None:
    """What the session's velocities tell on an axis of n, None where there are none."""
    return DopplerNoise.of(d.t, d.velocity_n[:, axis], float(noise.of_velocities[axis]))


def expected_of(d: Data, path: DensePath, state: ChainState, noise: Noise) -> ExpectedMotion:
    """Return the most probable motion along the dense path of `state`.

    Where it is set apart nothing holds the path: it may leap, by 500 m/s^2 across a hole in an outage, and the spectrum
    of the whole session would be that of the leap. It counts as rest there; no fix is read in it.
    """
    level, up = doppler_noise(d, noise), doppler_noise(d, noise, 2)
    if d.sampled is not None:
        apart = np.repeat(are_unsampled(d.sampled, state.t[:-1], state.t[1:]), (len(path.t) - 1) // (len(state.t) - 1))
        # where samples end, the last keyframe that has some is the first one of the hole, and moves on
        inside = np.append(apart, False) & np.append(False, apart)
        path = replace(
            path,
            acceleration_n=np.where(apart[:, None], 0.0, path.acceleration_n),
            velocity_n=np.where(inside[:, None], 0.0, path.velocity_n),
        )
    c = state.constants
    return expected_motion(
        path,
        c.level_axes_s,
        noise.inertial,
        level,
        state.interval,
        up,
        is_steered=c.is_steered,
        slopes_below=DRIVEN_BELOW if c.is_steered else _shown_below(c.velocity_response),
    )


def _shown_below(response: float) -> float:
    """Frequency, Hz, of what a receiver shows late and little else, by what of its response, s^2, is a filter's."""
    share, _ = low_pass_share(response)
    return shown_below(share * response)


def session_rows(
    d: Data, prior: Priors, path: DensePath, felt: ExpectedMotion, state: ChainState, noise: Noise
) -> list[Rows]:
    """Everything that is not inertial, linearised at `state`, whose dense path is `path`; fixes with robust weights.

    felt: the motion expected along the path.
    """
    position = rw.position_rows(
        state, path, felt, d.t, d.position_n, d.position_scale[:, None] * noise.position, prior.constants[0]
    )
    velocity = rw.velocity_rows(state, path, felt, d.t, d.velocity_n, d.velocity_scale[:, None] * noise.of_velocities)
    out = [
        robust(position, d.doubted),
        robust(velocity),
        *rw.offset_rows(state, noise.offset_sigma, noise.offset_tau, d.claims, float(prior.constants[0])),
    ]
    bias = np.concatenate([state.accel_bias_s[0], state.gyro_bias_s[0] - prior.gyro_bias_mean])
    sigma = np.repeat([prior.accel_bias, prior.gyro_bias], 3)
    out.append(rw.prior_row("bias_prior", bias, sigma, slice(ACCEL_BIAS.start, GYRO_BIAS.stop)))
    out.append(rw.prior_row("pose_prior", np.zeros(9), ANYWHERE, slice(0, 9)))
    if d.heights is not None:
        at, height = ground.far_from_heights(d.heights, state.t)
        if len(at):
            out.append(rw.ground_rows(state, LEVEL_GROUND / math.sqrt(state.interval), at, height))
    if len(d.still):
        out.append(rw.standstill_rows(state, d.still, STILL_SPEED, STILL_TURN))
    if d.heading is not None:
        out.append(rw.heading_rows(state, d.heading))
    return out


def robust(rows: Rows, doubted: BoolArray | None = None) -> Rows:
    """Return the rows with the weight that ROBUST_LIMIT gives each at its residual; 0 for those doubted (N,)."""
    finite = np.isfinite(rows.sigma)
    squared = np.where(finite, (rows.residual / np.where(finite, rows.sigma, 1.0)) ** 2, 0.0)
    dimension = np.maximum(finite.sum(axis=1), 1)
    distance = np.sqrt(squared.sum(axis=1) / dimension * 2.0)  # as if of two components
    weight = np.minimum(1.0, (ROBUST_LIMIT / np.maximum(distance, 1e-9)) ** 2)
    return replace(rows, weight=weight if doubted is None else np.where(doubted, 0.0, weight))
