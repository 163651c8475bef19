"""What a comparison of the streams shows that no clock explains.

What comes and goes is no clock: a buffer that fills, a radio that is busy, samples that are lost and counted on. One
latency for all of the session is then wrong by as much, and no residual shows it, since speeds and positions agree with
one another. Where none of the axes has to do with the path, one of the two files holds something else there: samples
counted at another rate than they were taken, blocks in the wrong order, a sensor that fell off. Fixes that stand while
the samples drive on are those of an antenna that came off, or of a receiver that holds a position.
"""

from collections.abc import Iterator

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, IntArray, are_near, median, runs_of
from smoother.estimate.averages import in_gap
from smoother.estimate.path_motion import PathMotion
from smoother.estimate.preprocess.clock_fit import common_change, fit_lags
from smoother.estimate.preprocess.streams import FEWEST, FEWEST_STRETCHES, LIVELY, SLOWEST, Measured, Streams
from smoother.samples import Problem
from smoother.trajectory import DELAY_CHANGES, MOTION_UNLIKE

UNLIKE, SHOWS, SURELY = 0.5, 0.85, 5.0  # correlation; of an axis, usually; scatters below the usual one
LEAST_SCATTER = 0.3  # of Fisher's z
STANDS, BESIDE_STOP = 1.0, 0.3  # m/s, below which fixes stand; s to either side, in which they begin and cease to
STOP = 20.0  # s of a stop that is judged
DRIVES = 0.7  # correlation of left force and yaw rate, which go together by the speed, of a sensor that drives


def stream_problems(streams: Streams, first: Array, last: Array) -> tuple[Problem, ...]:
    """Return what stretches from first (B,) to last (B,) s after the first fix contradict, on one clock."""
    out = []
    if np.any(unlike := are_unlike(streams)):
        rows = np.flatnonzero(unlike)
        text = (
            f"between {first[rows[0]]:.0f} and {last[rows[-1]]:.0f} s after the first fix samples and fixes are not of "
            f"one motion, in {len(rows)} of {len(first)} stretches of driving: the result is not to be trusted there. "
            "Did the rate of the samples change, or the box come off? Smooth the rest by itself"
        )
        out.append(Problem(MOTION_UNLIKE, text))
    change = common_change(streams, fit_lags(streams))
    if change is not None:
        early, late = int(np.argmin(change)), int(np.argmax(change))
        text = (
            f"fixes come {change[late] - change[early]:.2f} s later behind the samples about {first[late]:.0f} s after "
            f"the first fix than about {first[early]:.0f} s after it: places and speeds are off by up to as much. "
            "Stamp samples and fixes by one clock, as they come in"
        )
        out.append(Problem(DELAY_CHANGES, text))
    return tuple(out)


def are_unlike(streams: Streams) -> BoolArray:
    """Mask (B,) of stretches in which samples and fixes are not of one motion, in a session that shows the others are.

    An axis that is noise in most stretches, as forward force at an even speed, shows nothing by being so in one more.
    """
    none, known = np.zeros(len(streams.first), dtype=np.bool_), np.isfinite(streams.likeness)
    usual = np.array(
        [median(own[some]) if some.any() else 0.0 for own, some in zip(streams.likeness.T, known.T, strict=True)]
    )
    known &= usual > SHOWS
    rows = np.count_nonzero(known, axis=1) > 1  # one axis alone may be slip
    if np.count_nonzero(rows) < FEWEST_STRETCHES:
        return none
    most = np.max(np.where(known, streams.likeness, -1.0), axis=1)
    z = np.arctanh(np.clip(most, -0.999, 0.999))
    middle = median(z[rows])
    scatter = max(MAD_TO_SIGMA * median(np.abs(z[rows] - middle)), LEAST_SCATTER)
    unlike = rows & (most < UNLIKE) & (z < middle - SURELY * scatter)
    beside = np.concatenate([[False], unlike, [False]])
    return np.asarray(unlike & (beside[:-2] | beside[2:]))  # one alone may be chance


def false_stops(
    measured: Measured, sampled: Array, path: PathMotion, use: IntArray, lag: float
) -> tuple[BoolArray, Array]:
    """Mask (N,) of the fixes that stand while the kart drives on, and from when to when, (K, 2) s, that is so.

    sampled (M,) s: times of the samples; use: fixes at speed, `lag` s behind the samples.
    """
    out, stops = np.zeros(len(path.t), dtype=np.bool_), np.empty((0, 2))
    if use.size >= FEWEST * FEWEST_STRETCHES and median(np.diff(path.t)) <= SLOWEST:
        usual = np.std(measured.at(path.t[use] - lag), axis=1)
        stops = np.array(list(_driven_stops(measured, sampled, path, lag, usual))).reshape(-1, 2)
    for begin, end in zip(*runs_of(are_near(path.t, path.t[path.speed < STANDS], BESIDE_STOP)), strict=True):
        out[begin:end] = np.any((stops[:, 0] <= path.t[end - 1]) & (stops[:, 1] >= path.t[begin]))
    return out, stops


def _driven_stops(
    measured: Measured, sampled: Array, path: PathMotion, lag: float, usual: Array
) -> Iterator[list[float]]:
    """From when to when fixes stand while axes do as usual (3,) at speed, and left force and yaw rate go together."""
    stands = (path.speed < STANDS) & (path.t > sampled[0] + 1.0) & (path.t < sampled[-1] - 1.0)
    for first, behind in zip(*runs_of(stands & ~in_gap(sampled, path.t)), strict=True):
        parts = max(1, int((path.t[behind - 1] - path.t[first]) // STOP))
        for rows in np.array_split(np.arange(first, behind), parts):
            t = path.t[rows]
            if len(rows) < FEWEST or t[-1] - t[0] < 0.9 * STOP:
                continue
            here = measured.at(t - lag)
            alike = np.asarray(np.corrcoef(here[1:]))[0, 1] if np.all(np.std(here, axis=1) > LIVELY * usual) else 0.0
            if alike > DRIVES:
                yield [float(t[0]), float(t[-1])]


def stop_problems(stops: Array) -> tuple[Problem, ...]:
    """Return what to say of stops (K, 2) s after the first fix in which the samples drive on."""
    if not len(stops):
        return ()
    text = (
        f"between {stops[0, 0]:.0f} and {stops[-1, 1]:.0f} s after the first fix the fixes stand still for "
        f"{np.sum(stops[:, 1] - stops[:, 0]):.0f} s while the samples drive on: they were left out, and the result "
        "is not to be trusted there. "
        "Did the antenna come off, or the receiver hold a place? Smooth the rest by itself"
    )
    return (Problem(MOTION_UNLIKE, text),)
