"""How a table of another program is laid out: lines about the session, names, maybe units, rows.

Looks at the beginning of the text only, so that a folder is looked through quickly. Refuses what has no latitude,
longitude and time under any name that is known, and what has no numbers where these would be.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from smoother.session.column_names import meaning_of

MOST_LINES = 60  # before the names, about the session
SEPARATORS = ",;\t"  # of as many the first
COMMENT = "#"
OVERWRITTEN = "\0\ufffd"  # in rows that a card has lost, as in no text
OWN_NAMES = ("lat_deg", "lon_deg")  # of this project's tables, which have a reader, or are results


@dataclass(frozen=True)
class Layout:
    """Where the rows of a table begin and what its columns hold.

    lines : how many stand before the rows. columns : places of the columns of each quantity, the best first.
    """

    lines: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: dict[str, list[int]]
    separator: str

    @property
    def keys(self) -> list[str]:
        """Names of the columns, made different."""
        return [f"{name} #{i}" for i, name in enumerate(self.names)]


def layout_of(head: str) -> Layout | None:
    """Return the layout of a table that begins with the text `head`; None where that is none with places and times."""
    lines = head.split("\n")
    for place, line in enumerate(lines[:MOST_LINES]):
        separator = max(SEPARATORS, key=line.count)
        names = _cells(line, separator)
        columns = _columns(names)
        if set(names) & set(OWN_NAMES) or not {"latitude", "longitude"} <= columns.keys():
            continue
        if "time" in columns or "date" in columns:
            return _with_rows(Layout(place + 1, names, ("",) * len(names), columns, separator), lines)
    return None


def _columns(names: Sequence[str]) -> dict[str, list[int]]:
    """Places of the columns of each quantity, the best first, by their names."""
    meanings = [(meaning, i) for i, name in enumerate(names) if (meaning := meaning_of(name)) is not None]
    columns: dict[str, list[int]] = {}
    for meaning, i in sorted(meanings, key=lambda found: (found[0].rank, found[1])):
        columns.setdefault(meaning.quantity, []).append(i)
    return columns


def _with_rows(layout: Layout, lines: Sequence[str]) -> Layout | None:
    """The layout with the units below the names, if any are there; None where what follows is no row of such a table.

    A separator at the end of the names only, or of the rows only, is no column. Rows that are cut or overwritten are
    passed over, as those further down are: the first that is whole tells.
    """
    below = [i for i in range(layout.lines, len(lines)) if lines[i].strip() and not lines[i].startswith(COMMENT)]
    names = tuple(meaning.unit if (meaning := meaning_of(name)) is not None else "" for name in layout.names)
    if below and _is_units(units := _cells(lines[below[0]], layout.separator), layout):
        units = (units + ("",) * len(names))[: len(names)]
        layout = replace(
            layout, lines=below[0] + 1, units=tuple(a or b.lower() for a, b in zip(names, units, strict=True))
        )
        below = below[1:]
    else:
        layout = replace(layout, units=names)
    for i in below:
        row = _cells(lines[i], layout.separator)
        fitted = _ending_as(row, layout)
        if len(row) == len(fitted.names) and all(_is_number_or_blank(row[k]) for k in _places(fitted)):
            return fitted
        if len(row) == len(fitted.names) and not any(c in lines[i] for c in OVERWRITTEN):
            break
    return layout if not below or below[0] == len(lines) - 1 else None  # the last line may be cut


def _ending_as(row: Sequence[str], layout: Layout) -> Layout:
    """The layout with as many columns as a row, where that ends in a separator and the names do not, or they alone."""
    if len(row) == len(layout.names) + 1 and not row[-1]:
        return replace(layout, names=(*layout.names, ""), units=(*layout.units, ""))
    if len(row) == len(layout.names) - 1 and not layout.names[-1]:
        return replace(layout, names=layout.names[:-1], units=layout.units[:-1])
    return layout


def _is_units(cells: Sequence[str], layout: Layout) -> bool:
    """Whether a line below the names is one of units: words, and no places."""
    places = _places(layout)
    words = [cells[i] for i in places if i < len(cells)]
    return len(words) == len(places) and not any(any(c.isdigit() for c in word) for word in words)


def _places(layout: Layout) -> tuple[int, int]:
    return layout.columns["latitude"][0], layout.columns["longitude"][0]


def _is_number_or_blank(cell: str) -> bool:
    try:
        float(cell.replace(",", ".") or "nan")
    except ValueError:
        return False
    return True


def _cells(line: str, separator: str) -> tuple[str, ...]:
    return tuple(cell.strip(' "\ufeff\r') for cell in line.split(separator))
