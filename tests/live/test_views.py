"""What the views show, without looking at pixels: words, bars, the faces of the box."""

import io
import os
import shutil
import subprocess

import numpy as np
import pytest
from rich.console import Console

from smoother.errors import UsageError
from smoother.live import view_text
from smoother.live.decoding import Losses
from smoother.live.engine import Snapshot
from smoother.live.frame import Frame
from smoother.live.lag import LagState
from smoother.live.receiver import LinkStatus
from smoother.live.sensing import Reception
from smoother.live.terminal import BAR, bar, panel

LAG = LagState(1.0, np.eye(3), np.zeros(3), np.array([20.0, 0.0, 0.0]), *([np.full(3, 0.01)] * 3), np.zeros(3), 0.3)
FULL = Snapshot(
    t=12.0,
    madgwick=np.eye(3),
    lag=LAG,
    R_bs=np.eye(3),
    force=np.array([1.0, -2.0, 9.8]),
    rates={"imu": 200.0, "mag": 10.0, "gps": 5.0},
    reception=Reception(1, 9, 0.9, 12.0),
    speed=20.0,
    fix_age=0.1,
    losses=Losses(frames=100, lost_frames=7, damaged=1, noise_bytes=40),
    stage="smoothing",
)


def test_all_losses_are_listed_and_nothing_else() -> None:
    link = LinkStatus(disconnects=2, dropped_bytes=512)
    said = view_text.losses(Frame(FULL, link))
    for text in ("7 frames lost (6.5%)", "1 damaged", "40 bytes of noise", "512 bytes", "2 x unplugged"):
        assert text in said
    assert "restarted" not in said
    assert view_text.losses(Frame()) == "nothing lost"


def test_a_file_that_waits_for_the_smoother_is_not_called_silent() -> None:
    frame = Frame(FULL, LinkStatus(is_open=True), 7.0, is_held=True)
    assert view_text.delay(frame) == "the file waits for the smoother"
    assert not view_text.is_stale(frame) and view_text.rates(frame).startswith("IMU 200 Hz")
    assert view_text.delay(Frame(FULL, LinkStatus(is_open=True), 7.0)) == "no data for 7 s"


@pytest.mark.parametrize(
    ("error", "hint"), [("no such port", "ls /dev/tty*"), ("permission denied", "dialout"), ("", ""), ("broken", "")]
)
def test_a_port_that_cannot_be_opened_is_reported_with_a_remedy(error: str, hint: str) -> None:
    said = view_text.connection(LinkStatus(error=error), "/dev/ttyUSB0")
    assert said.startswith("/dev/ttyUSB0: NOT CONNECTED") and error in said and hint in said
    pulled = view_text.connection(LinkStatus(error=error, disconnects=1), "/dev/ttyUSB0")
    assert not hint or hint not in pulled


def test_a_fix_that_grows_old_is_no_fix() -> None:
    assert view_text.is_gps_good(FULL)
    old = Snapshot(reception=Reception(1, 9), fix_age=4.0)
    assert not view_text.is_gps_good(old)
    assert view_text.gps(old) == "NO FIX for 4 s, 9 satellites"


@pytest.mark.parametrize("s", [Snapshot(), FULL], ids=["nothing yet", "everything"])
def test_the_terminal_shows_any_snapshot(s: Snapshot) -> None:
    console = Console(file=io.StringIO(), width=100, force_terminal=False)
    console.print(panel(Frame(s, LinkStatus(is_open=True), 0.02), "ttyUSB0"))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "20 ms" in text
    assert ("72.0 km/h" in text) == (s is FULL)


def test_bars_reach_from_the_middle_and_stop_at_the_end() -> None:
    assert bar(0.0, 1.0).count("█") == 0
    assert bar(99.0, 1.0) == "·" * (BAR // 2) + "█" * (BAR // 2 + 1)
    assert bar(-99.0, 1.0) == bar(99.0, 1.0)[::-1]
    assert len(bar(0.3, 1.0)) == BAR


def test_a_window_without_a_display_is_one_line_of_error(monkeypatch: pytest.MonkeyPatch) -> None:
    window = pytest.importorskip("smoother.live.window", reason="Python without tkinter")
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(UsageError, match="terminal"):
        window.WindowView("ttyUSB0")


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="no virtual display")
def test_the_window_takes_any_snapshot(monkeypatch: pytest.MonkeyPatch) -> None:
    window = pytest.importorskip("smoother.live.window", reason="Python without tkinter")
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1280x800x24"]
    with subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL) as server:
        os.close(writing)
        with os.fdopen(reading) as pipe:
            monkeypatch.setenv("DISPLAY", f":{pipe.readline().strip()}")
        try:
            view = window.WindowView("ttyUSB0")
            for s in (Snapshot(), FULL, Snapshot(madgwick=np.eye(3)), FULL):
                assert view.draw(Frame(s, LinkStatus(is_open=True), 0.02))
            with view:
                pass
        finally:
            server.terminate()


def test_the_logger_level_and_heading_north_shows_its_back_its_top_and_one_side() -> None:
    window = pytest.importorskip("smoother.live.window", reason="Python without tkinter")
    faces, which = window.box_faces(np.eye(3))
    assert faces.shape == (3, 4, 2)
    assert {1, 4} < set(which.tolist())  # back and top, seen from behind and above
    upside_down = np.diag([1.0, -1.0, -1.0])
    assert 5 in window.box_faces(upside_down)[1]
