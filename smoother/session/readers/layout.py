"""How a table of another program is laid out: lines about the session, names, maybe units and sources, rows.

Looks at the beginning of the text only, so that a folder is looked through quickly. Refuses what has no times with
places, forces or turn rates under any name that is known, and what has no numbers where these would be.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from smoother.errors import SessionError
from smoother.session.readers.names import meaning_of
from smoother.session.readers.sheet import Column, Sheet, places_of, sheet_of
from smoother.session.tables import cells_of, head_lines, read_rows, separator_of
from smoother.session.text import text_head
from smoother.words import listed

MOST_LINES = 60  # before the names, about the session
COMMENT = "#"
TEXTUAL = ("time", "date", "latitude", "longitude", "fix")  # quantities whose cells may be more than numbers
OVERWRITTEN = "\0\ufffd"  # in rows that a card has lost, as in no text
OWN_NAMES = ("lat_deg", "lon_deg", "t_s")  # of this project's tables, which have a reader, or are results
PLACES = ("latitude", "longitude")
SENSORS = (("ax", "ay", "az"), ("gx", "gy", "gz"))
_WITH_FORM = re.compile(r'^"?([^"|]*)"?\|"?([^"|]*)"?\|')  # of RaceCapture: name, unit, least, most, rate
_NUMBER = re.compile(r"^\s*[-+]?\d*[.,]?\d+\s*$")
_SOURCE = re.compile(r"^(?:\d+: ?\w+|calc|gps|acc|gyro|)$", re.IGNORECASE)


@dataclass(frozen=True)
class Layout:
    """Where the rows of a table begin and what its columns hold.

    lines : how many stand before the rows. places : of the columns of each quantity, the best first. sensor : what the
    table is called after.
    """

    lines: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    sources: tuple[str, ...]
    places: dict[str, list[int]]
    separator: str
    about: dict[str, str]
    sensor: str

    @property
    def has_places(self) -> bool:
        """Whether there are latitudes and longitudes."""
        return all(quantity in self.places for quantity in PLACES)


def layout_of(head: str, sensor: str = "") -> Layout | None:
    """Return the layout of a table that begins with the text `head`; None where that is none of motion with times."""
    lines = head.split("\n")
    for place, line in enumerate(lines[:MOST_LINES]):
        separator = separator_of(line)
        if line.lstrip(' "\ufeff').lower().startswith("sep=") or not line.strip():
            continue
        names, units = _names(line, separator)
        found = _found(names, units, sensor)
        if set(names) & set(OWN_NAMES) or not _is_of_motion(found):
            continue
        about = _about(lines[:place], separator)
        blank = ("",) * len(names)
        return _with_rows(Layout(place + 1, names, units, blank, found, separator, about, sensor), lines)
    return None


def _names(line: str, separator: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the columns and their units, where the names have them in a form of their own."""
    forms = [_WITH_FORM.match(cell) for cell in line.strip("\ufeff \r").split(separator)]
    if all(forms):
        found = [form for form in forms if form is not None]
        return tuple(form[1].strip() for form in found), tuple(form[2].strip() for form in found)
    names = cells_of(line, separator)
    return names, ("",) * len(names)


def _found(names: Sequence[str], units: Sequence[str], sensor: str) -> dict[str, list[int]]:
    return places_of([meaning_of(name, unit, sensor) for name, unit in zip(names, units, strict=True)])


def _is_of_motion(found: dict[str, list[int]]) -> bool:
    has_time = bool({"time", "date"} & set(found)) or {"hour", "minute", "second"} <= set(found)
    has_place = all(quantity in found for quantity in PLACES)
    return has_time and (has_place or any(all(axis in found for axis in sensor) for sensor in SENSORS))


def _about(lines: Sequence[str], separator: str) -> dict[str, str]:
    """What each row about the session says, by its first cell in lower case; the last wins."""
    rows = [line.partition(separator) for line in lines]
    return {name.strip(' "').lower(): rest.strip(' "\r\n' + separator) for name, _, rest in rows}


def _with_rows(layout: Layout, lines: Sequence[str]) -> Layout | None:
    """The layout with units and sources below the names, if they are there; None where what follows is no such row.

    A separator at the end of the names only, or of the rows only, is no column. Rows that are cut or overwritten are
    passed over, as those further down are: the first that is whole decides.
    """
    below = [i for i in range(layout.lines, len(lines)) if lines[i].strip() and not lines[i].startswith(COMMENT)]
    number = len(layout.names)
    if below and _is_units(units := cells_of(lines[below[0]], layout.separator), layout):
        layout = replace(layout, lines=below[0] + 1, units=(*units, *[""] * number)[:number])
        below = below[1:]
        if below and _is_sources(sources := cells_of(lines[below[0]], layout.separator)):
            sources = tuple(source.lower() for source in (*sources, *[""] * number)[:number])
            layout = replace(layout, lines=below[0] + 1, sources=sources)
            below = below[1:]
    for i in below:
        row = cells_of(lines[i], layout.separator)
        fitted = _ending_as(row, layout)
        if len(row) == len(fitted.names) and all(_may_be_value(row[k]) for k in _telling(fitted)):
            return fitted
        if len(row) == len(fitted.names) and i < len(lines) - 1 and not any(c in lines[i] for c in OVERWRITTEN):
            return None
    return layout  # whoever reads its rows will say what is wrong with them


def _ending_as(row: Sequence[str], layout: Layout) -> Layout:
    """The layout with as many columns as a row, where that ends in a separator and the names do not, or they alone."""
    if len(row) == len(layout.names) + 1 and not row[-1]:
        names, units, sources = ((*cells, "") for cells in (layout.names, layout.units, layout.sources))
        return replace(layout, names=names, units=units, sources=sources)
    if len(row) == len(layout.names) - 1 and not layout.names[-1]:
        return replace(layout, names=layout.names[:-1], units=layout.units[:-1], sources=layout.sources[:-1])
    return layout


def _is_units(cells: Sequence[str], layout: Layout) -> bool:
    """Whether a line below the names is one of units: words, and no values."""
    telling = [cells[i] for i in _telling(layout) if i < len(cells)]
    some = any(cell.strip() for cell in cells) and len(telling) == len(_telling(layout))
    return some and not any(_NUMBER.match(cell) for cell in cells) and not any(_has_digit(cell) for cell in telling)


def _has_digit(cell: str) -> bool:
    return any(c.isdigit() for c in cell.replace("s2", "").replace("s^2", ""))


def _is_sources(cells: Sequence[str]) -> bool:
    """Whether a line below the units says where each column is from."""
    return any(cells) and all(_SOURCE.match(cell) for cell in cells)


def _telling(layout: Layout) -> list[int]:
    """The columns that tell rows from units: places, else forces or turn rates."""
    chosen = next(axes for axes in (PLACES, *SENSORS) if all(axis in layout.places for axis in axes))
    return [layout.places[axis][0] for axis in chosen]


def _may_be_value(cell: str) -> bool:
    return not cell or any(c.isdigit() for c in cell) or cell.lower() in ("nan", "-", "null", "n/a", "none")


def layout_in(path: Path) -> Layout | None:
    """The layout of a file that is a table of motion by its first lines; None of any other, or if it is unreadable."""
    try:
        return layout_of(text_head(path), path.stem)
    except SessionError:
        return None  # whoever needs the file will say so


def sheet_in(path: Path) -> Sheet:
    """The sheet in a table. Raises SessionError, one line, where it is none."""
    layout = layout_of(text_head(path), path.stem)
    if layout is None:
        raise SessionError(f"{path.name}: no table with latitude, longitude and time")
    texts = {place for quantity in TEXTUAL for place in layout.places.get(quantity, ())}
    has_commas = layout.separator != ","
    places = range(len(layout.names))
    rows = read_rows(path, layout.lines, len(places), layout.separator, places, texts, has_decimal_commas=has_commas)
    columns = [
        Column(name, found.values, layout.units[i] or found.unit, layout.sources[i], found.cells, found.unread)
        for i, name in enumerate(layout.names)
        for found in (rows.columns[i],)
    ]
    return sheet_of(path.name, columns, rows.problems, sensor=layout.sensor, about=layout.about)


LINES_OF_UNKNOWN = 40  # before the names, about the session
CLOCKS = {"time", "date"}
FEWEST_COLUMNS = 4  # of a table that somebody exported


def about_table(path: Path) -> str:
    """Which columns a table has and what is wanted, to stand behind its name. Raises SessionError if unreadable."""
    names, known = _names_of_unknown(path)
    has = f"its columns are {listed(names)}" if names else "it is empty"
    if known >= set(PLACES):
        if known & CLOCKS:
            return f"{has}, but the cells below the places hold no degrees, as 45.0451 (docs/files.md)"
        return f"{has}: no column says when; add one called time, in seconds or as 10:00:00.2 (docs/files.md)"
    if known & CLOCKS:
        return f"{has}: none says where; export it with the channels of the GPS, or name them lat_deg and lon_deg"
    wanted = "t_s (seconds), lat_deg and lon_deg, or t_s with ax, ay, az, gx, gy, gz"
    return f"{has}; wanted {wanted} (docs/files.md)"


def is_of_another_program(path: Path) -> bool:
    """Whether a file is a table with places, or with times and channels, that is not called as is wanted."""
    if not path.name.lower().endswith((".csv", ".csv.gz", ".tsv")):
        return False
    try:
        names, known = _names_of_unknown(path)
    except SessionError:
        return False
    is_likely = known >= set(PLACES) or (bool(known & CLOCKS) and len(names) >= FEWEST_COLUMNS)
    return is_likely and not set(names) & set(OWN_NAMES)


def _names_of_unknown(path: Path) -> tuple[tuple[str, ...], set[str]]:
    """Names of the columns, as they stand in the file, and their quantities: of the line with most that are known."""
    rows = [cells_of(line) for line in head_lines(path, LINES_OF_UNKNOWN)]
    known = [{meaning.quantity for name in row if (meaning := meaning_of(name)) is not None} for row in rows]
    place = max(range(len(rows)), key=lambda i: len(known[i]), default=0)
    return (rows[place], known[place]) if rows else ((), set())
