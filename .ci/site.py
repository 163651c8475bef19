"""Hooks of MkDocs: formulas as MathML, which browsers show without a script; roles of docstrings as code."""

import html
import re

from latex2mathml.converter import convert

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
ROLE = re.compile(r":(?:func|class|mod|meth|data|attr):(?=<code>)")


def on_page_content(content: str, **_: object) -> str:
    """Called with the HTML of each page."""
    return ROLE.sub("", FORMULA.sub(_formula, content))


def _formula(found: re.Match[str]) -> str:
    return str(convert(html.unescape(found[2]), display="block" if found[1] == "div" else "inline"))
