"""A car against its references: the smoothed path is no worse than the fixes, on data that others recorded."""

import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def twins() -> Iterator[ModuleType]:
    """The benchmark as a module; its own folder is on the path only as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("twins")


def test_beside_rtk_the_path_is_no_worse_than_its_fixes_and_better_across_the_track(
    twins: ModuleType, data_directory: Path
) -> None:
    fixes, smoothed, wanders, _ = twins.beside_rtk(data_directory)
    assert fixes.count == smoothed.count > 500
    assert smoothed.horizontal <= fixes.horizontal
    assert smoothed.across < fixes.across
    assert all(wander.usual < 2.0 for wander in wanders)  # RTK jumps at times: not the rms


def test_two_modules_in_one_car_agree_better_after_smoothing(twins: ModuleType, data_directory: Path) -> None:
    fixes, smoothed, wanders, motions = twins.between_twins(data_directory)
    assert fixes.count == smoothed.count > 5000
    assert smoothed.horizontal < fixes.horizontal
    assert all(wander.ratio < 2.0 for wander in wanders)
    velocities = [apart for apart in motions if apart.name.startswith("velocity")]
    assert len(velocities) == 2
    assert all(0.5 < apart.ratio < 1.3 and apart.rms < 0.04 for apart in velocities)
    assert all(apart.ratio < 1.3 for apart in motions if apart.name.endswith("deg"))
