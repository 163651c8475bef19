"""What a session states about its laps: the lines of the VBO that it is, or that lies beside it."""

from pathlib import Path

import pytest

from smoother.config import SessionConfig
from smoother.laps.stage import read_stated

VBO = """[header]
time
[laptiming]
Start 2700.00 -720.00 2700.01 -720.01 finish
[column names]
time lat long
[data]
"""
GPS = "t_s,lat_deg,lon_deg\n0,45,12\n0.2,45.0001,12\n"


@pytest.mark.parametrize("named", ["", "heat.vbo"])
@pytest.mark.parametrize("beside", [True, False])
def test_a_vbo_brings_its_lines(tmp_path: Path, named: str, beside: bool) -> None:
    """Also to a table of fixes of the same drive, which has none; lines of another track lie across no lap of it."""
    (tmp_path / "heat.vbo").write_text(VBO)
    if beside:
        (tmp_path / "gps.csv").write_text(GPS)
    assert len(read_stated(SessionConfig(), tmp_path, tmp_path / named).own) == 1
