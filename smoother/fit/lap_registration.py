"""The slow error of fixes from laps of one track: by how much the driven line seems to move from lap to lap.

Offsets of all laps at the stations of a common line give the line and, of each lap, one translation against it, both
robust: a driver's own line differs in some corners, traffic and excursions in others. How uncertain a translation is
shows by leaving out one block of the track at a time (jackknife), since what a driver does differently lasts for tens
of metres. Translations are means over a lap of a first-order Gauss-Markov process per level axis; its sigma and time
have the restricted likelihood of these (REML), on a grid, beside a weak prior. What laps show well is the change over
one lap, sigma sqrt(2 (1 - exp(-T / tau))); which part of it is sigma's and which is tau's is mostly prior.

Sources: Efron and Tibshirani 1993, 11 (jackknife); Harville 1977 (REML); Gelb 1974, 3.8 (Gauss-Markov).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray
from smoother.fit.lap_crossings import LapCrossings, cross_stations

FEWEST = 4  # laps
SPACING = 10.0  # m between stations
BLOCKS = 10  # of the track, left out in turn
WITHIN = 6  # times of a lap that stand for all of it
SETTLED = 6  # times that weights are renewed
STIFF = 1e-6  # of a station: keeps the translation of a lap defined where all normals are parallel
# Of a receiver's slow error, m and s: logarithms of candidates, and what is usual: mean and sigma of the logarithm.
LOG_SIGMA, LOG_TAU = np.log(np.geomspace(0.01, 12.0, 43)), np.log(np.geomspace(10.0, 1000.0, 24))
USUAL_SIGMA, USUAL_TAU = (float(np.log(0.8)), 1.5), (float(np.log(80.0)), 0.8)


@dataclass(frozen=True, eq=False)
class LapRegistration:
    """What n laps show of the slow error of the fixes, per level axis.

    change m: over one lap of time_of_lap s, rms; sigma m and tau s of the process; each with the sigma of its
    logarithm, `*_spread`. translation_n (n, 2) m, against the common line; noise m: of one. crossing_time (n, J) s:
    of the stations, NaN where a lap does not cross one.
    """

    change: float
    change_spread: float
    sigma: float
    sigma_spread: float
    tau: float
    tau_spread: float
    time_of_lap: float
    translation_n: Array
    noise: float
    crossing_time: Array

    @property
    def laps(self) -> int:
        """How many there were."""
        return len(self.translation_n)


def register_laps(t: Array, position_n: Array, spacing: float = SPACING) -> LapRegistration | None:
    """Return what fixes at t (N,) s, position_n (N, 2) m, show by their laps; None with fewer than FEWEST laps."""
    crossings = cross_stations(t, position_n, spacing)
    if crossings is None or len(crossings.offset) < FEWEST:
        return None
    return registered(crossings)


def registered(crossings: LapCrossings) -> LapRegistration:
    """Return what FEWEST laps or more show."""
    line = _common_line(crossings.offset, crossings.normal_n)
    covariance = _jackknife(line, crossings)
    return _process(line.translation_n, covariance, crossings)


@dataclass(frozen=True, eq=False)
class _Line:
    """translation_n (n, 2) m of laps against the common line; residual (n, J) m, 0 where weight (n, J) is.

    loss: by how much less a residual moves a translation than it seems by its weight, as that falls with the residual.
    """

    translation_n: Array
    residual: Array
    weight: Array
    loss: float = 1.0


def _common_line(offset: Array, normal_n: Array) -> _Line:
    weight = np.isfinite(offset).astype(np.float64)
    weight[:, weight.sum(axis=0) < 0.5 * len(offset)] = 0.0  # of the laps, that a station has to have
    line = _translated(offset, normal_n, weight)
    for _ in range(SETTLED):  # the loss redescends softly, from a good start
        used = line.weight > 0.0
        # m, of offsets about the line, whatever these are like
        scatter = max(MAD_TO_SIGMA * float(np.median(np.abs(line.residual[used]))), 0.1)
        fourth = (line.residual / (2.5 * scatter)) ** 4  # sigmas of offsets about the line, at which one counts half
        weight = np.where(used, 1.0 / (1.0 + fourth), 0.0)
        slope = np.where(used, (1.0 - 3.0 * fourth) * weight**2, 0.0)
        line = replace(_translated(offset, normal_n, weight), loss=float(np.sum(weight) / np.sum(slope)))
    return line


def _translated(offset: Array, normal_n: Array, weight: Array) -> _Line:
    """Least squares of the line and of all translations, in turns."""
    offset = np.where(weight > 0.0, offset, 0.0)
    total = np.maximum(weight.sum(axis=0), 1e-9)
    middle, moved = (weight * offset).sum(axis=0) / total, np.zeros((len(offset), 2))
    inverse = np.linalg.inv(_normal_matrix(weight, normal_n))
    for _ in range(60):  # of line and translations in turn, at the most
        moved = np.einsum("iab,ib->ia", inverse, (weight * (offset - middle)) @ normal_n)
        moved -= moved.mean(axis=0)
        before, middle = middle, (weight * (offset - moved @ normal_n.T)).sum(axis=0) / total
        if np.max(np.abs(middle - before)) < 1e-4:  # m, by which the line still moves
            break
    residual = np.where(weight > 0.0, offset - middle - moved @ normal_n.T, 0.0)
    return _Line(moved, residual, weight)


def _normal_matrix(weight: Array, normal_n: Array) -> Array:
    """Normal matrices (n, 2, 2) of translations."""
    return np.asarray(np.einsum("ij,ja,jb->iab", weight, normal_n, normal_n) + STIFF * np.eye(2))


def _jackknife(line: _Line, crossings: LapCrossings) -> Array:
    """Covariance (2, 2) m^2 of a translation, in the mean over laps, by leaving out a block of the track at a time."""
    normal_n, n = crossings.normal_n, len(line.translation_n)
    found = np.array([_without_block(line, normal_n, block) for block in _blocks(crossings)])
    found -= found.mean(axis=0)
    covariance = (BLOCKS - 1) / BLOCKS * np.einsum("bia,bic->ac", found, found) / n
    of_line = n / (n - 1)  # it is made of the same laps
    return np.asarray(covariance * of_line * line.loss**2 * _lost(crossings, _lasting(line, crossings.distance)))


def _blocks(crossings: LapCrossings) -> BoolArray:
    """Stations (BLOCKS, J) of each block of the track."""
    block = np.minimum((BLOCKS * crossings.distance / crossings.length).astype(np.int64), BLOCKS - 1)
    return np.asarray(block == np.arange(BLOCKS)[:, None])


def _without_block(line: _Line, normal_n: Array, block: BoolArray) -> Array:
    """Change (n, 2) m of all translations where the stations of a `block` (J,) are left out."""
    weight = line.weight * ~block
    right = (weight * line.residual) @ normal_n
    return np.asarray(np.linalg.solve(_normal_matrix(weight, normal_n), right[:, :, None])[:, :, 0])


def _lasting(line: _Line, distance: Array) -> float:
    """Distance, m, over which residuals are alike, as the sigma of a Gaussian: from the sum of their correlations."""
    values = np.where(line.weight > 0.0, line.residual * np.sqrt(line.weight), 0.0)
    spacing = float(np.median(np.diff(distance)))
    lags = min(len(distance) // 4, int(250.0 / spacing))  # m, over which residuals may be alike
    products = np.array([np.mean(values[:, : len(distance) - k] * values[:, k:]) for k in range(lags + 1)])
    alike = products / max(products[0], 1e-12)
    until = int(np.argmax(np.append(alike, -1.0) < 0.0))
    return spacing * (0.5 + float(np.sum(alike[1:until]))) * math.sqrt(2.0 / math.pi)


def _lost(crossings: LapCrossings, lasting: float) -> float:
    """Variance of a translation over that of the jackknife, for residuals correlated over `lasting` m."""
    normal_n, distance = crossings.normal_n, crossings.distance
    alike = np.exp(-0.5 * ((distance[:, None] - distance) / lasting) ** 2)
    inverse = np.linalg.inv(_normal_matrix(np.ones((1, len(distance))), normal_n)[0])
    moves = inverse @ normal_n.T
    left = np.eye(len(distance)) - normal_n @ moves
    of_residuals = left @ alike @ left.T
    changes = []
    for block in _blocks(crossings):
        kept = normal_n * ~block[:, None]
        changes.append(np.linalg.solve(kept.T @ kept + STIFF * np.eye(2), kept.T))
    change = np.array(changes) - np.mean(changes, axis=0)
    found = (BLOCKS - 1) / BLOCKS * np.einsum("bai,ij,baj->", change, of_residuals, change, optimize=True)
    return float(np.einsum("ai,ij,aj->", moves, alike, moves) / found)


def _process(translation_n: Array, covariance: Array, crossings: LapCrossings) -> LapRegistration:
    """Sigma and time of the process that the translations are means of, with noise of this covariance (2, 2)."""
    within = np.nanquantile(crossings.time, (np.arange(WITHIN) + 0.5) / WITHIN, axis=1).T
    logs, taus = np.meshgrid(LOG_SIGMA, LOG_TAU, indexing="ij")
    posterior = _log_likelihood(translation_n, covariance, within)
    posterior -= 0.5 * ((logs - USUAL_SIGMA[0]) / USUAL_SIGMA[1]) ** 2
    posterior -= 0.5 * ((taus - USUAL_TAU[0]) / USUAL_TAU[1]) ** 2
    weight = np.exp(posterior - posterior.max())
    weight /= weight.sum()
    changes = logs + 0.5 * np.log(-2.0 * np.expm1(-crossings.time_of_lap / np.exp(taus)))

    def of(values: Array) -> tuple[float, float]:
        mean = float(np.sum(weight * values))
        return float(np.exp(mean)), float(np.sqrt(np.sum(weight * (values - mean) ** 2)))

    return LapRegistration(
        *of(changes),
        *of(logs),
        *of(taus),
        crossings.time_of_lap,
        translation_n,
        float(np.sqrt(0.5 * np.trace(covariance))),
        crossings.time,
    )


def _log_likelihood(translation_n: Array, covariance: Array, within: Array) -> Array:
    """Restricted log likelihood (S, T) of LOG_SIGMA and LOG_TAU; within (n, WITHIN) s: times of each lap."""
    n = len(translation_n)
    noise, axes = np.linalg.eigh(covariance)
    contrasts = np.linalg.svd(np.eye(n) - 1.0 / n)[0][:, : n - 1]  # free of the mean, which is the line's
    seen = contrasts.T @ translation_n @ axes
    separation = np.abs(within[:, None, :, None] - within[None, :, None, :])
    out = np.zeros((len(LOG_SIGMA), len(LOG_TAU)))
    for k, log_tau in enumerate(LOG_TAU):
        alike = np.exp(-separation / np.exp(log_tau)).mean(axis=(2, 3))
        own, basis = np.linalg.eigh(contrasts.T @ alike @ contrasts)
        squares = (basis.T @ seen) ** 2
        variance = np.exp(2.0 * LOG_SIGMA)[:, None, None] * np.maximum(own, 0.0)[:, None] + np.maximum(noise, 1e-8)
        out[:, k] = -0.5 * np.sum(np.log(variance) + squares / variance, axis=(1, 2))
    return out
