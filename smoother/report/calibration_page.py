"""calibration.html: every number with its sigma and the figures, in the style of report.html and self-contained.

Nothing is computed here.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from smoother.documents import replacing
from smoother.report.page_charts import styled_alike
from smoother.report.page_html import Child, element, row, table, theme


@dataclass(frozen=True)
class Section:
    """One procedure: rows of (name, value ± sigma, unit, note), comparisons (name, before, after), remarks, figure."""

    title: str
    rows: Sequence[tuple[str, str, str, str]]
    comparisons: Sequence[tuple[str, str, str]] = ()
    remarks: Sequence[str] = ()
    figure: Path | None = None


def write_page(path: Path, title: str, sections: Sequence[Section], refusals: Sequence[tuple[str, str]]) -> None:
    """Write the page; refusals are (procedure, reason). What comes from files is text."""
    note = element("p", "Each number has one standard deviation (sigma).")
    body = [
        element("header", element("div", element("h1", title), note), element("div", theme(), class_="settings")),
        element("main", *(part for section in sections for part in _section(section)), *_refused(refusals)),
    ]
    with replacing(path) as temporary:
        temporary.write_text(styled_alike(title, body), encoding="utf-8", errors="replace")


def _section(section: Section) -> list[Element]:
    parts = [element("h2", section.title), *(element("p", remark, class_="soft") for remark in section.remarks)]
    if section.rows:
        parts.append(_words(["", "value ± sigma", "", ""], [(*cells, _soft(note)) for *cells, note in section.rows]))
    if section.comparisons:
        parts.append(_words(["", "before", "after"], section.comparisons))
    if section.figure is not None:
        data = base64.b64encode(section.figure.read_bytes()).decode("ascii")
        parts.append(element("figure", element("img", alt=section.title, src=f"data:image/png;base64,{data}")))
    return parts


def _refused(refusals: Sequence[tuple[str, str]]) -> list[Element]:
    if not refusals:
        return []
    return [element("h2", "Not calibrated"), _words(["", "why, and what to do"], refusals)]


def _words(heads: Sequence[str], rows: Sequence[Sequence[Child]]) -> Element:
    return table(heads, [row(*cells) for cells in rows], class_="words")


def _soft(note: str) -> Element:
    return element("td", note, class_="soft")
