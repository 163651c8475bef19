"""Separation of the slow error of the fixes from that of the Doppler velocities that the path follows.

The graph assumes independent Doppler velocities, so that the path follows them, and slow differences from the fixes
become their offset. A part of it is the slow error of Doppler, integrated: 0.1 m after 30 s (`slow_errors.DOPPLER`).
Neither samples nor fixes can separate both, so it is no unknown of the graph. Its offset y is separated afterwards, per
level axis,

    y = o + w,   o: first-order Gauss-Markov, of the fixes;   w' = b,   b: first-order Gauss-Markov, of Doppler

by the most probable o, w and b of a chain of nodes. Sigmas of o and b are those that laps show (`slow_errors`); without
laps b is the usual one and o has the likeliest sigma. The path moves by w.

Sources: Gelb 1974, 3.8 (both processes); Schweppe 1965 (the likelihood); Rauch, Tung and Striebel 1965 (that the most
probable states are those of least squares).
"""

import math
from dataclasses import replace

import numpy as np

from smoother.arrays import Array
from smoother.disc import roomy
from smoother.estimate.factors.rows import Rows, rows_of
from smoother.estimate.fixes.offset import ANYWHERE, BIN, FEWEST, Drift, log_likelihood
from smoother.estimate.fixes.slow_errors import DOPPLER, SlowErrors, SlowVelocity
from smoother.estimate.model.state import State
from smoother.estimate.output.resample import bracket, hermite, hermite_slope
from smoother.estimate.solvers.batch import solve_rows

WEIGHTY = 0.5  # least robust weight of a fix that determines the offset
SIGMAS = np.geomspace(0.005, 5.0, 25)  # m, of o, that are tried
UNKNOWNS = 3  # of a node: o, w, b


def share_wander(state: State, seen: Drift, errors: SlowErrors) -> State:
    """Return the state with Doppler's part of the level offset, `seen` at fixes, moved into the path."""
    moved_n, faster_n = moved(seen, errors, state.t)
    return replace(
        state,
        position_n=_sum(state.position_n, moved_n),
        velocity_n=_sum(state.velocity_n, faster_n),
        offset_n=_sum(state.offset_n, -moved_n),
    )


def _sum(values: Array, more: Array) -> Array:
    """The sum of two (K, 3), of a day on the disc."""
    out: Array = roomy(values.shape)
    np.add(values, more, out=out)
    return out


def unaided(seen: Drift, tau: float) -> SlowErrors:
    """Return the slow errors without laps: the usual one of Doppler, the likeliest of fixes, of time constant tau s."""
    return SlowErrors(likeliest_sigma(seen, tau), tau, DOPPLER)


def moved(seen: Drift, errors: SlowErrors, t: Array) -> tuple[Array, Array]:
    """Way w m and velocity b m/s (N, 3) at t (N,) s of Doppler's part of the offset `seen`; none upwards.

    Before the first and after the last node the way is constant.
    """
    _, w, b = most_probable(seen, errors.sigma, errors.tau, errors.doppler)
    place = bracket(seen.t, t)
    inside = (t >= seen.t[0]) & (t <= seen.t[-1])
    moved_n, faster_n = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    moved_n[:, :2] = hermite(w, b, place)
    faster_n[:, :2] = np.where(inside[:, None], hermite_slope(w, b, place), 0.0)
    return moved_n, faster_n


def likeliest_sigma(seen: Drift, tau: float, slow: SlowVelocity = DOPPLER) -> float:
    """Sigma of o, m, of the highest likelihood: of SIGMAS, and between them by a parabola."""
    logs = np.log(SIGMAS)
    walks = math.log(2.0 / tau) + 2.0 * logs
    found = log_likelihood(seen, np.stack([np.full(len(logs), math.log(tau)), walks, np.zeros(len(logs))]), slow)
    best = int(np.argmax(found))
    if best in (0, len(logs) - 1):
        return float(SIGMAS[best])
    before, at, after = found[best - 1 : best + 2]
    beside = 0.5 * (before - after) / (before - 2.0 * at + after)
    return float(np.exp(logs[best] + beside * (logs[1] - logs[0])))


def most_probable(seen: Drift, sigma: float, tau: float, slow: SlowVelocity = DOPPLER) -> tuple[Array, Array, Array]:
    """Own offset o m, way w m and velocity b m/s of Doppler's slow error, each (B, 2), of the offset `seen`.

    sigma m and tau s are those of o. Least squares over all nodes, of UNKNOWNS for each level axis.
    """
    transition, root = _steps(np.diff(seen.t), seen.walk[1:], sigma, tau, slow)
    nodes, eye = np.arange(len(seen.t)), np.eye(2)
    level = [np.kron(root, eye), np.kron(-root @ transition, eye), np.kron(np.array([[1.0, 1.0, 0.0]]), eye)]
    both = (len(seen.t), 2, 2 * UNKNOWNS)
    sees = np.broadcast_to(level[2], both)
    sees_last = nodes == nodes[-1]  # by the interval before it
    rows = [
        rows_of("steps", nodes[:-1], np.zeros((len(nodes) - 1, 2 * UNKNOWNS)), 1.0, level[1], level[0]),
        rows_of(
            "seen",
            np.minimum(nodes, nodes[-1] - 1),
            -seen.drift,
            np.sqrt(seen.white)[:, None],
            np.where(sees_last[:, None, None], 0.0, sees),
            np.where(sees_last[:, None, None], sees, 0.0),
        ),
        rows_of(
            "start",
            nodes[:1],
            np.zeros((1, 2 * UNKNOWNS)),
            np.repeat([sigma, ANYWHERE, slow.sigma], 2),
            np.eye(2 * UNKNOWNS)[None],
            np.zeros((1, 2 * UNKNOWNS, 2 * UNKNOWNS)),
        ),
    ]
    found, _, _ = solve_rows(rows, len(nodes), ())
    own, way, velocity = found.reshape(-1, UNKNOWNS, 2).transpose(1, 0, 2)
    return own, way, velocity


def _steps(h: Array, walk: Array, sigma: float, tau: float, slow: SlowVelocity) -> tuple[Array, Array]:
    """Transitions and roots of the information (S, 3, 3) of (o, w, b) over steps h (S,) s; walk (S,) m^2: of w."""
    F, Q = np.zeros((2, len(h), UNKNOWNS, UNKNOWNS))
    F[:, 0, 0], F[:, 1, 1] = np.exp(-h / tau), 1.0
    F[:, 1, 2], F[:, 2, 2] = ([part(float(step)) for step in h] for part in (slow.gone, slow.kept))
    Q[:, 0, 0] = sigma**2 * -np.expm1(-2.0 * h / tau)
    Q[:, 1, 1], Q[:, 1, 2], Q[:, 2, 2] = np.reshape([slow.noise(float(step)) for step in h], (-1, 3)).T
    Q[:, 1, 1] += walk
    Q[:, 2, 1] = Q[:, 1, 2]
    return F, np.asarray(np.linalg.inv(np.linalg.cholesky(Q)), dtype=np.float64)


def offset_at_fixes(state: State, fixes: Rows) -> Drift | None:
    """Return the level offset of the graph where fixes hold it, in means of BIN; white: variance of the fixes that do.

    fixes: their rows, one per fix. None where they are too few.
    """
    use = np.flatnonzero(np.isfinite(fixes.sigma[:, 0]) & (fixes.weight > WEIGHTY))
    if not len(use):
        return None
    at = fixes.interval[use]
    _, row = np.unique(np.floor((state.t[at] - state.t[0]) / BIN), return_inverse=True)
    count = np.bincount(row)
    t, north, west = (np.bincount(row, values) / count for values in (state.t[at], *state.offset_n[at, :2].T))
    white = 1.0 / np.bincount(row, fixes.weight[use] / fixes.sigma[use, 0] ** 2)
    return Drift(t, np.stack([north, west], axis=1), np.zeros(len(t)), white) if len(t) >= FEWEST else None
