"""Long sessions through the whole command: peak memory, time, and what comes out.

    python benchmarks/endurance.py 4 DIR        simulates four hours into DIR, unless it holds a recording, and smooths
    python benchmarks/endurance.py 24 DIR       a day: with 40 stops of a minute or two, as for changing drivers
    python benchmarks/endurance.py 24 DIR --format csv

`smooth DIR` runs in a process of its own, with baseline, laps, tables, figures and report; its memory is the most that
was resident, pages of files included, and a line is printed whenever it has grown by another quarter of a gigabyte. The
simulation of a day takes 8 GB. CPU seconds stand beside wall time: on a busy machine they are the better figure.
"""

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

STOPS, EVERY = 40, 0.96  # of a session of a day; share of it over which they are spread
MEMORY, STEP = 2.0, 0.25  # GB: promised, and told
COMMAND = "import sys; from smoother.cli import main; sys.exit(main())"


@dataclass(frozen=True)
class Cost:
    """Of one run of the command: exit code, wall and CPU time in s, peak memory in GB."""

    code: int
    wall: float
    cpu: float
    memory: float


def simulate(hours: float, directory: Path, form: str, seed: int) -> None:
    """Write a session of the preset kart; one of a day has stops of 60 to 120 s."""
    seconds = 3600.0 * hours
    words = ["simulate", str(directory), "--duration", f"{seconds:g}", "--seed", str(seed), "--format", form]
    if hours >= 24.0:
        starts = [EVERY * seconds * (k + 1) / STOPS for k in range(STOPS)]
        stops = ",".join(f"{start:.0f}:{60 + 23 * k % 61}" for k, start in enumerate(starts))
        words += ["--set", f"motion.stops={stops}"]
    subprocess.run([sys.executable, "-c", COMMAND, *words], check=True, stdout=subprocess.DEVNULL)


def smooth(directory: Path) -> Cost:
    """Run the command, telling when it comes to need more memory."""
    since = time.perf_counter()
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    child = subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(directory)], env=environment, stdout=subprocess.DEVNULL
    )
    watcher = threading.Thread(target=_watch, args=(child.pid, since), daemon=True)
    watcher.start()
    _, status, usage = os.wait4(child.pid, 0)
    unit = 1e9 if sys.platform == "darwin" else 1e6  # bytes there, kilobytes here
    wall, cpu = time.perf_counter() - since, usage.ru_utime + usage.ru_stime
    return Cost(os.waitstatus_to_exitcode(status), wall, cpu, usage.ru_maxrss / unit)


def _watch(process: int, since: float) -> None:
    """Print a line whenever the peak of a process (Linux) has passed another STEP."""
    told = 0.0
    while True:
        try:
            lines = Path(f"/proc/{process}/status").read_text(encoding="ascii").splitlines()
        except OSError:
            return
        peak = next((int(line.split()[1]) / 1e6 for line in lines if line.startswith("VmHWM")), 0.0)
        if peak > told + STEP:
            told = peak
            print(f"  {peak:.2f} GB after {time.perf_counter() - since:.0f} s", flush=True)
        time.sleep(0.5)


def show(directory: Path, cost: Cost) -> None:
    """Print the cost, the stages, and the sizes of the results."""
    print(f"exit code {cost.code}, {cost.wall:.0f} s ({cost.cpu:.0f} s of CPU)")
    if cost.code in (0, 3):  # 3: done, but its own quality gate was not met
        results = directory / "smoothed"
        summary = json.loads((results / "summary.json").read_text(encoding="utf-8"))
        stages = {name: s for name, s in summary["timings"].items() if not name.startswith("smoothing_")}
        print("stages, s:", ", ".join(f"{name} {seconds:.0f}" for name, seconds in stages.items()))
        laps = summary.get("laps", [])
        print(f"{summary['counts']['fixes']} fixes, {len(laps)} laps, {sum(lap['valid'] for lap in laps)} count")
        files = sorted(path for path in results.iterdir() if path.is_file())
        print("MB:", ", ".join(f"{path.name} {path.stat().st_size / 1e6:.1f}" for path in files))
    print(f"{'ok  ' if cost.memory <= MEMORY else 'MISS'} peak memory: {cost.memory:.2f} GB (limit {MEMORY:g})")


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("hours", type=float)
    parser.add_argument("directory", type=Path)
    parser.add_argument("--format", choices=("klg", "csv"), default="klg")
    parser.add_argument("--seed", type=int, default=5)
    arguments = parser.parse_args()
    held = [*arguments.directory.glob("*.KLG"), *arguments.directory.glob("imu.csv")]
    if not held:
        simulate(arguments.hours, arguments.directory, arguments.format, arguments.seed)
    show(arguments.directory, smooth(arguments.directory))


if __name__ == "__main__":
    main()
