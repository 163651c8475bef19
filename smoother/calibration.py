"""Calibration: the values that turn counts in s into SI in s. Load, save, apply; estimates nothing."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TypeGuard

import numpy as np

from smoother.arrays import Array, frozen, numbers
from smoother.disc import pieces, release, roomy
from smoother.documents import load_toml, replacing
from smoother.errors import ConfigError
from smoother.frames import Origin
from smoother.samples import SENSOR_AXES, AppliedValue, ImuSamples, MagSamples, RawImu, RawMag, RawSession, Session
from smoother.words import did_you_mean

FILE_NAME = "calibration.toml"
WILD = 1e9  # in any unit: no calibration has such a number, and products of them overflow


def _identity() -> Array:
    return np.eye(3)


def _zeros() -> Array:
    return np.zeros(3)


def _nothing() -> Mapping[str, Array]:
    return MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Calibration:
    """Sensor errors, all in s: `true = matrix @ (measured - offset)`; defaults change nothing.

    accel_offset (3,) m/s^2, accel_matrix (3, 3); gyro_bias (3,) rad/s, gyro_matrix (3, 3); hard_iron (3,) in the unit
    of the magnetometer, soft_iron (3, 3) such that the calibrated field has length 1; None if there is none.
    gyro_bias_slope (3,) rad/s/K and gyro_temperature deg C: where a sample has a temperature T, its bias is
    `gyro_bias + gyro_bias_slope (T - gyro_temperature)`, T held within gyro_temperature_span. `sigmas` maps names of
    these fields to one standard deviation, of the same shape. `source` names the file or data they come from.
    """

    accel_offset: Array = field(default_factory=_zeros)
    accel_matrix: Array = field(default_factory=_identity)
    gyro_bias: Array = field(default_factory=_zeros)
    gyro_matrix: Array = field(default_factory=_identity)
    hard_iron: Array | None = None
    soft_iron: Array | None = None
    gyro_bias_slope: Array = field(default_factory=_zeros)
    gyro_temperature: float = 25.0
    gyro_temperature_span: tuple[float, float] = (-np.inf, np.inf)
    sigmas: Mapping[str, Array] = field(default_factory=_nothing)
    source: str = ""

    def __post_init__(self) -> None:
        for name, shape in _SHAPES.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name), shape, name))
        if (self.hard_iron is None) != (self.soft_iron is None):
            raise ValueError("hard_iron and soft_iron come together")
        known = {name: frozen(value, _SHAPES[name], f"sigma of {name}") for name, value in self.sigmas.items()}
        object.__setattr__(self, "sigmas", MappingProxyType(known))

    def apply(self, raw: RawSession, origin: Origin) -> Session:
        """Return the calibrated session, with n placed at `origin`."""
        return Session(
            name=raw.name,
            gnss=raw.gnss,
            origin=origin,
            imu=None if raw.imu is None else self.apply_to_imu(raw.imu),
            mag=None if raw.mag is None else self.apply_to_mag(raw.mag),
            wheel_speed=raw.wheel_speed,
            channels=raw.channels,
            config=raw.config,
            inputs=raw.inputs,
            problems=raw.problems,
            unix_at_zero=raw.unix_at_zero,
            calibration=self.applied(raw.imu is not None, raw.mag is not None),
        )

    def apply_to_imu(self, raw: RawImu) -> ImuSamples:
        """Return inertial samples in SI, still in axes s."""
        force, rate, temperature = roomy(raw.accel.shape), roomy(raw.gyro.shape), raw.temperature
        for part in pieces(len(raw.t)):
            bias = self.gyro_bias_at(None if temperature is None else temperature[part])
            force[part] = (raw.accel[part] * raw.accel_scale - self.accel_offset) @ self.accel_matrix.T
            rate[part] = (raw.gyro[part] * raw.gyro_scale - bias) @ self.gyro_matrix.T
            release(raw, force, rate)
        for values in (force, rate):
            values.flags.writeable = False
        return ImuSamples(
            raw.t, force, rate, raw.accel_full_scale, raw.gyro_full_scale, raw.longest_step, raw.stamp_sigma
        )

    def gyro_bias_at(self, temperature: Array | None) -> Array:
        """Bias (3,) or, where temperatures (N,) deg C are known, (N, 3) rad/s; an unknown one counts as the usual."""
        if temperature is None or not np.any(self.gyro_bias_slope):
            return self.gyro_bias
        inside = np.clip(temperature, *self.gyro_temperature_span)
        warmer = np.where(np.isfinite(temperature), inside - self.gyro_temperature, 0.0)
        return np.asarray(self.gyro_bias + warmer[:, None] * self.gyro_bias_slope)

    def apply_to_mag(self, raw: RawMag) -> MagSamples:
        """Return the field as a unit vector's multiple where hard and soft iron are known, else as it was read."""
        if self.hard_iron is None or self.soft_iron is None:
            return MagSamples(raw.t, raw.field)
        return MagSamples(raw.t, (raw.field - self.hard_iron) @ self.soft_iron.T, is_calibrated=True)

    def with_magnetometer(self, hard_iron: Array, soft_iron: Array) -> "Calibration":
        """Return a copy with hard_iron (3,) and soft_iron (3, 3)."""
        return replace(self, hard_iron=hard_iron, soft_iron=soft_iron)

    def applied(self, has_imu: bool = True, has_mag: bool = True) -> tuple[AppliedValue, ...]:
        """What :meth:`apply` changes in a recording that has these sensors; nothing for values that change nothing."""
        nothing, found = Calibration(), []
        for name, unit in _UNITS.items():
            is_of_mag = name in ("hard_iron", "soft_iron")
            value = getattr(self, name)
            if (
                value is None
                or np.array_equal(value, getattr(nothing, name))
                or not (has_mag if is_of_mag else has_imu)
            ):
                continue
            sigma = tuple(self.sigmas[name].tolist()) if name in self.sigmas else None
            found.append(AppliedValue(name, tuple(value.tolist()), sigma, unit, self.source))
        return tuple(found)


_SHAPES: dict[str, tuple[int, ...]] = {
    "accel_offset": (3,),
    "accel_matrix": (3, 3),
    "gyro_bias": (3,),
    "gyro_matrix": (3, 3),
    "gyro_bias_slope": (3,),
    "hard_iron": (3,),
    "soft_iron": (3, 3),
}
_UNITS = {
    "accel_offset": "m/s^2",
    "accel_matrix": "",
    "gyro_bias": "rad/s",
    "gyro_bias_slope": "rad/s/K",
    "gyro_matrix": "",
    "hard_iron": "of the readings",
    "soft_iron": "per unit of the readings",
}
_LARGEST = {"accel_offset": 10.0, "gyro_bias": 4.0, "gyro_bias_slope": 0.1}  # length; an offset of gravity is none
_STRETCHES = (0.7, 1.4)  # by matrices of accelerometers and gyroscopes; the cheapest are off by a tenth
_TABLES = {
    "accelerometer": {"offset": "accel_offset", "matrix": "accel_matrix"},
    "gyroscope": {"bias": "gyro_bias", "bias_per_kelvin": "gyro_bias_slope", "matrix": "gyro_matrix"},
    "magnetometer": {"hard_iron": "hard_iron", "soft_iron": "soft_iron"},
}
_TEMPERATURES = ("temperature", "temperature_span")  # of the gyroscope
_NOTES = {  # what `smooth calibrate` writes beside them, for people
    "accelerometer": ("positions",),
    "gyroscope": ("noise_covariance", "rest_s", "turns"),
    "magnetometer": ("coverage", "semi_axes", "axes_turned", "axes_turned_sigma", "assumed", "level_hard_iron_sigma"),
}
_NOT_USED = "magnetometer_in_kart"  # a table that earlier versions wrote as information


def find_calibration(directory: Path) -> Path | None:
    """Return the calibration.toml of a session: in its directory, else in the one above, which holds all sessions.

    A session that comes with its truth (simulated, or a reference set) has sensors of its own: there only the first.
    """
    if (directory / FILE_NAME).is_file():
        return directory / FILE_NAME
    above = directory / ".." / FILE_NAME
    return above if above.is_file() and not (directory / "truth.csv").exists() else None


def load_calibration(path: Path) -> Calibration:
    """Read calibration.toml; tables and keys that are only for people are passed over.

    Raises ConfigError with file, key and remedy, also for what seems to be meant for a sensor and is not known.
    """
    document = _document(path)
    _require_known(document, path)
    values: dict[str, Array] = {}
    sigmas: dict[str, Array] = {}
    for table, keys in _TABLES.items():
        section = _section(document, table, path)
        for key, name in keys.items():
            if key in section:
                values[name] = _numbers(section[key], _SHAPES[name], path, table, key)
                _require_credible(name, values[name], path, table, key)
            if key in section and f"{key}_sigma" in section:
                sigmas[name] = _numbers(section[f"{key}_sigma"], _SHAPES[name], path, table, f"{key}_sigma")
                if np.any(sigmas[name] < 0.0):
                    raise ConfigError(f"{path.name}: [{table}] {key}_sigma is negative; a standard deviation is not")
    if ("hard_iron" in values) != ("soft_iron" in values):
        raise ConfigError(f"{path.name}: [magnetometer] needs both hard_iron and soft_iron")
    source = f"../{path.name}" if path.parent.name == ".." else path.name
    found = Calibration(**values, sigmas=sigmas, source=source)  # type: ignore[arg-type]
    gyro = _section(document, "gyroscope", path)
    if "bias_per_kelvin" not in gyro:
        return found
    if "temperature" not in gyro:
        raise ConfigError(f"{path.name}: [gyroscope] bias_per_kelvin needs the temperature at which bias holds")
    span = gyro.get("temperature_span", [-np.inf, np.inf])
    if not _is_span(span):
        raise ConfigError(f"{path.name}: [gyroscope] temperature_span must be two numbers, lowest and highest")
    at = float(_numbers(gyro["temperature"], (), path, "gyroscope", "temperature"))
    return replace(found, gyro_temperature=at, gyro_temperature_span=(float(span[0]), float(span[1])))


def _require_known(document: Mapping[str, object], path: Path) -> None:
    """Raise ConfigError for a misspelt table or one that holds keys of a sensor; other tables and texts are notes."""
    for name, section in document.items():
        if name in _TABLES and isinstance(section, dict):
            _require_known_keys(name, section, path)
        elif name not in (*_TABLES, _NOT_USED) and not isinstance(section, str):
            near = did_you_mean(name, _TABLES, 0.7)  # of names that are meant for one another, as difflib counts
            inside = section if isinstance(section, dict) else {name}
            if near or any(key in keys for key in inside for keys in _TABLES.values()):
                raise ConfigError(f"{path.name}: {name} is unknown{near}; known tables: {', '.join(_TABLES)}")


def _require_known_keys(table: str, section: Mapping[str, object], path: Path) -> None:
    """The same for the keys of a sensor's table."""
    values = [name for key in _TABLES[table] for name in (key, f"{key}_sigma")]
    values += _TEMPERATURES if table == "gyroscope" else ()
    for key, value in section.items():
        if key not in (*values, *_NOTES[table]) and not isinstance(value, str):
            near = did_you_mean(key, values)
            raise ConfigError(f"{path.name}: [{table}] {key} is unknown{near}; known: {', '.join(values)}")


def _is_span(span: object) -> TypeGuard[list[float]]:
    """Whether a value of the file is two numbers in order; either may be infinite."""
    if not isinstance(span, list) or len(span) != 2:
        return False
    if any(isinstance(end, bool) or not isinstance(end, int | float) for end in span):
        return False
    return bool(span[0] <= span[1] and all(abs(end) == np.inf or abs(end) < 1e9 for end in span))


def save_calibration(path: Path, calibration: Calibration, notes: Mapping[str, Mapping[str, object]]) -> None:
    """Write calibration.toml: the values that change something, their sigmas, and `notes`, keys by table, for people.

    A key of `notes` that is a text starting with # becomes a comment of the table.
    """
    applied = {value.quantity: value for value in calibration.applied()}
    lines = [
        "# Written by `smooth calibrate`. true = matrix (measured - offset), in the sensor's own axes; SI units.",
        "# `smooth SESSION` uses this file when it lies in the folder of the session, or in the folder above.",
    ]
    for table in dict.fromkeys([*_TABLES, *notes]):
        body: list[str] = []
        for key, name in _TABLES.get(table, {}).items():
            if name in applied:
                body.append(f"{key} = {toml_value(applied[name].value)}")
            if name in applied and applied[name].sigma is not None:
                body.append(f"{key}_sigma = {toml_value(applied[name].sigma)}")
        if table == "gyroscope" and "gyro_bias_slope" in applied:
            body.append(f"temperature = {toml_value(calibration.gyro_temperature)}")
            if np.all(np.isfinite(calibration.gyro_temperature_span)):
                body.append(f"temperature_span = {toml_value(calibration.gyro_temperature_span)}")
        for key, note in notes.get(table, {}).items():
            body.append(str(note) if str(note).startswith("#") else f"{key} = {toml_value(note)}")
        if body:
            lines += ["", f"[{table}]", *body]
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def load_notes(path: Path, newer: Calibration) -> dict[str, dict[str, object]]:
    """Return what calibration.toml holds for people, by table, except of sensors that `newer` has values for."""
    notes: dict[str, dict[str, object]] = {}
    changed = {value.quantity for value in newer.applied()}
    for table, section in _flattened(_document(path)).items():
        if any(name in changed for name in _TABLES.get(table, {}).values()):
            continue
        own = {key for name in _TABLES.get(table, {}) for key in (name, f"{name}_sigma")}
        own |= set(_TEMPERATURES) if table == "gyroscope" else set()
        kept = {key: value for key, value in section.items() if key not in own}
        if kept:
            notes[table] = kept
    return notes


def _flattened(document: Mapping[str, object], prefix: str = "") -> dict[str, dict[str, object]]:
    """Tables of tables as tables with dotted names."""
    found: dict[str, dict[str, object]] = {}
    for name, section in document.items():
        if isinstance(section, dict):
            found[prefix + name] = {key: value for key, value in section.items() if not isinstance(value, dict)}
            found |= _flattened({key: value for key, value in section.items() if isinstance(value, dict)}, f"{name}.")
    return found


def toml_value(value: object) -> str:
    """Return a number, text, truth value, or nested sequences of them as TOML, numbers to nine digits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else " " for c in escaped) + '"'
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float | np.floating):
        text = f"{float(value):.9g}"
        return text if any(c in text for c in ".en") else text + ".0"
    if isinstance(value, np.ndarray):
        value = value.tolist()
    assert isinstance(value, list | tuple), value
    return "[" + ", ".join(toml_value(item) for item in value) + "]"


def merged(older: Calibration, newer: Calibration) -> Calibration:
    """Return `older` with everything that `newer` determines; values of a sensor that it does not know are kept."""
    changed = {value.quantity for value in newer.applied()}
    values = {f.name: getattr(newer if f.name in changed else older, f.name) for f in fields(Calibration)}
    if "gyro_bias" in changed:  # bias and its temperature belong together
        for name in ("gyro_bias_slope", "gyro_temperature", "gyro_temperature_span"):
            values[name] = getattr(newer, name)
    values["sigmas"] = {
        **{name: sigma for name, sigma in older.sigmas.items() if name not in changed},
        **{name: sigma for name, sigma in newer.sigmas.items() if name in changed},
    }
    values["source"] = newer.source or older.source
    return Calibration(**values)


def _document(path: Path) -> dict[str, object]:
    return load_toml(path, "mend it or delete it")


def _section(document: dict[str, object], table: str, path: Path) -> dict[str, object]:
    section = document.get(table, {})
    if not isinstance(section, dict):
        raise ConfigError(f"{path.name}: {table} is not a table; write [{table}]")
    return section


def _numbers(value: object, shape: tuple[int, ...], path: Path, table: str, key: str) -> Array:
    try:
        return numbers(value, shape, WILD)
    except ValueError as error:
        raise ConfigError(f"{path.name}: [{table}] {key} {error}") from error


def _require_credible(name: str, value: Array, path: Path, table: str, key: str) -> None:
    """Raise ConfigError for values that no sensor needs: they would be applied, and make nonsense of the samples."""
    if name in _LARGEST and float(np.linalg.norm(value)) > _LARGEST[name]:
        most = f"{_LARGEST[name]:g} {_UNITS[name]}"
        raise ConfigError(f"{path.name}: [{table}] {key} is larger than {most}, more than of any sensor; mend it")
    if value.shape != (SENSOR_AXES, SENSOR_AXES):
        return
    least, _, most_stretched = sorted(np.linalg.svd(value, compute_uv=False).tolist())
    low, high = _STRETCHES
    if name == "soft_iron" and not least > 0.1 * most_stretched:  # least stretch of a soft iron, of its most
        raise ConfigError(f"{path.name}: [{table}] {key} makes a disc of the field; calibrate again, or delete it")
    if name != "soft_iron" and not low < least <= most_stretched < high:
        text = f"stretches by {least:.3g} to {most_stretched:.3g}, where sensors need 0.9 to 1.1"
        raise ConfigError(f"{path.name}: [{table}] {key} {text}; mend it or delete it")
