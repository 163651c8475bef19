"""Telemetry in a GoPro's video, through GPMF's own parser: fixes, accelerometer and gyroscope, of several chapters.

A stream's samples are spread evenly over the second or so of video that they are stored with. The three axes are used
in the order they are stored in, which is right-handed for every model. Runs in a child process.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.session.readers.sheet import Column, Sheet, sheet_of
from smoother.units import DAY

GPS5 = (("latitude", "deg"), ("longitude", "deg"), ("altitude", "m"), ("speed", "m/s"), ("speed 3d", "m/s"))
GPS9 = (*GPS5, ("days", ""), ("seconds of day", "s"), ("dop", ""), ("fix", ""))
AXES = {"ACCL": ("ax", "ay", "az", "m/s2"), "GYRO": ("gx", "gy", "gz", "rad/s")}
EPOCH_2000 = 946_684_800.0  # s since 1970
DOP_UNIT = 0.01
LARGEST_PAYLOAD = 64 << 20  # bytes


def sheets(paths: Sequence[Path]) -> list[Sheet]:
    """The sheets of the chapters of one recording. Raises SessionError where there is no telemetry in them."""
    blocks: dict[str, list[Array]] = defaultdict(list)
    start = 0.0
    for path in paths:
        start += _read_chapter(path, start, blocks)
    if not blocks:
        raise SessionError("a video without a GoPro's telemetry; was it cut or converted? Use the original")
    found = []
    for key, (x, y, z, unit) in AXES.items():
        if key in blocks:
            rows = np.concatenate(blocks[key])
            columns = [Column(axis, rows[:, 1 + i], unit) for i, axis in enumerate((x, y, z))]
            found.append(sheet_of("", [Column("time", rows[:, 0], "s"), *columns]))
    for key in ("GPS9", "GPS5"):
        if key in blocks:
            return [_fixes(np.concatenate(blocks[key]), GPS9 if key == "GPS9" else GPS5), *found]
    return found


def _fixes(rows: Array, names: Sequence[tuple[str, str]]) -> Sheet:
    """The sheet of fixes: rows (N, 1 + n + 3) of time, values, and then UTC, dilution and fix of the block."""
    values = {name: (rows[:, 1 + i], unit) for i, (name, unit) in enumerate(names)}
    utc, dop, fix = (rows[:, 1 + len(names) + i] for i in range(3))
    if "days" in values:
        utc = EPOCH_2000 + DAY * values["days"][0] + values["seconds of day"][0]
        dop, fix = values["dop"][0], values["fix"][0]
    columns = [Column("time", rows[:, 0], "s"), Column("utc", utc, "s")]
    columns += [Column(name, *values[name]) for name in ("latitude", "longitude", "altitude", "speed")]
    return sheet_of("", [*columns, Column("hdop", dop), Column("fix", np.where(fix >= 2, fix, 0.0))])


def _read_chapter(path: Path, start: float, blocks: dict[str, list[Array]]) -> float:
    """Append the rows (N, ..) of each stream, time first, and return how long the chapter is, s."""
    import py_gpmf_parser as gpmf

    handle = gpmf.OpenMP4Source(str(path), gpmf.MOV_GPMF_TRAK_TYPE, gpmf.MOV_GPMF_TRAK_SUBTYPE, 0)
    if not handle:
        raise SessionError("a video without a GoPro's telemetry; was it cut or converted? Use the original")
    resource = 0
    for index in range(gpmf.GetNumberPayloads(handle)):
        size = gpmf.GetPayloadSize(handle, index)
        if not 0 < size <= LARGEST_PAYLOAD:
            continue
        resource = gpmf.GetPayloadResource(handle, resource, size)
        payload = np.array(gpmf.GetPayload(handle, resource, index, size), dtype=np.uint32)
        _, begin, end = gpmf.GetPayloadTime(handle, index)
        for key, rows in streams_in(payload):
            t = start + begin + (end - begin) * (np.arange(len(rows)) + 0.5) / len(rows)
            blocks[key].append(np.column_stack([t, rows]))
    duration = float(gpmf.GetDuration(handle))
    gpmf.CloseSource(handle)
    return duration


def streams_in(payload: npt.NDArray[np.uint32]) -> Iterator[tuple[str, Array]]:
    """The streams of a payload of words (N,) that are wanted: fixes with UTC, dilution and quality of their block."""
    import py_gpmf_parser as gpmf

    error, stream = gpmf.GPMF_Init(payload, payload.nbytes)
    if error:
        return
    for key, width in (("ACCL", 3), ("GYRO", 3), ("GPS5", len(GPS5)), ("GPS9", len(GPS9))):
        rows = _values(gpmf, stream, key)
        if rows is None or rows.shape[1] != width:
            continue
        if key.startswith("GPS"):
            dop, fix = (_values(gpmf, stream, name) for name in ("GPSP", "GPSF"))
            of_block = [_utc(gpmf, stream), *(np.nan if one is None else one[0, 0] for one in (dop, fix))]
            of_block[1] *= DOP_UNIT
            utc = np.full(len(rows), np.nan)
            utc[:1] = of_block[0]
            rows = np.column_stack([rows, utc, np.full((len(rows), 2), of_block[1:])])
        yield key, rows


def _find(gpmf: Any, stream: Any, key: str) -> bool:
    gpmf.GPMF_ResetState(stream)
    return not gpmf.GPMF_FindNext(stream, gpmf.Str2FourCC(key), gpmf.GPMF_RECURSE_LEVELS_AND_TOLERANT)


def _values(gpmf: Any, stream: Any, key: str) -> Array | None:
    """Scaled values (N, n) of a stream, None without it."""
    if not _find(gpmf, stream, key):
        return None
    rows, width = gpmf.GPMF_Repeat(stream), gpmf.GPMF_ElementsInStruct(stream)
    if not 0 < rows * width <= LARGEST_PAYLOAD:
        return None
    error, values = gpmf.GPMF_ScaledData(stream, 8 * rows * width, 0, rows, gpmf.GPMF_SampleType.DOUBLE)
    return None if error else np.array(values[: rows * width]).reshape(rows, width)


def _utc(gpmf: Any, stream: Any) -> float:
    """UTC of a block, s since 1970, from yymmddhhmmss.sss; NaN without it."""
    import datetime as dt

    if not _find(gpmf, stream, "GPSU"):
        return float("nan")
    text = gpmf.GPMF_RawData(stream).decode("ascii", errors="replace")
    try:
        return dt.datetime.strptime(f"20{text}", "%Y%m%d%H%M%S.%f").replace(tzinfo=dt.UTC).timestamp()
    except ValueError:
        return float("nan")
