"""The path through the fixes of any session: in one piece, or hour by hour where it is long, so that memory is bounded.

The hours overlap by twice the time over which the GPS offset is forgotten, and the path changes over in the middle.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from smoother.arrays import Array
from smoother.estimate.fixes.path import GnssPath, GnssPathOptions, VelocityLag, fit_gnss_path
from smoother.estimate.fixes.path_noise import relative_sigmas
from smoother.samples import Session

PIECE = 3600.0  # s
LONG = 2.0 * PIECE  # s, from which on a session is taken in pieces
OVERLAP = 120.0  # s to either side
BLEND = 20.0  # s over which one piece gives way to the next
FEWEST_FIXES = 100  # of a piece; one with fewer joins the one before
PER_FIX = ("position_residual_n", "velocity_residual_n", "position_weight", "velocity_weight", "up_weight")
SCALES = ("position_scale", "up_scale", "velocity_scale")
PER_NODE = ("t", "position_n", "velocity_n", "acceleration_n", "offset_n")


def fit_path(session: Session, options: GnssPathOptions | None = None) -> GnssPath:
    """Return what :func:`smoother.estimate.fixes.path.fit_gnss_path` does, for sessions of any length."""
    t = session.gnss.t
    if t[-1] - t[0] < LONG:
        return fit_gnss_path(session, options)
    edges = _edges(t)
    insides = [(t >= first - OVERLAP) & (t < last + OVERLAP) for first, last in pairwise(edges)]
    paths = [fit_gnss_path(replace(session, gnss=session.gnss.select(inside)), options) for inside in insides]
    parts = []
    for i, (first, last) in enumerate(pairwise(edges)):
        path = paths[i] if i == 0 else _drawn(paths[i], paths[i - 1], first)
        path = path if i + 1 == len(paths) else _drawn(path, paths[i + 1], last)
        parts.append(_core(path, t[insides[i]], first, last))
    return _joined(parts, session)


def _edges(t: Array) -> list[float]:
    """Times (P + 1,) s between which the pieces count, infinite at the ends."""
    wanted = np.linspace(t[0], t[-1], round(float(t[-1] - t[0]) / PIECE) + 1)
    edges = [-np.inf]
    for edge in wanted[1:-1].tolist():
        if np.count_nonzero((t >= edges[-1]) & (t < edge)) >= FEWEST_FIXES:
            edges.append(edge)
    if np.count_nonzero(t >= edges[-1]) < FEWEST_FIXES and len(edges) > 1:
        edges.pop()
    return [*edges, np.inf]


def _drawn(path: GnssPath, neighbour: GnssPath, edge: float) -> GnssPath:
    """Return the path drawn towards its neighbour near the time where they change over, and half the way there."""
    near = np.abs(path.t - edge) < 0.5 * BLEND
    share, other = 0.5 - np.abs(path.t[near] - edge)[:, None] / BLEND, neighbour.at(path.t[near])
    changes: dict[str, Any] = {}
    for name in PER_NODE[1:]:
        changes[name] = getattr(path, name).copy()
        changes[name][near] += share * (getattr(other, name) - changes[name][near])
    return replace(path, **changes)


def _core(path: GnssPath, stamps: Array, first: float, last: float) -> GnssPath:
    """Return the path with the nodes and the fixes from time first to last alone."""
    nodes, fixes = (path.t >= first) & (path.t < last), (stamps >= first) & (stamps < last)
    changes: dict[str, Any] = {name: getattr(path, name)[nodes] for name in PER_NODE}
    changes |= {name: getattr(path, name)[fixes] for name in (*PER_FIX, *SCALES)}
    return replace(path, covariance=path.covariance[:, nodes], velocity_cross=path.velocity_cross[nodes], **changes)


def _joined(parts: list[GnssPath], session: Session) -> GnssPath:
    """Return the parts one behind the other, with noise and constants that are the means of all."""

    changes: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in (*PER_NODE, *PER_FIX)
    }
    for name in ("position_sigma", "velocity_sigma", "jerk_density"):
        changes[name] = np.median([getattr(part, name) for part in parts], axis=0)
    position, height, velocity, _ = relative_sigmas(session.gnss).T
    bias, bias_sigma = _mean([part.velocity_bias for part in parts], [part.velocity_bias_sigma for part in parts])
    return replace(
        parts[0],
        **changes,
        covariance=np.concatenate([part.covariance for part in parts], axis=1),
        velocity_cross=np.concatenate([part.velocity_cross for part in parts]),
        position_scale=position,
        up_scale=height,
        velocity_scale=velocity,
        velocity_lag=_lag([part.velocity_lag for part in parts]),
        velocity_bias=bias,
        velocity_bias_sigma=bias_sigma,
        iterations=max(part.iterations for part in parts),
        wander=float(np.median([part.wander for part in parts])),
    )


def _lag(lags: list[VelocityLag]) -> VelocityLag:
    if lags[0].source == "configured":
        return lags[0]
    value, sigma = _mean([np.array(lag.value) for lag in lags], [np.array(lag.sigma) for lag in lags])
    found = any(lag.source == "identified" for lag in lags)
    return VelocityLag(
        float(value), float(sigma), any(lag.observable for lag in lags), "identified" if found else "default"
    )


def _mean(values: list[Array], sigmas: list[Array]) -> tuple[Array, Array]:
    """Mean of values, weighted by their sigmas, and the sigma of the mean."""
    weight = np.maximum(sigmas, 1e-9) ** -2.0
    total = weight.sum(axis=0)
    return np.asarray((weight * values).sum(axis=0) / total), np.asarray(total**-0.5)
