"""Tables of other programs: AiM, RaceBox, RaceChrono, RaceCapture, TrackAddict, Harry's LapTimer, MoTeC, phones.

Lines about the session, a line with names, maybe lines with units and sources below, then rows.
"""

from pathlib import Path

from smoother.errors import SessionError
from smoother.session.readers.columns import recording_of
from smoother.session.readers.foreign import ForeignReading
from smoother.session.readers.layout import COMMENT, MOST_LINES, Layout, layout_of
from smoother.session.readers.sheet import Column, Sheet, sheet_of
from smoother.session.readers.text import head_of, read_rows

WHAT = "table with latitude, longitude and time"
TEXTUAL = ("time", "date", "latitude", "longitude", "fix")  # quantities whose cells may be more than numbers


def read_table(path: Path) -> ForeignReading:
    """Read such a table. Raises SessionError, one line, where it is none or nothing in it can be used."""
    return recording_of(path.name, [sheet_in(path)])


def sheet_in(path: Path) -> Sheet:
    """The sheet in a table. Raises SessionError, one line, where it is none."""
    layout, offset = layout_in(path)
    texts = {place for quantity in TEXTUAL for place in layout.places.get(quantity, ())}
    rows = read_rows(path, offset, len(layout.names), layout.separator, WHAT, texts=texts, comment=COMMENT)
    columns = [
        Column(
            name,
            rows.values[i],
            layout.units[i] or rows.units[i],
            layout.sources[i],
            rows.cells[i],
            rows.unread[i],
        )
        for i, name in enumerate(layout.names)
    ]
    return sheet_of(path.name, columns, rows.problems(path.name), sensor=layout.sensor, about=layout.about)


def layout_in(path: Path) -> tuple[Layout, int]:
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
    layout = layout_of("\n".join(lines), path.stem)
    if layout is None:
        raise SessionError(f"{path.name}: no {WHAT}")
    seen = iter(range(1, layout.lines))
    return layout, head_of(path, lambda line: next(seen, None) is None, WHAT)[1]
