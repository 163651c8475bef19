"""A velocity that its positions contradict: not used, and said so; one that agrees stays as it is."""

from pathlib import Path

import numpy as np
import pytest

from smoother.samples import GnssFixes
from smoother.session.csv_form import read_fixes

SPEED = 14.0  # m/s


def lap(directory: Path, **columns: np.ndarray | None) -> tuple[GnssFixes, dict[str, str]]:
    """Fixes of two minutes round an oval at 5 Hz, 0.2 m noisy, with the columns changed, or left out for None."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 120.0, 0.2)
    course, speed = t / 5.0 + 0.3 * np.sin(t), SPEED + 4.0 * np.sin(t / 4.0)
    velocity = speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    north, east = np.cumsum(velocity, axis=0).T * 0.2 + 0.2 * rng.standard_normal((2, t.size))
    table = {
        "t_s": t,
        "lat_deg": 45 + north / 111_195,
        "lon_deg": 12 + east / 111_195 / np.cos(np.pi / 4),
        "speed_mps": speed,
        "course_deg": np.degrees(course) % 360.0,
    } | columns
    names = [name for name, values in table.items() if values is not None]
    rows = np.column_stack([table[name] for name in names])
    path = directory / "gps.csv"
    np.savetxt(path, rows, fmt="%.8f", delimiter=",", header=",".join(names), comments="")
    fixes, problems = read_fixes(path)
    return fixes, {problem.code: problem.text for problem in problems}


def sound(directory: Path) -> GnssFixes:
    fixes, said = lap(directory)
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()
    return fixes


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        (np.radians, "in radians"),
        (lambda c: (c + 180.0) % 360.0, "it pointed backwards"),
        (lambda c: (-c) % 360.0, "anticlockwise from north"),
        (lambda c: (90.0 - c) % 360.0, "anticlockwise from east, or latitude and longitude exchanged"),
    ],
)
def test_a_course_that_is_written_otherwise_is_not_used_and_named(tmp_path: Path, change, hint: str) -> None:
    course = np.array(sound(tmp_path).course_deg)
    fixes, said = lap(tmp_path, course_deg=change(course))
    assert np.isnan(fixes.velocity_n[:, 0]).all()
    assert said["gps_course_wrong"].endswith(f", as if {hint}; not used")


def test_a_missing_course_is_reported(tmp_path: Path) -> None:
    _, said = lap(tmp_path, course_deg=None)
    assert said == {"gps_no_course": "gps.csv: 600 moving fixes with a speed but no course; the speed is used alone"}


def test_a_kart_that_stands_and_one_that_runs_straight_are_accepted(tmp_path: Path) -> None:
    t = np.arange(600) * 0.2
    still = np.zeros(600)
    noise = 0.3 * np.random.default_rng(1).standard_normal(600) / 111_195
    _, said = lap(tmp_path, speed_mps=still, course_deg=still, lat_deg=45 + noise, lon_deg=12 + noise)
    assert said == {}
    fixes, said = lap(
        tmp_path, speed_mps=still + 20.0, course_deg=still, lat_deg=45 + 20.0 * t / 111_195 + noise, lon_deg=12 + noise
    )
    assert said == {} and np.isfinite(fixes.velocity_n[:, 0]).all()


def circles(
    directory: Path, radius: float, speed: float, rate: float, delay: float
) -> tuple[GnssFixes, dict[str, str]]:
    """Two minutes of circles; the velocities come `delay` s behind their positions."""
    t = np.arange(0.0, 120.0, 1.0 / rate)
    turned = speed / radius * t
    lat, lon = 45 + radius * np.sin(turned) / 111_195, 12 - radius * np.cos(turned) / 111_195 / np.cos(np.pi / 4)
    course = np.degrees(turned - speed / radius * delay) % 360.0
    return lap(directory, t_s=t, lat_deg=lat, lon_deg=lon, speed_mps=np.full(t.size, speed), course_deg=course)


@pytest.mark.parametrize(
    ("radius", "speed", "rate", "delay"), [(5.0, 8.5, 5.0, 0.6), (8.0, 11.0, 10.0, 0.6), (5.0, 8.5, 1.0, 0.0)]
)
def test_a_course_that_comes_late_is_not_a_wrong_one(
    tmp_path: Path, radius: float, speed: float, rate: float, delay: float
) -> None:
    """A skid pad turns the kart by 60 degrees within the delay of a slow receiver, or from one fix to half way on."""
    fixes, said = circles(tmp_path, radius, speed, rate, delay)
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()


@pytest.mark.parametrize(("speed", "noise"), [(0.0, 5.0), (1.5, 1.0), (1.5, 5.0), (8.0, 2.0), (15.0, 5.0), (25.0, 5.0)])
@pytest.mark.parametrize("rate", [1.0, 5.0, 25.0])
def test_a_steady_velocity_is_accepted_where_the_positions_are_noisy(
    tmp_path: Path, speed: float, noise: float, rate: float
) -> None:
    t = np.arange(0.0, 300.0, 1.0 / rate)
    north, east = noise * np.random.default_rng(3).standard_normal((2, t.size))
    lat, lon = 45 + (speed * t + north) / 111_195, 12 + east / 111_195 / np.cos(np.pi / 4)
    sent = {"speed_mps": np.full(t.size, speed), "course_deg": np.zeros(t.size)}
    fixes, said = lap(tmp_path, t_s=t, lat_deg=lat, lon_deg=lon, **sent)
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()
    fixes, said = lap(
        tmp_path,
        t_s=t,
        lat_deg=lat,
        lon_deg=lon,
        vel_n_mps=sent["speed_mps"],
        vel_e_mps=0.0 * t,
        speed_mps=None,
        course_deg=None,
    )
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()
