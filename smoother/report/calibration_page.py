"""calibration.html: one self-contained page with every number, its sigma and the figures. Writes; computes nothing."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from smoother.documents import replacing

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .4rem; border-top: 1px solid #ddd; padding-top: 1rem; }
table { border-collapse: collapse; margin: .5rem 0; }
td, th { padding: .15rem 1.2rem .15rem 0; text-align: left; vertical-align: top; }
th { font-weight: 600; border-bottom: 1px solid #bbb; }
td.n { font-variant-numeric: tabular-nums; }
p { margin: .3rem 0; } .note { color: #666; } img { max-width: 100%; margin: .6rem 0; }
"""


@dataclass(frozen=True)
class Section:
    """One procedure: rows of (name, value ± sigma, unit, note), comparisons (name, before, after), remarks, figure."""

    title: str
    rows: Sequence[tuple[str, str, str, str]]
    comparisons: Sequence[tuple[str, str, str]] = ()
    remarks: Sequence[str] = ()
    figure: Path | None = None


def write_page(path: Path, title: str, sections: Sequence[Section], refusals: Sequence[tuple[str, str]]) -> None:
    """Write the page; refusals are (procedure, reason). Texts from files are escaped."""
    parts = [f"<h1>{escape(title)}</h1>", "<p>Each number stands with one standard deviation (sigma).</p>"]
    parts += [_section(section) for section in sections]
    if refusals:
        rows = "".join(f"<tr><td>{escape(name)}</td><td>{escape(reason)}</td></tr>" for name, reason in refusals)
        parts.append(f"<h2>Not calibrated</h2><table><tr><th></th><th>why, and what to do</th></tr>{rows}</table>")
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{_STYLE}</style>'
    text = f'<!DOCTYPE html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>\n'
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _section(section: Section) -> str:
    parts = [f"<h2>{escape(section.title)}</h2>"]
    parts += [f'<p class="note">{escape(remark)}</p>' for remark in section.remarks]
    if section.rows:
        rows = "".join(_row(*row) for row in section.rows)
        parts.append(f"<table><tr><th></th><th>value ± sigma</th><th></th><th></th></tr>{rows}</table>")
    if section.comparisons:
        rows = "".join(
            f'<tr><td>{escape(name)}</td><td class="n">{escape(before)}</td><td class="n">{escape(after)}</td></tr>'
            for name, before, after in section.comparisons
        )
        parts.append(f"<table><tr><th></th><th>before</th><th>after</th></tr>{rows}</table>")
    if section.figure is not None:
        data = base64.b64encode(section.figure.read_bytes()).decode("ascii")
        parts.append(f'<img alt="{escape(section.title)}" src="data:image/png;base64,{data}">')
    return "".join(parts)


def _row(name: str, value: str, unit: str, note: str) -> str:
    cells = f'<td>{escape(name)}</td><td class="n">{escape(value)}</td><td>{escape(unit)}</td>'
    return f'<tr>{cells}<td class="note">{escape(note)}</td></tr>'
