"""session.toml to SessionConfig: every key checked, a slip of the pen answered with the nearest known name."""

import datetime
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from smoother.arrays import Array, numbers
from smoother.config import GnssTiming, ImuNoise, MagnetometerUse, Mounting, SessionConfig
from smoother.documents import load_toml
from smoother.errors import ConfigError
from smoother.words import did_you_mean

ROTATION_TOLERANCE = 0.02  # largest error of R R^T: a matrix typed with two decimals is still meant as a rotation
LONGEST_LEVER_ARM = 20.0  # m; beyond, millimetres were written for metres
LONGEST_LATENCY = 5.0  # s
LONGEST_FILTER_DELAY = 0.2  # s; a low-pass of 5 Hz has 0.05
LARGEST_NUMBER = 1e300
DENSITIES = (1e-12, 1e3)  # SI; what is not within is no sensor's, and its square may be no number
DIRECTIONS: Mapping[str, tuple[float, float, float]] = {
    "forward": (1.0, 0.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "backward": (-1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}


def load_settings(path: Path) -> SessionConfig:
    """Read session.toml. Raises ConfigError naming file, key and remedy for anything it does not know."""
    return _settings(_Reader(path.name, load_toml(path)))


def rotation_from_axes(axes: str) -> Array:
    """R_bs (3, 3) of a sensor whose x, y and z axis point to the three body directions named, as "right-forward-up".

    Raises ValueError, saying why, unless the three are a right-handed set.
    """
    words = axes.lower().replace(",", "-").replace(" ", "-").split("-")
    words = [word for word in words if word]
    for word in words:
        if word not in DIRECTIONS:
            raise ValueError(f"{word!r} is no direction{did_you_mean(word, DIRECTIONS)}; use {', '.join(DIRECTIONS)}")
    if len(words) != 3:
        raise ValueError(f"has {len(words)} directions; name where x, y and z point, as in forward-left-up")
    R_bs = np.array([DIRECTIONS[word] for word in words]).T
    determinant = round(float(np.linalg.det(R_bs)))
    if determinant == 0:
        raise ValueError("names one direction and its line twice; x, y and z are at right angles")
    if determinant < 0:
        raise ValueError("is left-handed; turn one of the directions round")
    return R_bs


class _Reader:
    """One table of the file: hands out checked values, remembers which keys are known."""

    def __init__(self, file: str, values: Mapping[str, Any], table: str = "") -> None:
        self.file, self.values, self.table = file, values, table
        self.known: list[str] = []

    def fail(self, key: str, text: str) -> ConfigError:
        place = f"[{self.table}] {key}" if self.table else key
        return ConfigError(f"{self.file}: {place} {text}")

    def section(self, name: str) -> "_Reader":
        self.known.append(name)
        values = self.values.get(name, {})
        if not isinstance(values, Mapping):
            raise self.fail(name, f"is not a table; write [{name}]")
        return _Reader(self.file, values, name)

    def value(self, key: str, convert: Callable[[Any], Any]) -> Any:
        self.known.append(key)
        if key not in self.values:
            return None
        try:
            return convert(self.values[key])
        except ValueError as error:
            raise self.fail(key, str(error)) from error

    def finish(self) -> None:
        for key in self.values:
            if key not in self.known:
                raise self.fail(key, f"is unknown{did_you_mean(key, self.known)}; known: {', '.join(self.known)}")


def _settings(document: _Reader) -> SessionConfig:
    session, mounting = document.section("session"), document.section("mounting")
    imu, gps, magnetometer = document.section("imu"), document.section("gps"), document.section("magnetometer")
    config = SessionConfig(
        title=session.value("title", _text),
        driver=session.value("driver", _text),
        kart=session.value("kart", _text),
        track=session.value("track", _text),
        date=session.value("date", _date),
        notes=session.value("notes", _text),
        mounting=_mounting(mounting),
        imu=ImuNoise(
            accel_noise=imu.value("accel_noise", _density),
            gyro_noise=imu.value("gyro_noise", _density),
            accel_bias_walk=imu.value("accel_bias_walk", _density),
            gyro_bias_walk=imu.value("gyro_bias_walk", _density),
        ),
        imu_delay=imu.value("delay", _filter_delay),
        gps=GnssTiming(
            position_latency=gps.value("position_latency", _latency),
            velocity_latency=gps.value("velocity_latency", _latency),
        ),
        magnetometer=MagnetometerUse(
            use=magnetometer.value("use", _flag), declination_deg=magnetometer.value("declination_deg", _declination)
        ),
    )
    for table in (document, session, mounting, imu, gps, magnetometer):
        table.finish()
    return config


def _mounting(table: _Reader) -> Mounting:
    lever_arm_b = table.value("lever_arm_b", _lever_arm)
    matrix, from_axes = table.value("R_bs", _rotation), table.value("axes", _axes)
    if matrix is not None and from_axes is not None:
        raise table.fail("R_bs", "and axes say the same thing twice; keep one")
    return Mounting(lever_arm_b=lever_arm_b, R_bs=matrix if matrix is not None else from_axes)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError("must be a text in quotes")
    return value


def _date(value: Any) -> str:
    if isinstance(value, datetime.date):  # a datetime is one too
        return value.isoformat()[:10]
    try:
        return datetime.datetime.fromisoformat(_text(value).strip()).date().isoformat()
    except ValueError as error:
        raise ValueError("must be a date as 2024-05-31") from error


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError("must be true or false")
    return value


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("must be a finite number")
    if not abs(value) <= LARGEST_NUMBER:  # compared as it is: a whole number of TOML may be too long for a float
        raise ValueError("must be a finite number")
    return float(value)


def _density(value: Any) -> float:
    number, (low, high) = _number(value), DENSITIES
    if number <= 0.0:
        raise ValueError("must be greater than zero; leave it out to have it estimated")
    if not low <= number <= high:
        raise ValueError(f"must lie within {low:g} and {high:g}, in SI units; leave it out to have it estimated")
    return number


def _within(low: float, high: float, text: str) -> Callable[[Any], float]:
    """Conversion to a number from low to high; text : the bounds, for a message."""

    def convert(value: Any) -> float:
        number = _number(value)
        if not low <= number <= high:
            raise ValueError(f"must lie within {text}")
        return number

    return convert


_latency = _within(-LONGEST_LATENCY, LONGEST_LATENCY, f"{LONGEST_LATENCY:.0f} s; it is in seconds")
_filter_delay = _within(0.0, LONGEST_FILTER_DELAY, f"0 and {LONGEST_FILTER_DELAY:g} s; it is in seconds")
_declination = _within(-180.0, 180.0, "180 degrees, east positive")


def _lever_arm(value: Any) -> Array:
    arm = numbers(value, (3,))
    if np.max(np.abs(arm)) > LONGEST_LEVER_ARM or np.linalg.norm(arm) > LONGEST_LEVER_ARM:  # the square may overflow
        raise ValueError(f"is longer than {LONGEST_LEVER_ARM:.0f} m; it is in metres, from the IMU to the antenna")
    return arm


def _rotation(value: Any) -> Array:
    """The rotation nearest to the matrix as written (polar decomposition), if it is near one at all."""
    matrix = numbers(value, (3, 3))
    largest = np.max(np.abs(matrix))  # the product of wild numbers overflows
    if largest > 1.0 + ROTATION_TOLERANCE or np.max(np.abs(matrix @ matrix.T - np.eye(3))) > ROTATION_TOLERANCE:
        raise ValueError("is no rotation: its rows must have length 1 and stand at right angles")
    if np.linalg.det(matrix) < 0.0:
        raise ValueError("mirrors: its determinant is -1; turn one row or column round")
    left, _, right = np.linalg.svd(matrix)
    R_bs: Array = left @ right
    R_bs.flags.writeable = False
    return R_bs


def _axes(value: Any) -> Array:
    R_bs = rotation_from_axes(_text(value))
    R_bs.flags.writeable = False
    return R_bs
