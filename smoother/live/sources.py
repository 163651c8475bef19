"""Sources of bytes: a serial port (or pseudo-terminal), standard input, or a recording played at a chosen speed.

A source is opened, read and closed by one thread, see receiver.py. `read` returns b"" when nothing arrived in time, and
None at the end; OSError means that the cable was unplugged, for every kind of port.
"""

import contextlib
import errno
import os
import select
import stat
import time
from bisect import bisect_right
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import serial

from smoother.errors import UsageError
from smoother.session.log import list_recordings, read_records
from smoother.session.log_format import MAGIC
from smoother.session.log_frames import Frame, encode_frames, find_frames

READ_BYTES = 4096  # at once; 25 ms of the fastest line
WAIT = 0.02  # s without bytes after which a read returns
DEFAULT_BAUD = 115200  # `stream_baud` of the logger's settings
LARGEST_CAPTURE = 512 << 20  # bytes of a recording that is held in memory


class Source(Protocol):
    """A source of bytes that can be opened again after a failure."""

    @property
    def name(self) -> str:
        """Name for messages."""
        ...

    @property
    def can_return(self) -> bool:
        """Whether it may come back after its end: a cable can, a file cannot."""
        ...

    def open(self) -> None:
        """Raise OSError if it does not exist."""

    def read(self) -> bytes | None:
        """Return received bytes, b"" if there were none for :data:`WAIT`, None at the end. Raises OSError if it was
        lost."""

    def close(self) -> None:
        """Never raises."""


@dataclass
class SerialSource:
    """A serial port; also a pseudo-terminal, or an address of pyserial (socket://host:port)."""

    port: str
    baud: int = DEFAULT_BAUD
    _serial: serial.Serial | None = None
    can_return: bool = True

    @property
    def name(self) -> str:
        """The port."""
        return self.port

    def open(self) -> None:
        """Raise OSError if there is no such port."""
        try:
            self._serial = serial.serial_for_url(self.port, baudrate=self.baud, timeout=WAIT, exclusive=False)
        except (serial.SerialException, ValueError) as error:
            raise OSError(_reason(error)) from error

    def read(self) -> bytes | None:
        """Return the bytes that have come. Raises OSError when the cable was pulled."""
        assert self._serial is not None
        try:
            waiting = self._serial.in_waiting
            return bytes(self._serial.read(min(max(1, waiting), READ_BYTES)))
        except (serial.SerialException, TypeError) as error:  # pyserial fails on a closed descriptor with TypeError
            raise OSError(str(error)) from error

    def close(self) -> None:
        """Close the port."""
        if self._serial is not None:
            with contextlib.suppress(OSError):  # already closed
                self._serial.close()
            self._serial = None


def _reason(error: Exception) -> str:
    """The error of a port without its name, which pyserial repeats."""
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return "no such port"
    return os.strerror(number).lower() if number else str(error)


@dataclass
class PipeSource:
    """Standard input, or another file descriptor that delivers while it is read."""

    descriptor: int = 0
    name: str = "standard input"
    can_return: bool = False

    def open(self) -> None:
        """Nothing to do."""

    def read(self) -> bytes | None:
        """Return the bytes that have come, None at the end."""
        ready, _, _ = select.select([self.descriptor], [], [], WAIT)
        return (os.read(self.descriptor, READ_BYTES) or None) if ready else b""

    def close(self) -> None:
        """Nothing to do."""


@dataclass
class ReplaySource:
    """A recording as the logger would have sent it, `speed` times as fast; infinite: as fast as it is read."""

    path: Path
    speed: float = 1.0
    can_return: bool = False
    _data: bytes = b""
    _times: list[float] = field(default_factory=list)  # s since the first frame, at which each is sent
    _ends: list[int] = field(default_factory=list)
    _at: int = 0
    _began: float = 0.0

    @property
    def name(self) -> str:
        """The file."""
        return self.path.name

    def open(self) -> None:
        """Read the file. Raises SessionError or UsageError if it holds no records."""
        self._data = _as_stream(self.path)
        self._times, self._ends = _schedule(self._data)
        if not self._ends:
            raise UsageError(f"{self.path.name}: holds neither blocks nor frames of the logger")
        self._at, self._began = 0, time.monotonic()

    def read(self) -> bytes | None:
        """Return the frames that are due."""
        if self._at >= self._ends[-1]:
            return None
        limit = self._at + READ_BYTES
        due = self._due(time.monotonic())
        if due <= self._at:
            time.sleep(WAIT / 4)
            return b""
        end = min(due, limit)
        piece, self._at = self._data[self._at : end], end
        return piece

    @property
    def share(self) -> float:
        """Played share, 0..1."""
        return self._at / self._ends[-1] if self._ends else 0.0

    def _due(self, now: float) -> int:
        if self.speed == float("inf"):
            return self._ends[-1]
        k = bisect_right(self._times, (now - self._began) * self.speed)
        return self._ends[k - 1] if k else 0

    def close(self) -> None:
        """Release the file."""
        self._data = b""


def _as_stream(path: Path) -> bytes:
    if path.stat().st_size > LARGEST_CAPTURE:
        raise UsageError(f"{path.name}: larger than {LARGEST_CAPTURE >> 20} MB; smooth it instead")
    if path.suffix.lower() == ".klg" or path.read_bytes()[: len(MAGIC)] == MAGIC:
        return encode_frames(read_records(list_recordings([path])[0])[0])
    return path.read_bytes()


def _schedule(data: bytes) -> tuple[list[float], list[int]]:
    """When each good frame is due, s since the first, and the byte at which it ends."""
    frames, _ = find_frames(data)
    times: list[float] = []
    ends: list[int] = []
    at = 0
    for frame in frames:
        place = _place(data, frame, at)
        at = place
        ends.append(at)
        due = (frame.base_us - frames[0].base_us) * 1e-6
        times.append(max(due, times[-1] if times else 0.0))
    if ends:
        ends[-1] = len(data)
    return times, ends


def _place(data: bytes, frame: Frame, after: int) -> int:
    """Index of the byte after the next frame after `after`."""
    at = data.index(frame.records, after)
    return at + len(frame.records) + 4


def source_for(target: str, baud: int = DEFAULT_BAUD, speed: float = 1.0) -> Source:
    """Return the source that `target` names: "-", a file, or a port. Raises UsageError for a folder."""
    if target == "-":
        return PipeSource()
    path = Path(target)
    if path.is_dir():
        files = sorted(p for p in path.iterdir() if p.suffix.lower() == ".klg")
        raise UsageError(f"{target}: a folder; name one of its files" + (f", as {files[-1]}" if files else ""))
    if path.exists() and stat.S_ISREG(path.stat().st_mode):
        return ReplaySource(path, speed)
    if path.exists() and stat.S_ISFIFO(path.stat().st_mode):
        return PipeSource(os.open(path, os.O_RDONLY), target)
    looks_like_port = target.startswith(("/dev/", "COM", "socket://", "rfc2217://", "loop://"))
    if not path.exists() and not looks_like_port:
        raise UsageError(f"{target}: no such port or file")
    return SerialSource(target, baud)
