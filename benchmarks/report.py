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

from smoother import api
from smoother.report.drawing import Shown
from smoother.report.figures import save_figures
from smoother.report.page import Report, write_page
from smoother.samples import Session

MINUTES = (10.0, 20.0)
HEADER = f"{'session':32} {'minutes':>7} {'smoothing':>9} {'laps':>6} {'page':>6} {'figures':>7} {'MB':>6} {'limit':>6}"


def measure(name: str, session: Session, scratch: Path) -> str:
    """Return a row of the table: CPU seconds of each stage, size and its limit."""
    clock = [time.process_time()]
    smoothed, baseline = api.smooth(session), api.baseline(session)
    quality = api.assess(session, smoothed)
    clock.append(time.process_time())
    analysis = api.laps(session, smoothed)
    clock.append(time.process_time())
    path = scratch / "report.html"
    write_page(path, Report(session, smoothed, baseline, analysis, quality))
    clock.append(time.process_time())
    save_figures(Shown(session, smoothed, baseline, name), scratch / "figures")
    clock.append(time.process_time())
    smoothing, laps, page, figures = (b - a for a, b in pairwise(clock))
    minutes = float(smoothed.t[-1] - smoothed.t[0]) / 60.0
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
            session = api.read(path)
            print(measure(session.name, session, Path(scratch)), flush=True)
        for minutes in () if sessions else MINUTES:
            session = api.prepared(api.simulate("kart", 7, duration=60.0 * minutes).raw)
            print(measure("simulated kart", session, Path(scratch)), flush=True)


if __name__ == "__main__":
    main()
