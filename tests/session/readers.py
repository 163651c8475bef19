"""What every reader of another program's files has to do: refuse in one line, and outlive any damage."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from smoother.cli.main import run
from smoother.errors import SessionError
from smoother.session.readers.foreign import ForeignReading

Read = Callable[[Path], ForeignReading]


def assert_refused(read: Read, path: Path, text: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The reader and `smooth`, of a folder with nothing else in it, say why the file cannot be used."""
    path.write_bytes(text.encode())
    with pytest.raises(SessionError, match=re.escape(message)):
        read(path)
    assert run([str(path.parent), "--no-figures"]) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err.count("\n") == 1 and output.err.startswith(f"smooth: {path}: ")


def assert_outlives_damage(read: Read, path: Path, text: str, seed: int, most: int = 200) -> None:
    """Up to `most` bytes that became one other, and the end cut off: fixes in order of time, or one line."""
    rng = np.random.default_rng(seed)
    data = np.frombuffer(text.encode(), np.uint8).copy()
    data[rng.integers(0, data.size, rng.integers(1, most))] = rng.integers(0, 256)
    path.write_bytes(data[: rng.integers(1, data.size + 1)].tobytes())
    try:
        gnss = read(path).gnss
    except SessionError as error:
        assert "\n" not in str(error)
    else:
        assert np.all(np.diff(gnss.t) > 0.0)
