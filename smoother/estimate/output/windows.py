"""Sessions of hours, and those that samples cover a part of: solved in windows, with constants found from one part.

Hours are solved in windows that overlap, one after the other, in constant memory. All constants are those of the
busiest window, which is solved first with everything free, and are held in all windows, with their covariance. No
window reaches across a pause that time is cut out of: motion, biases and offset begin anew after it.

Fixes without samples must not determine the constants or their own scatter: along a motion prior latencies and lever
arm would be off by several of their sigmas.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.disc import roomy, settle
from smoother.estimate.factors.rows import Rows
from smoother.estimate.initial.guess import Start, fixes_between, stretch
from smoother.estimate.model.state import State
from smoother.estimate.output.estimated import Estimated, Known, Uncertainty, rows_after, uncertainty_of
from smoother.estimate.output.joint import WindowPositions, WindowsJoint, window_positions
from smoother.estimate.output.residuals import inertial_statistics, joined
from smoother.estimate.solvers.identify import Solution
from smoother.trajectory import ResidualStatistics

WINDOW = 1200.0  # s; about 0.4 GB while it is solved
OVERLAP = 120.0  # s to either side: twice the time constant of the GPS offset, which makes the seams
BLEND = 20.0  # s over which the states of one window give way to those of the next
FIXES = ("gps_position", "gps_velocity")
STATES = ("t", "R_ns", "position_n", "velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")


def is_long(start: Start) -> bool:
    """Whether a session is to be solved in windows: from half as long again as one of them."""
    return len(start.state.t) * start.state.interval > 1.5 * WINDOW


@dataclass(frozen=True, eq=False)
class _Piece:
    """The part of a solved window that counts: keyframes `first` to `last`, exclusive, of the session.

    state holds also those around them that are blended with the neighbours', from keyframe `begin` on. fixes: indices
    in the session of the rows of FIXES. inertial: residual statistics of the IMU factors.
    """

    first: int
    last: int
    begin: int
    state: State
    positions: WindowPositions
    rows: dict[str, Rows]
    fixes: dict[str, IntArray]
    inertial: dict[str, ResidualStatistics]


def solve_in_windows(
    start: Start, solve: Callable[[Start], Solution], known: Known, say: Callable[[float], None]
) -> Estimated:
    """Solve all keyframes of `start` window by window, with the constants and the noise that are known."""
    windows, n, pieces = _windows(start), len(start.state.t), []
    whole = Uncertainty(roomy((n, 9, 9)), roomy((n, 6)), roomy((n, 2)), roomy((n, 3, 3)))
    for i, window in enumerate(windows):
        solution = solve(stretch(start, window.begin, window.end - 1))
        core = uncertainty_of(solution, known.wheels_heading)
        for name, values in vars(whole).items():
            kept = slice(window.first - window.begin, window.last - window.begin)
            values[window.first : window.last] = getattr(core, name)[kept]
        pieces.append(_piece(solution, start, window))
        del solution, core
        settle(whole, start.binned)
        say((i + 1) / len(windows))
    kinds = {name for piece in pieces for name in piece.rows}
    return Estimated(
        _blended(pieces),
        known,
        whole,
        {name: _joined_rows(name, pieces, len(start.data.t)) for name in kinds},
        WindowsJoint([piece.positions for piece in pieces]),
        joined([piece.inertial for piece in pieces]),
    )


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


def _piece(solution: Solution, start: Start, window: _Window) -> _Piece:
    """Return what counts of a solved window."""
    state, begin = solution.state, window.begin
    core, margin = slice(window.first - begin, window.last - begin), _margin(state)
    outer = slice(max(0, core.start - margin), core.stop + margin)
    fixes, after = np.flatnonzero(fixes_between(start, begin, window.end - 1)), rows_after(solution)
    inertial, rows, own = inertial_statistics(after.pop("imu"), core), {}, {}
    for name, r in after.items():
        use = np.flatnonzero((r.interval >= core.start) & (r.interval < core.stop))
        empty = np.empty((len(use), 0, 0))
        rows[name] = Rows(name, r.interval[use] + begin, r.residual[use], r.sigma[use], empty, empty, {}, r.weight[use])
        if name in FIXES:
            own[name] = fixes[use]
    t = state.t  # until when it counts: where the next one begins to
    until = t[core.stop] if core.stop < len(t) else t[-1] + state.interval
    return _Piece(
        window.first,
        window.last,
        begin + outer.start,
        state.part(outer),
        window_positions(float(t[core.start]), float(until), solution.step.state, solution.chain),
        rows,
        own,
        inertial,
    )


def _margin(state: State) -> int:
    """Keyframes on each side of a seam that are blended."""
    return round(0.5 * BLEND / state.interval)


def _blended(pieces: list[_Piece]) -> State:
    """States of all keyframes; around each seam those of two windows are blended."""
    parts = {name: np.concatenate([_of_core(piece, name) for piece in pieces]) for name in STATES}
    margin = _margin(pieces[0].state)
    for before, after in pairwise(pieces):
        if after.begin == before.last:  # a pause
            continue
        first, last = max(after.begin, before.first), min(before.last + margin, after.last)
        share = (np.arange(first, last) - first + 0.5) / (last - first)
        one = {name: getattr(before.state, name)[first - before.begin : last - before.begin] for name in STATES}
        two = {name: getattr(after.state, name)[first - after.begin : last - after.begin] for name in STATES}
        for name in STATES[2:]:
            parts[name][first:last] = one[name] + share[:, None] * (two[name] - one[name])
        turn = so3.log(one["R_ns"].transpose(0, 2, 1) @ two["R_ns"])
        parts["R_ns"][first:last] = one["R_ns"] @ so3.exp(share[:, None] * turn)
    return State(constants=pieces[0].state.constants, geometry=pieces[0].state.geometry, **parts)


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
    return Rows(name, interval, residual, sigma, empty, empty, {}, weight)
