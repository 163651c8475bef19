"""One way to solve: GTSAM eliminates, and one sweep takes covariances out of what it eliminated."""

import re
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "smoother"
SOLVES_CHAINS = re.compile(r"pbtrf|solveh?_banded|cholesky_banded|spsolve|splu|eliminate(Sequential|Multifrontal)\(")


def test_chains_are_solved_by_gtsam_in_one_place() -> None:
    found = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if SOLVES_CHAINS.search(path.read_text(encoding="utf-8"))
    }
    assert found == {"estimate/solvers/batch.py"}
