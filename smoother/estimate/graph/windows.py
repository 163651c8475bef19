"""Sessions of hours: solved in windows that overlap, one after the other, at a cost in memory that does not grow.

Latencies, lever arm and all other constants are those of the busiest window, which is solved first with everything
free. They are known there far better than a lap needs, and held in all windows, so that no seam can show in them; how
unsure they are is in the covariance of every window as it is in that of the whole. What remains at a seam is what the
fixes beyond the overlap would have told of the slow GPS offset, minutes away.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.estimate.graph import rows as rw
from smoother.estimate.graph.batch import Batch, Data, Noise, Solved
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.inertial import LinearInertial
from smoother.estimate.graph.solve import NEAR, Say, Solution, solve_whole, with_heading
from smoother.estimate.graph.start import GraphOptions, Start, busiest_part, fixes_between, stretch
from smoother.estimate.graph.state import KEYFRAME_SIZE, ChainState
from smoother.frames import wrap_angle
from smoother.samples import Session

WINDOW = 1200.0  # s; about 0.4 GB while it is solved
OVERLAP = 120.0  # s to either side: twice what the GPS offset remembers, which makes the seams
CONVERGED = 0.01  # rad; the constants do not move, so that this is soon reached
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
    covariance: Array
    constants_cross: Array
    rows: dict[str, rw.Rows]
    fixes: dict[str, IntArray]  # indices in the session of the rows of FIXES


def solve_in_windows(session: Session, start: Start, noise: Noise, options: GraphOptions, say: Say) -> Solution:
    """Solve all keyframes of `start` window by window, with constants and noise of the busiest one."""
    main = solve_whole(session, busiest_part(start, WINDOW), noise, options, lambda fraction: say(0.3 * fraction))
    held, constants = main.solved.solution.constants_covariance, main.solved.state.constants
    main = replace(main, solved=replace(main.solved, solution=replace(main.solved.solution, factor=None)))
    start = replace(start, state=replace(start.state, constants=constants))
    edges = _edges(len(start.state.t), start.state.interval)
    pieces = []
    for i, (first, last) in enumerate(pairwise(edges)):
        pieces.append(_solve_piece(session, start, first, last, main.noise, held, options))
        say(0.3 + 0.7 * (i + 1) / (len(edges) - 1))
    return replace(main, solved=_joined(pieces, start, held))


def _edges(n_keyframes: int, interval: float) -> list[int]:
    n_windows = max(1, round(n_keyframes * interval / WINDOW))
    return [int(edge) for edge in np.linspace(0, n_keyframes, n_windows + 1).round()]


def _solve_piece(
    session: Session, start: Start, first: int, last: int, noise: Noise, held: Array, options: GraphOptions
) -> _Piece:
    overlap = round(OVERLAP / start.state.interval)
    begin, end = max(0, first - overlap), min(last + overlap, len(start.state.t)) - 1
    part = stretch(start, begin, end)
    batch = Batch(part.data, part.binned, start.priors)
    graph = batch.graph(part.state, noise)
    state = batch.approach(graph, part.state, noise, NEAR, options.approaches)
    batch = Batch(_with_level_heading(session, part, state, noise), part.binned, start.priors)
    state = batch.approach(graph, state, noise, CONVERGED, 2 * options.approaches)
    solved = batch.step(graph, state, noise, held=held)
    fixes = np.flatnonzero(fixes_between(start, begin, end))
    return _piece(solved, first, last, begin, fixes)


def _with_level_heading(session: Session, part: Start, state: ChainState, noise: Noise) -> Data:
    """Add heading factors whose mean says nothing: they hold the turns together, but not to a held heading offset.

    The compass is fitted to each window anew, and its offset with it.
    """
    data, _, _ = with_heading(session, part, state)
    if not data.extra:
        return data
    (make,) = data.extra
    mean = float(np.median(make(state, noise).residual))

    def rows(state: ChainState, noise: Noise) -> rw.Rows:
        found = make(state, noise)
        return replace(found, residual=wrap_angle(found.residual - mean), constants=np.zeros_like(found.constants))

    return replace(data, extra=(rows,))


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
    covariance, cross = solution.covariance[core].copy(), solution.constants_cross[core].copy()
    return _Piece(first, last, begin + outer.start, state, covariance, cross, rows, own)


def _margin(state: ChainState) -> int:
    """Keyframes on each side of a seam that are blended."""
    return round(0.5 * BLEND / state.interval)


def _figures(rows: rw.Rows, use: IntArray, begin: int) -> rw.Rows:
    """Return residuals, sigmas and weights of the rows `use`, without their Jacobians."""
    empty = np.empty((len(use), 0, 0))
    return rw.Rows(
        rows.name,
        rows.interval[use] + begin,
        rows.residual[use],
        np.broadcast_to(rows.sigma, rows.residual.shape)[use],
        empty,
        empty,
        empty,
        rows.weight[use],
    )


def _joined(pieces: list[_Piece], start: Start, held: Array) -> Solved:
    K, m = len(start.state.t), len(held)
    state = _blended(pieces, start.state)
    solution = ChainSolution(
        x=np.zeros((K, KEYFRAME_SIZE)),
        constants=np.zeros(m),
        covariance=np.concatenate([piece.covariance for piece in pieces]),
        cross=np.empty((0, KEYFRAME_SIZE, KEYFRAME_SIZE)),
        constants_covariance=held,
        constants_cross=np.concatenate([piece.constants_cross for piece in pieces]),
        log_determinant=float("nan"),
    )
    kinds = {name for piece in pieces for name in piece.rows}
    rows = {name: _joined_rows(name, pieces, len(start.data.t)) for name in kinds}
    nothing = np.empty((0, 15, 15))
    return Solved(state, solution, LinearInertial(nothing, nothing, nothing, np.empty((0, 15))), rows)


def _blended(pieces: list[_Piece], whole: ChainState) -> ChainState:
    """States of all keyframes; around each seam those of one window give way to the next one's bit by bit."""
    parts = {name: np.concatenate([_of_core(piece, name) for piece in pieces]) for name in STATES}
    margin = _margin(whole)
    for before, after in pairwise(pieces):
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


def _joined_rows(name: str, pieces: list[_Piece], n_fixes: int) -> rw.Rows:
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
    return rw.Rows(name, interval, residual, sigma, empty, empty, empty, weight)
