"""The GPS sentences of a recording, a day of which would take a quarter of a gigabyte as objects of their own."""

from collections.abc import Iterator, Sequence
from operator import eq
from typing import overload

import numpy as np

from smoother.disc import Growing, pieces, release

TOGETHER = 1 << 14  # sentences that are taken out at once


class Sentences(Sequence[tuple[int, bytes]]):
    """Pairs of time in us and text that behave like a tuple of them; held as columns, on the disc where they are many.

    Filled by `extend` while a recording is decoded, and not changed after.
    """

    def __init__(self) -> None:
        self._t_us, self._end, self._text = Growing(dtype=np.int64), Growing(dtype=np.int64), Growing(dtype=np.uint8)

    def extend(self, sentences: Sequence[tuple[int, bytes]]) -> None:
        """Append pairs of time in us and text."""
        lengths = np.array([len(text) for _, text in sentences], dtype=np.int64)
        self._end.add(len(self._text) + np.cumsum(lengths))
        self._t_us.add(np.array([t_us for t_us, _ in sentences], dtype=np.int64))
        self._text.add(np.frombuffer(b"".join(text for _, text in sentences), dtype=np.uint8))

    def __len__(self) -> int:
        return len(self._t_us)

    @overload
    def __getitem__(self, at: int) -> tuple[int, bytes]: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[tuple[int, bytes], ...]: ...
    def __getitem__(self, at: int | slice) -> tuple[int, bytes] | tuple[tuple[int, bytes], ...]:
        rows = range(len(self))[at]
        if isinstance(rows, int):
            return self._between(rows, rows + 1)[0]
        return tuple(self._between(row, row + 1)[0] for row in rows)

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        for some in pieces(len(self), TOGETHER):
            yield from self._between(some.start, some.stop)
            release(self._t_us.rows, self._end.rows, self._text.rows)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and len(self) == len(other) and all(map(eq, self, other))

    __hash__ = None  # type: ignore[assignment]  # it is filled bit by bit

    def __repr__(self) -> str:
        return repr(tuple(self))

    def _between(self, first: int, last: int) -> list[tuple[int, bytes]]:
        start = int(self._end.rows[first - 1]) if first else 0
        ends = (self._end.rows[first:last] - start).tolist()
        text = self._text.rows[start : start + ends[-1]].tobytes()
        times = self._t_us.rows[first:last].tolist()
        return [(t, text[begin:end]) for t, begin, end in zip(times, [0, *ends[:-1]], ends, strict=True)]
