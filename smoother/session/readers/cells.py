"""Values of cells as people and programs write them: numbers with units or separators, angles, words of quality.

Cells are text (N,). What a column means by a comma is decided by the whole column, never by one cell.
"""

import re
from collections import Counter
from dataclasses import dataclass

import numpy as np
import polars as pl

from smoother.arrays import Array

NOTHING = re.compile(r"(?i)^(?:[-*?.]+|#?n[./]?a\.?|nil|null|none|nan)$")  # as programs write cells without a number
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_WITH_UNIT = rf"^({_NUMBER})\s*([A-Za-z°%µμΩ][A-Za-z°%µμΩ/·*^²]*2?)$"
_SPACES = r"(\d)[   '’](\d{3})"  # between thousands
_GROUPS = r"^[-+]?\d{1,3}(?:,\d{3})+(?:\.\d+)?$"  # 1,234 and 1,234.5
_POINT_GROUPS = r"^[-+]?\d{1,3}(?:\.\d{3})+,\d+$"  # 1.234,5
_LETTER = r"[NSEWOnsewo]"
_PART = r"\d+(?:[.,]\d+)?"
_ANGLE = re.compile(
    rf"^\s*(?P<before>{_LETTER})?\s*(?P<sign>[-+−])?\s*(?P<deg>{_PART})\s*(?:[°ºd:]|deg)?\s*"
    rf"(?:(?<![\d.,])(?P<min>{_PART})\s*(?:['′’m:]|min)?\s*)?"
    rf"(?:(?<![\d.,])(?P<sec>{_PART})\s*(?:[\"″”s]|''|′′|sec)?\s*)?(?P<after>{_LETTER})?[a-z]*\s*$",
    re.IGNORECASE,
)
_EAST_OR_WEST = re.compile(r"^\s*[EWO]\w*\s*$", re.IGNORECASE)
_NORTH_OR_SOUTH = re.compile(r"^\s*[NS]\w*\s*$", re.IGNORECASE)
NO_FIX = re.compile(r"(?i)^(?:no ?fix|none|invalid|false|void|v|no|not? valid|0)$")
MOSTLY = 0.5  # of the cells of a column
LONGEST_ANGLE = 40  # letters of a cell; more is damage, of which every reading would be tried
SEMICIRCLE = 180.0 / 2**31  # deg
LARGEST_OF_MINUTES = 18060.0  # of longitude, as dddmm.mmmm
MOST_WORDS, LONGEST_WORD = 4, 8  # different ones in a column of hemispheres, and their letters


@dataclass(frozen=True, eq=False)
class Numbers:
    """Values (N,) of a column, NaN where a cell is no number; how many hold something else; the unit written in most.

    cells (N,) : as they stand, where they may be text.
    """

    values: Array
    unread: int = 0
    unit: str = ""
    cells: pl.Series | None = None


def numbers_of(cells: pl.Series, *, has_decimal_commas: bool = False) -> Numbers:
    """Return the numbers of a column of text (N,). has_decimal_commas : what parts its cells is no comma."""
    text = cells.str.strip_chars()
    plain = text.cast(pl.Float64, strict=False)
    odd = (plain.is_null() & (text != "") & ~text.str.contains(NOTHING.pattern)).fill_null(value=False)
    unit = ""
    if odd.any():
        filled = int((text != "").fill_null(value=False).sum())
        is_usual = MOSTLY * filled <= int(odd.sum())  # a unit is written in all cells, a damaged digit in one
        some, unit = _plain(text.filter(odd), has_decimal_commas or _all_odd(text, odd), is_usual)
        values = plain.to_numpy(writable=True)
        values[odd.to_numpy()] = floats(some)
        unread = int(np.count_nonzero(np.isnan(values[odd.to_numpy()])))
        return Numbers(np.where(np.isfinite(values), values, np.nan), unread, unit)
    return Numbers(floats(plain))


def _all_odd(text: pl.Series, odd: pl.Series) -> bool:
    """Whether no cell that holds something is a plain number."""
    filled = (text != "").fill_null(value=False) & ~text.str.contains(NOTHING.pattern).fill_null(value=True)
    return int(odd.sum()) == int(filled.sum())


def _plain(text: pl.Series, are_all: bool, may_have_unit: bool) -> tuple[pl.Series, str]:
    """Cells that no plain number is in, as numbers; and their unit. are_all : no other cell of the column is one."""
    text = (
        text.str.replace_all(_SPACES, "${1}${2}")
        .str.replace_all(_SPACES, "${1}${2}")
        .str.replace("−", "-", literal=True)
    )
    commas = text.str.contains(",", literal=True)
    if commas.any():
        grouped = text.str.contains(_GROUPS)
        by_point = text.str.contains(_POINT_GROUPS)
        has_points = (commas & text.str.contains(r"\d,\d{3}(?:,\d{3})*\.\d")).any()
        if has_points or (not are_all and bool((grouped | ~commas).all())):
            text = text.str.replace_all(",", "", literal=True)
        else:
            bare = text.str.replace_all(".", "", literal=True)
            frame = pl.DataFrame({"text": text, "bare": bare, "by_point": by_point})
            text = frame.select(pl.when("by_point").then("bare").otherwise("text").alias("text"))["text"]
            text = text.str.replace(",", ".", literal=True)
    if not may_have_unit:
        return text.cast(pl.Float64, strict=False), ""
    parts = text.str.extract_groups(_WITH_UNIT).struct.unnest()
    values = pl.select(pl.coalesce(text.cast(pl.Float64, strict=False), parts["1"].cast(pl.Float64, strict=False)))
    units = Counter(parts["2"].str.strip_chars().drop_nulls().to_list())
    unit, count = units.most_common(1)[0] if units else ("", 0)
    return values.to_series(), unit if 2 * count > len(text) else ""


def degrees_of(cells: pl.Series, *, is_longitude: bool, letters: Array | None = None) -> Array:
    """Degrees (N,) of a column of angles: with decimals, minutes or seconds, with letters, or NMEA's ddmm.mmmm.

    letters (N,) : +1 or -1 by a column of hemispheres beside it, NaN where that says nothing.
    """
    values, by_letter = _angles(cells)
    signs = letters if by_letter is None else by_letter
    if signs is None:
        return values
    known = np.isfinite(signs)
    middle = float(np.median(np.abs(values[np.isfinite(values)]))) if np.isfinite(values).any() else 0.0
    if middle > (180.0 if is_longitude else 90.0) and middle < LARGEST_OF_MINUTES:  # as sentences have it
        size = np.abs(values)
        values = np.where(size % 100.0 < 60.0, size // 100.0 + size % 100.0 / 60.0, np.nan)
    return np.where(known, np.abs(values) * signs, values)


def _angles(cells: pl.Series) -> tuple[Array, Array | None]:
    """Angles (N,) in degrees and their signs (N,) by letters, None where there are none."""
    numbers = numbers_of(cells)
    if not numbers.unread and not numbers.unit:
        return numbers.values, None
    text = cells.fill_null("").to_list()
    values, signs = np.full(len(text), np.nan), np.full(len(text), np.nan)
    is_east = any("E" in cell.upper() for cell in text)
    for i, cell in enumerate(text):
        if len(cell) > LONGEST_ANGLE or (match := _ANGLE.match(cell)) is None:
            continue
        deg, minutes, seconds = (float((match[key] or "0").replace(",", ".")) for key in ("deg", "min", "sec"))
        if not (minutes < 60.0 and seconds < 60.0):
            continue
        letter = (match["before"] or match["after"] or "").upper()
        size = deg + minutes / 60.0 + seconds / 3600.0
        values[i] = -size if match["sign"] in ("-", "−") else size
        signs[i] = sign_of(letter, is_east=is_east)
    return values, signs if np.isfinite(signs).any() else None


def sign_of(letter: str, *, is_east: bool) -> float:
    """+1 for north and east, -1 for south and west, else NaN. O is east in German, west where E is east."""
    return {"N": 1.0, "S": -1.0, "E": 1.0, "W": -1.0, "O": -1.0 if is_east else 1.0}.get(letter[:1].upper(), np.nan)


def hemispheres_of(cells: pl.Series, *, is_longitude: bool) -> Array | None:
    """Signs (N,) by a column of letters or words, None where it holds anything else or nothing."""
    different = [text for text in cells.unique().drop_nulls().to_list() if text.strip()]
    form = _EAST_OR_WEST if is_longitude else _NORTH_OR_SOUTH
    if not different or len(different) > 4 or not all(form.match(text) for text in different):
        return None
    is_east = any(text.strip().upper().startswith("E") for text in different)
    signs = {text: sign_of(text.strip(), is_east=is_east) for text in different}
    return floats(cells.replace_strict(list(signs), list(signs.values()), default=None, return_dtype=pl.Float64))


def qualities_of(cells: pl.Series) -> Array:
    """Quality (N,) of fixes: a number as it stands; of words 0 for those of no fix and 1 for others; NaN for none."""
    numbers = numbers_of(cells)
    if not numbers.unread:
        return numbers.values
    filled = (cells.str.strip_chars() != "").fill_null(value=False).to_numpy()
    none = cells.str.strip_chars().str.contains(NO_FIX.pattern).fill_null(value=False).to_numpy()
    words = np.where(filled, np.where(none, 0.0, 1.0), np.nan)
    return np.where(np.isfinite(numbers.values), numbers.values, words)


def are_words(column: Numbers) -> bool:
    """Whether the cells of a column are few different short words."""
    if column.cells is None or np.isfinite(column.values).any():
        return False
    different = column.cells.unique().drop_nulls().to_list()
    return len(different) <= MOST_WORDS and all(len(word) <= LONGEST_WORD for word in different)


def floats(series: pl.Series) -> Array:
    """Return the values (N,) of a series, NaN for null and infinite ones."""
    return finite(series.fill_null(np.nan).to_numpy())


def finite(values: Array) -> Array:
    """Return values (N,), NaN for infinite ones; the same array where there are none."""
    return values if np.isfinite(values).all() else np.where(np.isfinite(values), values, np.nan)
