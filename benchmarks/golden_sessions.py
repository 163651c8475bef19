"""Sessions for the golden table: simulated once and cached; copies with rows of their files left out or changed."""

import contextlib
import hashlib
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from golden_command import ENVIRONMENT, Array, Bench, link_files

SIMULATOR = Path(__file__).resolve().parents[1] / "smoother" / "sim"
FIGURES = "figures.txt"  # in the cache beside the session: every figure of the simulation, the true values


def simulated(bench: Bench, arguments: Iterable[str]) -> Path:
    """Return the folder of a simulated session, made on the first call for these arguments.

    Beside its files stands FIGURES. The name of the folder depends on the arguments and on the sources of the
    simulator, so that a changed simulator is never measured on sessions of the old one.
    """
    words = list(arguments)
    key = hashlib.sha256("\0".join([*words, _sources()]).encode()).hexdigest()[:16]
    folder = bench.cache / "simulated" / key
    if folder.is_dir():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
        made = Path(temporary) / "session"
        _simulate(bench.simulator, "simulate", str(made), *words)
        (made / FIGURES).write_text(_simulate(bench.simulator, "simulate", "--list", str(made), *words), "utf-8")
        with contextlib.suppress(OSError):  # another process was first: its files are the same
            made.rename(folder)
    return folder


def true_figures(folder: Path) -> dict[str, Array]:
    """Return the figures of a simulated session that are numbers, each (K,)."""
    figures = {}
    for line in (folder / FIGURES).read_text("utf-8").splitlines():
        name, _, text = line.partition(" ")
        with contextlib.suppress(ValueError):
            figures[name] = np.array([float(word) for word in text.strip().split(",")])
    return figures


def copy_of_simulated(folder: Path, target: Path) -> None:
    """Link the files of a simulated session that a smoother may see, and its truth, into a folder."""
    names = [path.name for path in folder.iterdir() if path.name != FIGURES]
    link_files(folder, target, names)


Edit = Callable[[list[str], list[list[str]]], tuple[list[str], list[list[str]]]]
"""Header and rows of cells of a CSV file, to those that are written in their place."""


def edit_csv(path: Path, edit: Edit) -> None:
    """Replace a CSV file (a link is replaced, not what it leads to) by its edited rows; cells stay text as they are."""
    header, *rows = [line.split(",") for line in path.read_text("utf-8").splitlines() if line]
    header, rows = edit(header, rows)
    text = "\n".join(",".join(cells) for cells in [header, *rows]) + "\n"
    path.unlink()
    path.write_text(text, "utf-8")


def edit_column(name: str, change: Callable[[Array], Array], digits: int) -> Edit:
    """Return an edit that changes the numbers (N,) of one column; empty cells are NaN and stay empty."""

    def edit(header: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
        i = header.index(name)
        values = change(np.array([float(row[i]) if row[i] else np.nan for row in rows]))
        return set_columns((name,), values[:, None], digits)(header, rows)

    return edit


def set_columns(names: Sequence[str], values: Array, digits: int) -> Edit:
    """Return an edit that puts values (N, K) into the columns of these names; NaN is an empty cell."""

    def edit(header: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
        changed = [list(row) for row in rows]
        for i, numbers in zip((header.index(name) for name in names), values.T, strict=True):
            for row, number in zip(changed, numbers, strict=True):
                row[i] = "" if np.isnan(number) else f"{number:.{digits}f}"
        return header, changed

    return edit


def keep_rows(kept: Iterable[int]) -> Edit:
    """Return an edit that keeps the rows of these numbers, in this order."""
    numbers = [int(i) for i in kept]
    return lambda header, rows: (header, [rows[i] for i in numbers])


def _simulate(smooth: Path, *words: str) -> str:
    process = subprocess.run(
        [str(smooth), *words], capture_output=True, text=True, env={**os.environ, **ENVIRONMENT}, check=False
    )
    if process.returncode != 0:
        raise RuntimeError(f"smooth {' '.join(words)}: exit code {process.returncode}: {process.stderr.strip()}")
    return process.stdout


def _sources() -> str:
    digest = hashlib.sha256()
    for path in sorted(SIMULATOR.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
