"""Tables that are none."""

from pathlib import Path

import pytest

from smoother.errors import SessionError
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
