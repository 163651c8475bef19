"""The blocks of docs/python.md run as they stand, from top to bottom, and what it says of their values holds."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "python.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.fixture(name="ran", scope="module")
def ran_fixture(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The names that the blocks leave behind, run one after the other in an empty folder."""
    names: dict[str, Any] = {"__name__": "docs_python"}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("project"))
        for i, block in enumerate(BLOCKS):
            exec(compile(block, f"{PAGE.name}, block {i + 1}", "exec"), names)
        names["out"] = names["out"].resolve()
    return names


def test_there_are_blocks_of_everything_it_speaks_of() -> None:
    assert len(BLOCKS) == 12
    for name in ("api.read", "api.smooth", "joint.covariance", "api.laps", "api.evaluate", "api.write_results"):
        assert any(name in block for block in BLOCKS)


def test_the_smoother_used_the_motion_sensor(ran: dict[str, Any]) -> None:
    assert ran["trajectory"].report.mode == "full"
    assert ran["with_arm"].report.identified["lever_arm_b"].source == "configured"
    assert {field.name for field in ran["found"].__dataclass_fields__.values()} == {
        "value",
        "sigma",
        "unit",
        "observable",
        "source",
    }


def test_positions_share_what_the_page_states(ran: dict[str, Any]) -> None:
    trajectory, times = ran["trajectory"], ran["times"]
    C = trajectory.joint.covariance(times, ran["north"])
    rows = np.searchsorted(trajectory.t, times)
    # but for the doubt about a sample's time, which rows alone have
    np.testing.assert_allclose(np.sqrt(np.diag(C)), trajectory.sigmas.position_n[rows, 0], rtol=0.01)
    over_a_second, over_half_a_minute = (np.sqrt(C[0, 0] + C[i, i] - 2.0 * C[0, i]) for i in (1, 2))
    assert 0.01 < over_a_second < 0.1 < over_half_a_minute < np.sqrt(C[0, 0])


def test_rows_have_the_sigmas_of_the_keyframes_and_the_doubt_about_a_sample_s_time(ran: dict[str, Any]) -> None:
    trajectory, keyframes = ran["trajectory"], ran["trajectory"].report.keyframes
    inside = (keyframes.t > trajectory.t[0]) & (keyframes.t < trajectory.t[-1])
    own = np.diagonal(keyframes.covariance[inside], axis1=1, axis2=2)
    step = np.median(np.diff(ran["session"].imu.t))
    position = np.sqrt(own[:, 6:9] + step**2 / 12.0 * keyframes.velocity_n[inside] ** 2)
    for i in range(3):
        at = np.interp(keyframes.t[inside], trajectory.t, trajectory.sigmas.position_n[:, i])
        np.testing.assert_allclose(at, position[:, i], rtol=0.01)


def test_errors_against_the_truth_are_as_large_as_documented(ran: dict[str, Any]) -> None:
    assert 0.5 < np.sqrt(np.mean(ran["z"] ** 2)) < 1.5
    assert ran["score"].nees.dimension == 9
    assert abs(ran["change"]) < 3.0 * np.sqrt(ran["C"][0, 0] + ran["C"][1, 1] - 2.0 * ran["C"][0, 1])


def test_laps_and_files_are_there(ran: dict[str, Any]) -> None:
    assert ran["laps"].sigma_source == "joint"
    assert sum(lap.is_valid for lap in ran["laps"].laps) == 2
    written = sorted(path.name for path in ran["out"].iterdir())
    assert written == ["gps.csv", "laps.csv", "report.html", "summary.json", "trajectory.csv"]
    table = pl.read_csv(ran["out"] / "trajectory.csv")
    assert len(table) == len(ran["trajectory"])
    assert table["lap"].max() == ran["laps"].laps[-1].number
