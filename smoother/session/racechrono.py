"""RaceChrono CSV version 3: lines about the session, then three header rows (names, units, sources) and the values.

Names repeat where several sources give the same quantity: that of the receiver is taken. A cell may be blank.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.errors import SessionError
from smoother.samples import Problem, RawImu
from smoother.session.fixes import interpolated_note
from smoother.session.foreign import (
    ACCELERATION_UNITS,
    LENGTH_UNITS,
    RATE_UNITS,
    SPEED_UNITS,
    ForeignReading,
    factor,
    fixes_from,
    imu_from,
    incomplete_note,
    seconds_since_first,
    speed_unit_note,
)
from smoother.session.interpolated import FEW_BETWEEN, between_samples, rows_at_knots
from smoother.session.records import head_of, read_records
from smoother.session.table_header import is_number
from smoother.words import listed

WHAT = "RaceChrono CSV of version 3"
MARKS = ("racechrono", "format,3")
OLD_TIMESTAMP = "timestamp (s)"
NEEDED = ("timestamp", "latitude", "longitude")
OPTIONAL = ("altitude", "speed", "bearing", "accuracy", "satellites", "fix_type")
LONGEST_APART = 0.1  # s between the samples of one sensor, beyond which those of another are not interpolated
FEWEST_SAMPLES = 100  # that show by noise which of them were measured
ACCELERATIONS = ("x_acc", "y_acc", "z_acc")
RATES = ("x_rate_of_rotation", "y_rate_of_rotation", "z_rate_of_rotation")


@dataclass(frozen=True)
class _Columns:
    """Header rows: names, units and sources of every column, lower case; `keys` are the names made different."""

    names: list[str]
    units: list[str]
    sources: list[str]

    @property
    def keys(self) -> list[str]:
        return [f"{name} #{i}" for i, name in enumerate(self.names)]

    def place(self, name: str, source: str) -> int | None:
        """Column of that name, from that source if one says so, else the first."""
        places = [i for i, other in enumerate(self.names) if other == name]
        return next((i for i in places if source in self.sources[i]), places[0] if places else None)


def read_racechrono(path: Path) -> ForeignReading:
    """Read a RaceChrono CSV. Raises SessionError, one line, where it is none or nothing in it can be used."""
    columns, offset = _header(path)
    places = {name: columns.place(name, "gps") for name in (*NEEDED, *OPTIONAL)}
    missing = [name for name in NEEDED if places[name] is None]
    if missing:
        raise SessionError(f"{path.name}: no column {missing[0]}; has {listed(columns.names)}")
    inertial = _inertial_places(columns)
    keys = columns.keys
    wanted = [keys[i] for i in dict.fromkeys([*(i for i in places.values() if i is not None), *inertial])]
    records = read_records(path, offset, keys, wanted, ",", WHAT)

    def value(name: str, units: dict[str, float] | None = None, usual: str = "") -> Array:
        place = places[name]
        if place is None:
            return np.full(records.length, np.nan)
        scale = 1.0 if units is None else factor(columns.units[place], units, usual)
        return records.column(keys[place]) * scale

    unix = value("timestamp")
    t = seconds_since_first(unix)
    has_position = np.isfinite(value("latitude")) | np.isfinite(value("longitude"))
    chosen = {
        "alt_m": value("altitude", LENGTH_UNITS, "m"),
        "speed": value("speed", SPEED_UNITS, "m/s"),
        "course_deg": value("bearing"),
        "sigma_horizontal": value("accuracy", LENGTH_UNITS, "m"),
        "num_sv": value("satellites"),
        "fix": value("fix_type"),
        "unix_s": unix,
    }
    rows = np.flatnonzero(has_position)  # rows of other sensors alone are no fixes that failed
    measured = measured_by_bearing(t[rows], chosen["course_deg"][rows])
    note = interpolated_note(path.name, rows.size - measured.size)
    rows = rows[measured]
    gnss, problems = fixes_from(
        path.name,
        t[rows],
        value("latitude")[rows],
        value("longitude")[rows],
        has_rows_between=bool(note),
        is_alone=not inertial,
        **{k: v[rows] for k, v in chosen.items()},
    )
    if (speed := places["speed"]) is not None:
        note += speed_unit_note(path.name, columns.units[speed], "m/s")
    values = [records.column(keys[i]) for i in inertial]
    imu, imu_problems = _imu(path.name, t, values, [columns.units[i] for i in inertial])
    if not inertial:
        imu_problems = incomplete_note(path.name, (*ACCELERATIONS, *RATES), columns.names)
    return ForeignReading(gnss, [*records.problems(path.name), *imu_problems, *note, *problems], imu)


def measured_by_bearing(t: Array, bearing: Array) -> IntArray:
    """Which rows of t (N,) s are fixes, all unless there is one at the stamps of other sensors too.

    Position and speed are interpolated there, the bearing is that of the fix before.
    """
    everything = np.arange(t.size)
    known = np.flatnonzero(np.isfinite(t) & np.isfinite(bearing))
    if known.size < 2 or np.any(np.diff(t[known]) < 0.0):
        return everything
    new = known[1:][np.diff(bearing[known]) != 0.0]
    rows = rows_at_knots(t[known], t[new]) if new.size else None
    return everything if rows is None else known[rows]


def _header(path: Path) -> tuple[_Columns, int]:
    """The header rows and the byte at which the values begin."""
    seen: list[str] = []

    def is_last(line: str) -> bool:
        cells = _cells(line)
        _require_version(path.name, cells)
        seen[:] = [*seen, line] if seen or "timestamp" in cells else []
        return len(seen) == 3

    lines, offset = head_of(path, is_last, WHAT)
    names, units, sources = (_cells(line) for line in lines[-3:])
    if is_number(units[0]):
        raise SessionError(f"{path.name}: no units below the names of its columns; export it as version 3")
    padded = [(row + [""] * len(names))[: len(names)] for row in (units, sources)]
    return _Columns(names, padded[0], padded[1]), offset


def _require_version(file: str, cells: Sequence[str]) -> None:
    """Raise SessionError at a line of another version, which says so, or names its times otherwise."""
    if cells[0] == "format" and cells[1:2] != ["3"]:
        raise SessionError(f"{file}: a RaceChrono CSV of version {listed(cells[1:2])}; export it as version 3")
    if OLD_TIMESTAMP in cells:
        raise SessionError(f"{file}: a RaceChrono CSV of version 1 or 2; export it as version 3")


def _cells(line: str) -> list[str]:
    return [cell.strip(' "').lower() for cell in line.split(",")]


def _inertial_places(columns: _Columns) -> list[int]:
    """Columns of the six inertial channels, none unless all are there."""
    places = [columns.place(name, "acc") for name in ACCELERATIONS]
    places += [columns.place(name, "gyro") for name in RATES]
    return [i for i in places if i is not None] if None not in places else []


def _imu(file: str, t: Array, values: Sequence[Array], units: Sequence[str]) -> tuple[RawImu | None, list[Problem]]:
    if not values:
        return None, []
    accel = np.stack(values[:3], axis=-1) * factor(units[0], ACCELERATION_UNITS, "g")
    gyro = np.stack(values[3:], axis=-1) * factor(units[3], RATE_UNITS, "deg/s")
    gyro = _at_accelerations(t, accel, gyro)
    rows = sampled_rows(t, [*accel.T, *gyro.T])
    return imu_from(file, t[rows], accel[rows], gyro[rows])


def _at_accelerations(t: Array, accel: Array, gyro: Array) -> Array:
    """Rates of rotation (N, 3), also in rows of accelerations (N, 3) where the two sensors have rows of their own.

    t (N,) s. Interpolated between the rows on either side, where both are near.
    """
    forced, turned = (np.isfinite(t) & np.all(np.isfinite(values), axis=1) for values in (accel, gyro))
    if not turned.any() or np.count_nonzero(forced & turned) > 0.5 * np.count_nonzero(forced):
        return gyro
    order = np.flatnonzero(turned)[np.argsort(t[turned], kind="stable")]
    known = t[order]
    place = np.clip(np.searchsorted(known, t), 1, max(known.size - 1, 1))
    near = (t >= known[0]) & (t <= known[-1])
    near &= np.maximum(t - known[place - 1], known[np.minimum(place, known.size - 1)] - t) < LONGEST_APART
    between = np.stack([np.interp(t, known, gyro[order, axis]) for axis in range(3)], axis=-1)
    return np.where((forced & ~turned & near)[:, None], between, gyro)


def sampled_rows(t: Array, channels: Sequence[Array]) -> IntArray:
    """Which rows of t (N,) s are samples of the channels (N,), all unless many lie between samples, interpolated.

    Noise keeps six channels that were measured from lying on the lines between their neighbours.
    """
    known = np.flatnonzero(np.all(np.isfinite(channels), axis=0) & np.isfinite(t))
    if known.size < FEWEST_SAMPLES or np.any(np.diff(t[known]) < 0.0):
        return np.arange(t.size)
    known = known[np.append(True, np.diff(t[known]) > 0.0)]  # of rows of one time, the first
    between = between_samples(t[known], [channel[known] for channel in channels])
    return known[~between] if np.mean(between) > FEW_BETWEEN else np.arange(t.size)
