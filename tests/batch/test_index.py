"""Best laps per kart and driver, tracks told apart, and the index as page, document and table."""

import csv
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from smoother.batch.entries import Entry, tracks_of, with_tracks
from smoother.batch.index import DOCUMENT, PAGE, TABLE, write_index
from smoother.batch.outcome import Cost, Facts, Outcome, State
from smoother.batch.task import ERROR_LOG, Task

NASTY = '<script>alert(1)</script>"\x1b[31m'


def entry(
    root: Path,
    name: str,
    best: float | None = 60.0,
    state: State = "done",
    kart: str = "",
    message: str = "",
    **facts: object,
) -> Entry:
    task = Task(root / name, root / name / "smoothed", (), name, kart)
    known = {"lat_deg": 45.0, "lon_deg": 12.0, "length_m": 900.0, "laps": 5, "best_lap": 2, "best_sigma_s": 0.02}
    return Entry(task, Outcome(state, message, Facts(best_s=best, **(known | facts)), Cost(2.0, 1.5, 130.0)))  # type: ignore[arg-type]


def test_the_best_lap_of_each_kart_and_driver_is_of_sessions_to_be_trusted(tmp_path: Path) -> None:
    entries = [
        entry(tmp_path, "a", 60.0, kart="1", driver="Ann"),
        entry(tmp_path, "b", 59.0, kart="1", driver="Bob"),
        entry(tmp_path, "c", 58.0, kart="2", driver="Ann"),
        entry(tmp_path, "d", 40.0, "doubtful", kart="2", driver="Ann"),
        entry(tmp_path, "e", None, kart="3", driver="Cay", laps=0),
        Entry(Task(tmp_path, tmp_path, (), "f", "4")),
    ]
    entries.append(entry(tmp_path, "g", 61.0))
    (track,) = tracks_of(with_tracks(entries))
    assert [(best.who, best.time, best.entry.task.name) for best in track.karts] == [
        ("2", 58.0, "c"),
        ("1", 59.0, "b"),
        (None, 61.0, "g"),
    ]
    assert [(best.who, best.time, best.sessions, best.laps) for best in track.drivers] == [
        ("Ann", 58.0, 2, 10),
        ("Bob", 59.0, 1, 5),
    ]


def test_what_session_toml_calls_the_kart_wins_over_the_folder(tmp_path: Path) -> None:
    assert entry(tmp_path, "a", kart="folder").kart == "folder"
    assert entry(tmp_path, "a", kart="folder", **{}).kart == "folder"
    named = entry(tmp_path, "a", kart="folder")
    assert named.outcome is not None
    named = replace(named, outcome=replace(named.outcome, facts=replace(named.facts, kart="7")))
    assert named.kart == "7"


def test_lap_times_of_different_tracks_and_layouts_are_not_compared(tmp_path: Path) -> None:
    entries = [
        entry(tmp_path, "here"),
        entry(tmp_path, "here too, from the pits", lat_deg=45.004, length_m=905.0),
        entry(tmp_path, "long layout", length_m=1200.0),
        entry(tmp_path, "elsewhere", lat_deg=46.0),
        entry(tmp_path, "named there", lat_deg=46.001, track="Adria"),
    ]
    assert [e.track for e in with_tracks(entries)] == ["track 1", "track 1", "track 2", "Adria", "Adria"]


def test_names_that_were_given_tell_tracks_apart_and_lengths_tell_layouts_of_one_name(tmp_path: Path) -> None:
    entries = [
        entry(tmp_path, "a", track="Adria"),
        entry(tmp_path, "b", track="Adria", length_m=700.0),
        entry(tmp_path, "c", track="Ring"),
        entry(tmp_path, "d"),
        entry(tmp_path, "e", None, track="Ring", lat_deg=None),
    ]
    assert [e.track for e in with_tracks(entries)] == ["Adria, 900 m", "Adria, 700 m", "Ring", "track 1", "Ring"]


def test_a_track_on_the_date_line_is_one(tmp_path: Path) -> None:
    entries = [entry(tmp_path, "a", lon_deg=179.9999), entry(tmp_path, "b", lon_deg=-179.9999)]
    assert [e.track for e in with_tracks(entries)] == ["track 1", "track 1"]


class Page(HTMLParser):
    """Links, scripts and texts of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name == "href" and value]

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1] not in ("script", "style"):
            self.text += data


@pytest.fixture
def day(tmp_path: Path) -> list[Entry]:
    names = [f"day/{NASTY[:-5]}/run", "day/kart 2/heat #1?", "day/\udcff/run", "day/javascript:x/run", "day/k/waits"]
    entries = [entry(tmp_path, name, 60.0 + i, kart=name.split("/")[1], driver=NASTY) for i, name in enumerate(names)]
    for one in entries[:4]:
        one.task.out.mkdir(parents=True)
        (one.task.out / "report.html").touch()
        (one.task.out / "trajectory.csv").touch()
    entries[4] = Entry(entries[4].task)
    entries.append(entry(tmp_path, "day/bad", None, "unusable", message=f"gps.csv: {NASTY}"))
    broken = entry(tmp_path, "day/worse", None, "broken", message="=1+1 a bug")
    broken.task.out.mkdir(parents=True)
    (broken.task.out / ERROR_LOG).touch()
    return [*entries, broken]


def test_names_of_files_are_text_in_the_page_and_links_lead_to_reports(day: list[Entry], tmp_path: Path) -> None:
    write_index(tmp_path, NASTY, day)
    page = Page(tmp_path / PAGE)
    assert page.tags.count("script") == 2  # the page's own script and its data
    assert "img" not in page.tags
    assert page.text.count("<script>alert(1)</script>") > 5
    links = [link for link in page.links if not link.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9_.~/%-]+", link) for link in links)
    wanted = {one.task.out / "report.html" for one in day[:4]} | {day[-1].task.out / ERROR_LOG}
    assert {tmp_path / unquote(link, errors="surrogateescape") for link in links} == wanted
    assert all(path.is_file() for path in wanted)


def test_a_session_in_no_table_of_best_laps_has_a_reason(tmp_path: Path) -> None:
    write_index(tmp_path, "day", [entry(tmp_path, "day/a", 60.0), entry(tmp_path, "day/b", None, laps=0)])
    assert Page(tmp_path / PAGE).text.count("ok, no lap counts") == 1


def test_the_document_and_the_table_say_the_same(day: list[Entry], tmp_path: Path) -> None:
    made = write_index(tmp_path, "day", day)
    document = json.loads((tmp_path / DOCUMENT).read_text(encoding="utf-8"))
    assert document == json.loads(json.dumps(made))
    assert document["counts"] == {"sessions": 7, "done": 4, "waiting": 1, "unusable": 1, "broken": 1}
    assert document["tracks"][0]["karts"][0]["best_s"] == 60.0
    assert [session["code"] for session in document["sessions"]] == [0, 0, 0, 0, None, 2, 1]
    assert NASTY in document["sessions"][5]["message"]
    with (tmp_path / TABLE).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == [session["state"] for session in document["sessions"]]
    assert [row["best_s"] for row in rows[:2]] == ["60.0", "61.0"]
    assert rows[6]["message"] == "'=1+1 a bug"  # a spreadsheet must not take it for a formula
    assert rows[4]["best_s"] == rows[4]["code"] == ""


def test_a_failed_write_leaves_the_old_index(day: list[Entry], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_index(tmp_path, "day", day)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}

    def full(*_: object, **__: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("smoother.batch.index.page", full)
    monkeypatch.setattr("smoother.batch.index.write_csv", full)
    monkeypatch.setattr("smoother.batch.index.to_json", full)
    with pytest.raises(OSError, match="No space"):
        write_index(tmp_path, "day", day[:1])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


def test_short_driving_is_shown_in_minutes_and_long_in_hours(tmp_path: Path) -> None:
    for seconds, said in ((240.0, "8 min 0 s"), (4000.0, "2 h 13 min")):
        entries = [entry(tmp_path, name, distance_m=4700.0, duration_s=seconds) for name in ("a", "b")]
        write_index(tmp_path, "day", entries)
        assert f"9.4 kmin {said}" in Page(tmp_path / PAGE).text  # in a line of its own below


def test_an_index_without_any_result_is_a_page_too(tmp_path: Path) -> None:
    entries = [Entry(Task(tmp_path / "a", tmp_path / "a", (), "a"))]
    made = write_index(tmp_path, "day", entries)
    assert made["tracks"] == []
    assert "waiting" in Page(tmp_path / PAGE).text


def test_absurd_times_and_places_are_shown_as_they_can(tmp_path: Path) -> None:
    for start in ("9999-12-31T23:59:59.999Z", "0001-01-01T00:00:00Z", "never"):
        write_index(tmp_path, "day", [entry(tmp_path, "a", start_utc=start, best_sigma_s=None)])
        row = re.search(r"track 1(–|\d+-\d\d-\d\d \d\d:\d\d \S+?)–51:00\.000––ok", Page(tmp_path / PAGE).text)
        assert row is not None, start  # a time that the zone of this machine moves beyond all years is a dash
        assert row[1] == "–" or start != "never"


def test_every_track_has_a_tile_with_its_best_lap(tmp_path: Path) -> None:
    """Not the first track alone, which may not be that of the fastest lap."""
    entries = [
        entry(tmp_path, "day/a", 60.0, kart="12", track="Adria"),
        entry(tmp_path, "day/b", 61.0, kart="kart7", track="Adria"),
        entry(tmp_path, "day/c", 48.2, track="Ring", lat_deg=46.0),
    ]
    write_index(tmp_path, "day", entries)
    text = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert "<dt>Best lap: Adria</dt><dd>1:00.000<small>kart 12</small>" in text
    assert "<dt>Best lap: Ring</dt><dd>48.200<small>c</small>" in text
    write_index(tmp_path, "day", entries[1:2])
    assert "<dt>Best lap</dt><dd>1:01.000<small>kart7</small>" in (tmp_path / PAGE).read_text(encoding="utf-8")
