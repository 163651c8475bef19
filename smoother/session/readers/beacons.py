"""Lap times that a logger took by a beacon or its own line, to stand beside ours as official times."""

import re
from pathlib import Path

import numpy as np

from smoother.errors import SessionError
from smoother.session.readers.child import sheets_in
from smoother.session.readers.table import layout_in
from smoother.session.readers.xrk import LAP

_SECONDS = re.compile(r"\d+(?:[.,]\d+)?")
END = 0.002  # s before the end of a recording, where the last marker of AiM's CSV stands


def beacon_times(kind: str, path: Path) -> tuple[float, ...]:
    """Return the times s of the laps between passages of the beacon in a recording, none where it holds none."""
    try:
        return _of_log(path) if kind == "xrk" else _of_table(path) if kind == "table" else ()
    except SessionError:  # whoever reads the session will say what is wrong
        return ()


def _of_log(path: Path) -> tuple[float, ...]:
    laps = next((sheet for sheet in sheets_in("xrk", [path]) if sheet.sensor == LAP), None)
    if laps is None:
        return ()
    begin, end = (column.values for column in laps.columns[:2])
    return tuple(float(time) for time in end - begin)


def _of_table(path: Path) -> tuple[float, ...]:
    about = layout_in(path)[0].about
    markers, lasts = (_seconds(about.get(name, "")) for name in ("beacon markers", "duration"))
    if markers and lasts and markers[-1] > lasts[0] - END:
        markers = markers[:-1]
    return tuple(float(time) for time in np.diff(markers))


def _seconds(text: str) -> list[float]:
    return [float(number.replace(",", ".")) for number in _SECONDS.findall(text)]
