"""What the lap analysis returns, as values: laps, sectors, reference line, traces over track distance, corners.

Conventions of everything here: SI and radians; plan coordinates are north and west in n; track distance is the metres
along the reference line from the start/finish line; lateral offsets are positive to the left of the direction of
travel; L is the number of laps in `LapAnalysis.laps`, S the number of sectors, M the length of the distance grid, C
the number of corners, N the rows of the trajectory. NaN is an unknown value. Every sigma is one standard
deviation. Nothing is computed here.
"""

from dataclasses import dataclass
from typing import Literal

from smoother.arrays import Array, BoolArray, IntArray, freeze, require_increasing
from smoother.samples import Problem

Reason = Literal["out-lap", "in-lap", "pit", "gap", "off-track", "stopped", "short-cut"]
"""Why a lap does not count: begins or ends without a crossing; stood or crawled off the track or left it for long; a
hole in the fixes; far from the line that the other laps took; stood still on the track; much shorter than a lap."""

SigmaSource = Literal["joint", "stored", "model", "none"]
"""Where the sigmas of times and offsets come from: the estimator's joint covariance; how that grew with the time
between two positions, as stored with the results; a model of the GPS offset; nowhere (no sigmas at all)."""


@dataclass(frozen=True, eq=False)
class Line:
    """A timing line in plan. left_n, right_n (2,) m north and west in n, of its ends as the driver sees them.

    `source`: "given" (option or session.toml's file), "library" (a track that comes with the program), "found".
    distance: track distance of the line, m, NaN without a reference line.
    """

    name: str
    left_n: Array
    right_n: Array
    source: str = "found"
    distance: float = float("nan")

    def __post_init__(self) -> None:
        freeze(self, left_n=(2,), right_n=(2,))


@dataclass(frozen=True, eq=False)
class Lap:
    """One lap, whether it counts or not. Times on the session clock.

    number: 0 for the part before the first crossing, 1 for the first whole lap, counting on. start, end s: of
    the lap's crossings, or of the recording where one is missing. time s and sigma s: NaN unless both ends are
    crossings. sector_time, sector_sigma (S,) s, NaN for a sector not crossed at both ends; sector_gap_sigma (S,) s, of
    the difference from the same sector of the best lap, in which the common GPS error cancels, 0 for that lap.
    reasons: empty if the lap counts. raw_time s: between straight-line crossings of the raw fixes, NaN where they have
    a gap. distance m, driven. is_from_grid: it starts far slower than the others, as from a standing start.
    """

    number: int
    start: float
    end: float
    time: float
    sigma: float
    reasons: tuple[Reason, ...]
    sector_time: Array
    sector_sigma: Array
    sector_gap_sigma: Array
    raw_time: float
    distance: float
    top_speed: float
    min_speed: float
    is_from_grid: bool = False

    @property
    def is_comparable(self) -> bool:
        """Whether the lap is compared with others; laps from a standing start are not."""
        return self.is_valid and not self.is_from_grid

    @property
    def is_valid(self) -> bool:
        """Whether the lap counts for best times and statistics."""
        return not self.reasons

    @property
    def is_timed(self) -> bool:
        """Whether both ends are crossings of the start/finish line (for a point-to-point run: of start and finish)."""
        return self.time == self.time


@dataclass(frozen=True, eq=False)
class ReferenceLine:
    """The mean of the laps over track distance, closed unless `is_closed` is false.

    distance (P,) m, increasing from 0, every metre or so; position_n (P, 2) m; tangent_n (P, 2) unit vectors; curvature
    (P,) 1/m, positive to the left; length m, of the whole lap (a closed line ends one step before it).
    up (P,) m, the mean height.
    """

    distance: Array
    position_n: Array
    tangent_n: Array
    curvature: Array
    up: Array
    length: float
    is_closed: bool = True

    def __post_init__(self) -> None:
        n = len(self.distance)
        freeze(self, distance=(n,), position_n=(n, 2), tangent_n=(n, 2), curvature=(n,), up=(n,))
        require_increasing(self.distance, "ReferenceLine.distance")


@dataclass(frozen=True, eq=False)
class Traces:
    """Every lap on one grid of track distance. distance (M,) m from the line, about every 2 m; the rest (L, M), NaN
    where the lap has no value (before an out-lap begins, in a pit, away from the track).

    t s, session clock, when the lap was at that distance; speed m/s; delta s against the reference lap, positive is
    slower, with delta_sigma; lateral m left of the reference line, with lateral_sigma, of the difference between the
    lap and the line, including the GPS error of both; place_sigma m, contribution of a lap to the sigma of the distance
    between two laps (the root of the sum of squares of both); is_off_line: where |lateral| is above two of its sigma
    (draw the rest grey). longitudinal, lateral_acceleration m/s^2 along and left of the path, level. zone: -1 braking,
    +1 driving, 0 neither. sideslip rad, heading minus course, both clockwise (positive: the kart slides to its left),
    with sideslip_sigma; all NaN where it is not observable (no inertial sensor, or too uncertain an attitude).
    """

    distance: Array
    t: Array
    speed: Array
    delta: Array
    delta_sigma: Array
    lateral: Array
    lateral_sigma: Array
    place_sigma: Array
    is_off_line: BoolArray
    longitudinal: Array
    lateral_acceleration: Array
    zone: IntArray
    sideslip: Array
    sideslip_sigma: Array


@dataclass(frozen=True, eq=False)
class Corner:
    """One corner and the values of every lap in it. Distances m on the reference line; per lap (L,), NaN where unknown.

    number from 1; start, apex, end: where curvature begins, is greatest, and ends; turns_left; radius m at the apex.
    segment (2,) m: the stretch whose time is compared, from the braking zone before to the acceleration after; the
    segments of all corners tile the lap. entry_speed at `start`, min_speed, exit_speed at `end` m/s, each with its
    sigma, which contains the position error. braking_point m, NaN where the lap did not brake,
    braking_sigma m. time s spent in the segment; time_lost s against the reference lap, time_lost_sigma; is_real:
    |time_lost| above real_from sigmas, the same in all corners, at a false discovery rate of 5 %.
    slide rad, mean sideslip between start and end, positive: the kart points into the corner, with slide_sigma.
    usual_lost s, the median of the other laps that count, with usual_lost_sigma, which contains the error of the
    reference lap; usual_is_real as above, among all corners.
    """

    number: int
    start: float
    apex: float
    end: float
    turns_left: bool
    radius: float
    segment: tuple[float, float]
    entry_speed: Array
    entry_speed_sigma: Array
    min_speed: Array
    min_speed_sigma: Array
    exit_speed: Array
    exit_speed_sigma: Array
    braking_point: Array
    braking_sigma: Array
    time: Array
    time_lost: Array
    time_lost_sigma: Array
    is_real: BoolArray
    real_from: float
    slide: Array
    slide_sigma: Array
    usual_lost: float
    usual_lost_sigma: float
    usual_is_real: bool


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of the laps that count; NaN where there are too few.

    best_lap: index in `laps` of the best, None without; best, best_sigma s. theoretical s: sum of the best sectors with
    the expected gain from picking the least of noisy times removed, theoretical_sigma; theoretical_raw s without
    that correction. rolling s: fastest whole lap from any point of the track to the same point, corrected likewise,
    rolling_sigma; rolling_raw s as measured, rolling_from m, the track distance of its start. mean, median s;
    spread s, standard deviation of the laps with the timing noise removed where that is known and not assumed, 0
    within it;
    within_tenth: number within 0.1 s of the best, including the best; counted: number of laps that count.
    """

    best_lap: int | None
    best: float
    best_sigma: float
    theoretical: float
    theoretical_sigma: float
    theoretical_raw: float
    rolling: float
    rolling_sigma: float
    rolling_raw: float
    rolling_from: float
    mean: float
    median: float
    spread: float
    within_tenth: int
    counted: int


@dataclass(frozen=True)
class OfficialTime:
    """An official (transponder) time s and the lap it belongs to: index in `laps`, None if none fits; difference s:
    time of the lap minus the official one, with the sigma of the former."""

    number: int
    time: float
    lap: int | None
    difference: float
    sigma: float


@dataclass(frozen=True, eq=False)
class LapAnalysis:
    """The lap analysis of a session.

    laps in time order, also those that do not count. start_line, and sector_lines where a sector ends and the next
    begins (S - 1 of them); finish_line of a point-to-point track. reference, traces, statistics: None without a loop or
    without laps. reference_lap: index in `laps` of the lap that deltas refer to, None when it comes from another
    session (then `reference_name` names it) or there is none. lap_of_row (N,) number of the lap of each row
    of the trajectory, -1 where none; lap_distance (N,) m, track distance since the line, NaN away from the track.
    track: its name, empty if unknown. problems of the analysis. no_sideslip: the reason if there is none.
    """

    lap_of_row: IntArray
    lap_distance: Array
    laps: tuple[Lap, ...] = ()
    start_line: Line | None = None
    sector_lines: tuple[Line, ...] = ()
    finish_line: Line | None = None
    reference: ReferenceLine | None = None
    traces: Traces | None = None
    corners: tuple[Corner, ...] = ()
    statistics: Statistics | None = None
    reference_lap: int | None = None
    reference_name: str = ""
    official: tuple[OfficialTime, ...] = ()
    sigma_source: SigmaSource = "none"
    track: str = ""
    problems: tuple[Problem, ...] = ()
    no_sideslip: str = ""

    @property
    def sectors(self) -> int:
        """Number of sectors of a lap, at least one with a line."""
        return len(self.sector_lines) + 1 if self.start_line is not None else 0


@dataclass(frozen=True, eq=False)
class FixPath:
    """The raw fixes as the analysis needs them: t (F,) s, position_n (F, 2) m north and west."""

    t: Array
    position_n: Array

    def __post_init__(self) -> None:
        freeze(self, t=(None,), position_n=(len(self.t), 2))
        require_increasing(self.t, "FixPath.t")


@dataclass(frozen=True, eq=False)
class GivenLines:
    """Given lines, in the session's n: start/finish, sectors in driving order, a separate finish.

    Ends are (2, 2) m: two points, in either order (the direction of travel decides which is left). name of the track.
    """

    start: Array
    sectors: tuple[Array, ...] = ()
    finish: Array | None = None
    name: str = ""
    source: str = "given"


@dataclass(frozen=True, eq=False)
class ReferenceLap:
    """A reference lap of another session: elapsed s since its line at track distance m (K,) on the same line; sigma
    (K,) s of elapsed, None where unknown; name of the lap."""

    distance: Array
    elapsed: Array
    name: str
    sigma: Array | None = None
