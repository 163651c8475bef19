"""A sheet: columns (N,) with names and units, of rows that share their times, as whichever reader found them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.samples import Problem
from smoother.session.readers.names import UNITS, Meaning, meaning_of

OTHER_SOURCES = ("calc", "obd", "canbus", "can")  # sources that are no receiver and no sensor of motion
OF_RECEIVER, OF_FORCES, OF_RATES = "gps", "acc", "gyro"  # what sources are called


@dataclass(frozen=True, eq=False)
class Column:
    """One column: values (N,), NaN where a cell is no number. cells (N,) : as they stand, where they may be text.

    unread : how many cells hold something else than a number.
    """

    name: str
    values: Array
    unit: str = ""
    source: str = ""
    cells: pl.Series | None = None
    unread: int = 0

    def meaning(self, sensor: str) -> Meaning | None:
        """What it holds, None for a channel of another kind."""
        meaning = meaning_of(self.name, self.unit, sensor)
        if meaning is None or OF_RECEIVER in self.source or not self.source:
            return meaning
        if any(word in self.source for word in OTHER_SOURCES):
            return replace(meaning, rank=meaning.rank + 200)  # better than none, as in files of this program
        return replace(meaning, rank=meaning.rank + (0 if _fits(self.source, meaning.quantity) else 100))


def _fits(source: str, quantity: str) -> bool:
    """Whether a source that is no receiver is the one of a quantity."""
    return (OF_FORCES in source and quantity[0] == "a") or (OF_RATES in source and quantity[0] == "g")


@dataclass(frozen=True, eq=False)
class Sheet:
    """Columns of one file, or of a part of it. sensor : what it is called after; about : lines above, by name."""

    file: str
    columns: tuple[Column, ...]
    problems: tuple[Problem, ...] = ()
    sensor: str = ""
    about: dict[str, str] = field(default_factory=dict)
    places: dict[str, list[int]] = field(default_factory=dict)

    @property
    def length(self) -> int:
        """Rows."""
        return len(self.columns[0].values) if self.columns else 0

    def has(self, *quantities: str) -> bool:
        """Whether there is a column of each."""
        return all(quantity in self.places for quantity in quantities)

    def column(self, quantity: str) -> Column | None:
        """The best column of a quantity."""
        return self.columns[self.places[quantity][0]] if quantity in self.places else None

    def all_of(self, quantity: str) -> list[Column]:
        """Its columns, the best first."""
        return [self.columns[i] for i in self.places.get(quantity, [])]

    def unit(self, quantity: str) -> str:
        """Unit of the best column of a quantity as it is written, in lower case; "" without one, or if none is."""
        column = self.column(quantity)
        if column is None or (meaning := column.meaning(self.sensor)) is None:
            return ""
        return meaning.unit.strip().lower()

    def value(self, quantity: str, usual: str = "") -> Array:
        """The best column (N,) of a quantity in SI, angles in deg; NaN without one. usual : unit if none is written."""
        column = self.column(quantity)
        if column is None:
            return np.full(self.length, np.nan)
        units = UNITS.get(quantity, {})
        return column.values * units.get(self.unit(quantity), units.get(usual, 1.0))


def sheet_of(
    file: str,
    columns: Sequence[Column],
    problems: Sequence[Problem] = (),
    *,
    sensor: str = "",
    about: dict[str, str] | None = None,
) -> Sheet:
    """A sheet of columns that are all as long, sorted by what they hold."""
    return Sheet(
        file, tuple(columns), tuple(problems), sensor, about or {}, places_of([c.meaning(sensor) for c in columns])
    )


def places_of(meanings: Sequence[Meaning | None]) -> dict[str, list[int]]:
    """Places of the columns of each quantity, the best first."""
    found = [(meaning, i) for i, meaning in enumerate(meanings) if meaning is not None]
    places: dict[str, list[int]] = {}
    for meaning, i in sorted(found, key=lambda one: (one[0].rank, one[1])):
        places.setdefault(meaning.quantity, []).append(i)
    return places
