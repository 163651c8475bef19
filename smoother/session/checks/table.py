"""The type of a check, what it may find, and the one loop that runs a table of checks.

A check looks at streams and returns a finding or None. The loop reports what was found and applies it; a check changes
nothing itself, and the next one sees what the one before has left.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.samples import Problem
from smoother.words import counted


class Streams(Protocol):
    """What checks look at: named streams, each a dataclass of columns with `t`, and the file each came from."""

    def stream(self, name: str) -> Any:
        """Return a stream, None where there is none."""

    def file_of(self, name: str) -> str:
        """Return the name of its file."""

    def with_stream(self: "S", name: str, rows: Any) -> "S":
        """Return the same with another stream of that name."""


S = TypeVar("S", bound=Streams)
D = TypeVar("D")


@dataclass(frozen=True, eq=False)
class Finding:
    """What a check found in a stream of N rows: one sentence for people, and at most one change.

    text : completes '<file>: ..' with what, where, how many and what to do; an empty one is not reported.
    drop : mask (N,) of rows that are not used. blank : columns, and masks (N,) of where they are unknown. scale :
    columns, and factors.
    """

    text: str = ""
    count: int = 1
    drop: BoolArray | None = None
    blank: Mapping[str, BoolArray] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)


def dropped(bad: BoolArray, reason: str, most: float = 1.0) -> Finding | None:
    """Rows of mask (N,) that are not used, and why, unless there is none, or they are more than a share of all."""
    count = int(np.count_nonzero(bad))
    if not 0 < count <= most * bad.size:
        return None
    return Finding(f"{counted(count, 'row')} {reason}; dropped", count, drop=bad)


@dataclass(frozen=True)
class Check(Generic[S]):
    """One check: the code that summary.json knows it by, the stream it changes, the columns of it that it needs."""

    code: str
    stream: str
    needs: tuple[str, ...]
    find: Callable[[S], Finding | None]


O = TypeVar("O", bound="OneStream")


@dataclass(frozen=True, eq=False)
class OneStream:
    """A single stream, and its file."""

    name: str
    file: str
    rows: Any

    def stream(self, name: str) -> Any:
        """Return the rows, None where none is left."""
        return self.rows if name == self.name and len(self.rows.t) else None

    def file_of(self, name: str) -> str:
        """Return the name of the file."""
        return self.file

    def with_stream(self: O, name: str, rows: Any) -> O:
        """Return the same with other rows."""
        return replace(self, rows=rows)


def run(checks: Iterable[Check[S]], streams: S) -> tuple[S, list[Problem]]:
    """Return the streams as the findings of all checks leave them, and what is to be said of them."""
    problems = []
    for check in checks:
        rows = streams.stream(check.stream)
        if rows is None or not all(_is_known(getattr(rows, name)) for name in check.needs):
            continue
        finding = check.find(streams)
        if finding is None:
            continue
        if finding.text:
            text = f"{streams.file_of(check.stream)}: {finding.text}"
            problems.append(Problem(check.code, text, finding.count))
        streams = streams.with_stream(check.stream, changed(rows, finding))
    return streams, problems


def changed(rows: D, finding: Finding) -> D:
    """Return a dataclass of columns as a finding leaves it."""
    new: dict[str, Any] = {name: np.where(where, np.nan, getattr(rows, name)) for name, where in finding.blank.items()}
    new |= {name: getattr(rows, name) * by for name, by in finding.scale.items()}
    assert is_dataclass(rows) and not isinstance(rows, type)
    rows = replace(rows, **new) if new else rows
    return rows if finding.drop is None or not finding.drop.any() else only(rows, ~finding.drop)


def only(rows: D, keep: BoolArray) -> D:
    """Return the rows of a mask (N,): of every column, which is what has one value a row."""
    assert is_dataclass(rows) and not isinstance(rows, type)
    values = {column.name: getattr(rows, column.name) for column in fields(rows) if column.init}
    index = np.flatnonzero(keep)
    columns = {name: x[index] for name, x in values.items() if isinstance(x, np.ndarray) and len(x) == keep.size}
    return replace(rows, **columns)


def _is_known(values: Array) -> bool:
    """Whether a column (N,) or (N, M) has a value anywhere."""
    return bool(np.isfinite(values[:1]).all() or np.isfinite(values).any())
