"""Where the kart stood still: detected from the inertial samples and the speed of the fixes, for any mounting.

Biases, mounting and noise are unknown, and an engine may idle, so nothing is compared with gravity or with zero. Two
judges have to agree:

1.  GNSS, where the session has it: no fix near the time is moving. It alone distinguishes a smooth straight from a
    stop; without a fix nearby there is no standstill. Velocity lags by up to 0.6 s, so later fixes count too.
2.  The inertial samples are steady: means over short blocks scatter no more than the scatter within the blocks
    explains (analysis of variance). Vibration averages out of the means, whatever its strength, so an idling engine
    does not hide a stop; setting off, turning or being lifted does move the means.

Under a roof fixes may wander at walking pace. Where both sensors are far quieter than they ever are on the move, the
engine is off and the kart is untouched, and slow fixes are ignored.

A kart that is turned where it stands, by hand after a spin, is steady to both: whatever has other rates at one time of
a run than at another, or than the gyroscope's bias where that is known, is no standstill from end to end.

Without any GNSS (a logger on the bench) the second judge is helped by a third: the scatter is near the quietest of the
session and below a bound, because there a smooth ride and a rest would look alike.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, IntArray, runs_of
from smoother.disc import pieces, release, thinned
from smoother.frames import Origin
from smoother.samples import GnssFixes, Session
from smoother.units import DEG


@dataclass(frozen=True)
class StandstillOptions:
    """Figures of the detector; times in s.

    max_speed m/s, of the mean velocity over `speed_window`. The means of `block` are compared over `blocks` of them.
    steadiness: ratio of variances; 1 is white noise, about 3 a sensor behind a low-pass filter, setting off gives 20
    and more. force_floor m/s^2, rate_floor rad/s: scatter of block means that is always steady (quantisation, drift).
    quiet_ratio of scatters and quiet_force, quiet_rate per axis: the third judge. latency: how long after a time fixes
    are asked. lifeless: scatter over that of driving, faster than `drives` m/s, of a kart with its engine off, for so
    many s; astray m/s: of fixes that may be wrong then. Karts on recordings are above 0.25 while they move, cars that
    creep above 0.15, and below 0.08 with engines off. turning rad/s: beside the usual rate of a run; off_bias rad/s:
    beside the bias of the session, which warms up by 3 deg/s.
    """

    max_speed: float = 0.3
    speed_window: float = 1.2
    block: float = 0.25
    blocks: int = 7
    steadiness: float = 6.0
    force_floor: float = 0.05
    rate_floor: float = 0.3 * DEG
    quiet_ratio: float = 3.0
    quiet_force: float = 0.3
    quiet_rate: float = 1.5 * DEG
    latency: float = 0.8
    shortest: float = 1.0
    lifeless: tuple[float, float] = (0.1, 5.0)
    drives: float = 5.0
    astray: float = 2.0
    turning: float = 1.5 * DEG
    off_bias: float = 5.0 * DEG


OPTIONS = StandstillOptions()
POSITION_WINDOW = 3.0  # s on each side, over which positions are averaged into a speed
FEWEST_BLOCKS = 4


def session_standstill(session: Session, gyro_bias: Array | None = None) -> BoolArray:
    """Mask (N,) of the inertial samples at which the kart stood still; (0,) without inertial samples.

    gyro_bias (3,) rad/s, in the axes of the samples, where it is known.
    """
    if session.imu is None:
        return np.zeros(0, dtype=np.bool_)
    speed, limit = fix_speeds(session.gnss, session.origin)
    imu = session.imu
    fixes_t = session.gnss.t
    return detect_standstill(imu.t, imu.specific_force_s, imu.angular_rate_s, fixes_t, speed, limit, gyro_bias)


def detect_standstill(
    t: Array,
    specific_force: Array,
    angular_rate: Array,
    fix_t: Array | None = None,
    fix_speed: Array | None = None,
    speed_limit: Array | float | None = None,
    gyro_bias: Array | None = None,
) -> BoolArray:
    """Mask (N,) of samples at rest.

    t (N,) s; specific_force (N, 3) m/s^2 and angular_rate (N, 3) rad/s in any axes, with any bias; fix_t (M,) s and
    fix_speed (M,) m/s, NaN unknown, None on the bench; speed_limit (M,) m/s of each fix, `max_speed` if not given;
    gyro_bias (3,) rad/s, where it is known.
    """
    if len(t) == 0:
        return np.zeros(0, dtype=np.bool_)
    block = np.floor((t - t[0]) / OPTIONS.block).astype(np.int64)
    edges = np.searchsorted(block, np.arange(int(block[-1]) + 2))
    force, rate = _Blocks.of(specific_force, edges), _Blocks.of(angular_rate, edges)
    still = _is_steady(force, OPTIONS.force_floor) & _is_steady(rate, OPTIONS.rate_floor)
    if fix_t is None or fix_speed is None:
        still &= _is_quiet(force, OPTIONS.quiet_force) & _is_quiet(rate, OPTIONS.quiet_rate)
    else:
        limit = np.broadcast_to(OPTIONS.max_speed if speed_limit is None else speed_limit, fix_t.shape)
        centre = t[0] + (np.arange(len(still)) + 0.5) * OPTIONS.block
        is_driven = np.interp(centre, *_known(fix_t, fix_speed)) > OPTIONS.drives
        lifeless = still & _is_lifeless(force, is_driven) & _is_lifeless(rate, is_driven)
        lifeless &= _is_stopped(centre, fix_t, fix_speed, np.full(fix_t.shape, OPTIONS.astray))
        still &= _is_stopped(centre, fix_t, fix_speed, np.asarray(limit))
        still |= _without_short_runs(lifeless, round(OPTIONS.lifeless[1] / OPTIONS.block))
    if fix_t is not None:
        still = _without_turned_runs(still, rate, gyro_bias)
    still = _without_short_runs(still, int(np.ceil(OPTIONS.shortest / OPTIONS.block - 1e-9)))
    return np.asarray(still[block])


def standstill_intervals(t: Array, is_standstill: BoolArray) -> Array:
    """First and last sample times (K, 2) s of each run of the mask (N,) over t (N,)."""
    first, after = runs_of(is_standstill)
    return np.stack([t[first], t[after - 1]], axis=1) if first.size else np.empty((0, 2))


# ---- the fixes ------------------------------------------------------------------------------------------------------


def fix_speeds(fixes: GnssFixes, origin: Origin) -> tuple[Array, Array]:
    """Horizontal speed of each fix (M,) m/s, NaN unknown, and the limit (M,) m/s below which it counts as stopped.

    Doppler velocity is averaged as a vector, so that its noise does not pass for speed; else the speed as sent; else
    positions are differenced, with a limit that their noise allows.
    """
    assert fixes.speed is not None
    limit = np.full(len(fixes), OPTIONS.max_speed)
    step = float(np.median(np.diff(fixes.t))) if len(fixes) > 1 else 1.0
    window = max(OPTIONS.speed_window, 3.0 * step)  # at least three fixes
    velocity = np.stack([_windowed_mean(fixes.t, fixes.velocity_n[:, i], window) for i in range(2)])
    speed = np.hypot(*velocity)
    speed = np.where(np.isfinite(speed), speed, _windowed_mean(fixes.t, fixes.speed, window))
    unknown = ~np.isfinite(speed)
    if np.any(unknown):
        from_positions, sigma = _speed_from_positions(fixes, origin)
        speed = np.where(unknown, from_positions, speed)
        # m/s; limit where only positions are known and these are noisy
        limit[unknown] = np.clip(3.0 * sigma, OPTIONS.max_speed, 1.0)[unknown]
    return speed, limit


def _windowed_mean(t: Array, values: Array, window: float) -> Array:
    """Mean of the known values within half a window of each t (M,); NaN where the value itself is unknown."""
    known = np.isfinite(values)
    total = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    count = np.concatenate([[0.0], np.cumsum(known)])
    low, high = np.searchsorted(t, t - 0.5 * window - 1e-6), np.searchsorted(t, t + 0.5 * window + 1e-6)
    mean = (total[high] - total[low]) / np.maximum(count[high] - count[low], 1.0)
    return np.where(known, mean, np.nan)


def _speed_from_positions(fixes: GnssFixes, origin: Origin) -> tuple[Array, Array]:
    """Speed (M,) from mean positions before and after each fix, and its sigma (M,) per axis from the white noise."""
    t, position = fixes.t, fixes.position_n(origin)[:, :2]
    padded = np.vstack([np.zeros((1, 3)), np.cumsum(np.column_stack([t - t[0], position - position[0]]), axis=0)])
    here = np.arange(len(t))
    low = np.searchsorted(t, t - POSITION_WINDOW)
    high = np.searchsorted(t, t + POSITION_WINDOW, side="right")
    before, after = here - low + 1, high - here  # both hold the fix itself: its noise cancels
    mean_before = (padded[here + 1] - padded[low]) / before[:, None]
    mean_after = (padded[high] - padded[here]) / after[:, None]
    change = mean_after - mean_before
    span = np.where(change[:, 0] > 0.5 * POSITION_WINDOW, change[:, 0], np.nan)  # too few fixes to tell
    noise = _white_noise(position)
    return np.hypot(change[:, 1], change[:, 2]) / span, noise * np.sqrt(1.0 / before + 1.0 / after) / span


def _white_noise(position: Array) -> float:
    """Standard deviation per axis of what is not a straight line through neighbouring fixes (M, 2)."""
    if len(position) < 3:
        return float("inf")
    bend = position[1:-1] - 0.5 * (position[:-2] + position[2:])
    return float(MAD_TO_SIGMA * np.median(np.abs(bend)) / np.sqrt(1.5))


def _is_stopped(centre: Array, fix_t: Array, speed: Array, limit: Array) -> BoolArray:
    """Whether all fixes from a step before `centre` (B,) until the latency after it are below their limit."""
    known = np.isfinite(speed)
    fix_t, is_moving = fix_t[known], speed[known] > limit[known]
    if fix_t.size == 0:
        return np.zeros(len(centre), dtype=np.bool_)
    step = float(np.median(np.diff(fix_t))) if fix_t.size > 1 else 1.0
    low = np.searchsorted(fix_t, centre - 0.3 - step)
    high = np.searchsorted(fix_t, centre + OPTIONS.latency + step)
    moving = np.concatenate([[0], np.cumsum(is_moving)])
    return np.asarray((high > low) & (moving[high] == moving[low]))


# ---- the inertial samples -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Per window of blocks, summed over axes: variance between block means, within blocks; mean count of a block.

    mean (B, 3), of the block means; between, within, count, occupied (B,). Blocks without samples (gaps) count for
    nothing.
    """

    mean: Array
    between: Array
    within: Array
    count: Array
    occupied: Array

    @staticmethod
    def of(values: Array, edges: IntArray) -> "_Blocks":
        """Sum up values (N, 3) of blocks that begin at the rows `edges` (B + 1,), the last one being N."""
        count, size = np.diff(edges).astype(np.float64), edges.size - 1
        filled = np.maximum(count, 1.0)
        has = (count > 0.0).astype(np.float64)
        k = _windowed(has)
        few = thinned(values, max(1, len(values) // (1 << 12)))  # samples, evenly taken, to know the usual value
        usual = np.median(few, axis=0)  # keeps the sums of squares precise
        mean, inside = np.zeros((3, size)), np.zeros((3, size))
        for part in pieces(len(values)):  # a day of samples is a gigabyte
            here, first, _ = _within(edges, part)
            for axis in range(3):
                mean[axis, here] += np.add.reduceat(values[part, axis] - usual[axis], first)
            release(values)
        mean /= filled
        for part in pieces(len(values)):
            here, first, length = _within(edges, part)
            for axis in range(3):
                rest = values[part, axis] - np.repeat(usual[axis] + mean[axis, here], length)
                inside[axis, here] += np.add.reduceat(rest * rest, first)
            release(values)
        between = sum(_windowed(m**2) - _windowed(m) ** 2 / np.maximum(k, 1.0) for m in mean)
        within = _windowed(np.sum(inside, axis=0))
        freedom = np.maximum(_windowed(np.maximum(count - 1.0, 0.0)), 1.0)
        between = np.maximum(between, 0.0) / np.maximum(k - 1.0, 1.0)
        around = usual + np.stack([_windowed(m) for m in mean], axis=1) / np.maximum(k, 1.0)[:, None]
        return _Blocks(around, between, within / freedom, _windowed(count) / np.maximum(k, 1.0), k)


def _within(edges: IntArray, part: slice) -> tuple[IntArray, IntArray, IntArray]:
    """Blocks (C,) that have samples in a part of them, the first such sample of each, in the part, and their number."""
    edges = np.clip(edges, part.start, part.stop) - part.start
    length = np.diff(edges)
    here = np.flatnonzero(length)
    return here, edges[here], length[here]


def _windowed(values: Array) -> Array:
    """Sum over the window of blocks around each, (B,)."""
    half = OPTIONS.blocks // 2
    return np.convolve(values, np.ones(OPTIONS.blocks))[half : half + len(values)]


def _is_steady(blocks: _Blocks, floor: float) -> BoolArray:
    explained = OPTIONS.steadiness * blocks.within / np.maximum(blocks.count, 1.0)
    enough = blocks.occupied >= FEWEST_BLOCKS
    return np.asarray(enough & (blocks.between <= np.maximum(explained, 3.0 * floor**2)))


def _is_quiet(blocks: _Blocks, bound: float) -> BoolArray:
    scatter = np.sqrt(blocks.within)
    known = scatter[blocks.occupied >= FEWEST_BLOCKS]
    if known.size == 0:
        return np.zeros(len(scatter), dtype=np.bool_)
    level = max(OPTIONS.quiet_ratio * float(np.percentile(known, 10.0)), 0.1 * bound)
    return np.asarray(scatter <= min(level, np.sqrt(3.0) * bound))


def _is_lifeless(blocks: _Blocks, is_driven: BoolArray) -> BoolArray:
    """Whether blocks (B,) scatter by far less than those in which the kart is driven; none do where it never is."""
    scatter, enough = np.sqrt(blocks.within), blocks.occupied >= FEWEST_BLOCKS
    driven = scatter[enough & is_driven]
    usual = float(np.median(driven)) if driven.size else 0.0
    return np.asarray(enough & (scatter < OPTIONS.lifeless[0] * usual))


def _known(t: Array, values: Array) -> tuple[Array, Array]:
    """Those of t (M,) and values (M,) that are known, or one that is zero."""
    known = np.isfinite(values)
    return (t[known], values[known]) if known.any() else (np.zeros(1), np.zeros(1))


def confirmed_at_rest(fixes: GnssFixes, origin: Origin, standing: BoolArray) -> BoolArray:
    """Mask (N,) of the fixes of stops in which no fix is moving; standing (N,): fixes at rest."""
    speed, limit = fix_speeds(fixes, origin)
    out = standing.copy()
    for first, after in zip(*runs_of(standing), strict=True):
        out[first:after] = not np.any(speed[first:after] > limit[first:after])
    return out


def _without_short_runs(mask: BoolArray, shortest: int) -> BoolArray:
    first, after = runs_of(mask)
    long = after - first >= shortest
    edges = np.zeros(len(mask) + 1, dtype=np.int64)
    edges[first[long]] += 1
    edges[after[long]] -= 1
    return np.asarray(np.cumsum(edges[:-1]) > 0)


def _without_turned_runs(still: BoolArray, rate: _Blocks, bias: Array | None) -> BoolArray:
    """The mask (B,) without the parts of runs in which the kart was turned; bias (3,) rad/s or unknown."""
    # of the mean rate of some blocks, by their scatter
    chance = 4.0 * np.sqrt(rate.within / np.maximum(rate.count * rate.occupied, 1.0))
    out = np.zeros_like(still)
    for first, after in zip(*runs_of(still), strict=True):
        mean, unsure = rate.mean[first:after], chance[first:after]
        at_rest = np.linalg.norm(mean - np.median(mean, axis=0), axis=1) <= OPTIONS.turning + unsure
        if bias is not None and np.any(
            np.linalg.norm(mean - bias, axis=1)[at_rest] > (OPTIONS.off_bias + unsure)[at_rest]
        ):
            continue
        begins, ends = runs_of(at_rest)
        if len(begins) == 1:
            out[first + begins[0] : first + ends[0]] = True
    return out
