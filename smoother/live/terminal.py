"""The view where there is no display: a panel on the terminal, drawn by rich."""

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from smoother.live import view_text
from smoother.live.frame import Frame
from smoother.units import DEG, STANDARD_GRAVITY

BAR = 21  # characters
FORCE_RANGE, RATE_RANGE = 3.0, 180.0  # g, deg/s
FRAMES = 10.0  # a second: enough for a terminal over a network


def bar(value: float, limit: float) -> str:
    """Return a bar of :data:`BAR` characters from the middle to value / limit."""
    half = BAR // 2
    n = round(half * float(np.clip(value / limit, -1.0, 1.0)))
    cells = ["·"] * BAR
    for i in range(min(half, half + n), max(half, half + n) + 1):
        cells[i] = "█"
    cells[half] = "│" if n == 0 else "█"
    return "".join(cells)


def panel(frame: Frame, name: str) -> Panel:
    """Return a frame as one panel. name of the source."""
    s, link = frame.snapshot, frame.link
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", min_width=10)
    table.add_column()
    gps_style = "green" if view_text.is_gps_good(s) else "bold red"
    lag = s.lag
    smoothed = view_text.angles(lag.R_nb if lag else None)
    rows: list[tuple[str, Text]] = [
        ("attitude", Text("roll {:>8}  pitch {:>8}  yaw {:>6}   (Madgwick)".format(*view_text.angles(s.madgwick)))),
        ("", Text("roll {:>8}  pitch {:>8}  yaw {:>6}   (smoother)".format(*smoothed))),
        ("smoother", Text(view_text.smoother(s))),
        ("GPS", Text(view_text.gps(s), style=gps_style)),
        ("speed", Text(view_text.speed(s), style="bold")),
        ("laps", Text(view_text.laps(s))),
    ]
    for axis, value in zip("xyz", s.force / STANDARD_GRAVITY, strict=True):
        rows.append((f"force {axis}", Text(f"{bar(value, FORCE_RANGE)} {value:+6.2f} g")))
    for axis, value in zip("xyz", s.rate / DEG, strict=True):
        rows.append((f"rate {axis}", Text(f"{bar(value, RATE_RANGE)} {value:+6.1f} °/s")))
    link_style = "" if link.is_open else "bold red"
    rows += [
        ("rates", Text(view_text.rates(frame))),
        ("link", Text(view_text.connection(link, name), style=link_style)),
        ("lost", Text(view_text.losses(frame))),
        ("delay", Text(view_text.delay(frame))),
        ("recording", Text(view_text.recording(frame), style="" if view_text.is_recording_well(frame) else "bold red")),
    ]
    for label, text in rows:
        table.add_row(label, text)
    return Panel(Group(table), title=Text(f"smooth live   {s.t:.1f} s"), expand=False)


class TerminalView:
    """Draws into the terminal until it is closed."""

    frames_a_second = FRAMES

    def __init__(self, name: str, console: Console | None = None) -> None:
        self._name = name
        self._live = Live(console=console or Console(), auto_refresh=False, transient=False)

    def __enter__(self) -> "TerminalView":
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def draw(self, frame: Frame) -> bool:
        """Draw; returns True: a terminal is never closed."""
        self._live.update(panel(frame, self._name), refresh=True)
        return True
