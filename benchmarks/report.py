"""Cost and size of report.html beside the smoothing itself, in CPU seconds of one core.

    python benchmarks/report.py                       # simulated karts, 10 and 20 minutes
    python benchmarks/report.py SESSION...            # recordings

Limits: the page costs less than the smoothing; 3 MB for ten minutes, 0.15 MB for each further minute. The figures
(PNG) are timed as well, as they are written together with the page.
"""

import argparse
import os
import tempfile
import time
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from smoother.cli.lap_stage import stated
from smoother.cli.pipeline import Options, Stopwatch, calibrated, estimate, heading, read, with_laps
from smoother.prepare import prepare
from smoother.report.figures import Shown, save_figures
from smoother.report.page import Report, write_page
from smoother.samples import Session
from smoother.sim.simulation import simulate_preset

MINUTES = (10.0, 20.0)
HEADER = f"{'session':32} {'minutes':>7} {'smoothing':>9} {'laps':>6} {'page':>6} {'figures':>7} {'MB':>6} {'limit':>6}"


def measure(name: str, session: Session, directory: Path, scratch: Path) -> str:
    """Return a row of the table: CPU seconds of each stage, size and its limit."""
    clock = [time.process_time()]
    made = estimate(session, Options(), Stopwatch())
    clock.append(time.process_time())
    made = with_laps(made, stated(session.config, directory), Stopwatch())
    clock.append(time.process_time())
    path = scratch / "report.html"
    write_page(path, Report(session, made.smoothed, made.baseline, made.laps, made.quality))
    clock.append(time.process_time())
    save_figures(Shown(session, made.smoothed, made.baseline, heading(made)), scratch / "figures")
    clock.append(time.process_time())
    smoothing, laps, page, figures = (b - a for a, b in pairwise(clock))
    minutes = float(made.smoothed.t[-1] - made.smoothed.t[0]) / 60.0
    size, limit = path.stat().st_size / 1e6, 3.0 + 0.15 * max(0.0, minutes - 10.0)
    numbers = f"{smoothing:9.2f} {laps:6.2f} {page:6.2f} {figures:7.2f} {size:6.2f} {limit:6.2f}"
    return f"{name[:32]:32} {minutes:7.1f} {numbers}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", nargs="*", type=Path)
    sessions = parser.parse_args().sessions
    print(HEADER)
    with tempfile.TemporaryDirectory() as scratch:
        for path in sessions:
            session = calibrated(read(path), path)
            print(measure(session.name, session, path, Path(scratch)), flush=True)
        for minutes in () if sessions else MINUTES:
            session = prepare(simulate_preset("kart", 7, duration=60.0 * minutes).raw)
            print(measure("simulated kart", session, Path(scratch), Path(scratch)), flush=True)


if __name__ == "__main__":
    main()
