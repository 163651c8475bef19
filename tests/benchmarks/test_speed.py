"""Costs of a command, and ratios of pairs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from speed import CommandCost, command_cost, pair_ratio, table

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def costs(*walls: float) -> list[CommandCost]:
    return [CommandCost(wall, 2.0 * wall, 100.0) for wall in walls]


def test_ratios_are_those_of_each_pair() -> None:
    ratio = pair_ratio(costs(1.0, 4.0, 9.0), costs(2.0, 4.0, 3.0), "wall")
    assert (ratio.middle, ratio.least, ratio.largest) == (1.0, 0.5, 3.0)
    assert pair_ratio(costs(1.0), costs(2.0), "peak").middle == 1.0


def test_a_table_has_medians_and_ratios_of_all_figures() -> None:
    lines = table("10 min", costs(1.0, 4.0, 9.0), costs(2.0, 4.0, 3.0)).splitlines()
    assert lines[0].startswith("10 min, 3 turns")
    assert lines[1].split() == ["wall,", "s", "4.00", "3.00", "1.000", "(0.500", "to", "3.000)"]
    assert lines[2].split()[2:4] == ["8.00", "6.00"]
    assert lines[3].split()[:2] == ["peak,", "MB"]


def test_memory_and_time_are_those_of_the_child() -> None:
    script = """
import sys
from speed import command_cost
python = [sys.executable, "-c"]
small = command_cost([*python, "pass"])
large = command_cost([*python, "x = bytearray(150_000_000); x[::4096] = b'1' * len(x[::4096])"])
print(large.peak - small.peak, small.cpu)
"""  # in a small process: Linux counts the memory of the parent as the child's until the child has more
    environment = {**os.environ, "PYTHONPATH": str(BENCHMARKS)}
    words = [sys.executable, "-c", script]
    more, cpu = subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout.split()
    assert float(more) == pytest.approx(150.0, abs=20.0)
    assert float(cpu) > 0.0


def test_a_command_that_fails_is_no_measurement_and_a_doubtful_result_is_one() -> None:
    with pytest.raises(RuntimeError, match="exit code 2"):
        command_cost([sys.executable, "-c", "import sys; sys.exit(2)"])
    assert command_cost([sys.executable, "-c", "import sys; sys.exit(3)"]).wall > 0.0
