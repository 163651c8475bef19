"""The lap analysis: from a trajectory to laps and everything that follows from them."""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import release
from smoother.fit.loop import SHORTEST
from smoother.fit.plan_path import PlanPath
from smoother.laps.circuit import Circuit, find_circuit, usual_speed
from smoother.laps.closure import tie_laps
from smoother.laps.corner_speeds import smooth_speed
from smoother.laps.corners import make_corners
from smoother.laps.delta import as_reference_lap, delta_sigma, grid_of, lap_times_at, make_traces, row_values
from smoother.laps.passages import Passage, find_passages, reasons
from smoother.laps.path import in_gaps, interpolated, plan_path
from smoother.laps.reference import Curve
from smoother.laps.results import (
    Corner,
    FixPath,
    GivenLines,
    Lap,
    LapAnalysis,
    Line,
    OfficialTime,
    Reason,
    ReferenceLap,
    ReferenceLine,
    SigmaSource,
)
from smoother.laps.sectors import found_sectors, lap_sigmas, line_times
from smoother.laps.sideslip import why_hidden
from smoother.laps.sigma import Drift, position_errors
from smoother.laps.statistics import official_times, statistics_of
from smoother.laps.timing import BESIDE, raw_crossings
from smoother.laps.top_speed import shrunk_tops
from smoother.samples import Problem
from smoother.trajectory import JointPosition, Trajectory


@dataclass(frozen=True, eq=False)
class LapOptions:
    """Options of the lap analysis; everything has a default.

    lines: start/finish and sectors, None: found. reference, reference_lap: of another session, for comparisons.
    official (K,) s: transponder times in driving order. shortest m: a loop below is no lap.
    drift: how the position error changes with time, of results read from files. problems: of the stated values.
    ties_laps: laps are tied to the line that they have in common, where the covariance of positions is known.
    """

    lines: GivenLines | None = None
    reference: ReferenceLine | None = None
    reference_lap: ReferenceLap | None = None
    official: tuple[float, ...] = ()
    shortest: float = SHORTEST
    drift: Drift | None = None
    problems: tuple[Problem, ...] = ()
    ties_laps: bool = True


@dataclass(frozen=True, eq=False)
class _Given:
    """Inputs of every stage."""

    trajectory: Trajectory
    path: PlanPath
    fixes: FixPath
    options: LapOptions
    errors: JointPosition | None
    source: SigmaSource


def analyse(trajectory: Trajectory, fixes: FixPath, options: LapOptions | None = None) -> LapAnalysis:
    """Return laps and all that follows from them; without a loop or line an analysis without laps, with the reason.

    `trajectory` at 10 Hz or more; `fixes` are the raw ones, for gaps and for times without smoothing.
    """
    options = options or LapOptions()
    found = _analyse(trajectory, fixes, options)
    return replace(found, problems=(*options.problems, *found.problems, *_unmatched(found.official)))


def _unmatched(official: tuple[OfficialTime, ...]) -> tuple[Problem, ...]:
    """The problem of official times of which none matches a lap."""
    if not official or any(time.lap is not None for time in official):
        return ()
    text = f"none of the {len(official)} official times is near that of a lap; are they of this session?"
    return (Problem("official_unmatched", text),)


def _analyse(trajectory: Trajectory, fixes: FixPath, options: LapOptions) -> LapAnalysis:
    if len(trajectory) < 3 or not np.isfinite(trajectory.position_n[:, :2]).all():
        return without_laps(trajectory, Problem("no_laps", "the trajectory is too short for laps"))
    trajectory, errors, source = _tied(trajectory, fixes, options.drift, ties_laps=options.ties_laps)
    given = _Given(trajectory, plan_path(trajectory), fixes, options, errors, source)
    blind = in_gaps(given.path.t, fixes)
    circuit = find_circuit(given.path, options.lines, options.reference, options.shortest, blind)
    if isinstance(circuit, Problem):
        return without_laps(trajectory, circuit)
    passages = find_passages(given.path, circuit, blind, _beside(trajectory))
    if not any(passage.is_timed for passage in passages):
        none = Problem("no_laps", "no whole lap: the line was not passed twice")
        return _empty_circuit(without_laps(trajectory, *circuit.problems, none), circuit, passages, given)
    return _analysed(given, circuit, passages)


def _beside(trajectory: Trajectory) -> float:
    """Tolerance (m) of the position of a passage: three sigma, within limits."""
    if trajectory.sigmas is None:
        return BESIDE
    sigma = float(np.nanmedian(trajectory.sigmas.position_n[:, :2]))
    return float(np.clip(3.0 * sigma, 4.0, 12.0)) if np.isfinite(sigma) else BESIDE


def reference_lap_of(
    analysis: LapAnalysis, trajectory: Trajectory, fixes: FixPath, name: str, drift: Drift | None = None
) -> ReferenceLap | None:
    """Return the best lap of a session as a reference for others; None without one."""
    if analysis.traces is None or analysis.reference is None or analysis.reference_lap is None:
        return None
    trajectory, errors, _ = _tied(trajectory, fixes, drift)
    curve, lap = Curve(analysis.reference), analysis.reference_lap
    return as_reference_lap(analysis.traces, lap, name, curve, plan_path(trajectory), errors)


def _tied(
    trajectory: Trajectory, fixes: FixPath, drift: Drift | None, *, ties_laps: bool = True
) -> tuple[Trajectory, JointPosition | None, SigmaSource]:
    """The trajectory with its laps tied, unless the covariance is a model, and the covariance with its source."""
    interval = float(np.median(np.diff(fixes.t))) if len(fixes.t) > 1 else np.inf
    errors, source = position_errors(trajectory, interval, drift)
    if ties_laps and errors is not None and source in ("joint", "stored"):
        trajectory, errors = tie_laps(trajectory, errors)
    return trajectory, errors, source


def without_laps(trajectory: Trajectory, *problems: Problem) -> LapAnalysis:
    """Return the analysis of a session without laps, with the reason."""
    n = len(trajectory)
    return LapAnalysis(np.full(n, -1, dtype=np.int64), np.full(n, np.nan), problems=problems)


def _analysed(given: _Given, circuit: Circuit, passages: tuple[Passage, ...]) -> LapAnalysis:
    path, options = given.path, given.options
    usual = float(np.median(usual_speed(path, circuit.curve, circuit.followed)))
    why = tuple(reasons(p, path, circuit, given.trajectory, given.fixes, usual) for p in passages)
    valid = np.array([not reason for reason in why])
    quickest = _quickest(passages, valid)
    elapsed = _elapsed(given, circuit, passages, quickest)
    index = None if options.reference_lap is not None else quickest
    shaping = valid if options.reference is None else None
    traces = make_traces(
        given.trajectory, path, circuit, passages, row_values(given.trajectory, path), elapsed, shaping, given.errors
    )
    release(given.trajectory)
    if given.errors is not None and elapsed is not None:
        sigma = delta_sigma(circuit.curve, traces.t, path, traces.distance, index, given.errors)
        traces = replace(traces, delta_sigma=np.hypot(sigma, _sigma_elsewhere(traces.distance, options)))
    corners = make_corners(circuit.curve, traces, given.trajectory, path, index, elapsed, valid, given.errors)
    lines = circuit.sector_lines or _sectors(circuit, corners, valid)
    laps = _laps(given, circuit, passages, why, lines, quickest)
    gates = (circuit.start_line, *lines, circuit.finish_line or circuit.start_line)
    return LapAnalysis(
        laps=laps,
        start_line=circuit.start_line,
        sector_lines=lines,
        finish_line=circuit.finish_line,
        reference=circuit.curve.line,
        traces=traces,
        corners=corners,
        statistics=statistics_of(laps, gates, traces, circuit.curve, path, given.errors, given.source),
        reference_lap=index,
        reference_name="" if options.reference_lap is None else options.reference_lap.name,
        official=official_times(options.official, laps),
        sigma_source=given.source,
        lap_of_row=_lap_of_row(path, passages),
        lap_distance=_lap_distance(circuit),
        track="" if options.lines is None else options.lines.name,
        problems=circuit.problems,
        no_sideslip=why_hidden(given.trajectory, path),
    )


def _empty_circuit(nothing: LapAnalysis, circuit: Circuit, passages: tuple[Passage, ...], given: _Given) -> LapAnalysis:
    """A track and a line, but no whole lap on it."""
    laps = tuple(_untimed(given, *each) for each in zip(passages, _speeds(given, passages), strict=True))
    return replace(
        nothing,
        laps=laps,
        start_line=circuit.start_line,
        finish_line=circuit.finish_line,
        reference=circuit.curve.line,
        lap_of_row=_lap_of_row(given.path, passages),
        lap_distance=_lap_distance(circuit),
    )


def _untimed(given: _Given, passage: Passage, speeds: Array) -> Lap:
    reason: Reason = "in-lap" if passage.starts_at_line else "out-lap"
    empty = np.full(1, np.nan)
    return _lap(given, passage, (reason,), np.nan, empty, empty, empty, np.nan, speeds)


def _quickest(passages: tuple[Passage, ...], valid: BoolArray) -> int | None:
    """Index of the reference lap: the best that counts, else the quickest timed one."""
    for wanted in (valid, np.array([p.is_timed for p in passages])):
        chosen = np.flatnonzero(wanted)
        if chosen.size:
            return int(min(chosen, key=lambda i: passages[i].end - passages[i].start))
    return None


def _elapsed(given: _Given, circuit: Circuit, passages: tuple[Passage, ...], quickest: int | None) -> Array | None:
    """Elapsed time (M,) s of the reference lap."""
    distance, elsewhere = grid_of(circuit.curve), given.options.reference_lap
    if elsewhere is not None:
        return np.interp(distance, elsewhere.distance, elsewhere.elapsed, left=np.nan, right=np.nan)
    if quickest is None:
        return None
    passage = passages[quickest]
    return lap_times_at(given.path, circuit, passage, distance) - passage.start


def _sigma_elsewhere(distance: Array, options: LapOptions) -> Array:
    """Sigma (M,) s of the elapsed time of a reference lap from elsewhere; zero where it is one of these."""
    lap = options.reference_lap
    if lap is None or lap.sigma is None:
        return np.zeros(len(distance))
    return np.interp(distance, lap.distance, lap.sigma)


def _sectors(circuit: Circuit, corners: tuple[Corner, ...], valid: BoolArray) -> tuple[Line, ...]:
    return found_sectors(circuit.curve, corners, valid) if valid.any() else ()


def _laps(
    given: _Given,
    circuit: Circuit,
    passages: tuple[Passage, ...],
    why: tuple[tuple[Reason, ...], ...],
    lines: tuple[Line, ...],
    best: int | None,
) -> tuple[Lap, ...]:
    times = line_times(given.path, circuit, passages, lines, _beside(given.trajectory))
    sigma, sector_sigma, gap_sigma = lap_sigmas(given.path, circuit, lines, times, given.errors, best)
    raw, speeds = _raw_times(given, circuit, passages), _speeds(given, passages)
    laps = (
        _lap(given, passage, why[i], sigma[i], np.diff(times[i]), sector_sigma[i], gap_sigma[i], raw[i], speeds[i])
        for i, passage in enumerate(passages)
    )
    grid = _from_grid(given.path, passages)
    return tuple(replace(lap, is_from_grid=bool(slow)) for lap, slow in zip(laps, grid, strict=True))


def _from_grid(path: PlanPath, passages: tuple[Passage, ...]) -> BoolArray:
    """Mask (L,) of laps that start far slower than usual over the line."""
    speed = interpolated(np.array([passage.start for passage in passages]), path.t, path.speed)
    at_line = np.array([passage.starts_at_line for passage in passages], dtype=np.bool_)
    usual = float(np.median(speed[at_line])) if at_line.any() else 0.0
    # of the usual speed over the line, below which a lap has a standing start
    return np.asarray(at_line & (speed < 0.5 * usual))


def _speeds(given: _Given, passages: tuple[Passage, ...]) -> Array:
    """Top and least speed (L, 2) m/s of every lap, without the bias of the extreme of many rows and laps."""
    steady = smooth_speed(given.trajectory)
    rows = [given.path.rows_between(p.start, p.end) for p in passages]
    highest = [int(r[np.argmax(steady.speed[r])]) if r.size else -1 for r in rows]
    tops = np.array([steady.speed[k] if k >= 0 else np.nan for k in highest])
    sigma = np.array([steady.sigma[k] if k >= 0 else np.nan for k in highest])
    least = [float(steady.speed[r].min()) if r.size else np.nan for r in rows]
    return np.column_stack([shrunk_tops(tops, sigma), least])


def _lap(
    given: _Given,
    passage: Passage,
    why: tuple[Reason, ...],
    sigma: float,
    sector_time: Array,
    sector_sigma: Array,
    sector_gap_sigma: Array,
    raw_time: float,
    speeds: Array,
) -> Lap:
    path = given.path
    driven = interpolated(np.array([passage.start, passage.end]), path.t, path.driven)
    return Lap(
        number=passage.number,
        start=passage.start,
        end=passage.end,
        time=passage.end - passage.start if passage.is_timed else np.nan,
        sigma=float(sigma) if passage.is_timed else np.nan,
        reasons=why,
        sector_time=sector_time,
        sector_sigma=sector_sigma,
        sector_gap_sigma=sector_gap_sigma,
        raw_time=float(raw_time),
        distance=float(driven[1] - driven[0]),
        top_speed=float(speeds[0]),
        min_speed=float(speeds[1]),
    )


def _raw_times(given: _Given, circuit: Circuit, passages: tuple[Passage, ...]) -> Array:
    """Lap times (L,) s by straight lines between the raw fixes."""
    start = np.array([p.start if p.starts_at_line else np.nan for p in passages])
    end = np.array([p.end if p.ends_at_line else np.nan for p in passages])
    last = circuit.finish_line or circuit.start_line
    return np.asarray(raw_crossings(given.fixes, last, end) - raw_crossings(given.fixes, circuit.start_line, start))


def _lap_of_row(path: PlanPath, passages: tuple[Passage, ...]) -> IntArray:
    out = np.full(len(path.t), -1, dtype=np.int64)
    for passage in passages:
        out[path.rows_between(passage.start, passage.end)] = passage.number
    return out


def _lap_distance(circuit: Circuit) -> Array:
    return np.where(circuit.followed.is_on, circuit.curve.wrapped(circuit.followed.distance), np.nan)
