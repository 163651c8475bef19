"""Tables of programs without a reader of their own, whose columns are told by their names and units.

RaceBox, RaceChrono before version 3, TrackAddict and RaceRender, Harry's LapTimer, MoTeC, GoPro's telemetry, phones and
what people log themselves: a line with names, lines about the session before it, maybe a line with units below, then
rows. Refuses what has no latitude, longitude and time under any name that is known.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.errors import SessionError
from smoother.samples import Problem, RawImu
from smoother.session.degrees import require_degrees
from smoother.session.fix_columns import FixColumns, fix_columns
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
    speed_unit_note,
)
from smoother.session.moments import Moments, put_together, read_days, read_moments, zone_note
from smoother.session.racechrono import measured_by_bearing, sampled_rows
from smoother.session.records import Records, head_of, read_records
from smoother.session.table_layout import COMMENT, MOST_LINES, Layout, layout_of
from smoother.session.time_unit import UNITS, in_seconds, unit_by_utc
from smoother.words import counted, listed

WHAT = "table with latitude, longitude and time"
FORCES, RATES = ("ax", "ay", "az"), ("gx", "gy", "gz")
USUAL_RATES = {"g": "deg/s"}  # unit of turn rates that do not say it, beside accelerations in that one
FASTEST_PERIOD = 0.01  # s between fixes; and ten seconds is the slowest, a thousand times as long


@dataclass(frozen=True)
class _Table:
    """A table as it was read."""

    file: str
    layout: Layout
    records: Records

    def unit(self, quantity: str) -> str:
        """Unit of the best column of a quantity; "" without one, or where it does not say."""
        places = self.layout.columns.get(quantity)
        return self.layout.units[places[0]] if places else ""

    def value(self, quantity: str, units: dict[str, float] | None = None, usual: str = "") -> Array:
        """The best column (N,) of a quantity in SI, NaN without one."""
        places = self.layout.columns.get(quantity)
        scale = 1.0 if units is None else factor(self.unit(quantity), units, usual)
        return self.records.column(self.layout.keys[places[0]] if places else "") * scale


@np.errstate(over="ignore", invalid="ignore")  # damaged digits; what is absurd is left out, and counted
def read_named_table(path: Path) -> ForeignReading:
    """Read such a table. Raises SessionError, one line, where it is none or nothing in it can be used."""
    layout, offset = _layout(path)
    columns, keys = layout.columns, layout.keys
    clocks = [keys[i] for quantity in ("time", "date") for i in columns.get(quantity, [])]
    wanted = [keys[places[0]] for quantity, places in columns.items() if quantity not in ("time", "date")]
    records = read_records(path, offset, keys, wanted, layout.separator, WHAT, texts=clocks, comment=COMMENT.encode())
    table = _Table(path.name, layout, records)
    clock, utc, said = _clocks(table)
    raw = _fix_columns(table, clock.seconds, utc)
    rows = _rows_of_fixes(table, raw)
    raw, t, unit_said = _in_seconds(table, clock, raw, rows)
    between: list[Problem] = []
    if _is_racechrono(layout):  # it interpolates positions to the stamps of other sensors; bearings it repeats
        measured = measured_by_bearing(raw.t, raw.course_deg)
        between = interpolated_note(path.name, raw.t.size - measured.size)
        raw = raw.take(measured)
    require_degrees(path.name, raw)
    known = {name: getattr(raw, name) for name in _KNOWN}
    imu, of_imu = _imu(table, t)
    gnss, problems = fixes_from(
        path.name,
        raw.t,
        raw.lat_deg,
        raw.lon_deg,
        has_rows_between=bool(between),
        is_alone=imu is None,
        **known,
    )
    said = [*said, *_without_numbers(table)]
    if "speed" in columns and np.isfinite(known["speed"]).any():
        said = [*said, *speed_unit_note(path.name, table.unit("speed"), _usual_speed(table))]
    problems = [*records.problems(path.name), *of_imu, *said, *unit_said, *between, *problems]
    return ForeignReading(gnss, problems, imu)


def _without_numbers(table: _Table) -> list[Problem]:
    """Say which columns that are called after a quantity hold something else, as 81.2 km/h, and are not used."""
    said = []
    for quantity in ("speed", "course", "altitude", "ax", "ay", "az", "gx", "gy", "gz"):
        places = table.layout.columns.get(quantity, [])
        if places and (count := table.records.words.get(table.layout.keys[places[0]], 0)):
            name = table.layout.names[places[0]]
            text = f"{table.file}: {name} is no number in {counted(count, 'row')}; write numbers alone. Not used there"
            said.append(Problem("gps_unread", text, count))
    return said


def _layout(path: Path) -> tuple[Layout, int]:
    """The layout of a table and the byte at which its rows begin."""
    lines: list[str] = []

    def is_last(line: str) -> bool:
        lines.append(line)
        return len(lines) > 2 * MOST_LINES

    try:
        head_of(path, is_last, WHAT)
    except SessionError:
        if not lines:
            raise
    layout = layout_of("\n".join(lines))
    if layout is None:
        raise SessionError(f"{path.name}: no {WHAT}")
    seen = iter(range(1, layout.lines))
    return layout, head_of(path, lambda line: next(seen, None) is None, WHAT)[1]


def _clocks(table: _Table) -> tuple[Moments, Moments | None, list[Problem]]:
    """The clock of the rows, UTC where the file tells it, and what has to be said of them."""
    columns, keys = table.layout.columns, table.layout.keys
    cells = {i: table.records.texts[keys[i]] for name in ("time", "date") for i in columns.get(name, [])}
    read = [found for i, text in cells.items() if (found := read_moments(text, table.layout.units[i])) is not None]
    if not read:
        example = next((str(text[0]) for text in cells.values()), "")
        raise SessionError(
            f"{table.file}: its times, as {listed([example], longest=40)}, are not understood; "
            "wanted seconds, milliseconds, UTC or times of day as 10:00:00.2"
        )
    date = columns.get("date")
    clock, utc = put_together(read, read_days(cells[date[0]]) if date else None)
    return clock, utc, [] if clock.has_zone and (utc is None or utc.has_zone) else [zone_note(table.file)]


_KNOWN = (
    *("alt_m", "speed", "course_deg", "sigma_horizontal", "sigma_up", "sigma_velocity"),
    *("hdop", "num_sv", "fix", "unix_s"),
)


def _fix_columns(table: _Table, t: Array, utc: Moments | None) -> FixColumns:
    """Every row as if it were a fix, t (N,) in whatever unit it is."""
    fix = table.value("fix")
    degrees = {"deg": 1.0, "°": 1.0, "min": 1.0 / 60.0, "minutes": 1.0 / 60.0}
    return fix_columns(
        t,
        table.value("latitude", degrees, "deg"),
        table.value("longitude", degrees, "deg"),
        alt_m=table.value("altitude", LENGTH_UNITS, "m"),
        speed=table.value("speed", SPEED_UNITS, _usual_speed(table)),
        course_deg=table.value("course"),
        sigma_horizontal=table.value("accuracy", LENGTH_UNITS, "m"),
        sigma_up=table.value("height accuracy", LENGTH_UNITS, "m"),
        sigma_velocity=table.value("speed accuracy", SPEED_UNITS, "m/s"),
        hdop=table.value("hdop"),
        num_sv=table.value("satellites"),
        fix=fix if np.any(fix >= 1.0) else np.full(t.size, np.nan),  # some programs write 0 throughout
        unix_s=np.full(t.size, np.nan) if utc is None else utc.seconds,
    )


def _usual_speed(table: _Table) -> str:
    """Unit of speeds that do not say it: RaceBox, which has accelerations in g of that name, writes km/h."""
    return "km/h" if _is_gforce(table.layout) else "m/s"


def _is_gforce(layout: Layout) -> bool:
    return any(layout.names[i].lower().startswith("gforce") for i in layout.columns.get("ax", [])[:1])


def _is_racechrono(layout: Layout) -> bool:
    return any(name.lower().startswith("session fragment") for name in layout.names)


def _rows_of_fixes(table: _Table, c: FixColumns) -> IntArray:
    """Rows with a position; where the file marks those with a new one (TrackAddict), only them."""
    update = table.value("update")
    has_position = ~c.is_blank
    if np.any(update == 1.0) and np.any(update == 0.0):
        has_position &= update == 1.0
    return np.flatnonzero(has_position)


def _in_seconds(
    table: _Table, clock: Moments, c: FixColumns, rows: IntArray
) -> tuple[FixColumns, Array, list[Problem]]:
    """The fixes at `rows` and the times (N,) of all rows, in seconds since the first, and what to say of their unit."""
    t, said = clock.seconds, list[Problem]()
    if not clock.unit:
        fixes = c.take(rows)
        t, said = in_seconds(t, unit_by_utc(fixes.t, fixes.unix_s) or _unit_by_fixes(fixes), "gps", table.file)
    known = t[np.isfinite(t)]
    t = np.round(t - known[0], 6) if known.size else t
    return replace(c, t=t).take(rows), t, said


def _unit_by_fixes(c: FixColumns) -> str | None:
    """The unit in which fixes come a hundred times a second to once in ten seconds; None for seconds."""
    steps = np.diff(c.t[_moved(c) & np.isfinite(c.t)]) if c.t.size else c.t
    steps = steps[steps > 0.0]
    period = float(np.median(steps)) if steps.size else 0.0
    return next((name for name, size in UNITS.items() if 1.0 <= period / size / FASTEST_PERIOD < 1e3), None)


def _moved(c: FixColumns) -> BoolArray:
    """Which rows (N,), N > 0, are at another place than the one before."""
    return np.append(True, (np.diff(c.lat_deg) != 0.0) | (np.diff(c.lon_deg) != 0.0))


def _imu(table: _Table, t: Array) -> tuple[RawImu | None, list[Problem]]:
    """Inertial samples of a table that has all six channels."""
    names = [name for name in (*FORCES, *RATES) if name in table.layout.columns]
    if len(names) < len(FORCES) + len(RATES):
        return None, incomplete_note(table.file, (*FORCES, *RATES), names) if names else []
    accel = np.stack([table.value(name) for name in FORCES], axis=-1)
    gyro = np.stack([table.value(name) for name in RATES], axis=-1)
    force, rate = table.unit("ax"), table.unit("gx")
    rate = rate or (USUAL_RATES.get(force, "") if _is_gforce(table.layout) else "")
    accel *= ACCELERATION_UNITS.get(force, 1.0)  # where the table does not say, the checks of all samples tell
    gyro *= RATE_UNITS.get(rate, 1.0)
    rows = sampled_rows(t, [*accel.T, *gyro.T])
    return imu_from(table.file, t[rows], accel[rows], gyro[rows])
