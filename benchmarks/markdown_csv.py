"""Tables in Markdown, as benchmarks print them, made into CSV: one column more with the heading above each table.

python benchmarks/calibration_honesty.py | python benchmarks/markdown_csv.py > docs/tables/calibration_honesty.csv
"""

import csv
import re
import sys
from collections.abc import Iterable, Iterator


def cells_of(line: str) -> list[str]:
    """Cells of a row without bold marks."""
    return [cell.strip().strip("*") for cell in line.strip().strip("|").split("|")]


def rows_of(lines: Iterable[str]) -> Iterator[list[str]]:
    """Rows of all tables; a header line wherever it differs from the one before."""
    title, header, before = "", [""], ""
    for line in lines:
        if line.startswith("#"):
            title = line.lstrip("# ").strip()
        elif re.fullmatch(r"[|\s:-]+", line.strip() or "."):  # the line below a header
            if cells_of(before) != header:
                header = cells_of(before)
                yield ["table", *header]
        elif line.startswith("|") and before.startswith("|"):
            yield [title, *cells_of(line)]
        before = line.strip()


if __name__ == "__main__":
    csv.writer(sys.stdout, lineterminator="\n").writerows(rows_of(sys.stdin))
