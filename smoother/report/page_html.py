"""Building a page as a tree of elements: whatever is put in is text, so nothing from a file can become markup.

The tree is the standard library's; it escapes texts and attributes when it is written. Style, script and the numbers
are joined to it afterwards, and a content security policy names the hashes of the only style and the only script that
a browser may apply: nothing else runs, and nothing is fetched.
"""

import base64
import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from xml.etree.ElementTree import Element, tostring

import numpy as np

from smoother.laps import clock
from smoother.units import KMH

_JSON_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}
Child = Element | str | None
DASH = "–"  # of an unknown value
SHORT = 16  # rows of a table that paper does not part
LONG = 60  # rows of a table that scrolls by itself, so that what follows it can be reached


def element(tag: str, *children: Child, **attributes: str) -> Element:
    """Return an element; a string among the children is text. `class_` and `for_` stand for the reserved words."""
    node = Element(tag, {name.rstrip("_").replace("_", "-"): cleaned(value) for name, value in attributes.items()})
    for child in children:
        if isinstance(child, Element):
            node.append(child)
        elif child is not None:
            _add_text(node, cleaned(child))
    return node


def _add_text(node: Element, text: str) -> None:
    if len(node):
        node[-1].tail = (node[-1].tail or "") + text
    else:
        node.text = (node.text or "") + text


def cleaned(text: str) -> str:
    """Return text without control characters and half pairs, which no page may hold; line breaks stay."""
    return "".join(c if c.isprintable() or c == "\n" else " " for c in text)


def table(header: Sequence[Child], rows: Sequence[Element], caption: str = "", class_: str = "") -> Element:
    """Return a table that scrolls sideways where the screen is narrow, and by itself where it has LONG rows or more;
    up to SHORT rows stay together on paper.

    `rows` as from :func:`row`.
    """
    head = element("thead", element("tr", *(_cell("th", name, {"scope": "col"}) for name in header)))
    title = [element("caption", caption)] if caption else []
    place = "scroll long" if len(rows) >= LONG else "scroll short" if len(rows) <= SHORT else "scroll"
    return element("div", element("table", *title, head, element("tbody", *rows), class_=class_), class_=place)


def row(*cells: Child, class_: str = "") -> Element:
    """Return a row; a cell that is an element `td` stays as it is."""
    made = [cell if isinstance(cell, Element) and cell.tag == "td" else _cell("td", cell, {}) for cell in cells]
    return element("tr", *made, **({"class_": class_} if class_ else {}))


def parted(name: str) -> list[Child]:
    """Return a name that a line may part before a slash and after _ and -, so that no word is cut beside them."""
    pieces = re.findall(r"/?[^/_-]*[_-]?", name)
    return [part for piece in pieces if piece for part in (element("wbr"), piece)][1:]


def _cell(tag: str, content: Child, attributes: Mapping[str, str]) -> Element:
    return element(tag, content, **attributes)


def json_in_script(document: object) -> str:
    """Return strict JSON that may stand inside a script element: no character of it can end the element."""
    return json.dumps(document, allow_nan=False, separators=(",", ":")).translate(_JSON_ESCAPES)


def whole_page(
    title: str, body: Sequence[Element], style: str, script: str, data: object = None, *, has_pictures: bool = False
) -> str:
    """Return the page: `data` as JSON in the element `data`, then the script. has_pictures: within the page itself."""
    policy = f"default-src 'none'; style-src {_hash(style)}; script-src {_hash(script)}; base-uri 'none'"
    policy += "; img-src data:" if has_pictures else ""
    head = (
        '<meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(cleaned(title))}</title><style>{style}</style>"
    )
    content = "".join(tostring(node, encoding="unicode", method="html") for node in body)
    numbers = f'<script type="application/json" id="data">{json_in_script(data)}</script>'
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n'
        f"<body>{content}\n{numbers}\n<script>{script}</script></body></html>\n"
    )


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def lap_clock(seconds: float, digits: int = 3) -> str:
    """Return 1:02.345, or 58.648 below a minute."""
    return clock.lap_clock(seconds, digits, DASH)


def number(value: float, digits: int = 2, signed: bool = False) -> str:
    """Return a number without a negative zero."""
    if not math.isfinite(value):
        return DASH
    return f"{round(value, digits) + 0.0:{'+' if signed else ''}.{digits}f}"


def with_sigma(value: float, sigma: float, digits: int, signed: bool = False) -> str:
    """Return value ± sigma, or the value alone."""
    text = number(value, digits, signed)
    return text if text == DASH or not (math.isfinite(sigma) and sigma > 0.0) else f"{text} ± {number(sigma, digits)}"


def settings() -> Element:
    """Unit of speed, and theme."""
    units = _select("units", "Speed", [("km/h", "km/h"), ("mph", "mph")])
    return element("div", units, theme(), class_="settings")


def theme() -> Element:
    """Light, dark, or the theme of the device."""
    return _select("theme", "Theme", [("auto", "as the device"), ("light", "light"), ("dark", "dark")])


def _select(name: str, label: str, options: list[tuple[str, str]]) -> Element:
    made = [element("option", text, value=value) for value, text in options]
    return element("label", f"{label} ", element("select", *made, id=name))


def card(name: str, value: Child, below: Child) -> Element:
    """One of the main results of a page: its name, its value, and a line below it."""
    return element("div", element("dt", name), element("dd", value, element("small", below)), class_="card")


def speed_cell(speed: float) -> Element:
    """A cell with a speed m/s, which the script shows in the chosen unit."""
    if not np.isfinite(speed):
        return element("td", DASH)
    return element("td", number(speed / KMH, 1), data_mps=f"{speed:.4f}")


def speed_span(speed: float, digits: int = 1) -> Element:
    """A speed m/s within a text, in the chosen unit, which :func:`speed_unit` shows."""
    more = {} if digits == 1 else {"data_digits": str(digits)}
    return element("span", number(speed / KMH, digits), data_mps=f"{speed:.5f}", **more)


def speed_unit() -> Element:
    """The chosen unit of speed."""
    return element("span", "km/h", class_="speed-unit")


def time_cell(time: float, sigma: float) -> Element:
    """A cell with a time and its sigma, s."""
    if not np.isfinite(time):
        return element("td", DASH)
    return element("td", lap_clock(time), element("small", f" ± {number(sigma, 3)}" if np.isfinite(sigma) else ""))
