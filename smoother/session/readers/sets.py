"""Which files of a folder are one recording of another program: chapters of a video, a table for each sensor; archives.

A phone's logger writes a table a sensor, in a folder or an archive; a camera starts a new chapter every few gigabytes.
"""

import itertools
import re
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import numpy as np

from smoother.errors import SessionError
from smoother.session.readers.child import KINDS, sheets_in
from smoother.session.readers.columns import recording_of
from smoother.session.readers.foreign import ForeignReading
from smoother.session.readers.layout import layout_in, sheet_in
from smoother.session.readers.xrk import LAP

_CHAPTER = re.compile(r"(?i)^g(?:[a-z](?P<chapter>\d{2})|opr)(?P<number>\d{4})\b")
MOST_FILES = 200
LARGEST_UNPACKED = 2 << 30  # bytes
OF_NO_SENSOR = "meta"  # folder of phyphox
COPY_STEP = 1 << 20  # bytes
UNPACKED_SUFFIXES = (
    ".csv",
    ".txt",
    ".tsv",
    ".nmea",
    ".gpx",
    ".tcx",
    ".kml",
    ".vbo",
    ".fit",
    ".log",
    ".ubx",
    ".xrk",
    ".json",
)


def chapters_of(path: Path, others: Sequence[Path]) -> list[Path]:
    """The chapters of a camera's recording in order, of which `path` is one."""
    if (match := _CHAPTER.match(path.name)) is None:
        return [path]
    found = [
        (m["chapter"] or "00", p) for p in others if (m := _CHAPTER.match(p.name)) and m["number"] == match["number"]
    ]
    return [p for _, p in sorted({(match["chapter"] or "00", path), *found})]


def sensors_of(path: Path, sensors: Sequence[Path], others: Sequence[Path]) -> list[Path]:
    """The tables of sensors that belong to the table `path` of fixes; by their names, where there are other fixes."""

    def shared(table: Path, sensor: Path) -> int:
        pairs = zip(table.name.lower(), sensor.name.lower(), strict=False)
        return sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs))

    return [s for s in sensors if all(shared(path, s) > shared(other, s) for other in others)]


def read_native(kind: str, paths: Sequence[Path]) -> ForeignReading:
    """Read the files of a recording of a kind that a library reads. Raises SessionError, one line."""
    return recording_of(paths[0].name, sheets_in(kind, paths))


def read_tables(path: Path, sensors: Sequence[Path] = ()) -> ForeignReading:
    """Read a table of fixes and those of sensors beside it. Raises SessionError, one line."""
    return recording_of(path.name, [sheet_in(path), *(sheet_in(sensor) for sensor in sensors)])


@contextmanager
def unpacked(archive: Path) -> Iterator[Path]:
    """A folder for a while with the recordings in an archive. Raises SessionError where there are none, or too much."""
    with tempfile.TemporaryDirectory() as name:
        folder, room = Path(name), LARGEST_UNPACKED
        try:
            with zipfile.ZipFile(archive) as packed:
                for member in packed.infolist()[:MOST_FILES]:
                    inner = PurePosixPath(member.filename.replace("\\", "/"))
                    is_wanted = inner.name.lower().endswith(UNPACKED_SUFFIXES) and not inner.name.startswith(".")
                    if not is_wanted or OF_NO_SENSOR in inner.parts:
                        continue
                    with packed.open(member) as source, (folder / inner.name).open("wb") as target:
                        while chunk := source.read(COPY_STEP):
                            room -= len(chunk)
                            if room < 0:
                                raise SessionError(f"{archive.name}: more than {LARGEST_UNPACKED >> 30} GB unpacked")
                            target.write(chunk)
        except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError, ValueError) as error:
            raise SessionError(f"{archive.name}: cannot be unpacked ({error}); unpack it yourself") from error
        except zlib.error as error:
            raise SessionError(f"{archive.name}: damaged ({error})") from error
        yield folder


__all__ = ["KINDS", "chapters_of", "read_native", "read_tables", "sensors_of", "unpacked"]


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
    layout = layout_in(path)
    about = {} if layout is None else layout.about
    markers, lasts = (_seconds(about.get(name, "")) for name in ("beacon markers", "duration"))
    if markers and lasts and markers[-1] > lasts[0] - END:
        markers = markers[:-1]
    return tuple(float(time) for time in np.diff(markers))


def _seconds(text: str) -> list[float]:
    return [float(number.replace(",", ".")) for number in _SECONDS.findall(text)]
