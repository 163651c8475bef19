"""Every lap over track distance: time, speed, delta, and line, each with sigma.

Delta compares times at the same point of the track, not at the same driven distance, which would drift by tenths of a
second over a lap because lines differ.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.fit.plan_path import PlanPath
from smoother.fit.running import local_polynomial
from smoother.frames import to_left
from smoother.laps.circuit import Circuit
from smoother.laps.passages import Passage
from smoother.laps.path import level_acceleration
from smoother.laps.reference import Curve
from smoother.laps.results import ReferenceLap, Traces
from smoother.laps.sideslip import sideslip_of
from smoother.laps.sigma import Crossed, covariances, least_significant, sigma_of, time_covariances
from smoother.trajectory import JointPosition, Trajectory

GRID = 2.0  # m between points
SMOOTHED_OVER = 0.4  # s, of the acceleration that zones are judged by
BRAKING, BRAKING_ENDS = -2.0, -1.0  # m/s^2, hysteresis
DRIVING, DRIVING_ENDS = 0.7, 0.3  # m/s^2


@dataclass(frozen=True, eq=False)
class Timed:
    """Inputs of traces, per row (N,): along and left acceleration, zone, sideslip with sigma."""

    along: Array
    left: Array
    zone: IntArray
    sideslip: Array
    sideslip_sigma: Array


def row_values(trajectory: Trajectory, path: PlanPath) -> Timed:
    """Return the values of each row for traces; path is that of the trajectory."""
    acceleration = level_acceleration(trajectory, path)
    along = _smoothed(acceleration[:, 0], path.t)
    return Timed(along, acceleration[:, 1], zones(along), *sideslip_of(trajectory, path))


def _smoothed(values: Array, t: Array) -> Array:
    window = 2 * round(0.5 * SMOOTHED_OVER / median(np.diff(t))) + 1
    if window < 3 or len(values) < window:
        return values
    return local_polynomial(values, window, 1)


def zones(along: Array) -> IntArray:
    """-1 braking, +1 driving, 0 neither, (N,), with hysteresis, of an acceleration (N,) m/s^2 along the path."""
    braking = _hysteresis(-along, -BRAKING, -BRAKING_ENDS)
    driving = _hysteresis(along, DRIVING, DRIVING_ENDS)
    return np.where(braking, -1, np.where(driving, 1, 0)).astype(np.int64)


def _hysteresis(values: Array, enter: float, leave: float) -> BoolArray:
    """True in each run above `leave` that reaches `enter`: the zone starts where the pedal starts to act."""
    above = values > leave
    run = np.cumsum(np.diff(above, prepend=False))
    reached = np.zeros(int(run[-1]) + 1, dtype=np.bool_)
    np.logical_or.at(reached, run, values > enter)
    return np.asarray(above & reached[run])


def grid_of(curve: Curve) -> Array:
    """Track distances (M,) from 0 to the whole lap, both ends on the line."""
    return np.linspace(0.0, curve.length, max(8, round(curve.length / GRID)) + 1)


def lap_times_at(path: PlanPath, circuit: Circuit, passage: Passage, distance: Array) -> Array:
    """Times (M,) s at which one lap was at track distances (M,) m; NaN where it was off the track."""
    followed = circuit.followed
    first, last = np.searchsorted(path.t, [passage.start, passage.end])
    rows = np.arange(max(first - 1, 0), min(last + 1, len(path.t)))
    rows = rows[np.isfinite(followed.distance[rows])]
    if len(rows) < 2:
        return np.full(len(distance), np.nan)
    along = np.maximum.accumulate(followed.distance[rows] - passage.base)
    along = along + 1e-9 * np.arange(len(along))  # at rest times must not be ambiguous
    t = np.interp(distance, along, path.t[rows])
    t += _led_in(distance, passage.start - np.interp(0.0, along, path.t[rows]), passage.starts_at_line)
    end = distance[-1]
    t += _led_in(end - distance, passage.end - np.interp(end, along, path.t[rows]), passage.ends_at_line)
    on = np.interp(distance, along, followed.is_on[rows].astype(np.float64)) > 0.5
    before, after = GRID * passage.starts_at_line, GRID * passage.ends_at_line  # not beyond the ends of the recording
    here = (distance >= along[0] - before) & (distance <= along[-1] + after) & on
    if passage.starts_at_line:
        here[0] = True
    if passage.ends_at_line:
        here[-1] = True
    inside = (t >= passage.start - 1e-6) & (t <= passage.end + 1e-6)
    return np.where(here & inside, t, np.nan)


def _led_in(distance: Array, error: float, is_crossing: bool) -> Array:
    if not is_crossing:
        return np.zeros(len(distance))
    # m over which times on the grid are blended into the crossing times, where a line is oblique
    return np.asarray(error * np.clip(1.0 - distance / 30.0, 0.0, 1.0))


def make_traces(
    trajectory: Trajectory,
    path: PlanPath,
    circuit: Circuit,
    passages: tuple[Passage, ...],
    values: Timed,
    reference: Array | None,
    counting: BoolArray | None,
    errors: JointPosition | None,
) -> Traces:
    """Return the traces of all laps.

    reference (M,) s: elapsed time of the reference lap at each point, None without; counting (L,): the laps whose mean
    is the reference line, None if that is of another session.
    """
    curve = circuit.curve
    distance = grid_of(curve)
    t = np.stack([lap_times_at(path, circuit, passage, distance) for passage in passages])
    known = np.isfinite(t)
    at = np.where(known, t, path.t[0])

    def sampled(rows: Array) -> Array:
        return np.where(known, np.interp(at, path.t, rows), np.nan)

    position, velocity = path.at(at.ravel())
    speed = np.where(known, np.hypot(velocity[:, 0], velocity[:, 1]).reshape(t.shape), np.nan)
    lateral = _lateral(curve, position.reshape(*t.shape, 2), distance)
    lateral = np.where(known, lateral, np.nan)
    lateral_sigma, place_sigma = _place_sigmas(curve, distance, t, counting, errors)
    elapsed = t - np.array([p.start if p.starts_at_line else np.nan for p in passages])[:, None]
    delta = elapsed - reference if reference is not None else np.full(t.shape, np.nan)
    nearest = np.clip(np.searchsorted(path.t, at), 0, len(path.t) - 1)
    return Traces(
        distance=distance,
        t=t,
        speed=speed,
        delta=delta,
        delta_sigma=np.full(t.shape, np.nan),
        lateral=lateral,
        lateral_sigma=lateral_sigma,
        place_sigma=place_sigma,
        is_off_line=(np.abs(lateral) > least_significant(lateral_sigma)) & (lateral_sigma > 0.0),
        longitudinal=sampled(values.along),
        lateral_acceleration=sampled(values.left),
        zone=np.where(known, values.zone[nearest], 0),
        sideslip=sampled(values.sideslip),
        sideslip_sigma=sampled(values.sideslip_sigma),
    )


def _lateral(curve: Curve, position: Array, distance: Array) -> Array:
    """Offset (L, M) to the left of the reference line, at its own points."""
    return to_left(curve.tangent(distance), position - curve.position(distance))


def sigma_places(distance: Array) -> IntArray:
    """Indices (B,) of the points at which sigmas are computed, including both ends."""
    # points of a lap at which sigmas are computed; between them they are interpolated
    return np.unique(np.linspace(0, len(distance) - 1, min(40, len(distance))).round().astype(np.int64))


def _place_sigmas(
    curve: Curve, distance: Array, t: Array, counting: BoolArray | None, errors: JointPosition | None
) -> tuple[Array, Array]:
    """Sigma (L, M) m of each lap's offset from the mean of the laps that count, and its share of the difference of two
    laps.

    The latter is used along the track too, because position errors are isotropic. Without `counting` the line is that
    of another session with an independent GPS error: then the whole position error counts twice.
    """
    out = np.full((2, *t.shape), np.nan)
    if errors is None:
        return out[0], out[1]
    places = sigma_places(distance)
    there = [np.flatnonzero(np.isfinite(t[:, place])) for place in places]
    there, places = [laps for laps in there if laps.size], places[[laps.size > 0 for laps in there]]
    left = [np.array([-west, north, 0.0]) for north, west in curve.tangent(distance[places])]
    directions = [np.tile(one, (len(laps), 1)) for one, laps in zip(left, there, strict=True)]
    times = [t[laps, place] for laps, place in zip(there, places, strict=True)]
    for place, laps, covariance in zip(places, there, covariances(errors, times, directions), strict=True):
        variance = _variances(covariance, None if counting is None else counting[laps])
        out[:, laps, place] = np.sqrt(np.maximum(variance, 0.0))
    known = np.isfinite(t)
    return _between(distance, places, out[0], known), _between(distance, places, out[1], known)


def _variances(covariance: Array, counting: BoolArray | None) -> Array:
    """Variance (2, K) of the offsets of K laps from the mean of those that count, and half of that between a lap and
    another that counts, as their covariance (K, K) has it; two laps then differ by the sum of theirs."""
    own = np.diag(covariance)
    if counting is None:
        return np.stack([2.0 * own, 2.0 * own])
    shaping = counting / max(1, int(np.count_nonzero(counting)))
    of_mean = covariance @ shaping
    compared = (counting if counting.any() else np.ones_like(counting)).astype(np.float64)
    between = (own[:, None] + own[None, :] - 2.0 * covariance) @ compared  # 0 with itself
    return np.stack(
        [own - 2.0 * of_mean + shaping @ of_mean, 0.5 * between / np.maximum(compared.sum() - compared, 1.0)]
    )


def _between(distance: Array, places: IntArray, values: Array, known: BoolArray) -> Array:
    """Interpolate (L, M) between the computed points."""
    out = np.full(values.shape, np.nan)
    for lap in range(len(values)):
        have = places[np.isfinite(values[lap, places])]
        if have.size:
            out[lap] = np.interp(distance, distance[have], values[lap, have])
    return np.where(known, out, np.nan)


def delta_sigma(
    curve: Curve, traces_t: Array, path: PlanPath, distance: Array, reference: int | None, errors: JointPosition
) -> Array:
    """Sigma (L, M) s of each lap's delta: of four crossings, two of its own and two of the reference lap.

    reference: its index; None for a lap of another session, whose errors are unknown: then only the crossings of the
    lap itself count.
    """
    places = sigma_places(distance)
    normal = curve.tangent(distance[places])
    theirs = np.empty(0) if reference is None else traces_t[reference, places]
    laps = [lap for lap in range(len(traces_t)) if lap != reference and np.isfinite(traces_t[lap, 0])]
    known = {lap: np.isfinite(traces_t[lap, places]) & (np.isfinite(theirs) if theirs.size else True) for lap in laps}
    groups = []
    for lap in laps:
        times = np.concatenate([values[known[lap]] for values in (traces_t[lap, places], theirs) if values.size])
        normals = np.tile(normal[known[lap]], (2 if theirs.size else 1, 1))
        groups.append(Crossed(times, normals, path.at(times)[1]))
    out = np.full(traces_t.shape, np.nan)
    for lap, covariance in zip(laps, time_covariances(errors, groups), strict=True):
        elapsed = np.eye(int(np.count_nonzero(known[lap])))
        elapsed[:, 0] -= 1.0  # since the line
        weights = np.concatenate([elapsed, -elapsed], axis=1) if theirs.size else elapsed
        out[lap, places[known[lap]]] = sigma_of(covariance, weights)
    filled = _between(distance, places, out, np.isfinite(traces_t))
    if reference is not None:
        filled[reference] = np.where(np.isfinite(traces_t[reference]), 0.0, np.nan)
    return filled


def as_reference_lap(
    traces: Traces, lap: int, name: str, curve: Curve, path: PlanPath, errors: JointPosition | None
) -> ReferenceLap:
    """Return a lap as a reference for laps of other sessions."""
    elapsed = traces.t[lap] - traces.t[lap, 0]
    known = np.isfinite(elapsed)
    sigma = None
    if errors is not None:
        sigma = delta_sigma(curve, traces.t[lap : lap + 1], path, traces.distance, None, errors)[0][known]
    return ReferenceLap(traces.distance[known], elapsed[known], name, sigma)
