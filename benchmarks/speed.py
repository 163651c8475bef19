"""Speed and memory: against the reference graph of speed_reference.py, or against the command of another checkout.

    python benchmarks/speed.py                 10 minutes at 200 Hz and at 1 kHz, 60 minutes, beside the reference graph
    python benchmarks/speed.py --quick         10 minutes at 200 Hz only
    python benchmarks/speed.py --minutes 240   one more length
    python benchmarks/speed.py --against DIR   this command beside that of a checkout, DIR/.venv/bin/smooth: 10 and 60
                                               minutes; with --quick 10

Against a checkout both smooth the same sessions in turns; which begins changes from turn to turn. The ratio is that of
each pair, this over that, since machines change their pace from one minute to the next. CPU is that of the process
alone: on a busy machine it is the better figure.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # one core; before numpy is imported
for _name, _count in ENVIRONMENT.items():
    os.environ.setdefault(_name, _count)

PEAK_UNIT = 1e6 if sys.platform == "darwin" else 1e3  # of ru_maxrss in a megabyte: bytes there, kilobytes here
FIGURES = (("wall", "s"), ("cpu", "s"), ("peak", "MB"))


@dataclass(frozen=True)
class CommandCost:
    """Wall and CPU time, s, and peak memory, MB, of one run of a command."""

    wall: float
    cpu: float
    peak: float


@dataclass(frozen=True)
class Ratio:
    """Middle, least and largest of ratios, one of each pair of runs."""

    middle: float
    least: float
    largest: float

    def __str__(self) -> str:
        return f"{self.middle:.3f} ({self.least:.3f} to {self.largest:.3f})"


def command_cost(words: Sequence[str]) -> CommandCost:
    """Run a command to its end; raises RuntimeError where it gives no result.

    Peak memory is at least that of this process: Linux keeps what it had when the child was made from it. So this
    module imports the standard library alone.
    """
    # modules are compiled once after an installation, not at every start
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    since = time.perf_counter()
    child = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 3):  # 3: done, but its own quality gate was not met
        raise RuntimeError(f"{' '.join(words)}: exit code {child.returncode}")
    return CommandCost(time.perf_counter() - since, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / PEAK_UNIT)


def pair_ratio(these: Sequence[CommandCost], those: Sequence[CommandCost], figure: str) -> Ratio:
    """Return what these runs cost over those, pair by pair."""
    ratios = [getattr(a, figure) / getattr(b, figure) for a, b in zip(these, those, strict=True)]
    return Ratio(median(ratios), min(ratios), max(ratios))


def table(name: str, these: Sequence[CommandCost], those: Sequence[CommandCost]) -> str:
    """Return the lines of one session: medians of both, and the ratio of the pairs."""
    lines = [f"{name}, {len(these)} turns        this    that   this / that, middle (least to largest) of the pairs"]
    for figure, unit in FIGURES:
        medians = (median(getattr(cost, figure) for cost in costs) for costs in (these, those))
        this, that = (f"{value:7.2f}" for value in medians)
        lines.append(f"  {figure + ', ' + unit:<18} {this} {that}   {pair_ratio(these, those, figure)}")
    return "\n".join(lines)


def against(other: Path, lengths: Sequence[float], turns: int, seed: int) -> None:
    """Time both commands on simulated sessions of these lengths, minutes; print a table each."""
    this, that = (Path(sys.executable).with_name("smooth"), other / ".venv" / "bin" / "smooth")
    for smooth in (this, that):
        if not smooth.exists():
            raise SystemExit(f"{smooth}: no such command; name a checkout whose environment is made")
    for minutes in lengths:
        with tempfile.TemporaryDirectory() as name:
            session = Path(name) / "session"
            length = ("--duration", f"{60 * minutes:g}", "--seed", str(seed))
            command_cost([str(this), "simulate", str(session), *length])
            runs = {
                smooth: [str(smooth), str(session), "--no-baseline", "--no-figures", "-o", str(Path(name) / folder)]
                for smooth, folder in ((this, "this"), (that, "that"))
            }
            costs: dict[Path, list[CommandCost]] = {this: [], that: []}
            for turn in range(turns + 1):
                for smooth in (this, that) if turn % 2 else (that, this):
                    cost = command_cost(runs[smooth])
                    if turn:  # the first run compiles modules and fills the cache of files
                        costs[smooth].append(cost)
        print(table(f"{minutes:g} min", costs[this], costs[that]), flush=True)


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="10 minutes at 200 Hz only")
    parser.add_argument("--minutes", type=float, action="append", default=[], help="a further session of this length")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--against", type=Path, metavar="DIR", help="another checkout, with its environment in .venv")
    arguments = parser.parse_args()
    if arguments.turns < 1:
        parser.error("--turns must be at least 1")
    if arguments.against is not None:
        lengths = [10.0, *([] if arguments.quick else [60.0]), *arguments.minutes]
        against(arguments.against, lengths, arguments.turns, arguments.seed)
        return
    from speed_reference import measure  # the package is imported for this alone

    measure(arguments.minutes, arguments.turns, arguments.seed, arguments.quick)


if __name__ == "__main__":
    main()
