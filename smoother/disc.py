"""Arrays that would fill the memory of a small computer: from a size on they live in unnamed files on the disc.

A file is unlinked as soon as it is open, so that nothing is left of it when the array or the process ends, however it
ends. What was read or written stays in memory until it is released; who goes through a large array in pieces releases
it after each.
"""

import contextlib
import ctypes
import gc
import mmap
import os
import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

LARGE = 32 << 20  # bytes; five hours of one column at 200 Hz
PIECE = 1 << 19  # rows that are worked on together; six columns of them are 25 MB
PLACE = Path("/var/tmp")  # where systems keep large temporary files, whose /tmp may be memory


def roomy(shape: int | tuple[int, ...], dtype: npt.DTypeLike = np.float64, large: int = LARGE) -> npt.NDArray[Any]:
    """Return an array of unset values: in memory, or from `large` bytes on in a file, if the disc has room for it."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size >= max(large, 1):
        with contextlib.suppress(OSError):  # a disc that is full or locked; the memory may do
            return np.ndarray(shape, dtype, buffer=_file(size))
    return np.empty(shape, dtype)


def kept(values: npt.NDArray[Any], large: int = LARGE) -> npt.NDArray[Any]:
    """Return a read-only copy made by :func:`roomy`; `values` themselves if they are such."""
    if _map_of(values) is not None and not values.flags.writeable:
        return values
    out = roomy(values.shape, values.dtype, large)
    for part in pieces(len(values)):
        out[part] = values[part]
        release(out, values)
    out.flags.writeable = False
    return out


class Shelf:
    """Read-only copies of many small arrays side by side in one made by :func:`roomy`: one file, not one for each.

    size : values that all of them hold together.
    """

    def __init__(self, size: int, large: int = LARGE) -> None:
        self._room, self._used = roomy(size, large=large), 0

    def keep(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return a copy of `values`, of float64."""
        place = self._room[self._used : self._used + values.size].reshape(values.shape)
        place[...] = values
        place.flags.writeable = False
        self._used += values.size
        release(self._room)
        return place


class Growing:
    """Rows that come part by part, however many: they are in memory, and from `large` bytes on in a file.

    width : shape of a row.
    """

    def __init__(self, width: tuple[int, ...] = (), dtype: npt.DTypeLike = np.float64, large: int = LARGE) -> None:
        self._room, self._length, self._large = np.empty((0, *width), dtype), 0, large

    def add(self, rows: npt.NDArray[Any]) -> None:
        """Append rows (n, *width)."""
        length = self._length + len(rows)
        if length > len(self._room):
            room = roomy((max(length, 2 * len(self._room)), *self._room.shape[1:]), self._room.dtype, self._large)
            for part in pieces(self._length):
                room[part] = self._room[part]
                release(room, self._room)
            self._room = room
        self._room[self._length : length] = rows
        self._length = length
        release(self._room)

    def __len__(self) -> int:
        return self._length

    @property
    def rows(self) -> npt.NDArray[Any]:
        """All rows so far, (N, *width), read-only."""
        rows = self._room[: self._length]
        rows.flags.writeable = False
        return rows


def release(*values: object) -> None:
    """Give back the memory of arrays in files, also of those in dataclasses, dicts, sequences; their values stay."""
    for value in values:
        if isinstance(value, (np.ndarray, mmap.mmap)):
            _forget(value)
        elif is_dataclass(value) and not isinstance(value, type):
            release(*(getattr(value, field.name) for field in fields(value)))
        elif isinstance(value, dict):
            release(*value.values())
        elif isinstance(value, (tuple, list)):
            release(*value)


def settle(*values: object) -> None:
    """Release values between two stages of a long session; what the C library keeps of freed memory goes back too.

    Left to itself it keeps hundreds of megabytes for arrays to come. Nothing happens where no value is in a file.
    """
    release(*values)
    if any(_is_in_file(value) for value in values):
        gc.collect()
        with contextlib.suppress(AttributeError, OSError, TypeError):  # a C library without it
            ctypes.CDLL(None).malloc_trim(0)


def _is_in_file(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return _map_of(value) is not None
    if is_dataclass(value) and not isinstance(value, type):
        return any(_is_in_file(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, dict):
        return any(map(_is_in_file, value.values()))
    return isinstance(value, (tuple, list)) and any(map(_is_in_file, value))


def pieces(n: int, size: int = PIECE) -> Iterator[slice]:
    """Slices of at most `size` rows that make up n rows."""
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))


def even_pieces(n: int, size: int) -> Iterator[slice]:
    """Slices of at most `size` rows that make up n rows and are as long as one another, to a row."""
    count = max(1, -(-n // size))
    for i in range(count):
        yield slice(i * n // count, (i + 1) * n // count)


def thinned(values: npt.NDArray[Any], step: int) -> npt.NDArray[Any]:
    """Return each `step`-th row; of a large array the memory is given back while it is gone through."""
    if step == 1:
        return values
    parts = []
    for part in pieces(len(values)):
        parts.append(values[part.start + -part.start % step : part.stop : step].copy())
        release(values)
    out = np.concatenate(parts) if parts else values
    out.flags.writeable = False
    return out


def contents(path: Path, large: int = LARGE) -> bytes | mmap.mmap:
    """Return the bytes of a file, a large one copied so that it need not be in memory. Raises OSError.

    A map of the file itself would end the process where a card is damaged or pulled out.
    """
    with path.open("rb") as source:
        size = os.fstat(source.fileno()).st_size
        if size >= large:
            with contextlib.suppress(OSError):
                return _copied(source, _file(size))
            source.seek(0)
        return source.read()


def _copied(source: BinaryIO, copy: mmap.mmap) -> mmap.mmap:
    while part := source.read(min(LARGE, len(copy) - copy.tell())):
        copy.write(part)
        release(copy)
    if copy.tell() < len(copy):
        raise OSError("the file became shorter")
    copy.seek(0)
    return copy


def _file(size: int) -> mmap.mmap:
    place = None if "TMPDIR" in os.environ or not PLACE.is_dir() else PLACE
    with tempfile.TemporaryFile(dir=place) as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)  # a hole that the disc cannot fill later would end the process
        else:
            for part in pieces(size, 1 << 20):
                file.write(bytes(part.stop - part.start))
            file.flush()
        return mmap.mmap(file.fileno(), size)


def _forget(values: npt.NDArray[Any] | mmap.mmap) -> None:
    """Drop the pages of the file that values lie in."""
    file = _map_of(values)
    if file is not None and hasattr(mmap, "MADV_DONTNEED"):
        file.madvise(mmap.MADV_DONTNEED)


def _map_of(values: npt.NDArray[Any] | mmap.mmap) -> mmap.mmap | None:
    """The file that values lie in, None if they are in memory."""
    base: object = values
    while isinstance(base, (np.ndarray, memoryview)):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    return base if isinstance(base, mmap.mmap) else None
