"""Elements of pages with charts: placeholders of charts, selection of laps and parts, style and script."""

from collections.abc import Sequence
from importlib.resources import files
from xml.etree.ElementTree import Element

from smoother.report.page_data import Document
from smoother.report.page_html import LONG, element, whole_page

TEMPLATE = files("smoother.report") / "template"
Part = tuple[str, tuple[float, float]]  # of the track: name, and ends in m


def styled(title: str, body: Sequence[Element], numbers: Document) -> str:
    """Return the page with the one style and script of all pages; body begins with the header."""
    note = element("noscript", element("p", "The charts need JavaScript; the tables do not.", class_="bad"))
    return whole_page(title, [body[0], note, *body[1:]], _text("page.css"), _text("theme.js", "page.js"), numbers)


def styled_alike(title: str, body: Sequence[Element]) -> str:
    """Return a page of tables and pictures with the style and theme of the pages with charts."""
    return whole_page(title, body, _text("page.css"), _text("theme.js"), has_pictures=True)


def _text(*names: str) -> str:
    return "".join((TEMPLATE / name).read_text(encoding="utf-8") for name in names)


def figure(name: str, label: str) -> Element:
    """Placeholder of a chart, which the script draws."""
    return element("figure", id=name, data_label=label)


def linked(numbers: Document) -> Element:
    """Map with readout, and traces with the slider that moves through them."""
    return element(
        "div",
        element("div", figure("map", "Map of the laps, coloured by speed"), _readout(numbers), class_="stay"),
        element("div", _slider(numbers), figure("traces", "Speed, time lost, accelerations and line over the track")),
        class_="linked",
    )


def grip(words: str) -> Element:
    """The diagram of accelerations, with words beside it."""
    circle = figure("circle", "Accelerations forward and sideways in g")
    return element("div", circle, element("p", words, class_="soft"), class_="pair")


def picker(names: Sequence[str], parts: Sequence[Part], legend: str = "Laps shown") -> Element:
    """Which laps are drawn, which of them colours the map, and which part of the track is shown."""
    boxes = [
        element("label", element("input", type="checkbox", value=str(i)), element("svg"), name, class_="lap")
        for i, name in enumerate(names)
    ]
    choices = [element("option", "whole lap" if parts else "everything", value="whole")]
    choices += [element("option", name, value=str(i)) for i, (name, _) in enumerate(parts)]
    choices.append(element("option", "own choice", value="own", disabled="disabled"))
    kind = "picker many" if len(names) >= LONG else "picker"
    fields = element("fieldset", element("legend", legend), element("div", *boxes, class_=kind), id="laps-picked")
    coloured = element("label", "Speed colours: ", element("select", id="coloured"))
    part = element("label", "Part: ", element("select", *choices, id="stretch"))
    return element("div", fields, element("div", coloured, part, class_="settings"))


def _slider(numbers: Document) -> Element:
    last = str(numbers["points"])
    keys = (
        "Move over map or traces, or use the slider (arrow keys, with Shift ten steps). Drag over the traces, or "
        "press + and −, to zoom; double-click, or press Esc, to see all."
    )
    label = element("label", "Distance: ", element("input", type="range", min="0", max=last, value="0", id="cursor"))
    where = element("output", id="where")
    return element("div", element("div", label, where, class_="settings"), element("p", keys, class_="keys"))


def _readout(numbers: Document) -> Element:
    unit = element("span", "km/h", class_="speed-unit")
    channels = numbers.get("channels", [])
    assert isinstance(channels, list)
    heads = ("lost (s)", "line (m)", "drive (g)", "side (g)", *(channel["title"] for channel in channels))
    head = element("tr", element("th", "lap"), element("th", unit), *(element("th", name) for name in heads))
    body = element("tbody", id="readout")
    return element("div", element("table", element("thead", head), body), class_="scroll readout")
