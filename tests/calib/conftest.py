"""Recordings of a simulated box on the bench, made once."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from smoother.sim.bench import BenchErrors, BenchPlan, BenchRecording, simulate_bench, write_bench
from smoother.sim.scenario import ImuErrors, MagErrors
from smoother.units import DEG, STANDARD_GRAVITY

FIELD_N = np.array([22.0, -1.2, -42.0])


@dataclass(frozen=True, eq=False)
class Made:
    """A recording on disk, and the truth behind it."""

    directory: Path
    bench: BenchRecording


def make(directory: Path, seed: int, plan: BenchPlan, slope: float = 0.0) -> Made:
    rng = np.random.default_rng(seed)
    distortion = rng.uniform(-0.2, 0.2, (3, 3))
    imu = ImuErrors(
        rate=100.0,
        accel_noise=0.004,
        gyro_noise=0.01 * DEG,
        accel_bias=rng.normal(0.0, 0.3, 3),
        gyro_bias=rng.normal(0.0, 2.0 * DEG, 3),
        accel_matrix=np.eye(3) + rng.normal(0.0, 0.01, (3, 3)),
        gyro_matrix=np.eye(3) + rng.normal(0.0, 0.01, (3, 3)),
        accel_range=8.0 * STANDARD_GRAVITY,
        gyro_range=1000.0 * DEG,
        bits=16,
    )
    mag = MagErrors(
        rate=40.0,
        noise=0.01,
        hard_iron_s=rng.normal(0.0, 30.0, 3),
        soft_iron=np.eye(3) + 0.5 * (distortion + distortion.T),
        resolution=0.15,
    )
    errors = BenchErrors(np.array([1.0, -2.0, 0.5]) * slope, mag_outliers=0.02, mag_delay=0.012)
    bench = simulate_bench(imu, mag, FIELD_N, rng, plan, errors)
    write_bench(bench, directory)
    return Made(directory, bench)


@pytest.fixture(scope="session")
def handled(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A box that warmed up lying still, was laid on faces and edges, and turned by hand."""
    plan = BenchPlan(still=90.0, positions=16, rest=6.0, waving=40.0, warm_up=10.0)
    return make(tmp_path_factory.mktemp("bench"), 3, plan, slope=0.02 * DEG)
