"""Rows that a spreadsheet sorted by their times as texts (0.1, 10.3, 11.1, 2.2): put back in order by number.

A clock that started again, or two drives in one file, do not stand in the order of texts, or not with one UTC.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from smoother.arrays import Array, IntArray, is_increasing
from smoother.disc import pieces, release
from smoother.session.rows import MOSTLY, is_even
from smoother.session.tables import Table

FEWEST_FALLS = 5  # steps back in time; 20 s from 0 on have as many, and clocks that start again hardly do
UTC_COLUMNS = ("unix_s", "utc", "utc_ms")  # the first that has times says whether rows are of one drive
DECIMALS = 9  # more than any clock has


def in_order_of_numbers(table: Table) -> Table:
    """Return a table with its rows by t_s, where they are sorted by it as text; else the table as it is."""
    t = table.column("t_s")
    if is_increasing(t) or _falls(t) < FEWEST_FALLS:
        return table
    known = np.isfinite(t)
    if not _is_sorted_as_text(t[known]):
        return table
    order = np.argsort(t, kind="stable")  # rows without a time go to the end
    if not _is_of_one_drive(table, order[: np.count_nonzero(known)]):
        return table
    columns = {name: column[order] for name, column in table.columns.items()}
    empty = {name: column[order] for name, column in table.empty.items()}
    moved = int(np.count_nonzero(order != np.arange(t.size)))
    return replace(table, columns=columns, empty=empty, sorted_as_text=moved)


def _falls(t: Array) -> int:
    """How many of the steps of t (N,) are back, looked at bit by bit."""
    count = 0
    for part in pieces(t.size - 1):
        count += int(np.count_nonzero(np.diff(t[part.start : part.stop + 1]) < 0.0))
        release(t)
    return count


def _is_sorted_as_text(t: Array) -> bool:
    """Whether t (N,), which falls, mostly does not as text; single rows may have been added or damaged since."""
    falls = np.flatnonzero(np.diff(t) < 0.0)
    at_falls = sum(_text(t[i]) > _text(t[i + 1]) for i in falls.tolist())
    if at_falls > (1.0 - MOSTLY) * falls.size:  # most files end here, before all their times are written
        return False
    texts = map(_text, t.tolist())
    return sum(before > after for before, after in pairwise(texts)) <= (1.0 - MOSTLY) * falls.size


def _text(t: float) -> str:
    return f"{t:.{DECIMALS}f}"


def _is_of_one_drive(table: Table, order: IntArray) -> bool:
    """Whether rows, in this order of their times, hardly share any, and UTC goes on with them.

    Where there is no UTC, the steps have to be even, which those of two drives sorted into one another are not.
    """
    t = table.column("t_s")[order]
    if np.mean(np.diff(t) > 0.0) < MOSTLY:
        return False
    utc = (table.column(name)[order] for name in UTC_COLUMNS)
    known = next((times[np.isfinite(times)] for times in utc if np.isfinite(times).any()), None)
    if known is None or known.size < MOSTLY * t.size:
        return is_even(t)
    return bool(np.mean(np.diff(known) >= 0.0) >= MOSTLY)
