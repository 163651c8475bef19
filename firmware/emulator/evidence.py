"""What a run of the emulator left, read as a person would: the card, the recordings on it, the LED, the messages.

The sensors measure numbers here: each sample says which one it is, so that whatever becomes of it can be told.
"""

import subprocess
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parent))
from emulation import Outcome, Stimulus, build
from smoother.errors import SessionError
from smoother.session.log import list_recordings, read_records
from smoother.session.log_decode import Losses
from smoother.session.log_format import EVENTS, IMU, LogRecords

IMU_US, MAG_US, FIX_US = 1_000, 10_000, 200_000
LOW_BITS = 14
GAP_SLACK_US = 1_500  # by which the times of a gap may miss a sample's
LED_STEP_S = 0.01
LED_AGREEMENT = 0.95  # of a window; a change of pattern in it is no agreement

# README.md, "Using it": period s, length of a flash and of the pause after it s, flashes
LED_PATTERNS = {
    "dark": (1.0, 0.5, 0),
    "waiting": (2.0, 1.0, 1),
    "recording": (1.0, 0.1, 1),
    "no fix": (1.0, 0.1, 2),
    "offer": (2.0, 0.15, 3),
    "calibrating": (0.5, 0.25, 1),
    "card missing": (0.1, 0.05, 1),
    "card failing": (2.0, 0.05, 10),
    "card full": (2.0, 0.05, 5),
    "card foreign": (2.0, 0.05, 2),
    "GPS alone": (2.0, 0.15, 4),
    "on": (1.0, 1.0, 1),
}

Ints = npt.NDArray[np.int64]


# ---- what the sensors measure ----


def stir(number: Ints, columns: int) -> npt.NDArray[np.int16]:
    """Words (N, columns) that follow from a number (N,) and look like noise."""
    column: npt.NDArray[np.uint64] = np.arange(columns, dtype=np.uint64)
    x: npt.NDArray[np.uint64] = number.astype(np.uint64)[:, None] * np.uint64(0x9E3779B97F4A7C15) + column
    x = (x ^ (x >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return np.asarray((x >> np.uint64(48)).astype(np.uint16).view(np.int16))


def numbered(count: int, columns: int) -> npt.NDArray[np.int16]:
    """Samples (count, columns) that tell their number: two words of it, the others stirred."""
    number = np.arange(count, dtype=np.int64)
    words = np.stack([number & ((1 << LOW_BITS) - 1), number >> LOW_BITS], axis=1).astype(np.int16)
    return np.concatenate([words, stir(number, columns - 2)], axis=1)


def numbers_of(samples: npt.NDArray[np.int16]) -> Ints:
    """Numbers (N,) of samples (N, columns); -1 where it is none of those that `numbered` makes."""
    number = samples[:, 0].astype(np.int64) + (samples[:, 1].astype(np.int64) << LOW_BITS)
    is_true = (samples[:, :2] >= 0).all(axis=1) & (samples[:, 2:] == stir(number, samples.shape[1] - 2)).all(axis=1)
    return np.where(is_true, number, -1)


def sentence(body: str) -> bytes:
    """An NMEA sentence with its sum."""
    total = 0
    for byte in body.encode():
        total ^= byte
    return f"${body}*{total:02X}\r\n".encode()


def fix_at(t_us: int) -> bytes:
    """The three sentences of a fix, their time of day that of the emulator."""
    hundredths = t_us // 10_000
    seconds = hundredths // 100
    clock = f"{seconds // 3600:02}{seconds // 60 % 60:02}{seconds % 60:02}.{hundredths % 100:02}"
    return b"".join(
        sentence(body)
        for body in (
            f"GPRMC,{clock},A,4124.8963,N,00210.4251,E,30.5,84.4,230394,,,A",
            f"GPGGA,{clock},4124.8963,N,00210.4251,E,1,08,1.1,50.0,M,49.0,M,,",
            f"GPGST,{clock},1.2,,,,1.1,1.3,2.2",
        )
    )


def numbered_stimulus(duration_s: float) -> Stimulus:
    """Sensors that count, from power-on: sample n of the IMU at n + 1 ms, a fix each 200 ms."""
    imu, mag = (numbered(round(duration_s * 1e6) // period, n) for period, n in ((IMU_US, 6), (MAG_US, 3)))
    imu_t, mag_t = ((np.arange(len(rows), dtype=np.int64) + 1) * t for rows, t in ((imu, IMU_US), (mag, MAG_US)))
    due = np.arange(300_000, round(duration_s * 1e6), FIX_US)
    late = stir(due, 1)[:, 0] % IMU_US  # by which they come, at any moment between two samples
    fixes = [(t + more, fix_at(t)) for t, more in zip(due.tolist(), late.tolist(), strict=True)]
    return Stimulus(imu_t, imu, mag_t, mag, fixes, 0, round(duration_s * 1e6))


# ---- what became of them ----


@dataclass(frozen=True)
class Account:
    """The samples of one recording. recorded, strange (not as measured), missing between the first and the last, told
    of by gaps, missing outside the times of all gaps; out of order; the first and the last number; how far apart the
    errors of the stamps are (us)."""

    recorded: int
    strange: int
    missing: int
    told: int
    untold: int
    disorder: int
    first: int
    last: int
    spread_us: float


def account(records: LogRecords) -> Account:
    """Count what a recording says of its samples and what is true."""
    number = numbers_of(records.imu)
    is_true = number >= 0
    gaps = [gap for gap in records.gaps if gap.source == IMU]
    told = sum(gap.count for gap in gaps)
    if not is_true.any():
        return Account(0, len(number), 0, told, 0, 0, -1, -1, 0.0)
    number, t = number[is_true], records.imu_t[is_true]
    step = np.diff(number)
    missing = np.setdiff1d(np.arange(number[0], number[-1] + 1), number)
    late = t - (number + 1) * IMU_US
    when = (missing + 1) * IMU_US + np.median(late)
    spans = [(gap.first_us - GAP_SLACK_US, gap.last_us + GAP_SLACK_US) for gap in gaps]
    covered = np.zeros(len(missing), dtype=bool)
    for first, last in spans:
        covered |= (when >= first) & (when <= last)
    return Account(
        len(number),
        int((~is_true).sum()),
        len(missing),
        told,
        int((~covered).sum()),
        int((step <= 0).sum()),
        int(number[0]),
        int(number[-1]),
        float(np.ptp(late)),
    )


@dataclass(frozen=True)
class Recording:
    """A recording on a card: the names of its files, its records, what is missing by the numbers of its blocks."""

    names: tuple[str, ...]
    records: LogRecords
    losses: Losses

    @cached_property
    def account(self) -> Account:
        """What became of its samples."""
        return account(self.records)

    @cached_property
    def numbers(self) -> Ints:
        """Numbers (N,) of its samples, -1 for those that were not as measured."""
        return numbers_of(self.records.imu)

    @property
    def events(self) -> set[str]:
        """Names of its events."""
        return {EVENTS.get(event.code, str(event.code)) for event in self.records.events}


def read_recordings(folders: list[Path]) -> tuple[Recording, ...]:
    """The recordings on the cards, oldest first; those without a block are left out."""
    paths = [path for folder in folders for path in sorted(folder.glob("LOG*.KLG"))]
    try:
        found = list_recordings(paths)
    except SessionError:
        return ()
    return tuple(Recording(tuple(p.name for p in files.paths), *read_records(files)) for files in found)


def check_volume(path: Path) -> str:
    """What fsck.fat complains of; empty if of nothing."""
    tool = build.find_tool("fsck.fat") or "fsck.fat"
    done = subprocess.run([tool, "-n", str(path)], capture_output=True, text=True)
    return " / ".join(done.stdout.splitlines()[1:4]) if done.returncode else ""


@dataclass(frozen=True)
class Evidence:
    """Everything a run left."""

    outcome: Outcome

    @property
    def folders(self) -> list[Path]:
        """One for each card: the one that was in last, and the one before it if there was one."""
        folder = self.outcome.folder
        return [part for part in (folder, folder / "other") if (part / "card.img").exists()]

    @cached_property
    def recordings(self) -> tuple[Recording, ...]:
        """On all cards."""
        return read_recordings(self.folders)

    @cached_property
    def serial(self) -> str:
        """Messages from USART1."""
        return (self.outcome.folder / "serial.txt").read_text(errors="replace")

    @cached_property
    def files(self) -> dict[str, int]:
        """Length of each file in the root directory, by name."""
        path = self.outcome.folder / "files.txt"
        rows = [line.rsplit(" ", 1) for line in path.read_text().splitlines()] if path.exists() else []
        return {name: int(size) for name, size in rows}

    @cached_property
    def volume_complaints(self) -> str:
        """Of fsck.fat, about every card that was formatted."""
        images = [folder / "card.img" for folder in self.folders if (folder / "files.txt").exists()]
        return " / ".join(filter(None, map(check_volume, images)))

    @cached_property
    def _led(self) -> npt.NDArray[np.float64]:
        text = (self.outcome.folder / "led.txt").read_text()
        return np.array([line.split() for line in text.splitlines()], dtype=float).reshape(-1, 2)

    def led(self, start_s: float, end_s: float) -> str:
        """The pattern of the LED in a window of at least its period; empty if it is none of them throughout."""
        t = np.arange(start_s, end_s, LED_STEP_S)
        at = np.searchsorted(self._led[:, 0], 1e6 * t, side="right") - 1
        is_on = np.where(at >= 0, self._led[np.maximum(at, 0), 1] > 0, False) if len(self._led) else t < 0
        best, name = max((_agreement(is_on, t, rhythm), name) for name, rhythm in LED_PATTERNS.items())
        return name if best >= LED_AGREEMENT else ""


def _agreement(is_on: npt.NDArray[np.bool_], t: npt.NDArray[np.float64], rhythm: tuple[float, float, int]) -> float:
    """Largest share of a window in which the LED is as a rhythm has it, over all its phases."""
    period, flash, flashes = rhythm
    phase = np.arange(0.0, period, LED_STEP_S)[:, None]
    step = ((t + phase) % period / flash).astype(int)
    return float(((step % 2 == 0) & (step // 2 < flashes) == is_on).mean(axis=1).max())
