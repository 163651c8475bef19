"""What to say of a table that no reader knows: which columns it has, and what they would have to be called."""

from pathlib import Path

from smoother.errors import SessionError
from smoother.session.readers.names import meaning_of
from smoother.session.tables import head_lines, names_of
from smoother.words import counted, listed

MOST_LINES = 40  # before the names, about the session
LATITUDE, LONGITUDE = ("lat",), ("lon", "lng")  # as names of them hold
OTHERS = ("lateral", "longitudinal", "latacc", "lonacc", "longacc", "accel")  # that hold it too
CLOCKS = {"time", "date"}
FEWEST_COLUMNS = 4  # of a table that somebody exported
NEEDED = "t_s (seconds), lat_deg and lon_deg"


def about_table(path: Path) -> str:
    """Which columns a table has and what is wanted, to stand behind its name. Raises SessionError if unreadable."""
    place, names = _names(path)
    has = f"its columns are {listed(names)}" if names else "it is empty"
    lines = f", and leave out the {counted(place, 'line')} before the names" if place else ""
    known = {meaning.quantity for name in names if (meaning := meaning_of(name)) is not None}
    if known >= {"latitude", "longitude"}:
        if known & CLOCKS:
            return f"{has}, but the cells below the places hold no degrees, as 45.0451 (docs/files.md)"
        return f"{has}: no column says when; add one called time, in seconds or as 10:00:00.2 (docs/files.md)"
    if known & CLOCKS and _places(names) is None:
        return f"{has}: none says where; export it with the channels of the GPS, or name them lat_deg and lon_deg"
    if (places := _places(names)) is None:
        return f"{has}; wanted {NEEDED}, or t_s with ax, ay, az, gx, gy, gz (docs/files.md)"
    shown = " and ".join(listed([name]) for name in places)
    return f"{has}; wanted {NEEDED}: rename {shown} and the times{lines} (docs/files.md)"


def has_times_only(path: Path) -> bool:
    """Whether a file is another program's table with times and channels, and no places."""
    if not path.name.lower().endswith((".csv", ".csv.gz", ".tsv")):
        return False
    try:
        names = _names(path)[1]
    except SessionError:
        return False
    known = {meaning.quantity for name in names if (meaning := meaning_of(name)) is not None}
    return "t_s" not in names and bool(known & CLOCKS) and len(names) >= FEWEST_COLUMNS and _places(names) is None


def holds_places(path: Path) -> bool:
    """Whether a file is a table with columns that are called after latitude and longitude, but not as is wanted."""
    if not path.name.lower().endswith((".csv", ".csv.gz")):
        return False
    try:
        names = _names(path)[1]
    except SessionError:  # it is not what anybody asked for
        return False
    return "lat_deg" not in names and _places(names) is not None


def _names(path: Path) -> tuple[int, tuple[str, ...]]:
    """How many lines stand before the names of the columns, and these: of the first line with places, else the first.

    Names are as they stand in the file.
    """
    lines = head_lines(path, MOST_LINES)
    rows = [names_of(line) for line in lines]
    place = next((i for i, row in enumerate(rows) if _places(row) is not None), None)
    if place is None:  # without places the row with most names that are known
        known = [sum(meaning_of(name) is not None for name in row) for row in rows]
        place = known.index(max(known)) if known and max(known) > 1 else 0
    return place, rows[place] if rows else ()


def _places(names: tuple[str, ...]) -> tuple[str, str] | None:
    """The names of latitude and longitude among those of a table."""
    found = []
    for wanted in (LATITUDE, LONGITUDE):
        of_place = (name for name in names if not any(other in name.lower() for other in OTHERS))
        found.append(next((name for name in of_place if any(part in name.lower() for part in wanted)), None))
    return None if found[0] is None or found[1] is None else (found[0], found[1])
