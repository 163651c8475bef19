"""calibration.html as text and in a browser, and what its figure of noise draws."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smoother.fit.allan import AllanDeviation, NoiseFigures
from smoother.report import style
from smoother.report.calibration_figures import allan, draw
from smoother.report.calibration_page import Section, write_page

from ..chromium import chromium, needs_chromium

NASTY = "<script>alert(1)</script>"


def noise(walk_is_seen: bool) -> NoiseFigures:
    """White noise, and a random walk as large as a short recording allows."""
    value = np.tile([0.1, 0.0, 0.05], (3, 1))
    seen = np.tile([True, False, walk_is_seen], (3, 1))
    return NoiseFigures(value, 0.8 * value, 2.0 * value, seen, np.zeros((3, 3, 3)))


def curve() -> AllanDeviation:
    tau = np.logspace(-1.0, 2.0, 20)
    white = np.tile((0.1 / np.sqrt(tau))[:, None], (1, 3))
    return AllanDeviation(tau, white, 0.1 * white)


@pytest.fixture
def page(tmp_path: Path) -> Path:
    figure = tmp_path / "noise.png"
    style.save(draw(allan, curves={"accelerometer": curve()} | {"gyroscope": curve()}, figures=both(True)), figure)
    wide = " | ".join(["0.9831 ± 0.0020, 0.0026 ± 0.0011, 0.0279 ± 0.0015"] * 3)
    rows = [("hard iron", "1.0 ± 0.1, 2.0 ± 0.1", "units", NASTY), ("soft iron", wide, "", "not seen: x")]
    sections = [Section(NASTY, rows, [("length of the field", "13 %", "0.4 %")], [NASTY, "8190 readings"], figure)]
    write_page(tmp_path / "calibration.html", f"Calibration from {NASTY}", sections, [("gyroscope scale", NASTY)])
    return tmp_path / "calibration.html"


def both(walk_is_seen: bool) -> dict[str, NoiseFigures]:
    return {"accelerometer": noise(walk_is_seen), "gyroscope": noise(walk_is_seen)}


def test_the_axes_of_noise_are_labelled_without_powers_of_ten() -> None:
    for axes in draw(allan, curves={"accelerometer": curve(), "gyroscope": curve()}, figures=both(True)).axes:
        for axis in (axes.xaxis, axes.yaxis):
            labels = [label.get_text() for label in axis.get_ticklabels(which="both") if label.get_text()]
            assert len(labels) >= 3 and not any("10^" in label or "e-" in label for label in labels), labels


def test_it_has_the_style_of_the_other_pages_and_loads_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in text
    assert "prefers-color-scheme: dark" in text and '<select id="theme">' in text
    assert "<script>alert" not in text and text.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 5
    assert not re.findall(r"(?:href|src)=\"(?!#|data:image/png;base64,)", text)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None and policy[1].startswith("default-src 'none'") and "unsafe" not in policy[1]


@needs_chromium
def test_it_fits_a_telephone_shows_its_figures_and_follows_the_theme(page: Path) -> None:
    from selenium.webdriver.support.select import Select
    from selenium.webdriver.support.wait import WebDriverWait

    with chromium() as browser:
        phone = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
        browser.get(page.as_uri())
        assert browser.execute_script("return innerWidth") == 390
        assert browser.execute_script("return document.documentElement.scrollWidth") == 390
        assert browser.execute_script("return [...document.images].every(i => i.naturalWidth > 0 && i.width <= 390)")
        theme = Select(browser.find_element("id", "theme"))
        looks = []
        for name in ("dark", "light", "dark"):
            theme.select_by_value(name)
            looks.append(browser.execute_script("return getComputedStyle(document.body).backgroundColor"))
        assert looks == ["rgb(20, 24, 28)", "rgb(255, 255, 255)", "rgb(20, 24, 28)"]

        def is_dark_again(browser: Any) -> bool:
            browser.refresh()  # what a page stores reaches the process of the next one with some delay
            return bool(browser.execute_script("return getComputedStyle(document.body).backgroundColor") == looks[-1])

        assert WebDriverWait(browser, 10).until(is_dark_again)
        assert browser.get_log("browser") == []


@pytest.mark.parametrize("walk_is_seen", [True, False])
def test_noise_that_was_not_seen_is_not_in_the_line(walk_is_seen: bool) -> None:
    figure = draw(allan, curves={"accelerometer": curve(), "gyroscope": curve()}, figures=both(walk_is_seen))
    for axes, factor in zip(figure.axes, (1.0, 180.0 / np.pi), strict=True):
        line = axes.lines[1]  # of x, after its points
        tau, drawn = (np.asarray(values, dtype=np.float64) for values in line.get_data())
        walk = 0.05**2 * tau / 3.0 if walk_is_seen else 0.0
        np.testing.assert_allclose(drawn, factor * np.sqrt(0.1**2 / tau + walk), rtol=1e-9)
