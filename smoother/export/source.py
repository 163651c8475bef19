"""A smoothed session as the writers see it: who and where, the laps, and the rows as blocks that can be had again.

Reads the files of `smoothed/` (trajectory.csv, laps.csv, summary.json) and nothing of the recording.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.export.rows import NUMBERS, REQUIRED, Rows, header_of, logged_columns, read_rows, resampled, with_motion
from smoother.frames import Origin
from smoother.utc_clock import UtcClock

TRAJECTORY, LAPS, SUMMARY = "trajectory.csv", "laps.csv", "summary.json"


@dataclass(frozen=True)
class LapRow:
    """One row of laps.csv: times in s on the session clock, NaN where unknown."""

    number: int
    start: float
    end: float
    time: float
    sigma: float
    is_valid: bool
    reason: str
    sectors: tuple[float, ...] = ()

    @property
    def is_timed(self) -> bool:
        """Whether both ends are crossings of the line."""
        return self.time == self.time


@dataclass(frozen=True, eq=False)
class BestLap:
    """The fastest lap that counts: elapsed (K,) s at track distance (K,) m, increasing."""

    lap: LapRow
    distance: Array
    elapsed: Array


@dataclass(frozen=True, eq=False)
class Survey:
    """Result of one pass over trajectory.csv: rows, first and last time s, rate Hz, complete and logged columns."""

    count: int
    start: float
    end: float
    rate: float
    complete: frozenset[str]
    logged: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Source:
    """A smoothed session in `directory`, to be written at `rate` Hz; None: as it is stored.

    name and the texts about it are data from files. known_clock: of the time of day, None where the receiver never sent
    it (`has_utc`): times then count from the start of 1970.
    """

    directory: Path
    name: str
    about: dict[str, str]
    origin: Origin
    survey: Survey
    known_clock: UtcClock | None = None
    laps: tuple[LapRow, ...] = ()
    rate: float | None = None

    @property
    def file_name(self) -> str:
        """The name as a file may have it, without an ending."""
        return self.name.translate(dict.fromkeys(map(ord, '/\\:*?"<>|'), "_"))

    @property
    def has_utc(self) -> bool:
        """Whether the time of day is known."""
        return self.known_clock is not None

    @property
    def clock(self) -> UtcClock:
        """Of the time of day; counts from the first row on where that is unknown."""
        return self.known_clock or UtcClock(self.start, 0.0)

    @property
    def row_rate(self) -> float:
        """Rows a second, Hz."""
        return self.survey.rate if self.rate is None else self.rate

    @property
    def start(self) -> float:
        """Time of the first row, s."""
        return self.survey.start

    @property
    def count(self) -> int:
        """How many rows there are."""
        if not self._is_resampled:
            return self.survey.count
        return int(np.floor((self.survey.end - self.survey.start) * self.row_rate + 1e-6)) + 1

    @property
    def _is_resampled(self) -> bool:
        # share; stored times are rounded to a microsecond
        return self.rate is not None and abs(self.rate - self.survey.rate) > 1e-4 * self.survey.rate

    @property
    def crossings(self) -> list[float]:
        """Times s at which the start/finish line was crossed, in order."""
        ends = {round(t, 6) for lap in self.laps if lap.is_timed for t in (lap.start, lap.end)}
        return sorted(t for t in ends if self.survey.start <= t <= self.survey.end)

    @cached_property
    def best(self) -> BestLap | None:
        """The fastest lap that counts, None without one or without track distance."""
        counted = [lap for lap in self.laps if lap.is_valid and lap.is_timed]
        return _best_lap(self.directory / TRAJECTORY, min(counted, key=lambda lap: lap.time)) if counted else None

    def has(self, *names: str) -> bool:
        """Whether every row has a number in each of these columns: formats without blanks leave out the others."""
        return all(name in self.survey.complete for name in names)

    def text(self, key: str, otherwise: str = "") -> str:
        """Title, driver, kart, track or notes as one printable line."""
        return one_line(self.about.get(key, "")) or otherwise

    def rows(self) -> Iterator[Rows]:
        """Yield all rows: the columns of trajectory.csv, and

        course_deg (0..360), distance_m driven, elapsed_s since the first row, unix_s; lap (number, NaN outside timed
        laps), lap_time_s since its start, delta_s against the best lap at the same track distance (positive: slower).
        Accelerations and yaw rate are those of the path where there was no inertial sensor.
        """
        blocks = read_rows(self.directory / TRAJECTORY)
        if self._is_resampled:
            blocks = resampled(blocks, self.row_rate, self.origin)
        for block in with_motion(blocks):
            yield self._with_laps(block)

    def _with_laps(self, rows: Rows) -> Rows:
        t = rows["t_s"]
        number, since = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
        delta = np.full(len(rows), np.nan)
        for lap in self.laps:
            inside = (t >= lap.start) & (t < lap.end)
            if lap.is_timed and inside.any():
                number[inside] = lap.number
                since[inside] = t[inside] - lap.start
        if self.best is not None:
            reached = np.interp(rows["lap_distance_m"], self.best.distance, self.best.elapsed)
            delta = since - reached
        return rows.with_columns(
            elapsed_s=t - self.start, unix_s=self.clock.at(t), lap=number, lap_time_s=since, delta_s=delta
        )


def open_source(directory: Path, rate: float | None = None) -> Source:
    """Open the results in `directory`. Raises SessionError, one line, where they are missing or damaged."""
    path = directory / TRAJECTORY
    survey = _survey(path)
    # eight hours at 1000 Hz; beyond, the times of the file are damaged
    if rate is not None and (survey.end - survey.start) * rate > 30_000_000:
        raise SessionError(f"{path}: {(survey.end - survey.start) * rate:.0f} rows at {rate:g} Hz; ask for fewer")
    about, origin, clock = _about(directory / SUMMARY)
    name = one_line(about.get("name", "")) or one_line(directory.resolve().parent.name) or "session"
    return Source(directory, name, about, origin, survey, clock, read_laps(directory / LAPS), rate)


def one_line(text: str) -> str:
    """Return text as one line without control characters: file formats take them for structure."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _about(path: Path) -> tuple[dict[str, str], Origin, UtcClock | None]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        about, place = document["session"], document["origin"]
        origin = Origin(float(place["lat_deg"]), float(place["lon_deg"]), float(place["alt_m"]))
        clock = UtcClock.of_summary(about)
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, KeyError, TypeError) as error:
        raise SessionError(f"{path}: damaged; smooth the session again") from error
    return {key: value for key, value in about.items() if isinstance(value, str)}, origin, clock


def _survey(path: Path) -> Survey:
    """Pass over trajectory.csv once, holding one block."""
    names = header_of(path)
    count, start, end, rate = 0, np.nan, np.nan, np.nan
    whole = {name for name in NUMBERS if name in names}
    for rows in read_rows(path):
        t = rows["t_s"]
        if not np.all(np.isfinite(t)) or np.any(np.diff(t) <= 0.0) or (count and t[0] <= end):
            raise SessionError(f"{path}: its times do not increase; smooth the session again")
        if count == 0:
            start, rate = float(t[0]), _rate(t)
        whole = {name for name in whole if np.all(np.isfinite(rows[name]))}
        count, end = count + len(rows), float(t[-1])
    if count == 0:
        raise SessionError(f"{path}: no rows; smooth the session again")
    if missing := [name for name in REQUIRED if name not in whole]:
        raise SessionError(f"{path}: {missing[0]} is not a number in every row; smooth the session again")
    return Survey(count, start, end, rate, frozenset(whole), tuple(logged_columns(names)))


def _rate(t: Array) -> float:
    return 1.0 / float(np.median(np.diff(t))) if t.size > 1 else 1.0


def read_laps(path: Path) -> tuple[LapRow, ...]:
    """Read laps.csv; no laps where there is no such file, or nothing in it."""
    if not path.is_file():
        return ()
    try:
        frame = pl.read_csv(path.read_bytes(), infer_schema=False, truncate_ragged_lines=True)
    except pl.exceptions.NoDataError:
        return ()
    except pl.exceptions.PolarsError as error:
        raise SessionError(f"{path}: damaged ({str(error).splitlines()[0]}); smooth the session again") from error
    names = [f"sector{i}_s" for i in range(1, 1 + sum(name.startswith("sector") for name in frame.columns))]
    laps = [_lap(row, [name for name in names if name in frame.columns]) for row in frame.iter_rows(named=True)]
    return tuple(sorted((lap for lap in laps if lap is not None), key=lambda lap: lap.start))


def _lap(row: dict[str, str | None], sectors: list[str]) -> LapRow | None:
    def number(name: str) -> float:
        try:
            return float(row.get(name) or "nan")
        except ValueError:
            return np.nan

    start, end, label = number("start_s"), number("end_s"), number("lap")
    if not (start < end and label >= 0.0):
        return None
    is_valid = (row.get("valid") or "").strip().lower() == "true"
    times = tuple(number(name) for name in sectors)
    sigma = number("lap_time_sigma_s")
    return LapRow(int(label), start, end, number("lap_time_s"), sigma, is_valid, row.get("reason") or "", times)


def _best_lap(path: Path, lap: LapRow) -> BestLap | None:
    """Track distance over time of one lap; None where trajectory.csv does not hold it."""
    if "lap_distance_m" not in header_of(path):
        return None
    t_parts, distance_parts = [], []
    for rows in read_rows(path):
        inside = (rows["t_s"] >= lap.start) & (rows["t_s"] < lap.end) & np.isfinite(rows["lap_distance_m"])
        t_parts.append(rows["t_s"][inside])
        distance_parts.append(rows["lap_distance_m"][inside])
        if rows["t_s"][-1] > lap.end:
            break
    t, distance = np.concatenate(t_parts), np.concatenate(distance_parts)
    if t.size < 2:
        return None
    first = int(np.argmin(distance))  # a row just behind the line may still have the length of the track
    onward = np.flatnonzero(distance[first:] > _highest_before(distance[first:])) + first
    return _with_ends(lap, distance[onward], t[onward] - lap.start)


def _highest_before(distance: Array) -> Array:
    return np.concatenate([[-np.inf], np.maximum.accumulate(distance)[:-1]])


def _with_ends(lap: LapRow, distance: Array, elapsed: Array) -> BestLap | None:
    """The lap from line to line: the crossings lie between rows, where the speed is that of the nearest two."""
    if distance.size < 2:
        return None
    slow, fast = (np.diff(distance[ends]) / np.diff(elapsed[ends]) for ends in (slice(0, 2), slice(-2, None)))
    start, end = distance[:1] - slow * elapsed[:1], distance[-1:] + fast * (lap.time - elapsed[-1:])
    return BestLap(lap, np.concatenate([start, distance, end]), np.concatenate([[0.0], elapsed, [lap.time]]))
