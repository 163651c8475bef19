"""The largest losses, and what is said to have been different."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.fit.plan_path import PlanPath
from smoother.frames import Origin
from smoother.laps import analysis
from smoother.laps.analysis import _from_grid, analyse
from smoother.laps.document import analysis_document
from smoother.laps.lost import largest_losses, likely_losses
from smoother.laps.passages import Passage
from smoother.laps.results import Corner, LapAnalysis
from smoother.trajectory import Trajectory

from .conftest import fixes_of


@pytest.fixture(scope="module")
def found(driven: Trajectory) -> LapAnalysis:
    return analyse(driven, fixes_of(driven))


def with_loss(found: LapAnalysis, number: int, lost: float, *, is_real: bool = True, **changes: float) -> LapAnalysis:
    """The laps, of which the first that counts but is not compared with lost `lost` s in one corner and nothing else.

    changes: what it did otherwise than the lap compared with, by the field of the corner.
    """
    reference, lap = found.reference_lap, slow_lap(found)
    assert reference is not None

    def changed(corner: Corner) -> Corner:
        nothing = np.zeros(len(found.laps))
        corner = replace(corner, time_lost=nothing, time_lost_sigma=nothing + 0.02, is_real=nothing > 0.0)
        if corner.number != number:
            return corner
        fields = {"time_lost": lost * np.eye(len(found.laps))[lap]}
        fields["is_real"] = (fields["time_lost"] != 0.0) & is_real
        fields |= {f"{name}_speed_sigma": nothing + 0.1 for name in ("entry", "min", "exit")}
        fields["braking_sigma"] = nothing + 2.0
        for name in ("braking_point", "entry_speed", "min_speed", "exit_speed"):
            values = np.full(len(found.laps), 20.0)
            values[lap] += changes.get(name, 0.0)
            fields[name] = values
        return replace(corner, **fields)

    return replace(found, corners=tuple(changed(corner) for corner in found.corners))


def slow_lap(found: LapAnalysis) -> int:
    return next(i for i, lap in enumerate(found.laps) if lap.is_valid and i != found.reference_lap)


def test_only_real_losses_are_listed(found: LapAnalysis) -> None:
    assert largest_losses(with_loss(found, 3, 0.3, is_real=False)) == ()
    assert largest_losses(with_loss(found, 3, -0.3)) == ()
    (loss,) = largest_losses(with_loss(found, 3, 0.3))
    assert (loss.corner.number, loss.lap, loss.lost, loss.sigma) == (3, slow_lap(found), 0.3, 0.02)
    assert loss.differences == ()


def test_laps_that_do_not_count_tell_nothing(found: LapAnalysis) -> None:
    lost = with_loss(found, 3, 0.3)
    laps = tuple(replace(lap, reasons=("pit",)) for lap in lost.laps)
    assert largest_losses(replace(lost, laps=laps)) == ()


def test_clear_differences_are_listed_and_nothing_else(found: LapAnalysis) -> None:
    lost = with_loss(found, 4, 0.2, braking_point=-9.0, entry_speed=0.8, min_speed=-1.5, exit_speed=-0.2)
    (loss,) = largest_losses(lost)
    # the entry was faster, the exit slower within its sigma, 0.14
    assert [(each.kind, pytest.approx(each.by)) for each in loss.differences] == [("braking", 9.0), ("minimum", 1.5)]
    assert loss.differences[0].sigma == pytest.approx(2.0 * np.sqrt(2.0))


def test_against_a_lap_of_another_session_only_the_time_is_listed(found: LapAnalysis) -> None:
    lost = replace(with_loss(found, 4, 0.2, min_speed=-5.0), reference_lap=None)
    assert [loss.differences for loss in largest_losses(lost)] == [()]


def test_the_largest_come_first(found: LapAnalysis) -> None:
    lap = slow_lap(found)
    corners = []
    for corner in with_loss(found, 0, 0.0).corners:
        only = np.arange(len(found.laps)) == lap
        corners.append(replace(corner, time_lost=np.where(only, 0.1 * corner.number, 0.0), is_real=only))
    numbers = [loss.corner.number for loss in largest_losses(replace(found, corners=tuple(corners)))]
    assert numbers == [len(corners) - k for k in range(5)]


def test_summary_json_has_them(found: LapAnalysis) -> None:
    lost = with_loss(found, 4, 0.2, braking_point=-9.0, min_speed=-1.5)
    (row,) = analysis_document(lost, Origin(45.0, 12.0, 100.0))["largest_losses"]
    assert row["corner"] == 4 and row["lap"] == lost.laps[slow_lap(lost)].number
    assert (row["lost_s"], row["lost_sigma_s"]) == (0.2, 0.02)
    assert (row["braking_earlier_m"], row["minimum_slower_mps"]) == (9.0, 1.5)
    assert row["minimum_slower_sigma_mps"] == pytest.approx(0.141)
    assert not [name for name in row if name.startswith(("entry", "exit"))]


def test_where_nothing_is_sure_the_likeliest_are_ranked(found: LapAnalysis) -> None:
    lap, rows = slow_lap(found), []
    for corner in found.corners:
        only = np.arange(len(found.laps)) == lap
        sigma = np.where(only, 0.05, 0.2)
        lost = np.where(only, 0.03 * corner.number, 0.1)  # the others are within their sigma
        rows.append(replace(corner, time_lost=lost, time_lost_sigma=sigma, is_real=np.zeros_like(only)))
    unsure = replace(found, corners=tuple(rows))
    assert largest_losses(unsure) == ()
    numbers = [loss.corner.number for loss in likely_losses(unsure)]
    assert numbers == [len(rows), len(rows) - 1, len(rows) - 2]
    assert [row["corner"] for row in analysis_document(unsure, Origin(45.0, 12.0, 100.0))["likely_losses"]] == numbers
    assert likely_losses(with_loss(found, 3, 0.3)) == ()


def test_a_lap_from_a_standing_start_is_not_compared(found: LapAnalysis) -> None:
    lost = with_loss(found, 3, 0.3)
    grid = tuple(replace(lap, is_from_grid=i == slow_lap(found)) for i, lap in enumerate(lost.laps))
    assert largest_losses(replace(lost, laps=grid)) == ()


def test_a_lap_is_from_the_grid_where_it_begins_far_slower_than_others() -> None:
    t, speed = np.arange(0.0, 100.0, 1.0), np.full(100, 20.0)
    speed[:12] = np.linspace(0.0, 20.0, 12)
    velocity_n = np.stack([speed, np.zeros(100)], axis=1)
    path = PlanPath(t, np.cumsum(velocity_n, axis=0), velocity_n, np.zeros(100))
    ends = [(3.0, 30.0, True), (30.0, 60.0, True), (60.0, 90.0, True), (0.0, 3.0, False)]
    passages = tuple(Passage(i, start, end, at_line, True, 0.0) for i, (start, end, at_line) in enumerate(ends))
    assert _from_grid(path, passages).tolist() == [True, False, False, False]


def test_consistency_is_that_of_flying_laps(
    driven: Trajectory, found: LapAnalysis, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = next(i for i, lap in enumerate(found.laps) if lap.is_valid)
    grid = np.arange(len(found.laps)) == first
    monkeypatch.setattr(analysis, "_from_grid", lambda *_: grid)
    other = analyse(driven, fixes_of(driven))
    times = [lap.time for i, lap in enumerate(found.laps) if lap.is_valid and i != first]
    assert other.statistics.spread == pytest.approx(np.std(times, ddof=1))
    assert other.statistics.spread != pytest.approx(found.statistics.spread)
    assert other.statistics.counted == found.statistics.counted
