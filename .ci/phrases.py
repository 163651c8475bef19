"""Find phrases that only the authors understand, in the documents and in what the program writes: part of `make lint`.

Phrases alone are banned, no single good English words. A line that needs one ends with `phrase: ok` and the reason.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PHRASES = (
    r"lived with",
    r"(?:is|are|was) told",
    r"tells? of",
    r"taken out",
    r"taken as such",
    r"of other making",
    r"by and by",
    r"said so",
    r"(?:and|which) (?:is |it is )said\b",
    r"which is said",
    r"it is said",
    r"made up",
    r"nobody knows",
    r"(?:hardly|not) believed",
    r"left over",
    r"for itself",
    r"of no use",
    r"sure to ±",
)
BANNED = re.compile(rf"\b(?:{'|'.join(PHRASES)})", re.IGNORECASE)
DOCUMENTS = ("*.md", "docs/*.md", "firmware/README.md")
# packages whose text is plain English already; a package joins when it is
SOURCES = (
    *("*.py", "*.toml", "batch/*.py", "cli/*.py", "export/*.py", "fit/*.py", "laps/*.py", "live/*.py", "report/*.py"),
    *("estimate/**/*.py", "session/**/*.py", "sim/*.py", "*/template/*"),
)
EXCUSED = "phrase: ok"


def found(path: Path) -> Iterator[str]:
    """Each banned phrase of a file, with its line."""
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        for phrase in BANNED.findall(line) if EXCUSED not in line else ():
            yield f"{path.relative_to(ROOT)}:{number}: {phrase!r}; say it in plain English"


def main() -> int:
    """Print what is found; 1 if anything is."""
    paths = [path for pattern in DOCUMENTS for path in sorted(ROOT.glob(pattern))]
    paths += [path for pattern in SOURCES for path in sorted((ROOT / "smoother").glob(pattern))]
    lines = [line for path in paths for line in found(path)]
    print("\n".join(lines) if lines else f"No banned phrase in {len(paths)} files")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
