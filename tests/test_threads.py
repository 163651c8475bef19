"""A session is smoothed in one thread, which the command sees to before numpy is imported."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from smoother import threads

COMMAND = """
import os, sys
from smoother.cli import main
early = "numpy" in sys.modules
sys.argv = ["smooth", "--help"]
try:
    main()
except SystemExit:
    pass
import numpy
print(early, os.environ["OPENBLAS_NUM_THREADS"], len(os.listdir("/proc/self/task")))
"""


def answer(surroundings: dict[str, str]) -> list[str]:
    """What COMMAND prints in the end: numpy there before its threads were set, their number, and threads that run."""
    call = [sys.executable, "-c", COMMAND]
    child = subprocess.run(call, env=surroundings, capture_output=True, text=True, check=True)
    return child.stdout.splitlines()[-1].split()


def bare() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in threads.VARIABLES}


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted where Linux lists them")
def test_the_command_starts_no_threads_of_linear_algebra() -> None:
    assert answer(bare()) == ["False", "1", "1"]


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted where Linux lists them")
def test_a_number_of_threads_that_somebody_asked_for_stays() -> None:
    assert answer({**bare(), "OPENBLAS_NUM_THREADS": "2"})[:2] == ["False", "2"]


def test_only_what_was_not_stated_is_set() -> None:
    surroundings = {"OMP_NUM_THREADS": "3"}
    threads.start_none(surroundings)
    assert surroundings == {**dict.fromkeys(threads.VARIABLES, "1"), "OMP_NUM_THREADS": "3"}
