"""Golden tables: text and back, tolerances of the head, what counts as moved, worst first."""

import math
from pathlib import Path

import pytest

from golden import FIRST, store
from golden_tables import Rows, Texts, beyond, changes, read_table, summary, text_of, texts_of, write_table

ROWS: Rows = {
    "kart": {"error.velocity": 0.123456, "exit": 0, "mode": "full", "quality.reasons": "far  from the\nfixes"},
    "kart_no_imu": {"error.velocity": 1.5, "exit": 3, "mode": "gps-only"},
}


def stored(tmp_path: Path, rows: Rows) -> tuple[Texts, list[tuple[str, float, float]]]:
    write_table(tmp_path / "table.txt", texts_of(rows))
    return read_table(tmp_path / "table.txt")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.123456, "0.1235"), (12345.678, "1.235e+04"), (-0.0, "0"), (3e-16, "0"), (7, "7"), ("", "-"), (math.nan, "nan")],
)
def test_a_value_has_four_digits(value: float | str, text: str) -> None:
    assert text_of(value) == text


def test_a_lap_time_shows_its_milliseconds() -> None:
    assert texts_of({"kart": {"lap.03.time": 38.3649}}) == {("kart", "lap.03.time"): "38.3649"}


def test_what_was_written_is_read(tmp_path: Path) -> None:
    texts, tolerances = stored(tmp_path, ROWS)
    assert texts["kart", "quality.reasons"] == "far from the fixes"
    assert texts == texts_of(ROWS)
    assert [pattern for pattern, _, _ in tolerances] == ["error.*"]


def test_the_same_rows_in_another_order_give_the_same_file(tmp_path: Path) -> None:
    write_table(tmp_path / "a.txt", texts_of(ROWS))
    write_table(tmp_path / "b.txt", texts_of(dict(reversed(ROWS.items()))))
    assert (tmp_path / "a.txt").read_bytes() == (tmp_path / "b.txt").read_bytes()


def test_tolerances_are_those_of_the_head(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    write_table(path, texts_of(ROWS))
    moved = texts_of({"kart": ROWS["kart"] | {"error.velocity": 0.15}})
    before, tolerances = read_table(path)
    assert [change.column for change in beyond(changes(before, moved, tolerances, ["kart"]))] == ["error.velocity"]
    path.write_text(path.read_text().replace("# error.*  0.04", "# error.*  0.40"))
    before, tolerances = read_table(path)
    assert beyond(changes(before, moved, tolerances, ["kart"])) == []


@pytest.mark.parametrize("column", ["exit", "mode"])
def test_what_has_no_tolerance_must_be_equal(tmp_path: Path, column: str) -> None:
    before, tolerances = stored(tmp_path, ROWS)
    after = texts_of(ROWS) | {("kart", column): "1"}
    assert [change.column for change in beyond(changes(before, after, tolerances))] == [column]


@pytest.mark.parametrize("lost", ["before", "after"])
def test_a_column_that_one_side_lacks_counts(lost: str) -> None:
    whole, less = texts_of(ROWS), texts_of(ROWS)
    del less["kart", "error.velocity"]
    pair = (less, whole) if lost == "before" else (whole, less)
    assert [change.excess for change in beyond(changes(*pair, [("error.*", 0.5, 0.5)]))] == [math.inf]


def test_a_number_that_becomes_nan_counts() -> None:
    before, after = texts_of(ROWS), texts_of({**ROWS, "kart": {**ROWS["kart"], "error.velocity": math.nan}})
    assert len(beyond(changes(before, after, [("*", 1e3, 1e3)]))) == 1


def test_worst_first_in_per_cent_and_sigmas() -> None:
    before = texts_of({"a": {"x": 10.0, "x.sigma": 2.0}, "b": {"x": 10.0}})
    after = texts_of({"a": {"x": 11.0, "x.sigma": 2.0}, "b": {"x": 5.0}})
    worst, other = changes(before, after, [("x", 0.01, 0.0)])
    assert (worst.row, worst.relative, worst.sigmas) == ("b", -0.5, None)
    assert (other.row, other.sigmas) == ("a", 0.5)
    assert "+10.0 %" in str(other) and "+0.50 sigma" in str(other)


def test_only_the_rows_asked_for_are_compared() -> None:
    before = texts_of({"a": {"x": 1}, "b": {"x": 1}})
    assert changes(before, texts_of({"a": {"x": 1}}), [], ["a"]) == []


def test_a_median_counts_unchanged_rows() -> None:
    before = texts_of({name: {"sigma": 1.0} for name in "abc"})
    two = before | {("a", "sigma"): "1.3", ("b", "sigma"): "1.3"}
    assert summary(changes(before, two, []), before) == ["sigma: median +30.0 % over 3 rows"]
    assert summary(changes(before, before | {("a", "sigma"): "1.3"}, []), before) == []


def test_a_table_with_a_row_missing_is_not_stored(tmp_path: Path) -> None:
    tables = {"simulated": texts_of(ROWS), "costs": {}}
    with pytest.raises(SystemExit, match="rows are missing: other"):
        store(tmp_path, tables, {"simulated": {"kart", "other"}}, keep=False)
    assert list(tmp_path.iterdir()) == []


def test_the_first_edition_is_never_rewritten(tmp_path: Path) -> None:
    tables = {"simulated": texts_of(ROWS), "costs": {}}
    store(tmp_path / FIRST, tables, {"simulated": {"kart"}}, keep=True)
    before = (tmp_path / FIRST / "simulated.txt").read_bytes()
    with pytest.raises(SystemExit, match="never rewritten"):
        store(tmp_path / FIRST, {"simulated": {}, "costs": {}}, {"simulated": set()}, keep=True)
    assert (tmp_path / FIRST / "simulated.txt").read_bytes() == before
