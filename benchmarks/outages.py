"""Outages of simulated karts: how far off is the line in them, and what do wheels that roll along do for it?

    python benchmarks/outages.py
    python benchmarks/outages.py --preset kart_harsh --seconds 60 --seeds 4

Sessions of five minutes with outages of some length, half a minute and more apart. The error is that of the horizontal
position in an outage, less the straight line between what it is at both ends: the slow wander of the fixes is the
receiver's. Velocity likewise in the outages, yaw everywhere; z is error over sigma, of velocity in the outages.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from scoring import SCORED_RATE, Case, cases, compare, recorded
from smoother import api
from smoother.arrays import Array
from smoother.sim.scenario import Interval
from smoother.units import DEG

DURATION, APART, BEGIN = 300.0, 30.0, 40.0  # s


@dataclass(frozen=True, eq=False)
class Found:
    """Errors of one session: position (n, 2) m, velocity (n, 2) m/s in outages, and over sigma; yaw (m,) rad."""

    position: Array
    velocity: Array
    z: Array
    yaw: Array


def outages(seconds: float) -> tuple[Interval, ...]:
    """Outages of that length all through a session."""
    begins = np.arange(BEGIN, DURATION - seconds - APART, seconds + APART)
    return tuple(Interval(float(begin), seconds) for begin in begins)


def run(job: tuple[Case, float, bool]) -> Found:
    """Smooth one session with outages, with or without wheels."""
    case, seconds, wheels = job
    simulation = case.simulate()
    session = recorded(simulation)
    estimate = api.smooth(session, wheels=wheels)
    compared = compare(simulation, session, estimate, SCORED_RATE)
    sigmas = compared.found.sigmas
    assert sigmas is not None
    positions, velocities, over = [], [], []
    for outage in outages(seconds):
        inside = (compared.t >= outage.start) & (compared.t <= outage.start + outage.duration)
        error = compared.errors.position_n[inside, :2]
        positions.append(error - np.linspace(error[0], error[-1], len(error)))
        velocities.append(compared.errors.velocity_n[inside, :2])
        over.append(velocities[-1] / sigmas.velocity_n[inside, :2])
    joined = [np.concatenate(values) for values in (positions, velocities, over)]
    return Found(joined[0], joined[1], joined[2], compared.errors.euler[:, 2])


def _rms(found: list[Found], name: str) -> float:
    """Root mean square of all sessions, of both axes together."""
    errors = np.concatenate([np.atleast_2d(getattr(one, name).T).T for one in found])
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", action="append", choices=("kart", "kart_harsh"), help="default: both")
    parser.add_argument("--seconds", action="append", type=float, help="length of the outages; default 10, 30 and 60")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    print(f"{arguments.seeds} sessions of {DURATION:.0f} s each, in outages\n")
    print("| preset | outages, s | wheels | position, m | velocity, m/s | z of velocity | yaw, deg |")
    print("|---|--:|---|--:|--:|--:|--:|")
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for preset, seconds in product(arguments.preset or ["kart", "kart_harsh"], arguments.seconds or [10, 30, 60]):
            changes = {"gnss_outages": outages(seconds)}
            sessions = [
                Case(c.preset, c.seed, c.track, c.duration, c.standing, changes) for c in cases(preset, seeds, DURATION)
            ]
            for wheels in (False, True):
                found = list(pool.map(run, [(case, seconds, wheels) for case in sessions]))
                figures = (_rms(found, "position"), _rms(found, "velocity"), _rms(found, "z") / np.sqrt(2.0))
                cells = " | ".join(f"{value:.2f}" for value in (*figures, _rms(found, "yaw") / DEG))
                print(f"| {preset} | {seconds:.0f} | {'yes' if wheels else 'no'} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
