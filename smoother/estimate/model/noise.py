"""Noise of the sensors in the graph."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from smoother.arrays import Array
from smoother.estimate.model.imu import BinnedImu

MISSING_ACCEL = 8.0  # m/s^2, rms error of an interpolated force
MISSING_GYRO = 0.5  # rad/s likewise
LASTING = 1.0  # s, correlation time of both

Shape = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
ROUND: Shape = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class InertialNoise:
    """Densities of the graph's inertial factors: m/s^2/sqrt(Hz), rad/s/sqrt(Hz), and of the walks of the biases.

    accel and gyro are means over directions; accel_shape, gyro_shape are covariances (3, 3) in s over their squares, of
    trace 3.
    """

    accel: float
    gyro: float
    accel_bias_walk: float  # m/s^2/sqrt(s)
    gyro_bias_walk: float  # rad/s/sqrt(s)
    accel_share: float = 0.0  # of the variance at mean vibration, that follows the vibration
    gyro_share: float = 0.0
    accel_shape: Shape = ROUND
    gyro_shape: Shape = ROUND


def interval_noise(binned: BinnedImu, noise: InertialNoise) -> tuple[Array, Array]:
    """Densities (K-1,) of force and rate in each interval: by vibration, and greater where samples are missing."""
    accel, gyro = (
        density * np.sqrt(level)
        for density, level in zip((noise.accel, noise.gyro), levels(binned, noise), strict=True)
    )
    if not np.any(binned.missing):
        return accel, gyro
    unseen = np.sqrt(binned.missing) * unseen_density(hole_lengths(binned.missing, np.diff(binned.t)))
    return np.hypot(accel, MISSING_ACCEL * unseen), np.hypot(gyro, MISSING_GYRO * unseen)


def unseen_density(hole: Array) -> Array:
    """Density of the error of an interpolated motion of rms one, in holes of `hole` s.

    The error is correlated for the time of a bend. Means over holes of 0.1, 0.3, 1 and 3 s, interpolated as a line, are
    off by 0.04, 0.25, 0.35 and 0.35 rad/s (Adria's kart, worst axis) and by 0.01, 0.09, 0.24 and 0.25 (Lignano's); this
    gives 0.05, 0.13, 0.32 and 0.39.
    """
    return np.asarray(-np.expm1(-hole / LASTING) * np.sqrt(np.minimum(hole, 2.0 * LASTING)))


def hole_lengths(missing: Array, duration: Array) -> Array:
    """Length (K-1,) s of the hole that each interval, `duration` (K-1,) s long, is a part of; 0 without one.

    A hole is intervals in a row that miss samples, missing (K-1,) being the share.
    """
    empty = missing > 0.0
    number = np.cumsum(np.diff(empty, prepend=False) & empty)
    length = np.bincount(number, empty * missing * duration)
    return np.where(empty, length[number], 0.0)


def levels(binned: BinnedImu, noise: InertialNoise) -> tuple[Array, Array]:
    """Variances (K-1,) of force and of rate, by vibration, over those of the session."""
    if binned.rough is None:
        return np.ones(len(binned.missing)), np.ones(len(binned.missing))
    by_accel, by_gyro = binned.rough.T
    return 1.0 + noise.accel_share * (by_accel - 1.0), 1.0 + noise.gyro_share * (by_gyro - 1.0)


def shared_densities(binned: BinnedImu, noise: InertialNoise) -> tuple[Array, Array]:
    """Densities (K-1,) as :func:`interval_noise`, in steps of 2 % from the session's: intervals share a handful."""
    accel, gyro = interval_noise(binned, noise)
    steps = 50.0  # to a natural logarithm
    return (
        noise.accel * np.exp(np.round(steps * np.log(accel / noise.accel)) / steps),
        noise.gyro * np.exp(np.round(steps * np.log(gyro / noise.gyro)) / steps),
    )


@dataclass(frozen=True, eq=False)
class Noise:
    """inertial: densities of the samples and walks of the biases. position m, velocity m/s (3,): white noise of fixes,
    per axis of n. offset_sigma (3,) m, offset_tau s: the slow error of the fixes, a Gauss-Markov process. slip rad:
    sideslip in a hard corner, None without wheels. constants: prior sigmas by name that are identified with the noise.
    sigmas: of the rows of factors whose sigma is identified from their residuals alone, by the factor's name.
    offset_tau_spread: sigma of the logarithm of offset_tau where the session shows it, infinite where it is the
    population's.
    """

    inertial: InertialNoise
    position: Array
    velocity: Array
    offset_sigma: Array
    offset_tau: float
    slip: float | None = None
    constants: Mapping[str, Array] = field(default_factory=dict)
    offset_tau_spread: float = math.inf
    sigmas: Mapping[str, float] = field(default_factory=dict)
