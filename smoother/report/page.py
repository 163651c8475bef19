"""report.html: one file with everything about a session, for a browser without a network, and for paper.

Its charts are drawn by a small script of ours as SVG. A plotting library was measured first: Bokeh with inline
resources costs 2.7 s of CPU (import and serialising nine figures) and 2.1 MB, as much as smoothing ten minutes, and
its canvases follow neither theme nor paper by style sheet.
"""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from xml.etree.ElementTree import Element

from smoother.estimate.check import Check, check
from smoother.estimate.quality import Quality
from smoother.laps.results import LapAnalysis
from smoother.report import page_sections as words
from smoother.report.files import replacing
from smoother.report.page_data import Document, Numbers, drawn_laps, lap_name, page_data, stretches
from smoother.report.page_html import element, whole_page
from smoother.samples import RawImu, RawMag, RawSession, Session
from smoother.trajectory import Trajectory

TEMPLATE = files("smoother.report") / "template"


@dataclass(frozen=True, eq=False)
class Report:
    """What the page is made of. baseline, laps: None where there are none."""

    session: Session
    smoothed: Trajectory
    baseline: Trajectory | None
    laps: LapAnalysis | None
    quality: Quality


def write_page(path: Path, report: Report) -> None:
    """Write report.html."""
    with replacing(path) as temporary:
        temporary.write_text(page(report), encoding="utf-8")


def page(report: Report) -> str:
    """Return the page as text."""
    told = words.Told(
        report.session, report.smoothed, report.baseline, report.laps, report.quality, recorded_check(report.session)
    )
    numbers = page_data(Numbers(report.session, report.smoothed, report.baseline, report.laps))
    body = [
        words.header(told),
        _contents(told),
        element("noscript", element("p", "The charts need JavaScript; the tables do not.", class_="bad")),
        element("main", words.summary(told), *words.lap_section(told), *_charts(told, numbers), *_quality(told)),
    ]
    style, script = ((TEMPLATE / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    return whole_page(told.title, body, style, script, numbers)


def recorded_check(session: Session) -> Check:
    """Return what the sensors delivered, judged from the calibrated samples."""
    imu, mag = session.imu, session.mag
    raw_imu = None
    if imu is not None:
        reach = imu.accel_full_scale, imu.gyro_full_scale
        raw_imu = RawImu(imu.t, imu.specific_force_s, imu.angular_rate_s, 1.0, 1.0, *reach)
    raw_mag = None if mag is None else RawMag(mag.t, mag.field_s)
    return check(RawSession(session.name, session.gnss, raw_imu, raw_mag))


def _contents(told: words.Told) -> Element:
    places = [("laps", "Laps"), ("driving", "Map and traces"), ("corners", "Corners"), ("circle-title", "Grip")]
    places += [("compared", "Baseline against smoother"), ("quality", "Can I trust this?")]
    has_laps, has_corners = told.laps is not None and told.laps.laps, told.laps is not None and told.laps.corners
    hidden = {*(() if has_laps else ("laps",)), *(() if has_corners else ("corners",))}
    links = [element("a", name, href=f"#{place}") for place, name in places if place not in hidden]
    return element("nav", *links, aria_label="Contents")


def _charts(told: words.Told, numbers: Document) -> list[Element]:
    linked = element(
        "div",
        element("div", _figure("map", "Map of the laps, coloured by speed"), _readout(told), class_="stay"),
        element("div", _slider(numbers), _figure("traces", "Speed, time lost, accelerations and line over the track")),
        class_="linked",
    )
    title = "Map and traces" if told.laps is not None and told.laps.traces is not None else "The session"
    circle = element(
        "div",
        _figure("circle", "Accelerations forward and sideways in g"),
        element("p", _circle_words(told), class_="soft"),
        class_="pair",
    )
    return [
        element("h2", title, id="driving"),
        _picker(told),
        linked,
        *words.corner_section(told),
        element("h2", "Grip: accelerations forward and sideways", id="circle-title"),
        circle,
        element("h2", "Baseline against smoother", id="compared"),
        element("p", _compared_words(told), class_="soft"),
        *words.baseline_section(told),
        element(
            "div",
            _figure("compared-map", "Fixes, baseline and smoother"),
            _figure("compared-speed", "Speed"),
            class_="pair",
        ),
    ]


def _figure(name: str, label: str) -> Element:
    return element("figure", id=name, data_label=label)


def _picker(told: words.Told) -> Element:
    """Which laps are drawn, which of them colours the map, and which part of the track is shown."""
    laps = told.laps
    names = ["whole session"]
    parts: list[tuple[str, tuple[float, float]]] = []
    if laps is not None and laps.traces is not None:
        names, parts = [lap_name(laps.laps[i]) for i in drawn_laps(laps)], stretches(laps)
    boxes = [
        element("label", element("input", type="checkbox", value=str(i)), element("svg"), name, class_="lap")
        for i, name in enumerate(names)
    ]
    choices = [element("option", "whole lap" if parts else "everything", value="whole")]
    choices += [element("option", name, value=str(i)) for i, (name, _) in enumerate(parts)]
    choices.append(element("option", "own choice", value="own", disabled="disabled"))
    fields = element(
        "fieldset", element("legend", "Laps shown"), element("div", *boxes, class_="picker"), id="laps-picked"
    )
    coloured = element("label", "Speed colours: ", element("select", id="coloured"))
    part = element("label", "Part: ", element("select", *choices, id="stretch"))
    return element("div", fields, element("div", coloured, part, class_="settings"))


def _slider(numbers: Document) -> Element:
    last = str(numbers["points"])
    keys = (
        "Move over map or traces, or use the slider: arrow keys, with Shift ten steps; + and − zoom, Esc shows all. "
        "Drag over the traces to zoom, double-click to see all."
    )
    label = element("label", "Place: ", element("input", type="range", min="0", max=last, value="0", id="cursor"))
    where = element("output", id="where")
    return element("div", element("div", label, where, class_="settings"), element("p", keys, class_="keys"))


def _readout(told: words.Told) -> Element:
    unit = element("span", "km/h", class_="speed-unit")
    heads = ("lost (s)", "line (m)", "drive (g)", "side (g)")
    head = element("tr", element("th", "lap"), element("th", unit), *(element("th", name) for name in heads))
    body = element("tbody", id="readout")
    return element("div", element("table", element("thead", head), body), class_="scroll readout")


def _circle_words(told: words.Told) -> str:
    source = "the smoothed GPS speed" if told.smoothed.report.mode == "gps-only" else "the motion sensor"
    return (
        "Each dot is a moment: up is driving, down is braking, left and right are corners to that side. Grey: the "
        f"whole session; in colour: the laps and the part of the track shown above. From {source}, gravity removed."
    )


def _compared_words(told: words.Told) -> str:
    which = "the best lap" if told.statistics is not None else "a minute around the top speed"
    baseline = "dashed: the baseline, " if told.baseline is not None else ""
    return f"Of {which}. Dots: GPS fixes as received; {baseline}solid: the smoother."


def _quality(told: words.Told) -> list[Element]:
    tables = [words.recording_table(told), words.residual_table(told)]
    return [
        element("h2", "Can I trust this?", id="quality"),
        *words.trust(told),
        _figure("quality-time", "Sigma, residuals and gaps over time"),
        element("div", *tables, class_="pair"),
        words.identified_table(told),
    ]
