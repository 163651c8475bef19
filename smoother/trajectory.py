"""Trajectory: what every estimator returns, baseline and smoother alike, on the same axes and with the same names."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from smoother.arrays import Array, BoolArray, freeze, require_increasing
from smoother.disc import thinned
from smoother.frames import euler_from_rotation
from smoother.samples import Problem


@dataclass(frozen=True, eq=False)
class NavState:
    """Attitude R_nb (3, 3), position_n (3,) m and velocity_n (3,) m/s at one instant."""

    R_nb: Array
    position_n: Array
    velocity_n: Array


@dataclass(frozen=True, eq=False)
class Sigmas:
    """One standard deviation per row of a trajectory, NaN where the estimator has none.

    position_n (N, 3) m, absolute, with the GPS offset in it; velocity_n (N, 3) m/s; speed (N,) m/s, horizontal;
    attitude (N, 3) rad of roll, pitch, yaw; track (N,) m, horizontal position per axis with the GPS offset removed.
    """

    position_n: Array
    velocity_n: Array
    speed: Array
    attitude: Array
    track: Array

    def __post_init__(self) -> None:
        n = len(self.track)
        freeze(self, position_n=(n, 3), velocity_n=(n, 3), speed=(n,), attitude=(n, 3), track=(n,))


@dataclass(frozen=True)
class Identified:
    """A value of the whole session. `source` is configured, identified or default; `observable`: the data pinned it.

    sigma has the shape of the value, but for `R_bs`, a rotation (3, 3), of which it is that of turns (3,) about b, rad.
    """

    value: float | list[float] | list[list[float]]
    sigma: float | list[float] | list[list[float]] | None
    unit: str
    observable: bool
    source: str


WHITENED = "sigma"  # unit of residuals that have no other: each beyond what those before it say


@dataclass(frozen=True)
class ResidualStatistics:
    """Residuals of one kind of factor: mean and rms in `unit`, rms divided by sigma, and how many were rejected."""

    unit: str
    count: int
    mean: float
    rms: float
    normalised_rms: float
    rejected: int


@dataclass(frozen=True, eq=False)
class FixResiduals:
    """Per used fix: its index among the session's fixes (N,), residual_n (N, 3) m, and robust weight (N,) in 0..1."""

    index: np.ndarray
    residual_n: Array
    weight: Array


@dataclass(frozen=True, eq=False)
class Keyframes:
    """The estimator's own states, before densifying. t (K,) s; accel_bias_s (K, 3) m/s^2, gyro_bias_s (K, 3) rad/s.

    position_n, velocity_n (K, 3) of the antenna; R_nb (K, 3, 3) of the kart; covariance (K, 9, 9) of the error in
    (rotation vector in n of the kart's attitude: truth = exp(error) @ estimate; velocity_n; position_n). What no
    measurement of the session shows of the fixes' slow error, the same at all times, has the variance
    unseen_offset (3,) m^2, which is in every position's.
    """

    t: Array
    position_n: Array
    velocity_n: Array
    R_nb: Array
    covariance: Array
    accel_bias_s: Array
    gyro_bias_s: Array
    sigma_accel_bias: Array
    sigma_gyro_bias: Array
    gps_offset_n: Array | None = None  # (K, 3) m, the slow error of the fixes
    unseen_offset: Array | None = None


BOX_ON_WHEEL = (
    "box_on_wheel"  # the problem of a logger that turns with the steering wheel, whose attitude is not the kart's
)

IMU_SHAKEN = "imu_shaken"  # the problem of samples that the engine's vibration is folded into

MIRRORED_AXES, UNLIKE_AXES = "imu_mirrored", "imu_axes_disagree"  # problems of axes that no mounting explains


@dataclass(frozen=True, eq=False)
class EstimateReport:
    """What an estimator found out besides the trajectory, for summary.json and the figures."""

    identified: dict[str, Identified] = field(default_factory=dict)
    residuals: dict[str, ResidualStatistics] = field(default_factory=dict)
    fixes: FixResiduals | None = None
    keyframes: Keyframes | None = None
    problems: tuple[Problem, ...] = ()
    left_out: BoolArray | None = None  # (F,) fixes of which no position was used, as `problems` say; None: all were
    timings: dict[str, float] = field(default_factory=dict)  # s per stage
    mode: str = "full"  # "full" or "gps-only"


class JointPosition(Protocol):
    """How the errors of positions at several times hang together: what decides a lap time's sigma."""

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """Covariance (m, m) m^2 of `direction_n[i] . error of position_n(t[i])`.

        t (m,) s, in any order; direction_n (m, 3), unit vectors in n. The error is the whole one of the antenna's
        absolute position, the slow GPS offset and the constants of the session included.
        """
        ...


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Dense estimate in n. t (N,) s on the session clock; NaN where the estimator has no value.

    position_n, velocity_n (N, 3) of the antenna, m and m/s; R_nb (N, 3, 3) of the kart; acceleration_b (N, 3) m/s^2
    of the IMU, kinematic (gravity removed); angular_rate_b (N, 3) rad/s.
    """

    t: Array
    position_n: Array
    velocity_n: Array
    R_nb: Array
    acceleration_b: Array
    angular_rate_b: Array
    sigmas: Sigmas | None = None
    report: EstimateReport = field(default_factory=EstimateReport)
    joint: JointPosition | None = None  # None: only the sigmas of single times are known

    def __post_init__(self) -> None:
        n = len(self.t)
        freeze(self, t=(n,), position_n=(n, 3), velocity_n=(n, 3), R_nb=(n, 3, 3))
        freeze(self, acceleration_b=(n, 3), angular_rate_b=(n, 3))
        require_increasing(self.t, "Trajectory.t")

    def __len__(self) -> int:
        return len(self.t)

    def every(self, step: int) -> "Trajectory":
        """Return each `step`-th row, the first one included; the report and the joint covariance stay as they are."""
        return self if step == 1 else self._taken(lambda values: thinned(values, step))

    def rows(self, rows: slice) -> "Trajectory":
        """Return some of the rows; the report and the joint covariance stay as they are."""
        return self._taken(lambda values: values[rows])

    def _taken(self, take: Callable[[Array], Array]) -> "Trajectory":
        sigmas = self.sigmas
        return Trajectory(
            take(self.t),
            take(self.position_n),
            take(self.velocity_n),
            take(self.R_nb),
            take(self.acceleration_b),
            take(self.angular_rate_b),
            None if sigmas is None else Sigmas(*map(take, vars(sigmas).values())),
            self.report,
            self.joint,
        )

    @property
    def speed(self) -> Array:
        """Horizontal speed of the antenna, (N,) m/s."""
        return np.asarray(np.hypot(self.velocity_n[:, 0], self.velocity_n[:, 1]))

    @property
    def euler(self) -> Array:
        """Roll, pitch, yaw of the kart, (N, 3) rad."""
        return np.stack(euler_from_rotation(self.R_nb), axis=-1)
