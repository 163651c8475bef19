"""What is done to the bytes of a file."""

import gzip
from collections.abc import Callable
from pathlib import Path

import pytest

from golden_damaged import (
    BLOCK,
    CASES,
    QUICK,
    bits_flipped,
    blocks,
    blocks_damaged,
    cells,
    checksums_bad,
    cut,
    damaged,
    decimal_commas,
    filled,
    folder_for_file,
    gzipped,
    lost,
    noise,
    only_file,
    overwritten,
    recoded,
    repeated,
    rows,
    scaled,
    shuffled,
    swapped,
    without_column,
    without_header,
    write_other_formats,
)

TABLE = b"t_s,a,b\n" + b"".join(b"%d,%d.5,%d\n" % (i, i, 10 * i) for i in range(20))
LINES = TABLE.splitlines()


@pytest.mark.parametrize(
    ("mutate", "after"),
    [
        (cut(0.5), TABLE[: len(TABLE) // 2]),
        (without_header, TABLE.partition(b"\n")[2]),
        (decimal_commas, TABLE.replace(b",", b";").replace(b".", b",")),
        (recoded("utf-16"), TABLE.decode().encode("utf-16")),
        (lost(3, 5), b"\n".join([*LINES[:4], *LINES[9:], b""])),
        (repeated(3, 5), b"\n".join([*LINES[:9], *LINES[4:], b""])),
        (swapped(0), b"\n".join([LINES[0], LINES[2], LINES[1], *LINES[3:], b""])),
    ],
)
def test_what_becomes_of_a_table(mutate: Callable[[bytes], bytes], after: bytes) -> None:
    assert mutate(TABLE) == after


def test_cells_change_in_their_column_and_rows_alone() -> None:
    changed = filled(b"nan", "a", 5, 9, 2)(TABLE).splitlines()
    assert [i for i, (old, new) in enumerate(zip(LINES, changed, strict=True)) if old != new] == [6, 8]
    assert changed[6] == b"5,nan,50"
    assert cells("b", lambda cell: cell + b"!", 19)(TABLE).endswith(b"190!\n")


def test_units_and_columns() -> None:
    assert scaled(1000.0, "t_s", "b")(TABLE).splitlines()[4] == b"3000,3.5,30000"
    assert without_column("a")(TABLE).splitlines()[:2] == [b"t_s,b", b"0,0"]


def test_shuffled_rows_are_the_same_rows_in_the_same_other_order() -> None:
    once, again = rows(shuffled)(TABLE), rows(shuffled)(TABLE)
    assert once == again != TABLE
    assert sorted(once.splitlines()) == sorted(LINES)


@pytest.mark.parametrize(
    "mutate", [noise(0.5, 30), bits_flipped(5), overwritten(255, 0.5, 30), overwritten(0, 0.9, 999)]
)
def test_bytes_are_damaged_in_place_and_alike_each_time(mutate: Callable[[bytes], bytes]) -> None:
    assert len(mutate(TABLE)) == len(TABLE)
    assert mutate(TABLE) == mutate(TABLE) != TABLE


def test_a_bit_in_every_twentieth_block() -> None:
    data = bytes(BLOCK * 40)
    changed = blocks(blocks_damaged)(data)
    hit = {i // BLOCK for i, (old, new) in enumerate(zip(data, changed, strict=True)) if old != new}
    assert hit == {10, 30}


def test_sentences_keep_the_checksum_of_before() -> None:
    lines = b"".join(b"%d,$GPRMC,1,A,5,N,6,E*11\r\n" % i for i in range(20))
    changed = checksums_bad(lines).splitlines()
    assert [b",S," in line for line in changed] == [i in (5, 15) for i in range(20)]
    assert all(line.endswith(b"*11") for line in changed)


@pytest.fixture
def good(tmp_path: Path) -> Path:
    folder = tmp_path / "good" / "csv"
    folder.mkdir(parents=True)
    for name in ("imu.csv", "gps.csv"):
        (folder / name).write_bytes(TABLE)
    return tmp_path / "good"


def test_files_are_damaged_in_a_copy(good: Path, tmp_path: Path) -> None:
    damaged("csv", imu_csv=cut(0.5), gps_csv=None, session_toml=b"x")(good, tmp_path / "a")
    assert {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()} == {
        "imu.csv": TABLE[: len(TABLE) // 2],
        "session.toml": b"x",
    }
    folder_for_file("gps.csv")(good, tmp_path / "b")
    assert (tmp_path / "b" / "gps.csv").is_dir()
    gzipped(lambda data: data)(good, tmp_path / "c")
    assert gzip.decompress((tmp_path / "c" / "imu.csv.gz").read_bytes()) == TABLE
    assert not (tmp_path / "c" / "imu.csv").exists()
    assert (good / "csv" / "imu.csv").read_bytes() == TABLE
    (good / "csv" / "gps.csv").unlink()
    only_file("csv", "csv", lambda data: b"")(good, tmp_path / "d")
    assert (tmp_path / "d" / "imu.csv").read_bytes() == b""


def test_the_other_formats_have_the_fixes_of_the_table(tmp_path: Path) -> None:
    folder = tmp_path / "csv"
    folder.mkdir()
    (folder / "imu.csv").write_bytes(TABLE)
    (folder / "gps.csv").write_text(
        "t_s,unix_s,lat_deg,lon_deg,alt_m,speed_mps,course_deg\n"
        "0.2,1778925600.2,52.5,17.25,100.0,10.0,90.0\n0.4,1778925600.4,52.51,17.26,101.0,20.0,180.0\n"
    )
    write_other_formats(tmp_path)
    sentence = (tmp_path / "nmea" / "gps.nmea").read_text().splitlines()[0]
    assert sentence.startswith("0.200000,$GPRMC,100000.20,A,5230.00000,N,01715.00000,E,19.438,90.00,160526,,,A*")
    assert "100000.400 +03150.600000 -01035.600000 072.000 180.000" in (tmp_path / "vbo" / "run.vbo").read_text()
    points = (tmp_path / "gpx" / "run.gpx").read_text()
    assert 'lat="52.510000000" lon="17.260000000"' in points
    assert "2026-05-16T10:00:00.400Z" in points
    assert "1778925600.400,0,2.00,101.00,180.00,3," in (tmp_path / "racechrono" / "session.csv").read_text()


def test_names_are_unique_words_and_ten_are_quick() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names) >= 60
    assert not any(" " in name for name in names)
    assert set(names) >= QUICK
    assert sum(case.quick for case in CASES) == 10
