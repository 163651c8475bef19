"""sessions.json and sessions.csv: everything the index page says, for programs and for spreadsheets."""

import datetime as dt
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

import smoother
from smoother.batch.entries import Best, Entry, Track, report_of, tracks_of, with_tracks
from smoother.batch.page import page
from smoother.batch.task import REPORT, TRAJECTORY
from smoother.documents import replacing
from smoother.report.files import to_json, write_csv

PAGE, DOCUMENT, TABLE = "sessions.html", "sessions.json", "sessions.csv"
Document = dict[str, Any]
NUMBERS = (
    ("duration_s", 2),
    ("distance_m", 1),
    ("top_speed_mps", 3),
    ("laps", 0),
    ("best_lap", 0),
    ("best_s", 4),
    ("best_sigma_s", 4),
    ("problems", 0),
)
WHOLE = ("code", "laps", "best_lap", "problems", "starts")
FORMULA = ("=", "+", "-", "@", "\t", "\r")


def write_index(directory: Path, title: str, entries: Sequence[Entry]) -> Document:
    """Write the page, the JSON document and the table of a batch into a directory; return the document.

    Each file appears at once and whole. Raises OSError.
    """
    known = with_tracks(entries)
    tracks = tracks_of(known)
    now = dt.datetime.now(dt.UTC)
    made = document(title, known, tracks, directory, now)
    directory.mkdir(parents=True, exist_ok=True)
    with replacing(directory / DOCUMENT) as temporary:
        temporary.write_text(to_json(made), encoding="utf-8")
    write_csv(directory / TABLE, table(made))
    with replacing(directory / PAGE) as temporary:
        temporary.write_text(page(title, known, tracks, directory, now), encoding="utf-8")
    return made


def document(
    title: str, entries: Sequence[Entry], tracks: Sequence[Track], directory: Path, now: dt.datetime
) -> Document:
    """Return the index as plain values; paths are seen from `directory`."""
    return {
        "version": smoother.__version__,
        "title": readable(title),
        "written_utc": now.isoformat(timespec="seconds").replace("+00:00", "Z"),
        "counts": {"sessions": len(entries), **Counter(entry.state for entry in entries)},
        "tracks": [_track(track) for track in tracks],
        "sessions": [_session(entry, directory) for entry in entries],
    }


def _track(track: Track) -> Document:
    return {
        "track": readable(track.name),
        "length_m": round(track.length_m, 1),
        "sessions": track.sessions,
        "karts": [_best(best, "kart") for best in track.karts],
        "drivers": [_best(best, "driver") for best in track.drivers],
    }


def _best(best: Best, who: str) -> Document:
    facts = best.entry.facts
    other = {"driver": facts.driver} if who == "kart" else {"kart": best.entry.kart}
    return {
        who: None if best.who is None else readable(best.who),
        "best_s": facts.best_s,
        "best_sigma_s": facts.best_sigma_s,
        "lap": facts.best_lap,
        "session": readable(best.entry.task.name),
        **{key: None if value is None else readable(value) for key, value in other.items()},
        "sessions": best.sessions,
        "laps": best.laps,
    }


def _session(entry: Entry, directory: Path) -> Document:
    facts, outcome = entry.facts, entry.outcome
    report, rows = report_of(entry, REPORT), report_of(entry, TRAJECTORY)
    texts = {"title": facts.title, "kart": entry.kart, "driver": facts.driver, "track": entry.track}
    return {
        "session": readable(entry.task.name),
        "state": entry.state,
        "code": None if outcome is None else outcome.code,
        "message": "" if outcome is None else readable(outcome.message),
        **{key: None if value is None else readable(value) for key, value in texts.items()},
        "start_utc": facts.start_utc,
        "mode": facts.mode,
        **{name: _rounded(getattr(facts, name), digits) for name, digits in NUMBERS},
        "report": _seen_from(directory, report),
        "results": _seen_from(directory, None if rows is None else rows.parent),
        "kept": entry.is_kept,
        "seconds": None if outcome is None else round(outcome.cost.seconds, 2),
        "cpu_s": None if outcome is None else round(outcome.cost.cpu_s, 2),
        "memory_mb": None if outcome is None else round(outcome.cost.memory_mb, 1),
        "starts": None if outcome is None else outcome.cost.starts,
    }


def _rounded(value: float | None, digits: int) -> float | int | None:
    if value is None:
        return None
    return round(value, digits) if digits else int(value)


def _seen_from(directory: Path, path: Path | None) -> str | None:
    return None if path is None else readable(os.path.relpath(path, directory.resolve()))


def readable(text: str) -> str:
    """Return text that UTF-8 can hold: names of files may be bytes that are none."""
    return text.encode("utf-8", errors="replace").decode("utf-8")


def table(made: Document) -> pl.DataFrame:
    """Return one row per session. A text that a spreadsheet would run as a formula begins with an apostrophe."""
    columns: dict[str, pl.Series] = {}
    names = list(made["sessions"][0]) if made["sessions"] else []
    for name in names:
        values = [session[name] for session in made["sessions"]]
        columns[name] = pl.Series(name, [_harmless(value) for value in values], dtype=_kind(name), strict=True)
    return pl.DataFrame(columns)


def _kind(name: str) -> Any:
    if name == "kept":
        return pl.Boolean
    if name in WHOLE:
        return pl.Int64
    is_number = name in dict(NUMBERS) or name in ("seconds", "cpu_s", "memory_mb")
    return pl.Float64 if is_number else pl.String


def _harmless(value: Any) -> Any:
    if isinstance(value, str):
        value = "".join(c if c.isprintable() else " " for c in value)
        return f"'{value}" if value.startswith(FORMULA) else value
    return value
