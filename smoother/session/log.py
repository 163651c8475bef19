"""The logger's recordings: from `*.klg` files (firmware/FORMAT.md) to samples and fixes in physical units.

A recording is every block with one session id, in whichever files of a directory they lie.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from mmap import mmap
from pathlib import Path

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array, IntArray
from smoother.disc import contents, kept, pieces, release, roomy
from smoother.errors import SessionError
from smoother.samples import GnssFixes, Problem, RawImu, RawMag
from smoother.session import log_format as form
from smoother.session.log_decode import Blocks, Losses, decode, find_blocks
from smoother.session.log_format import LogRecords, Setup
from smoother.session.nmea import fixes_from_sentences
from smoother.session.rows import in_time_order, is_all
from smoother.session.text import unreadable
from smoother.units import DEG, MICROSECOND, STANDARD_GRAVITY
from smoother.words import counted, span

_NOUNS = {
    form.IMU: "IMU sample",
    form.MAG: "compass reading",
    form.TEMPERATURE: "temperature",
    form.GPS: "GPS sentence",
}
_REASONS = {
    form.GAP_NO_ROOM: ("log_card_stalled", "lost because the card did not take them in time"),
    form.GAP_SENSOR: ("log_sensor_late", "lost because the sensor was not read in time"),
    form.GAP_SERIAL: ("log_serial_lost", "lost on the line to the GPS"),
}
_EVENTS = {
    "CARD_LOST": "the card was away {} times",
    "CARD_RETRY": "the card refused a block {} times; written again",
    "IMU_LOST": "the motion sensor was away {} times",
    "GPS_SILENT": "the GPS was silent {} times",
    "GPS_NOT_CONFIGURED": "the GPS did not take its settings ({} times)",
    "CONFIG_REJECTED": "CONFIG.TXT has a mistake; recorded with the default settings",
    "MAG_ABSENT": "no magnetometer was found",
    "SUPPLY_LOW": "the supply was low {} times",
    "WATCHDOG": "the logger was restarted by its watchdog {} times",
}
_STOPS = {
    form.STOP_CARD_FULL: "the recording ended because the card was full",
    form.STOP_SUPPLY_LOW: "the recording ended because the supply was low",
    form.STOP_FAULT: "the recording ended because of a fault",
}


def describe(records: LogRecords, losses: Losses, file: str) -> list[Problem]:
    """Return the flaws of a recording, but for those of its values."""
    said = [*_of_losses(losses), *_of_gaps(records), *_of_events(records), *_of_end(records)]
    if records.setup is None:
        said.append(("log_setup_missing", "no record of the sensor's settings; taken as 16 g and 1000 deg/s", 1))
    return [Problem(code, f"{file}: {text}", count) for code, text, count in said]


def _of_losses(losses: Losses) -> Iterator[tuple[str, str, int]]:
    if losses.blocks > 0:
        samples = counted(losses.samples, "IMU sample")
        yield (
            "log_blocks_lost",
            f"{counted(losses.blocks, 'block')} damaged or missing, {samples} in them",
            losses.blocks,
        )
    if losses.unreadable > 0:
        text = f"{counted(losses.unreadable, 'block')} with records of a newer version; the rest of them left out"
        yield "log_newer_version", text, losses.unreadable


def _of_gaps(records: LogRecords) -> Iterator[tuple[str, str, int]]:
    kinds = sorted({(gap.source, gap.reason) for gap in records.gaps})
    for source, reason in kinds:
        gaps = [gap for gap in records.gaps if (gap.source, gap.reason) == (source, reason)]
        count = sum(gap.count for gap in gaps)
        longest = max(gap.last_us - gap.first_us for gap in gaps) * MICROSECOND
        code, text = _REASONS.get(reason, ("log_lost", "lost"))
        noun = counted(count, _NOUNS.get(source, "other record"))
        yield code, f"{noun} {text} ({counted(len(gaps), 'gap')}, the longest {span(longest)})", count


def _of_events(records: LogRecords) -> Iterator[tuple[str, str, int]]:
    counts = Counter(form.EVENTS.get(event.code, "") for event in records.events)
    for name, text in _EVENTS.items():
        if counts[name]:
            yield f"log_{name.lower()}", text.format(counts[name]), counts[name]


def _of_end(records: LogRecords) -> Iterator[tuple[str, str, int]]:
    if records.stop is None:
        text = "the recording was not stopped (switched off or cut short); its last moment may be missing"
        yield "log_not_stopped", text, 1
    elif records.stop.reason in _STOPS:
        yield "log_stopped", _STOPS[records.stop.reason], 1


HEAD_BYTES = 262_144  # of a file, to know whose it is: more than the 5 s between SETUP records
CLUSTER_BLOCKS = 128  # of the largest cluster that FAT32 has, 64 KiB
MAG_SCALE = 0.15  # uT per count of the AK8963 in 16-bit mode
TEMPERATURE_OFFSET, TEMPERATURE_SCALE = 21.0, 333.87  # deg C, counts per deg C (MPU-9250 register map, TEMP_OUT)
COUNTS = 32768.0
TICKS_PER_SECOND = 1e6


@dataclass(frozen=True)
class LogFiles:
    """The files of one recording, in the order of their blocks. `name` is that of the first, without extension."""

    session: int
    paths: tuple[Path, ...]
    setup: Setup | None = None

    @property
    def name(self) -> str:
        """Name for people and for the folder of the results."""
        return self.paths[0].stem

    @property
    def is_calibration(self) -> bool:
        """Whether the box was turned in all directions, to calibrate the magnetometer."""
        return self.setup is not None and self.setup.purpose == form.PURPOSE_MAG_CALIBRATION


@dataclass(frozen=True, eq=False)
class LogRecording:
    """What a recording holds, on the logger's clock in seconds since power-on.

    imu_delay, s, is that of the low-pass, which is taken off.
    """

    imu: RawImu | None
    mag: RawMag | None
    gnss: GnssFixes
    problems: list[Problem]
    imu_delay: float


def list_recordings(paths: Iterable[Path]) -> list[LogFiles]:
    """Return the recordings in these files, in order of their names; only the heads of the files are read.

    Raises SessionError if a file cannot be read, or if none of them holds a whole block.
    """
    paths = sorted(paths, key=lambda path: (path.name.lower(), path.name))
    heads = [(path, _head(path)) for path in paths]
    found: dict[int, list[tuple[int, Path, Setup | None]]] = {}
    for path, blocks in heads:
        if len(blocks):
            setup = decode(blocks)[0].setup
            found.setdefault(int(blocks.head["session"][0]), []).append((int(blocks.head["sequence"][0]), path, setup))
    if not found:
        names = ", ".join(path.name for path in paths)
        raise SessionError(f"{names}: no whole block of a recording; is it the logger's file?")
    return [_files(session, parts) for session, parts in found.items()]


def _files(session: int, parts: list[tuple[int, Path, Setup | None]]) -> LogFiles:
    parts = sorted(parts, key=lambda part: part[0])
    setups = [setup for _, _, setup in parts if setup is not None]
    return LogFiles(session, tuple(path for _, path, _ in parts), setups[0] if setups else None)


def _head(path: Path) -> Blocks:
    """The blocks of its recording at the head of a file; where the head is damaged, all of them."""
    blocks, _ = find_blocks(_first_bytes(path))
    if len(blocks) == 0:
        blocks, _ = find_blocks(_all_bytes(path))
    return _own(blocks)


def _own(blocks: Blocks) -> Blocks:
    """The blocks of the recording that a file belongs to: that of its first block. What follows its end is older.

    Where these are few and do not begin it, the first cluster was lost and holds what an older file left there.
    """
    if len(blocks) == 0:
        return blocks
    sessions, counts = np.unique(blocks.head["session"], return_counts=True)
    first = blocks.head["session"][0]
    is_left_over = blocks.head["sequence"][0] > 0 and counts[sessions == first][0] <= CLUSTER_BLOCKS
    return _of_session(blocks, int(sessions[np.argmax(counts)] if is_left_over else first))


def _of_session(blocks: Blocks, session: int) -> Blocks:
    own = blocks.head["session"] == session
    return blocks if np.all(own) else blocks.select(own)


def _first_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError as error:
        raise unreadable(path, error) from error


def _all_bytes(path: Path) -> bytes | mmap:
    try:
        return contents(path)
    except OSError as error:
        raise unreadable(path, error) from error


def read_records(files: LogFiles) -> tuple[LogRecords, Losses]:
    """Return the records of a recording and what it lacks. Raises SessionError if a file cannot be read."""
    found = [find_blocks(_all_bytes(path)) for path in files.paths]
    parts = [_of_session(blocks, files.session) for blocks, _ in found]
    all_blocks = parts[0] if len(parts) == 1 else Blocks.of(np.concatenate([p.content for p in parts if len(p)]))
    return decode(all_blocks)


def read_log(files: LogFiles) -> LogRecording:
    """Read a recording. Raises SessionError if a file cannot be read or holds no usable sentence of the GPS."""
    records, losses = read_records(files)
    name = files.paths[0].name
    imu, problems = imu_samples(records, name)
    reading = fixes_from_sentences(((t / TICKS_PER_SECOND, text) for t, text in records.sentences), name)
    mag, mag_problems = mag_samples(records, name)
    problems = [*describe(records, losses, name), *problems, *mag_problems, *reading.problems]
    delay = (records.setup or Setup()).gyro_delay_us / TICKS_PER_SECOND
    return LogRecording(imu, mag, reading.gnss, problems, delay)


def seconds(t_us: IntArray, earlier_us: int = 0) -> Array:
    """Return times (N,) s, `earlier_us` before t_us (N,) us, each the float64 nearest to its decimal."""
    out = roomy(t_us.shape)
    for part in pieces(len(t_us)):
        out[part] = (t_us[part] - earlier_us) / TICKS_PER_SECOND
        release(out, t_us)
    return out


def imu_samples(records: LogRecords, file: str) -> tuple[RawImu | None, list[Problem]]:
    """Return the inertial samples, None without any, and what was flawed about their times.

    The low-pass makes a sample late by its delay (that of the gyro is taken, to which a kart's attitude is more
    sensitive); a RawImu's sample is as late as half its period. The times are shifted by the difference.
    """
    if records.imu_t.size == 0:
        return None, []
    setup = records.setup or Setup()
    shift_us = setup.gyro_delay_us - setup.imu_period_us // 2
    ordered = in_time_order(seconds(records.imu_t, shift_us), records.imu, file=file, prefix="imu")
    t, index = ordered.t, ordered.index
    counts = records.imu if is_all(index, len(records.imu)) else records.imu[index]
    accel_full_scale, gyro_full_scale = setup.accel_range_g * STANDARD_GRAVITY, setup.gyro_range_dps * DEG
    imu = RawImu(
        kept(t),
        _as_numbers(counts[:, :3]),
        _as_numbers(counts[:, 3:]),
        accel_full_scale / COUNTS,
        gyro_full_scale / COUNTS,
        accel_full_scale,
        gyro_full_scale,
        _temperature(records, t),
    )
    return imu, ordered.problems


def _as_numbers(counts: npt.NDArray[np.int16]) -> Array:
    """Counts (N, 3) as a read-only float64 array, not all of it in memory where it is large."""
    out = roomy(counts.shape)
    for part in pieces(len(counts)):
        out[part] = counts[part]
        release(out, counts)
    out.flags.writeable = False
    return out


def _temperature(records: LogRecords, t: Array) -> Array | None:
    """Temperature (N,) deg C at t (N,) s; None if it was never recorded."""
    if records.temperature_t.size == 0:
        return None
    order = np.argsort(records.temperature_t, kind="stable")
    at = seconds(records.temperature_t[order])
    celsius, out = TEMPERATURE_OFFSET + records.temperature[order] / TEMPERATURE_SCALE, roomy(t.shape)
    for part in pieces(len(t)):
        out[part] = np.interp(t[part], at, celsius)
        release(out, t)
    out.flags.writeable = False
    return out


def mag_samples(records: LogRecords, file: str) -> tuple[RawMag | None, list[Problem]]:
    """Return the magnetic field in uT and axes s, without readings that overflowed; None without any."""
    whole = np.flatnonzero((records.mag_flags & form.MAG_OVERFLOW) == 0)
    field, lost = records.mag[whole], records.mag_t.size - whole.size
    ordered = in_time_order(seconds(records.mag_t)[whole], field, file=file, prefix="mag")
    text = f"{file}: {counted(lost, 'row')} of the magnetometer beyond its range; dropped"
    problems = [*([Problem("mag_overflow", text, lost)] if lost else []), *ordered.problems]
    if ordered.index.size == 0:
        return None, problems
    return RawMag(ordered.t, magnetic_field(field[ordered.index], records.setup or Setup())), problems


def magnetic_field(counts: np.ndarray, setup: Setup) -> Array:
    """Field (K, 3) uT in axes s from counts (K, 3) in the magnetometer's axes: adjusted, and turned to the IMU's."""
    adjusted = counts * (np.frombuffer(setup.mag_adjustment, dtype=np.uint8) + 128.0) / 256.0
    return np.asarray(MAG_SCALE * adjusted[:, [1, 0, 2]] * [1.0, 1.0, -1.0])


def read_mag_calibration(recording: LogFiles, others: Sequence[LogFiles]) -> tuple[Array | None, Path | None]:
    """Return the field (K, 3) uT, axes s, of the calibration that holds for a recording, and its file.

    It is the last one before the recording by the number of the boot, else the first after it.
    """

    def boot(files: LogFiles) -> int:
        return 0 if files.setup is None else files.setup.boot_number

    calibrations = sorted((files for files in others if files.is_calibration), key=boot)
    before = [files for files in calibrations if boot(files) <= boot(recording)]
    for files in [*before[::-1], *(files for files in calibrations if files not in before)]:
        mag, _ = mag_samples(read_records(files)[0], files.paths[0].name)
        if mag is not None:
            return mag.field, files.paths[0]
    return None, None
