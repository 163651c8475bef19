"""Karts whose figures are drawn at random: is the smoother honest, and good, where nobody has looked?

    python benchmarks/random_karts.py --sessions 200

Rates of samples and fixes, noise of every sensor, delays, lever arm, vibration, grip, slip, outages, track, start and
length are drawn for each session, over what real devices have; some receivers send no Doppler, some a vertical one. A
line for each session: delays and arm over their own sigmas, shares of velocities, attitudes, lines and positions within
two sigmas, errors over the information bound (which knows scale and misalignment: with a good gyro these are what
limits attitude). Then the same for groups, and for all else that is identified, error over sigma.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from scoring import ANGLES, QUANTITIES, TRACKS, Case, Score, ScoreOptions, other_values, recorded, score
from smoother import api

FIRST = 7000  # of the seeds by which figures are drawn
VALUES = ("gps_position_latency", "gps_velocity_latency", "arm_x", "arm_y")
SHARES = {
    "velocity": ("vel_north", "vel_west"),
    "attitude": ANGLES,
    "line": ("track",),
    "position": ("pos_north", "pos_west"),
}
WORTH_A_LOOK = 3.0  # sigmas


def draw(seed: int) -> Case:
    """Return a session whose figures are drawn by `seed`."""
    rng = np.random.default_rng(FIRST + seed)

    def between(low: float, high: float) -> float:
        """A value as likely in every octave from low to high as in any other."""
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    duration = float(round(between(120.0, 400.0)))
    changes: dict[str, Any] = {
        "imu_rate": float(rng.choice([50, 100, 200, 200, 400, 1000])),
        "imu_accel_noise": between(0.05, 1.0),
        "imu_gyro_noise": between(0.003, 0.05),
        "imu_accel_tone": between(0.5, 10.0),
        "imu_gyro_tone": between(0.03, 1.5),
        "imu_jitter": float(rng.uniform(0.0, 0.004)),
        "imu_clock_drift": float(rng.normal() * 1e-4),
        "gnss_rate": float(rng.choice([1, 2, 4, 5, 5, 8, 10, 10, 18, 20, 25])),
        "gnss_white_horizontal": between(0.03, 1.5),
        "gnss_offset_horizontal": between(0.3, 4.0),
        "gnss_offset_tau": between(30.0, 150.0),
        "gnss_velocity_sigma": between(0.03, 0.4),
        "gnss_position_latency": float(rng.uniform(0.0, 0.4)),
        "motion_grip_g": float(rng.uniform(1.0, 2.4)),
        "motion_slip_per_acceleration": float(rng.uniform(0.0, 0.012)),
        "motion_slip_sigma": float(rng.uniform(0.0, 0.6)),
        "motion_roll_per_acceleration": float(rng.uniform(0.0, 0.004)),
        "motion_pitch_per_acceleration": float(rng.uniform(0.0, 0.004)),
        "motion_roughness": between(0.001, 0.01),
        "motion_kerb_height": float(rng.uniform(0.0, 0.03)),
        "motion_line_sigma": float(rng.uniform(0.2, 1.0)),
    }
    changes["gnss_white_up"] = 1.7 * changes["gnss_white_horizontal"]
    changes["gnss_offset_up"] = 1.7 * changes["gnss_offset_horizontal"]
    changes["gnss_velocity_latency"] = max(0.0, changes["gnss_position_latency"] + float(rng.uniform(-0.05, 0.2)))
    preset = str(rng.choice(["kart", "kart", "kart_harsh"]))
    if rng.random() < 0.4:
        changes["gnss_outages"] = ()
    if preset == "kart_harsh" and rng.random() < 0.5:
        changes["gnss_jumps"] = ()
    if rng.random() < 0.3:
        changes["gnss_has_vertical_velocity"] = True
    if rng.random() < 0.15:
        changes["gnss_velocity"] = False
    changes["lever_arm_b"] = rng.uniform([-1.0, -0.4, 0.0], [1.0, 0.4, 0.8])
    return Case(preset, seed, str(rng.choice(TRACKS)), duration, bool(rng.random() < 0.5), changes)


def run(seed: int) -> Score:
    """Simulate, smooth and score the session drawn by `seed`."""
    case = draw(seed)
    simulation = case.simulate()
    session, since = recorded(simulation), time.perf_counter()
    estimate = api.smooth(session)
    with np.errstate(divide="ignore"):  # the bound of a delay that nothing tells
        return score(case, simulation, session, estimate, time.perf_counter() - since, ScoreOptions())


def normalised(scores: Sequence[Score]) -> np.ndarray:
    """Errors of delays and arms over their own sigmas, of all sessions."""
    return np.array([s.values[key].z for s in scores for key in VALUES if key in s.values])


def share(scores: Sequence[Score], names: tuple[str, ...], sigmas: int) -> float:
    """Mean share within so many sigmas, 1 or 2."""
    return float(np.mean([s.coverage[name][sigmas - 1] for s in scores for name in names if name in s.coverage]))


def _line(s: Score) -> str:
    c, z = s.case.changes, normalised([s])
    doppler = f"{c['gnss_velocity_sigma']:.2f}" if c.get("gnss_velocity", True) else "none"
    figures = (
        f"{s.case.seed:4d} {s.case.preset:10} {s.case.duration:3.0f} s, samples {c['imu_rate']:4.0f} Hz "
        f"{c['imu_accel_noise']:.2f} {c['imu_gyro_noise']:.3f}, fixes {c['gnss_rate']:2.0f} Hz "
        f"{c['gnss_white_horizontal']:.2f} {doppler:4}"
    )
    shares = " ".join(f"{100.0 * share([s], names, 2):3.0f}" for names in SHARES.values())
    times = " ".join(f"{s.rms[q] / s.bound[q]:5.2f}" for q in QUANTITIES)
    flag = "  <-" if np.any(np.abs(z) > WORTH_A_LOOK) else ""
    mode = "" if s.mode == "full" else f" {s.mode}"
    return f"{figures}  z {' '.join(f'{value:+5.1f}' for value in z)}  {shares}  {times}{mode}{flag}"


def _group(name: str, scores: Sequence[Score]) -> str:
    z = normalised(scores)
    shares = "  ".join(
        f"{what} {100.0 * share(scores, names, 1):.0f}/{100.0 * share(scores, names, 2):.0f}"
        for what, names in SHARES.items()
    )
    times = " ".join(f"{np.median([s.rms[q] / s.bound[q] for s in scores]):.2f}" for q in QUANTITIES)
    beyond = f"{100.0 * np.mean(np.abs(z) > 2.0):.1f} % beyond 2, {100.0 * np.mean(np.abs(z) > 3.0):.1f} % beyond 3"
    return f"{name:<22}{len(scores):4d}  z {np.sqrt(np.mean(z**2)):.2f}, {beyond}  {shares}  {times}"


def _groups(scores: Sequence[Score]) -> list[str]:
    has_doppler: Callable[[Score], bool] = lambda s: bool(s.case.changes.get("gnss_velocity", True))  # noqa: E731
    kinds: dict[str, Callable[[Score], bool]] = {
        "all": lambda _: True,
        "without Doppler": lambda s: not has_doppler(s),
        "fixes up to 2 Hz": lambda s: has_doppler(s) and s.case.changes["gnss_rate"] <= 2.0,
        "fixes 4 to 10 Hz": lambda s: has_doppler(s) and 2.0 < s.case.changes["gnss_rate"] <= 10.0,
        "fixes 18 to 25 Hz": lambda s: has_doppler(s) and s.case.changes["gnss_rate"] > 10.0,
        "Doppler below 0.06": lambda s: has_doppler(s) and s.case.changes["gnss_velocity_sigma"] < 0.06,
        "Doppler upwards": lambda s: has_doppler(s) and "gnss_has_vertical_velocity" in s.case.changes,
        "fixes beyond 0.9 m": lambda s: s.case.changes["gnss_white_horizontal"] > 0.9,
        "samples beyond 0.5": lambda s: s.case.changes["imu_accel_noise"] > 0.5,
        "arms beyond 0.6 m": lambda s: float(np.hypot(*s.case.changes["lever_arm_b"][:2])) > 0.6,
    }
    chosen = {name: [s for s in scores if belongs(s)] for name, belongs in kinds.items()}
    return [_group(name, some) for name, some in chosen.items() if some]


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="number of the first session")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    print(
        "z of both delays, arm x, y; % within two sigmas: velocity, attitude, line, position; error / bound: velocity,"
    )
    print("position over 1 s, roll, pitch, yaw")
    scores = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for result in pool.map(run, range(arguments.first, arguments.first + arguments.sessions)):
            print(_line(result))
            sys.stdout.flush()
            scores.append(result)
    print("\nz rms; % within one and two sigmas; median error over the bound, of velocity, position over 1 s, attitude")
    print("\n".join(_groups(scores)))
    print("\n".join(other_values(scores)))


if __name__ == "__main__":
    main()
