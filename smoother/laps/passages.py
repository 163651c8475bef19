"""From crossings to laps: the time span of each lap, and whether it counts."""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, runs_of
from smoother.fit.plan_path import PlanPath
from smoother.laps.circuit import Circuit
from smoother.laps.path import in_gaps
from smoother.laps.results import FixPath, Reason
from smoother.laps.timing import Crossings, crossings, gate_crossings
from smoother.trajectory import Trajectory

STANDING = 1.0  # m/s
STOPPED_FOR = 2.0  # s at rest; such a lap does not count
OFF_FOR = 1.0  # s away from the line
PIT_FOR = 15.0  # s away from the line: longer than an excursion
PIT_SPEED = 0.5  # of the usual speed: slower and off the track is in the pits or the gravel
RUN_OFF = 8.0  # m beside the mean line, beyond the GPS error
BRIDGED = 3.0  # m, sigma of the line up to which the inertial sensor has bridged a gap
SHORTER = 0.93  # of the length of the lap: a shorter driven distance is a short cut
INWARDS = (
    1.5  # m farther inside than usual all the way round, which is no short cut: a lap of 40 m is 9 m shorter by it
)


@dataclass(frozen=True, eq=False)
class Passage:
    """One lap as a stretch of time. number from 0; start, end s; is_timed: both ends are crossings, else the
    recording's; starts_at_line likewise of the start. base m: unwrapped track distance of its start line."""

    number: int
    start: float
    end: float
    starts_at_line: bool
    ends_at_line: bool
    base: float

    @property
    def is_timed(self) -> bool:
        """Whether both ends are crossings."""
        return self.starts_at_line and self.ends_at_line


def find_passages(path: PlanPath, circuit: Circuit, blind: BoolArray, beside: float) -> tuple[Passage, ...]:
    """Return all laps in time order, with the parts before the first crossing and after the last.

    blind (N,): rows in gaps of the fixes. beside m: tolerance beyond the ends of a line.
    """
    if circuit.finish_line is not None:
        return _runs(path, circuit, beside)
    found = crossings(path, circuit.followed, circuit.curve.length, circuit.start_line, beside, blind)
    return _laps(path, found, circuit.curve.length)


def _laps(path: PlanPath, found: Crossings, length: float) -> tuple[Passage, ...]:
    if len(found) == 0:
        return ()
    ends = np.concatenate([[path.t[0]], found.t, [path.t[-1]]])
    laps = []
    for i in range(len(ends) - 1):
        base = float(found.lap[0] - 1 if i == 0 else found.lap[i - 1]) * length
        laps.append(Passage(i, float(ends[i]), float(ends[i + 1]), i > 0, i < len(ends) - 2, base))
    return tuple(lap for lap in laps if lap.end > lap.start)


def _runs(path: PlanPath, circuit: Circuit, beside: float) -> tuple[Passage, ...]:
    """Each passage from the start line to the finish, the last start before a finish counting."""
    assert circuit.finish_line is not None
    starts = gate_crossings(path, circuit.start_line, beside)
    finishes = gate_crossings(path, circuit.finish_line, beside)
    runs: list[Passage] = []
    for i, start in enumerate(starts):
        until = starts[i + 1] if i + 1 < len(starts) else np.inf
        within = finishes[(finishes > start) & (finishes < until)]
        if within.size:
            runs.append(Passage(len(runs) + 1, float(start), float(within[0]), True, True, 0.0))
    return tuple(runs)


def reasons(
    passage: Passage, path: PlanPath, circuit: Circuit, trajectory: Trajectory, fixes: FixPath, usual_speed: float
) -> tuple[Reason, ...]:
    """Return the reasons why a lap does not count, none if it does."""
    found: list[Reason] = []
    if not passage.ends_at_line:
        found.append("in-lap")
    if not passage.starts_at_line:
        found.append("out-lap")
    rows = path.rows_between(passage.start, passage.end)
    if len(rows) < 2:
        return tuple(found)
    in_gap = in_gaps(path.t[rows], fixes)
    if _is_blind(trajectory, rows, in_gap):
        found.append("gap")
    on = circuit.followed.is_on[rows]
    standing = path.speed[rows] < STANDING
    away = ~on & ~in_gap
    if passage.is_timed or not passage.ends_at_line:
        found += _where_to(path, circuit, rows, on, away, standing, usual_speed)
    driven = float(path.driven[rows[-1]] - path.driven[rows[0]])
    if (
        passage.is_timed
        and circuit.finish_line is None
        and driven < _least_driven(circuit.curve.length)
        and "gap" not in found
    ):
        found.append("short-cut")
    return tuple(dict.fromkeys(found))


def _least_driven(length: float) -> float:
    """Least driven distance of a lap of `length` m."""
    return min(SHORTER * length, length - 2.0 * np.pi * INWARDS)


def _where_to(
    path: PlanPath,
    circuit: Circuit,
    rows: np.ndarray,
    on: BoolArray,
    away: BoolArray,
    standing: BoolArray,
    usual_speed: float,
) -> list[Reason]:
    """Stops and excursions."""
    found: list[Reason] = []
    t = path.t[rows]
    for first, last in _lasting(away, t, OFF_FOR):
        slow = float(np.mean(path.speed[rows[first : last + 1]])) < PIT_SPEED * usual_speed
        found.append("pit" if slow or t[last] - t[first] > PIT_FOR else "off-track")
    for first, last in _lasting(standing, t, STOPPED_FOR):
        found.append("stopped" if on[first : last + 1].mean() > 0.5 else "pit")
    lateral = np.abs(circuit.followed.lateral[rows])
    wide = on & (lateral > RUN_OFF + 2.0 * circuit.followed.spread)
    if _lasting(wide, t, OFF_FOR):
        found.append("off-track")
    return found


def _lasting(mask: BoolArray, t: Array, shortest: float) -> list[tuple[int, int]]:
    """First and last index of each run of true that lasts at least `shortest` s."""
    first, behind = runs_of(mask)
    pairs = zip(first.tolist(), (behind - 1).tolist(), strict=True)
    return [(a, b) for a, b in pairs if t[b] - t[a] >= shortest]


def _is_blind(trajectory: Trajectory, rows: np.ndarray, in_gap: BoolArray) -> bool:
    """Whether the position of the kart in a gap of the fixes is unknown."""
    if not in_gap.any():
        return False
    if trajectory.report.mode != "full" or trajectory.sigmas is None:
        return True
    return not bool(np.nanmax(trajectory.sigmas.track[rows[in_gap]]) < BRIDGED)
