"""AiM's binary logs, .xrk, .xrz and .drk, through libxrk: every channel at its own rate, laps by the beacon.

Its accelerometer counts z downwards and its gyroscope upwards, as gravity shows; a box that lies on its head is the
same. Runs in a child process.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from smoother.errors import SessionError
from smoother.session.readers.sheet import Column, Sheet, sheet_of

MOST_CHANNELS = 200
LAP = "lap"  # sheet of times of laps


def sheets(paths: Sequence[Path]) -> list[Sheet]:
    """The channels of a log that share their times, as sheets; and one of its laps. Raises SessionError without any."""
    import libxrk

    log = libxrk.aim_xrk(str(paths[0]))
    groups: dict[bytes, list[Column]] = {}
    for name, table in list(log.channels.items())[:MOST_CHANNELS]:
        t = np.asarray(table.column("timecodes"), dtype=np.float64)
        values = np.asarray(table.column(name), dtype=np.float64)
        unit = (table.schema.field(name).metadata or {}).get(b"units", b"").decode(errors="replace")
        if t.size:
            columns = groups.setdefault(t.tobytes(), [Column("time", t, "ms")])
            columns.append(Column(name, values, unit))
    if not groups:
        raise SessionError("no channels in it; was the recording started?")
    about = {key.lower(): str(log.metadata.get(key) or "").strip() for key in ("Log Date", "Log Time")}
    about["z of forces"] = "down"
    found = [sheet_of("", columns, about=about) for columns in groups.values()]
    whole = np.array([kind == "full" for kind in log.laps.column("lap_type").to_pylist()], dtype=np.bool_)
    laps = {key: np.asarray(log.laps.column(key), dtype=np.float64)[whole] for key in ("start_time", "end_time")}
    if laps["start_time"].size:
        found.append(sheet_of("", [Column(key, 1e-3 * values, "s") for key, values in laps.items()], sensor=LAP))
    return found
