"""Golden tables as text, one value a line: format, tolerances, reading, comparison."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from statistics import median

Value = float | int | str
Columns = dict[str, Value]
Rows = dict[str, Columns]
Texts = dict[tuple[str, str], str]
"""Value, as it stands in the file, of each row and column."""

TOLERANCES: tuple[tuple[str, float, float], ...] = (
    # pattern of a column, relative, absolute; the first that fits counts. What a table's head lacks must be equal.
    ("identified.*latency", 0.0, 0.002),
    ("identified.*delay", 0.0, 0.002),
    ("identified.*.sigma*", 0.1, 1e-5),
    ("identified.R_bs.*", 0.0, 0.005),
    ("identified.gps_offset_*", 0.1, 0.02),
    ("identified.mag_*", 0.05, 0.02),
    ("identified.*_noise*", 0.05, 1e-4),
    ("identified.*", 0.05, 0.01),
    ("error.mount_deg", 0.05, 0.05),
    ("error.*", 0.04, 0.003),
    ("left_out.*", 0.04, 0.003),
    ("lag.*", 0.0, 0.003),
    ("sigma.*", 0.04, 0.001),
    ("size.*", 0.02, 0.005),
    ("within*", 0.0, 0.03),
    ("nees", 0.06, 0.1),
    ("z.laps_rms", 0.1, 0.1),
    ("z.*", 0.0, 0.25),
    ("lap.*.time", 0.0, 0.005),
    ("lap.*.sigma", 0.08, 0.001),
    ("line_change.*", 0.05, 0.01),
    ("rejected.*", 0.1, 2.0),
    ("residual.*", 0.04, 0.005),
    ("problem.*", 0.05, 1.0),
    ("change.*", 0.2, 0.05),
    ("ratio.*", 0.02, 0.0),
    ("figure.*", 0.0, math.inf),  # read, never compared
    ("fixes_used", 0.005, 0.0),
    ("duration", 0.0, 0.05),
    ("distance", 0.003, 1.0),
)
DIGITS = 4  # significant, of every number
LAP_TIME, LAP_TIME_DIGITS = "lap.*.time", 6  # a hundredth of a lap's second is half its sigma
SMALLEST = 1e-6  # a figure below it is rounding
HEAD = "# column  relative  absolute"


@dataclass(frozen=True)
class Change:
    """A value that is not what it was; before or after is empty where a row has no such column."""

    row: str
    column: str
    before: str
    after: str
    sigma: float | None
    excess: float  # change over tolerance: above 1 it counts

    @property
    def relative(self) -> float | None:
        """Change relative to the value before; None of texts and of zero."""
        before, after = number(self.before), number(self.after)
        return None if before is None or after is None or before == 0 else (after - before) / abs(before)

    @property
    def sigmas(self) -> float | None:
        """Change over the value's own sigma, where it has one."""
        before, after = number(self.before), number(self.after)
        if before is None or after is None or not self.sigma:
            return None
        return (after - before) / self.sigma

    def __str__(self) -> str:
        percent = "" if self.relative is None else f"{100 * self.relative:+.1f} %"
        sigmas = "" if self.sigmas is None else f"{self.sigmas:+.2f} sigma"
        words = f"{self.row}  {self.column}: {self.before or '(none)'} -> {self.after or '(none)'}"
        return "  ".join(word for word in (words, percent, sigmas, f"({self.excess:.3g} tolerances)") if word)


def number(text: str) -> float | None:
    """Return the number a text is, None if it is none."""
    try:
        return float(text)
    except ValueError:
        return None


def text_of(value: Value, digits: int = DIGITS) -> str:
    """Return a value as a table has it."""
    if isinstance(value, str):
        return " ".join(value.split()) or "-"
    if isinstance(value, int):
        return str(value)
    return "0" if abs(value) < SMALLEST else f"{value:.{digits}g}"


def texts_of(rows: Mapping[str, Mapping[str, Value]]) -> Texts:
    """Return the texts of all values."""
    return {
        (row, column): text_of(value, LAP_TIME_DIGITS if fnmatchcase(column, LAP_TIME) else DIGITS)
        for row, values in rows.items()
        for column, value in values.items()
    }


def write_table(path: Path, texts: Texts) -> None:
    """Write a table: tolerances of the columns that occur, then a value a line, sorted."""
    names = {column for _, column in texts}
    used = {next((t for t in TOLERANCES if fnmatchcase(name, t[0])), None) for name in names}
    lines = [HEAD, *(f"# {p}  {r:g}  {a:g}" for p, r, a in TOLERANCES if (p, r, a) in used)]
    wide = max((len(row) for row, _ in texts), default=0)
    broad = max((len(column) for _, column in texts), default=0)
    lines += [f"{row:<{wide}}  {column:<{broad}}  {texts[row, column]}" for row, column in sorted(texts)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_table(path: Path) -> tuple[Texts, list[tuple[str, float, float]]]:
    """Return the values of a table and the tolerances of its head."""
    texts: Texts = {}
    tolerances = []
    for line in path.read_text("utf-8").splitlines():
        if line.startswith("#"):
            if line != HEAD:
                pattern, relative, absolute = line[1:].split()
                tolerances.append((pattern, float(relative), float(absolute)))
        elif line:
            row, column, text = line.split(None, 2)
            texts[row, column] = text
    return texts, tolerances


def changes(
    before: Texts, after: Texts, tolerances: Sequence[tuple[str, float, float]], rows: Iterable[str] | None = None
) -> list[Change]:
    """Return what differs at all between two tables, worst first; of some rows, or of all that either has."""
    wanted = None if rows is None else set(rows)
    found = []
    for row, column in sorted(before.keys() | after.keys()):
        if wanted is not None and row not in wanted:
            continue
        old, new = before.get((row, column), ""), after.get((row, column), "")
        if old == new:
            continue
        sigma = number(before.get((row, f"{column}.sigma"), ""))
        found.append(Change(row, column, old, new, sigma, _excess(old, new, column, tolerances)))
    return sorted(found, key=lambda change: (-change.excess, change.row, change.column))


def beyond(found: Iterable[Change]) -> list[Change]:
    """Return the changes that exceed their tolerance."""
    return [change for change in found if change.excess > 1.0]


def summary(found: Iterable[Change], before: Texts, prefix: str = "") -> list[str]:
    """Return a line a column: median change in per cent over the rows that have it, unchanged ones included."""
    relative: dict[str, list[float]] = {}
    for change in found:
        if change.row.startswith(prefix) and change.relative is not None and math.isfinite(change.relative):
            relative.setdefault(change.column, []).append(change.relative)
    lines = []
    for column, values in relative.items():
        count = sum(name == column and row.startswith(prefix) for row, name in before)
        middle = median([*values, *([0.0] * (count - len(values)))])
        if abs(middle) >= 0.0005:
            lines.append((abs(middle), f"{column}: median {100 * middle:+.1f} % over {count} rows"))
    return [line for _, line in sorted(lines, reverse=True)]


def _excess(old: str, new: str, column: str, tolerances: Sequence[tuple[str, float, float]]) -> float:
    before, after = number(old), number(new)
    if before is None or after is None or not (math.isfinite(before) and math.isfinite(after)):
        return math.inf
    _, relative, absolute = next((t for t in tolerances if fnmatchcase(column, t[0])), ("", 0.0, 0.0))
    tolerance = absolute + relative * abs(before)
    return abs(after - before) / tolerance if tolerance > 0 else math.inf
