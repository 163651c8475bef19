"""Laps for the golden table: how far the line moves from lap to lap, and when a path crosses a gate.

A receiver's slow error moves whole laps sideways. Each lap's distance from a common line, at stations along it, is
fitted by one translation (robustly: the driver's own line is the scatter around it). `change_of_line` is how far that
translation moves from a lap to the next, as it is seen; `slow_change` is what of it is a slow error of the positions: a
Gauss-Markov process, by restricted maximum likelihood beside the noise of the translations. A smoother should make
neither larger than in the raw fixes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from golden_command import Array

STEP = 15.0  # m between stations
REACH = 12.0  # m, of a lap from the common line
AHEAD = 5.0  # m, along the line, of a lap's point from its station
CUT = 2.5  # robust sigmas where the weight of a distance is half lost
SAMPLES = 50.0  # Hz
USUAL_SIGMA, SPREAD_SIGMA = 0.8, 1.5  # m and a logarithm: the weak prior of a slow error,
USUAL_TAU, SPREAD_TAU = 80.0, 0.8  # s and a logarithm
WIDER = 6.0  # m, that a gate is lengthened by at both ends: the path is offset against it
NEAR = 5.0  # s, between a reported start of a lap and the true one


def change_of_line(t: Array, path: Array, starts: Array, ends: Array) -> float | None:
    """Rms per axis, m, of the change of the laps' translation from a lap to the next; None with under three laps.

    t (N,) s, path (N, 2) m, starts and ends (L,) s of the laps.
    """
    if len(starts) < 3:
        return None
    stations, tangent, normal = common_line(t, path, starts, ends)
    distance, _ = cross_track(t, path, starts, ends, stations, tangent, normal)
    translation = translations(distance, normal).moved
    follows = np.abs(starts[1:] - ends[:-1]) < 1.0  # laps that were left out between two: no neighbours
    change = np.diff(translation, axis=0)[follows]
    return float(np.sqrt(np.mean(change**2))) if len(change) else None


def slow_change(t: Array, path: Array, starts: Array, ends: Array) -> float | None:
    """Change in a lap, m rms per axis, of a Gauss-Markov error of the positions; None with under three laps.

    Its sigma and time constant are found from the laps' translations by restricted maximum likelihood, on a grid with a
    weak prior, beside the noise that the translations have by the driver's own line (Patterson and Thompson 1971, of
    variance components; a jackknife over blocks of the track for the noise). Arguments as of :func:`change_of_line`.
    """
    if len(starts) < 3:
        return None
    stations, tangent, normal = common_line(t, path, starts, ends)
    distance, when = cross_track(t, path, starts, ends, stations, tangent, normal)
    fit = translations(distance, normal)
    noise = translation_noise(fit, normal)
    laps = [np.quantile(w[np.isfinite(w)], (np.arange(6) + 0.5) / 6) for w in when]
    apart = np.abs(np.array(laps)[:, None, :, None] - np.array(laps)[None, :, None, :])
    n, y = len(starts), fit.moved.T.ravel()
    mean = np.kron(np.eye(2), np.ones((n, 1)))
    log_sigma, log_tau = np.log(np.geomspace(0.01, 12.0, 30)), np.log(np.geomspace(10.0, 1000.0, 14))
    likelihood = np.empty((len(log_sigma), len(log_tau)))
    for j, tau in enumerate(np.exp(log_tau)):
        together = np.kron(np.eye(2), np.exp(-apart / tau).mean(axis=(2, 3)))
        for i, sigma in enumerate(np.exp(log_sigma)):
            root = np.linalg.cholesky(sigma**2 * together + np.kron(noise, np.eye(n)))
            z, x = np.linalg.solve(root, y), np.linalg.solve(root, mean)
            information = x.T @ x
            rest = z @ z - (x.T @ z) @ np.linalg.solve(information, x.T @ z)
            likelihood[i, j] = -np.log(np.diag(root)).sum() - 0.5 * np.linalg.slogdet(information)[1] - 0.5 * rest
    of_sigma, of_tau = (log_sigma - np.log(USUAL_SIGMA)) / SPREAD_SIGMA, (log_tau - np.log(USUAL_TAU)) / SPREAD_TAU
    posterior = likelihood - 0.5 * of_sigma[:, None] ** 2 - 0.5 * of_tau[None] ** 2
    weight = np.exp(posterior - posterior.max())
    weight /= weight.sum()
    square = np.exp(2.0 * log_sigma)[:, None] * 2.0 * -np.expm1(-np.median(ends - starts) / np.exp(log_tau))[None]
    return float(np.sqrt(np.sum(weight * square)))


def translation_noise(fit: "Translations", normal: Array, blocks: int = 10) -> Array:
    """Covariance (2, 2) m^2 of a lap's translation by what the driver's line is off, the mean of all laps."""
    block = np.arange(len(normal)) * blocks // len(normal)
    out = np.zeros((2, 2))
    for weight, residual in zip(fit.weight, fit.residual, strict=True):
        without = []
        for b in range(blocks):
            scaled = (weight * (block != b))[:, None] * normal
            without.append(np.linalg.solve(scaled.T @ normal + 1e-6 * np.eye(2), scaled.T @ residual))
        spread = np.array(without) - np.mean(without, axis=0)
        out += (blocks - 1) / blocks * spread.T @ spread
    return np.asarray(out / max(len(fit.weight) - 1, 1))


def common_line(t: Array, path: Array, starts: Array, ends: Array) -> tuple[Array, Array, Array]:
    """Stations (S, 2) m along the lap of median time, their unit tangents and normals (S, 2)."""
    middle = int(np.argsort(ends - starts)[len(starts) // 2])
    at = np.arange(starts[middle], ends[middle], 1 / SAMPLES)
    line = _interpolated(at, t, path)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    s = np.arange(STEP / 2, length[-1], STEP)
    tangent = _interpolated(s + 2.0, length, line) - _interpolated(s - 2.0, length, line)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-9)[:, None]
    return _interpolated(s, length, line), tangent, np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)


def cross_track(
    t: Array, path: Array, starts: Array, ends: Array, stations: Array, tangent: Array, normal: Array
) -> tuple[Array, Array]:
    """Distance (L, S), m, of each lap to the left of each station, and when it passes, s; NaN where it does not."""
    distance, when = np.full((2, len(starts), len(stations)), np.nan)
    for lap, (start, end) in enumerate(zip(starts, ends, strict=True)):
        at = np.arange(start - 1.0, end + 1.0, 1 / SAMPLES)
        away = _interpolated(at, t, path)[None] - stations[:, None]
        along = np.einsum("skx,sx->sk", away, tangent)
        across = np.einsum("skx,sx->sk", away, normal)
        passes = (along[:, :-1] <= 0) & (along[:, 1:] > 0) & (np.abs(along[:, :-1]) < AHEAD)
        passes &= np.abs(across[:, :-1]) < REACH
        for station in np.flatnonzero(passes.any(axis=1)):
            every = np.flatnonzero(passes[station])
            k = int(every[np.argmin(np.abs(across[station, every]))])
            part = -along[station, k] / (along[station, k + 1] - along[station, k])
            distance[lap, station] = (1 - part) * across[station, k] + part * across[station, k + 1]
            when[lap, station] = at[k] + part / SAMPLES
    return distance, when


@dataclass(frozen=True, eq=False)
class Translations:
    """moved (L, 2), m: of each lap against the common line; residual (L, S), m, of its distances, and their weight."""

    moved: Array
    residual: Array
    weight: Array


def translations(distance: Array, normal: Array, rounds: int = 20) -> Translations:
    """Fit the translation of each lap against the common line, from distances (L, S) along normals (S, 2).

    Line and translations are fitted by turns; weights fall softly with a residual, so that a slide or another line
    through one corner does not move its lap.
    """
    known = np.isfinite(distance)
    weight = known.astype(np.float64)
    weight[:, known.mean(axis=0) < 0.5] = 0.0  # stations that few laps pass
    value = np.where(known, distance, 0.0)
    line = np.where(known.any(axis=0), np.nanmedian(np.where(known, distance, np.nan), axis=0), 0.0)
    moved, left = np.zeros((len(distance), 2)), value
    for _ in range(rounds):
        for lap in range(len(distance)):
            scaled = weight[lap][:, None] * normal
            information = scaled.T @ normal + 1e-6 * np.eye(2)
            moved[lap] = np.linalg.solve(information, scaled.T @ (value[lap] - line))
        moved -= moved.mean(axis=0)
        left = value - moved @ normal.T
        line = (weight * left).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9)
        residual = np.abs(left - line)
        counted = residual[weight > 0]
        if not len(counted):
            break
        scale = CUT * max(1.48 * float(np.median(counted)), 1e-6)
        weight = np.where(weight > 0, 1 / (1 + (residual / scale) ** 4), 0.0)
    return Translations(moved, left - line, weight)


def crossings(t: Array, path: Array, gate: Array) -> Array:
    """Times, s, at which a path (N, 2) crosses a gate, its ends (2, 2), lengthened by WIDER; one direction only."""
    along = gate[1] - gate[0]
    length = float(np.linalg.norm(along))
    along = along / length
    across = np.array([-along[1], along[0]])
    ahead = (path - gate[0]) @ across
    beside = (path - gate[0]) @ along
    times = []
    for k in np.flatnonzero(np.signbit(ahead[:-1]) != np.signbit(ahead[1:])):
        part = ahead[k] / (ahead[k] - ahead[k + 1])
        where = beside[k] + part * (beside[k + 1] - beside[k])
        if -WIDER < where < length + WIDER:
            times.append((t[k] + part * (t[k + 1] - t[k]), bool(ahead[k] < ahead[k + 1])))
    if not times:
        return np.empty(0)
    usual = sum(forward for _, forward in times) * 2 >= len(times)
    return np.array([time for time, forward in times if forward == usual])


def lap_times(laps: Sequence[Mapping[str, Any]], true_starts: Array) -> tuple[Array, Array]:
    """Errors (L,) of the valid laps' times, s, and the same over their sigmas, against the true crossings (K,), s."""
    errors, scores = [], []
    for lap in laps:
        if not lap["valid"] or not lap["lap_time_sigma_s"] or len(true_starts) < 2:
            continue
        first, last = (true_starts[np.argmin(np.abs(true_starts - lap[key]))] for key in ("start_s", "end_s"))
        if max(abs(first - lap["start_s"]), abs(last - lap["end_s"])) < NEAR and last > first:
            errors.append(lap["lap_time_s"] - (last - first))
            scores.append(errors[-1] / lap["lap_time_sigma_s"])
    return np.array(errors), np.array(scores)


def _interpolated(at: Array, t: Array, path: Array) -> Array:
    return np.stack([np.interp(at, t, path[:, i]) for i in range(2)], axis=1)
