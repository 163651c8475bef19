"""Files that look like a recording and are none: the reason is said, with what to do."""

import time
from pathlib import Path

import pytest

from smoother.errors import SessionError
from smoother.session.load import load_raw

FIXES = "t_s,lat_deg,lon_deg\n" + "".join(f"{k / 5:.1f},{45 + 1e-4 * k:.7f},12\n" for k in range(50))


def refusal(folder: Path) -> str:
    with pytest.raises(SessionError) as error:
        load_raw(folder)
    return str(error.value)


@pytest.mark.parametrize(
    "name", ["gps.csv", "imu.csv", "mag.csv", "x.nmea", "x.vbo", "x.gpx", "x.klg", "out.txt", "a.csv"]
)
def test_a_file_that_is_one_large_hole_is_refused_at_once(tmp_path: Path, name: str) -> None:
    (tmp_path / "gps.csv").write_text(FIXES)
    with (tmp_path / name).open("ab") as file:
        file.truncate(50 << 30)
    if (tmp_path / name).stat().st_blocks > 1 << 20:
        pytest.skip("this disk has no holes in files")
    begin = time.monotonic()
    said = refusal(tmp_path)
    assert time.monotonic() - begin < 20.0  # to read it would take minutes
    assert said.startswith(f"{name}: 53.7 GB long, of which 0") and said.endswith("copy it from the card again")


def test_a_hole_beside_the_file_that_was_named_harms_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(FIXES)
    with (tmp_path / "other.csv").open("ab") as file:
        file.truncate(50 << 30)
    assert len(load_raw(tmp_path / "a.csv").gnss) == 50


def test_samples_that_were_never_written_leave_the_fixes(tmp_path: Path) -> None:
    (tmp_path / "gps.csv").write_text(FIXES)
    (tmp_path / "imu.csv").write_bytes(bytes(200_000))
    raw = load_raw(tmp_path)
    assert raw.imu is None and len(raw.gnss) == 50
    (said,) = [problem.text for problem in raw.problems if problem.code == "imu_empty"]
    assert said == "imu.csv: begins with 65536 zero bytes; was it ever written? Copy it again"


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le"])
def test_a_table_of_an_unknown_program_in_another_encoding_is_shown(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "x.csv").write_bytes("Record,Latitude,Longitude\n1,2,3\n".encode(encoding))
    assert "no recording found, but x.csv" in refusal(tmp_path) and "Record, Latitude" in refusal(tmp_path)
