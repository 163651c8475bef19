"""What a calibration is worth: `smooth evaluate` on simulated sessions of uncalibrated sensors, without and with one.

    python benchmarks/calibration_improvement.py --seeds 3 --jobs 2

Sensor errors are drawn within the limits of the MPU-9250's data sheet (gyroscope: 5 deg/s, 3 % scale, 2 % cross-axis;
accelerometer: 0.6 m/s^2, 3 %, 2 %; hard iron of half the Earth's field, soft iron of 10 %). The same box is then
calibrated on a simulated bench by the README's guide, and the session evaluated again with the calibration.toml that
came of it. Everything else of a session (noise, delays, mounting, driving) is that of its preset.
docs/tables/calibration_improvement.csv is made from what it prints (markdown_csv.py).
"""

import argparse
import os
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported

import numpy as np

from calib.recording import load_recording
from calib.run import run
from smoother import api
from smoother.arrays import Array
from smoother.calibration import FILE_NAME, save_calibration
from smoother.samples import Session
from smoother.sim.bench import BenchErrors, simulate_bench, write_bench
from smoother.sim.scenario import ImuErrors, Interval, MagErrors
from smoother.trajectory import Trajectory
from smoother.units import DEG, STANDARD_GRAVITY

FIRST_SEED = 52_000
ROWS = (
    ("velocity, horizontal (m/s)", "horizontal_velocity_rms_mps"),
    ("horizontal, over 1 s (m)", "relative_1s_rms_m"),
    ("horizontal (m)", "horizontal_rms_m"),
    ("up (m)", "up_rms_m"),
    ("roll (deg)", "roll_rms_deg"),
    ("pitch (deg)", "pitch_rms_deg"),
    ("yaw (deg)", "yaw_rms_deg"),
)
ESTIMATORS: dict[str, Callable[[Session], Trajectory]] = {"smoother": api.smooth, "baseline": api.baseline}
OUTAGES = (0.25, 0.5, 0.75)  # of the session, where the fixes of `outages` stay away
OUTAGE = 12.0  # s
VARIANTS = {"white": "white", "outages": "white", "kart": "kart"}  # what to run, and its preset


@dataclass(frozen=True)
class Case:
    """One session."""

    variant: str
    seed: int
    duration: float


def _matrix(scale: float, cross: float, rng: np.random.Generator) -> Array:
    matrix = rng.uniform(-cross, cross, (3, 3))
    np.fill_diagonal(matrix, 1.0 + rng.uniform(-scale, scale, 3))
    return matrix


def sensor_errors(rng: np.random.Generator) -> dict[str, Array]:
    """Draw what a data sheet allows, by the names of `simulate_preset`'s changes."""
    distortion = rng.uniform(-0.1, 0.1, (3, 3))
    return {
        "imu_accel_bias": rng.uniform(-0.6, 0.6, 3),
        "imu_gyro_bias": rng.uniform(-5.0, 5.0, 3) * DEG,
        "imu_accel_matrix": _matrix(0.03, 0.02, rng),
        "imu_gyro_matrix": _matrix(0.03, 0.02, rng),
        "mag_hard_iron_s": rng.uniform(-25.0, 25.0, 3),
        "mag_soft_iron": np.eye(3) + 0.5 * (distortion + distortion.T),
    }


def evaluated(case: Case) -> Array:
    """Figures (2, estimators, rows): without and with the calibration."""
    rng = np.random.default_rng(FIRST_SEED + case.seed)
    errors = sensor_errors(rng)
    changes: dict[str, Any] = {**errors, "mag_calibration_points": 0}
    if case.variant == "outages":
        changes["gnss_outages"] = tuple(Interval(share * case.duration, OUTAGE) for share in OUTAGES)
    simulation = api.simulate(VARIANTS[case.variant], case.seed, duration=case.duration, **changes)
    own = {name.split("_", 1)[1]: value for name, value in errors.items()}
    imu = ImuErrors(
        rate=200.0,
        accel_noise=0.003,
        gyro_noise=0.01 * DEG,
        accel_range=4.0 * STANDARD_GRAVITY,
        gyro_range=500.0 * DEG,
        bits=16,
        accel_bias=own["accel_bias"],
        gyro_bias=own["gyro_bias"],
        accel_matrix=own["accel_matrix"],
        gyro_matrix=own["gyro_matrix"],
    )
    mag = MagErrors(rate=50.0, noise=0.01, resolution=0.15, hard_iron_s=own["hard_iron_s"], soft_iron=own["soft_iron"])
    bench = simulate_bench(imu, mag, simulation.field_n, rng, errors=BenchErrors(np.zeros(3), mag_outliers=0.01))
    with tempfile.TemporaryDirectory() as name:
        session, on_bench = Path(name) / "session", Path(name) / "bench"
        api.write_session(simulation, session)
        write_bench(bench, on_bench)
        without = figures(session)
        results = run([load_recording(on_bench)])
        save_calibration(session / FILE_NAME, results.calibration, results.notes)
        return np.array([without, figures(session)])


def figures(folder: Path) -> Array:
    """Figures (estimators, rows) that `smooth evaluate` gives."""
    session = api.read(folder)
    truth = api.read_truth(folder, session.origin)
    scores = [api.evaluate(estimate(session), truth) for estimate in ESTIMATORS.values()]
    return np.array([[getattr(score, key) for _, key in ROWS] for score in scores])


def table(cases: list[Case], found: Array) -> str:
    """Return the table in Markdown; found (cases, 2, estimators, rows)."""
    variants = list(dict.fromkeys(case.variant for case in cases))
    head = [f"{variant}, {name}: before → after" for variant in variants for name in ESTIMATORS]
    lines = ["| rms error | " + " | ".join(head) + " |", "|---|" + "---:|" * len(head)]
    for row, (text, _) in enumerate(ROWS):
        cells = []
        for variant in variants:
            chosen = found[[i for i, case in enumerate(cases) if case.variant == variant]]
            for k in range(len(ESTIMATORS)):
                before, after = np.sqrt(np.mean(chosen[:, :, k, row] ** 2, axis=0))
                cells.append(f"{before:.3g} → {after:.3g}" if np.isfinite(before) else "-")
        lines.append(f"| {text} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run the comparison and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=120.0)
    parser.add_argument("--variant", action="append", choices=list(VARIANTS))
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    variants = arguments.variant or list(VARIANTS)
    cases = [Case(variant, seed + 1, arguments.duration) for variant in variants for seed in range(arguments.seeds)]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        found = np.array(list(pool.map(evaluated, cases)))
    text = table(cases, found)
    print(text)


if __name__ == "__main__":
    main()
