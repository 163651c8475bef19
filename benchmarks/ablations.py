"""What each factor of the graph is worth on a real kart: left out, how much farther are the fixes that were left out?

    SMOOTH_DATA=folder python benchmarks/ablations.py
    SMOOTH_DATA=folder python benchmarks/ablations.py --recording kart_lignano_racebox --interval 2 --phases 6

The recording is thinned as in thinning.py, at several phases. Each row of the table leaves one factor out (`imu`: the
motion sensor) and shows by how much the horizontal rms error at the fixes left out changes: the mean over the phases,
per cent, and its standard error. `not used`: the recording does not have what the factor needs.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from smoother import api
from smoother.arrays import Array
from smoother.estimate.factors.graph import TABLE
from thinning import DATA, read_estimate, scored, thin

WITHOUT = ((), *((factor.name,) for factor in TABLE), ("imu",))


def error(case: tuple[Path, float, float, tuple[str, ...]]) -> float:
    """Horizontal rms at the fixes left out, m, of a recording with one fix in `interval` s kept from `phase` on.

    NaN where the graph has no solution without some factors.
    """
    path, interval, phase, without = case
    session = api.read(path)
    thinned, kept = thin(session, interval, phase)
    at = scored(session, kept)
    imu = "imu" not in without
    trajectory = api.smooth(thinned, imu=imu, without=without if imu else ())
    if imu and trajectory.report.mode != "full":
        return np.nan
    position, with_offset, _ = read_estimate(trajectory, session.gnss.t[at])
    miss = (position if with_offset is None else with_offset) - session.fix_position_n[at, :2]
    return float(np.sqrt(np.mean(np.sum(miss**2, axis=1))))


def change(errors: Array, usual: Array) -> str:
    """Change of errors (P,) m in P phases against the usual ones, as a cell of the table."""
    if not np.all(np.isfinite(errors)):
        return "no solution"
    if np.array_equal(errors, usual):
        return "not used"
    logarithm = np.log(errors / usual)
    mean, sigma = np.expm1(np.mean(logarithm)), np.std(logarithm, ddof=1) / np.sqrt(len(logarithm))
    return f"{100.0 * mean:+.1f} ± {100.0 * sigma:.1f} %"


def main() -> None:
    """Parse the arguments, run, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recording", default="kart_adria_first_half")
    parser.add_argument("--interval", action="append", type=float, help="s between fixes; default 1 and 5")
    parser.add_argument("--phases", type=int, default=3, help="ways to thin, two or more")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.exit(0, f"no real recordings at {DATA}; set SMOOTH_DATA\n")
    intervals, phases = arguments.interval or [1.0, 5.0], arguments.phases
    path = DATA / arguments.recording
    cases = [(path, dt, i / phases, names) for names in WITHOUT for dt in intervals for i in range(phases)]
    print(f"| without | {' | '.join(f'one fix in {dt:g} s' for dt in intervals)} |\n|---|{'---:|' * len(intervals)}")
    with ProcessPoolExecutor(arguments.jobs) as pool:
        done = pool.map(error, cases)
        rows = ([np.array([next(done) for _ in range(phases)]) for _ in intervals] for _ in WITHOUT)
        usual = next(rows)
        cells = (f"{np.sqrt(np.mean(errors**2)):.3f} m" for errors in usual)
        print(f"| nothing: rms error | {' | '.join(cells)} |", flush=True)
        for names, found in zip(WITHOUT[1:], rows, strict=True):
            print(f"| {names[0]} | {' | '.join(map(change, found, usual))} |", flush=True)


if __name__ == "__main__":
    main()
