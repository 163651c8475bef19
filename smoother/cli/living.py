"""`smooth live PORT|FILE`: attitude, position and lap times while the logger records."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from smoother.cli.arguments import EXIT_DONE, EXIT_UNUSABLE, Number, Whole
from smoother.cli.output import Progress, print_json, progress_on_terminal, warn
from smoother.errors import UsageError
from smoother.words import counted

if TYPE_CHECKING:
    from smoother.live.frame import Frame
    from smoother.live.receiver import LinkStatus
    from smoother.live.recording import Recorder
    from smoother.live.running import View
    from smoother.live.sources import Source


@click.command(short_help="Attitude, position and lap time while the logger records.")
@click.argument("target", metavar="PORT|FILE|-")
@click.option("--baud", type=Whole(1200, 4_000_000), default=115200, help="Of the serial port [115200].")
@click.option("--speed", metavar="X", default="1", help="Of a file: times real speed, or `max` [1].")
@click.option("--record", metavar="DIR", type=click.Path(path_type=Path), help="Write a session that smooth accepts.")
@click.option("--headless", is_flag=True, help="Show progress only.")
@click.option("--json", "as_json", is_flag=True, help="Print a line of JSON every second; implies --headless.")
@click.option("--view", type=click.Choice(["auto", "window", "terminal"]), default="auto", help="Where to show it.")
@click.option("--calibration", metavar="FILE", type=click.Path(path_type=Path), help="calibration.toml of this logger.")
@click.option("--line", metavar="LAT,LON;LAT,LON", help="The start/finish line [found in the second lap].")
@click.option("--seconds", metavar="S", type=Number(0.1), help="Stop after this time.")
def live(
    target: str,
    baud: int,
    speed: str,
    record: Path | None,
    headless: bool,
    as_json: bool,
    view: str,
    calibration: Path | None,
    line: str | None,
    seconds: float | None,
) -> int:
    """Show what the logger sends over its serial line: attitude, accelerations, GPS, laps, and the share of lost data.

    PORT is a serial port (/dev/ttyUSB0), FILE a recording (.KLG, or bytes of the line), - standard input. An unplugged
    cable may be plugged in again. Attitude is shown at once; after some seconds of driving, mounting and latencies are
    identified and the smoother starts. Ctrl-C or closing the window ends it.
    """
    import numpy as np

    from smoother.calibration import load_calibration
    from smoother.laps.tracks import line_from_text
    from smoother.live.engine import Engine
    from smoother.live.receiver import Receiver
    from smoother.live.recording import Recorder, SessionWriter
    from smoother.live.remote_navigator import RemoteNavigator
    from smoother.live.running import run
    from smoother.live.sources import source_for

    source = source_for(target, baud, _speed(speed))
    values = None if calibration is None else load_calibration(calibration)
    tracks = () if line is None else (line_from_text(line),)
    recorder = None if record is None else Recorder(SessionWriter(record, np.random.default_rng()))
    with (
        RemoteNavigator(tracks) as navigating,
        Receiver(source, waits=not source.can_return) as receiver,
        _view(view, headless or as_json, as_json, source) as shown,
        _stopping(seconds) as stop,
        recorder or contextlib.nullcontext(),
    ):
        last = run(receiver, Engine(navigating, values), shown, recorder, stop)
    came, is_understood = receiver.status.received_bytes, last.losses.frames > 0
    if came and not is_understood:
        warn(
            f"{_bytes(came)} received, none of them in the format of the logger's line; "
            "check the speed (--baud) and that its CONFIG.TXT has stream=200. "
            "To play a file of a card, name it: smooth live FILE"
        )
    return EXIT_DONE if recorder is None or _report_recorded(recorder, came > 0) else EXIT_UNUSABLE


def _bytes(count: int) -> str:
    if count < 1000:
        return counted(count, "byte")
    return f"{count / 1e3:.0f} kB" if count < 1_000_000 else f"{count / 1e6:.1f} MB"


def _report_recorded(recorder: Recorder, has_come: bool) -> bool:
    """Report the recorded data; return whether all received data was recorded."""
    status, path = recorder.status, recorder.path
    if status.flaw:
        kept = f"{path} holds the first {_bytes(status.bytes_written)}" if status.bytes_written else "nothing is kept"
        warn(f"recording failed: {status.flaw}; {kept}")
        return False
    nothing = "nothing was recorded" if has_come else "nothing was received, so nothing was recorded"
    warn(nothing if path is None else f"recorded {path}")
    return True


def _speed(text: str) -> float:
    try:
        value = float("inf") if text == "max" else float(text)
    except ValueError:
        value = 0.0
    if not value > 0.0:
        raise UsageError(f"--speed {text}: a number above 0, or max")
    return value


@contextlib.contextmanager
def _stopping(seconds: float | None) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether to stop: after `seconds`, on Ctrl-C or SIGTERM."""
    import time

    asked: list[int] = []
    end = None if seconds is None else time.monotonic() + seconds
    ends = [s for name in ("SIGINT", "SIGTERM", "SIGHUP") if (s := getattr(signal, name, None)) is not None]
    before = {s: signal.signal(s, lambda number, _: asked.append(number)) for s in ends}
    try:
        yield lambda: bool(asked) or (end is not None and time.monotonic() >= end)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Lines:
    """The view without a display: a line of JSON a second, or progress only."""

    def __init__(self, as_json: bool, source: Source, progress: Progress) -> None:
        self._as_json, self._source, self._progress = as_json, source, progress
        self._has_told, self._news = False, ""
        self.frames_a_second = 1.0

    def draw(self, frame: Frame) -> bool:
        from smoother.live.document import line_of, news_of
        from smoother.live.sources import ReplaySource

        self._report_connection(frame.link)
        share = self._source.share if isinstance(self._source, ReplaySource) else 0.0
        # the smoother goes on at the end of a file, and so does the time that is shown
        self._progress(f"{self._source.name} {frame.snapshot.t:.0f} s, {frame.snapshot.stage}", 0.99 * share)
        before, self._news = self._news, news_of(frame) if self._as_json else ""
        if self._as_json and not (frame.link.is_over and self._news == before):  # at the end the smoother goes on
            print_json(line_of(frame))
            sys.stdout.flush()
        return True

    def _report_connection(self, link: LinkStatus) -> None:
        """Report a missing connection once, and again whenever it is lost."""
        if link.is_open:
            self._has_told = False
        elif link.error and not self._has_told:
            from smoother.live.view_text import trouble

            warn(f"waiting for {self._source.name}: {trouble(link)}")
            self._has_told = True


@contextlib.contextmanager
def _view(kind: str, headless: bool, as_json: bool, source: Source) -> Iterator[View]:
    name = source.name
    if headless:
        # not on a terminal that shows the lines
        with progress_on_terminal(not (as_json and sys.stdout.isatty())) as progress:
            yield _Lines(as_json, source, progress)
        return
    if kind == "window" or (kind == "auto" and _has_display()):
        from smoother.live.window import WindowView

        with WindowView(name) as window:
            yield window
        return
    from smoother.live.terminal import TerminalView

    with TerminalView(name) as terminal:
        yield terminal


def _has_display() -> bool:
    if not sys.stdout.isatty():
        return False
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
