"""Lap times on simulated karts: error beside the information bound and beside the raw fixes, honesty of the sigmas.

    python benchmarks/lap_times.py --seeds 54 --duration 600     # 300 laps in disjoint pairs; ten minutes on two cores
    python benchmarks/lap_times.py --seeds 6 --duration 300      # a look
    python benchmarks/lap_times.py --gps-only --change gnss_rate=10 --change gnss_offset_horizontal=0.25

Seeds take the tracks in turn, standing and rolling starts. Every second lap counts, so that no two share a crossing,
beginning with the first flying one: a lap that follows a standing start begins at the pace of a jogger. Other choices
are printed beside it: the first, third, .. and the second, fourth, .. of each session whatever its start, all laps, and
those from the grid alone. The bound is the least standard deviation
that any estimator of the time between the two crossings can have, from truth and true noise. Raw fixes are joined by
straight lines, at the receiver's own times and at the stamps as logged. Laps are looked for with the track's own line
and with none; a lap that is missing, or found where the truth has none, is counted and named.
"""

import argparse
import dataclasses
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.sparse import block_array, coo_array, csc_array
from scipy.sparse.linalg import splu

from bound import BoundOptions, information_system
from scoring import Case, cases, recorded, rms
from smoother import api, so3
from smoother.arrays import Array
from smoother.frames import Origin, geodetic_to_nwu, nwu_to_geodetic
from smoother.laps.results import FixPath, GivenLines, LapAnalysis, Line
from smoother.laps.timing import forward_normal, raw_crossings
from smoother.samples import Session
from smoother.sim.simulation import Simulation
from smoother.trajectory import Trajectory

SAME_LAP = 1.0  # s; a found crossing farther from every true one is another's
WIDER = 2.0  # times a found line, on which true crossings are looked for: the GPS may have put it metres aside


@dataclasses.dataclass(frozen=True)
class LapScore:
    """One lap: error of smoothed and raw time, sigma, bound, all s.

    place: from 0, among those of its session; every second shares no crossing with another. logged_error: raw, with the
    stamps as logged. is_from_grid: the first after a standing start.
    """

    number: int
    time: float
    error: float
    raw_error: float
    logged_error: float
    sigma: float
    bound: float
    is_valid: bool
    place: int
    is_from_grid: bool


@dataclasses.dataclass(frozen=True)
class SessionScore:
    """One session: its laps, how many were missed or invented with the line given and with none."""

    case: Case
    laps: list[LapScore]
    given: tuple[int, int, int]  # true, missed, false
    found: tuple[int, int, int]
    found_errors: list[tuple[float, float]]  # error and sigma of laps on the found line
    seconds: tuple[float, float]  # estimating, analysing: CPU
    source: str


def run(case: Case, gps_only: bool) -> SessionScore:
    """Simulate, smooth, time laps and score one session."""
    simulation = case.simulate()
    session = recorded(simulation)
    since = time.process_time()
    estimate = estimated(session, gps_only)
    between = time.process_time()
    given = api.laps(session, estimate, true_line(simulation, session.origin))
    found = api.laps(session, estimate)
    seconds = between - since, 0.5 * (time.process_time() - between)
    crossings = simulation.lap_crossings()
    crossings = within(crossings, estimate)
    logged = logged_times(given, simulation, session.fix_position_n[:, :2])
    laps, given_counts = scored(given, crossings, simulation, logged, case.standing, estimate)
    found_errors, found_counts = [], (0, 0, 0)
    if found.start_line is not None:
        on_found = true_crossings(simulation, found.start_line, session.origin, estimate)
        pairs, missed, false = paired(found, on_found, estimate)
        found_counts = len(on_found) - 1, missed, false
        found_errors = [(found.laps[i].time - t, found.laps[i].sigma) for i, t, _ in pairs]
    return SessionScore(case, laps, given_counts, found_counts, found_errors, seconds, given.sigma_source)


def estimated(session: Session, gps_only: bool) -> Trajectory:
    """Return the smoothed session, with the inertial sensor or from the fixes alone."""
    return api.smooth(session, imu=not gps_only)


def true_line(simulation: Simulation, origin: Origin) -> GivenLines:
    """Return the track's own start/finish line in the session's n."""
    ends = simulation.track.start_line_deg
    plan = geodetic_to_nwu(ends[:, 0], ends[:, 1], np.full(2, origin.alt_m), origin)[:, :2]
    return GivenLines(plan, name=simulation.track.name)


def true_crossings(simulation: Simulation, line: Line, origin: Origin, estimate: Trajectory) -> Array:
    """Return the true times (K,) s at which the antenna crossed a line of the session, ends widened."""
    centre, half = 0.5 * (line.left_n + line.right_n), 0.5 * WIDER * (line.left_n - line.right_n)
    ends = np.concatenate([np.stack([centre + half, centre - half]), np.zeros((2, 1))], axis=1)
    lat, lon, _ = nwu_to_geodetic(ends, origin)
    plan = geodetic_to_nwu(lat, lon, np.full(2, simulation.truth.origin.alt_m), simulation.truth.origin)[:, :2]
    crossings = simulation.truth.crossings(plan, simulation.scenario.lever_arm_b)
    return within(crossings, estimate)


def within(crossings: Array, estimate: Trajectory) -> Array:
    """Return those of the true times (K,) s that lie within the session."""
    return np.asarray(crossings[(crossings > estimate.t[0]) & (crossings < estimate.t[-1])])


def paired(
    analysis: LapAnalysis, crossings: Array, estimate: Trajectory
) -> tuple[list[tuple[int, float, int]], int, int]:
    """Return (index of a lap, its true time, its first true crossing); how many were missed; how many false.

    A lap that begins or ends within a moment of the session's own beginning and end is neither: the true crossing may
    lie beyond it.
    """
    first, last = float(estimate.t[0]) + SAME_LAP, float(estimate.t[-1]) - SAME_LAP
    pairs, false = [], 0
    for i, lap in enumerate(analysis.laps):
        if not lap.is_timed:
            continue
        k, end = (int(np.argmin(np.abs(crossings - t))) for t in (lap.start, lap.end))
        near = max(abs(crossings[k] - lap.start), abs(crossings[end] - lap.end)) < SAME_LAP
        if near and end == k + 1:
            pairs.append((i, float(crossings[end] - crossings[k]), k))
        elif lap.start > first and lap.end < last:
            false += 1
    found = {k + 1 for _, _, k in pairs}
    inside = (crossings > first) & (crossings < last)
    missed = sum(end not in found and bool(inside[end - 1] and inside[end]) for end in range(1, len(crossings)))
    return pairs, missed, false


def logged_times(analysis: LapAnalysis, simulation: Simulation, position_n: Array) -> Array:
    """Return the times (L,) s of all laps by straight lines between the fixes, at the stamps as they were logged."""
    if analysis.start_line is None:
        return np.empty(0)
    fixes = FixPath(simulation.raw.gnss.t, position_n)
    late = float(np.median(simulation.raw.gnss.t - recorded(simulation).gnss.t))
    ends = np.array([(lap.start, lap.end) for lap in analysis.laps]) + late
    first, last = (raw_crossings(fixes, analysis.start_line, end) for end in ends.T)
    return np.asarray(last - first)


def scored(
    analysis: LapAnalysis,
    crossings: Array,
    simulation: Simulation,
    logged: Array,
    standing: bool,
    estimate: Trajectory,
) -> tuple[list[LapScore], tuple[int, int, int]]:
    """Return the score of every lap on the given line, and how many laps there are, were missed, and are false."""
    pairs, missed, false = paired(analysis, crossings, estimate)
    assert analysis.start_line is not None or not pairs
    bounds = lap_bounds(simulation, crossings, analysis.start_line) if pairs else np.empty(0)
    laps = []
    for n, (i, true, k) in enumerate(pairs):
        lap = analysis.laps[i]
        laps.append(
            LapScore(
                lap.number,
                true,
                lap.time - true,
                lap.raw_time - true,
                float(logged[i]) - true,
                lap.sigma,
                float(bounds[k]),
                lap.is_valid,
                n,
                standing and k == 0,
            )
        )
    return laps, (max(len(crossings) - 1, 0), missed, false)


def lap_bounds(simulation: Simulation, crossings: Array, line: Line | None) -> Array:
    """Return the least standard deviation (K-1,) s of the times between successive crossings (K,) s of a line."""
    assert line is not None
    system, states, _ = information_system(simulation, BoundOptions())
    K, n, m = system.border.shape
    solver = splu(  # positive definite and banded: any other order or pivot fills it in
        _sparse(system.diagonal, system.upper, system.border, system.corner),
        permc_spec="NATURAL",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    arm = simulation.scenario.lever_arm_b
    normal = np.append(forward_normal(line), 0.0)
    closing = simulation.truth.antenna_velocity_n(crossings, arm) @ normal
    rhs = np.zeros((K * n + m, len(crossings)))
    k = np.clip(np.searchsorted(states.t, crossings) - 1, 0, K - 2)
    share = (crossings - states.t[k]) / (states.t[k + 1] - states.t[k])
    for column in range(len(crossings)):
        for node, part in ((k[column], 1.0 - share[column]), (k[column] + 1, share[column])):
            R = states.R_nb[node]
            row = rhs[node * n : node * n + n, column]
            row[0:3] += part * (normal @ -so3.skew(R @ arm))
            row[6:9] += part * normal
            rhs[K * n + 2 : K * n + 5, column] += part * (normal @ R)
    rhs /= -closing
    covariance = rhs.T @ solver.solve(rhs)
    own = np.diag(covariance)
    return np.sqrt(own[1:] + own[:-1] - 2.0 * np.diagonal(covariance, 1))


def _sparse(diagonal: Array, upper: Array, border: Array, corner: Array) -> csc_array:
    """Return the whole information matrix."""
    K, n, m = border.shape
    node, row, column = np.meshgrid(np.arange(K), np.arange(n), np.arange(n), indexing="ij")
    i, j = (node * n + row).ravel(), (node * n + column).ravel()
    above = node.ravel() < K - 1
    chain = coo_array((diagonal.ravel(), (i, j)), shape=(K * n, K * n))
    step = coo_array((upper.ravel(), (i[above], j[above] + n)), shape=(K * n, K * n))
    edge = coo_array(border.reshape(K * n, m))
    matrix = csc_array(block_array([[chain + step + step.T, edge], [edge.T, coo_array(corner)]]))
    matrix.eliminate_zeros()
    return matrix


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="kart", choices=("white", "kart", "kart_harsh"))
    parser.add_argument("--seeds", type=int, default=54, help="number of seeds, each on the next track")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=600.0, help="s")
    parser.add_argument("--gps-only", action="store_true", help="smooth the fixes alone")
    parser.add_argument("--change", action="append", default=[], metavar="NAME=VALUE", help="a figure of the simulator")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    work = partial(run, gps_only=arguments.gps_only)
    scores = []
    print(f"{'session':<32} laps  missed false | none given: laps missed false | rms ms  bound  raw    CPU s")
    with ProcessPoolExecutor(arguments.jobs) as pool:
        changes = {name: float(value) for name, value in (change.split("=") for change in arguments.change)}
        usual = cases(arguments.preset, seeds, arguments.duration)
        wanted = [dataclasses.replace(case, changes=changes) for case in usual]
        for score in pool.map(work, wanted) if arguments.jobs > 1 else map(work, wanted):
            print(_row(score))
            sys.stdout.flush()
            scores.append(score)
    print(_summary(scores))


def _row(s: SessionScore) -> str:
    laps = [lap for lap in s.laps if lap.is_valid]
    error, bound, raw = (1e3 * rms(getattr(lap, name) for lap in laps) for name in ("error", "bound", "raw_error"))
    counts = "{:>4} {:>7} {:>5}".format(*s.given) + "   |           {:>6} {:>6} {:>5}".format(*s.found)
    return f"{s.case.name:<32} {counts} | {error:6.1f} {bound:6.1f} {raw:6.1f}  {s.seconds[0]:.1f} + {s.seconds[1]:.1f}"


def _summary(scores: list[SessionScore]) -> str:
    everything = [lap for s in scores for lap in s.laps]
    counting = [lap for lap in everything if lap.is_valid]
    found = [pair for s in scores for pair in s.found_errors]
    totals = [[sum(getattr(s, kind)[i] for s in scores) for i in range(3)] for kind in ("given", "found")]
    choices = {
        "disjoint flying laps": [
            lap
            for s in scores
            for lap in s.laps
            if lap.is_valid and not lap.is_from_grid and (lap.place - s.case.standing) % 2 == 0
        ],
        "disjoint: 1st, 3rd, ..": [lap for lap in counting if lap.place % 2 == 0],
        "disjoint: 2nd, 4th, ..": [lap for lap in counting if lap.place % 2 == 1],
        "all": counting,
        "all but from the grid": [lap for lap in counting if not lap.is_from_grid],
        "from the grid": [lap for lap in counting if lap.is_from_grid],
    }
    lines = [
        f"\nsigmas: {', '.join(sorted({s.source for s in scores}))}",
        f"{'laps':<24} count rms ms  bound times | raw ms times, logged ms times, in bounds | 1, 2 sigma, sigma ms, z",
        *(_choice(name, laps) for name, laps in choices.items()),
        f"line given: {totals[0][0]} laps, {totals[0][1]} missed, {totals[0][2]} false, "
        f"{len(everything) - len(counting)} do not count",
        f"line found: {totals[1][0]} laps, {totals[1][1]} missed, {totals[1][2]} false, "
        f"rms {1e3 * rms(e for e, _ in found):.1f} ms",
    ]
    return "\n".join(lines)


def _choice(name: str, laps: list[LapScore]) -> str:
    """A row: our error and how many times the bound; raw errors and how many times ours; theirs in bounds; coverage."""
    error, bound, raw, logged, sigma = (
        1e3 * rms(getattr(lap, which) for lap in laps)
        for which in ("error", "bound", "raw_error", "logged_error", "sigma")
    )
    ours = f"{name:<24} {len(laps):5d} {error:6.1f} {bound:6.1f} {error / bound:5.2f}"
    theirs = f"{raw:6.1f} {raw / error:5.2f}  {logged:9.1f} {logged / error:5.2f}  {raw / bound:11.2f}"
    z = rms(lap.error / lap.sigma for lap in laps)
    return f"{ours} | {theirs} | {100 * _within(laps, 1.0):6.1f} {100 * _within(laps, 2.0):7.1f} {sigma:8.1f} {z:5.2f}"


def _within(laps: list[LapScore], sigmas: float) -> float:
    return float(np.mean([abs(lap.error) <= sigmas * lap.sigma for lap in laps])) if laps else np.nan


if __name__ == "__main__":
    main()
