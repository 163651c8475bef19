"""Where the tests find the stand-in for `smooth SESSION`, and the fixture that makes sessions for it."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from batch_stand_in import MakeTask

from smoother.batch.task import Limits, Task


@pytest.fixture
def make_task(tmp_path: Path) -> MakeTask:
    """A session whose stand-in does what `word` says."""

    def make(word: str = "fine", name: str = "run", seconds: float = 30.0, megabytes: int = 400) -> Task:
        session = tmp_path / name
        session.mkdir(parents=True, exist_ok=True)
        (session / "gps.csv").write_text(word)
        return Task(session, session / "smoothed", (session / "gps.csv",), name, limits=Limits(seconds, megabytes))

    return make
