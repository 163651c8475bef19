"""Fixes that jump, most of them beside outages: does the path stay where it would be without them?

    python benchmarks/jumps.py --first 200 --sessions 90

Each session has two outages of 4 to 20 s and four or five jumps of 10 to 50 m for 0.2 to 2 s: two anywhere, one right
after an outage, one right before one, and every other time one more after it. Kinds of kart, rates from 1 to 25 Hz and
Doppler or none go in turns. Every session is smoothed as it is, and once more without the fixes that jumped, which
nothing can beat by much.
"""

import argparse
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from scoring import SCORED_RATE, STANDING, TRACKS, compare, recorded
from smoother import api
from smoother.samples import Session
from smoother.sim.scenario import Interval, Jump
from smoother.sim.simulation import Simulation

KINDS = ("kart", "kart_harsh", "metres")  # metres: a kart whose fixes scatter by 1 to 2.5 m
RATES = (1.0, 2.0, 5.0, 10.0, 25.0)  # Hz
DURATION = 140.0  # s
FIRST, FIRST_SIMULATED = 91000, 5000  # of the seeds by which figures and noise are drawn
EDGE = 0.001  # s by which a jump begins before an outage ends, so that the first fix after it is displaced
FAR = 4.0  # sigmas


@dataclass(frozen=True)
class Result:
    """Horizontal rms and worst error, m, worst error over its sigma, shares within one and two sigmas."""

    rms: float
    worst: float
    worst_in_sigma: float
    inside: tuple[float, float]


@dataclass(frozen=True)
class Pair:
    """What became of a session, and of the same without the fixes that jumped."""

    kind: str
    has_doppler: bool
    rate: float
    found: Result
    without: Result


def draw(seed: int) -> tuple[str, dict[str, Any]]:
    """Return the kind of kart and the figures that `seed` draws."""
    rng = np.random.default_rng(FIRST + seed)
    kind, rate = KINDS[seed % 3], RATES[(seed // 6) % 5]
    changes: dict[str, Any] = {"track": TRACKS[int(rng.integers(3))], "gnss_rate": rate, "imu_gaps": ()}
    changes["motion_standstill"] = None if rng.random() < 0.5 else STANDING
    if (seed // 3) % 2 == 0:
        changes["gnss_velocity"] = False
    if kind == "metres":
        white = float(rng.uniform(1.0, 2.5))
        changes |= {"gnss_white_horizontal": white, "gnss_white_up": 1.7 * white}
        offset = float(rng.choice([0.3, 1.5]))
        changes |= {"gnss_offset_horizontal": offset, "gnss_offset_up": 1.7 * offset}
    one = Interval(30.0 + rng.uniform(0.0, 10.0), rng.uniform(4.0, 20.0))
    two = Interval(85.0 + rng.uniform(0.0, 10.0), rng.uniform(4.0, 20.0))

    def jump(start: float, seconds: float) -> Jump:
        size, direction = rng.uniform(10.0, 50.0), rng.uniform(0.0, 2.0 * np.pi)
        return Jump(float(start), float(seconds), size * np.array([np.cos(direction), np.sin(direction), 0.0]))

    def seconds() -> float:
        """At least one fix; three in ten last twice as long."""
        return float(max(rng.uniform(0.2, 1.0), 1.01 / rate) * (2.0 if rng.random() < 0.3 else 1.0))

    jumps = [jump(rng.uniform(10.0, 27.0), seconds()), jump(rng.uniform(62.0, 80.0), seconds())]
    jumps.append(jump(one.start + one.duration - EDGE, seconds()))
    before = seconds()
    jumps.append(jump(two.start - before, before + EDGE))
    if rng.random() < 0.5:
        jumps.append(jump(two.start + two.duration - EDGE, seconds()))
    return kind, {**changes, "gnss_outages": (one, two), "gnss_jumps": tuple(jumps)}


def run(seed: int, solver: str) -> Pair:
    """Simulate and smooth the session drawn by `seed`."""
    kind, changes = draw(seed)
    preset = "kart" if kind == "metres" else kind
    simulation = api.simulate(preset, seed + FIRST_SIMULATED, duration=DURATION, **changes)
    session, jumped = recorded(simulation), np.any(simulation.gnss.jump_n != 0.0, axis=1)
    without = replace(session, gnss=session.gnss.select(np.flatnonzero(~jumped)))
    found = [_result(simulation, s, solver) for s in (session, without)]
    return Pair(kind, changes.get("gnss_velocity", True), changes["gnss_rate"], *found)


def _result(simulation: Simulation, session: Session, solver: str) -> Result:
    estimate = api.smooth(session, solver=solver)
    compared = compare(simulation, session, estimate, SCORED_RATE)
    assert compared.found.sigmas is not None
    error = compared.errors.position_n[:, :2]
    in_sigma, distance = np.abs(error) / compared.found.sigmas.position_n[:, :2], np.hypot(error[:, 0], error[:, 1])
    inside = float(np.mean(in_sigma <= 1.0)), float(np.mean(in_sigma <= 2.0))
    return Result(float(np.sqrt(np.mean(distance**2))), float(distance.max()), float(in_sigma.max()), inside)


def _figures(results: Sequence[Result]) -> str:
    rms = np.array([r.rms for r in results])
    one, two = (100.0 * np.mean([r.inside[i] for r in results]) for i in range(2))
    far = sum(r.worst_in_sigma > FAR for r in results)
    worst = [r.worst for r in results]
    return (
        f"{np.sqrt(np.mean(rms**2)):6.2f} {np.median(rms):6.2f} {np.max(worst):6.1f} {np.median(worst):6.1f} "
        f"{far:3d}  {one:3.0f}/{two:3.0f}"
    )


def _groups(pairs: Sequence[Pair]) -> list[str]:
    kinds: dict[str, Callable[[Pair], bool]] = {"all": lambda _: True}
    for has_doppler, word in ((False, "no Doppler"), (True, "Doppler")):
        kinds[word] = lambda p, d=has_doppler: p.has_doppler == d  # type: ignore[misc]
        for kind in KINDS:
            kinds[f"  {kind}, {word}"] = lambda p, d=has_doppler, k=kind: (p.has_doppler, p.kind) == (d, k)  # type: ignore[misc]
        for rate in RATES:
            kinds[f"  {rate:.0f} Hz, {word}"] = lambda p, d=has_doppler, r=rate: (p.has_doppler, p.rate) == (d, r)  # type: ignore[misc]
    chosen = {name: [p for p in pairs if belongs(p)] for name, belongs in kinds.items()}
    return [
        f"{name:<24}{len(some):4d} {_figures([p.found for p in some])}   {_figures([p.without for p in some])}"
        for name, some in chosen.items()
        if some
    ]


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="number of the first session")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--solver", choices=("batch", "isam2"), default="batch")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.sessions)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        pairs = list(pool.map(run, seeds, [arguments.solver] * len(seeds)))
    print(
        "horizontal error, m: rms over sessions, median rms, worst, median of the worst; sessions with an error beyond"
    )
    print(f"{FAR:.0f} sigmas; % within one and two sigmas. Then the same without the fixes that jumped")
    print("\n".join(_groups(pairs)))


if __name__ == "__main__":
    main()
