"""The slow error of the fixes from the fixes alone: is there one, how large is it, and how long does it last?

Doppler added up is a path of its own, wherever it began: it drifts like a random walk, by the white noise of Doppler,
and along a straight line, by its bias. What the positions do against that path beyond these and beyond their own white
noise is the slow offset, a first-order Gauss-Markov process. Its sigma and time are those of the highest likelihood,
which a Kalman filter over means of `BIN` seconds finds for many candidates at once.

`offset_model` decides by it: fixes that scatter by more than a metre are not filtered, and have an offset only if they
show one. Filtered ones have one as receivers do: its walk is that of the fixes, its sigma and time only where a session
is long enough. Where fixes are too few, the walk is the one that was identified with the path.

Sources: Gelb 1974, 3.8 (the process); Schweppe 1965 (likelihood from innovations); Akaike 1974 (the price of a value).
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, median
from smoother.estimate.fixes.path import GnssPath
from smoother.estimate.fixes.slow_errors import SlowVelocity
from smoother.samples import GnssFixes

UNFILTERED = 1.0  # m of white noise, more than any filtered fix shows
SHOWN = 0.25  # of receivers' offset; more than is assumed of unfiltered fixes at first
BIN = 2.0  # s, of the means: a fifth of the shortest time that counts as slow
GAP = 1.5  # s without Doppler, over which it cannot be added up
WILD = 5.0  # m/s^2, what is unknown of the motion over a gap
BIASED = SlowVelocity(0.05)  # Doppler's bias, as of the path
ANYWHERE = 1e3  # m, sigma of where Doppler's path began
FEWEST = 30  # means
LEAST_DOPPLER = 0.5  # share of the fixes with Doppler
PRICE = 2.0  # logarithm of likelihood that an offset's two values, which always fit a little better, have to be worth
# Receivers report half to twice the error of their fixes, of both axes; at most ten times the usual is used.
HALF, MOST_WORSE = 2.0 * math.sqrt(2.0), 10.0
# m, reported with corrections only; percentile of the fixes without them, and by what factor those are worse
CORRECTED, WORSE, MIXED = 0.1, 92.0, 6.0
NONE = 0.005  # of the usual offset, where there is none: a centimetre
UNTOLD = 0.2  # of it, for unfiltered fixes without Doppler, to begin with: the graph finds it if there is more
TIMES = 10.0  # taus that a session has to last for its own sigma and tau
KNOWN_TAU = 0.3  # sigma of a logarithm, half of what receivers' 30 to 100 s leave open beforehand
# s, of receivers. Faster errors are reflections, which return every lap. They are most of what residuals show, and the
# receiver's own wander is observable beside them only in a session of TIMES the longest.
SHORTEST, LONGEST = 30.0, 100.0
# m of white noise, below which one fix stands for its bin: a mean of a path that wanders by more than its fixes scatter
# would wander less over a bin than over two, and seem to last longer.
AVERAGED = 1.0
WEIGHTY = 0.5  # weight in the path from which a measurement is one
# Logarithms of candidates: tau s (what is faster is motion or white, what is slower a constant); walk 2 sigma^2 / tau
# m^2/s, which the data know best; factor on the white variance that the path found.
COARSE = (np.log(np.geomspace(10.0, 320.0, 6)), np.log(np.geomspace(1e-4, 10.0, 11)), np.array([-0.7, 0.0, 0.7]))
WALKS = np.linspace(-9.0, 1.5, 64)  # logarithms of walk over the usual one
WALK_SPREAD = 3.0  # sigma of these beforehand: receivers of a metre and of a decimetre are both usual
FINER = 3  # refinements around the best candidate, each of half the spacing
AROUND = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
NEAR = tuple(step * np.array([-1.0, 0.0, 1.0]) for step in (0.15, 0.05, 0.1))  # about a sigma in half an hour


@dataclass(frozen=True)
class OffsetFit:
    """Horizontal offset of the fixes: sigma m per axis and tau s of the highest likelihood.

    tau_spread: sigma of the logarithm of tau. evidence: logarithm of how much likelier the fixes are so than without an
    offset; never much below 0.
    """

    sigma: float
    tau: float
    tau_spread: float
    evidence: float


@dataclass(frozen=True, eq=False)
class OffsetModel:
    """What is assumed of the offset: sigma (3,) m north, west, up; tau s; tau_spread as in OffsetFit, infinite where it
    is the population's.
    """

    sigma: Array
    tau: float
    tau_spread: float = math.inf


@dataclass(frozen=True, eq=False)
class Drift:
    """B means of fixes against Doppler added up: t (B,) s, drift (B, 2) m; variances (B,) m^2: walk that Doppler adds
    from the one before, white of the mean."""

    t: Array
    drift: Array
    walk: Array
    white: Array


def offset_model(fixes_t: Array, path: GnssPath, usual: OffsetModel, is_filtered: bool) -> OffsetModel:
    """Return the offset of the fixes of `path`, stamped fixes_t (M,) s; `usual` as far as they are too few.

    The height wanders in proportion, since hardly any receiver measures vertical speed.
    """
    lasts = float(fixes_t[-1] - fixes_t[0])
    seen = drift_against_doppler(fixes_t, path)
    if not shows_offset(fixes_t, seen, path):
        if has_doppler(path):
            return OffsetModel(usual.sigma * path.wander, usual.tau)
        return usual if is_filtered else OffsetModel(usual.sigma * UNTOLD, usual.tau)
    if is_filtered and lasts <= TIMES * max(usual.tau, LONGEST):
        return _walked(seen, usual)
    fit = fit_offset(seen)
    if not is_filtered and fit.evidence < PRICE:
        return OffsetModel(usual.sigma * NONE, usual.tau)
    own = usual.sigma * (fit.sigma / usual.sigma[0])
    known = lasts > TIMES * fit.tau and fit.tau_spread < KNOWN_TAU and fit.evidence > PRICE
    if known and not (is_filtered and fit.tau < SHORTEST):
        return OffsetModel(own, fit.tau, fit.tau_spread)
    return _walked(seen, usual) if is_filtered else OffsetModel(np.minimum(own, usual.sigma), usual.tau)


def reported_share(fixes: GnssFixes, usual: float) -> float:
    """Horizontal accuracy that a receiver reports over the usual slow error, m: 1 where it reports none.

    A session shows no wander that is slower than the session is long; there the receiver's own report counts.
    Where corrections came or went, the accuracy of the fixes without them counts for all.
    """
    if fixes.sigma_horizontal is None or not np.any(np.isfinite(fixes.sigma_horizontal)):
        return 1.0
    accuracy, worse = np.nanpercentile(fixes.sigma_horizontal, [50.0, WORSE])
    if accuracy < CORRECTED and worse > MIXED * accuracy:
        accuracy = worse
    share = float(accuracy) / usual
    return float(np.clip(share, 1.0 / MOST_WORSE, np.clip(share / HALF, 1.0, MOST_WORSE)))


def unseen_variance(offset: OffsetModel, white: float, population: Array, n_fixes: int, hidden: float = 0.0) -> Array:
    """Variance (3,) m^2 of the offset beyond what a session's `offset` shows, to be added to absolute positions.

    A receiver with little white noise (m) has filtered its fixes. They wander slowly, by more than a drive can show,
    since neither integrated Doppler nor the inertial samples are judges of minutes: what is seen is a lower bound, and
    the population (3,) m says the rest. With white noise beyond a metre the fixes are not filtered, and the data may
    find that there is no offset at all, where there are so many fixes that it would be seen; if they show one, it is as
    others are. Less than `hidden` m, infinite without Doppler, nothing would show, and where that is much they may
    wander as all do. A session that lasts for many times the time over which its offset is forgotten is its own judge.
    """
    seen = max(white / math.sqrt(max(n_fixes, 1)), hidden) < SHOWN * population[0]
    shows_none = seen and white > UNFILTERED and offset.sigma[0] < SHOWN * population[0]
    if shows_none or math.isfinite(offset.tau_spread):
        return np.zeros(3)
    return np.maximum(population**2 - offset.sigma**2, 0.0)


def _walked(seen: Drift, usual: OffsetModel) -> OffsetModel:
    """Return the usual offset with a sigma at which it walks, over seconds, as the fixes show.

    Sigma and time together define the walk, which weighs a fix against the next one. Its size over minutes remains
    unknown and belongs to the sigma of absolute positions.
    """
    mean = math.log(2.0 * usual.sigma[0] ** 2 / usual.tau)
    candidates = _grid((np.array([math.log(usual.tau)]), mean + WALKS, COARSE[2]))
    found = log_likelihood(seen, candidates) - 0.5 * ((candidates[1] - mean) / WALK_SPREAD) ** 2
    share = math.exp(0.5 * (float(candidates[1, np.argmax(found)]) - mean))
    return OffsetModel(usual.sigma * share, usual.tau)


def shows_offset(fixes_t: Array, seen: Drift, path: GnssPath) -> bool:
    """Whether there are enough means and Doppler to estimate the offset of the fixes, stamped fixes_t (M,) s."""
    return len(seen.t) >= FEWEST and has_doppler(path) and not follows_positions(fixes_t, path)


def is_reported(fixes_t: Array, path: GnssPath) -> bool:
    """Whether the fixes of `path`, stamped fixes_t (M,) s, show their offset."""
    return shows_offset(fixes_t, drift_against_doppler(fixes_t, path), path)


def has_doppler(path: GnssPath) -> bool:
    """Whether most fixes of `path` come with a velocity that agrees with it."""
    return float(np.mean(path.velocity_weight > WEIGHTY)) >= LEAST_DOPPLER


def follows_positions(fixes_t: Array, path: GnssPath) -> bool:
    """Whether positions determine the way from one fix, stamped fixes_t (M,) s, to the next better than motion does.

    White jerk leaves the way between two states open by density times step^2.5 / sqrt(720), Doppler by its noise times
    the step. Where the former is more, which is from about one fix a second on, the path goes wherever the positions
    do, with their offset and noise, and is no judge of either.
    """
    step = float(median(np.diff(fixes_t))) if len(fixes_t) > 1 else math.inf
    return bool(path.jerk_density[0] * step**1.5 > math.sqrt(720.0) * path.velocity_sigma[0])


def fit_offset(seen: Drift, axes: tuple[Array, Array, Array] = COARSE) -> OffsetFit:
    """Return the offset of the highest likelihood; `seen` has to show one, see :func:`shows_offset`."""
    none = log_likelihood(seen, np.stack([COARSE[2] * 0.0, COARSE[2] * 0.0 - np.inf, COARSE[2]]))
    best = np.zeros(3)
    for _ in range(1 + FINER):
        candidates = _grid(axes)
        best = candidates[:, np.argmax(log_likelihood(seen, candidates))]
        axes = tuple(x + AROUND * 0.5 * (a[1] - a[0]) for x, a in zip(best, axes, strict=True))
    near = _grid(NEAR)
    found = log_likelihood(seen, best[:, None] + near)
    tau, walk, _ = best
    return OffsetFit(
        math.sqrt(0.5 * math.exp(walk + tau)), math.exp(tau), _spread(near, found), float(found.max() - none.max())
    )


def _grid(axes: tuple[Array, ...]) -> Array:
    return np.stack([values.ravel() for values in np.meshgrid(*axes, indexing="ij")])


def _spread(near: Array, log_likelihood: Array) -> float:
    """Sigma of the first of three values by a quadratic through log likelihoods (G,) at `near` (3, G), infinite if it
    has no maximum."""
    x, y, z = near
    design = np.stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z, np.ones_like(x)], axis=1)
    xx, yy, zz, xy, xz, yz = np.linalg.lstsq(design, log_likelihood, rcond=None)[0][:6]
    information = -np.array([[2.0 * xx, xy, xz], [xy, 2.0 * yy, yz], [xz, yz, 2.0 * zz]])
    if np.linalg.eigvalsh(information)[0] <= 0.0:
        return math.inf
    return math.sqrt(np.linalg.inv(information)[0, 0])


def drift_against_doppler(fixes_t: Array, path: GnssPath) -> Drift:
    """Return the horizontal fixes of `path`, stamped fixes_t (M,) s, less its Doppler added up, in means of BIN."""
    known = path.velocity_weight > WEIGHTY
    off = np.where(known[:, None], np.nan_to_num(path.velocity_residual_n[:, :2]), 0.0)
    step, both = np.diff(fixes_t), known[1:] & known[:-1]
    added = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (off[1:] + off[:-1]) * step[:, None], axis=0)])
    offset_n = path.at(fixes_t - path.position_latency).offset_n
    drift = (offset_n - path.position_residual_n)[:, :2] + added
    noise = path.velocity_sigma[0] * path.velocity_scale[1:] * step
    if follows_positions(fixes_t, path):  # then the way between two velocities is what is uncertain
        noise = np.hypot(noise, path.jerk_density[0] * step**2.5 / math.sqrt(720.0))
    # over a pause of an hour it may be anywhere; a larger number would only take the digits of all that follows
    walk = np.where(both & (step < GAP), noise, np.minimum(0.5 * WILD * step**2, ANYWHERE)) ** 2
    walk = np.concatenate([[0.0], np.cumsum(walk)])
    use = np.flatnonzero(np.isfinite(drift).all(axis=1) & (path.position_weight > WEIGHTY))
    if path.position_sigma[0] < AVERAGED:
        use = use[np.unique(np.floor((fixes_t[use] - fixes_t[0]) / BIN), return_index=True)[1]]
    _, row, count = np.unique(np.floor((fixes_t[use] - fixes_t[0]) / BIN), return_inverse=True, return_counts=True)
    t, north, west, walk, white = (
        np.bincount(row, values) / count
        for values in (fixes_t[use], *drift[use].T, walk[use], (path.position_sigma[0] * path.position_scale[use]) ** 2)
    )
    return Drift(t, np.stack([north, west], axis=1), np.diff(walk, prepend=walk[:1]), white / count)


def log_likelihood(seen: Drift, candidates: Array, slow: SlowVelocity = BIASED) -> Array:
    """Log likelihood (G,) of candidates (3, G), as in COARSE, of both axes; one filter steps through all of them.

    State: Doppler's path, its `slow` error, the offset. Their covariance is the same for both axes and written out,
    because stacks of such small matrices cost ten times as much.
    """
    tau, walked, white = np.exp(candidates)
    variance = 0.5 * walked * tau
    zero = np.zeros(len(tau))
    p00, p01, p02, p11, p12, p22 = zero + ANYWHERE**2, zero, zero, zero + slow.sigma**2, zero, variance
    x0, x1, x2 = (np.zeros((2, len(tau))) for _ in range(3))
    total = np.zeros(len(tau))
    measured, steps = (seen.drift - seen.drift[0])[:, :, None], np.diff(seen.t, prepend=seen.t[0]).tolist()
    for z, h, walk, noise in zip(measured, steps, seen.walk.tolist(), seen.white.tolist(), strict=True):
        keep, lasts, goes = np.exp(-h / tau), slow.kept(h), slow.gone(h)
        q00, q01, q11 = slow.noise(h)
        p00, p01 = p00 + goes * (2.0 * p01 + goes * p11) + walk + q00, lasts * (p01 + goes * p11) + q01
        p02, p12, p22 = keep * (p02 + goes * p12), keep * lasts * p12, variance + keep**2 * (p22 - variance)
        p11 = lasts**2 * p11 + q11
        x0, x1, x2 = x0 + goes * x1, lasts * x1, keep * x2
        a0, a1, a2 = p00 + p02, p01 + p12, p02 + p22
        s = a0 + a2 + white * noise
        innovation = z - x0 - x2
        total -= np.log(s) + 0.5 * np.sum(innovation**2, axis=0) / s
        g0, g1, g2 = a0 / s, a1 / s, a2 / s
        x0, x1, x2 = x0 + g0 * innovation, x1 + g1 * innovation, x2 + g2 * innovation
        p00, p01, p02 = p00 - g0 * a0, p01 - g0 * a1, p02 - g0 * a2
        p11, p12, p22 = p11 - g1 * a1, p12 - g1 * a2, p22 - g2 * a2
    return total
