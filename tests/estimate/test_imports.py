"""The linear algebra of the paths through fixes alone is theirs: the graph is solved by GTSAM."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "smoother"


def importers(module: str) -> set[str]:
    """Files of the package that import a module of it, by their path within."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and module in (
                node.module,
                *(f"{node.module}.{a.name}" for a in node.names),
            ):
                found.add(path.relative_to(PACKAGE).as_posix())
    return found


@pytest.mark.parametrize("module", ["smoother.estimate.chain", "smoother.estimate.lapack"])
def test_only_paths_through_fixes_solve_chains_themselves(module: str) -> None:
    names = {Path(name).stem for name in importers(module)}
    assert names
    assert all(name.startswith("gnss_") for name in names), names
