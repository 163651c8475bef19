"""From the sheets of a recording to fixes, samples and channels, by the names and units of their columns.

Every reader of another program's files ends here: tables, folders of a phone's sensors, logs of cameras and loggers.
"""

import contextlib
import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.degrees import require_degrees
from smoother.session.fix_columns import FixColumns, fix_columns
from smoother.session.fixes import interpolated_note
from smoother.session.interpolated import rows_at_knots
from smoother.session.readers.cells import degrees_of, hemispheres_of, qualities_of
from smoother.session.readers.channels import channels_of
from smoother.session.readers.foreign import ForeignReading, date_note, fixes_from, speed_unit_note, unread_note
from smoother.session.readers.motion import imu_of
from smoother.session.readers.names import ANGLE_UNITS
from smoother.session.readers.sheet import Column, Sheet
from smoother.session.readers.times import (
    CLOCK_PARTS,
    DATE_PARTS,
    Moments,
    day_of,
    days_of_parts,
    moments_of_numbers,
    moments_of_parts,
    put_together,
    read_days,
    read_moments,
    spread_evenly,
    with_fractions,
    zone_note,
)
from smoother.session.time_unit import UNITS, in_seconds, unit_by_utc
from smoother.words import listed

FASTEST_PERIOD = 0.01  # s between fixes; and ten seconds is the slowest, a thousand times as long
NUMBERS = (  # said where they hold words
    *("latitude", "longitude", "speed", "course", "altitude", "accuracy", "satellites", "hdop"),
    *("ax", "ay", "az", "gx", "gy", "gz"),
)
CLOCK_FORMS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M", "%I:%M:%S %p", "%I:%M %p")  # of the start of a log
STARTS = (("date", "time"), ("log date", "log time"))  # of the log, as lines above the names tell them
OWN_UTC = "time is utc."  # as this program's own export says


@dataclass(frozen=True, eq=False)
class _Clocks:
    """What the sheets say of time: by name the columns of one, the best of them all, and UTC."""

    by_name: dict[str, Moments]
    clock: Moments
    utc: Moments | None


@np.errstate(over="ignore", invalid="ignore")  # damaged digits; what is absurd is left out, and counted
def recording_of(file: str, sheets: Sequence[Sheet]) -> ForeignReading:
    """Return what the sheets of one recording hold. Raises SessionError, one line, where there are no fixes."""
    fixes = next((sheet for sheet in sheets if sheet.has("latitude", "longitude")), None)
    if fixes is None:
        raise SessionError(f"{file}: no GPS in it, only a motion sensor; switch the GPS on for the next recording")
    clocks = {id(sheet): _clocks(sheet) for sheet in sheets if sheet is fixes or sheet.length}
    own = clocks[id(fixes)]
    if own is None:
        raise SessionError(_about_times(fixes))
    others = [sheet for sheet in sheets if sheet is not fixes and clocks.get(id(sheet)) is not None]
    name = _common_name(own, [found for sheet in others if (found := clocks[id(sheet)]) is not None])
    clock = own.clock if name is None else own.by_name[name]
    clock, own, whole_said = _with_fractions(file, clock, own)
    raw = _fix_columns(fixes, clock.seconds, own.utc)
    rows = _rows_of_fixes(fixes, raw)
    raw, t, unit, unit_said = _in_seconds(file, clock, raw, rows)
    timed = [(fixes, t)]
    zero = _first(clock.seconds)
    for sheet in others:
        found = clocks[id(sheet)]
        assert found is not None
        if name is not None and name in found.by_name:
            timed.append((sheet, np.round((found.by_name[name].seconds - zero) / UNITS.get(unit or "", 1.0), 6)))
    raw, between = _without_rows_between(fixes, raw)
    if not _are_stated_degrees(fixes, raw):
        require_degrees(file, raw)
    known = {name: getattr(raw, name) for name in _KNOWN}
    imu, of_imu = imu_of(file, timed)
    gnss, problems = fixes_from(
        file,
        raw.t,
        raw.lat_deg,
        raw.lon_deg,
        has_rows_between=bool(between) or _is_resampled(fixes),
        **known,
    )
    start, start_said = _start(file, fixes.about) if own.utc is None else (None, [])
    said = [problem for sheet in sheets for problem in sheet.problems] + start_said
    if not own.clock.has_zone or (own.utc is not None and not own.utc.has_zone):
        said.append(zone_note(file))
    said += _unread(fixes)
    if fixes.has("speed") and np.isfinite(known["speed"]).any():
        said += speed_unit_note(file, fixes.unit("speed") or _of_cells(fixes, "speed"), _usual_speed(fixes))
    problems = [*said, *of_imu, *whole_said, *unit_said, *between, *problems]
    return ForeignReading(gnss, problems, imu, start, channels_of(timed))


def _about_times(sheet: Sheet) -> str:
    example = next((str(column.cells[0]) for column in sheet.all_of("time") if column.cells is not None), "")
    return (
        f"{sheet.file}: its times, as {listed([example], longest=40)}, are not understood; "
        "wanted seconds, milliseconds, UTC or times of day as 10:00:00.2"
    )


def _clocks(sheet: Sheet) -> _Clocks | None:
    """The clocks of a sheet; None without any."""
    by_name: dict[str, Moments] = {}
    for quantity in ("time", "date"):
        for column in sheet.all_of(quantity):
            meaning = column.meaning(sheet.sensor)
            unit = "" if meaning is None else meaning.unit
            cells = column.cells
            found = moments_of_numbers(column.values, unit) if cells is None else read_moments(cells, unit)
            if found is not None and np.isfinite(found.seconds).any():
                by_name.setdefault(column.name.lower(), found)
    parts = {name: sheet.value(name) for name in (*DATE_PARTS, *CLOCK_PARTS, "millisecond") if sheet.has(name)}
    if (of_parts := moments_of_parts(parts)) is not None:
        by_name["parts"] = of_parts
    names = list(by_name)
    by_name = dict(zip(names, with_fractions([by_name[key] for key in names], parts.get("millisecond")), strict=True))
    if not by_name and "millisecond" in parts:
        by_name = {"ms": moments_of_numbers(parts["millisecond"], "ms")}
    if not by_name:
        return None
    days = days_of_parts(parts)
    for column in sheet.all_of("date") if days is None else []:
        if column.cells is not None and np.isfinite(days := read_days(column.cells)).any():
            break
    clock, utc = put_together(list(by_name.values()), days)
    return _Clocks(by_name, clock, utc)


def _with_fractions(file: str, clock: Moments, own: _Clocks) -> tuple[Moments, _Clocks, list[Problem]]:
    """The clock, and UTC, of rows that share whole seconds: spread evenly over each, and said."""
    if not (clock.has_date or clock.is_of_day):
        return clock, own, []
    spread, rate = spread_evenly(clock.seconds)
    if rate == 1:
        return clock, own, []
    utc = None if own.utc is None else replace(own.utc, seconds=spread_evenly(own.utc.seconds)[0])
    text = f"{file}: its times have no fractions of seconds; {rate} fixes a second spread evenly"
    said = [Problem("gps_whole_seconds", text)]
    return replace(clock, seconds=spread), replace(own, utc=utc), said


def _common_name(own: _Clocks, others: Sequence[_Clocks]) -> str | None:
    """The name of the finest clock that all sheets share; None where there is one sheet only, or they share none."""
    shared = [name for name in own.by_name if all(name in other.by_name for other in others)]
    return max(shared, key=lambda name: own.by_name[name].fineness, default=None) if others else None


_KNOWN = (
    *("alt_m", "speed", "course_deg", "velocity_north", "velocity_east", "velocity_up", "sigma_horizontal", "sigma_up"),
    *("sigma_velocity", "hdop", "num_sv", "fix", "unix_s"),
)


def _fix_columns(sheet: Sheet, t: Array, utc: Moments | None) -> FixColumns:
    """Every row as if it were a fix, t (N,) in whatever unit it is."""
    fix = _quality(sheet)
    return fix_columns(
        t,
        _degrees(sheet, "latitude"),
        _degrees(sheet, "longitude"),
        alt_m=sheet.value("altitude", "m"),
        speed=_speed(sheet),
        course_deg=sheet.value("course"),
        velocity_north=sheet.value("north", "m/s"),
        velocity_east=sheet.value("east", "m/s"),
        velocity_up=sheet.value("up", "m/s"),
        sigma_horizontal=sheet.value("accuracy", _usual_accuracy(sheet)),
        sigma_up=sheet.value("height accuracy", "m"),
        sigma_velocity=sheet.value("speed accuracy", _usual_speed(sheet)),
        hdop=sheet.value("hdop"),
        num_sv=sheet.value("satellites"),
        fix=fix if np.any(fix >= 1.0) else np.full(t.size, np.nan),  # some programs write 0 throughout
        unix_s=np.full(t.size, np.nan) if utc is None else utc.seconds,
    )


def _degrees(sheet: Sheet, quantity: str) -> Array:
    """Latitude or longitude (N,) in degrees, with the signs of letters in the cells, or in the column beside."""
    column = sheet.column(quantity)
    assert column is not None
    if column.cells is None:
        return sheet.value(quantity, "deg")
    is_longitude = quantity == "longitude"
    place = sheet.places[quantity][0]
    letters = None
    for beside in (place + 1, place - 1):
        if 0 <= beside < len(sheet.columns) and (cells := sheet.columns[beside].cells) is not None:
            letters = hemispheres_of(cells, is_longitude=is_longitude) if letters is None else letters
    degrees = degrees_of(column.cells, is_longitude=is_longitude, letters=letters)
    plain = replace(column, values=degrees)
    return replace(sheet, columns=(*sheet.columns[:place], plain, *sheet.columns[place + 1 :])).value(quantity, "deg")


def _are_stated_degrees(sheet: Sheet, c: FixColumns) -> bool:
    """Whether the file says the unit of its places, and they are on Earth by it."""
    if sheet.unit("latitude") not in ANGLE_UNITS or sheet.unit("longitude") not in ANGLE_UNITS:
        return False
    return not np.any(np.abs(c.lat_deg) > 90.0) and not np.any(np.abs(c.lon_deg) > 360.0)


def _quality(sheet: Sheet) -> Array:
    column = sheet.column("fix")
    if column is None or column.cells is None:
        return sheet.value("fix")
    return qualities_of(column.cells)


def _speed(sheet: Sheet) -> Array:
    """Speed (N,) m/s by the unit of its name, else of its cells, else the usual one."""
    return sheet.value("speed", _of_cells(sheet, "speed").lower() or _usual_speed(sheet))


def _of_cells(sheet: Sheet, quantity: str) -> str:
    column = sheet.column(quantity)
    return "" if column is None else column.unit


def _usual_speed(sheet: Sheet) -> str:
    """Unit of speeds that do not say it: RaceBox, which has accelerations in g of that name, writes km/h, as AiM."""
    column = sheet.column("ax")
    is_racebox = column is not None and column.name.lower().startswith("gforce")
    return "km/h" if is_racebox or _is_aim(sheet) else "m/s"


def _usual_accuracy(sheet: Sheet) -> str:
    return "mm" if _is_aim(sheet) else "m"


def _is_aim(sheet: Sheet) -> bool:
    return "aim csv" in sheet.about.get("format", "").lower()


def _is_resampled(sheet: Sheet) -> bool:
    """Whether the program wrote all channels at one rate, and so lines where the receiver was silent."""
    return "sample rate" in sheet.about


def _rows_of_fixes(sheet: Sheet, c: FixColumns) -> IntArray:
    """Rows with a position; where the file marks those with a new one (TrackAddict), only them."""
    update = sheet.value("update")
    has_position = ~c.is_blank
    if np.any(update == 1.0) and np.any(update == 0.0):
        has_position &= update == 1.0
    return np.flatnonzero(has_position)


def _first(t: Array) -> float:
    known = t[np.isfinite(t)]
    return float(known[0]) if known.size else 0.0


def _in_seconds(
    file: str, clock: Moments, c: FixColumns, rows: IntArray
) -> tuple[FixColumns, Array, str | None, list[Problem]]:
    """The fixes at `rows` and the times (N,) of all rows, in seconds since the first; their unit and what to say."""
    t, said, unit = clock.seconds, list[Problem](), None
    if not clock.unit:
        fixes = c.take(rows)
        unit = unit_by_utc(fixes.t, fixes.unix_s) or _unit_by_fixes(fixes)
        t, said = in_seconds(t, unit, "gps", file)
    t = np.round(t - _first(t), 6)
    return replace(c, t=t).take(rows), t, unit, said


def _unit_by_fixes(c: FixColumns) -> str | None:
    """The unit in which fixes come a hundred times a second to once in ten seconds; None for seconds."""
    steps = np.diff(c.t[_moved(c) & np.isfinite(c.t)]) if c.t.size else c.t
    steps = steps[steps > 0.0]
    period = float(np.median(steps)) if steps.size else 0.0
    return next((name for name, size in UNITS.items() if 1.0 <= period / size / FASTEST_PERIOD < 1e3), None)


def _without_rows_between(sheet: Sheet, c: FixColumns) -> tuple[FixColumns, list[Problem]]:
    """The fixes without the rows at which RaceChrono interpolates positions to the stamps of other sensors."""
    if not any(column.name.lower().startswith(("session fragment", "fragment_id")) for column in sheet.columns):
        return c, []
    measured = measured_by_bearing(c.t, c.course_deg)
    return c.take(measured), interpolated_note(sheet.file, c.t.size - measured.size)


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


def _moved(c: FixColumns) -> BoolArray:
    """Which rows (N,), N > 0, are at another place than the one before."""
    return np.append(True, (np.diff(c.lat_deg) != 0.0) | (np.diff(c.lon_deg) != 0.0))


def _unread(sheet: Sheet) -> list[Problem]:
    """Say which cells of columns that are used hold something else than numbers."""
    used = [(quantity, column) for quantity in NUMBERS if (column := sheet.column(quantity)) is not None]
    notes = [unread_note(sheet.file, column.name, _unread_cells(column, quantity)) for quantity, column in used]
    return [note for note in notes if note is not None]


def _unread_cells(column: Column, quantity: str) -> int:
    if quantity not in ("latitude", "longitude") or column.cells is None or not column.unread:
        return column.unread
    values = degrees_of(column.cells, is_longitude=quantity == "longitude")
    return max(0, column.unread - int(np.count_nonzero(np.isfinite(values) & ~np.isfinite(column.values))))


def _start(file: str, about: dict[str, str]) -> tuple[float | None, list[Problem]]:
    """UTC at which a log began whose times count from its start, and what had to be assumed for it."""
    is_aim = "aim csv" in about.get("format", "").lower()
    day_name, clock_name = next((names for names in STARTS if names[0] in about), ("", ""))
    day, clock = day_of(about.get(day_name, "")), _clock(about.get(clock_name, ""))
    if day is None or clock is None:
        reason = "no date and time of day in it that can be read one way; laps have none"
        return None, [date_note(file, reason)] if is_aim else []
    moment = dt.datetime.combine(day, clock)
    if OWN_UTC in about.get("comment", "").lower():
        return moment.replace(tzinfo=dt.UTC).timestamp(), []
    zone = moment.astimezone()
    text = f"date and time of day are local, the zone is not in it; taken as this computer's ({zone:%Z})"
    return zone.timestamp(), [date_note(file, text)]


def _clock(text: str) -> dt.time | None:
    for form in CLOCK_FORMS:
        with contextlib.suppress(ValueError):
            return dt.datetime.strptime(text.strip().replace(",", "."), form).time().replace(microsecond=0)
    return None
