"""What is recorded from the line is a session like one from the card."""

import contextlib
import itertools
import json
import os
import subprocess
import sys
import threading
import time
from io import FileIO
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from smoother.cli import living
from smoother.cli.living import live
from smoother.cli.main import run as run_command
from smoother.live import recording
from smoother.live.decoding import Decoder
from smoother.live.receiver import Chunk
from smoother.live.recording import Recorder, SessionWriter
from smoother.session.log import list_recordings, read_records
from smoother.session.log_frames import decode_frames, find_frames
from smoother.sim.record_log import drive_records


def record(stream: bytes, directory: Path, piece: int = 700) -> SessionWriter:
    decoder, writer = Decoder(), SessionWriter(directory, np.random.default_rng(7))
    for at in range(0, len(stream), piece):
        for batch in decoder.feed([Chunk(0.0, stream[at : at + piece])]):
            writer.add(batch.records, batch.restarted)
    writer.close()
    return writer


def test_a_recorded_stream_holds_every_record_that_was_sent(drive, tmp_path: Path) -> None:
    record(drive.stream, tmp_path)
    (files,) = list_recordings(tmp_path.glob("*.KLG"))
    records, losses = read_records(files)
    sent = drive_records(drive.simulation)
    np.testing.assert_array_equal(records.imu_t, sent.imu_t)
    np.testing.assert_array_equal(records.imu, sent.imu)
    np.testing.assert_array_equal(records.mag, sent.mag)
    assert records.sentences == sent.sentences
    assert records.setup == sent.setup
    assert records.stop == sent.stop
    assert (losses.blocks, losses.samples, losses.unreadable) == (0, 0, 0)


def test_a_restarted_logger_begins_another_file(drive, tmp_path: Path) -> None:
    record(drive.stream[100_000:150_000] + drive.stream[:50_000], tmp_path)
    found = list_recordings(tmp_path.glob("*.KLG"))
    assert [files.name for files in found] == ["LIVE0001", "LIVE0002"]
    assert found[0].session != found[1].session


def test_nothing_recorded_before_is_overwritten(drive, tmp_path: Path) -> None:
    first = record(drive.stream[:20_000], tmp_path).path
    second = record(drive.stream[:20_000], tmp_path).path
    assert first != second
    assert first is not None and first.stat().st_size > 0


def test_the_file_holds_at_every_moment_what_has_come(drive, tmp_path: Path) -> None:
    decoder, writer = Decoder(), SessionWriter(tmp_path, np.random.default_rng(7))
    sent, came = drive_records(drive.simulation), 0
    for at in range(0, 40_000, 700):
        for batch in decoder.feed([Chunk(0.0, drive.stream[at : at + 700])]):
            writer.add(batch.records, batch.restarted)
            came += len(batch.records.imu_t)
        if at % 4900 == 0:  # as if the program were killed here
            records, losses = read_records(list_recordings(tmp_path.glob("*.KLG"))[0])
            np.testing.assert_array_equal(records.imu_t, sent.imu_t[:came])
            assert (losses.blocks, losses.samples) == (0, 0)
    assert came > 1000
    writer.close()


def test_a_full_disc_is_reported_and_later_records_are_written_when_there_is_room(
    drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = recording._write_all
    decoder, recorder = Decoder(), Recorder(SessionWriter(tmp_path, np.random.default_rng(7)))

    def feed(start: int, end: int) -> None:
        for at in range(start, end, 700):
            recorder.add(decoder.feed([Chunk(0.0, drive.stream[at : at + 700])]))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with recorder:
        feed(0, 7000)
        recorder.settle()
        monkeypatch.setattr(recording, "_write_all", full)
        feed(7000, 21_000)
        recorder.settle()
        assert recorder.status.flaw == "No space left on device"
        monkeypatch.setattr(recording, "_write_all", written)
        feed(21_000, 28_000)
        recorder.settle()
        assert recorder.status.flaw == ""
    records, losses = read_records(list_recordings(tmp_path.glob("*.KLG"))[0])
    np.testing.assert_array_equal(records.imu_t, drive_records(drive.simulation).imu_t[: len(records.imu_t)])
    assert (losses.blocks, losses.samples) == (0, 0)
    assert len(records.imu_t) > 900  # of 28,000 bytes


@pytest.mark.parametrize(("written", "kept"), [(0, "nothing is kept"), (1, "LIVE0001.KLG holds the first ")])
def test_the_command_does_not_call_recorded_what_the_disc_did_not_take(
    drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], written: int, kept: str
) -> None:
    write, calls = recording._write_all, itertools.count()

    def until_full(file: FileIO, data: bytes, at: int) -> None:
        if next(calls) >= written:
            raise OSError(28, "No space left on device")
        write(file, data, at)

    monkeypatch.setattr(recording, "_write_all", until_full)
    capture = tmp_path / "capture.bin"
    capture.write_bytes(drive.stream[:60_000])
    asked = ["live", str(capture), "--speed", "max", "--headless", "--record", str(tmp_path / "new")]
    assert run_command(asked) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("smooth: recording failed: No space left on device; ") and kept in said


def test_a_program_that_is_killed_leaves_what_it_received(drive, tmp_path: Path) -> None:
    reading, writing = os.pipe()
    smooth = Path(sys.executable).parent / "smooth"
    command = [str(smooth), "live", "-", "--record", str(tmp_path / "new"), "--json"]
    with subprocess.Popen(command, stdin=reading, stdout=subprocess.PIPE, text=True) as program:
        os.close(reading)
        os.write(writing, drive.stream[:30_000])
        assert program.stdout is not None
        newest = 0.0
        while newest < 5.0:  # s of the stream; a line comes each second
            newest = json.loads(program.stdout.readline())["t_s"]
        time.sleep(0.5)
        program.kill()
    os.close(writing)
    records, losses = read_records(list_recordings((tmp_path / "new").glob("*.KLG"))[0])
    whole, _ = find_frames(drive.stream[:30_000])
    assert records.imu_t[-1] * 1e-6 > newest - 0.1  # what it told of is there, and what it read while it was killed
    assert len(records.imu_t) == len(decode_frames(whole).imu_t)
    assert losses.blocks == 0


def test_the_command_writes_json_lines_and_a_session_that_can_be_checked(
    drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capture = tmp_path / "capture.bin"
    capture.write_bytes(b"boot\n" + drive.stream[:150_000] + b"\x00" * 33)
    arguments = ["live", str(capture), "--speed", "20", "--json", "--record", str(tmp_path / "new")]
    assert run_command(arguments) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(lines) >= 2
    assert lines[-1]["t_s"] > 30.0
    assert lines[-1]["losses"]["lost_frames"] == 0
    assert lines[-1]["losses"]["noise_bytes"] > 0
    assert lines[-1]["madgwick"]["roll_deg"] is not None
    assert run_command(["check", str(tmp_path / "new"), "--json"]) in (0, 3)
    found = json.loads(capsys.readouterr().out)
    assert "error" not in found


def test_without_a_view_a_missing_port_is_reported_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["live", "/dev/ttyNoSuchPort", "--headless", "--seconds", "2.5"]) == 0
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("smooth: waiting for /dev/ttyNoSuchPort: no such port; ") and "`ls /dev/tty*`" in line


def test_after_the_end_of_a_file_no_line_is_printed_twice(
    drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capture = tmp_path / "capture.bin"
    capture.write_bytes(drive.stream[:250_000])
    assert run_command(["live", str(capture), "--speed", "max", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    over = [{**line, "delay_s": 0, "smoother": {**(line["smoother"] or {}), "delay_s": 0}} for line in lines]
    over = [line for line in over if not line["connected"] and line["t_s"] > 0.0]
    assert all(one != other for one, other in itertools.pairwise(over))
    assert lines[-1]["stage"] == "smoothing" and lines[-1]["losses"]["left_out_s"] == 0.0


def test_without_a_view_a_terminal_shows_the_progress_of_a_file(
    drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = []
    monkeypatch.setattr(
        living,
        "progress_on_terminal",
        lambda wanted: contextlib.nullcontext(lambda *said: told.append((wanted, *said))),
    )
    capture = tmp_path / "capture.bin"
    capture.write_bytes(drive.stream[:60_000])
    assert run_command(["live", str(capture), "--speed", "max", "--headless"]) == 0
    wanted, text, share = told[-1]
    assert wanted and text.startswith("capture.bin ") and share == 0.99


def test_a_disc_that_hangs_does_not_keep_the_program_from_ending(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "MOST_WAITING", 2)
    monkeypatch.setattr(recording, "ENDS_WITHIN", 0.2)
    hangs, has_room = threading.Event(), threading.Event()

    class Hanging(SessionWriter):
        def sync(self) -> None:
            hangs.set()
            has_room.wait(10.0)

    monkeypatch.setattr(recording, "SYNC_EVERY", -1.0)
    recorder, began = Recorder(Hanging(tmp_path, np.random.default_rng(7))), time.monotonic()
    with recorder:
        recorder.add([])
        assert hangs.wait(5.0)
        for _ in range(3):
            recorder.add([])
    assert "nothing for minutes" in recorder.status.flaw
    assert time.monotonic() - began < 5.0
    has_room.set()


def test_speeds_that_are_none_are_refused() -> None:
    for speed in ("0", "-1", "fast"):
        result = CliRunner().invoke(live, ["/dev/null", "--speed", speed])
        assert result.exit_code != 0


@pytest.mark.parametrize(
    ("count", "said"), [(0, "nothing was received, so nothing was recorded"), (65_536, "66 kB received")]
)
def test_bytes_of_another_format_are_not_called_nothing(tmp_path: Path, count: int, said: str) -> None:
    """A card's file, piped in: blocks, not frames of the line."""
    smooth = Path(sys.executable).parent / "smooth"
    blocks = (Path(__file__).parents[1] / "data" / "golden.klg").read_bytes()
    command = [str(smooth), "live", "-", "--record", str(tmp_path / "new"), "--headless"]
    data = (blocks * (1 + count // len(blocks)))[:count]
    done = subprocess.run(command, input=data, capture_output=True, timeout=120, check=False)
    text = done.stderr.decode()
    assert done.returncode == 0 and said in text and "nothing was recorded" in text
    assert ("in the format of the logger's line" in text) == (count > 0)
    assert ("CONFIG.TXT has stream=200" in text) == (count > 0)  # as it comes, the logger sends messages only
