"""What a recording holds beside the motion: engine speed, temperatures, pedals, heart rate, whatever has a name.

Channels that never change tell nothing and are left out. Names become those of columns, with the unit at their end.
"""

import re
from collections.abc import Iterable, Sequence

import numpy as np

from smoother.arrays import Array
from smoother.samples import Channel
from smoother.session.readers.names import parts_of
from smoother.session.readers.sheet import Sheet

MOST = 100  # channels
FEWEST_VALUES = 2
UNITS = {  # as files write them, in lower case: what stands behind a name
    **{"°c": "c", "c": "c", "degc": "c", "celsius": "c", "°f": "f", "f": "f", "degf": "f", "k": "k", "%": "pct"},
    **{"percent": "pct", "km/h": "kmh", "kmh": "kmh", "kph": "kmh", "mph": "mph", "m/s": "mps", "m/s2": "mps2"},
    **{"m/s²": "mps2", "deg/s": "dps", "deg/sec": "dps", "rad/s": "radps", "deg": "deg", "°": "deg", "g": "g"},
    **{"rpm": "rpm", "1/min": "rpm", "bar": "bar", "mbar": "mbar", "kpa": "kpa", "psi": "psi", "hpa": "hpa"},
    **{"v": "v", "volts": "v", "mv": "mv", "a": "a", "w": "w", "bpm": "bpm", "m": "m", "mm": "mm", "km": "km"},
    **{"s": "s", "sec": "s", "ms": "ms", "min": "min", "nm": "nm", "l/h": "lph", "lambda": "lambda", "µt": "ut"},
}
ALIASES = {  # letters and digits of names: what the channel is called
    **dict.fromkeys(("rpm", "enginerpm", "enginespeed", "motorspeed", "drehzahl", "cadencerpm"), "rpm"),
    **dict.fromkeys(("tps", "throttle", "throttlepos", "throttleposition", "throttlepct"), "throttle"),
    **dict.fromkeys(("watertemp", "watertemperature", "coolanttemp", "enginetemp", "ect"), "water_temp"),
    **dict.fromkeys(("steering", "steer", "steeringangle", "steerangle"), "steering"),
    **dict.fromkeys(("heartrate", "hr"), "heart_rate"),
    **dict.fromkeys(("wheelspeed", "vehiclespeed", "canspeed"), "wheel_speed"),
}
OF_TRAJECTORY = ("lap", "utc", "yaw_rate_dps", "roll_deg", "pitch_deg", "yaw_deg", "speed_mps", "t_s", "lap_distance_m")
NO_CHANNEL = re.compile(r"^(?:index|record|id|row|lap_?index|interval|utc|session_fragment.*|fragment_id)$")


def channels_of(timed: Sequence[tuple[Sheet, Array]]) -> tuple[Channel, ...]:
    """The channels of sheets, with the times (N,) s of the rows of each."""
    found = []
    for sheet, t in timed:
        for i, column in enumerate(sheet.columns):
            if any(i in places for places in sheet.places.values()):
                continue
            name, unit = parts_of(column.name)
            is_axis = name.lower() in ("x", "y", "z")
            of_sensor = f"{sheet.sensor} {name}" if is_axis and sheet.sensor else name
            found.append(channel_of(of_sensor, unit or column.unit, t, column.values))
    return distinct(channel for channel in found if channel is not None)


def channel_of(name: str, unit: str, t: Array, values: Array) -> Channel | None:
    """A channel of the rows that have a value (N,) at increasing times t (N,) s; None if it never changes."""
    rows = np.flatnonzero(np.isfinite(t) & np.isfinite(values))
    if rows.size < FEWEST_VALUES or not np.any(values[rows] != values[rows[0]]):
        return None
    rows = rows[np.argsort(t[rows], kind="stable")]
    rows = rows[np.append(True, np.diff(t[rows]) > 0.0)]
    called = column_name(name, unit)
    return None if NO_CHANNEL.match(called) else Channel(called, unit, t[rows], values[rows])


def column_name(name: str, unit: str) -> str:
    """What the column of a channel is called: lower case, words and unit with underscores between them."""
    letters = re.sub(r"[^a-z0-9]", "", name.lower())
    plain = ALIASES.get(letters) or re.sub(r"[^a-z0-9]+", "_", name.strip().lower()).strip("_") or "channel"
    suffix = UNITS.get(unit.strip().lower()) or re.sub(r"[^a-z0-9]+", "_", unit.strip().lower()).strip("_")
    called = plain if not suffix or plain == suffix or plain.endswith(f"_{suffix}") else f"{plain}_{suffix}"
    return f"logged_{called}" if called in OF_TRAJECTORY or called[:1].isdigit() else called


def distinct(channels: Iterable[Channel]) -> tuple[Channel, ...]:
    """The first of each name, and no more than MOST."""
    named: dict[str, Channel] = {}
    for channel in channels:
        named.setdefault(channel.name, channel)
    return tuple(named.values())[:MOST]
