"""sessions.html: the sessions of a batch on one page, in the style of report.html; from disk, and on paper.

Like the report it is a tree of elements into which names go as text only. It reads as it stands; its script sorts and
searches the table and switches unit and theme.
"""

import datetime as dt
import math
import os
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote
from xml.etree.ElementTree import Element

from smoother.batch.entries import Best, Entry, Track, report_of
from smoother.batch.task import ERROR_LOG, REPORT, is_there
from smoother.laps.clock import local_day
from smoother.report.page_html import (
    DASH,
    Child,
    card,
    element,
    lap_clock,
    number,
    parted,
    row,
    settings,
    table,
    whole_page,
)
from smoother.units import KMH
from smoother.words import counted, duration

STATES = {
    "done": "ok",
    "doubtful": "not to be trusted",
    "unusable": "unusable",
    "limit": "over its limit",
    "broken": "broke off",
    "lost": "lost",
    "waiting": "waiting",
}
Cells = Sequence[Child]


def page(title: str, entries: Sequence[Entry], tracks: Sequence[Track], directory: Path, now: dt.datetime) -> str:
    """Return the page as text; it links to reports as they lie seen from `directory`."""
    wrong = [entry for entry in entries if entry.state not in ("done", "waiting")]
    body = [
        _header(title, entries, now),
        _contents(tracks, wrong),
        element("noscript", element("p", "Sorting and searching need JavaScript; the tables do not.", class_="soft")),
        element(
            "main",
            _cards(entries, tracks),
            *(part for i, track in enumerate(tracks) for part in _track(track, i, directory)),
            *(_wrong(wrong, directory) if wrong else []),
            *_all(entries, directory),
        ),
    ]
    shared, own = files("smoother.report") / "template", files("smoother.batch") / "template"
    look, acts = (shared / "page.css", own / "index.css"), (shared / "theme.js", own / "index.js")
    style, script = ("".join(part.read_text(encoding="utf-8") for part in parts) for parts in (look, acts))
    return whole_page(title, body, style, script, {})


def _header(title: str, entries: Sequence[Entry], now: dt.datetime) -> Element:
    days = sorted({start[:10] for entry in entries if (start := _start(entry)) != DASH})
    span = days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}" if days else ""
    about = " · ".join(text for text in (span, f"written {local_day(now.timestamp())}") if text)
    words = element("div", element("h1", title), element("p", about))
    return element("header", words, settings())


def _contents(tracks: Sequence[Track], wrong: Sequence[Entry]) -> Element:
    links = [element("a", track.name, href=f"#track-{i}") for i, track in enumerate(tracks)]
    links += [element("a", "Sessions to look at", href="#wrong")] if wrong else []
    return element("nav", *links, element("a", "All sessions", href="#sessions"), aria_label="Contents")


def _cards(entries: Sequence[Entry], tracks: Sequence[Track]) -> Element:
    states = [entry.state for entry in entries]
    good, doubtful, waiting = (states.count(state) for state in ("done", "doubtful", "waiting"))
    failed = len(states) - good - doubtful - waiting
    parts = [f"{doubtful} not to be trusted"] if doubtful else []
    parts += [f"{waiting} still waiting"] if waiting else []
    cards = [card("Sessions", str(len(entries)), f"{good} ok" + "".join(f", {part}" for part in parts))]
    mark = element("span", str(failed), class_="bad" if failed else "good")
    cards.append(card("Without a result", mark, element("a", "see why", href="#wrong") if failed else "none"))
    for track in tracks[:3]:  # of best laps, a track each; the tables below have all
        if bests := track.karts or track.drivers:
            title = f"Best lap: {track.name}" if len(tracks) > 1 else "Best lap"
            cards.append(card(title, lap_clock(bests[0].time), _whose(bests[0], bool(track.karts))))
    laps = sum(entry.facts.laps or 0 for entry in entries if entry.counts)
    karts = {entry.kart for entry in entries if entry.counts and entry.kart}
    cards.append(card("Laps", str(laps), f"that count, of {counted(len(karts), 'kart')}" if karts else "that count"))
    metres = sum(entry.facts.distance_m or 0.0 for entry in entries)
    lasts = sum(entry.facts.duration_s or 0.0 for entry in entries)
    cards.append(card("Distance", f"{metres / 1000.0:.1f} km", f"in {duration(lasts)}"))
    return element("section", element("dl", *cards, class_="cards"), id="summary")


def _whose(best: Best, is_of_kart: bool) -> str:
    """Whose lap it was, the session where no name is known."""
    if best.who is None:
        return _short(best.entry)
    return f"kart {best.who}" if is_of_kart and not best.who.lower().startswith("kart") else best.who


# ---- best laps ------------------------------------------------------------------------------------------------------


def _track(track: Track, number_: int, directory: Path) -> list[Element]:
    length = f", {track.length_m:.0f} m" if math.isfinite(track.length_m) and " m" not in track.name else ""
    note = f"{counted(track.sessions, 'session')} with laps that count{length}. The ± is one sigma; laps of sessions "
    parts = [_bests("kart", "driver", track.karts, directory), _bests("driver", "kart", track.drivers, directory)]
    shown = [part for part in parts if part is not None]
    return [
        element("h2", f"Best laps: {track.name}", id=f"track-{number_}"),
        element("p", f"{note}that are not to be trusted are left out.", class_="soft"),
        element("div", *shown, class_="pair bests"),
    ]


def _bests(who: str, other: str, bests: Sequence[Best], directory: Path) -> Element | None:
    """The table of one kind; None where no name is known."""
    if not bests:
        return None
    head = ["", who, "best lap", "behind", other, "session", "laps"]
    fastest = bests[0].time
    rows = [
        row(
            _cell(str(i), "number"),
            _cell(best.who or "not named", "name"),
            element("td", lap_clock(best.time), _pm(best.entry.facts.best_sigma_s), class_="number"),
            _cell(number(best.time - fastest, 3, signed=True) if i > 1 else "", "number"),
            _cell((best.entry.facts.driver if who == "kart" else best.entry.kart) or DASH, "name"),
            element("td", _linked(best.entry, directory), class_="name"),
            _cell(str(best.laps), "number"),
            class_="best" if i == 1 else "",
        )
        for i, best in enumerate(bests, 1)
    ]
    numbers = {"", "best lap", "behind", "laps"}
    return _table([(name, name in numbers) for name in head], rows, f"Best lap of each {who}")


def _pm(sigma: float | None) -> Element | None:
    return None if sigma is None else element("small", f" ± {number(sigma, 3)}")


def _table(head: Sequence[tuple[Child, bool]], rows: Sequence[Element], caption: str = "") -> Element:
    """A table of words; the heads of columns with numbers stand over these."""
    made = table([name for name, _ in head], rows, caption, "words")
    for cell, (_, is_number) in zip(made.iter("th"), head, strict=True):
        if is_number:
            cell.set("class", "number")
    return made


def _cell(text: str, class_: str, **attributes: str) -> Element:
    return element("td", text, class_=class_, **attributes)


# ---- sessions -------------------------------------------------------------------------------------------------------


def _wrong(entries: Sequence[Entry], directory: Path) -> list[Element]:
    rows = [
        row(
            element("td", _linked(entry, directory), class_="name"),
            _cell(entry.kart or DASH, "plain"),
            _cell(STATES[entry.state], "plain bad" if entry.state != "doubtful" else "plain"),
            _cell(str(entry.outcome.code) if entry.outcome else DASH, "number"),
            element("td", *_reason(entry, directory)),
        )
        for entry in entries
    ]
    head = [("session", False), ("kart", False), ("what", False), ("code", True), ("why", False)]
    note = "Code: what smooth would have ended with: 1 a bug in this program, 2 unusable, 3 not to be trusted."
    return [
        element("h2", "Sessions to look at", id="wrong"),
        element("p", note, class_="soft"),
        element("div", _table(head, rows), class_="wide"),
    ]


def _reason(entry: Entry, directory: Path) -> Cells:
    assert entry.outcome is not None
    log = entry.task.out / ERROR_LOG
    if entry.state != "broken" or not is_there(log):
        return [entry.outcome.message]
    return [entry.outcome.message, " (", element("a", "all of it", href=link(log, directory)), ")"]


def _all(entries: Sequence[Entry], directory: Path) -> list[Element]:
    unit = element("span", "km/h", class_="speed-unit")
    head: list[tuple[Child, bool]] = [
        (element("button", name, type="button"), is_number)
        for name, is_number in (
            ("session", False),
            ("kart", False),
            ("driver", False),
            ("track", False),
            ("start", False),
            ("km", True),
            ("laps", True),
            ("best lap", True),
            ("± s", True),
        )
    ]
    head.append((element("button", "top ", unit, type="button"), True))
    head.append((element("button", "result", type="button"), False))
    find = element("label", "Search ", element("input", type="search", id="search", placeholder="kart, driver, day .."))
    return [
        element("h2", "All sessions", id="sessions"),
        element("div", find, element("output", counted(len(entries), "session"), id="shown"), class_="settings"),
        element("div", _table(head, [_row(entry, directory) for entry in entries]), id="all", class_="wide"),
    ]


def _row(entry: Entry, directory: Path) -> Element:
    facts = entry.facts
    is_bad = entry.state not in ("done", "doubtful", "waiting")
    speed = facts.top_speed_mps
    top = {} if speed is None else {"data_mps": f"{speed:.4f}", "data_value": f"{speed:.4f}"}
    return row(
        element("td", _linked(entry, directory), class_="name"),
        _cell(entry.kart or DASH, "plain"),
        _cell(facts.driver or DASH, "name" if facts.driver else ""),
        _cell(entry.track or DASH, "name" if entry.track else ""),
        _cell(_start(entry), "plain"),
        _number(None if facts.distance_m is None else facts.distance_m / 1000.0, 2),
        _number(facts.laps, 0),
        _cell(lap_clock(_known(facts.best_s)), "number", **_value(facts.best_s)),
        _number(facts.best_sigma_s, 3),
        _cell(DASH if speed is None else number(speed / KMH, 1), "number", **top),
        _cell(_result(entry), "bad" if is_bad else ""),
        class_="waiting" if entry.state == "waiting" else "",
    )


def _result(entry: Entry) -> str:
    """What became of it; a kart that is in none of the tables above has a reason."""
    lapless = entry.state == "done" and not entry.facts.laps
    return f"{STATES[entry.state]}, no lap counts" if lapless else STATES[entry.state]


def _number(value: float | None, digits: int) -> Element:
    return _cell(number(_known(value), digits), "number", **_value(value))


def _value(value: float | None) -> dict[str, str]:
    """What the script sorts by."""
    return {} if value is None else {"data_value": f"{value:.6g}"}


def _known(value: float | None) -> float:
    return math.nan if value is None else value


def _linked(entry: Entry, directory: Path) -> Child:
    """The name of a session, linked to its report where there is one."""
    report = report_of(entry, REPORT)
    parts = parted(_short(entry))
    return element("span", *parts) if report is None else element("a", *parts, href=link(report, directory))


def _short(entry: Entry) -> str:
    """The name of a session without the folder that was searched, which all of them share."""
    return entry.task.name.partition("/")[2] or entry.task.name


def link(path: Path, directory: Path) -> str:
    """Return the address of a file as seen from a page in `directory`; whatever its name is, it stays an address."""
    return quote(os.fsencode(os.path.relpath(path, directory.resolve())))


def _start(entry: Entry) -> str:
    """Day and time of its start on the clock of this machine."""
    if entry.facts.start_utc is None:
        return DASH
    try:
        return local_day(dt.datetime.fromisoformat(entry.facts.start_utc).timestamp())
    except (ValueError, OverflowError, OSError):  # a receiver may report year 9999
        return DASH
