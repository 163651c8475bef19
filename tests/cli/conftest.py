"""A short simulated session on disk, made once and copied for each test that writes."""

import shutil
from pathlib import Path

import pytest

from smoother.cli.main import run

SECONDS = 30.0


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("simulated") / "monday"
    assert run(["simulate", str(directory), "--duration", str(SECONDS), "--seed", "11", "--preset", "white"]) == 0
    return directory


@pytest.fixture
def monday(simulated: Path, tmp_path: Path) -> Path:
    """A session directory of the test's own, without results."""
    return Path(shutil.copytree(simulated, tmp_path / "monday"))
