"""Calibration: the values that turn counts in s into SI in s. Load, save, apply; estimates nothing."""

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from smoother.arrays import Array, frozen
from smoother.errors import ConfigError
from smoother.frames import Origin
from smoother.samples import ImuSamples, MagSamples, RawImu, RawMag, RawSession, Session


def _identity() -> Array:
    return np.eye(3)


def _zeros() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Sensor errors, all in s: `true = matrix @ (measured - offset)`; defaults change nothing.

    accel_offset (3,) m/s^2, accel_matrix (3, 3); gyro_bias (3,) rad/s, gyro_matrix (3, 3); hard_iron (3,) in the unit
    of the magnetometer, soft_iron (3, 3) such that the calibrated field has length 1; None if there is none.
    """

    accel_offset: Array = field(default_factory=_zeros)
    accel_matrix: Array = field(default_factory=_identity)
    gyro_bias: Array = field(default_factory=_zeros)
    gyro_matrix: Array = field(default_factory=_identity)
    hard_iron: Array | None = None
    soft_iron: Array | None = None

    def __post_init__(self) -> None:
        for name, shape in (
            ("accel_offset", (3,)),
            ("accel_matrix", (3, 3)),
            ("gyro_bias", (3,)),
            ("gyro_matrix", (3, 3)),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), shape, name))
        if (self.hard_iron is None) != (self.soft_iron is None):
            raise ValueError("hard_iron and soft_iron come together")
        if self.hard_iron is not None and self.soft_iron is not None:
            object.__setattr__(self, "hard_iron", frozen(self.hard_iron, (3,), "hard_iron"))
            object.__setattr__(self, "soft_iron", frozen(self.soft_iron, (3, 3), "soft_iron"))

    def apply(self, raw: RawSession, origin: Origin) -> Session:
        """Return the calibrated session, with n placed at `origin`."""
        return Session(
            name=raw.name,
            gnss=raw.gnss,
            origin=origin,
            imu=None if raw.imu is None else self.apply_to_imu(raw.imu),
            mag=None if raw.mag is None else self.apply_to_mag(raw.mag),
            config=raw.config,
            inputs=raw.inputs,
            problems=raw.problems,
            unix_at_zero=raw.unix_at_zero,
        )

    def apply_to_imu(self, raw: RawImu) -> ImuSamples:
        """Return inertial samples in SI, still in axes s."""
        force = (raw.accel * raw.accel_scale - self.accel_offset) @ self.accel_matrix.T
        rate = (raw.gyro * raw.gyro_scale - self.gyro_bias) @ self.gyro_matrix.T
        return ImuSamples(raw.t, force, rate, raw.accel_full_scale, raw.gyro_full_scale)

    def apply_to_mag(self, raw: RawMag) -> MagSamples:
        """Return the field as a unit vector's multiple where hard and soft iron are known, else as it was read."""
        if self.hard_iron is None or self.soft_iron is None:
            return MagSamples(raw.t, raw.field)
        return MagSamples(raw.t, (raw.field - self.hard_iron) @ self.soft_iron.T, is_calibrated=True)

    def with_magnetometer(self, hard_iron: Array, soft_iron: Array) -> "Calibration":
        """Return a copy with hard_iron (3,) and soft_iron (3, 3)."""
        return replace(self, hard_iron=hard_iron, soft_iron=soft_iron)


_TABLES = {
    "accelerometer": {"offset": "accel_offset", "matrix": "accel_matrix"},
    "gyroscope": {"bias": "gyro_bias", "matrix": "gyro_matrix"},
    "magnetometer": {"hard_iron": "hard_iron", "soft_iron": "soft_iron"},
}


def load_calibration(path: Path) -> Calibration:
    """Read calibration.toml. Raises ConfigError with file, key and remedy."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path.name}: not valid TOML ({error}); mend it or delete it") from error
    values: dict[str, Array] = {}
    for table, keys in _TABLES.items():
        section = document.get(table, {})
        if not isinstance(section, dict):
            raise ConfigError(f"{path.name}: {table} is not a table; write [{table}]")
        for key, name in keys.items():
            if key in section:
                values[name] = _numbers(
                    section[key], (3, 3) if key in ("matrix", "soft_iron") else (3,), path, table, key
                )
    if ("hard_iron" in values) != ("soft_iron" in values):
        raise ConfigError(f"{path.name}: [magnetometer] needs both hard_iron and soft_iron")
    return Calibration(**values)


def _numbers(value: object, shape: tuple[int, ...], path: Path, table: str, key: str) -> Array:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not np.all(np.isfinite(array)):
        wanted = " x ".join(map(str, shape))
        raise ConfigError(f"{path.name}: [{table}] {key} must be {wanted} finite numbers")
    return array
