"""The sessions of a batch as an index lists them: who drove what where, and the best laps of each kart and driver.

Lap times are compared on one track only. A track is where sessions were driven: fixes within some kilometres, laps of
one length; two given names distinguish two tracks even there.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from smoother.batch.outcome import Facts, Outcome
from smoother.batch.task import Task, is_there

FAR = 3000.0  # m between first fixes, of paddock and pit too: not the same track
METRES_PER_DEGREE = 111_320.0  # of latitude; enough to distinguish tracks


@dataclass(frozen=True)
class Entry:
    """A session of the index. outcome : None while it waits; is_kept : its results are those of an earlier run."""

    task: Task
    outcome: Outcome | None = None
    is_kept: bool = False
    track: str | None = None

    @property
    def facts(self) -> Facts:
        """What is known of it."""
        return Facts() if self.outcome is None else self.outcome.facts

    @property
    def kart(self) -> str | None:
        """The kart that session.toml names, else the folder above the session's."""
        return self.facts.kart or self.task.kart or None

    @property
    def state(self) -> str:
        """One word."""
        return "waiting" if self.outcome is None else self.outcome.state

    @property
    def counts(self) -> bool:
        """Whether its laps take part in a comparison: only results that passed the quality gate do."""
        return self.outcome is not None and self.outcome.state == "done" and self.facts.best_s is not None


@dataclass(frozen=True)
class Best:
    """The best lap of a kart or a driver on a track, in which session; of how many sessions and laps that count.

    who : None for all those without a name.
    """

    who: str | None
    entry: Entry
    sessions: int
    laps: int

    @property
    def time(self) -> float:
        """Its time, s."""
        return self.entry.facts.best_s or math.nan


@dataclass(frozen=True)
class Track:
    """A track with the best laps on it, fastest first."""

    name: str
    karts: tuple[Best, ...]
    drivers: tuple[Best, ...]
    sessions: int
    length_m: float


def with_tracks(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries with the names of their tracks: as given, else "track 1", "track 2" by their places."""
    places = _places(entries)
    given = {i: {e.facts.track for e, k in zip(entries, places, strict=True) if k == i} - {None} for i in set(places)}
    unnamed = [i for i, _ in Counter(places).most_common() if i is not None and len(given[i]) != 1]

    def name(entry: Entry, place: int | None) -> str | None:
        if entry.facts.track or place is None:
            return entry.facts.track
        return f"track {unnamed.index(place) + 1}" if place in unnamed else next(iter(given[place]))

    named = [name(entry, place) for entry, place in zip(entries, places, strict=True)]
    where = {n: {k for m, k in zip(named, places, strict=True) if m == n} - {None} for n in set(named)}
    lengths = {i: f", {entry.facts.length_m:.0f} m" for entry, i in zip(entries, places, strict=True) if i is not None}
    return [  # one name for layouts of several lengths: the length distinguishes them
        replace(entry, track=n if n is None or len(where[n]) < 2 or i is None else n + lengths[i])
        for entry, n, i in zip(entries, named, places, strict=True)
    ]


def _places(entries: Sequence[Entry]) -> list[int | None]:
    """Number the places that sessions were driven at; None where no lap was found."""
    places: list[Facts] = []
    found: list[int | None] = []
    for facts in (entry.facts for entry in entries):
        if facts.lat_deg is None or facts.lon_deg is None or facts.length_m is None:
            found.append(None)
            continue
        index = next((i for i, place in enumerate(places) if _is_same(place, facts)), len(places))
        if index == len(places):
            places.append(facts)
        found.append(index)
    return found


def _is_same(a: Facts, b: Facts) -> bool:
    """Whether two sessions with known place and length were driven on one track."""
    assert a.lat_deg is not None and a.lon_deg is not None and a.length_m is not None
    assert b.lat_deg is not None and b.lon_deg is not None and b.length_m is not None
    north = (a.lat_deg - b.lat_deg) * METRES_PER_DEGREE
    east = ((a.lon_deg - b.lon_deg + 180.0) % 360.0 - 180.0) * METRES_PER_DEGREE * math.cos(math.radians(a.lat_deg))
    # of a track's length: another layout; the driven line differs by 1 % at the most
    return math.hypot(north, east) < FAR and abs(a.length_m - b.length_m) < 0.04 * a.length_m


def tracks_of(entries: Sequence[Entry]) -> list[Track]:
    """Return the tracks with laps that count, the one with most sessions first; `entries` as of :func:`with_tracks`."""
    timed = [entry for entry in entries if entry.counts and entry.track is not None]
    made = []
    for name, group in _grouped(timed, lambda entry: entry.track):
        lengths = sorted(entry.facts.length_m for entry in group if entry.facts.length_m is not None)
        length = lengths[len(lengths) // 2] if lengths else math.nan
        karts = _bests(group, lambda entry: entry.kart)
        drivers = _bests([e for e in group if e.facts.driver is not None], lambda entry: entry.facts.driver)
        made.append(Track(name, karts, drivers, len(group), length))
    return sorted(made, key=lambda track: (-track.sessions, track.name))


def _bests(entries: Iterable[Entry], who: Callable[[Entry], str | None]) -> tuple[Best, ...]:
    bests = [
        Best(name or None, min(group, key=lambda entry: entry.facts.best_s or math.inf), len(group), _laps(group))
        for name, group in _grouped(list(entries), who)
    ]
    return tuple(sorted(bests, key=lambda best: best.time))


def _grouped(entries: Sequence[Entry], key: Callable[[Entry], str | None]) -> list[tuple[str, list[Entry]]]:
    def known(entry: Entry) -> str:
        return key(entry) or ""

    return [(name, list(group)) for name, group in groupby(sorted(entries, key=known), key=known)]


def _laps(entries: Iterable[Entry]) -> int:
    return sum(entry.facts.laps or 0 for entry in entries)


def report_of(entry: Entry, name: str) -> Path | None:
    """Return the file of its results with this name, if results are there and it is."""
    if entry.outcome is None or not entry.outcome.has_results:
        return None
    path = entry.task.out / name
    return path if is_there(path) else None
