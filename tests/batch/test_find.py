"""Which sessions lie under a folder."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from smoother.batch.find import find_sessions
from smoother.batch.task import Task
from smoother.errors import UsageError
from smoother.session.log_encode import encode
from smoother.sim.record_log import DRIVE_FILE, calibration_records, write_klg
from smoother.sim.simulation import simulate_preset

FIXES = "t_s,lat_deg,lon_deg\n0,45,12\n"


def make(root: Path, *names: str, text: str = FIXES) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


def names(tasks: tuple[Task, ...]) -> list[str]:
    return [task.name for task in tasks]


def test_a_day_of_karts_is_found_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    for kart in (1, 2, 10):
        make(tmp_path / "day", *(f"kart{kart}/run{i}/gps.csv" for i in (1, 9, 10)))
    found = find_sessions([tmp_path / "day"])
    assert names(found.tasks)[:4] == ["day/kart1/run1", "day/kart1/run9", "day/kart1/run10", "day/kart2/run1"]
    assert [task.kart for task in found.tasks] == ["kart1"] * 3 + ["kart2"] * 3 + ["kart10"] * 3
    assert all(task.out == task.session / "smoothed" for task in found.tasks)
    assert found.problems == ()


def test_results_hidden_folders_links_and_bench_recordings_are_none(tmp_path: Path) -> None:
    make(tmp_path, "run/gps.csv", "run/smoothed/gps.csv", ".trash/gps.csv", "notes/readme.txt")
    make(tmp_path, "elsewhere/gps.csv", "elsewhere/trajectory.csv", "elsewhere/summary.json")
    make(tmp_path, "bench/imu.csv", "bench/calibration.toml")
    (tmp_path / "link").symlink_to(tmp_path / "run")
    assert [task.session.name for task in find_sessions([tmp_path]).tasks] == ["run"]


def test_folders_beside_sessions_that_hold_none_are_reported(tmp_path: Path) -> None:
    make(tmp_path / "day", "kart1/run1/gps.csv", "photos.png", "kart9/bench/imu.csv", "kart9/bench/calibration.toml")
    make(tmp_path / "day", *(f"kart{kart}/run1/photo.png" for kart in (2, 3, 4, 5)), "notes/readme.txt")
    found = find_sessions([tmp_path / "day"])
    assert names(found.tasks) == ["day/kart1/run1"]
    assert found.problems == (f"{tmp_path / 'day'}: no recording in kart2/run1, kart3/run1, kart4/run1 and 1 more",)


def test_what_cannot_be_read_is_a_session_too_and_reported(tmp_path: Path) -> None:
    make(tmp_path, "torn/LOG00001.KLG", "blind/imu.csv", text="not a log")
    assert [task.session.name for task in find_sessions([tmp_path]).tasks] == ["blind", "torn"]


def test_results_may_go_under_another_folder_which_is_not_searched(tmp_path: Path) -> None:
    make(tmp_path, "day/kart1/run1/gps.csv", "day/out/old/gps.csv", "other/day/run/gps.csv")
    out = tmp_path / "day" / "out"
    found = find_sessions([tmp_path / "day", tmp_path / "other" / "day"], out)
    assert [task.out.relative_to(out).as_posix() for task in found.tasks] == ["day/kart1/run1", "day-2/run"]


def test_folders_named_twice_or_within_another_give_each_session_once(tmp_path: Path) -> None:
    make(tmp_path, "day/run1/gps.csv", "day/run2/gps.csv")
    found = find_sessions(
        [tmp_path / "day", tmp_path / "day", tmp_path / "day" / "run1", tmp_path / "day" / "run1/gps.csv"]
    )
    assert {task.session.relative_to(tmp_path).as_posix() for task in found.tasks[:2]} == {"day/run1", "day/run2"}
    assert len({task.out for task in found.tasks}) == len(found.tasks)


def test_files_of_another_program_are_a_session_each_the_best_kind_of_one_name(tmp_path: Path) -> None:
    make(tmp_path, "day/a.vbo", "day/b.vbo", "day/b.gpx", "day/session.toml", text="")
    tasks = find_sessions([tmp_path / "day"]).tasks
    assert [task.session.name for task in tasks] == ["a.vbo", "b.vbo"]
    assert [task.out.relative_to(tmp_path).as_posix() for task in tasks] == ["day/smoothed/a", "day/smoothed/b"]
    assert [path.name for path in tasks[0].inputs] == ["a.vbo", "session.toml"]
    alone = find_sessions([tmp_path / "day" / "b.vbo"]).tasks
    assert [(task.session, task.out.name) for task in alone] == [(tasks[1].session, "b")]


def test_folders_that_are_called_karts_name_them_wherever_they_stand(tmp_path: Path) -> None:
    own = "kart1/gps.csv", "Kart 02/gps.csv", "7/a.vbo"
    make(tmp_path / "day", *own, "kart-3b/run1/gps.csv", "karting/anna/gps.csv")
    found = find_sessions([tmp_path / "day"])
    assert {(task.session.name, task.kart) for task in found.tasks} == {
        ("kart1", "kart1"),
        ("Kart 02", "Kart 02"),
        ("run1", "kart-3b"),
        ("anna", "karting"),
        ("7", ""),
    }


def test_a_card_of_the_logger_holds_a_session_for_each_recording(tmp_path: Path) -> None:
    card = tmp_path / "kart7"
    for number, seed in enumerate((1, 2), 1):
        write_klg(simulate_preset("white", seed, duration=10.0), tmp_path / "drive")
        card.mkdir(exist_ok=True)
        (tmp_path / "drive" / DRIVE_FILE).rename(card / f"LOG0000{number}.KLG")
    shutil.rmtree(tmp_path / "drive")
    tasks = find_sessions([tmp_path]).tasks
    assert [task.session.name for task in tasks] == ["LOG00001.KLG", "LOG00002.KLG"]
    assert [task.out.relative_to(card).as_posix() for task in tasks] == ["smoothed/LOG00001", "smoothed/LOG00002"]
    assert [task.kart for task in tasks] == ["kart7", "kart7"]
    assert [path.name for path in tasks[0].inputs] == ["LOG00001.KLG"]
    (card / "LOG00000.KLG").write_bytes(encode(calibration_records(np.eye(3)[[0, 1, 2] * 40]), 7))
    tasks = find_sessions([tmp_path]).tasks
    assert [[path.name for path in task.inputs] for task in tasks] == [
        ["LOG00001.KLG", "LOG00000.KLG"],
        ["LOG00002.KLG", "LOG00000.KLG"],
    ]
    (card / "LOG00002.KLG").unlink()
    assert [task.session.name for task in find_sessions([tmp_path]).tasks] == ["kart7"]


def test_the_files_that_decide_the_results_are_known(tmp_path: Path) -> None:
    make(tmp_path, "kart1/run/gps.csv", "kart1/run/imu.csv", "kart1/run/official.csv", "kart1/run/lines/a.json")
    make(tmp_path, "kart1/calibration.toml", "kart1/run/truth.csv", "kart1/run/video.mp4")
    settings = tmp_path / "kart1" / "run" / "session.toml"
    for track, is_used in (("lines/a.json", True), ("../calibration.toml", False), ("nowhere.json", False)):
        settings.write_text(f'[session]\ntrack = "{track}"\n')
        (task,) = find_sessions([tmp_path / "kart1" / "run"]).tasks
        used = {path.name for path in task.inputs}
        assert {"gps.csv", "imu.csv", "official.csv", "session.toml"} <= used
        assert ("a.json" in used) == is_used
        assert "video.mp4" not in used
    (tmp_path / "kart1" / "run" / "truth.csv").unlink()  # of a session with truth, only a calibration of its own
    (task,) = find_sessions([tmp_path / "kart1" / "run"]).tasks
    assert "calibration.toml" in {path.name for path in task.inputs}


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such file or folder"):
        find_sessions([tmp_path / "nowhere"])


def test_a_folder_that_cannot_be_searched_is_reported_and_the_others_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path, "a/gps.csv", "b/gps.csv")
    real = os.scandir

    def scandir(path: str) -> object:
        if str(path).endswith("/a"):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path)

    monkeypatch.setattr(os, "scandir", scandir)
    found = find_sessions([tmp_path])
    assert [task.session.name for task in found.tasks] == ["b"]
    assert len(found.problems) == 1
    assert "Permission denied" in found.problems[0]
