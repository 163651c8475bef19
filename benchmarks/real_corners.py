"""Losses in corners that are called real, against the truth: how many are luck, and how many true ones are called so.

    python benchmarks/real_corners.py --seeds 4 --durations 600 1500 3400     # 24 sessions; two minutes on two cores
    python benchmarks/real_corners.py --lapses 4                              # drivers who brake too early now and then
    python benchmarks/real_corners.py --seeds 2 --durations 600               # a look

Seeds take the tracks in turn, standing and rolling starts; each is driven by a `kart` and a `kart_harsh`. A loss of a
lap that counts, called real, is luck where the true one is less than a quarter of it or of other sign. Lines between
corners stand at fixed places of the track, and the truth is timed at these, moved back by what the session lies beside
it in the mean. Beside the program's decision stand that of two sigma for each loss alone, and in the sum that of
Benjamini and Hochberg, for errors that go one way together. The usual loss of a corner
is compared with the median of the true losses of the same laps.
"""

import argparse
import dataclasses
import os
from concurrent.futures import ProcessPoolExecutor

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.stats import norm

from lap_times import estimated, true_crossings
from scoring import Case, cases, recorded
from smoother import api
from smoother.arrays import Array, BoolArray
from smoother.laps.reference import Curve
from smoother.laps.results import LapAnalysis, Line
from smoother.laps.sigma import FALSE_DISCOVERY_RATE as FALSE
from smoother.laps.sigma import are_real, least_significant
from smoother.samples import Session
from smoother.sim.simulation import Simulation
from smoother.trajectory import Trajectory
from theoretical_best import mean_error, moved

NEAR = 1.0  # s between a crossing and the true one
HALF = 5.0  # m to either side that a line between two corners reaches
LUCK = 0.25  # of a loss shown: where the true one is less, it is called luck
WORTH = 0.1  # s; a true loss that a driver should be told of


@dataclasses.dataclass(frozen=True)
class CornerScore:
    """One session: losses (K,) s of the laps that count in all corners, true ones, sigmas, what is called real; the
    same (C,) of the usual losses."""

    case: Case
    lost: Array
    true: Array
    sigma: Array
    is_real: BoolArray
    sure: float
    usual: Array
    true_usual: Array
    usual_sigma: Array
    usual_is_real: BoolArray


def run(case: Case) -> CornerScore | None:
    """Simulate, smooth and score one session; None where no lap is compared with another."""
    simulation = case.simulate()
    session = recorded(simulation)
    estimate = estimated(session, gps_only=False)
    found = api.laps(session, estimate)
    others = np.array([lap.is_valid and i != found.reference_lap for i, lap in enumerate(found.laps)])
    if not found.corners or not others.any():
        return None
    true = true_losses(found, simulation, session, estimate)[others]
    lost, sigma, is_real = (
        np.stack([np.asarray(getattr(c, name)) for c in found.corners], axis=1)[others]
        for name in ("time_lost", "time_lost_sigma", "is_real")
    )
    known = np.isfinite(lost) & np.isfinite(true)
    usual, usual_sigma, usual_is_real = (
        np.array([getattr(c, name) for c in found.corners])
        for name in ("usual_lost", "usual_lost_sigma", "usual_is_real")
    )
    return CornerScore(
        case,
        lost[known],
        true[known],
        sigma[known],
        is_real[known],
        found.corners[0].real_from,
        usual,
        np.nanmedian(np.where(known, true, np.nan), axis=0),
        usual_sigma,
        usual_is_real,
    )


def true_losses(found: LapAnalysis, simulation: Simulation, session: Session, estimate: Trajectory) -> Array:
    """Return what every lap truly lost in every corner (L, C) s; NaN where it was not timed."""
    assert found.reference is not None and found.traces is not None and found.reference_lap is not None
    curve, off = Curve(found.reference), mean_error(simulation, session, estimate)
    bounds = np.array([found.corners[0].segment[0], *(corner.segment[1] for corner in found.corners)])
    seen = np.stack([np.interp(bounds, found.traces.distance, t) for t in found.traces.t])
    true = np.full(seen.shape, np.nan)
    for k, (centre, (north, west)) in enumerate(zip(*curve.place(bounds), strict=True)):
        left = np.array([-west, north])
        line = Line("between corners", centre + HALF * left, centre - HALF * left)
        passed = true_crossings(simulation, moved(line, -off), session.origin, estimate)
        for lap in np.flatnonzero(np.isfinite(seen[:, k])):
            nearest = passed[np.argmin(np.abs(passed - seen[lap, k]))] if passed.size else np.nan
            true[lap, k] = nearest if abs(nearest - seen[lap, k]) < NEAR else np.nan
    spent = np.diff(true, axis=1)
    return np.asarray(spent - spent[found.reference_lap])


def counts(lost: Array, true: Array, is_real: BoolArray) -> tuple[int, int, int, int]:
    """Return how many are called real, how many of these are luck, how many true ones are worth it, and are called."""
    worth = np.abs(true) > WORTH
    is_luck = is_real & (true * np.sign(lost) < LUCK * np.abs(lost))
    called = is_real & worth & (true * lost > 0.0)
    return tuple(int(np.count_nonzero(mask)) for mask in (is_real, is_luck, worth, called))  # type: ignore[return-value]


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, help="number of seeds, each on the next track")
    parser.add_argument("--first-seed", type=int, default=3)
    parser.add_argument("--durations", type=float, nargs="+", default=[600.0, 1500.0, 3400.0], help="s")
    parser.add_argument("--lapses", type=float, default=0.0, help="of the driver, a km")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    wanted = [
        dataclasses.replace(case, changes={"motion_lapse_rate": arguments.lapses})
        for duration in arguments.durations
        for preset in ("kart", "kart_harsh")
        for case in cases(preset, seeds, duration)
    ]
    print(f"{'session':<40} losses  from | two sigma: real luck | called real luck | true > {WORTH} s: called")
    scores = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for score in pool.map(run, wanted):
            if score is not None:
                print(_row(score), flush=True)
                scores.append(score)
    print(summary(scores))


def _alone(s: CornerScore) -> BoolArray:
    """What each loss would be called by itself."""
    return are_real(s.lost, s.sigma, float(least_significant(1.0)))


def _hochberg(s: CornerScore) -> BoolArray:
    ratio = np.sort(np.abs(s.lost / s.sigma))[::-1]
    needed = norm.isf(0.5 * FALSE * np.arange(1, len(ratio) + 1) / len(ratio))
    passing = np.flatnonzero(ratio >= needed)
    return are_real(s.lost, s.sigma, max(2.0, float(needed[passing[-1] if passing.size else 0])))


def _row(s: CornerScore) -> str:
    before, now = counts(s.lost, s.true, _alone(s)), counts(s.lost, s.true, s.is_real)
    name = f"{s.case.name} {s.case.duration:.0f} s"
    return (
        f"{name:<40} {len(s.lost):6d} {s.sure:5.1f} | {before[0]:15d} {before[1]:4d} | {now[0]:11d} {now[1]:4d} | "
        f"{now[2]:12d} {now[3]:6d}"
    )


def summary(scores: list[CornerScore]) -> str:
    """Return both decisions over all sessions, how honest the sigmas are, and the same of the usual losses."""
    lines = []
    for name, choose in (("two sigma", _alone), ("Hochberg", _hochberg), ("called real", lambda s: s.is_real)):
        each = np.array([counts(s.lost, s.true, choose(s)) for s in scores])
        lines.append(f"{name:<12} {_said(each)}")
    each = np.array([counts(s.usual, s.true_usual, s.usual_is_real) for s in scores])
    lines.append(f"{'usual loss':<12} {_said(each)}")
    for name, parts in (
        ("losses", [(s.lost - s.true) / s.sigma for s in scores]),
        ("usual losses", [(s.usual - s.true_usual) / s.usual_sigma for s in scores]),
    ):
        z = np.concatenate(parts)
        z = z[np.isfinite(z)]
        within = (100.0 * np.mean(np.abs(z) < k) for k in (1.0, 2.0))
        lines.append(
            f"{name}: error over sigma {np.sqrt(np.mean(z**2)):.2f} rms, "
            "{:.0f} and {:.0f} % within one and two".format(*within)
        )
    return "\n".join(lines)


def _said(each: Array) -> str:
    real, luck, worth, called = each.sum(axis=0)
    share = float(np.mean(each[:, 1] / np.maximum(each[:, 0], 1)))
    return (
        f"{real} real, {luck} of them luck ({100.0 * luck / max(real, 1):.0f} %; {100.0 * share:.0f} % in the mean of "
        f"the sessions), {called} of {worth} true ones above {WORTH} s"
    )


if __name__ == "__main__":
    main()
