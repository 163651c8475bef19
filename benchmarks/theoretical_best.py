"""Theoretical and rolling best on simulated karts: errors, and how honest their sigmas are, beside what was just seen.

    python benchmarks/theoretical_best.py --seeds 21 --duration 600     # a minute on one core
    python benchmarks/theoretical_best.py --seeds 24 --duration 150     # sessions of two or three laps

Lines stand at fixed places of the track, and what the GPS is off by in the mean of a session moves them alike for all
laps. The truth is therefore the sum over sectors of the least true time, over the laps that count, between the lines as
they were found or given, moved back by the session's mean error of position. The rolling best is compared with the
fastest window of the true drive on the line of the session's laps, moved likewise.
"""

import argparse
import dataclasses

import numpy as np

from lap_times import estimated, true_crossings
from scoring import Case, cases, recorded
from smoother import api
from smoother.arrays import Array
from smoother.frames import geodetic_to_nwu, nwu_to_geodetic
from smoother.laps.results import GivenLines, LapAnalysis, Line
from smoother.samples import Session
from smoother.sim.simulation import Simulation
from smoother.trajectory import Trajectory

NEAR = 1.0  # s between a crossing and the true one


@dataclasses.dataclass(frozen=True)
class Rolling:
    """The true rolling best, what is said of it with its sigma, and the fastest window as it was seen, all s."""

    true: float
    said: float
    sigma: float
    raw: float


@dataclasses.dataclass(frozen=True)
class TheoreticalScore:
    """One session: the laps that count, the true theoretical best, what is said of it with its sigma, the plain sum of
    the best sectors and the best lap, all s; the rolling best."""

    case: Case
    laps: int
    true: float
    said: float
    sigma: float
    raw: float
    best: float
    rolling: Rolling

    @property
    def error(self) -> float:
        """Of what is said, s."""
        return self.said - self.true


def run(case: Case, gps_only: bool = False) -> TheoreticalScore | None:
    """Simulate, smooth and score one session; None where fewer than two laps count."""
    simulation = case.simulate()
    session = recorded(simulation)
    estimate = estimated(session, gps_only)
    found = api.laps(session, estimate)
    said, sectors = found.statistics, true_sectors(found, simulation, session, estimate)
    if said is None or len(sectors) < 2:
        return None
    true = float(sectors.min(axis=0).sum())
    driven = true_analysis(found, simulation, session, estimate).statistics
    rolling = np.nan if driven is None else driven.rolling_raw
    return TheoreticalScore(
        case,
        len(sectors),
        true,
        said.theoretical,
        said.theoretical_sigma,
        said.theoretical_raw,
        said.best,
        Rolling(rolling, said.rolling, said.rolling_sigma, said.rolling_raw),
    )


def true_sectors(found: LapAnalysis, simulation: Simulation, session: Session, estimate: Trajectory) -> Array:
    """Return the true sector times (L, S) s of the laps that count and passed every line."""
    counting = [lap for lap in found.laps if lap.is_valid and np.isfinite(lap.sector_time).all()]
    if found.start_line is None or not counting:
        return np.empty((0, 1))
    off = mean_error(simulation, session, estimate)
    lines = (found.start_line, *found.sector_lines, found.start_line)
    passed = [true_crossings(simulation, moved(line, -off), session.origin, estimate) for line in lines]
    seen = np.array([[lap.start, *(lap.start + np.cumsum(lap.sector_time))] for lap in counting])
    true = np.stack([t[np.argmin(np.abs(t[:, None] - s), axis=0)] for t, s in zip(passed, seen.T, strict=True)], axis=1)
    return np.diff(true[np.all(np.abs(true - seen) < NEAR, axis=1)], axis=1)


def mean_error(simulation: Simulation, session: Session, estimate: Trajectory) -> Array:
    """Return how far (2,) m the session lies beside the truth in the mean."""
    true = simulation.truth.antenna_position_n(estimate.t, simulation.scenario.lever_arm_b)
    in_session = geodetic_to_nwu(*nwu_to_geodetic(true, simulation.truth.origin), session.origin)
    return np.asarray(np.nanmean((estimate.position_n - in_session)[:, :2], axis=0))


def true_analysis(found: LapAnalysis, simulation: Simulation, session: Session, estimate: Trajectory) -> LapAnalysis:
    """Return the analysis of the true drive on the line of a session's laps, which lies beside the truth."""
    assert found.start_line is not None
    true = simulation.truth.trajectory(estimate.t, simulation.scenario.lever_arm_b, session.origin)
    off = np.append(mean_error(simulation, session, estimate), 0.0)
    like = dataclasses.replace(
        true, position_n=true.position_n + off, sigmas=estimate.sigmas, report=estimate.report, joint=estimate.joint
    )
    known = np.flatnonzero(np.isfinite(true.position_n).all(axis=1))
    lines = GivenLines(np.stack([found.start_line.left_n, found.start_line.right_n]))
    return api.laps(session, like.rows(slice(known[0], known[-1] + 1)), lines, reference=found.reference)


def moved(line: Line, by: Array) -> Line:
    """Return the line moved by (2,) m."""
    return dataclasses.replace(line, left_n=line.left_n + by, right_n=line.right_n + by)


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="kart", choices=("white", "kart", "kart_harsh"))
    parser.add_argument("--seeds", type=int, default=21, help="number of seeds, each on the next track")
    parser.add_argument("--first-seed", type=int, default=301)
    parser.add_argument("--duration", type=float, default=600.0, help="s")
    parser.add_argument("--gps-only", action="store_true", help="smooth the fixes alone")
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    scores = []
    print(f"{'session':<32} laps     true     said  sigma   error  of the plain sum  of the best lap")
    for case in cases(arguments.preset, seeds, arguments.duration):
        score = run(case, arguments.gps_only)
        if score is not None:
            print(_row(score), flush=True)
            scores.append(score)
    print(summary(scores))


def _row(s: TheoreticalScore) -> str:
    others = f"{s.raw - s.true:+17.3f} {s.best - s.true:+16.3f}"
    return f"{s.case.name:<32} {s.laps:4d} {s.true:8.3f} {s.said:8.3f} {s.sigma:6.3f} {s.error:+7.3f} {others}"


def summary(scores: list[TheoreticalScore]) -> str:
    """Return mean and rms errors of what is said and of what was just seen, and how honest the sigmas are."""
    as_best = sum(s.said >= s.best - 1e-6 for s in scores)
    theoretical = np.array([(s.error, s.sigma, s.raw - s.true) for s in scores])
    windows = [s.rolling for s in scores]
    rolling = np.array([(w.said - w.true, w.sigma, w.raw - w.true) for w in windows])
    return (
        f"{len(scores)} sessions; as the best lap {as_best} times\n"
        f"theoretical: {_said(theoretical)}; plain sum {_errors(theoretical[:, 2])}\n"
        f"rolling: {_said(rolling)}; fastest window {_errors(rolling[:, 2])}"
    )


def _said(values: Array) -> str:
    error, sigma = values[:, 0], values[:, 1]
    z, usual = error / sigma, np.sqrt(np.mean(sigma**2))
    return (
        f"{_errors(error)} where {usual:.3f} is said; error over sigma {np.sqrt(np.mean(z**2)):.2f} rms, "
        f"{100 * np.mean(np.abs(z) < 1.0):.0f} and {100 * np.mean(np.abs(z) < 2.0):.0f} % within one and two"
    )


def _errors(error: Array) -> str:
    return f"mean error {error.mean():+.3f}, rms {np.sqrt(np.mean(error**2)):.3f} s"


if __name__ == "__main__":
    main()
