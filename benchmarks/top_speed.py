"""Top speed of simulated karts against the truth: of sessions and of their laps, beside the highest row of all.

    python benchmarks/top_speed.py --seeds 10 --duration 600     # both presets; a minute on two cores

Seeds take the tracks in turn, standing and rolling starts. Speeds are those of the antenna; km/h.
"""

import argparse
import dataclasses
import os
from concurrent.futures import ProcessPoolExecutor

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from lap_times import estimated
from scoring import Case, cases, recorded
from smoother import api
from smoother.arrays import Array
from smoother.laps.top_speed import top_speed
from smoother.units import KMH


@dataclasses.dataclass(frozen=True)
class TopScore:
    """One session: errors of its top speed and of its highest row, the sigma said; errors (L,) of the laps that count
    and of their highest rows, m/s."""

    case: Case
    error: float
    sigma: float
    highest: float
    laps: Array
    laps_highest: Array


def run(case: Case) -> TopScore:
    """Simulate, smooth and score one session."""
    simulation = case.simulate()
    session = recorded(simulation)
    estimate = estimated(session, gps_only=False)
    velocity = simulation.truth.antenna_velocity_n(estimate.t, simulation.scenario.lever_arm_b)
    true, said = np.hypot(velocity[:, 0], velocity[:, 1]), top_speed(estimate)
    laps = [lap for lap in api.laps(session, estimate).laps if lap.is_valid]
    rows = [(estimate.t >= lap.start) & (estimate.t <= lap.end) for lap in laps]
    tops = np.array([true[k].max() for k in rows])
    return TopScore(
        case,
        said.speed - true.max(),
        said.sigma,
        float(estimate.speed.max() - true.max()),
        np.array([lap.top_speed for lap in laps]) - tops,
        np.array([estimate.speed[k].max() for k in rows]) - tops,
    )


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds, each on the next track")
    parser.add_argument("--first-seed", type=int, default=40)
    parser.add_argument("--duration", type=float, default=600.0, help="s")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for preset in ("kart", "kart_harsh"):
            scores = list(pool.map(run, cases(preset, seeds, arguments.duration)))
            print(f"{preset}, {len(scores)} sessions of {arguments.duration:.0f} s")
            print(summary(scores), flush=True)


def summary(scores: list[TopScore]) -> str:
    """Return mean and rms error of what is told and of the highest rows, and how honest the sigma is."""
    error, sigma = np.array([s.error for s in scores]), np.array([s.sigma for s in scores])
    return "\n".join(
        [
            f"  session {_said(error)}, error over sigma {np.sqrt(np.mean((error / sigma) ** 2)):.2f} rms; "
            f"highest row {_said(np.array([s.highest for s in scores]))}",
            f"  laps    {_said(np.concatenate([s.laps for s in scores]))}; "
            f"highest row {_said(np.concatenate([s.laps_highest for s in scores]))}",
        ]
    )


def _said(error: Array) -> str:
    return f"mean error {error.mean() / KMH:+.2f}, rms {np.sqrt(np.mean(error**2)) / KMH:.2f} km/h"


if __name__ == "__main__":
    main()
