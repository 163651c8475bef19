"""Alignment by rare fixes: changes of course and velocity from one fix to the next.

In the seconds between two such fixes a kart takes whole bends, so that the path through them shows neither forces nor
rates. But both ends are measured, and the samples can be integrated between them. With psi(t), the turn about up since
the first of two fixes by the rates less a bias, and the horizontal force a(t), complex, in any axes of the sensor,

    course_1 - course_0   = psi(t_1),
    velocity_1 - velocity_0 = exp(i course_0) (kappa Int a exp(i psi) dt - beta Int exp(i psi) dt).

The mean of exp(i (turn by fixes - turn by samples)) is 1 where all turns agree and about 1/sqrt(N) by chance (Mardia &
Jupp 2000, 2.3): its maximum gives the latency, and the bias, but for whole turns from fix to fix. kappa, exp(-i angle)
from the sensor's axis to forward, and beta, the horizontal part of gravity, follow by least squares; the size of kappa
is 1 if samples and fixes are of one drive. Integration in the body's frame as in alignment in motion by velocities (Wu
& Pan 2013, IEEE Trans. Aerosp. Electron. Syst. 49(2)).
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray, median
from smoother.estimate.preprocess.streams import (
    LAGS,
    MIN_SPEED,
    Averages,
    PathMotion,
    averages_of,
    before_holes,
    in_gap,
    peak,
    thinned,
)
from smoother.frames import wrap_angle
from smoother.samples import ImuSamples
from smoother.units import STANDARD_GRAVITY

RARE = 2.0  # s from fix to fix, usually; in that time a kart takes a bend
LONGEST = 15.0  # s from one fix to the next; errors of bias and of up add up
FEWEST, ENOUGH = 15, 2000  # pairs of fixes: by chance 15 agree to 0.7, biases and delays tried
BIASES = np.linspace(-1.3, 1.3, 521)  # rad/s, of all usual gyroscopes
AS_GOOD = 0.02  # of agreement, by which other biases are tried too
MOST_TRIED = 9
# s about the lag of the turns: a kart turns in before its path does, and its wheels before it
FINER_LAGS = np.arange(-0.4, 0.21, 0.05)
BESIDE = 1.0  # s before the first fix and after the last one, in which lags reach
STRAIGHT = 0.002  # mean 1 - cos of turns: 4 deg rms, as noise of the course makes them
STEP = 0.02  # s, of the integration; a kart turns by 3 deg in it
ROUNDS = 3  # of what is up, and what follows from it
REWEIGHTED = 5
LEAST_SIZE, MOST_SIZE = 0.6, 1.6  # of kappa; slip and lean of real karts make it 1.0 to 1.2


@dataclass(frozen=True, eq=False)
class RareAlignment:
    """R_bs (3, 3); gyro_bias_s (3,) rad/s; lag, s, of the fixes; what is left of force, m/s^2/sqrt(Hz), and rate,
    rad/s/sqrt(Hz), as densities.

    turned, moved: shares of turns and of changes of velocity that are explained, at most 1.
    """

    R_bs: Array
    gyro_bias_s: Array
    lag: float
    turned: float
    moved: float
    accel_noise: float
    gyro_noise: float


def are_rare(t: Array) -> bool:
    """Whether between fixes at t (N,) s a kart goes round bends, so that their path knows few of its forces."""
    return len(t) > 1 and median(np.diff(t)) > RARE


def align_rare(imu: ImuSamples, path: PathMotion) -> RareAlignment | None:
    """Align by the changes from fix to fix; None where too few neighbours are at speed, or the course hardly turns."""
    pairs = _Pairs.of(imu, path)
    if pairs is None:
        return None
    averages = averages_of(imu)
    up_s = np.median(imu.specific_force_s, axis=0)
    up_s = up_s / max(float(np.linalg.norm(up_s)), 1e-9)
    fitted = _fitted(imu, averages, pairs, up_s)
    for _ in range(ROUNDS - 1):
        fitted = _fitted(imu, averages, pairs, fitted.R_bs[2])
    return fitted


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Neighbouring fixes (P,): since, until s; course (2, P) rad of both, anticlockwise from north; change (P,) m/s of
    velocity, north + i west. steady (P, B): exp(i angle) that each of BIASES has turned by from the one to the next."""

    since: Array
    until: Array
    course: Array
    change: Array
    steady: Array

    @classmethod
    def of(cls, imu: ImuSamples, path: PathMotion) -> "_Pairs | None":
        """Those at speed with samples all the way; None if too few, or too straight."""
        rows = thinned(_at_speed(imu, path), ENOUGH)
        if rows.size < FEWEST:
            return None
        velocity = path.velocity_n[:, 0] + 1j * path.velocity_n[:, 1]
        course = np.stack([path.yaw[rows], path.yaw[rows + 1]])
        since, until = path.t[rows], path.t[rows + 1]
        steady = np.exp(1j * (until - since)[:, None] * BIASES)
        pairs = cls(since, until, course, velocity[rows + 1] - velocity[rows], steady)
        return None if pairs.straightness < STRAIGHT else pairs

    @property
    def lasts(self) -> Array:
        """From fix to fix, (P,) s."""
        return np.asarray(self.until - self.since)

    @property
    def turn(self) -> Array:
        """Of the course, (P,) rad, but for whole turns."""
        return np.asarray(self.course[1] - self.course[0])

    @property
    def straightness(self) -> float:
        """Mean 1 - cos of the turns about a steady one: their circular variance."""
        return 1.0 - float(np.max(self.agreement(np.zeros(len(self.since)))))

    def agreement(self, turn: Array) -> Array:
        """Mean cosine (B,) of the turns less those of the samples, (P,) rad, and of each of BIASES."""
        return np.asarray(np.real(np.exp(1j * (self.turn - turn)) @ np.conj(self.steady)) / len(turn))


def _at_speed(imu: ImuSamples, path: PathMotion) -> IntArray:
    """Return which fixes are at speed, as the next one is, with samples in all of the time from the one to it."""
    t = path.t
    usable = (path.speed > MIN_SPEED) & (t - LAGS[-1] > imu.t[0]) & (t - LAGS[0] < imu.t[-1]) & ~in_gap(imu.t, t)
    holes = np.searchsorted(imu.t[before_holes(imu.t)], t)
    return np.flatnonzero(usable[:-1] & usable[1:] & (np.diff(t) < LONGEST) & (np.diff(holes) == 0))


def _fitted(imu: ImuSamples, averages: Averages, pairs: _Pairs, up_s: Array) -> RareAlignment:
    """Fit with up at up_s (3,)."""

    def turned(lag: float) -> Array:
        return averages.between(pairs.since - lag, pairs.until - lag)[1] @ up_s

    by_turns = peak(LAGS, np.array([np.max(pairs.agreement(turned(lag))) for lag in LAGS]))
    of_biases = pairs.agreement(turned(by_turns))
    level = _Level.of(imu, averages, pairs, up_s)
    biases = -BIASES[_peaks(of_biases)]
    bias = max(biases, key=lambda each: level.turned_with(each).moved(pairs, by_turns).share)
    level_samples = level.turned_with(bias)
    tried = by_turns + FINER_LAGS
    lag = peak(tried, np.array([level_samples.moved(pairs, each).share for each in tried]))
    moved = level_samples.moved(pairs, lag)
    off = wrap_angle(pairs.turn - turned(by_turns) + bias * pairs.lasts)
    root = np.sqrt(pairs.lasts)
    return RareAlignment(
        level.mounting(moved),
        level.bias(averages, pairs, lag, bias),
        lag,
        1.0 - (1.0 - float(np.max(of_biases))) / pairs.straightness,
        moved.share if LEAST_SIZE < abs(moved.kappa) < MOST_SIZE else 0.0,
        median(moved.rest / root) / math.sqrt(2.0 * math.log(2.0)),
        median(np.abs(off) / root) / 0.6745,
    )


def _peaks(values: Array) -> IntArray:
    """Return where values (B,) have a local maximum that is nearly the highest; a few of them."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    is_peak = (values >= padded[:-2]) & (values >= padded[2:]) & (values > np.max(values) - AS_GOOD)
    rows = np.flatnonzero(is_peak)
    return np.sort(rows[np.argsort(-values[rows])[:MOST_TRIED]])


@dataclass(frozen=True, eq=False)
class _Moved:
    """kappa and beta m/s^2 of the module's text; rest (P,) m/s of each pair; share of the changes explained."""

    kappa: complex
    beta: complex
    rest: Array
    share: float


@dataclass(frozen=True, eq=False)
class _Level:
    """Level samples at t (M,) s: force (M,) m/s^2, complex, along axes (2, 3) level with up_s (3,), and
    turn about up (M,) rad by rates as they are."""

    t: Array
    force: Array
    turn: Array
    axes: Array
    up_s: Array

    @classmethod
    def of(cls, imu: ImuSamples, averages: Averages, pairs: _Pairs, up_s: Array) -> "_Level":
        """Return it from before the first pair to after the last one."""
        t = np.arange(max(imu.t[0], pairs.since[0] - BESIDE), min(imu.t[-1], pairs.until[-1] + BESIDE), STEP)
        force, rate = averages.around(t, STEP)
        axes = so3.rotation_to_up(up_s)[:2]
        return cls(t, force @ axes[0] + 1j * (force @ axes[1]), np.cumsum(rate @ up_s) * STEP, axes, up_s)

    def turned_with(self, bias: float) -> "_Turned":
        """Return the integrals of the samples, turned by the rates less a bias about up, rad/s."""
        yaw = self.turn - bias * self.t
        turning = np.exp(1j * yaw)
        sums = [np.concatenate([[0.0], np.cumsum(each)]) * STEP for each in (self.force * turning, turning)]
        return _Turned(self.t, yaw, sums[0], sums[1])

    def mounting(self, moved: _Moved) -> Array:
        """R_bs (3, 3): forward by kappa, up by beta."""
        forward = np.real(moved.kappa) * self.axes[0] - np.imag(moved.kappa) * self.axes[1]
        forward = forward / max(float(np.linalg.norm(forward)), 1e-9)
        left = np.cross(self.up_s, forward)
        up = self.up_s + (np.real(moved.beta) * forward + np.imag(moved.beta) * left) / STANDARD_GRAVITY
        return so3.normalized(np.stack([forward, left, up / np.linalg.norm(up)]))

    def bias(self, averages: Averages, pairs: _Pairs, lag: float, about_up: float) -> Array:
        """gyro_bias_s (3,) rad/s: the mean rate over all pairs, since no kart rolls over, but for that about up."""
        _, turned = averages.between(pairs.since - lag, pairs.until - lag)
        mean = turned.sum(axis=0) / pairs.lasts.sum()
        return np.asarray(mean + (about_up - float(mean @ self.up_s)) * self.up_s)


@dataclass(frozen=True, eq=False)
class _Turned:
    """Turn `yaw` (M,) rad at t (M,) s; sums (M + 1,) of force so turned, and of turning itself, at the steps' edges."""

    t: Array
    yaw: Array
    force: Array
    turning: Array

    def moved(self, pairs: _Pairs, lag: float) -> _Moved:
        """Fit the changes of velocity of pairs that are late by `lag` s."""
        edges, at = np.append(self.t, self.t[-1] + STEP) - 0.5 * STEP, np.stack([pairs.since, pairs.until]) - lag
        force, turning = (np.diff(np.interp(at, edges, sums), axis=0)[0] for sums in (self.force, self.turning))
        # the courses at both ends tell how it all lies in the path's frame
        turned_by = np.exp(1j * (pairs.course - np.interp(at, self.t, self.yaw))).sum(axis=0)
        changes = pairs.change * np.conj(turned_by / np.maximum(np.abs(turned_by), 1e-9))
        design = np.stack([force, -turning], axis=1)
        weight = np.ones(len(changes))
        for _ in range(REWEIGHTED):
            weighted = (weight[:, None] * design).conj().T
            found = np.linalg.lstsq(weighted @ design, weighted @ changes, rcond=1e-12)[0]
            rest = np.abs(changes - design @ found)
            weight = 1.0 / (1.0 + (rest / (2.0 * median(rest) + 1e-9)) ** 2)
        share = 1.0 - float(weight @ rest**2) / max(float(weight @ np.abs(changes) ** 2), 1e-9)
        return _Moved(complex(found[0]), complex(found[1]), rest, share)
