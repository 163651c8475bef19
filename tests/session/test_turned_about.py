"""A box that is turned about the vertical as the kart drives: by gravity it lies as before."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.files import list_files
from smoother.session.recording import Recording, finish
from smoother.session.turned import without_turned_about
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

from .folders import Folder


def recording(seed: int, preset: str = "kart", **changes: float) -> tuple[RawImu, GnssFixes]:
    raw = simulate_preset(preset, seed, duration=180.0, **changes).raw
    assert raw.imu is not None
    return raw.imu, raw.gnss


def turned_about(imu: RawImu, angle: float, begin: float, end: float = np.inf) -> RawImu:
    """The samples (N, 3) of a box turned about what it feels most of the time, from `begin` to `end` s."""
    up: Array = np.mean(imu.accel, axis=0)
    R = so3.exp(angle * up / np.linalg.norm(up))
    inside = ((imu.t > begin) & (imu.t < end))[:, None]
    accel, gyro = (np.where(inside, values @ R.T, values) for values in (imu.accel, imu.gyro))
    return replace(imu, accel=accel, gyro=gyro)


@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
@pytest.mark.parametrize("angle", [90.0, -90.0, 180.0])
@pytest.mark.parametrize(("begin", "end"), [(70.0, 110.0), (120.0, np.inf)])
def test_samples_of_a_box_that_pointed_elsewhere_are_left_out(
    preset: str, angle: float, begin: float, end: float
) -> None:
    imu, gnss = recording(61, preset)
    problems: list[Problem] = []
    kept = without_turned_about(turned_about(imu, angle * DEG, begin, end), gnss, "imu.csv", problems)
    assert not np.any((kept.t > begin) & (kept.t < end))
    assert imu.t.size - kept.t.size < (min(end, imu.t[-1]) - begin + 45.0) * 200.0
    (problem,) = problems
    assert problem.code == "imu_turned" and "about the vertical" in problem.text
    assert abs(float(problem.text.partition("by about ")[2].split()[0]) - abs(angle)) < 12.0


@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
@pytest.mark.parametrize("steering", [0.0, 0.2])
def test_a_box_that_stays_or_swings_with_the_wheel_keeps_its_samples(preset: str, steering: float) -> None:
    for seed in (62, 63):
        imu, gnss = recording(seed, preset, motion_steering=steering)
        problems: list[Problem] = []
        assert without_turned_about(imu, gnss, "imu.csv", problems) is imu and not problems


def test_a_reader_leaves_them_out(folder: Folder) -> None:
    imu, gnss = recording(64)
    folder.write(session__toml="")
    files = list_files(folder.path)
    raw = finish(files, Recording(gnss, "gps.csv", (), (), turned_about(imu, 90.0 * DEG, 60.0, 100.0), "imu.csv"))
    assert "imu_turned" in {problem.code for problem in raw.problems}
    assert raw.imu is not None and not np.any((raw.imu.t > 60.0) & (raw.imu.t < 100.0))
