"""What a person should know of the logger's log: what is missing, what the logger itself noted."""

from collections import Counter
from collections.abc import Iterator

from smoother.samples import Problem
from smoother.session.log_decode import Losses
from smoother.session.log_format import (
    EVENTS,
    GAP_NO_ROOM,
    GAP_SENSOR,
    GAP_SERIAL,
    GPS,
    IMU,
    MAG,
    STOP_CARD_FULL,
    STOP_FAULT,
    STOP_SUPPLY_LOW,
    TEMPERATURE,
    LogRecords,
)
from smoother.units import MICROSECOND
from smoother.words import counted, span

_NOUNS = {IMU: "IMU sample", MAG: "compass reading", TEMPERATURE: "temperature", GPS: "GPS sentence"}
_REASONS = {
    GAP_NO_ROOM: ("log_card_stalled", "lost because the card did not take them in time"),
    GAP_SENSOR: ("log_sensor_late", "lost because the sensor was not read in time"),
    GAP_SERIAL: ("log_serial_lost", "lost on the line to the GPS"),
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
    STOP_CARD_FULL: "the recording ended because the card was full",
    STOP_SUPPLY_LOW: "the recording ended because the supply was low",
    STOP_FAULT: "the recording ended because of a fault",
}


def describe(records: LogRecords, losses: Losses, file: str) -> list[Problem]:
    """Return what is flawed about a recording, apart from the values in it."""
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
    counts = Counter(EVENTS.get(event.code, "") for event in records.events)
    for name, text in _EVENTS.items():
        if counts[name]:
            yield f"log_{name.lower()}", text.format(counts[name]), counts[name]


def _of_end(records: LogRecords) -> Iterator[tuple[str, str, int]]:
    if records.stop is None:
        text = "the recording was not stopped (switched off or cut short); its last moment may be missing"
        yield "log_not_stopped", text, 1
    elif records.stop.reason in _STOPS:
        yield "log_stopped", _STOPS[records.stop.reason], 1
