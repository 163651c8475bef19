"""Positions in another form than degrees, and times in another unit than seconds: one line with cause and remedy."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.session.csv_form import read_fixes
from smoother.session.load import load_raw

T = np.arange(500) / 5.0
LAT, LON = 45.0451 + 1e-3 * np.sin(T / 9.0), 12.1490 + 2e-3 * np.cos(T / 9.0)
NORTH = 111_195 * 1e-3 / 9.0 * np.cos(T / 9.0)
EAST = -111_195 * np.cos(np.radians(LAT)) * 2e-3 / 9.0 * np.sin(T / 9.0)


def write(path: Path, lat: Array, lon: Array, t: Array = T, form: str = ".10f", has_speed: bool = True) -> Path:
    course, speed = np.degrees(np.arctan2(EAST, NORTH)) % 360.0, np.hypot(NORTH, EAST)
    rows = [
        f"{t[k]:.9f},{lat[k]:{form}},{lon[k]:{form}}" + (f",{speed[k]:.3f},{course[k]:.2f}" if has_speed else "")
        for k in range(T.size)
    ]
    path.write_text("t_s,lat_deg,lon_deg" + (",speed_mps,course_deg" if has_speed else "") + "\n" + "\n".join(rows))
    return path


def minutes(degrees: Array) -> Array:
    return np.floor(degrees) * 100.0 + (degrees % 1.0) * 60.0


@pytest.mark.parametrize(
    ("make", "form", "has_speed", "named"),
    [
        (lambda lat, lon: (lon - 150.0, lat), ".10f", False, "swapped; exchange the names"),
        (lambda lat, lon: (np.radians(lat), np.radians(lon)), ".10f", True, "radians; multiply .* 57.29577951"),
        (lambda lat, lon: (np.radians(lat), np.radians(lon)), ".10f", False, "radians; multiply .* 57.29577951"),
        (lambda lat, lon: (lat * 1e7, lon * 1e7), ".0f", True, "integers of 1e-7 degrees .* divide .* by 10000000"),
        (lambda lat, lon: (minutes(lat), minutes(lon)), ".6f", True, r"NMEA's degrees and minutes \(ddmm.mmmm\)"),
        (lambda lat, lon: (lat * 1000.0, lon), ".6f", True, "no degrees on Earth; wanted are degrees"),
    ],
)
def test_positions_in_another_form_are_named_with_the_remedy(
    tmp_path: Path, make: Callable[[Array, Array], tuple[Array, Array]], form: str, has_speed: bool, named: str
) -> None:
    table = write(tmp_path / "gps.csv", *make(LAT, LON), form=form, has_speed=has_speed)
    with pytest.raises(SessionError, match=rf"^gps.csv: lat_deg \S+, lon_deg \S+ .*{named}"):
        read_fixes(table)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (-45.0451, -12.149), (-100.0, 167.85), (0.0, 330.0)])
@pytest.mark.parametrize("has_speed", [True, False])
def test_degrees_are_degrees_wherever_the_track_lies(
    tmp_path: Path, shift: tuple[float, float], has_speed: bool
) -> None:
    fixes, _ = read_fixes(write(tmp_path / "gps.csv", LAT + shift[0], LON + shift[1], has_speed=has_speed))
    assert len(fixes) == 500


def test_speeds_in_another_unit_are_no_minutes(tmp_path: Path) -> None:
    """Positions of which the way is as much too short: mph for km/h make 0.62, and places beyond 0.6 are none."""
    for shrunk, shift in ((0.6214, 0.0), (0.6, 0.7)):
        lat, lon = (v[0] + shrunk * (v - v[0]) for v in (LAT, LON))
        fixes, _ = read_fixes(write(tmp_path / "gps.csv", lat + shift, lon))
        assert len(fixes) == 500


def test_velocities_that_fit_nothing_leave_the_positions_alone(tmp_path: Path) -> None:
    assert len(read_fixes(write(tmp_path / "gps.csv", LAT[::-1], LON))[0]) == 500


def test_no_real_recording_is_taken_for_another_form(data_directory: Path) -> None:
    tables = sorted(data_directory.glob("*/gps.csv"))
    assert tables
    for table in tables:
        assert len(load_raw(table).gnss)
