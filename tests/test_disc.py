"""Arrays on the disc: they behave as others do, take no memory when released, and leave nothing behind."""

import errno
import mmap
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from smoother import disc
from smoother.disc import LARGE, Growing, Shelf, contents, even_pieces, kept, pieces, release, roomy, settle, thinned


def resident() -> int:
    """Bytes of this process in memory."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * mmap.PAGESIZE


def is_on_disc(values: np.ndarray) -> bool:
    return isinstance(values.base, mmap.mmap)


def test_small_arrays_stay_in_memory_and_large_ones_go_to_the_disc() -> None:
    assert not is_on_disc(roomy((1000, 3)))
    assert is_on_disc(roomy(LARGE // 8))


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is told by Linux alone")
def test_a_released_array_keeps_its_values_but_no_memory() -> None:
    values = roomy(8 * LARGE // 8)
    before = resident()
    values[:] = np.arange(len(values))
    assert resident() - before > 7 * LARGE
    release(values)
    assert resident() - before < LARGE
    assert values[-1] == len(values) - 1


def test_release_finds_arrays_in_dataclasses_and_leaves_others_alone() -> None:
    @dataclass
    class Holder:
        values: np.ndarray
        parts: tuple[np.ndarray, ...]
        name: str = "holder"

    holder = Holder(np.arange(3.0), (kept(np.arange(5.0), large=1)[1:], np.ones(2)))
    release(holder, {"name": holder})
    np.testing.assert_array_equal(holder.parts[0], [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(holder.values, [0.0, 1.0, 2.0])


def test_what_is_kept_cannot_be_written_to() -> None:
    assert not kept(np.arange(5.0), large=1).flags.writeable


@pytest.mark.parametrize("large", [1, LARGE])
def test_small_arrays_lie_side_by_side_and_keep_their_values(large: int) -> None:
    arrays = [np.arange(24.0).reshape(2, 3, 4), np.ones((5, 0)), -np.arange(7.0)]
    shelf = Shelf(sum(a.size for a in arrays), large)
    copies = [shelf.keep(a) for a in arrays]
    release(copies)
    for a, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(copy, a)
        assert not copy.flags.writeable
    assert np.shares_memory(copies[0].base, copies[2].base)


def test_nothing_is_left_on_the_disc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    values = roomy(100, large=1)
    values[:] = 1.0
    assert is_on_disc(values)
    assert list(tmp_path.iterdir()) == []


def test_without_room_on_the_disc_the_memory_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(size: int) -> mmap.mmap:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(disc, "_file", full)
    assert not is_on_disc(roomy(10, large=1))


def test_a_system_that_cannot_reserve_room_writes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "posix_fallocate", raising=False)
    values = roomy(300_000, large=1)
    np.testing.assert_array_equal(values, 0.0)


def test_an_array_of_nothing_is_in_memory() -> None:
    assert roomy((0, 3), large=0).shape == (0, 3)


@pytest.mark.parametrize("size", [0, 5, 3_000_000])
def test_contents_are_the_bytes_of_the_file(size: int, tmp_path: Path) -> None:
    data = np.random.default_rng(1).bytes(size)
    (tmp_path / "log").write_bytes(data)
    assert bytes(contents(tmp_path / "log", large=1)) == data
    assert bytes(contents(tmp_path / "log")) == data
    assert contents(tmp_path / "log", large=1).find(data[-3:], 0) == max(size - 3, 0)


def test_pieces_make_up_the_whole() -> None:
    assert [range(10)[piece] for piece in pieces(10, 4)] == [range(4), range(4, 8), range(8, 10)]
    assert list(pieces(0)) == []


def test_even_pieces_make_up_the_whole_and_none_is_a_remnant() -> None:
    assert [range(10)[piece] for piece in even_pieces(10, 4)] == [range(3), range(3, 6), range(6, 10)]
    assert [range(8)[piece] for piece in even_pieces(8, 8)] == [range(8)]
    assert [range(0)[piece] for piece in even_pieces(0, 8)] == [range(0)]


@pytest.mark.parametrize("large", [1, LARGE])
def test_rows_that_come_in_parts_make_up_the_whole(large: int) -> None:
    rng = np.random.default_rng(1)
    parts = [rng.integers(0, 9, (n, 3)).astype(np.int16) for n in (0, 4, 1, 30, 7, 0, 200)]
    growing = Growing((3,), np.int16, large)
    for part in parts:
        growing.add(part)
    np.testing.assert_array_equal(growing.rows, np.concatenate(parts))
    assert len(growing) == 242
    assert growing.rows.dtype == np.int16
    assert not growing.rows.flags.writeable


def test_what_is_kept_already_is_not_copied() -> None:
    once = kept(np.arange(5.0), large=1)
    assert kept(once, large=1) is once


@pytest.mark.parametrize("step", [1, 3, 7])
def test_thinning_takes_each_nth_row_of_all(step: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disc, "pieces", lambda n: pieces(n, 10))
    values = np.arange(46.0).reshape(23, 2)
    np.testing.assert_array_equal(thinned(values, step), values[::step])


def test_values_survive_the_end_of_a_stage() -> None:
    on_disc, in_memory = kept(np.arange(5.0), large=1), np.arange(3)
    settle(on_disc, (in_memory,), None)
    np.testing.assert_array_equal(on_disc, np.arange(5.0))
    np.testing.assert_array_equal(in_memory, np.arange(3))


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is told by Linux alone")
@pytest.mark.parametrize("hide", [lambda v: {"values": v}, lambda v: [(v,)]])
def test_arrays_are_found_wherever_they_are_held(hide: Callable[[np.ndarray], object]) -> None:
    values = roomy(4 * LARGE // 8)
    before = resident()
    values[:] = 1.0
    release(hide(values))
    assert resident() - before < LARGE
