"""sessions.html in a browser: from disk, sorted and searched, light and dark, on a phone and on paper."""

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from smoother.batch.entries import Entry
from smoother.batch.index import PAGE, write_index
from smoother.batch.outcome import Facts, Outcome
from smoother.batch.task import Task

from ..chromium import NASTY, chromium, needs_chromium, opened_alone

pytestmark = needs_chromium


def written(directory: Path) -> Path:
    entries = []
    for i in range(12):
        name = f"day/kart{i % 3 + 1}/run{i + 1}"
        task = Task(directory / name, directory / name / "smoothed", (), name, f"kart{i % 3 + 1}")
        facts = Facts(
            driver=NASTY if i == 4 else f"driver {i % 4}",
            start_utc=f"2026-05-16T08:{59 - i}:00Z",
            distance_m=12000.0,
            top_speed_mps=30.0,
            laps=i,
            best_lap=3,
            best_s=65.0 - i,
            best_sigma_s=0.02,
            lat_deg=45.0,
            lon_deg=12.0,
            length_m=900.0,
        )
        task.out.mkdir(parents=True)
        (task.out / "report.html").write_text("<p>the report</p>")
        entries.append(Entry(task, Outcome("done", facts=facts) if i != 7 else Outcome("unusable", f"no fix {NASTY}")))
    entries.append(Entry(Task(directory, directory, (), "day/waits")))
    write_index(directory, f"day {NASTY}", entries)
    return directory / PAGE


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as driver:
        yield driver


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Any]:
    yield from opened_alone(browser, written(tmp_path), tmp_path)


def rows(browser: Any) -> list[list[str]]:
    """The texts of the rows of all sessions that are shown."""
    found: list[list[str]] = browser.execute_script(
        "return [...document.querySelectorAll('#all tbody tr')].filter(r => !r.hidden)"
        ".map(r => [...r.cells].map(c => c.textContent))"
    )
    return found


def test_sessions_are_sorted_by_any_column_and_what_is_unknown_stays_below(opened: Any) -> None:
    def sort(column: int) -> list[str]:
        opened.find_elements("css selector", "#all th button")[column].click()
        return [row[column] for row in rows(opened)]

    assert sort(0)[:3] == ["kart1/run1", "kart1/run4", "kart1/run7"]
    assert [row[0] for row in rows(opened)][3] == "kart1/run10"
    best = sort(7)
    assert best[:2] == ["54.000", "55.000"]
    assert best[-2:] == ["–", "–"]
    assert sort(7)[:2] == ["1:05.000", "1:04.000"]
    assert sort(6)[:3] == ["0", "1", "2"]
    for column in (4, 5, 6, 7, 8, 9):
        assert all(sort(column)[-2:] == ["–", "–"] for _ in range(2)), column


def test_sessions_are_searched_by_words(opened: Any) -> None:
    field = opened.find_element("id", "search")
    field.send_keys("KART2 driver")
    assert {row[1] for row in rows(opened)} == {"kart2"}
    assert opened.find_element("id", "shown").text == f"{len(rows(opened))} of 13"
    field.clear()
    field.send_keys("nobody")
    assert rows(opened) == []


def test_names_from_files_are_text_and_links_lead_to_reports(opened: Any) -> None:
    assert opened.find_elements("css selector", "img") == []
    assert NASTY in opened.find_element("css selector", "h1").text
    assert NASTY in opened.find_element("css selector", "#all").text
    opened.find_element("link text", "kart1/run1").click()
    assert "the report" in opened.find_element("css selector", "body").text


def test_theme_and_unit_are_switched(opened: Any) -> None:
    from selenium.webdriver.support.select import Select

    def look() -> str:
        return str(opened.execute_script("return getComputedStyle(document.body).backgroundColor"))

    theme = Select(opened.find_element("id", "theme"))
    theme.select_by_value("dark")
    dark = look()
    theme.select_by_value("light")
    assert look() != dark == "rgb(20, 24, 28)"
    theme.select_by_value("auto")
    Select(opened.find_element("id", "units")).select_by_value("mph")
    assert float(rows(opened)[0][9]) == pytest.approx(30.0 / 0.44704, abs=0.1)
    Select(opened.find_element("id", "units")).select_by_value("km/h")
    assert float(rows(opened)[0][9]) == pytest.approx(108.0, abs=0.1)


def test_names_of_sessions_stay_whole_or_are_parted_at_their_signs(browser: Any, tmp_path: Path) -> None:
    names = [
        "kart_adria_first_half",
        "kart_massafinalese_racechrono",
        "2026-05-16_morning_practice_with_new_tyres/LOG00002",
    ]
    entries = []
    for i, name in enumerate(names):
        facts = Facts(
            driver="Ann", laps=5, best_s=60.0, best_sigma_s=0.02, lat_deg=45.0 + i, lon_deg=12.0, length_m=900.0
        )
        out = tmp_path / name / "smoothed"
        entries.append(Entry(Task(tmp_path / name, out, (), f"data/{name}"), Outcome("done", facts=facts)))
    write_index(tmp_path, "data", entries)
    browser.get((tmp_path / PAGE).as_uri())
    pieces = browser.execute_script(  # the boxes of each piece between places where a line may break
        "return [...document.querySelectorAll('td.name a, td.name span')].flatMap(name =>"
        "  [...name.childNodes].filter(n => n.nodeType === 3).map(n => {"
        "    const range = document.createRange(); range.selectNodeContents(n);"
        "    return [n.textContent, range.getClientRects().length]; }))"
    )
    assert [piece for piece, lines in pieces if lines > 1] == []
    lines = browser.execute_script(
        "return [...document.querySelectorAll('.bests td.name a, .bests td.name span')]"
        ".map(n => [n.textContent, new Set([...n.getClientRects()].map(r => Math.round(r.top))).size])"
    )
    assert [count for name, count in lines if name == names[0]] == [1, 1]


def test_it_fits_a_telephone_and_prints_on_paper(opened: Any) -> None:
    size = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    opened.refresh()
    assert opened.execute_script("return document.documentElement.scrollWidth <= innerWidth")
    opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    paper = opened.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})
    document = base64.b64decode(paper["data"])
    assert document.startswith(b"%PDF") and len(document) > 15_000
