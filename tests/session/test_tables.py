"""Tables that are none, and such as are too long to be read at once."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.session import text
from smoother.session.tables import Table, read_table


@pytest.mark.parametrize("start", [b"t_s,x\n", b"t_s,x\n" + b"1,2\n" * 500_000])
def test_an_endless_line_is_refused_before_it_fills_the_memory(tmp_path: Path, start: bytes) -> None:
    path = tmp_path / "gps.csv"
    with path.open("wb") as file:
        file.write(start)
        file.seek(1 << 30)  # zeros as far as a gigabyte, without room on the disk
        file.write(b"\n")
    with pytest.raises(SessionError, match=r"^gps.csv: a line of more than 1048576 characters"):
        read_table(path, ("t_s", "x"))


@pytest.mark.parametrize(
    "data",
    [
        np.random.default_rng(1).bytes(200_000),
        np.random.default_rng(2).bytes(2_000_000),
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\3\x84\0\0\2X\x08\6\0\0\0\xa2\x9d\x7e",
        gzip.compress(np.random.default_rng(3).bytes(5000)),
        (Path(__file__).parent.parent / "data" / "golden.klg").read_bytes(),
    ],
)
def test_a_file_of_another_kind_is_refused_in_printable_characters(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "gps.csv").write_bytes(data)
    with pytest.raises(SessionError) as error:
        read_table(tmp_path / "gps.csv", ("t_s", "lat_deg", "lon_deg"))
    assert str(error.value) == (
        "gps.csv: not a text table, but a file of another kind; wanted t_s, lat_deg, lon_deg, .."
    )


def test_a_table_in_another_encoding_with_zeros_behind_it_is_a_table(tmp_path: Path) -> None:
    text = "Zeit,Länge,Höhe,Übergänge\n" + "1,2,3,4\n" * 9
    (tmp_path / "gps.csv").write_bytes(text.encode("latin-1") + b"\0" * 4000)
    with pytest.raises(SessionError, match=r"no column t_s; has zeit, l\?nge, h\?he, \?berg\?nge$"):
        read_table(tmp_path / "gps.csv", ("t_s",))


def test_names_of_columns_are_shown_without_control_characters_and_not_at_length(tmp_path: Path) -> None:
    (tmp_path / "gps.csv").write_text("\x1b[31mred\x07,\u202eeman," + "n" * 200 + "\n" + "1,2,3\n" * 30)
    with pytest.raises(SessionError) as error:
        read_table(tmp_path / "gps.csv", ("t_s",))
    assert str(error.value) == f"gps.csv: no column t_s; has ?[31mred?, ?eman, {'n' * 22}.."


def test_a_long_table_whose_last_row_has_no_end_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    path.write_bytes(b"t_s,x\n" + b"1,2\n" * 700_000 + b"3,4")
    assert read_table(path, ("t_s", "x")).length == 700_001


def test_a_long_table_is_read_in_parts_as_it_is_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [f"{i},{i / 7:.5f},2024-05-31T10:00:{i % 60:02d}Z" for i in range(900)]
    rows[100], rows[450:452], rows[700], rows[899] = "100, 5.5 ,", ["", "451,x,yesterday"], ",,", "899,1"
    path = tmp_path / "gps.csv"
    path.write_text("\nT_s,x,utc\n" + "\n".join(rows))

    def read() -> Table:
        return read_table(path, ("t_s",), ("x",), ("utc",))

    at_once = read()
    monkeypatch.setattr(text, "BLOCK_BYTES", 1000)
    in_parts = read()
    assert in_parts.length == at_once.length == 898
    for name, column in at_once.columns.items():
        np.testing.assert_array_equal(in_parts.columns[name], column, err_msg=name)
    assert in_parts.unread == at_once.unread


PLAIN = 't_s,x,note\n0.5,-1.25,"a"\n1.5,2e-3,b\n'


@pytest.mark.parametrize(
    "text",
    [
        PLAIN.replace(",", ";"),
        PLAIN.replace(",", "\t"),
        PLAIN.replace(",", ";").replace(".", ","),
        PLAIN.replace(",", "\t").replace(".", ","),
        '"","t_s","x","note"\n"1","0.5",-1.25,"a, b"\n"2","1.5","2e-3","c"\n',
        '"note","t_s","x"\r\n"a, b","0,5","-1,25"\r\n"c","1,5","0,002"\r\n',
        '"t_s";"x";"note"\n"0,5";"-1,25";"a; b"\n1,5;0,002;say ""so""\n',
    ],
)
def test_a_table_is_read_as_the_spreadsheet_of_any_country_writes_it(tmp_path: Path, text: str) -> None:
    path = tmp_path / "gps.csv"
    path.write_text(text)
    table = read_table(path, ("t_s", "x"))
    np.testing.assert_array_equal(table.stack("t_s", "x"), [[0.5, -1.25], [1.5, 0.002]])


@pytest.mark.parametrize("damage", ['"', '5,"6', '","', '"5,6', '5"",6', '"\r'])
@pytest.mark.parametrize("is_long", [False, True])
def test_a_stray_quotation_mark_costs_no_row_but_its_own(
    tmp_path: Path, damage: str, is_long: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [f"{i},{2 * i}" for i in range(300)]
    rows[100] = rows[200] = damage
    path = tmp_path / "gps.csv"
    path.write_text("t_s,x\n" + "\n".join(rows) + "\n")
    if is_long:
        monkeypatch.setattr(text, "BLOCK_BYTES", 500)
    read = read_table(path, ("t_s", "x")).stack("t_s", "x")
    whole = read[np.isfinite(read).all(axis=1) & (read[:, 1] == 2 * read[:, 0])]
    np.testing.assert_array_equal(whole[:, 0], [i for i in range(300) if i not in (100, 200)])


TABLE = "t_s,x,note\n" + "".join(f"{i / 4},{-i},n\n" for i in range(40))


def numbers(path: Path) -> list[list[float]]:
    rows: list[list[float]] = read_table(path, ("t_s", "x")).stack("t_s", "x").tolist()
    return rows


@pytest.mark.parametrize(
    "content",
    [
        TABLE.encode("utf-16-le"),
        TABLE.encode("utf-16-be"),
        TABLE.encode("utf-16"),
        ("#,t_s,x\n" + "".join(f"{i},{i / 4},{-i}\n" for i in range(40))).encode(),
    ],
)
def test_encodings_without_a_mark_cost_nothing(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "gps.csv"
    path.write_bytes(content)
    assert numbers(path) == [[i / 4, -i] for i in range(40)]


@pytest.mark.parametrize("content", [b"#", b"\0" * 600])
def test_zeros_alone_are_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "gps.csv"
    path.write_bytes(content)
    with pytest.raises(SessionError, match=r"^gps.csv: "):
        read_table(path, ("t_s", "x"))


def test_decimal_commas_between_commas_are_reported_and_not_read_as_other_numbers(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    rows = "".join(f"{i},25,-{i},5\n" for i in range(40))
    path.write_text(f"t_s,x\n{rows}")
    with pytest.raises(
        SessionError,
        match=r"^gps.csv: rows have 4 values, but 2 columns are named; .* write semicolons",
    ):
        read_table(path, ("t_s", "x"))


@pytest.mark.parametrize("tail", [",,", ", ,"])
def test_empty_cells_behind_the_last_column_are_none(tmp_path: Path, tail: str) -> None:
    path = tmp_path / "gps.csv"
    path.write_text("t_s,x\n" + "".join(f"{i}.5,{i}.25{tail}\n" for i in range(40)))
    assert numbers(path) == [[i + 0.5, i + 0.25] for i in range(40)]


@pytest.mark.parametrize("name", ["run[1]", "run*", "run?", "[2026-05-16] Adria", "{a,b}", "~", "file:"])
def test_a_name_is_no_pattern_that_another_file_may_match(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder, value in (("run1", 7.0), (name, 1.0)):
        Path(folder).mkdir()
        (Path(folder) / "gps.csv").write_text(f"t_s,x\n{value},{value}\n" * 1)
    table = read_table(Path(name) / "gps.csv", ("t_s", "x"))
    assert table.column("x").tolist() == [1.0]


def test_a_cell_in_quotation_marks_may_hold_separators_line_ends_and_marks(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    rows = [f'{i},"a, ""b""\nof {i}",{2 * i}' for i in range(30)]
    path.write_text("t_s,note,x\n" + "\n".join(rows) + "\n")
    assert numbers(path) == [[i, 2 * i] for i in range(30)]


def test_a_unit_in_all_cells_of_a_column_is_not_taken_for_that_of_its_name(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    path.write_text("t_s,x\n" + "".join(f"{i},{i}.5 km/h\n" for i in range(30)))
    table = read_table(path, ("t_s",), ("x",))
    assert np.isnan(table.column("x")).all() and table.unread == {"x": 30}


def test_rows_with_too_many_or_too_few_cells_and_comments_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "gps.csv"
    rows = [f"{i},{2 * i}" for i in range(60)]
    rows[10], rows[20], rows[30], rows[40] = "10", "20,40,41", "# lap 2, 30 s", " "
    path.write_text("t_s,x\n" + "\n".join(rows) + "\n")
    table = read_table(path, ("t_s", "x"))
    assert table.column("t_s").tolist() == [i for i in range(60) if i not in (10, 20, 30, 40)]
    assert [(problem.code, problem.count) for problem in table.problems] == [("gps_row_damaged", 2)]


@pytest.mark.parametrize("block", [700, 1 << 20])
def test_a_long_packed_or_wide_table_is_read_as_a_plain_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    monkeypatch.setattr(text, "BLOCK_BYTES", block)
    content = TABLE.replace("\n", "\r\n")
    wanted = [[i / 4, -i] for i in range(40)]
    for data in (
        content.encode(),
        content.encode("utf-16"),
        gzip.compress(content.encode()),
        content.encode() + bytes(900),
    ):
        path = tmp_path / ("gps.csv.gz" if data.startswith(b"\x1f") else "gps.csv")
        path.write_bytes(data)
        assert numbers(path) == wanted
