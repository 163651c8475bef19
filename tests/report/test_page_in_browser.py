"""report.html in a browser: it opens from disk, answers to mouse and keys, prints, and asks for nothing."""

import base64
import io
import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from smoother.cli.pipeline import Options, Stopwatch, calibrated, estimate, read, with_laps
from smoother.config import SessionConfig
from smoother.estimate.judge.quality import Quality
from smoother.laps.stage import read_stated
from smoother.prepare import prepare
from smoother.report.compare_page import Compared, write_comparison
from smoother.report.page import Report, write_page
from smoother.samples import Session
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import Trajectory

from ..chromium import NASTY, chromium, needs_chromium, opened_alone

pytestmark = needs_chromium
PAINTED_OUTSIDE = """
const found = [];
for (const svg of document.querySelectorAll("svg.chart")) {
  const sheet = svg.getBoundingClientRect(), to = svg.getScreenCTM();
  for (const node of svg.querySelectorAll("path, circle, rect, text")) {
    if (node.closest("defs") || getComputedStyle(node).visibility === "hidden") continue;
    let { left, top, right, bottom } = node.getBoundingClientRect();
    if (right - left + bottom - top === 0) continue;
    const clipped = node.closest("[clip-path]");
    if (clipped) {
      const shape = document.querySelector(clipped.getAttribute("clip-path").slice(4, -1) + " rect");
      const [x, y, w, h] = ["x", "y", "width", "height"].map((name) => Number(shape.getAttribute(name)));
      [left, right] = [Math.max(left, to.a * x + to.e), Math.min(right, to.a * (x + w) + to.e)];
      [top, bottom] = [Math.max(top, to.d * y + to.f), Math.min(bottom, to.d * (y + h) + to.f)];
      if (right <= left || bottom <= top) continue;
    }
    const out = Math.max(sheet.left - left, sheet.top - top, right - sheet.right, bottom - sheet.bottom);
    const what = [svg.parentNode.id, node.tagName, node.getAttribute("class"), node.textContent].join(" ");
    if (out > 1) found.push(`${what} by ${out.toFixed(0)} px`);
  }
}
return found;"""


def written(session: Session, directory: Path, path: Path) -> Path:
    made = estimate(session, Options(), Stopwatch())
    made = with_laps(made, read_stated(session.config, directory), Stopwatch())
    write_page(path, Report(made.session, made.smoothed, made.baseline, made.laps, made.quality))
    return path


@pytest.fixture(scope="module")
def simulated_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("simulated")
    raw = simulate_preset("kart", 2026, duration=200.0).raw
    object.__setattr__(raw, "config", SessionConfig(driver=NASTY))
    return written(prepare(raw), directory, directory / "report.html")


@pytest.fixture(scope="module")
def adria_page(tmp_path_factory: pytest.TempPathFactory, data_directory: Path) -> Path:
    source = data_directory / "kart_adria_first_half"
    if not source.is_dir():
        pytest.skip(f"no {source}")
    return written(calibrated(read(source), source), source, tmp_path_factory.mktemp("adria") / "report.html")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as driver:
        driver.execute_cdp_cmd("Network.setBypassServiceWorker", {"bypass": True})
        yield driver


@pytest.fixture(scope="module")
def compared_page(tmp_path_factory: pytest.TempPathFactory, compared: list[Compared]) -> Path:
    path = tmp_path_factory.mktemp("compared") / "comparison.html"
    write_comparison(path, compared)
    return path


@pytest.fixture(scope="module")
def shaken_page(tmp_path_factory: pytest.TempPathFactory, session: Session, trajectory: Trajectory) -> Path:
    """40 min, no laps; blows far beyond the reach of the diagram of accelerations, and a baseline that runs away."""
    trajectory = replace(trajectory, t=60.0 * trajectory.t)
    force = np.array(trajectory.acceleration_b)
    force[::150, :2] *= 40.0
    away = replace(trajectory, position_n=trajectory.position_n * 30.0)
    path = tmp_path_factory.mktemp("shaken") / "report.html"
    quality = Quality(True, (), {})
    write_page(path, Report(session, replace(trajectory, acceleration_b=force), away, None, quality))
    return path


@pytest.fixture(scope="module")
def spiked_page(tmp_path_factory: pytest.TempPathFactory, session: Session, trajectory: Trajectory) -> Path:
    """A speed of 500 km/h that is known to be unsure."""
    assert trajectory.sigmas is not None
    velocity, sigma = trajectory.velocity_n.copy(), trajectory.sigmas.speed.copy()
    velocity[1000:1020], sigma[1000:1020] = [500.0 / 3.6, 0.0, 0.0], 100.0
    spiked = replace(trajectory, velocity_n=velocity, sigmas=replace(trajectory.sigmas, speed=sigma))
    path = tmp_path_factory.mktemp("spiked") / "report.html"
    write_page(path, Report(session, spiked, spiked, None, Quality(True, (), {})))
    return path


@pytest.fixture(params=["simulated_page", "adria_page"])
def opened(request: pytest.FixtureRequest, browser: Any) -> Iterator[Any]:
    yield from opened_alone(browser, request.getfixturevalue(request.param))


@pytest.fixture
def opened_comparison(compared_page: Path, browser: Any) -> Iterator[Any]:
    yield from opened_alone(browser, compared_page)


def shown_laps(browser: Any) -> list[str]:
    return [str(cell.text).strip() for cell in browser.find_elements("css selector", "#readout td:first-child")]


def place(browser: Any) -> float:
    return float(browser.find_element("id", "where").text.split()[0])


def drawn(browser: Any, chart: str) -> int:
    return int(browser.execute_script(f"return document.querySelectorAll('#{chart} svg path').length"))


def test_every_chart_is_drawn_and_names_from_files_are_text(opened: Any) -> None:
    for chart in ("map", "traces", "circle", "compared-map", "compared-speed", "quality-time"):
        assert drawn(opened, chart) > 3, chart
    assert opened.execute_script(
        "return [...document.querySelectorAll('svg path')].every(p => !/NaN/.test(p.outerHTML))"
    )
    assert opened.find_elements("css selector", "script:not([type]) ~ script, img") == []
    if "simulated" in opened.current_url:
        assert NASTY in opened.find_element("css selector", "header").text


def test_laps_are_picked_with_mouse_and_keys(opened: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    assert len(shown_laps(opened)) == 2
    free = opened.find_elements("css selector", "#laps-picked input:not(:checked)")
    before = drawn(opened, "traces")
    free[0].click()
    assert len(shown_laps(opened)) == 3
    assert drawn(opened, "traces") > before
    free[1].send_keys(Keys.SPACE)
    assert len(shown_laps(opened)) == 4
    free[1].send_keys(Keys.SPACE)
    free[0].click()
    assert len(shown_laps(opened)) == 2


def test_the_cursor_goes_from_the_map_to_the_traces_and_back(opened: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    def point(chart: str) -> tuple[float, float]:
        x, y = opened.execute_script(
            f"const c = document.querySelector('#{chart} svg .dot').getBoundingClientRect();"
            "return [c.left + c.width / 2, c.top + c.height / 2]"
        )
        return float(x), float(y)

    opened.execute_script("document.getElementById('map').scrollIntoView()")
    map_ = opened.find_element("css selector", "#map svg")
    start, trace = place(opened), point("traces")
    target = opened.execute_script(  # a place half way round, in client coordinates from the middle of the map
        "const p = document.querySelector('#map svg .casing'), s = p.ownerSVGElement, m = p.getScreenCTM();"
        "const q = p.getPointAtLength(p.getTotalLength() / 2), r = s.getBoundingClientRect();"
        "return [m.a * q.x + m.e - r.left - r.width / 2, m.d * q.y + m.f - r.top - r.height / 2]"
    )
    ActionChains(opened).move_to_element_with_offset(map_, round(target[0]), round(target[1])).perform()
    assert abs(place(opened) - start) > 100.0
    assert point("traces")[0] > trace[0] + 50.0
    on_map = point("map")
    traces = opened.find_element("css selector", "#traces svg")
    ActionChains(opened).move_to_element_with_offset(traces, -200, -200).perform()
    assert abs(point("map")[0] - on_map[0]) + abs(point("map")[1] - on_map[1]) > 5.0
    here = place(opened)
    slider = opened.find_element("id", "cursor")
    slider.send_keys(Keys.ARROW_RIGHT)
    assert here < place(opened) < here + 10.0
    slider.send_keys(Keys.HOME)
    assert place(opened) == 0.0


def test_a_part_of_the_track_is_looked_at_closely_and_left_again(opened: Any) -> None:
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.select import Select

    def marks() -> str:
        return str(opened.find_element("css selector", "#traces svg").get_attribute("textContent"))

    whole = marks()
    part = Select(opened.find_element("id", "stretch"))
    part.select_by_index(2)
    assert marks() != whole
    opened.find_element("id", "cursor").send_keys(Keys.ESCAPE)
    assert marks() == whole
    assert part.first_selected_option.text == "whole lap"


def test_a_loss_is_shown_by_the_laps_and_the_part_where_it_was(opened: Any) -> None:
    buttons = opened.find_elements("css selector", "button.look")
    if not buttons:
        assert "Nowhere:" in opened.find_element("id", "lost").find_element("xpath", "following::p").text
        return
    item = buttons[-1].find_element("xpath", "..").text
    whole = str(opened.find_element("css selector", "#traces svg").get_attribute("textContent"))
    buttons[-1].click()
    assert str(opened.find_element("css selector", "#traces svg").get_attribute("textContent")) != whole
    names = [name.strip() for name in shown_laps(opened)]
    assert len(names) == 2
    assert f"on {names[1]}" in item or f"on {names[0]}" in item
    assert abs(opened.find_element("id", "driving").rect["y"] - opened.execute_script("return scrollY")) < 30.0


@contextmanager
def sized(browser: Any, width: int, height: int) -> Iterator[None]:
    """The window with an inside of so many pixels, and as it was afterwards."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        yield
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("name", ["simulated_page", "adria_page", "shaken_page", "compared_page"])
def test_no_chart_paints_over_the_page_around_it(
    name: str, width: int, browser: Any, request: pytest.FixtureRequest
) -> None:
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.select import Select

    with sized(browser, width, 900):
        browser.get(request.getfixturevalue(name).as_uri())
        part = Select(browser.find_element("id", "stretch"))
        assert browser.execute_script(PAINTED_OUTSIDE) == []
        for i, option in enumerate(part.options[:-1]):
            part.select_by_index(i)
            assert browser.execute_script(PAINTED_OUTSIDE) == [], option.text
        browser.find_element("id", "cursor").send_keys(Keys.PAGE_DOWN * 3)  # beyond the part, where it has no place
        assert browser.execute_script(PAINTED_OUTSIDE) == []


def test_corners_and_lines_that_are_not_in_the_part_shown_are_not_on_its_map(opened: Any) -> None:
    from selenium.webdriver.support.select import Select

    def numbers() -> list[str]:
        return [
            str(node.get_attribute("textContent"))
            for node in opened.find_elements("css selector", "#map svg text.corner")
        ]

    part = Select(opened.find_element("id", "stretch"))
    assert len(numbers()) > 3
    (third,) = (option.text for option in part.options if option.text.startswith("corner 3"))
    part.select_by_visible_text(third)
    assert numbers() == ["3"]
    for gate in opened.find_elements("css selector", "#map svg .gate, #map svg .split"):
        box, sheet = gate.rect, opened.find_element("css selector", "#map svg").rect
        assert sheet["x"] - box["width"] < box["x"] < sheet["x"] + sheet["width"]
        assert sheet["y"] - box["height"] < box["y"] < sheet["y"] + sheet["height"]


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("name", ["simulated_page", "shaken_page"])
def test_times_below_a_chart_stand_apart(name: str, width: int, browser: Any, request: pytest.FixtureRequest) -> None:
    with sized(browser, width, 900):
        browser.get(request.getfixturevalue(name).as_uri())
        for chart in ("traces", "quality-time", "compared-speed"):
            boxes = browser.execute_script(
                f"return [...document.querySelectorAll('#{chart} svg text[text-anchor=middle]:not(.corner)')]"
                ".map(t => t.getBoundingClientRect()).map(b => [b.left, b.right])"
            )
            assert len(boxes) > 1 and all(a[1] + 3.0 < b[0] for a, b in itertools.pairwise(boxes)), chart


@pytest.mark.parametrize("name", ["simulated_page", "adria_page", "shaken_page", "spiked_page", "compared_page"])
def test_every_panel_has_a_scale_of_two_values_at_least(
    name: str, browser: Any, request: pytest.FixtureRequest
) -> None:
    browser.get(request.getfixturevalue(name).as_uri())
    labels = browser.execute_script(
        "return ['traces', 'compared-speed', 'quality-time'].flatMap(id => {"
        "  const svg = document.querySelector(`#${id} svg`);"
        "  if (!svg) return [];"
        "  const top = (node) => node.getBoundingClientRect().top;"
        "  const titles = [...svg.querySelectorAll('text.title')].map(top);"
        "  const values = [...svg.querySelectorAll('text[text-anchor=end]')]"
        "    .filter(t => t.textContent !== 'm').map(top);"
        "  return titles.map((y, i) => values.filter(v => v > y - 3 && !(v > titles[i + 1])).length); })"
    )
    assert len(labels) >= 3 and min(labels) >= 2


def test_rings_of_grip_are_named_over_the_dots_and_nothing_is_less_than_zero(opened: Any) -> None:
    over = opened.execute_script(
        "const dots = [...document.querySelectorAll('#circle path.cloud, #circle path.points')];"
        "const names = [...document.querySelectorAll('#circle text')].filter(t => / g$/.test(t.textContent));"
        "return names.length > 1 && names.every(n => dots.every(d => d.compareDocumentPosition(n) & 4))"
    )
    assert over
    said = opened.execute_script(  # at every place of the lap: which of them has a value of nothing is chance
        "const cursor = document.getElementById('cursor'), said = [];"
        "for (let place = 0; place <= +cursor.max; place++) {"
        "  cursor.value = place; cursor.dispatchEvent(new Event('input'));"
        "  said.push(...[...document.querySelectorAll('#readout td')].map(cell => cell.textContent)); }"
        "return said"
    )
    assert "+0.00" in said and "-0.00" not in said and "−0.00" not in said


def test_spikes_that_are_not_sure_do_not_flatten_the_rest(spiked_page: Path, browser: Any) -> None:
    browser.get(spiked_page.as_uri())
    titles = [str(title.text) for title in browser.find_elements("css selector", "svg text.title")]
    assert "speed (km/h); unsure parts go on beyond the frame" in titles
    values = browser.execute_script(
        "return [...document.querySelectorAll('#traces svg text, #compared-speed svg text, #map svg text')]"
        ".map(t => t.textContent)"
    )
    assert "100" in values or "80" in values
    assert not {"200", "300", "400", "500"} & set(values)
    assert any(text.startswith("≥ ") for text in values)
    assert "speed (km/h); the baseline and unsure parts go on beyond the frame" in titles


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("name", ["simulated_page", "compared_page"])
def test_what_explains_a_chart_stands_whole_above_it(
    name: str, width: int, browser: Any, request: pytest.FixtureRequest
) -> None:
    with sized(browser, width, 900):
        browser.get(request.getfixturevalue(name).as_uri())
        told = browser.execute_script(
            "return [...document.querySelectorAll('svg text.title')].map(t => t.textContent).join(' ')"
        )
        expected = [
            "(s), band: two sigma",
            "sideways (g), left +",
            "sideslip (deg), + heading right of the path, band: two sigma",
            "line: metres left of the mean line, band: two sigma, grey: within noise",
        ]
        if name == "simulated_page":
            expected += [
                "uncertainty (m, one sigma): position (solid), line on the track (dashed)",
                "each fix: residual in metres (orange: little weight)",
            ]
        assert [text for text in expected if text not in told] == []
        assert browser.execute_script(PAINTED_OUTSIDE) == []
        covered = browser.execute_script(  # no title stands in a panel, nor in another title
            "const boxes = [...document.querySelectorAll('svg.chart')].flatMap(svg => {"
            "  const titles = [...svg.querySelectorAll('text.title')].map(t => t.getBoundingClientRect());"
            "  const grids = [...svg.querySelectorAll('path.grid, path.zero')].map(g => g.getBoundingClientRect());"
            "  return titles.flatMap((t, i) => [...titles.slice(i + 1), ...grids].filter("
            "    b => t.bottom - 2 > b.top && b.bottom > t.top + 2 && b.right > t.left && t.right > b.left));"
            "}); return boxes.length"
        )
        assert covered == 0


def test_every_corner_has_its_number_over_the_traces_of_a_wide_screen(opened: Any) -> None:
    numbers = (
        f"return [...document.querySelectorAll('#{chart} svg text.corner')].map(t => t.textContent)"
        for chart in ("traces", "map")
    )
    with sized(opened, 1280, 900):
        opened.refresh()
        over_traces, on_map = (opened.execute_script(script) for script in numbers)
        assert over_traces == on_map and len(on_map) > 8


@pytest.mark.parametrize("name", ["simulated_page", "compared_page"])
def test_bands_end_inside_their_frame_or_the_title_notes_it(
    name: str, browser: Any, request: pytest.FixtureRequest
) -> None:
    browser.get(request.getfixturevalue(name).as_uri())
    told = browser.execute_script(
        "return [...document.querySelectorAll('#traces svg path.band')].map(band => {"
        "  const frame = band.parentNode.getAttribute('clip-path').slice(4, -1);"
        "  const shape = document.querySelector(frame + ' rect'), box = band.getBBox();"
        "  const [y, height] = ['y', 'height'].map(key => Number(shape.getAttribute(key)));"
        "  return box.y >= y && box.y + box.height <= y + height; })"
    )
    titles = browser.execute_script(
        "return [...document.querySelectorAll('#traces text.title')].map(t => t.textContent).join(' ')"
    )
    assert len(told) > 2
    assert all(told) or "beyond the frame" in titles
    if name == "simulated_page":  # without an outage nothing is cut
        assert all(told) and "beyond the frame" not in titles


def test_cards_stand_two_beside_one_another_on_a_telephone(opened: Any) -> None:
    with sized(opened, 390, 800):
        left = "return [...document.querySelectorAll('.card')].map((c) => c.getBoundingClientRect().left)"
        assert len(set(opened.execute_script(left))) == 2


def test_cards_stand_in_rows_of_like_length(opened: Any) -> None:
    for width in (1100, 1280, 1920):
        with sized(opened, width, 900):
            tops = opened.execute_script(
                "return [...document.querySelectorAll('.card')].map(c => Math.round(c.getBoundingClientRect().top))"
            )
            assert sorted(tops.count(top) for top in set(tops)) in ([3, 4], [4, 4]), width


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
    cell = opened.find_element("css selector", "td[data-mps]")
    kmh = float(cell.text)
    unit = Select(opened.find_element("id", "units"))
    unit.select_by_value("mph")
    assert float(cell.text) == pytest.approx(kmh / 1.609344, abs=0.1)
    words = opened.execute_script("return document.querySelector('main').innerText")
    assert "km/h" not in words and words.count("mph") >= 7
    unit.select_by_value("km/h")


def test_the_tables_of_laps_and_of_residuals_fit_a_small_laptop(opened: Any) -> None:
    with sized(opened, 1280, 800):
        for place in ("#laps ~ .scroll", "#quality ~ .pair .scroll:last-child"):
            table = f"document.querySelector('{place}')"
            assert opened.execute_script(f"return {table}.scrollWidth <= {table}.clientWidth"), place


def test_it_fits_a_telephone_and_prints_on_paper(opened: Any) -> None:
    with sized(opened, 390, 800):
        opened.refresh()
        assert opened.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        assert opened.execute_script(
            "return [...document.querySelectorAll('caption')].every(c => c.getBoundingClientRect().right <= innerWidth)"
        )
        assert opened.execute_script(
            "const boxes = [...document.querySelectorAll('#traces text.corner')].map(t => t.getBoundingClientRect());"
            "return boxes.length > 3 && boxes.every((b, i) => boxes.slice(i + 1).every("
            "  c => c.right <= b.left || b.right <= c.left || c.bottom <= b.top + 4 || b.bottom <= c.top + 4))"
        )
    paper = opened.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})
    document = base64.b64decode(paper["data"])
    assert document.startswith(b"%PDF") and len(document) > 30_000


def test_on_paper_map_and_traces_fit_one_sheet_and_tables_stay_with_their_captions(opened: Any) -> None:
    opened.execute_script("dispatchEvent(new Event('beforeprint'))")
    heights = opened.execute_script(
        "return ['map', 'traces'].map(id => document.querySelector(`#${id} svg`).viewBox.baseVal.height)"
    )
    opened.execute_script("dispatchEvent(new Event('afterprint'))")
    assert sum(heights) < 940.0  # px of A4 within its margins are 1024, less heading and laps shown
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    parted = opened.execute_script(
        "return [...document.querySelectorAll('table')].filter(t => t.offsetParent)"
        ".filter(t => t.caption || t.rows.length < 15)"
        ".filter(t => getComputedStyle(t.parentNode).breakInside !== 'avoid'"
        "  && getComputedStyle(t).breakInside !== 'avoid').map(t => t.textContent)"
    )
    torn = opened.execute_script(
        "return [...document.querySelectorAll('h2, h3, caption, legend')]"
        ".filter(h => getComputedStyle(h).breakAfter !== 'avoid').map(h => h.textContent)"
    )
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert parted == [] and torn == []


def test_the_fixes_are_seen_beside_the_lines_over_them(opened: Any) -> None:
    widths = opened.execute_script(
        "return ['fixes', 'line'].map(kind => parseFloat(getComputedStyle("
        "document.querySelector(`#compared-map svg path.${kind}`)).strokeWidth))"
    )
    assert widths[0] > 2.0 * widths[1]


def test_a_table_that_is_cut_at_an_edge_is_shaded_there_and_nowhere_on_paper(opened: Any) -> None:
    with sized(opened, 390, 800):
        wide = opened.find_element("css selector", ".scroll")
        for share, cut in ((0.0, (False, True)), (0.5, (True, True)), (1.0, (True, False))):
            opened.execute_script("const e = arguments[0]; e.scrollLeft = arguments[1] * e.scrollWidth", wide, share)
            assert shaded_edges(wide) == cut, share
    with sized(opened, 1280, 900):
        assert shaded_edges(opened.find_element("css selector", ".scroll")) == (False, False)
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    look = opened.execute_script("return getComputedStyle(document.querySelector('.scroll')).backgroundImage")
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert look == "none"


def shaded_edges(element: Any) -> tuple[bool, bool]:
    """Whether what is seen of an element is darker than the paper at its left and at its right edge, all along."""
    picture = np.asarray(Image.open(io.BytesIO(element.screenshot_as_png)).convert("L"), dtype=float)
    edges = picture[:, 1], picture[:, -2]
    return bool(np.median(edges[0]) < 240.0), bool(np.median(edges[1]) < 240.0)


def test_the_tables_of_a_comparison_fit_a_small_laptop(opened_comparison: Any) -> None:
    with sized(opened_comparison, 1280, 800):
        cut = opened_comparison.execute_script(
            "return [...document.querySelectorAll('.scroll')].filter(s => s.scrollWidth > s.clientWidth)"
            ".map(s => s.textContent + s.scrollWidth + ' ' + s.clientWidth)"
        )
        assert cut == []


def test_a_comparison_is_picked_looked_at_and_printed_like_a_report(opened_comparison: Any) -> None:
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.select import Select

    page = opened_comparison
    for chart in ("map", "traces", "circle"):
        assert drawn(page, chart) > 3, chart
    assert page.execute_script("return [...document.querySelectorAll('svg path')].every(p => !/NaN/.test(p.outerHTML))")
    assert len(shown_laps(page)) == 2
    free = page.find_elements("css selector", "#laps-picked input:not(:checked)")
    free[0].click()
    assert len(shown_laps(page)) == 3
    page.find_element("id", "cursor").send_keys(Keys.ARROW_RIGHT)
    assert place(page) > 0.0
    Select(page.find_element("id", "theme")).select_by_value("dark")
    assert page.execute_script("return getComputedStyle(document.body).backgroundColor") == "rgb(20, 24, 28)"
    Select(page.find_element("id", "theme")).select_by_value("auto")
    paper = page.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})
    document = base64.b64decode(paper["data"])
    assert document.startswith(b"%PDF") and len(document) > 20_000
