"""The channels that formats with room for custom ones get, with the units that racers read."""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array
from smoother.export.rows import Rows
from smoother.export.source import Source
from smoother.units import KMH, STANDARD_GRAVITY


@dataclass(frozen=True)
class Channel:
    """A column of Rows under another name: value = column / factor, in `unit`."""

    name: str
    column: str
    unit: str
    factor: float = 1.0

    def of(self, rows: Rows) -> Array:
        """Return its values (N,)."""
        return rows[self.column] / self.factor

    def filled(self, rows: Rows) -> Array:
        """Return its values with 0 where there are none, for formats without blanks."""
        values = self.of(rows)
        return np.where(np.isfinite(values), values, 0.0)


G = STANDARD_GRAVITY
MOTION = (
    Channel("lateral_acc", "accel_left_mps2", "g", G),
    Channel("longitudinal_acc", "accel_forward_mps2", "g", G),
    Channel("vertical_acc", "accel_up_mps2", "g", G),
    Channel("yaw_rate", "yaw_rate_dps", "deg/s"),
    Channel("roll", "roll_deg", "deg"),
    Channel("pitch", "pitch_deg", "deg"),
    Channel("yaw", "yaw_deg", "deg"),
)
LAP = (
    Channel("lap", "lap", ""),
    Channel("lap_time", "lap_time_s", "s"),
    Channel("lap_distance", "lap_distance_m", "m"),
    Channel("delta", "delta_s", "s"),
)
DRIVEN = Channel("distance", "distance_m", "m")
SIGMAS = (
    Channel("sigma_track", "sigma_track_m", "m"),
    Channel("sigma_north", "sigma_north_m", "m"),
    Channel("sigma_west", "sigma_west_m", "m"),
    Channel("sigma_up", "sigma_up_m", "m"),
    Channel("sigma_speed", "sigma_speed_mps", "km/h", KMH),
    Channel("sigma_roll", "sigma_roll_deg", "deg"),
    Channel("sigma_pitch", "sigma_pitch_deg", "deg"),
    Channel("sigma_yaw", "sigma_yaw_deg", "deg"),
)
ALWAYS = ("accel_left_mps2", "accel_forward_mps2", "yaw_rate_dps", "distance_m")  # of the path, if of nothing else


LOGGED_UNITS = {  # of channels of the logger, by the end of their columns
    **{unit: unit for unit in ("mph", "rpm", "bar", "mbar", "psi", "bpm", "deg", "g", "m", "mm", "s")},
    **{"c": "C", "f": "F", "k": "K", "pct": "%", "kmh": "km/h", "mps": "m/s", "dps": "deg/s", "mps2": "m/s2"},
    **{"kpa": "kPa", "hpa": "hPa", "v": "V", "mv": "mV", "a": "A", "w": "W", "nm": "Nm"},
}
STANDARD: dict[str, dict[str, str]] = {  # channel of the logger: what programs call it
    "rpm": {"motec": "Engine RPM", "aim": "RPM", "racechrono": "rpm"},
    "throttle": {"motec": "Throttle Pos", "aim": "TPS", "racechrono": "throttle_pos"},
    "water_temp": {"motec": "Engine Temp", "aim": "Water Temp", "racechrono": "coolant_temp"},
    "steering": {"motec": "Steered Angle", "aim": "Steering Angle", "racechrono": "steering_angle"},
    "brake": {"motec": "Brake Pos", "aim": "Brake Pos", "racechrono": "brake_pos"},
    "heart_rate": {"motec": "Heart Rate", "aim": "Heart Rate", "racechrono": "heart_rate"},
}


def known_channels(source: Source) -> list[Channel]:
    """The channels of a session for formats without blanks: those known in every row, and the laps if there are any."""
    motion = [channel for channel in MOTION if channel.column in ALWAYS or source.has(channel.column)]
    sigmas = [channel for channel in SIGMAS if source.has(channel.column)]
    return [*motion, DRIVEN, *lap_channels(source), *sigmas, *logged_channels(source)]


def logged_channels(source: Source, program: str = "plain") -> list[Channel]:
    """The channels that the logger recorded beside the motion, under the names that a program has for them."""
    found: list[Channel] = []
    taken = {channel.name for channel in (*MOTION, *LAP, DRIVEN, *SIGMAS)}
    for channel in (_logged(column, program) for column in source.survey.logged):
        is_new = channel.name not in taken
        found.append(channel if is_new else replace(channel, name=f"logged_{channel.column}"))
        taken.add(found[-1].name)
    return found


def _logged(column: str, program: str) -> Channel:
    name, _, suffix = column.rpartition("_")
    unit = LOGGED_UNITS.get(suffix, "")
    plain = name if unit and name else column
    unit = unit or LOGGED_UNITS.get(column, "")
    standard = STANDARD.get(plain, {}).get(program)
    return Channel(standard or (plain if program == "plain" else plain.replace("_", " ").title()), column, unit)


def lap_channels(source: Source) -> list[Channel]:
    """The channels about laps that a session has: no laps, none; no track distance, no delta."""
    if not any(lap.is_timed for lap in source.laps):
        return []
    return [channel for channel in LAP if channel.column in ("lap", "lap_time_s") or source.best is not None]
