"""Is this a circuit? A loop is recognised by coming back to the same place in the same direction, again and again.

For places along the path, the distances driven until the path is there again, in the same direction, are collected.
The lap is the shortest distance after which most of the path repeats: a parallel straight nearby repeats only a part,
a crossing in the middle of an eight is met in another direction, two laps are longer than one.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import pieces
from smoother.fit.plan_path import PlanPath

SAME_PLACE = 10.0  # m: how wide a track is driven, plus what the GPS wanders between two laps
SPACING = 4.0  # m between the places that are compared
MOST_PLACES = 1500  # that are looked for again; more say nothing new
PAIRS = 1 << 24  # of places that are compared at once at most: some 100 MB
# m: neighbours on the path are near each other anyhow, and a kart that spins comes back after 10 to 25. Rounds in a car
# park have 40, and of a skid pad of 15 m radius 94; twice the lap is what is found where one is below
SHORTEST = 30.0
BIN = 10.0  # m, of repeat distances; as wide as SAME_PLACE blurs them
SLACK = 0.02  # relative spread of lap lengths: lines differ from lap to lap
REPEATING = 0.3  # least share of the path that must repeat for a loop to be one
COMPARABLE = 0.5  # of the distance after which most repeats: a shorter one that repeats as well is the lap
SURE_ROUNDS = 1.5  # repeated laps: a loop, whatever else the kart or its transporter drove
SURE_LENGTH = 300.0  # m of such a lap; what wanders about in the paddock has shorter ones


@dataclass(frozen=True)
class Loop:
    """A lap as first found: length m, and start and end s of its quickest passage, to the same place again."""

    length: float
    start: float
    end: float


def find_loop(path: PlanPath, shortest: float, blind: BoolArray | None = None) -> Loop | None:
    """Return the loop that the path repeats, None where it does not come back.

    shortest m: no lap is shorter. blind (N,): rows in holes of the fixes, where the path is a guess.
    """
    blind = np.zeros(len(path.t), dtype=np.bool_) if blind is None else blind
    row = _places(path)
    row = row[~blind[row]]
    if len(row) < 8:
        return None
    driven = path.driven[row]
    again = _repeats(path, row, shortest)
    if len(again[0]) == 0:
        return None
    length = _lap_length(driven, *again)
    return None if length is None else _quickest(path, row, length, blind, *again)


def _places(path: PlanPath) -> IntArray:
    """Rows every :data:`SPACING` m of driven distance."""
    wanted = np.arange(0.0, path.driven[-1], SPACING)
    return np.asarray(np.searchsorted(path.driven, wanted), dtype=np.int64)


def _repeats(path: PlanPath, row: IntArray, shortest: float) -> tuple[IntArray, IntArray]:
    """Pairs (i, j) of places, i before j, at the same place in the same direction, at least `shortest` m apart."""
    position, driven = path.position_n[row], path.driven[row]
    direction = path.velocity_n[row] / np.maximum(path.speed[row], 1e-6)[:, None]
    chosen = np.unique(np.linspace(0, len(row) - 1, min(MOST_PLACES, len(row))).astype(np.int64))
    some = max(1, PAIRS // len(row))  # of the places at once: in a day each is passed two thousand times
    found = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))]
    for part in pieces(len(chosen), some):
        i, j = _within(position, chosen[part], SAME_PLACE)
        separation = driven[j] - driven[i]
        good = (separation > shortest) & (separation < 30_000.0)  # m: the longest lap
        i, j = i[good], j[good]
        good = np.sum(direction[i] * direction[j], axis=1) > 0.7  # least cosine between the two directions of travel
        found.append((i[good], j[good]))
    return np.concatenate([i for i, _ in found]), np.concatenate([j for _, j in found])


def _within(points: Array, around: IntArray, distance: float) -> tuple[IntArray, IntArray]:
    """Pairs (i, j): of each of the `points` (N, 2) named in `around` (K,) those within `distance` m of it."""
    order = np.argsort(points[:, 0], kind="stable")
    north, west = points[order, 0], points[order, 1]
    first = np.searchsorted(north, points[around, 0] - distance)
    count = np.searchsorted(north, points[around, 0] + distance) - first
    which = np.repeat(np.arange(len(around)), count)
    near = np.arange(len(which)) + np.repeat(first - (np.cumsum(count) - count), count)  # first, first + 1, ... of each
    away = (north[near] - points[around, 0][which]) ** 2 + (west[near] - points[around, 1][which]) ** 2
    found = np.flatnonzero(away <= distance**2)
    return around[which[found]], order[near[found]]


def _lap_length(driven: Array, i: IntArray, j: IntArray) -> float | None:
    """The shortest distance (m) after which the path repeats nearly as well as it does at all."""
    places, column = np.unique(i, return_inverse=True)
    separation = driven[j] - driven[i]
    bins = int(separation.max() / BIN) + 2
    hit = np.zeros((len(places), bins), dtype=np.bool_)
    hit[column, (separation / BIN).astype(np.int64)] = True
    step = driven[-1] / max(1, min(MOST_PLACES, len(driven)) - 1)
    covered, share, possible = np.zeros(bins), np.zeros(bins), _seen_at_both_ends(driven, bins)
    for b in np.flatnonzero(hit.any(axis=0)):
        width = max(1, round(SLACK * b))
        covered[b] = np.count_nonzero(hit[:, max(0, b - width) : b + width + 1].any(axis=1)) * step
        share[b] = covered[b] / max(possible[b], covered[b], 40.0)  # m of path that must repeat
    length = BIN * (np.arange(bins) + 0.5)
    is_sure = (length >= SURE_LENGTH) & (covered >= SURE_ROUNDS * length)
    usable = np.where((share >= REPEATING) | is_sure, covered, 0.0)
    best = int(np.argmax(usable))
    if usable[best] == 0.0:
        return None
    first = int(np.flatnonzero((usable >= COMPARABLE * usable[best]) & (share >= COMPARABLE * share[best]))[0])
    near = _around(separation, first)
    return float(np.median(separation[near]))


def _seen_at_both_ends(driven: Array, bins: int) -> Array:
    """Length (bins,) m of the path with fixes at both ends of each distance, by autocorrelation; driven (M,) m: places
    with fixes."""
    seen = np.zeros(int((driven[-1] - driven[0]) / BIN) + 1)
    seen[((driven - driven[0]) / BIN).astype(np.int64)] = 1.0
    transform = np.fft.rfft(seen, 1 << (2 * len(seen) - 1).bit_length())  # nothing meets its own end
    both = np.round(np.fft.irfft(np.abs(transform) ** 2)[: len(seen)])
    out = np.zeros(bins)
    n = min(bins, len(both))
    out[:n] = BIN * both[:n]
    return out


def _around(separation: Array, b: int) -> BoolArray:
    centre = (b + 0.5) * BIN
    return np.asarray(np.abs(separation - centre) < max(1.5 * BIN, 2.0 * SLACK * centre))


def _quickest(path: PlanPath, row: IntArray, length: float, blind: BoolArray, i: IntArray, j: IntArray) -> Loop | None:
    """The quickest of the passages of about one lap with the fewest holes: without stops, pits and excursions."""
    separation = path.driven[row[j]] - path.driven[row[i]]
    one = np.abs(separation - length) < max(1.5 * BIN, 1.5 * SLACK * length)
    if not one.any():
        return None
    i, j, separation = i[one], j[one], separation[one]
    pace = (path.t[row[j]] - path.t[row[i]]) / separation  # per metre, as the ends of the pairs are metres apart
    guessed = np.concatenate([[0.0], np.cumsum(blind[1:] * np.diff(path.t))])
    hole = guessed[row[j]] - guessed[row[i]]
    k = int(np.argmin(np.where(hole <= hole.min() + 1e-9, pace, np.inf)))
    start = row[i[k]]
    end = _nearest_return(path, int(start), int(row[j[k]]))
    return Loop(float(path.driven[end] - path.driven[start]), float(path.t[start]), float(path.t[end]))


def _nearest_return(path: PlanPath, start: int, near: int) -> int:
    """The row around `near` that is closest to `start`."""
    low, high = np.searchsorted(path.driven, path.driven[near] + np.array([-1.5, 1.5]) * SAME_PLACE)
    rows = np.arange(low, min(high + 1, len(path.t)))
    away = path.position_n[rows] - path.position_n[start]
    return int(rows[np.argmin(np.sum(away**2, axis=1))])
