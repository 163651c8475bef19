"""The slow error of fixes from laps on simulated karts: what is identified beside what was simulated.

    python benchmarks/lap_wander.py                  # 24 sessions a cell, ten laps each; some minutes on two cores
    python benchmarks/lap_wander.py --seeds 6        # a look
    python benchmarks/lap_wander.py --harm           # drivers and layouts that change, 20 sessions each
    SMOOTH_DATA=DIR python benchmarks/lap_wander.py --real

A cell is a wander (sigma m per axis, tau s). Of each: geometric mean of the identified change over a lap over the true
one, sigma sqrt(2 (1 - exp(-T / tau))), the standard deviation of its logarithm, and the rms of its error over the sigma
that is reported with it; sessions without four laps are counted. `spacing` says by how much stations of 5 and 15 m
change it against 10 m (largest of the cell).
"""

import argparse
import dataclasses
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.spatial import cKDTree

from smoother import api
from smoother.arrays import Array, IntArray
from smoother.fit.lap_registration import LapRegistration, register_laps
from smoother.frames import geodetic_to_nwu
from smoother.sim.presets import draw_scenario
from smoother.sim.scenario import with_changes
from smoother.sim.simulation import simulate
from smoother.sim.track import TRACKS, Track

LAPS, LAP = 10, 50.0  # s, about
SIGMAS, TAUS = (0.2, 0.5, 1.0, 2.0, 3.0), (60.0, 100.0, 200.0)
SPACINGS = (5.0, 15.0)
RECORDINGS = ("kart_okc_doves", "kart_massafinalese_racechrono", "kart_lignano_racebox", "kart_adria_first_half")
Change = Callable[[Track, Array, np.random.Generator], Array]
HARMED = ((0.5, 100.0), (1.0, 60.0))  # m, s: wander of the sessions whose drivers or layouts change


@dataclasses.dataclass(frozen=True)
class Score:
    """Logarithm of the identified change over a lap over the true one, its sigma, the same for both other spacings."""

    error: float
    spread: float
    spacing: float


def track_of(seed: int) -> Track:
    """The track of a seed."""
    return TRACKS[sorted(TRACKS)[seed % len(TRACKS)]]


def fixes(seed: int, sigma: float, tau: float, rate: float = 5.0) -> tuple[Array, Array]:
    """Times (N,) s and positions (N, 2) m of ten laps of a simulated kart."""
    draw, noise = np.random.default_rng(seed).spawn(2)
    scenario = draw_scenario("kart", draw, track_of(seed).name, LAPS * LAP + 30.0)
    changes = {"gnss_offset_horizontal": sigma, "gnss_offset_tau": tau, "gnss_rate": rate}
    simulation = simulate(dataclasses.replace(with_changes(scenario, changes), imu=None, mag=None), noise)
    gnss, origin = simulation.gnss.fixes, simulation.truth.origin
    return gnss.t, geodetic_to_nwu(gnss.lat_deg, gnss.lon_deg, gnss.alt_m, origin)[:, :2]


def unchanged(_: Track, position_n: Array, __: np.random.Generator) -> Array:
    """The driver as simulated."""
    return position_n


def other_corners(track: Track, position_n: Array, rng: np.random.Generator) -> Array:
    """The line of four corners is moved by 1 to 3 m, anew in every lap."""
    lap, place = places(track, position_n)
    beside = np.zeros(len(place))
    for corner in rng.uniform(0.0, track.length, 4):
        size = rng.uniform(1.0, 3.0, lap.max() + 1) * rng.choice([-1.0, 1.0], lap.max() + 1)
        beside += size[lap] * bump(track, place, corner, 20.0)
    return np.asarray(position_n + beside[:, None] * left_of(track, place))


def other_layout(track: Track, position_n: Array, rng: np.random.Generator) -> Array:
    """The second half of the laps goes 6 to 12 m aside over some 100 m."""
    lap, place = places(track, position_n)
    size = rng.uniform(6.0, 12.0) * rng.choice([-1.0, 1.0])
    beside = size * (lap > lap.max() // 2) * bump(track, place, rng.uniform(0.0, track.length), 30.0)
    return np.asarray(position_n + beside[:, None] * left_of(track, place))


def drifting(track: Track, position_n: Array, rng: np.random.Generator) -> Array:
    """The whole line moves outwards or inwards by half a metre during the session."""
    _, place = places(track, position_n)
    beside = rng.choice([-0.5, 0.5]) * np.linspace(0.0, 1.0, len(place))
    return np.asarray(position_n + beside[:, None] * left_of(track, place))


HARM: dict[str, Change] = {
    "as simulated": unchanged,
    "other corners": other_corners,
    "other layout": other_layout,
    "drifting line": drifting,
}


def places(track: Track, position_n: Array) -> tuple[IntArray, Array]:
    """Lap (N,), from 0, and distance (N,) m along the centre line."""
    table = np.arange(0.0, track.length, 1.0)
    _, nearest = cKDTree(track.centre(table)[:, :2]).query(position_n)
    place = table[nearest]
    return np.cumsum(np.diff(place, prepend=place[0]) < -0.5 * track.length), place


def bump(track: Track, place: Array, middle: float, sigma: float) -> Array:
    """A Gaussian (N,) about a distance along the track, m, one in the middle."""
    away = np.mod(place - middle + 0.5 * track.length, track.length) - 0.5 * track.length
    return np.asarray(np.exp(-0.5 * (away / sigma) ** 2))


def left_of(track: Track, place: Array) -> Array:
    """Unit vectors (N, 2) to the left."""
    tangent = track.tangent(place)
    return np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)


def run(case: tuple[float, float, int], change: Change = unchanged) -> Score | None:
    """One session; None without four laps."""
    sigma, tau, seed = case
    t, position_n = fixes(seed, sigma, tau)
    position_n = change(track_of(seed), position_n, np.random.default_rng(seed))
    found = register_laps(t, position_n)
    if found is None:
        return None
    true = sigma * np.sqrt(-2.0 * np.expm1(-found.time_of_lap / tau))
    others = [register_laps(t, position_n, spacing) for spacing in SPACINGS]
    apart = [abs(np.log(other.change / found.change)) for other in others if other is not None]
    return Score(float(np.log(found.change / true)), found.change_spread, max(apart, default=np.inf))


def line(name: str, scores: list[Score | None]) -> str:
    """A row of the table."""
    known = [score for score in scores if score is not None]
    error, spread = np.array([s.error for s in known]), np.array([s.spread for s in known])
    z, spacing = float(np.sqrt(np.mean((error / spread) ** 2))), [s.spacing for s in known]
    mean, own = float(np.exp(error.mean())), float(error.std())
    return (
        f"{name:<24} {len(known):>3} of {len(scores):<3} mean {mean:5.2f}  sd of log {own:5.2f}  largest "
        f"{np.exp(error.max()):5.2f}  z {z:4.2f}  spacing {np.median(spacing):5.2f} {max(spacing):5.2f}"
    )


def table(seeds: int, jobs: int) -> None:
    """All cells."""
    with ProcessPoolExecutor(jobs) as pool:
        for sigma in SIGMAS:
            for tau in TAUS:
                cases = [(sigma, tau, seed) for seed in range(seeds)]
                print(line(f"sigma {sigma:3.1f} m, tau {tau:3.0f} s", list(pool.map(run, cases))), flush=True)


def harm(seeds: int, jobs: int) -> None:
    """Drivers and layouts that change."""
    with ProcessPoolExecutor(jobs) as pool:
        for name, change in HARM.items():
            for sigma, tau in HARMED:
                cases = [(sigma, tau, seed) for seed in range(seeds)]
                scores = list(pool.map(partial(run, change=change), cases))
                print(line(f"{name}, {sigma:3.1f} m", scores), flush=True)


def real() -> None:
    """The recordings in SMOOTH_DATA."""
    folder = Path(os.environ["SMOOTH_DATA"])
    for name in RECORDINGS:
        session = api.read(folder / name)
        found = [register_laps(session.gnss.t, session.fix_position_n[:, :2], s) for s in (10.0, *SPACINGS)]
        print(f"{name:<30} " + "   ".join("none" if f is None else text_of(f) for f in found), flush=True)


def text_of(found: LapRegistration) -> str:
    """What one session shows."""
    step = np.diff(found.translation_n, axis=0)
    seen = np.sqrt(max(0.0, float(np.mean(step**2)) - 2.0 * found.noise**2))
    return (
        f"{found.laps} laps, change {found.change:.2f} m (log +- {found.change_spread:.2f}; as seen {seen:.2f}), "
        f"sigma {found.sigma:.2f} m, tau {found.tau:.0f} s"
    )


def main() -> int:
    """Print the tables that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--harm", action="store_true")
    parser.add_argument("--real", action="store_true")
    options = parser.parse_args()
    if options.real:
        real()
    elif options.harm:
        harm(options.seeds, options.jobs)
    else:
        table(options.seeds, options.jobs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
