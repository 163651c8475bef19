"""What the lap closure is worth on simulated karts with all sensors: line and lap times with it and without it.

    python benchmarks/lap_closure.py               # wander of 0.2 to 3 m, 12 sessions of ten laps each
    python benchmarks/lap_closure.py --harm        # drivers and layouts that change, 12 sessions each
    SMOOTH_DATA=DIR python benchmarks/lap_closure.py --real

Of each row: rms of the line's error from its mean over the session, m; rms of the error of times from one passage of a
station to the next, ms, at eight stations of the lap, for the same graph without and with the closure, the ratio of
both, and the rms of the latter over its sigma. `worst` is the largest ratio of a single session.
"""

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.interpolate import make_interp_spline

from golden_laps import change_of_line
from scoring import TRACKS, recorded
from smoother import api
from smoother.arrays import Array
from smoother.fit.lap_crossings import cross_stations
from smoother.frames import geodetic_to_nwu, nwu_to_geodetic
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.closure import tie_laps
from smoother.laps.stage import fix_path
from smoother.sim import motion
from smoother.sim.simulation import Simulation
from smoother.sim.track import TRACKS as OUTLINES
from smoother.trajectory import Trajectory

DURATION = 530.0  # s: ten laps
STATIONS = 8
WANDERS = ((0.2, 100.0), (0.5, 100.0), (1.0, 100.0), (2.0, 60.0), (3.0, 60.0))  # m, s
RECORDINGS = ("kart_lignano_racebox", "kart_adria_first_half")
Beside = Callable[[Array, float, np.random.Generator], Array]  # m, of the distance driven and the length of a lap


def unchanged(distance: Array, _: float, __: np.random.Generator) -> Array:
    """The driver as simulated."""
    return np.zeros_like(distance)


def other_corners(distance: Array, length: float, rng: np.random.Generator) -> Array:
    """The line of four corners is moved by 1 to 3 m, anew in every lap."""
    lap = _lap(distance, length)
    out = np.zeros_like(distance)
    for corner in rng.uniform(0.0, length, 4):
        size = rng.uniform(1.0, 3.0, lap.max() + 1) * rng.choice([-1.0, 1.0], lap.max() + 1)
        out += size[lap] * _bump(distance, length, corner, 20.0)
    return out


def other_layout(distance: Array, length: float, rng: np.random.Generator) -> Array:
    """The second half of the laps goes 6 to 12 m aside over some 100 m."""
    lap = _lap(distance, length)
    size = rng.uniform(6.0, 12.0) * rng.choice([-1.0, 1.0])
    return np.asarray(size * (lap > 5) * _bump(distance, length, rng.uniform(0.0, length), 30.0))


def drifting(distance: Array, length: float, rng: np.random.Generator) -> Array:
    """The whole line moves outwards or inwards by half a metre in ten laps."""
    return np.asarray(rng.choice([-0.5, 0.5]) * np.clip(distance / (10.0 * length), 0.0, 1.0))


HARM: dict[str, tuple[Beside, dict[str, float]]] = {
    "as simulated": (unchanged, {}),
    "loose, 1 m over 120 m": (unchanged, {"motion_line_sigma": 1.0, "motion_line_length": 120.0}),
    "other corners": (other_corners, {}),
    "other layout": (other_layout, {}),
    "drifting line": (drifting, {}),
}


def _lap(distance: Array, length: float) -> Any:
    return np.floor((distance - distance[0]) / length).astype(np.int64)


def _bump(distance: Array, length: float, middle: float, sigma: float) -> Array:
    away = np.mod(distance - middle + 0.5 * length, length) - 0.5 * length
    return np.asarray(np.exp(-0.5 * (away / sigma) ** 2))


@contextmanager
def driven_by(beside: Beside, length: float, seed: int) -> Iterator[None]:
    """The simulator with a driver whose line is moved; of its random functions the first one is the line."""
    original, calls = motion.wander, []

    def wander(start: float, stop: float, *rest: Any) -> Any:
        own = original(start, stop, *rest)
        calls.append(start)
        if len(calls) > 1:
            return own
        at = np.arange(start, stop + 2.0)
        return make_interp_spline(at, own(at) + beside(at, length, np.random.default_rng(seed)), k=5)

    motion.wander = wander  # type: ignore[assignment]
    try:
        yield
    finally:
        motion.wander = original


@dataclass(frozen=True)
class Score:
    """Mean squares of a session: of the line, m^2; of times, s^2; of these over their sigmas."""

    line: float
    time: float
    z: float


def run(case: tuple[float, float, int], beside: Beside, changes: dict[str, float]) -> tuple[Score, Score] | None:
    """A session without and with the closure; None without four laps."""
    sigma, tau, seed = case
    track = TRACKS[seed % 3]
    with driven_by(beside, OUTLINES[track].length, seed):
        simulation = api.simulate(
            "kart",
            seed,
            track=track,
            duration=DURATION,
            motion_standstill=None,
            gnss_offset_horizontal=sigma,
            gnss_offset_tau=tau,
            **changes,
        )
    session = recorded(simulation)
    before = api.smooth(session)
    after = tied(before)
    crossings = cross_stations(before.t, before.position_n[:, :2])
    if crossings is None or len(crossings.offset) < 4:
        return None
    some = np.linspace(0, len(crossings.distance) - 1, STATIONS).astype(np.int64)
    at = crossings.time[:, some]
    at = at[:, np.isfinite(at).all(axis=0)]
    return scored(simulation, before, at, session.origin), scored(simulation, after, at, session.origin)


def tied(estimate: Trajectory) -> Trajectory:
    """The trajectory as the lap analysis uses it."""
    assert estimate.joint is not None
    moved, joint = tie_laps(estimate, estimate.joint)
    return replace(moved, joint=joint)


def scored(simulation: Simulation, estimate: Trajectory, at: Array, origin: Any) -> Score:
    """Score of an estimate at the times (L, S) s at which laps pass stations."""
    t = at.ravel()
    lat, lon, alt = nwu_to_geodetic(
        simulation.truth.antenna_position_n(t, simulation.scenario.lever_arm_b), simulation.truth.origin
    )
    true = geodetic_to_nwu(lat, lon, alt, origin)[:, :2]
    place, velocity = (_at(estimate, values, t) for values in (estimate.position_n, estimate.velocity_n))
    error, speed = (place - true).reshape(*at.shape, 2), np.hypot(*velocity.T).reshape(at.shape)
    along = (velocity / speed.reshape(-1, 1)).reshape(*at.shape, 2)
    assert estimate.joint is not None
    direction_n = np.column_stack([along.reshape(-1, 2), np.zeros(len(t))])
    P = estimate.joint.covariance(t, direction_n) / np.outer(speed.ravel(), speed.ravel())
    late = np.einsum("lsi,lsi->ls", error, along) / speed
    variance, S = np.diag(P), at.shape[1]
    changed = variance[S:] + variance[:-S] - 2.0 * np.diagonal(P, S)
    times = np.diff(late, axis=0).ravel()
    off = error - error.mean(axis=(0, 1))
    return Score(float(np.mean(off**2)), float(np.mean(times**2)), float(np.mean(times**2 / changed)))


def _at(estimate: Trajectory, values: Array, t: Array) -> Array:
    return np.column_stack([np.interp(t, estimate.t, values[:, i]) for i in range(2)])


def row(name: str, results: list[tuple[Score, Score] | None]) -> str:
    """A row of the table."""
    known = [result for result in results if result is not None]
    line, time, z = (np.sqrt([[getattr(s, kind) for s in pair] for pair in known]) for kind in ("line", "time", "z"))

    def both(values: Array, digits: int, unit: float) -> str:
        before, after = unit * np.sqrt(np.mean(values**2, axis=0))
        worst = float(np.max(values[:, 1] / values[:, 0]))
        return f"{before:6.{digits}f} -> {after:5.{digits}f} ({after / before:4.2f}, worst {worst:4.2f})"

    sizes = " -> ".join(f"{value:4.2f}" for value in np.sqrt(np.mean(z**2, axis=0)))
    counts = f"{len(known):>3} of {len(results):<3}"
    return f"{name:<24}{counts} line m {both(line, 3, 1.0)}  lap ms {both(time, 1, 1e3)}  z {sizes}"


def simulated(seeds: int, jobs: int, *, harm: bool) -> None:
    """All rows."""
    with ProcessPoolExecutor(jobs) as pool:
        if harm:
            for name, (beside, changes) in HARM.items():
                cases = [(1.0, 100.0, seed) for seed in range(seeds)]
                print(row(name, list(pool.map(partial(run, beside=beside, changes=changes), cases))), flush=True)
            return
        for sigma, tau in WANDERS:
            cases = [(sigma, tau, seed) for seed in range(seeds)]
            work = partial(run, beside=unchanged, changes={})
            print(row(f"wander {sigma} m, {tau:.0f} s", list(pool.map(work, cases))), flush=True)


def real() -> None:
    """Change of the line from lap to lap of the recordings in SMOOTH_DATA: of the fixes, without and with closure."""
    for name in RECORDINGS:
        session = api.read(Path(os.environ["SMOOTH_DATA"]) / name)
        before = api.smooth(session)
        after = tied(before)
        times, laps = [], []
        for ties in (False, True):
            laps = [lap for lap in analyse(before, fix_path(session), LapOptions(ties_laps=ties)).laps if lap.is_valid]
            times.append(np.array([(lap.time, lap.sigma) for lap in laps]))
        starts, ends = (np.array([getattr(lap, which) for lap in laps]) for which in ("start", "end"))
        paths = [(session.gnss.t, session.fix_position_n), *((s.t, s.position_n) for s in (before, after))]
        changes = [change_of_line(t, position_n[:, :2], starts, ends) for t, position_n in paths]
        print(f"{name:<24} change of the line, m: " + ", ".join(f"{change:.3f}" for change in changes if change))
        print(
            "   lap times, s: "
            + "; ".join(
                f"{a[0]:.3f} {1e3 * a[1]:.0f} -> {b[0]:.3f} {1e3 * b[1]:.0f}" for a, b in zip(*times, strict=True)
            )
        )


def main() -> int:
    """Print the tables that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--harm", action="store_true")
    parser.add_argument("--real", action="store_true")
    options = parser.parse_args()
    if options.real:
        real()
    else:
        simulated(options.seeds, options.jobs, harm=options.harm)
    return 0


if __name__ == "__main__":
    sys.exit(main())
