"""Output of the command line: results on stdout, progress and warnings on stderr, without control characters.

Progress is drawn by rich, which is imported when it is needed, as it is slow to start.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TextIO

import click

Progress = Callable[[str, float], None]
"""Called with the name of a stage and its finished share (0..1)."""
NAME_COLUMNS, GUTTER = 12, "  "  # of pairs: the least width of names (and of values), and the gap between


def no_progress(stage: str, share: float) -> None:
    """Report nothing."""


def plain(text: object) -> str:
    """Return text without control characters: names come from files, and a terminal obeys escape sequences."""
    return "".join(c if c.isprintable() else " " for c in str(text))


def print_line(text: str) -> None:
    """Print one line on stdout, unwrapped."""
    click.echo(plain(text))


def print_json(document: str) -> None:
    """Print a JSON document on stdout."""
    click.echo(document, nl=not document.endswith("\n"))


def warn(text: str) -> None:
    """Print one line on stderr; a closed stream or a full disk is ignored."""
    try:
        click.echo(f"smooth: {plain(text)}", err=True)
    except OSError:
        discard_output(sys.stderr)


def open_page(path: Path) -> None:
    """Show a page in the browser; where there is none, print a line."""
    if sys.platform == "win32":
        click.launch(str(path))
        return
    opener = "open" if sys.platform == "darwin" else "xdg-open"
    try:
        none = subprocess.DEVNULL  # it reports on its own search
        # s after which the browser is assumed to be open
        is_open = subprocess.Popen([opener, str(path)], stdin=none, stdout=none, stderr=none).wait(3.0) == 0
    except subprocess.TimeoutExpired:  # the browser itself
        is_open = True
    except OSError:
        is_open = False
    if not is_open:
        warn(f"no browser found; open {path}")


def print_pairs(title: str, pairs: Iterable[tuple[str, str]]) -> None:
    """Print a title and, below it, names with their values in two columns; long values are wrapped."""
    rows = [(plain(name), plain(value)) for name, value in pairs]
    width = shutil.get_terminal_size().columns - len(GUTTER)
    # names that would leave their values less than half a line are wrapped too
    first = min(max([NAME_COLUMNS, *(len(name) for name, _ in rows)]), max(NAME_COLUMNS, width // 2))
    rest = max(width - first, NAME_COLUMNS)
    lines = [_styled(plain(title), bold=True)]
    for pair in rows:
        names, values = (
            textwrap.wrap(text, n, break_on_hyphens=False) for text, n in zip(pair, (first, rest), strict=True)
        )
        for name, part in itertools.zip_longest(names or [""], values, fillvalue=""):
            lines.append(f"{_styled(name, dim=True)}{' ' * (first - len(name))}{GUTTER}{part}".rstrip())
    click.echo("\n".join(lines))


def _styled(text: str, **style: bool) -> str:
    """Styled text; click removes the style where there is no terminal."""
    return click.style(text, **style) if text.strip() and os.environ.get("TERM") not in ("dumb", "unknown") else text


def print_table(title: str, header: list[str], rows: list[list[str]], left: int = 0) -> None:
    """Print a table whose cells are never cut, however narrow the terminal: column `left` to the left, others right."""
    lines = [[plain(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    click.echo(_styled(plain(title), bold=True))
    for cells in lines:
        padded = [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
        padded[left] = cells[left].ljust(widths[left])
        click.echo("  ".join(padded).rstrip())


def discard_output(stream: TextIO) -> None:
    """Discard all further output to a stream whose reader has gone (`smooth .. | head`)."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextlib.contextmanager
def progress_on_terminal(wanted: bool = True) -> Iterator[Progress]:
    """Yield a function that draws a progress line on stderr, if that is a terminal, and removes it at the end."""
    if not wanted or sys.stderr is None or not sys.stderr.isatty():  # None: closed (`2>&-`)
        yield no_progress
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda stage, share: bar.update(task, description=plain(stage), completed=share)


def number(value: float | None, digits: int = 2) -> str:
    """Return a number, or a dash where there is none."""
    return "-" if value is None or value != value else f"{value:.{digits}f}"
