"""The time base of a recording: even out the jitter of stamps, keep real gaps, tie receive times to the receiver's UTC.

A sensor samples evenly; the logger that stamps its samples is late now and then, and its own clock runs a little fast
or slow. The stamps are therefore a straight line in the sample number, with a slowly changing slope, plus jitter, plus
steps where samples were lost. What is none of that (a logger that samples when it finds the time) is left alone.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, IntArray, is_increasing, median
from smoother.disc import pieces, release, roomy
from smoother.samples import Problem, are_gaps
from smoother.units import MICROSECOND
from smoother.words import counted, span

FEWEST_SAMPLES = 32
PERIOD_WINDOW = 128  # samples over which a period is measured: longer than the bursts in which samples may arrive
LOSSY_SHARE = 0.15  # up to this share of long intervals they are lost samples, above it is how samples arrive
WHOLE = 0.2  # periods; how near to a whole number of periods lost samples leave an interval
STEP_WINDOWS = (1, 4, 16, 64)  # samples on either side of a step; wide ones see single lost samples through jitter
BURST_HASTE = 0.2  # periods; most intervals shorter by more: samples arrive in bursts, only wide windows see steps
STEP_SIGMAS = 5.0
SMALLEST_STEP = 0.5  # periods
STAYING_SHARE = 0.6  # of a step's height that the least lags before and after must differ by
UNSTEADY_GAP = 4.0  # periods
JITTER_WORTH_SAYING = 0.1  # periods; less is the rounding of stamps
ENVELOPE_WINDOW = 256  # samples; late samples are followed by early ones within it, lost ones never
EVEN_ENOUGH = 1e-3  # periods; stamps with less jitter are left as they are
BLOCK_JITTER = 0.05  # periods; blocks are long enough for their mean to be this good ...
SHORTEST_BLOCK = 32  # samples
LONGEST_BLOCK = 10.0  # s; ... but the drift of a clock that warms up is followed
LATE_BLOCKS = 9  # blocks of which up to half may be late without the smooth line following them
IRREGULAR_GROWTH = 5.0  # random walk grows 8 times from 1 to 64 samples, jitter of even samples does not grow
TYPICAL_SHARE = 99.0  # percent of the intervals that count for the size of the jitter; the others are gaps

PART = 1 << 21  # samples that are evened together, three hours at 200 Hz
MARGIN = 1 << 18  # samples on either side that are looked at as well: even at 2 kHz more than LATE_BLOCKS blocks

FEWEST_FIXES = 20
ENVELOPE_PERCENTILE = 10.0  # of the delays in a bin: the least delay is the steady one, single values may be odd
FIXES_PER_BIN = 20
FEWEST_PER_BIN = 5
SHORTEST_BIN = 30.0  # s
LARGEST_DRIFT = 2e-3  # of one clock against the other; more is not a clock
WORST_ENVELOPE = 0.02  # s; how far the least delays may lie off the line
ODD_UTC = 1.0  # s; a fix whose UTC is off by more (leap seconds not yet known) keeps its receive time
SHORTEST_GPS_GAP = 1.0  # s; single lost fixes at 10 or 25 Hz are not worth a word
GAP_TIMES = 1.5  # usual steps
STEPS_BESIDE = 15  # on either side of one, which tell the rate there
SLOWEST_RATE = 1.0  # s from one fix to the next


@dataclass(frozen=True, eq=False)
class TimeBase:
    """Evened stamps t (N,) s, strictly increasing; the sampling period and the rms of what was removed, s.

    is_steady : the samples follow a clock, so that an interval longer than a period means lost ones.
    """

    t: Array
    period: float
    jitter: float = 0.0
    is_steady: bool = True

    @property
    def gap_steps(self) -> float:
        """Usual steps beyond which a step holds lost samples: one at least where sampling is steady, else several."""
        return 1.0 + SMALLEST_STEP if self.is_steady else UNSTEADY_GAP

    @property
    def longest_step(self) -> float:
        """The same in seconds, where samples come as fast as usual."""
        return self.gap_steps * self.period


def regularize(t: Array) -> TimeBase:
    """Even out the stamps t (N,) s, strictly increasing, of samples taken at a steady rate.

    Lost samples stay gaps, a rate that changes slowly is followed.
    Stamps that are even already, too few, or of a sampling that is itself irregular come back unchanged (jitter 0).
    Many hours are done part by part.
    """
    return _regularize_part(t) if t.size <= PART else _regularize_parts(t)


def _regularize_parts(t: Array) -> TimeBase:
    """The same for many hours. At a seam the line may step by its own uncertainty, a twentieth of a period."""
    even, bases = roomy(t.shape), []
    for part in pieces(t.size, PART):
        begin = max(0, part.start - MARGIN)
        bases.append(_regularize_part(t[begin : part.stop + MARGIN]))
        even[part] = bases[-1].t[part.start - begin : part.stop - begin]
        release(t, even)
    period = float(np.median([base.period for base in bases]))
    if not (all(base.is_steady for base in bases) and is_increasing(even)):
        return TimeBase(t, period, is_steady=False)
    jitter = float(np.sqrt(np.mean([base.jitter**2 for base in bases])))
    even.flags.writeable = False
    return TimeBase(even if jitter > 0.0 else t, period, jitter)


def _regularize_part(t: Array) -> TimeBase:
    if t.size < FEWEST_SAMPLES:
        return TimeBase(t, float(np.median(np.diff(t))) if t.size > 1 else np.nan)
    period = _period(t)
    return _evened(t, t[0] + period * np.arange(t.size), period)


def _evened(t: Array, line: Array, period: float) -> TimeBase:
    """Stamps t (N,) s with their lag behind the line (N,) s smoothed between its steps."""
    lag = t - line
    steps = _steps(lag, period)
    if _is_irregular(lag - _step_heights(lag, steps), period):
        return TimeBase(t, period, is_steady=False)
    noise = _typical_rms(np.concatenate([_roughness(piece) for piece in np.split(lag, steps)]))
    if noise < EVEN_ENOUGH * period:
        return TimeBase(t, period)
    even = _even(t, lag, steps, _block_length(noise, period), period)
    if even is None:
        return TimeBase(t, period, is_steady=False)
    return TimeBase(even, period, float(np.sqrt(np.mean(np.square(even - t)))))


def _even(t: Array, lag: Array, steps: IntArray, block: int, period: float) -> Array | None:
    """Stamps with the lag smoothed between the steps; None if they are not increasing.

    A step whose sides would overlap is none (late samples) and is dropped.
    """
    while True:
        even = t - lag + np.concatenate([_smooth(piece, block, period) for piece in np.split(lag, steps)])
        folded = np.flatnonzero(np.diff(even) <= 0.0) + 1
        if folded.size == 0:
            return np.asarray(even)
        kept = np.setdiff1d(steps, folded)
        if kept.size == steps.size:
            return None
        steps = kept


def find_gaps(base: TimeBase) -> BoolArray:
    """Mask (N-1,) of the intervals that hold lost samples."""
    mask = np.empty(max(0, base.t.size - 1), dtype=np.bool_)
    for part in pieces(mask.size):
        mask[part] = are_gaps(np.diff(base.t[part.start : part.stop + 1]), base.period, base.gap_steps)
        release(base.t)
    return mask


def are_fix_gaps(steps: Array) -> BoolArray:
    """Mask (N,) of the steps from fix to fix, s, that are gaps beside those around them: receivers change their rate.

    Fixes that come slower than usual, and slower than SLOWEST_RATE, for a while are no other rate.
    """
    gaps = steps > SHORTEST_GPS_GAP
    long = np.flatnonzero(gaps)
    around = np.clip(long[:, None] + np.arange(-STEPS_BESIDE, STEPS_BESIDE + 1), 0, steps.size - 1)
    local = np.minimum(np.median(steps[around], axis=1), max(float(np.median(steps)), SLOWEST_RATE))
    gaps[long] = steps[long] > GAP_TIMES * local
    return gaps


def describe_time_base(base: TimeBase, prefix: str, file: str) -> list[Problem]:
    """What a person should know of the stamps of a file: gaps and jitter. The codes start with `prefix`."""
    problems = []
    last_before = np.flatnonzero(find_gaps(base))
    gaps = base.t[last_before + 1] - base.t[last_before]
    if gaps.size:
        gap_count = counted(gaps.size, "gap")
        text = f"{file}: {gap_count} in the samples, the longest {span(gaps.max())}, {span(gaps.sum())} in all"
        problems.append(Problem(f"{prefix}_gap", text, int(gaps.size)))
    if base.jitter > JITTER_WORTH_SAYING * base.period:
        text = f"{file}: times of samples scatter by {1e3 * base.jitter:.1f} ms rms; made even"
        problems.append(Problem(f"{prefix}_jitter", text))
    return problems


def _period(t: Array) -> float:
    """Sampling period: the median over windows, not misled by bursts, nor by lost samples where they are plain."""
    interval = np.diff(t)
    typical = median(interval)
    multiple = np.round(interval / typical)
    long = multiple > 1.0
    whole = np.abs(interval / typical - multiple) < WHOLE
    plain = np.mean(long) < LOSSY_SHARE and np.count_nonzero(long & whole) > 0.5 * np.count_nonzero(long)
    number = np.concatenate([[0.0], np.cumsum(multiple if plain else np.ones(interval.size))])
    window = min(PERIOD_WINDOW, t.size // 4)
    return median((t[window:] - t[:-window]) / (number[window:] - number[:-window]))


def _is_irregular(lag: Array, period: float) -> bool:
    """Whether intervals add up like a random walk: then it is the sampling that is uneven, not its stamps."""
    window = min(64, lag.size // 4)
    one, many = _typical_rms(np.diff(lag)), _typical_rms(lag[window:] - lag[:-window])
    return one > EVEN_ENOUGH * period and many > IRREGULAR_GROWTH * one


def _typical_rms(values: Array) -> float:
    size = np.abs(values)
    return float(np.sqrt(np.mean(np.square(size[size <= np.percentile(size, TYPICAL_SHARE)])))) if size.size else 0.0


def _roughness(lag: Array) -> Array:
    """Deviation of each lag from the mean of its neighbourhood, that is the jitter without the drift."""
    window = min(64, lag.size)
    mean = np.convolve(lag, np.ones(window) / window, mode="valid")
    start = window // 2
    return np.asarray(lag[start : start + mean.size] - mean)


def _steps(lag: Array, period: float) -> IntArray:
    """Sample numbers at which the lag (N,) steps up for good: where samples were lost. Ascending."""
    found: set[int] = set()
    for window in STEP_WINDOWS[-1:] if _are_bursts(np.diff(lag) + period, period) else STEP_WINDOWS:
        rest = lag - _step_heights(lag, np.array(sorted(found), dtype=np.int64))
        found.update(_steps_at_scale(rest, window, period))
    return np.array(sorted(found), dtype=np.int64)


def _are_bursts(intervals: Array, period: float) -> bool:
    return median(intervals) < (1.0 - BURST_HASTE) * period


def _step_heights(lag: Array, steps: IntArray) -> Array:
    """Sum (N,) of the steps so far, each the difference of the means on either side, up to its neighbours."""
    if steps.size == 0:
        return np.zeros(lag.size)
    total = np.concatenate([[0.0], np.cumsum(lag)])
    room = np.diff(steps, prepend=0, append=lag.size)
    before, after = np.minimum(room[:-1], STEP_WINDOWS[-1]), np.minimum(room[1:], STEP_WINDOWS[-1])
    rise = np.zeros(lag.size)
    rise[steps] = (total[steps + after] - total[steps]) / after - (total[steps] - total[steps - before]) / before
    return np.asarray(np.cumsum(rise))


def _steps_at_scale(lag: Array, window: int, period: float) -> list[int]:
    if lag.size < 2 * window:
        return []
    total = np.concatenate([[0.0], np.cumsum(lag)])
    height = (total[2 * window :] - 2.0 * total[window:-window] + total[: -2 * window]) / window
    if height.max() <= SMALLEST_STEP * period:
        return []
    noise = MAD_TO_SIGMA * median(np.abs(height - median(height)))
    high = height > max(SMALLEST_STEP * period, STEP_SIGMAS * noise)
    if window == 1:
        starts = np.flatnonzero(high)  # neighbours are steps of their own
        ends = starts + 1
    else:
        edge = np.diff(np.concatenate([[False], high, [False]]).astype(np.int8))
        starts, ends = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
    steps: list[int] = []
    for i, j in zip(starts, ends, strict=True):
        top = int(window + i + np.argmax(height[i:j]))  # the sample the step comes before
        near = np.arange(max(1, top - window // 2), min(lag.size, top + window // 2 + 1))
        step = int(near[np.argmax(lag[near] - lag[near - 1])])
        since = steps[-1] if steps else 0
        if step > since and _stays(lag, step, since, height[i:j].max(), period):
            steps.append(step)
    return steps


def _stays(lag: Array, step: int, since: int, height: float, period: float) -> bool:
    """Whether the lag never falls back to what it was: late samples are followed by early ones.

    What it was before the step at `since` says nothing: after a hole any late sample is far above that.
    """
    jump = lag[step] - lag[step - 1]
    before = np.min(lag[max(since, step - ENVELOPE_WINDOW) : step])
    after = np.min(lag[step : step + ENVELOPE_WINDOW])
    return bool(after - before > max(SMALLEST_STEP * period, STAYING_SHARE * height) and jump > 0.5 * height)


def _block_length(noise: float, period: float) -> int:
    wanted = int(np.ceil(3.0 * (noise / (BLOCK_JITTER * period)) ** 2))  # 3: jitter of neighbours is alike
    return int(np.clip(wanted, SHORTEST_BLOCK, max(SHORTEST_BLOCK, LONGEST_BLOCK / period)))


def _smooth(lag: Array, block: int, period: float) -> Array:
    """Lag (N,) of a piece without steps, smoothed: a line through the means of blocks, extended at the ends.

    Blocks that stick out by more than a period are late samples.
    """
    count = lag.size // block
    if count < 2:
        return np.full(lag.size, np.mean(lag)) if lag.size < SHORTEST_BLOCK else _line(lag)
    bounds = np.linspace(0, lag.size, count + 1).round().astype(np.int64)
    means = _trimmed_means(lag, bounds)
    centres = 0.5 * (bounds[:-1] + bounds[1:] - 1)
    late = np.abs(means - _running_median(means, LATE_BLOCKS)) > period
    means, centres = means[~late], centres[~late]
    number = np.arange(lag.size)
    smooth = np.interp(number, centres, means)
    for ends, a, b in ((number < centres[0], 0, 1), (number > centres[-1], -1, -2)):
        slope = (means[b] - means[a]) / (centres[b] - centres[a])
        smooth[ends] = means[a] + slope * (number[ends] - centres[a])
    return np.asarray(smooth)


def _trimmed_means(values: Array, bounds: IntArray) -> Array:
    """Mean without the tenth at either end of each stretch bounds[k] .. bounds[k + 1], (len(bounds) - 1,)."""
    sizes, means = np.diff(bounds), np.empty(bounds.size - 1)
    for size in np.unique(sizes).tolist():  # two sizes at most: stretches of one size are sorted together
        alike = np.flatnonzero(sizes == size)
        stretches = np.sort(values[bounds[alike, None] + np.arange(size)], axis=1)
        means[alike] = np.mean(stretches[:, size // 10 : size - size // 10], axis=1)
    return means


def _running_median(values: Array, size: int) -> Array:
    """Median of `size` (odd) neighbours of each of the values (N,), the end ones repeated."""
    padded = np.pad(values, size // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, size), axis=1))


def _line(lag: Array) -> Array:
    number = np.arange(lag.size)
    slope, offset = np.polyfit(number, lag, 1)
    return np.asarray(offset + slope * number)


def true_fix_times(t_receive: Array, unix_s: Array) -> tuple[Array, bool]:
    """Replace the receive times of fixes by the receiver's own times, on the clock of the receive times.

    t_receive (N,) s, strictly increasing; unix_s (N,) the UTC in each fix, NaN where unknown. The least delays follow
    a line (two clocks and a constant latency); every fix is put on it, raised to the typical delay, so that the latency
    of the stamps as they were written stays the same. Where UTC was set, it goes on as it began. Returns times (N,) s
    and whether they are others than were written: nothing is changed without UTC, with too few fixes, or where the two
    do not behave like two clocks.
    """
    known = np.isfinite(unix_s)
    if np.count_nonzero(known) < FEWEST_FIXES:
        return t_receive, False
    utc = unix_s - unix_s[known][0]
    delay = t_receive - utc
    odd = ~(np.abs(delay - median(delay[known])) < ODD_UTC)
    if np.mean(odd) > 0.5 or (line := _envelope(utc[~odd], delay[~odd])) is None:
        return t_receive, False
    t, (slope, offset) = np.array(t_receive), line
    t[~odd] = utc[~odd] + offset + slope * utc[~odd]
    t[~odd] += np.median(t_receive[~odd] - t[~odd])
    if np.any(odd):
        t[odd] = _moved_alike(t_receive[odd], t_receive[~odd], t[~odd])
        t = _not_after_the_next(t)
    return (t, True) if np.all(np.diff(t) > 0.0) else (t_receive, False)


def _moved_alike(t: Array, before: Array, after: Array) -> Array:
    """Move times t as the times `before` next to them were moved to `after`; the order is kept."""
    return np.asarray(t + np.interp(t, before, after - before))


def _not_after_the_next(t: Array) -> Array:
    """Times (N,) s with each moved back to a microsecond before the next, where it was not before it."""
    tick = MICROSECOND * np.arange(t.size)
    return np.asarray(np.minimum.accumulate((t - tick)[::-1])[::-1] + tick)


def _envelope(utc: Array, delay: Array) -> tuple[float, float] | None:
    """Slope and offset (s) of a line through the least delays over utc (N,) s; None if they follow none."""
    span = float(utc[-1] - utc[0])
    bins = int(max(2, min(utc.size // FIXES_PER_BIN, span // SHORTEST_BIN)))
    member = np.clip(((utc - utc[0]) / max(span, 1e-9) * bins).astype(np.int64), 0, bins - 1)
    order = np.argsort(member, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(member[order])) + 1)
    filled = [part for part in parts if part.size >= FEWEST_PER_BIN]
    if len(filled) < 2:
        return None
    centre = np.array([np.mean(utc[part]) for part in filled])
    slope, offset, off = 0.0, 0.0, np.empty(0)
    for _ in range(3):  # the least delay of a bin is only level once the drift within the bin is out
        rest = delay - slope * utc
        low = np.array([np.percentile(rest[part], ENVELOPE_PERCENTILE) for part in filled])
        more, offset = _theil_sen(centre, low)
        off = np.abs(low - offset - more * centre)
        slope += more
    if abs(slope) > LARGEST_DRIFT or np.median(off) > WORST_ENVELOPE:
        return None
    return slope, offset


def _theil_sen(x: Array, y: Array) -> tuple[float, float]:
    """Slope and offset of a robust line through y (N,) over x (N,), increasing: the median slope of all pairs.

    Source: Sen 1968. (scipy.stats has it, and takes longer to import than a session takes to read.)
    """
    i, j = np.triu_indices(x.size, 1)
    slope = float(np.median((y[j] - y[i]) / (x[j] - x[i])))
    return slope, float(np.median(y) - slope * np.median(x))
