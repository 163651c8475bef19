"""AiM CSV as Race Studio exports it: quoted rows about the session, names, units, and the values at an even rate.

Times count from the start of the log; its date and time of day are local and so no UTC. Only the GPS channels are used:
which way the inertial channels of a given AiM box point, the file does not say.
"""

from dataclasses import dataclass
from pathlib import Path

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.foreign import LENGTH_UNITS, SPEED_UNITS, ForeignReading, factor, fixes_from
from smoother.session.records import head_of, read_records

WHAT = "AiM CSV with GPS channels"
MARK = "aim csv file"
TIME, LATITUDE, LONGITUDE = "time", "gps latitude", "gps longitude"
OPTIONAL = ("gps speed", "gps nsat", "gps heading", "gps altitude", "gps posaccuracy", "gps spdaccuracy")
INERTIAL = ("inlineacc", "lateralacc", "rollrate", "yawrate")


@dataclass(frozen=True)
class _Columns:
    """Names (lower case, repeated ones made different) and units of the columns, and what stands between cells."""

    names: list[str]
    units: list[str]
    separator: str

    def unit(self, name: str) -> str:
        return self.units[self.names.index(name)]


def read_aim(path: Path) -> ForeignReading:
    """Read an AiM CSV. Raises SessionError, one line, where it is none or nothing in it can be used."""
    columns, offset = _header(path)
    names = columns.names
    missing = [name for name in (LATITUDE, LONGITUDE) if name not in names]
    if missing:
        raise SessionError(f"{path.name}: no channel {missing[0].title()}; export it with the GPS channels")
    wanted = [TIME, LATITUDE, LONGITUDE, *(name for name in OPTIONAL if name in names)]
    records = read_records(path, offset, names, wanted, columns.separator, WHAT)

    def value(name: str, units: dict[str, float] | None = None, usual: str = "") -> Array:
        scale = 1.0 if units is None or name not in names else factor(columns.unit(name), units, usual)
        return records.column(name) * scale

    gnss, problems = fixes_from(
        path.name,
        value(TIME),
        value(LATITUDE),
        value(LONGITUDE),
        alt_m=value("gps altitude", LENGTH_UNITS, "m"),
        speed=value("gps speed", SPEED_UNITS, "km/h"),
        course_deg=value("gps heading"),
        sigma_horizontal=value("gps posaccuracy", LENGTH_UNITS, "mm"),
        sigma_velocity=value("gps spdaccuracy", SPEED_UNITS, "km/h"),
        num_sv=value("gps nsat"),
    )
    unused = [name for name in INERTIAL if name in names]
    if unused:
        text = f"{path.name}: the inertial channels ({', '.join(unused)}) are not used: their axes are not known"
        problems = [Problem("imu_axes_unknown", text), *problems]
    return ForeignReading(gnss, [*records.problems(path.name), *problems])


def _header(path: Path) -> tuple[_Columns, int]:
    """The names and units and the byte at which the rows after the units begin."""
    state = {"seen": 0}

    def is_last(line: str) -> bool:
        if state["seen"]:
            return True  # the row of units follows the names at once
        cells = _cells(line, _separator(line))
        state["seen"] = int(cells[0] == TIME and len(cells) > 2 and any(cell.startswith("gps") for cell in cells))
        return False

    lines, offset = head_of(path, is_last, WHAT)
    separator = _separator(lines[-2])
    names = _cells(lines[-2], separator)
    names = [name if names.index(name) == i else f"{name} #{i}" for i, name in enumerate(names)]
    units = _cells(lines[-1], separator)
    return _Columns(names, (units + [""] * len(names))[: len(names)], separator), offset


def _separator(line: str) -> str:
    return ";" if line.count(";") > line.count(",") else ","


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip(' "').lower() for cell in line.split(separator)]
