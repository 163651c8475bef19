"""Attitude without delay: Madgwick's filter of the baseline on the stream, and its initial level."""

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.baseline.baseline import UNITY
from smoother.estimate.baseline.madgwick import BETA, ZETA, run_madgwick
from smoother.samples import ImuSamples, MagSamples

FASTEST = 250.0  # Hz; faster samples are averaged, at a loss of accuracy far below that of the filter


class MadgwickTracker:
    """The filter between batches. As in the baseline, readings are turned by the attitude at the start and the filter
    begins at unity. Without a calibrated field its yaw starts at zero and drifts."""

    def __init__(self) -> None:
        self._first: list[ImuSamples] = []
        self._R_0s: Array | None = None
        self._q, self._bias = UNITY, np.zeros(3)
        self._t = 0.0
        self._field: Array | None = None

    @property
    def is_started(self) -> bool:
        """Whether there is an attitude."""
        return self._R_0s is not None

    @property
    def R_ns(self) -> Array:
        """Attitude (3, 3) of the sensor; identity before the start."""
        return np.eye(3) if self._R_0s is None else so3.from_quaternion_wxyz(self._q[None])[0] @ self._R_0s

    def feed(self, imu: ImuSamples, mag: MagSamples | None) -> None:
        """Process samples, and the field received with them (used if calibrated)."""
        if mag is not None and mag.is_calibrated:
            self._field = mag.field_s[-1]
        if self._R_0s is None:
            self._begin(imu)
            return
        step, force, rate = _averaged(imu, self._t)
        self._t = float(imu.t[-1])
        field = None if self._field is None else np.tile(self._R_0s @ self._field, (len(step), 1))
        q, bias = run_madgwick(
            np.minimum(step, 0.5),  # s; over a longer gap the rotation is unknown
            force @ self._R_0s.T,
            rate @ self._R_0s.T - self._bias,
            field,
            self._q,
            BETA,
            ZETA,
        )
        self._q, self._bias = q[-1], self._bias + bias[-1]

    def _begin(self, imu: ImuSamples) -> None:
        self._first.append(imu)
        if imu.t[-1] - self._first[0].t[0] < 0.25:  # s of samples whose mean force is the initial up
            return
        up = np.mean(np.concatenate([part.specific_force_s for part in self._first]), axis=0)
        length = np.linalg.norm(up)
        R_ls = so3.rotation_to_up(up / length) if length > 0.0 else np.eye(3)
        if self._field is not None:  # the filter's x axis is magnetic north
            level = R_ls @ self._field
            R_ls = so3.exp(np.array([0.0, 0.0, -np.arctan2(level[1], level[0])])) @ R_ls
        self._R_0s, self._t, self._first = R_ls, float(imu.t[-1]), []


def _averaged(imu: ImuSamples, before: float) -> tuple[Array, Array, Array]:
    """Steps (M,) s, forces and rates (M, 3): samples, or means of neighbours at rates above FASTEST."""
    step = np.diff(imu.t, prepend=before)
    n = max(1, int(np.ceil(len(step) / max(1.0, FASTEST * float(np.sum(step))))))
    if n == 1:
        return step, imu.specific_force_s, imu.angular_rate_s
    first = np.arange(0, len(step), n)
    total = np.add.reduceat(step, first)
    force = np.add.reduceat(imu.specific_force_s * step[:, None], first, axis=0) / total[:, None]
    rate = np.add.reduceat(imu.angular_rate_s * step[:, None], first, axis=0) / total[:, None]
    return total, force, rate
