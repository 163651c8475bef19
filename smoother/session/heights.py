"""Heights that jump: a receiver, or a program behind it, that changes what it measures from, or writes single nonsense.

Latitude and longitude of those fixes are as good as ever, so it is the height alone that is mended, or left out where
all of them are of another unit.
"""

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.session.rows import RowFilter
from smoother.words import counted

JUMP_HEIGHT = 50.0  # m from one fix to the next; recorded ones have 30 at most, of a receiver that is walked with
FASTEST_CLIMB = 50.0  # m/s
STEADY_ROWS = 10  # a height that stays as long is measured from elsewhere; a shorter one is nonsense
END_ROWS = 5  # whose median is the height on either side of a step
SLOPE_SPAN, SLOPE_WAY = 5.0, 30.0  # s and m over which the way rises or falls, beyond what heights scatter
STEEPEST = 0.3  # of the way, that it rises or falls by for half of it; hill climbs have 0.1, centimetres for metres 1
FEWEST_SLOPES = 50


def without_impossible_heights(rows: RowFilter, t: Array, way: Array, alt_m: Array) -> Array:
    """Heights (N,) m at t (N,) s in order, NaN where unknown; all of them where no road is as steep as they are.

    way (N,) m: gone until each. Says in `rows` what was done.
    """
    known = np.flatnonzero(np.isfinite(alt_m))
    at = t[known]
    later = np.searchsorted(at, at + SLOPE_SPAN)
    first = np.flatnonzero(later < known.size)
    first, last = known[first], known[later[first]]
    gone = way[last] - way[first]
    far = (gone > SLOPE_WAY) & (t[last] - t[first] < 2.0 * SLOPE_SPAN)
    slope = np.abs(alt_m[last] - alt_m[first])[far] / gone[far]
    if slope.size < FEWEST_SLOPES or (usual := float(np.median(slope))) < STEEPEST:
        return alt_m
    text = f"heights rise and fall by {100.0 * usual:.0f} % of the way, which no track does; in metres? None was used"
    rows.say("height_impossible", text, known.size)
    return np.full_like(alt_m, np.nan)


def without_height_jumps(rows: RowFilter, t: Array, alt_m: Array) -> Array:
    """Heights (N,) m at t (N,) s in order, NaN where unknown: single ones that jump left out, later levels joined.

    The longest stretch without a jump is taken to be right. Says in `rows` what was done.
    """
    known = np.flatnonzero(np.isfinite(alt_m))
    at, height = t[known], alt_m[known]
    cuts = np.flatnonzero(np.abs(np.diff(height)) > JUMP_HEIGHT + FASTEST_CLIMB * np.diff(at)) + 1
    if cuts.size == 0:
        return alt_m
    mended, steps = _mended(at, height, np.concatenate([[0], cuts, [known.size]]))
    lost = int(np.count_nonzero(~np.isfinite(mended)))
    if lost:
        rows.say("height_jump", f"{counted(lost, 'height')} far from those around; that value ignored", lost)
    if steps:
        sizes = ", ".join(f"{step:+.0f}" for step in steps[:3]) + (", .." if len(steps) > 3 else "")
        text = f"{counted(len(steps), 'step')} in its heights ({sizes} m), which no kart climbs; taken out"
        rows.say("height_step", f"{text}, and heights from there on are as sure as the step is", len(steps))
    out = alt_m.copy()
    out[known] = mended
    return out


def _mended(t: Array, height: Array, bounds: IntArray) -> tuple[Array, list[float]]:
    """Heights (K,), NaN where they are nonsense, and the steps (m) that were taken out.

    bounds : where the pieces without a jump begin, and K.
    """
    out, steps = height.copy(), []
    sizes = np.diff(bounds)
    main = int(np.argmax(sizes))
    for direction, pieces in ((1, range(main + 1, sizes.size)), (-1, range(main - 1, -1, -1))):
        near = main  # the last piece that counts, whose end faces the next one
        for piece in pieces:
            a, b = (near, piece) if direction > 0 else (piece, near)
            last, first = int(bounds[a + 1]) - 1, int(bounds[b])  # on either side of the step
            within = slice(int(bounds[piece]), int(bounds[piece + 1]))
            near_end, far_end = (last, first) if direction > 0 else (first, last)
            if abs(out[far_end] - out[near_end]) > JUMP_HEIGHT + FASTEST_CLIMB * (t[first] - t[last]):
                if sizes[piece] < STEADY_ROWS:
                    out[within] = np.nan
                    continue
                before = out[max(int(bounds[a]), last + 1 - END_ROWS) : last + 1]
                after = out[first : min(int(bounds[b + 1]), first + END_ROWS)]
                step = float(np.median(after) - np.median(before))
                out[within] -= direction * step
                steps.append(step)
            near = piece
    return out, steps
