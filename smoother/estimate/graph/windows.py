"""Sessions of hours, and those that samples cover a part of: solved with constants that are found from a part.

Hours are solved in windows that overlap, one after the other, at a cost in memory that does not grow. Latencies, lever
arm and all other constants are those of the busiest window, which is solved first with everything free. They are known
there far better than a lap needs, and held in all windows, so that no seam can show in them; how unsure they are is in
the covariance of every window as it is in that of the whole. What remains at a seam is what the fixes beyond the
overlap would have told of the slow GPS offset, minutes away. No window reaches across a pause that time is cut out of:
motion, biases and offset begin anew after it.

Fixes without samples must not tell the constants, nor how they scatter (:func:`where_sampled`): along a way that is
made up, delays and lever arm would seem to be known, several of their sigmas from where they are.
"""

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import roomy, settle
from smoother.estimate.graph.batch import Batch, Solved
from smoother.estimate.graph.coarse import NEAR, near_solution
from smoother.estimate.graph.estimated import Estimated, are_made_up, common_attitude
from smoother.estimate.graph.heading import Heading
from smoother.estimate.graph.incremental import solve_as_stream
from smoother.estimate.graph.inertial import InertialGraph
from smoother.estimate.graph.inputs import Data, Noise, Priors
from smoother.estimate.graph.joint import WindowFactor, WindowsJoint, window_factor
from smoother.estimate.graph.leftovers import joined, left_of_inertial
from smoother.estimate.graph.options import GraphOptions
from smoother.estimate.graph.parts import busiest_part, fixes_between, longest_sampled, stretch, where_sampled
from smoother.estimate.graph.rows import Rows, heading_rows
from smoother.estimate.graph.sampled import HOLE
from smoother.estimate.graph.solve import ROLLING, Say, fits_wheels, solve_whole, with_heading
from smoother.estimate.graph.start import Start
from smoother.estimate.graph.state import ChainState
from smoother.estimate.graph.uncertainty import Uncertainty, nose_variance, uncertainty_of
from smoother.samples import Problem, Session
from smoother.trajectory import ResidualStatistics

WINDOW = 1200.0  # s; about 0.4 GB while it is solved
OVERLAP = 120.0  # s to either side: twice what the GPS offset remembers, which makes the seams
BLEND = 20.0  # s over which the states of one window give way to those of the next
FIXES = ("gps_position", "gps_velocity")
STATES = ("t", "R_ns", "position_n", "velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")


def is_long(start: Start) -> bool:
    """Whether a session is to be solved in windows: from half as long again as one of them."""
    return len(start.state.t) * start.state.interval > 1.5 * WINDOW


@dataclass(frozen=True, eq=False)
class _Piece:
    """The part of a solved window that counts: keyframes `first` to `last`, exclusive, of the session.

    state holds also those around them that are blended with the neighbours', from keyframe `begin` on.
    """

    first: int
    last: int
    begin: int
    state: ChainState
    factor: WindowFactor
    rows: dict[str, Rows]
    fixes: dict[str, IntArray]  # indices in the session of the rows of FIXES
    inertial: dict[str, ResidualStatistics]  # what is left of the factors, by name


@dataclass(frozen=True, eq=False)
class WindowsSolution:
    """A session solved in windows, and what it was solved with."""

    found: Estimated
    noise: Noise
    priors: Priors
    problems: tuple[Problem, ...]
    heading: Heading | None = None


def solve_in_windows(session: Session, start: Start, noise: Noise, options: GraphOptions, say: Say) -> WindowsSolution:
    """Solve all keyframes of `start` window by window, with constants and noise of the busiest, sampled one."""
    if options.solver == "gtsam":
        from smoother.estimate.bridge import solve_part  # which imports this module

        busiest = longest_sampled(busiest_part(start, WINDOW))
        main = solve_part(session, busiest, noise, options, lambda fraction: say(0.3 * fraction))
    else:
        busiest = where_sampled(busiest_part(start, WINDOW))
        in_one = replace(options, solver="batch")  # a stream takes the constants as they are
        main = solve_whole(session, busiest, noise, in_one, lambda fraction: say(0.3 * fraction))
    held, constants = main.solved.solution.constants_covariance, main.solved.state.constants
    priors, problems, heading = main.priors, main.problems, main.heading
    noise = replace(main.noise, inertial=main.noise.inertial.everywhere())
    common = _common_attitude(main.solved, start, are_made_up(busiest.binned))
    del main, busiest  # the windows need its room
    start = replace(start, state=replace(start.state, constants=constants))
    windows = _windows(start)
    n, pieces = len(start.state.t), []
    whole = Uncertainty(roomy((n, 9, 9)), roomy((n, 6)), roomy((n, 2)), roomy((n, 3, 3)))
    for i, window in enumerate(windows):
        piece, known = _solve_piece(session, start, window, noise, held, options)
        pieces.append(piece)
        for name, values in vars(whole).items():
            values[window.first : window.last] = getattr(known, name)
        settle(whole, start.binned)
        say(0.3 + 0.7 * (i + 1) / len(windows))
    return WindowsSolution(_joined(pieces, start, held, whole, common), noise, priors, problems, heading)


def _common_attitude(main: Solved, start: Start, made_up: BoolArray | None) -> Array:
    """Covariance (3, 3) rad^2 in s of the mean error of attitude; zero where `main` is not all that has samples.

    Over hours other errors are common than in one window.
    """
    t, whole = main.state.t, start.state.t
    first, last = max(start.spans[0, 0], whole[0]), min(start.spans[-1, 1], whole[-1])
    if t[0] - first > HOLE or last - t[-1] > HOLE:
        return np.zeros((3, 3))
    return common_attitude(main, made_up)


@dataclass(frozen=True)
class _Window:
    """Keyframes `begin` to `end`, exclusive, that are solved together; those from `first` to `last` count."""

    first: int
    last: int
    begin: int
    end: int


def _windows(start: Start) -> list[_Window]:
    """Windows of all keyframes, evenly from pause to pause, none across one."""
    t, interval = start.state.t, start.state.interval
    overlap, out = round(OVERLAP / interval), []
    for part in start.pauses.stretches(t):
        count = max(1, round((part.stop - part.start) * interval / WINDOW))
        edges = [int(edge) for edge in np.linspace(part.start, part.stop, count + 1).round()]
        for first, last in pairwise(edges):
            out.append(_Window(first, last, max(part.start, first - overlap), min(last + overlap, part.stop)))
    return out


def _solve_piece(
    session: Session, start: Start, window: _Window, noise: Noise, held: Array, options: GraphOptions
) -> tuple[_Piece, Uncertainty]:
    """Return what counts of a window, and what is known of the errors of its keyframes that count."""
    begin, end = window.begin, window.end - 1
    part = stretch(start, begin, end)
    if options.solver == "gtsam":
        from smoother.estimate.bridge import solve_window  # likewise

        return _cut_out(session, start, window, noise, solve_window(session, part, noise, held, options))
    state = near_solution(part, replace(noise, slip=None), options.approaches)
    data = _with_level_heading(session, part, state)
    batch = Batch(data, part.binned, start.priors)
    return _cut_out(session, start, window, noise, _solve_window(batch, data, part, state, noise, held, options))


def _cut_out(
    session: Session, start: Start, window: _Window, noise: Noise, solved: Solved
) -> tuple[_Piece, Uncertainty]:
    """Return what counts of a solved window, and what is known of its errors."""
    first, last, begin, end = window.first, window.last, window.begin, window.end - 1
    fixes = np.flatnonzero(fixes_between(start, begin, end))
    core, known = slice(first - begin, last - begin), uncertainty_of(solved, nose_variance(session, noise))
    known = Uncertainty(*(values[core] for values in vars(known).values()))
    return _piece(solved, first, last, begin, fixes), known


def _solve_window(
    batch: Batch, data: Data, part: Start, state: ChainState, noise: Noise, held: Array, options: GraphOptions
) -> Solved:
    """Solve a window, with wheels where what comes without them agrees: the box may have moved since the main one.

    state: of the batch, near the solution without wheels. Where that agrees already, all its keyframes go on with them.
    """
    no_slip, graph = replace(noise, slip=None), batch.graph(state, noise)
    if options.solver == "isam2":
        constants = part.state.constants
        solved = solve_as_stream(batch, data, part.binned, part.priors, no_slip, part.state, constants, held)
        state = solved.state
        del solved
    else:
        if (rolling := _on_wheels(batch, graph, state, noise, held)) is not None:
            return rolling
        state = batch.approach(graph, state, no_slip, NEAR, 2 * options.approaches)
    rolling = _on_wheels(batch, graph, state, noise, held)
    return batch.step(graph, state, no_slip, held=held) if rolling is None else rolling


def _on_wheels(batch: Batch, graph: InertialGraph, state: ChainState, noise: Noise, held: Array) -> Solved | None:
    """Return the solution with wheels, from a state without; None where the two do not agree."""
    if not batch.is_of_wheels(state, noise):
        return None
    solved = batch.step(graph, batch.approach(graph, state, noise, *ROLLING), noise, held=held)
    return solved if fits_wheels(solved) else None


def _with_level_heading(session: Session, part: Start, state: ChainState) -> Data:
    """Add heading factors whose mean says nothing: they hold the turns together, but not to a held heading offset.

    The compass is fitted to each window anew, and its offset with it.
    """
    data, _, _ = with_heading(session, part, state)
    if data.heading is None:
        return data
    known = replace(data.heading, has_offset=False)
    mean = float(np.median(heading_rows(state, known).residual))
    return replace(data, heading=replace(known, field_yaw=known.field_yaw + mean))


def _piece(solved: Solved, first: int, last: int, begin: int, fixes: IntArray) -> _Piece:
    """Cut out keyframes first to last of the session from a window that starts at `begin` and read `fixes`."""
    s, solution, core = solved.state, solved.solution, slice(first - begin, last - begin)
    margin = _margin(s)
    outer = slice(max(0, core.start - margin), core.stop + margin)
    state = ChainState(constants=s.constants, **{name: getattr(s, name)[outer].copy() for name in STATES})
    rows, own = {}, {}
    for name, r in solved.rows.items():
        use = np.flatnonzero((r.interval >= core.start) & (r.interval < core.stop))
        rows[name] = _figures(r, use, begin)
        if name in FIXES:
            own[name] = fixes[use]
    assert solution.factor is not None
    until = s.t[core.stop] if core.stop < len(s.t) else s.t[-1] + s.interval  # where the next one begins to count
    factor = window_factor(s.t[core.start], until, solved.linearised_at, solution.factor)
    return _Piece(first, last, begin + outer.start, state, factor, rows, own, left_of_inertial(solved, core))


def _margin(state: ChainState) -> int:
    """Keyframes on each side of a seam that are blended."""
    return round(0.5 * BLEND / state.interval)


def _figures(rows: Rows, use: IntArray, begin: int) -> Rows:
    """Return residuals, sigmas and weights of the rows `use`, without their Jacobians."""
    empty = np.empty((len(use), 0, 0))
    return Rows(
        rows.name,
        rows.interval[use] + begin,
        rows.residual[use],
        np.broadcast_to(rows.sigma, rows.residual.shape)[use],
        empty,
        empty,
        empty,
        rows.weight[use],
    )


def _joined(pieces: list[_Piece], start: Start, held: Array, uncertainty: Uncertainty, common: Array) -> Estimated:
    kinds = {name for piece in pieces for name in piece.rows}
    rows = {name: _joined_rows(name, pieces, len(start.data.t)) for name in kinds}
    joint = partial(WindowsJoint, [piece.factor for piece in pieces])
    inertial = joined([piece.inertial for piece in pieces])
    return Estimated(_blended(pieces, start.state), held, uncertainty, rows, joint, common, inertial)


def _blended(pieces: list[_Piece], whole: ChainState) -> ChainState:
    """States of all keyframes; around each seam those of one window give way to the next one's bit by bit."""
    parts = {name: np.concatenate([_of_core(piece, name) for piece in pieces]) for name in STATES}
    margin = _margin(whole)
    for before, after in pairwise(pieces):
        if after.begin == before.last:  # a pause: neither knows of the other's keyframes
            continue
        first, last = max(after.begin, before.first), min(before.last + margin, after.last)
        share = (np.arange(first, last) - first + 0.5) / (last - first)
        one = {name: getattr(before.state, name)[first - before.begin : last - before.begin] for name in STATES}
        two = {name: getattr(after.state, name)[first - after.begin : last - after.begin] for name in STATES}
        for name in STATES[2:]:
            parts[name][first:last] = one[name] + share[:, None] * (two[name] - one[name])
        turn = so3.log(one["R_ns"].transpose(0, 2, 1) @ two["R_ns"])
        parts["R_ns"][first:last] = one["R_ns"] @ so3.exp(share[:, None] * turn)
    return ChainState(constants=pieces[0].state.constants, **parts)


def _of_core(piece: _Piece, name: str) -> Array:
    values: Array = getattr(piece.state, name)
    return values[piece.first - piece.begin : piece.last - piece.begin]


def _joined_rows(name: str, pieces: list[_Piece], n_fixes: int) -> Rows:
    """Rows of all windows; those of fixes in the order of the session's, one for each."""
    parts = [piece.rows[name] for piece in pieces if name in piece.rows]
    empty = np.empty((0, 0, 0))
    fields = ("interval", "residual", "sigma", "weight")
    interval, residual, sigma, weight = (np.concatenate([getattr(p, f) for p in parts]) for f in fields)
    if name in FIXES:
        at = np.concatenate([piece.fixes[name] for piece in pieces])
        all_residual, all_sigma = np.zeros((n_fixes, residual.shape[1])), np.full((n_fixes, residual.shape[1]), np.inf)
        all_interval, all_weight = np.zeros(n_fixes, dtype=np.int64), np.zeros(n_fixes)
        all_interval[at], all_residual[at], all_sigma[at], all_weight[at] = interval, residual, sigma, weight
        interval, residual, sigma, weight = all_interval, all_residual, all_sigma, all_weight
    return Rows(name, interval, residual, sigma, empty, empty, empty, weight)
