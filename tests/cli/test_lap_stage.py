"""What a session states about its laps: the lines of the files that it was read from, of no others."""

from pathlib import Path

import pytest

from smoother.cli.lap_stage import stated
from smoother.config import SessionConfig

VBO = """[header]
time
[laptiming]
Start 2700.00 -720.00 2700.01 -720.01 finish
[column names]
time lat long
[data]
"""
GPS = "t_s,lat_deg,lon_deg\n0,45,12\n0.2,45.0001,12\n"


@pytest.mark.parametrize(("named", "lines"), [("", 0), ("gps.csv", 0), ("heat.vbo", 1)])
def test_lines_come_from_the_recording_that_is_read(tmp_path: Path, named: str, lines: int) -> None:
    (tmp_path / "heat.vbo").write_text(VBO)
    (tmp_path / "gps.csv").write_text(GPS)
    assert len(stated(SessionConfig(), tmp_path, tmp_path / named).own) == lines


def test_a_vbo_alone_in_its_folder_brings_its_lines(tmp_path: Path) -> None:
    (tmp_path / "heat.vbo").write_text(VBO)
    assert len(stated(SessionConfig(), tmp_path, tmp_path).own) == 1
