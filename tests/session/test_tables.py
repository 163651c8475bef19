"""Tables that are none, and such as are too long to be read at once."""

from pathlib import Path

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.session import tables
from smoother.session.tables import read_table


@pytest.mark.parametrize("start", [b"t_s,x\n", b"t_s,x\n" + b"1,2\n" * 500_000])
def test_an_endless_line_is_told_before_it_fills_the_memory(tmp_path: Path, start: bytes) -> None:
    path = tmp_path / "gps.csv"
    with path.open("wb") as file:
        file.write(start)
        file.seek(1 << 30)  # zeros as far as a gigabyte, without room on the disk
        file.write(b"\n")
    with pytest.raises(SessionError, match=r"^gps.csv: a line of more than 1048576 characters"):
        read_table(path, ("t_s", "x"))


def test_a_long_table_whose_last_row_has_no_end_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    path.write_bytes(b"t_s,x\n" + b"1,2\n" * 700_000 + b"3,4")
    assert read_table(path, ("t_s", "x")).length == 700_001


def test_a_long_table_is_read_in_parts_as_it_is_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [f"{i},{i / 7:.5f},2024-05-31T10:00:{i % 60:02d}Z" for i in range(900)]
    rows[100], rows[450:452], rows[700], rows[899] = "100, 5.5 ,", ["", "451,x,yesterday"], ",,", "899"
    path = tmp_path / "gps.csv"
    path.write_text("\n\nT_s,x,utc,more\n"[1:] + "\n".join(rows))

    def read() -> tables.Table:
        return read_table(path, ("t_s",), ("x",), ("utc",))

    at_once = read()
    monkeypatch.setattr(tables, "LONG_FILE", 0)
    monkeypatch.setattr(tables, "PART_BYTES", 1000)
    in_parts = read()
    assert in_parts.length == at_once.length > 890
    for name, column in at_once.columns.items():
        np.testing.assert_array_equal(in_parts.columns[name], column, err_msg=name)
    np.testing.assert_array_equal(in_parts.empty["t_s"], at_once.empty["t_s"])
