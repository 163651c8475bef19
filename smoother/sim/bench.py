"""A simulated calibration recording: the logger on the bench, laid on its faces and edges, then turned in the hands.

What a person does by the guide in the README, sampled with the errors of :class:`ImuErrors` and :class:`MagErrors`
(vibration, jitter and gaps of which do not occur on a bench). The true values stand beside it, in the conventions of
the fits: a rotation of all axes of a sensor together cannot be seen by its own readings.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from scipy.ndimage import gaussian_filter1d

from smoother import so3
from smoother.arrays import Array
from smoother.samples import RawImu, RawMag
from smoother.sim.record import imu_table, mag_table, write_table
from smoother.sim.scenario import ImuErrors, MagErrors
from smoother.sim.sensors import converted, mag_reading
from smoother.units import STANDARD_GRAVITY

OUTLIER_SIZE = 100.0  # uT
WARM_UP = 300.0  # s, time constant of a logger that heats itself
_FACES = np.concatenate([np.eye(3), -np.eye(3)])[[2, 0, 1, 5, 3, 4]]  # first as it stands on a bench
_EDGES = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if abs(x) + abs(y) + abs(z) == 2]
)


@dataclass(frozen=True)
class BenchPlan:
    """What the person does, seconds each: lie still first, then `positions` rests with turns between, then wave.

    The first six positions are the faces, the others edges; `tilt` rad is how far off each is put down. hand: m/s^2 of
    acceleration while the logger is moved. warm_up: K by which the logger heats itself; temperature: deg C at first.
    """

    still: float = 60.0
    positions: int = 18
    rest: float = 8.0
    turn: float = 2.0
    waving: float = 60.0
    wave_turn: float = 1.2
    tilt: float = np.radians(5.0)
    hand: float = 0.5
    warm_up: float = 0.0
    temperature: float = 25.0


@dataclass(frozen=True, eq=False)
class BenchErrors:
    """Errors that a session's scenario has no figure for: gyro_slope (3,) rad/s/K; mag_outliers: their share;
    mag_delay s, by which the magnetometer's stamps are late.
    """

    gyro_slope: Array
    mag_outliers: float = 0.0
    mag_delay: float = 0.0


@dataclass(frozen=True, eq=False)
class BenchTruth:
    """What a calibration has to find, in the conventions of smoother.fit: see :func:`bench_truth`."""

    accel_offset: Array
    accel_matrix: Array
    gyro_matrix: Array
    hard_iron: Array
    soft_iron: Array


@dataclass(frozen=True, eq=False)
class BenchRecording:
    """Readings, and what was true: is_moved (N,) of the IMU samples; gyro_bias (N, 3) rad/s; R_ns (N, 3, 3)."""

    imu: RawImu
    mag: RawMag
    truth: BenchTruth
    imu_errors: ImuErrors
    errors: BenchErrors
    is_moved: np.ndarray
    gyro_bias: Array
    R_ns: Array


def bench_truth(imu: ImuErrors, mag: MagErrors, strength: float) -> BenchTruth:
    """Offsets and symmetric matrices of accelerometer and magnetometer; the gyroscope's leads to the former's axes."""
    accel = _symmetric_root(np.asarray(np.linalg.inv(imu.accel_matrix)))
    soft = _symmetric_root(np.asarray(np.linalg.inv(mag.soft_iron) / strength))
    gyro = accel @ imu.accel_matrix @ np.linalg.inv(imu.gyro_matrix)
    return BenchTruth(imu.accel_bias, accel, gyro, mag.hard_iron_s, soft)


def _symmetric_root(matrix: Array) -> Array:
    """Symmetric A (3, 3) with the same |A x| as `matrix` for all x."""
    _, values, rows = np.linalg.svd(matrix)
    return np.asarray(rows.T @ np.diag(values) @ rows)


def simulate_bench(
    imu: ImuErrors,
    mag: MagErrors,
    field_n: Array,
    rng: np.random.Generator,
    plan: BenchPlan | None = None,
    errors: BenchErrors | None = None,
) -> BenchRecording:
    """Return the readings of a logger handled as `plan` says, in the Earth's field field_n (3,) uT."""
    plan = BenchPlan() if plan is None else plan
    errors = BenchErrors(np.zeros(3)) if errors is None else errors
    motion_rng, imu_rng, mag_rng = rng.spawn(3)
    path = _Path.of(plan, motion_rng)
    t = np.arange(1, int(path.end * imu.rate) + 1) / imu.rate
    step = 1.0 / imu.rate
    temperature = plan.temperature + plan.warm_up * (1.0 - np.exp(-t / WARM_UP))
    bias = imu.gyro_bias + (temperature - plan.temperature)[:, None] * errors.gyro_slope
    bias = bias + imu.gyro_bias_walk * np.sqrt(step) * np.cumsum(imu_rng.standard_normal((len(t), 3)), axis=0)
    moved = path.is_moving(t) | path.is_moving(t - step)
    force = _force(path, t - 0.5 * step, moved, plan.hand, imu.rate, motion_rng) @ imu.accel_matrix.T + imu.accel_bias
    rate = so3.log(path.at(t - step).transpose(0, 2, 1) @ path.at(t)) / step @ imu.gyro_matrix.T + bias
    force = force + imu.accel_noise * np.sqrt(imu.rate) * imu_rng.standard_normal(force.shape)
    rate = rate + imu.gyro_noise * np.sqrt(imu.rate) * imu_rng.standard_normal(rate.shape)
    accel_counts, accel_scale = converted(force, imu.accel_range, imu.bits)
    gyro_counts, gyro_scale = converted(rate, imu.gyro_range, imu.bits)
    raw = RawImu(
        t, accel_counts, gyro_counts, accel_scale, gyro_scale, imu.accel_range, imu.gyro_range, np.round(temperature, 2)
    )
    truth = bench_truth(imu, mag, float(np.linalg.norm(field_n)))
    field = _field(path, mag, field_n, errors, mag_rng)
    return BenchRecording(raw, field, truth, imu, errors, moved, bias, path.at(t))


def write_bench(recording: BenchRecording, directory: Path) -> None:
    """Write imu.csv (with temp_c) and mag.csv into `directory`, made if need be."""
    directory.mkdir(parents=True, exist_ok=True)
    table = imu_table(recording.imu)
    if recording.imu.temperature is not None:
        table = table.with_columns(pl.Series("temp_c", recording.imu.temperature))
    write_table(table, directory / "imu.csv")
    write_table(mag_table(recording.mag), directory / "mag.csv")


# ---- how the logger is held -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Path:
    """Legs of constant axis: start (L + 1,) s; R_ns (L, 3, 3) at the start of each; turn (L, 3) rad about axes s."""

    start: Array
    R_ns: Array
    turn: Array

    @property
    def end(self) -> float:
        return float(self.start[-1])

    @staticmethod
    def of(plan: BenchPlan, rng: np.random.Generator) -> "_Path":
        """Draw the positions; each turn to the next is the shortest, with a smooth start and end."""
        edges = _EDGES[rng.permutation(len(_EDGES))]
        up = np.concatenate([_FACES, edges])[np.arange(max(plan.positions, 0)) % (len(_FACES) + len(edges))]
        poses = [_pose(direction, plan.tilt, rng) for direction in up] or [np.eye(3)]
        lengths, targets = [plan.still], [poses[0]]
        for pose in poses[1:] if plan.positions else []:
            lengths += [plan.turn, plan.rest]
            targets += [pose, pose]
        for _ in range(int(plan.waving / plan.wave_turn)):
            lengths.append(plan.wave_turn)
            targets.append(_any_attitude(rng))
        R = np.stack([poses[0], *targets])
        return _Path(np.concatenate([[0.0], np.cumsum(lengths)]), R[:-1], so3.log(R[:-1].transpose(0, 2, 1) @ R[1:]))

    def _leg(self, t: Array) -> np.ndarray:
        return np.clip(np.searchsorted(self.start, t, side="right") - 1, 0, len(self.turn) - 1)

    def at(self, t: Array) -> Array:
        """R_ns (N, 3, 3) at t (N,)."""
        leg = self._leg(t)
        length = np.diff(self.start)[leg]
        u = np.clip((t - self.start[leg]) / length, 0.0, 1.0)
        share = u - np.sin(2.0 * np.pi * u) / (2.0 * np.pi)
        return np.asarray(self.R_ns[leg] @ so3.exp(share[:, None] * self.turn[leg]))

    def is_moving(self, t: Array) -> np.ndarray:
        """Mask (N,) of the times within a turn."""
        return np.asarray(np.linalg.norm(self.turn[self._leg(t)], axis=1) > 1e-9)


def _pose(up_s: Array, tilt: float, rng: np.random.Generator) -> Array:
    """R_ns of a logger put down with the direction up_s (3,) up, off by `tilt`, and with any heading."""
    up = up_s / np.linalg.norm(up_s)
    off = so3.exp(tilt * rng.standard_normal(3)) @ up
    axis = np.cross(off, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(off[2])
    level = so3.exp(axis / sine * np.arctan2(sine, cosine)) if sine > 1e-9 else np.diag([1.0, cosine, cosine])
    return np.asarray(so3.exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])) @ level)


def _any_attitude(rng: np.random.Generator) -> Array:
    quaternion = rng.standard_normal(4)
    return so3.from_quaternion_wxyz(quaternion / np.linalg.norm(quaternion))


# ---- what the sensors make of it ------------------------------------------------------------------------------------


def _force(path: _Path, t: Array, moved: np.ndarray, hand: float, rate: float, rng: np.random.Generator) -> Array:
    """Specific force (N, 3): gravity, and while the logger is moved what the hand adds, slow against the samples."""
    push = gaussian_filter1d(rng.standard_normal((len(t), 3)), 0.1 * rate, axis=0)
    push *= hand / max(float(np.std(push)), 1e-12) * moved[:, None]
    up = path.at(t)[:, 2, :] * STANDARD_GRAVITY
    return np.asarray(up + push)


def _field(path: _Path, mag: MagErrors, field_n: Array, errors: BenchErrors, rng: np.random.Generator) -> RawMag:
    t = np.arange(1, int(path.end * mag.rate) + 1) / mag.rate
    strength = float(np.linalg.norm(field_n))
    field = path.at(t - errors.mag_delay).transpose(0, 2, 1) @ field_n
    reading = mag_reading(field, mag, strength, rng)
    bad = rng.random(len(t)) < errors.mag_outliers
    reading[bad] += OUTLIER_SIZE * rng.standard_normal((int(bad.sum()), 3))
    return RawMag(t, reading)
