"""FIT files of Garmin and others, through fitdecode: the records, a fix and what else was measured a second or so.

Runs in a child process.
"""

import datetime as dt
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from smoother.errors import SessionError
from smoother.session.readers.sheet import Column, Sheet, sheet_of

MOST_RECORDS = 2_000_000
BETTER = {"speed": "enhanced_speed", "altitude": "enhanced_altitude"}


def sheets(paths: Sequence[Path]) -> list[Sheet]:
    """The sheet of the records. Raises SessionError where there are none."""
    import fitdecode

    columns: dict[str, dict[int, float]] = {}
    units: dict[str, str] = {}
    row = 0
    with fitdecode.FitReader(str(paths[0]), error_handling=fitdecode.ErrorHandling.WARN) as reader:
        try:
            for frame in reader:
                if frame.frame_type != fitdecode.FIT_FRAME_DATA or frame.name != "record" or row >= MOST_RECORDS:
                    continue
                for field in frame.fields:
                    value = field.value
                    if isinstance(value, dt.datetime):
                        value = value.timestamp()
                    if isinstance(value, (int, float)):
                        columns.setdefault(field.name, {})[row] = float(value)
                        units.setdefault(field.name, str(field.units or ""))
                row += 1
        except fitdecode.FitError:
            if not row:
                raise
    if "position_lat" not in columns:
        raise SessionError("no record with a position in it; was the GPS on?")
    found = []
    for name, cells in columns.items():
        if BETTER.get(name) in columns:
            continue
        values = np.full(row, np.nan)
        values[list(cells)] = list(cells.values())
        found.append(Column(name, values, "s" if name == "timestamp" else units[name]))
    return [sheet_of("", found)]
