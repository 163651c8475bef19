"""Speeds that change their unit in mid-file, as where a setting was changed or files of two programs were joined.

Of the file as a whole they are no unit's multiple of those of the positions; of each part they are.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from smoother.arrays import Array, BoolArray

PART = 5.0  # s judged together
FEWEST_TOLD = 3  # of the speeds in a part
SHORTEST = 2  # parts; positions wander as fast for less
MOSTLY = 0.5  # of the parts in which the kart drives tell of the one unit
RIGHT = (0.85, 1.18)  # times the speed of the positions
STEADY = 1.25  # upper by lower quartile of what is a unit, and no noise of the positions
SAME_UNIT = 0.05  # share; the nearest two units are 5 % apart from one another, and 1 is a third from the next


def parts_in_other_units(
    t: Array, ratios: Array, told: BoolArray, units: Mapping[str, float]
) -> Iterator[tuple[str, slice, slice]]:
    """Yield the unit of each stretch of fixes at t (N,) s, the rows surely in it, and those that may be.

    ratios (N,) : of the speed sent to that of the positions, by which unit is which in `units`; told (N,) : where there
    is one. The unit changes anywhere from the last part that tells of one to the first that tells of the other.
    """
    part = np.floor((t - t[0]) / PART).astype(np.int64)
    found = [(k, _unit(ratios[told & (part == k)], units)) for k in np.unique(part[told]).tolist()]
    known = [(k, unit) for k, unit in found if unit is not None]
    known = [one for begin, end in _runs(known) if end - begin >= SHORTEST for one in known[begin:end]]
    driven = np.array([k for k, _ in found])
    for begin, end in _runs(known):
        first, last = np.searchsorted(driven, [known[begin][0], known[end - 1][0]])
        if not known[begin][1] or end - begin < MOSTLY * (last + 1 - first):
            continue
        sure, maybe = [0, t.size], [0, t.size]
        if begin > 0:
            maybe[0], sure[0] = np.searchsorted(part, [known[begin - 1][0], known[begin][0] + 1]).tolist()
        if end < len(known):
            sure[1], maybe[1] = np.searchsorted(part, [known[end - 1][0], known[end][0] + 1]).tolist()
        yield known[begin][1], slice(sure[0], max(sure)), slice(maybe[0], maybe[1])


def _unit(ratios: Array, units: Mapping[str, float]) -> str | None:
    """The unit of speeds by their ratios (K,) to those of the positions; "" where these are right, None if unknown."""
    if ratios.size < FEWEST_TOLD:
        return None
    low, ratio, high = np.percentile(ratios, (25.0, 50.0, 75.0))
    if high > STEADY * low:
        return None
    if RIGHT[0] < ratio < RIGHT[1]:
        return ""
    alike = {name: abs(ratio / size - 1.0) for name, size in units.items() if abs(ratio / size - 1.0) < SAME_UNIT}
    return min(alike, key=lambda name: alike[name], default=None)


def _runs(known: list[tuple[int, str]]) -> Iterator[tuple[int, int]]:
    """First and the one behind the last of each run of parts in one unit; those of slow motion are none of `known`."""
    begin = 0
    for end in range(1, len(known) + 1):
        if end == len(known) or known[end][1] != known[begin][1]:
            yield begin, end
            begin = end
