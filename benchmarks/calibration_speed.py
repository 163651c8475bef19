"""CPU seconds of the ellipsoid fit: 100,000 readings with noise and outliers, on one core.

    python benchmarks/calibration_speed.py

The limit is one second.
"""

import argparse
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from smoother.fit.ellipsoid import fit_ellipsoid

LIMIT = 1.0  # s


def readings(count: int, outliers: float, rng: np.random.Generator) -> np.ndarray:
    """Readings (count, 3) of a magnetometer with strong soft iron, noise of 2 % and a share of outliers."""
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distortion = rng.uniform(-0.3, 0.3, (3, 3))
    points = 48.0 * direction @ (np.eye(3) + 0.5 * (distortion + distortion.T)) + rng.normal(0.0, 40.0, 3)
    points += rng.standard_normal((count, 3))
    bad = rng.random(count) < outliers
    points[bad] += 100.0 * rng.standard_normal((int(bad.sum()), 3))
    return np.round(points / 0.15) * 0.15


def main() -> None:
    """Time the fit and print the least and the median of several draws."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--draws", type=int, default=7)
    arguments = parser.parse_args()
    seconds = []
    for seed in range(arguments.draws):
        points = readings(arguments.points, 0.05, np.random.default_rng(seed))
        since = time.process_time()
        fit_ellipsoid(points)
        seconds.append(time.process_time() - since)
    print(
        f"{arguments.points} points: {np.min(seconds):.2f} s at least, {np.median(seconds):.2f} s median of {seconds}"
    )
    sys.exit(0 if np.median(seconds) < LIMIT else 1)


if __name__ == "__main__":
    main()
