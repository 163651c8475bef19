"""Initial noise of the graph, of fixes and samples by themselves."""

import math

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, median
from smoother.estimate.factors.graph import GraphOptions
from smoother.estimate.fixes.offset import UNFILTERED, OffsetModel, follows_positions, has_doppler, offset_model
from smoother.estimate.fixes.path import GnssPath
from smoother.estimate.initial.align import Alignment
from smoother.estimate.model.imu import BinnedImu, mostly_sampled
from smoother.estimate.model.noise import InertialNoise, Noise
from smoother.estimate.model.state import SIZES
from smoother.estimate.solvers.variance_components import OWN_SCATTER, SENSOR_SCALE, Scatter
from smoother.samples import Session
from smoother.units import DEG, STANDARD_GRAVITY

DATA_SHEET_ACCEL = 300e-6 * STANDARD_GRAVITY  # m/s^2/sqrt(Hz), MPU9250 product specification
DATA_SHEET_GYRO = 0.01 * DEG  # rad/s/sqrt(Hz), likewise
START_SHARE = 0.5  # of the residual of the alignment; the rest is not noise of the samples
ENOUGH_BINS = 40_000  # intervals that determine the scatter of bins; more than two hours
# m, north, west, up: initial scatter of a fix against the next, with Doppler and without; the identification reduces it
MOST_SCATTER, SOME_SCATTER = np.array([3.0, 3.0, 5.0]), np.array([0.3, 0.3, 0.5])


def first_noise(
    session: Session, path: GnssPath, alignment: Alignment, binned: BinnedImu, options: GraphOptions
) -> Noise:
    """Initial noise: of the fixes from their own smoothing, of the IMU from the residual of the alignment.

    It is too large, and the identification reduces it: from too little, with few fixes, it would converge to perfect
    samples and bad fixes.
    """
    stated = session.config.imu
    inertial = InertialNoise(
        stated.accel_noise
        or max(START_SHARE * alignment.accel_noise, _density(binned, binned.specific_force_s, DATA_SHEET_ACCEL)),
        stated.gyro_noise
        or max(START_SHARE * alignment.gyro_noise, _density(binned, binned.angular_rate_s, DATA_SHEET_GYRO)),
        stated.accel_bias_walk or options.accel_bias_walk,
        stated.gyro_bias_walk or options.gyro_bias_walk,
    )
    usual = OffsetModel(np.array(options.offset_sigma), options.offset_tau)
    offset = offset_model(session.gnss.t, path, usual, path.position_sigma[0] < UNFILTERED)
    position = path.position_sigma
    if follows_positions(session.gnss.t, path):
        position = np.maximum(position, MOST_SCATTER if has_doppler(path) else SOME_SCATTER)
    return Noise(
        inertial,
        position,
        path.velocity_sigma,
        offset.sigma,
        offset.tau,
        constants={name: np.full(SIZES[name], options.sigmas[name]) for name in SENSOR_SCALE},
        offset_tau_spread=offset.tau_spread,
    )


def _density(binned: BinnedImu, bins: Array, floor: float) -> float:
    """Noise density of bins (K, n, 3) of `binned`: second differences of white noise have six times its variance."""
    bins = bins if np.all(telling := mostly_sampled(binned.missing)) else bins[telling]
    if len(bins) > ENOUGH_BINS:  # a day: those within intervals, evenly taken, are as good
        some = bins[:: len(bins) // ENOUGH_BINS]
        second = some[:, 2:] - 2.0 * some[:, 1:-1] + some[:, :-2]
    else:
        flat = bins.reshape(-1, 3)
        second = flat[2:] - 2.0 * flat[1:-1] + flat[:-2]
    sigma = MAD_TO_SIGMA * median(np.abs(second).ravel())
    return max(floor, sigma * math.sqrt(binned.dt / 6.0))


def scatter_of(binned: BinnedImu) -> Scatter:
    """Return the densities that neighbouring bins show."""
    accel = _density(binned, binned.specific_force_s, 2.0 * DATA_SHEET_ACCEL / OWN_SCATTER)
    gyro = _density(binned, binned.angular_rate_s, 2.0 * DATA_SHEET_GYRO / OWN_SCATTER)
    return Scatter(accel, gyro)


# Velocities of fixes at rest: the weight of each for a bias that lasts through the session.

LASTS = 20.0  # s, time constant of the slow error of a velocity
LATER = 2.0  # s after which two velocities share their slow error alone
USUAL_SHARE, USUAL_FOR = 0.7, 5.0  # prior share of the variance of velocities at rest that is slow; s of its weight


def scale_at_rest(t: Array, velocity_n: Array, standing: BoolArray) -> float:
    """Factor of the sigma of each velocity at rest, so that all together have the information of correlated ones.

    t (N,) s; velocity_n (N, 3) m/s, NaN where unknown; standing (N,): at rest.
    A share r of their variance is slow, the rest white: the mean of n of them over LASTS has variance r + (1 - r)/n.
    """
    if len(t) < 2:
        return 1.0
    spacing = float(median(np.diff(t)))
    count = max(1.0, LASTS / spacing)
    share = _lasting_share(velocity_n[:, :2], standing, max(1, round(LATER / spacing)), spacing)
    return float(np.sqrt(1.0 + share * (count - 1.0)))


def _lasting_share(level: Array, standing: BoolArray, later: int, spacing: float) -> float:
    """Share of the variance of level velocities (N, 2) at rest that those `later` fixes on have in common."""
    stood = np.concatenate([[0], np.cumsum(standing)])
    throughout = np.flatnonzero(stood[later + 1 :] - stood[: -later - 1] == later + 1)
    pairs = level[throughout], level[throughout + later]
    known = np.all(np.isfinite(np.hstack(pairs)), axis=1)
    one, two = (values[known] for values in pairs)
    power = 0.5 * float(np.sum(one**2 + two**2))
    seconds = len(one) * spacing if power > 0.0 else 0.0
    shown = float(np.sum(one * two)) / power if power > 0.0 else 0.0
    share = (seconds * shown + USUAL_FOR * USUAL_SHARE) / (seconds + USUAL_FOR)
    return float(np.clip(share, 0.0, 1.0))
