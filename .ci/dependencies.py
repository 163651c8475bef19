"""Write the tables of docs/dependencies.md: what is installed, within which bounds, under which licence, and why.

    python .ci/dependencies.py

Names, bounds and reasons are those of pyproject.toml (the reason is the comment behind a dependency); licences are what
the installed packages say of themselves, so everything has to be installed: `make dependencies` sees to it.
"""

import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "dependencies.md"
BEGIN, END = "<!-- tables: made by .ci/dependencies.py -->", "<!-- end of tables -->"
EXTRAS = {
    "aim": "Installed with the extra `aim`",
    "gopro": "Installed with the extra `gopro`",
    "fit": "Installed with the extra `fit`",
    "dask": "Installed with the extra `dask`",
    "test": "For the tests only",
    "docs": "For the documents as a site only",
    "bench": "For the benchmarks only",
    "dev": "For style and types only",
    "release": "For these checks only",
}
SHORT = 60  # characters that the name of a licence may have


@dataclass(frozen=True)
class Dependency:
    """One line of pyproject.toml."""

    name: str
    bounds: str
    why: str


def dependencies(text: str, extra: str | None = None) -> list[Dependency]:
    """What the text of a pyproject.toml asks for, of one extra or without any."""
    project = tomllib.loads(text)["project"]
    wanted = project["dependencies"] if extra is None else project["optional-dependencies"][extra]
    section = text[text.index("dependencies = [" if extra is None else f"\n{extra} = [") :]
    return [_dependency(section, line) for line in wanted]


def _dependency(section: str, line: str) -> Dependency:
    comment = re.search(rf'^ *"{re.escape(line)}", *# (.+)$', section, re.MULTILINE)
    requirement = Requirement(line)
    bounds = ", ".join(sorted(map(str, requirement.specifier), reverse=True))
    return Dependency(requirement.name, bounds, comment[1].strip() if comment else "")


def licence(name: str) -> str:
    """What an installed package says of its licence. Raises PackageNotFoundError."""
    told = metadata.metadata(name)
    # told["..."] of a field that is not there is None or a KeyError, by the version of importlib_metadata
    lines: list[str] = (told.get_all("License-Expression") or told.get_all("License") or [""])[0].split("\n")
    if len(lines) == 1 and 0 < len(lines[0]) <= SHORT:
        return lines[0]
    classifiers = [row.rpartition(" :: ")[2] for row in told.get_all("Classifier", []) if row.startswith("License ::")]
    # else the text of the licence, of which the first line is the name
    return ", ".join(classifiers) or lines[0].strip().capitalize() or "not stated"


def brought_along(names: Iterable[str]) -> dict[str, set[str]]:
    """Packages that others need and pyproject.toml does not name, each with those that ask for it."""
    direct = [_plain(name) for name in names]
    found: dict[str, set[str]] = {}
    waiting = list(direct)
    while waiting:
        name = waiting.pop()
        for needed in _needs(name):
            if needed not in direct:
                if needed not in found:
                    waiting.append(needed)
                found.setdefault(needed, set()).add(name)
    return dict(sorted(found.items()))


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _needs(name: str) -> Iterator[str]:
    for line in metadata.requires(name) or []:
        requirement = Requirement(line)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield _plain(requirement.name)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ("---",) * len(head), *rows])


def _direct(rows: list[Dependency]) -> str:
    cells = [(row.name, row.bounds, licence(row.name), row.why) for row in rows]
    return _table(("package", "versions", "licence", "why"), cells)


def tables(text: str) -> str:
    """All tables, in Markdown."""
    direct = dependencies(text)
    along = [(name, licence(name), ", ".join(sorted(by))) for name, by in brought_along(d.name for d in direct).items()]
    parts = ["### Installed with `smooth`", _direct(direct)]
    parts += ["### Brought along by those", _table(("package", "licence", "asked for by"), along)]
    for extra, title in EXTRAS.items():
        parts += [f"### {title}", _direct(dependencies(text, extra))]
    return "\n\n".join(parts)


def main() -> int:
    """Rewrite the tables; the exit code."""
    try:
        made = tables((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    except metadata.PackageNotFoundError as error:
        print(
            f"{error.name} is not installed, so its licence cannot be told; `make dependencies` does", file=sys.stderr
        )
        return 2
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n\n{made}\n\n{END}{rest.partition(END)[2]}", encoding="utf-8")
    print(PAGE.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
