"""The header line of a table: names of columns made different, and lines between the rows that name them otherwise.

A file that goes on under another header, as after a new program on the logger or where files were joined, is cut there.
"""

import re
from collections.abc import Sequence

from smoother.session.table_bytes import separator_of

_MADE_DIFFERENT = re.compile(r"_duplicated_\d+$")


def unique_names(names: Sequence[str]) -> list[str]:
    """Trim and lower the header cells; a repeated or empty name gets a suffix no contract uses."""
    seen: dict[str, int] = {}
    unique = []
    for name in names:
        plain = name.strip("\ufeff\x00 \t\r\n\"'").lower()
        seen[plain] = seen.get(plain, 0) + 1
        unique.append(plain if plain and seen[plain] == 1 else _repeated(plain, seen[plain]))
    return unique


def own_names(names: Sequence[str]) -> list[str]:
    """The same of names that polars has made different in its own way."""
    return unique_names([_MADE_DIFFERENT.sub("", name) for name in names])


def _repeated(name: str, number: int) -> str:
    """What the column of a name is called that is the second of it, or of any other number."""
    return f"{name} #{number}"


def written_name(name: str) -> str:
    """What stands in the header, in lower case, of a column that `unique_names` may have given a suffix."""
    return name.partition(" #")[0]


def others_of_name(name: str, header: Sequence[str]) -> tuple[str, ...]:
    """The columns of a name beside the first, of all that `unique_names` made of a header."""
    return tuple(other for other in header if other != name and written_name(other) == name)


def header_of(line: str) -> list[str]:
    """Names of the columns by a header line, of which trailing separators are no part."""
    bare = line.rstrip(" \t\r\n,;")
    return unique_names(bare.split(separator_of(bare)))


def parts_by_header(table: bytes, required: Sequence[str]) -> list[tuple[int, bytes]]:
    """Cut a table, header first, where a line with all `required` names has others than the header before, or in
    another order; each part with the number of its first line, from 1.
    """
    parts, begin, line = [], 0, 1
    names = header_of(_line_at(table, len(table) - len(table.lstrip()))[1])
    for found in re.finditer(re.escape(required[0].encode()), table, re.IGNORECASE):
        start, text = _line_at(table, found.start())
        others = header_of(text)
        if start > begin and others != names and set(required) <= set(others) and not any(map(is_number, others)):
            parts.append((line, table[begin:start]))
            line += table.count(b"\n", begin, start)
            begin, names = start, others
    return [*parts, (line, table[begin:])]


def is_number(cell: str) -> bool:
    """Whether a cell of a table is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _line_at(table: bytes, place: int) -> tuple[int, str]:
    """Where the line begins that a place is in, and the line."""
    start, end = table.rfind(b"\n", 0, place) + 1, table.find(b"\n", place)
    return start, table[start : end if end >= 0 else len(table)].decode(errors="replace")
