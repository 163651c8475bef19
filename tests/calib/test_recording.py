"""What a recording to calibrate from is read from: tables, the thesis' files, the logger's card; GPS or not."""

from pathlib import Path

import numpy as np
import pytest

from calib.recording import load_recording, load_recordings
from smoother.cli.main import run as smooth
from smoother.fit.resting import distinct_directions
from smoother.sim.record import write_csv, write_thesis
from smoother.sim.simulation import simulate_preset


def test_a_bench_needs_neither_fixes_nor_every_sensor(tmp_path: Path) -> None:
    rows = "\n".join(f"{i / 50:.3f},{np.cos(i):.5f},{np.sin(i):.5f},3.0" for i in range(100))
    (tmp_path / "mag.csv").write_text("t_s,mx,my,mz\n" + rows + "\n")
    recording = load_recording(tmp_path)
    assert recording.imu is None and recording.fixes is None
    assert recording.mag is not None and len(recording.mag.t) == 100
    assert not recording.is_driven
    assert recording.origin is None and recording.date is None


def test_temperatures_of_a_table_are_read_beside_the_samples(handled) -> None:
    recording = load_recording(handled.directory)
    np.testing.assert_allclose(recording.imu.temperature, handled.bench.imu.temperature, atol=0.02)
    assert len(recording.positions) == 16
    i, j = recording.longest_rest
    assert recording.imu.t[j - 1] - recording.imu.t[i] == pytest.approx(89.0, abs=1.0)
    assert not np.any(recording.is_at_rest & handled.bench.is_moved)


def test_the_thesis_files_are_a_recording(tmp_path: Path) -> None:
    write_thesis(simulate_preset("white", 1, duration=60.0), tmp_path)
    recording = load_recording(tmp_path)
    assert recording.is_thesis and recording.is_driven
    assert recording.mag_field is not None and len(recording.mag_field) == 500
    assert recording.origin is not None and recording.date is not None


def test_rests_of_a_drive_are_judged_with_the_fixes(tmp_path: Path) -> None:
    simulation = simulate_preset("kart", 1, duration=60.0)
    write_csv(simulation, tmp_path)
    recording = load_recording(tmp_path)
    assert recording.is_driven
    speed = np.linalg.norm(simulation.truth.at(recording.imu.t).velocity_n, axis=1)
    assert np.max(speed[recording.is_at_rest], initial=0.0) < 0.5


def test_all_recordings_on_a_card_are_read(tmp_path: Path) -> None:
    assert smooth(["simulate", str(tmp_path), "--preset", "kart", "--duration", "30", "--format", "klg"]) == 0
    (tmp_path / "session.toml").write_text('[session]\ndate = "2026-05-16"\n')
    (one,) = load_recordings(tmp_path)
    assert one.imu is not None and one.mag is not None and one.fixes is not None
    assert one.is_driven and one.config.date == "2026-05-16"
    np.testing.assert_allclose(one.mag_stamps, one.mag.t, atol=0.01)  # those that were evened


def test_a_sensor_that_never_changed_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t, noise = np.arange(0.0, 30.0, 0.01), 0.02 * rng.standard_normal((3, 3000))
    rows = np.column_stack([t, noise[0], noise[1], 9.8 + noise[2], np.zeros((3000, 2)), 1e-3 * noise[0]])
    np.savetxt(tmp_path / "imu.csv", rows, "%.5f", ",", header="t_s,ax,ay,az,gx,gy,gz", comments="")
    (said,) = load_recording(tmp_path).problems
    assert "x of the gyroscope, y of the gyroscope never changed" in said.text and said.count == 2


def test_without_any_force_there_is_no_direction() -> None:
    assert len(distinct_directions(np.zeros((4, 3)))) == 0
    assert len(distinct_directions(np.array([[0.0, 0.0, 9.8], [0.0, 0.0, 0.0], [9.8, 0.0, 0.0]]))) == 2
