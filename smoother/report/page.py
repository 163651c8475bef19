"""report.html: one file about a session, for a browser without a network, and for print.

A small script draws the charts as SVG. For comparison, Bokeh with inline resources costs 2.7 s of CPU (import and
serialising nine figures) and 2.1 MB, as much as smoothing ten minutes, and its canvases follow neither theme nor print
by style sheet.
"""

from pathlib import Path
from xml.etree.ElementTree import Element

from smoother.estimate.judge.check import USELESS, Check, check
from smoother.report import page_sections as words
from smoother.report import page_trust
from smoother.report.files import replacing
from smoother.report.page_charts import figure, grip, linked, picker, styled
from smoother.report.page_corners import corner_section
from smoother.report.page_data import MOST_DRAWN, Document, Numbers, drawn_laps, lap_name, page_data, stretches
from smoother.report.page_html import element
from smoother.report.page_sections import Report as Report
from smoother.samples import RawImu, RawMag, RawSession, Session


def write_page(path: Path, report: Report) -> None:
    """Write report.html."""
    with replacing(path) as temporary:
        temporary.write_text(page(report), encoding="utf-8", errors="replace")


def page(report: Report) -> str:
    """Return the page as text."""
    content = words.PageContent(**vars(report), check=recorded_check(report.session))
    numbers = page_data(Numbers(report.session, report.smoothed, report.baseline, report.laps))
    body = [
        words.header(content),
        _contents(content),
        element(
            "main", words.summary(content), *words.lap_section(content), *_charts(content, numbers), *_quality(content)
        ),
    ]
    return styled(content.title, body, numbers)


def recorded_check(session: Session) -> Check:
    """Return the check of the recording, from the calibrated samples."""
    imu, mag = session.imu, session.mag
    raw_imu = None
    if imu is not None:
        reach = imu.accel_full_scale, imu.gyro_full_scale
        raw_imu = RawImu(
            imu.t, imu.specific_force_s, imu.angular_rate_s, 1.0, 1.0, *reach, longest_step=imu.longest_step
        )
    raw_mag = None if mag is None else RawMag(mag.t, mag.field_s)
    why = tuple(problem for problem in session.problems if problem.code in USELESS)
    return check(RawSession(session.name, session.gnss, raw_imu, raw_mag, inputs=session.inputs, problems=why))


def _contents(content: words.PageContent) -> Element:
    places = [("laps", "Laps"), ("driving", "Map and traces"), ("corners", "Corners"), ("circle-title", "Grip")]
    places += [("compared", _comparison_title(content)), ("quality", "Can I trust this?")]
    has_laps, has_corners = (
        content.laps is not None and content.laps.laps,
        content.laps is not None and content.laps.corners,
    )
    hidden = {*(() if has_laps else ("laps",)), *(() if has_corners else ("corners",))}
    links = [element("a", name, href=f"#{place}") for place, name in places if place not in hidden]
    return element("nav", *links, aria_label="Contents")


def _charts(content: words.PageContent, numbers: Document) -> list[Element]:
    title = "Map and traces" if content.laps is not None and content.laps.traces is not None else "The session"
    drawn = "Fixes, baseline and smoother" if content.baseline is not None else "Fixes and smoother"
    return [
        element("h2", title, id="driving"),
        *_hidden_laps_note(content),
        _picker(content),
        linked(numbers),
        *corner_section(content.laps),
        element("h2", "Grip: accelerations forward and sideways", id="circle-title"),
        grip(_grip_caption(content)),
        element("h2", _comparison_title(content), id="compared"),
        element("p", _comparison_caption(content), class_="soft"),
        *words.baseline_section(content),
        element(
            "div",
            figure("compared-map", drawn),
            figure("compared-speed", "Speed"),
            class_="pair",
        ),
    ]


def _picker(content: words.PageContent) -> Element:
    laps = content.laps
    if laps is None or laps.traces is None:
        return picker(["whole session"], [], "Shown")
    return picker([lap_name(laps.laps[i]) for i in drawn_laps(laps)], stretches(laps))


def _hidden_laps_note(content: words.PageContent) -> list[Element]:
    """A note where not all laps are drawn."""
    laps = content.laps
    if laps is None or laps.traces is None or len(laps.laps) <= MOST_DRAWN:
        return []
    text = f"Of {len(laps.laps)} laps the {len(drawn_laps(laps))} quickest are shown here and below; laps.csv has all."
    return [element("p", text, class_="soft")]


def _grip_caption(content: words.PageContent) -> str:
    is_of_fixes = content.smoothed.report.mode == "gps-only"
    source = "the smoothed GPS speed" if is_of_fixes else "the motion sensor, gravity removed"
    return (
        "Each dot is the acceleration at one time: upwards accelerating, downwards braking, left and right cornering "
        "to that side. Grey: the whole session; in colour: the laps and the part of the track shown above. "
        f"Source: {source}."
    )


def _comparison_title(content: words.PageContent) -> str:
    return "Baseline against smoother" if content.baseline is not None else "GPS fixes against smoother"


def _comparison_caption(content: words.PageContent) -> str:
    which = "the best lap" if content.statistics is not None else "a minute around the top speed"
    baseline = "dashed: the baseline, an older method; " if content.baseline is not None else ""
    shown = f"Map and curves show {which}, the table the whole session. Dots on the map: GPS fixes as received; "
    return f"{shown}{baseline}solid: the smoother."


def _quality(content: words.PageContent) -> list[Element]:
    tables = [page_trust.recording_table(content), page_trust.residual_table(content)]
    return [
        element("h2", "Can I trust this?", id="quality"),
        *page_trust.trust(content),
        figure("quality-time", "Sigma, residuals and gaps over time"),
        element("div", *tables, class_="pair"),
        page_trust.identified_table(content),
    ]
