"""NMEA sentences to fixes. The only user of pynmea2; everything a receiver or a card can do to the text is met here.

Sentences of one UTC make one fix, whatever their order and talker. The height is the one of the sentence, above mean
sea level.
"""

import datetime
import math
import re
from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pynmea2

from smoother.arrays import Array, BoolArray, IntArray
from smoother.errors import SessionError
from smoother.samples import GnssFixes, Problem
from smoother.session.fix_columns import FixColumns
from smoother.session.fixes import screen_fixes
from smoother.session.rows import over_midnight
from smoother.session.text import in_utf8, whole
from smoother.session.time_unit import in_seconds, unit_by_utc
from smoother.session.velned import Velocities
from smoother.units import DAY, KMH, KNOT
from smoother.words import counted

# [t_s,]$<talker><kind>,<data>[*<checksum>]; a garbled byte ends the match and so leaves the checksum out
ESTIMATED = 6  # quality of a position by dead reckoning, without satellites
_SENTENCE = re.compile(
    rb"(?:(?:^|(?<=[\r\n]))[ \t]*([-+]?\d[-+0-9.eE]*)[ \t]*,[ \t]*)?\$"
    rb"(([A-Z]{2})(RMC|GGA|GNS|GST|VTG|ZDA),([\x20-\x23\x25-\x29\x2b-\x7e]*))(\*[0-9A-Fa-f]{2})?"
)
_TIME_OF_DAY = re.compile(r"^(\d\d)(\d\d)(\d\d(?:\.\d*)?)$")
_COORDINATE = re.compile(r"^\d{3,5}(?:\.\d*)?$")
_PRECEDENCE = ("VTG", "RMC", "GNS", "GGA", "GST", "ZDA")  # later ones overrule: VTG only fills what RMC leaves out
_TALKERS = ("GN", "GP")  # preferred in this order where several constellations report the same kind
_TALKER_CODES = 65536  # two letters
_FIRST_YEAR = 80  # of GPS time, and of the century
_TIME_QUANTUM = 1e-3  # s; UTC equal to a millisecond is one epoch


@dataclass(frozen=True, eq=False)
class _Sentences:
    """N good sentences in the order of the file, as columns, because a day of them has more than a million.

    kind (N,) is an index into _PRECEDENCE, talker (N,) two letters as a number; received, time_of_day (N,) s are
    receive time and UTC, NaN where unknown. values holds by kind the values _COLUMNS_OF[kind] of its sentences (M, ..).
    """

    kind: npt.NDArray[np.int8]
    talker: npt.NDArray[np.int16]
    received: Array
    time_of_day: Array
    values: dict[str, Array]

    def take(self, keep: BoolArray) -> "_Sentences":
        """Return the sentences of a mask (N,)."""
        values = {kind: of_kind[keep[self.is_of(kind)]] for kind, of_kind in self.values.items()}
        return _Sentences(self.kind[keep], self.talker[keep], self.received[keep], self.time_of_day[keep], values)

    def is_of(self, kind: str) -> BoolArray:
        """Mask (N,) of the sentences of one kind."""
        return np.asarray(self.kind == _PRECEDENCE.index(kind))

    @property
    def stream(self) -> IntArray:
        """Kind and talker (N,) of each as one number."""
        return self.kind.astype(np.int64) * _TALKER_CODES + self.talker

    def column(self, name: str) -> Array:
        """The value (N,) of that name in each sentence, NaN in those of kinds without it."""
        values = np.full(self.kind.size, np.nan)
        for kind in _PRECEDENCE:
            if name in _COLUMNS_OF[kind]:
                values[self.is_of(kind)] = self.values[kind][:, _COLUMNS_OF[kind].index(name)]
        return values


@dataclass
class _Tally:
    """What was wrong with the sentences of one file."""

    checksum: int = 0
    unreadable: int = 0
    duplicate: int = 0
    misplaced: int = 0

    def problems(self, file: str) -> list[Problem]:
        said = (
            ("gps_bad_checksum", self.checksum, "{} with a wrong checksum; dropped"),
            ("gps_bad_sentence", self.unreadable, "{} cut short or unreadable; dropped"),
            ("gps_duplicate_sentence", self.duplicate, "{} of the time of another; dropped"),
            ("gps_misplaced_sentence", self.misplaced, "{} out of order; placed by their UTC"),
        )
        return [
            Problem(code, f"{file}: {text.format(counted(count, 'NMEA sentence'))}", count)
            for code, count, text in said
            if count
        ]


@dataclass(frozen=True, eq=False)
class NmeaReading:
    """Fixes of a file, what was flawed, and whether `t` is a receive time on the IMU clock or counts from the start."""

    gnss: GnssFixes
    problems: list[Problem] = field(default_factory=list)
    has_receive_times: bool = False


def read_nmea(path: Path) -> NmeaReading:
    """Read a file of sentences, each line optionally prefixed `t_s,`. Raises SessionError if it holds none."""
    data = whole(path)
    if not data.strip():
        raise SessionError(f"{path.name}: the file is empty; expected NMEA sentences")
    return fixes_from_sentences([(math.nan, in_utf8(data))], path.name)


def fixes_from_sentences(received: Iterable[tuple[float, bytes]], file: str) -> NmeaReading:
    """Merge sentences into fixes.

    received : (receive time in s or NaN, bytes with any number of sentences, or one NAV-VELNED); a `t_s,` prefix
    overrules the time. Without receive times t counts from the first sentence with a time. Raises SessionError if no
    sentence is usable.
    """
    tally, velocities = _Tally(), Velocities()
    sentences = _parse_all(velocities.extracted_from(received), tally)
    timed = np.isfinite(sentences.time_of_day)
    if not np.any(timed):
        flaws = "; ".join(problem.text for problem in tally.problems(file))
        raise SessionError(f"{file}: no NMEA sentence with a time (RMC, GGA, GNS){f'; {flaws}' if flaws else ''}")
    utc = over_midnight(sentences.time_of_day[timed])
    unit = unit_by_utc(sentences.received[timed], utc)
    received_s, said = in_seconds(sentences.received, unit, "gps", file)
    sentences = replace(sentences, received=received_s)
    columns, has_receive_times = _merge(sentences, timed, utc, tally, velocities)
    gnss, problems = screen_fixes(columns, file)
    return NmeaReading(gnss, [*said, *tally.problems(file), *problems], has_receive_times)


def _parse_all(received: Iterable[tuple[float, bytes]], tally: _Tally) -> _Sentences:
    kinds, talkers, checked = array("b"), array("h"), array("b")
    received_at, times_of_day = array("d"), array("d")
    values = {kind: array("d") for kind in _PRECEDENCE}
    any_checked = False
    for time, data in received:
        for match in _SENTENCE.finditer(data):
            any_checked = any_checked or match[6] is not None
            parsed = _parse(match, tally)
            if parsed is None:
                continue
            kind = match[4].decode()
            kinds.append(_PRECEDENCE.index(kind))
            talkers.append(int.from_bytes(match[3], "big"))
            checked.append(match[6] is not None)
            received_at.append(time if match[1] is None else _number(match[1].decode()))
            times_of_day.append(parsed[0])
            values[kind].extend(parsed[1])
    sentences = _Sentences(
        np.frombuffer(kinds, dtype=np.int8),
        np.frombuffer(talkers, dtype=np.int16),
        np.frombuffer(received_at),
        np.frombuffer(times_of_day),
        {kind: np.frombuffer(values[kind]).reshape(-1, len(_COLUMNS_OF[kind])) for kind in _PRECEDENCE},
    )
    is_checked = np.frombuffer(checked, dtype=np.bool_)
    if not any_checked or np.all(is_checked):
        return sentences
    tally.unreadable += int(np.count_nonzero(~is_checked))  # cut short: in this file a whole sentence has a checksum
    return sentences.take(is_checked)


def _parse(match: re.Match[bytes], tally: _Tally) -> tuple[float, tuple[float, ...]] | None:
    """UTC of day and values of a sentence, None if it is no good."""
    try:
        message = pynmea2.parse((match[2] + (match[6] or b"")).decode("ascii"))
    except pynmea2.ChecksumError:
        tally.checksum += 1
        return None
    except (pynmea2.ParseError, ValueError):
        tally.unreadable += 1
        return None
    kind = match[4].decode()
    text = message.data[0] if kind != "VTG" else ""
    time_of_day = _time_of_day(text)
    if text and not math.isfinite(time_of_day):
        tally.unreadable += 1
        return None
    return time_of_day, _VALUES[kind](message)


def _number(text: object) -> float:
    try:
        value = float(str(text))
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def _time_of_day(text: str) -> float:
    match = _TIME_OF_DAY.match(text)
    if match is None:
        return math.nan
    hours, minutes, seconds = int(match[1]), int(match[2]), float(match[3])
    return hours * 3600.0 + minutes * 60.0 + seconds if hours < 24 and minutes < 60 and seconds < 61.0 else math.nan


def _year(two_digits: int) -> int:
    """The year that a date with two digits of it means: GPS time began in 1980, and old firmware falls back to 1999."""
    return two_digits + (1900 if two_digits >= _FIRST_YEAR else 2000)


def _day(year: int, month: int, day: int) -> float:
    """Days since 1970, NaN for a date that does not exist."""
    try:
        return float((datetime.date(year, month, day) - datetime.date(1970, 1, 1)).days)
    except ValueError:
        return math.nan


def _position(message: Any) -> tuple[float, float]:
    """Latitude and longitude in degrees; NaN where a part is missing, for which pynmea2 would say 0."""
    are_numbers = _COORDINATE.match(message.lat) and _COORDINATE.match(message.lon)
    if not are_numbers or message.lat_dir not in ("N", "S") or message.lon_dir not in ("E", "W"):
        return math.nan, math.nan
    try:
        return message.latitude, message.longitude
    except ValueError:
        return math.nan, math.nan


def _quality(mode: str) -> float:
    """Fix quality by the mode of one satellite system; dead reckoning counts as no fix."""
    return 0.0 if mode in ("N", "E") else 1.0


def _rmc(message: Any) -> tuple[float, ...]:
    date = str(message.data[8]) if len(message.data) > 8 else ""
    known = len(date) == 6 and date.isdigit()
    mode = message.data[11] if len(message.data) > 11 else ""
    return (
        *_position(message),
        _quality(mode) if message.status == "A" else 0.0,
        _number(message.spd_over_grnd) * KNOT,
        _number(message.true_course),
        _day(_year(int(date[4:])), int(date[2:4]), int(date[:2])) if known else math.nan,
    )


def _gga(message: Any) -> tuple[float, ...]:
    return (
        *_position(message),
        0.0 if message.gps_qual == ESTIMATED else _number(message.gps_qual),
        _number(message.num_sats),
        _number(message.horizontal_dil),
        _number(message.altitude),
    )


def _gns(message: Any) -> tuple[float, ...]:
    mode = message.mode_indicator
    return (
        *_position(message),
        max(map(_quality, mode), default=1.0),
        _number(message.num_sats),
        _number(message.hdop),
        _number(message.altitude),
    )


def _gst(message: Any) -> tuple[float, ...]:
    north, east = _number(message.std_dev_latitude), _number(message.std_dev_longitude)
    return math.sqrt(0.5 * (north**2 + east**2)), _number(message.std_dev_altitude)


def _vtg(message: Any) -> tuple[float, ...]:
    knots, kmh = _number(message.spd_over_grnd_kts), _number(message.spd_over_grnd_kmph)
    return kmh * KMH if math.isnan(knots) else knots * KNOT, _number(message.true_track)


def _zda(message: Any) -> tuple[float, ...]:
    year, month, day = (_number(text) for text in (message.year, message.month, message.day))
    known = all(math.isfinite(value) for value in (year, month, day)) and 1.0 <= year <= 9999.0
    return (_day(int(year), int(month), int(day)) if known else math.nan,)


_VALUES = {"RMC": _rmc, "GGA": _gga, "GNS": _gns, "GST": _gst, "VTG": _vtg, "ZDA": _zda}
_COLUMNS_OF = {
    "RMC": ("lat_deg", "lon_deg", "fix", "speed", "course_deg", "day"),
    "GGA": ("lat_deg", "lon_deg", "fix", "num_sv", "hdop", "alt_m"),
    "GNS": ("lat_deg", "lon_deg", "fix", "num_sv", "hdop", "alt_m"),
    "GST": ("sigma_horizontal", "sigma_up"),
    "VTG": ("speed", "course_deg"),
    "ZDA": ("day",),
}


def _merge(
    sentences: _Sentences, timed: BoolArray, utc: Array, tally: _Tally, velocities: Velocities
) -> tuple[FixColumns, bool]:
    """One row per UTC. utc belongs to the sentences that have a time; VTG, which has none, to the one before it."""
    owner = _owners(sentences, timed)
    ticks = np.round(utc / _TIME_QUANTUM).astype(np.int64)
    epochs, row_of_timed = np.unique(ticks, return_inverse=True)
    row = row_of_timed[owner]
    newest = np.maximum.accumulate(row_of_timed)
    tally.misplaced += int(np.count_nonzero((row_of_timed < newest) & (np.diff(row_of_timed, prepend=-1) != 0)))
    values = _fill(sentences, row, epochs.size, tally)
    received = np.full(epochs.size, np.inf)
    np.fmin.at(received, row_of_timed, sentences.received[timed])
    seconds = np.asarray(epochs * _TIME_QUANTUM, dtype=np.float64)
    is_other_day = (ticks[0] - epochs[0]) * _TIME_QUANTUM > 0.5 * DAY  # damaged times of day are nearer
    since_first = np.asarray((epochs - (epochs[0] if is_other_day else ticks[0])) * _TIME_QUANTUM, dtype=np.float64)
    t, has_receive_times = _row_times(received, since_first)
    unix = seconds + _midnight(values["day"], seconds)
    columns = {name: values[name] for name in _COLUMNS if name != "day"}
    return FixColumns(t=t, **columns, **velocities.columns_at(t), unix_s=unix), has_receive_times


_COLUMNS = (
    *("lat_deg", "lon_deg", "alt_m", "speed", "course_deg", "sigma_horizontal", "sigma_up"),
    *("hdop", "num_sv", "fix", "day"),
)


def _fill(sentences: _Sentences, row: IntArray, rows: int, tally: _Tally) -> dict[str, Array]:
    """Columns (rows,): of each kind the first sentence of an epoch counts, kinds overrule in _PRECEDENCE."""
    columns = {name: np.full(rows, np.nan) for name in _COLUMNS}
    for kind in _PRECEDENCE:
        of_kind = sentences.is_of(kind)
        place, talker = row[of_kind], sentences.talker[of_kind]
        tally.duplicate += place.size - np.unique(place + rows * talker.astype(np.int64)).size
        order = np.argsort(_rank(talker), kind="stable")
        at, first = np.unique(place[order], return_index=True)
        counts = sentences.values[kind][order[first]]
        for name, column in zip(_COLUMNS_OF[kind], counts.T, strict=True):
            use = np.isfinite(column)
            if name == "fix":
                use &= ~((columns[name][at] == 0.0) & (column > 0.0))  # where one denies a fix, the denial stays
            columns[name][at[use]] = column[use]
    return columns


def _rank(talker: npt.NDArray[np.int16]) -> IntArray:
    """Preference (N,), least first, of the talkers (N,)."""
    rank = np.full(talker.size, len(_TALKERS), dtype=np.int64)
    for i, name in enumerate(_TALKERS):
        rank[talker == int.from_bytes(name.encode(), "big")] = i
    return rank


def _owners(sentences: _Sentences, timed: BoolArray) -> IntArray:
    """For each sentence the number of the timed one it belongs to: itself, else the one before it.

    Without RMC, u-blox receivers start the burst with VTG: a file that starts so attaches VTG to the one after it.
    """
    before = np.cumsum(timed) - 1
    leads = bool(sentences.is_of("VTG")[0]) and not np.any(sentences.is_of("RMC"))
    return np.clip(np.where(timed, before, before + leads), 0, np.count_nonzero(timed) - 1)


def _row_times(received: Array, since_first: Array) -> tuple[Array, bool]:
    """Times (N,) s: receive times where most have one, the others placed by UTC; else since the first sentence."""
    known = np.isfinite(received)
    if np.count_nonzero(known) * 2 <= received.size:
        return since_first, False
    return np.where(known, received, since_first + np.median(received[known] - since_first[known])), True


def _midnight(day: Array, utc: Array) -> float:
    """Unix time of the midnight that `utc` (N,) counts from, by the vote of all dates (N,) days; NaN without dates."""
    known = np.isfinite(day)
    return float(np.median(day[known] - np.floor(utc[known] / DAY))) * DAY if np.any(known) else math.nan
