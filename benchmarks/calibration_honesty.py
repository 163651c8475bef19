"""Are the sigmas of a calibration honest? Simulated recordings, errors divided by their sigmas.

    python benchmarks/calibration_honesty.py --recordings 200 --jobs 2

Each recording is a box lying still, laid on faces and edges, and turned by hand, with errors drawn anew: strong soft
iron, outliers and coarse steps of the magnetometer, quantised inertial samples, warming up in every second one. All
procedures run as `smooth calibrate` runs them. For the noise figures a box lies still for hours with white, flicker and
random-walk noise of known strength. Printed: for every parameter the mean of (error / sigma)^2 over the recordings with
its 99.9 % bounds (Bonferroni over the parameters), and the pooled share within one and two sigma.
"""

import argparse
import os
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported

import numpy as np
from scipy.stats import chi2

from calib.outcome import Value
from calib.recording import Recording
from calib.run import run
from smoother import so3
from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.config import MagnetometerUse, SessionConfig
from smoother.fit.allan import fit_noise
from smoother.frames import euler_from_rotation
from smoother.sim.bench import BenchErrors, BenchPlan, BenchRecording, simulate_bench
from smoother.sim.scenario import ImuErrors, MagErrors
from smoother.units import DEG, STANDARD_GRAVITY

FIRST_SEED = 41_000
CONFIDENCE = 0.999
ONE_SIGMA, TWO_SIGMA = (0.65, 0.71), (0.935, 0.965)
NOISE_RATE, NOISE_HOURS = 10.0, 3.0
NOISE_FIGURES = (0.1, 0.06, 0.02)  # density, instability, walk: each rules a decade of the Allan plot
FIELD_N = np.array([22.0, -1.2, -42.0])  # uT, as in northern Italy

ROWS, COLUMNS = np.triu_indices(3)  # of a symmetric matrix

Normalised = dict[str, float]


@dataclass(frozen=True)
class Task:
    """One recording: the kind and its seed."""

    kind: str
    seed: int


def bench_recording(seed: int) -> tuple[BenchRecording, Recording]:
    """Simulate one recording with its own errors."""
    rng = np.random.default_rng(FIRST_SEED + seed)
    soft = rng.uniform(-0.3, 0.3, (3, 3))
    warms_up = seed % 2 == 1
    imu = ImuErrors(
        rate=100.0,
        accel_noise=0.004,
        gyro_noise=0.01 * DEG,
        accel_bias=rng.normal(0.0, 0.3, 3),
        gyro_bias=rng.normal(0.0, 2.0 * DEG, 3),
        accel_matrix=np.eye(3) + rng.normal(0.0, 0.01, (3, 3)),
        gyro_matrix=np.eye(3) + rng.normal(0.0, 0.01, (3, 3)),
        accel_range=16.0 * STANDARD_GRAVITY,
        gyro_range=1000.0 * DEG,
        bits=16,
    )
    mag = MagErrors(
        rate=50.0,
        noise=0.01,
        hard_iron_s=rng.normal(0.0, 40.0, 3),
        soft_iron=np.eye(3) + 0.5 * (soft + soft.T),
        resolution=[0.15, 0.6, 1.5][seed % 3],
    )
    errors = BenchErrors(
        gyro_slope=rng.normal(0.0, 0.02 * DEG, 3) if warms_up else np.zeros(3),
        mag_outliers=[0.0, 0.02, 0.1][(seed // 3) % 3],
        mag_delay=rng.uniform(0.0, 0.03),
    )
    plan = BenchPlan(still=60.0, rest=6.0, waving=60.0, warm_up=12.0 if warms_up else 0.0)
    bench = simulate_bench(imu, mag, FIELD_N, rng, plan, errors)
    raw = bench.imu if warms_up else replace(bench.imu, temperature=None)
    declination = float(np.degrees(np.arctan2(-FIELD_N[1], FIELD_N[0])))
    config = SessionConfig(magnetometer=MagnetometerUse(declination_deg=declination))
    recording = Recording(f"seed {seed}", raw, bench.mag, imu_stamps=raw.t, mag_stamps=bench.mag.t, config=config)
    return bench, recording


def handled(seed: int) -> Normalised:
    """Errors divided by sigmas of everything that a handled box tells."""
    bench, recording = bench_recording(seed)
    results = run([recording])
    found, truth = results.calibration, bench.truth
    outcomes = {outcome.procedure: outcome for outcome in results.outcomes}
    (delay, delay_sigma), (turned, turned_sigma) = map(_figure, outcomes["magnetometer against gyroscope"].values[:2])
    Q = truth.accel_matrix @ bench.imu_errors.accel_matrix  # from the true axes to those of the calibrated sensor
    z: Normalised = {}
    _add(z, "accelerometer offset", found.accel_offset - truth.accel_offset, found.sigmas["accel_offset"])
    accel = (found.accel_matrix - truth.accel_matrix)[ROWS, COLUMNS]
    _add(z, "accelerometer matrix", accel, found.sigmas["accel_matrix"][ROWS, COLUMNS])
    _add(z, "gyroscope matrix", (found.gyro_matrix - truth.gyro_matrix).ravel(), found.sigmas["gyro_matrix"].ravel())
    _add(z, "gyroscope bias", found.gyro_bias - _true_bias(bench, found), found.sigmas["gyro_bias"])
    if "gyro_bias_slope" in found.sigmas:
        _add(z, "bias per kelvin", found.gyro_bias_slope - bench.errors.gyro_slope, found.sigmas["gyro_bias_slope"])
    assert found.hard_iron is not None
    _add(z, "hard iron", found.hard_iron - truth.hard_iron, found.sigmas["hard_iron"])
    magnetometer = outcomes["magnetometer"].calibration
    assert magnetometer.soft_iron is not None
    soft = (magnetometer.soft_iron - truth.soft_iron)[ROWS, COLUMNS]
    _add(z, "soft iron", soft, magnetometer.sigmas["soft_iron"][ROWS, COLUMNS])
    _add(z, "magnetometer axes", turned * DEG - so3.log(Q), turned_sigma * DEG)
    _add(z, "magnetometer delay", delay / 1000.0 - bench.errors.mag_delay, delay_sigma / 1000.0)
    level = {value.name: _figure(value) for value in outcomes["level and heading"].values}
    at_rest = bench.R_ns[len(bench.R_ns) // 100] @ Q.T
    for name, true in zip(("roll", "pitch", "yaw"), euler_from_rotation(at_rest), strict=True):
        value, sigma = level[name]
        _add(z, name, (value * DEG - float(true) + np.pi) % (2.0 * np.pi) - np.pi, sigma * DEG)
    dip = np.arctan2(-FIELD_N[2], np.hypot(*FIELD_N[:2]))
    value, sigma = level["inclination measured"]
    _add(z, "inclination", value * DEG - dip, sigma * DEG)
    return z


def _figure(value: Value) -> tuple[Array, Array]:
    """A measured figure and its sigma."""
    return np.atleast_1d(np.asarray(value.value, dtype=np.float64)), np.atleast_1d(np.asarray(value.sigma, np.float64))


def _true_bias(bench: BenchRecording, found: Calibration) -> Array:
    """The bias where the fit states it: at its temperature, or wherever the box lay (the bias is constant then)."""
    at_first = np.asarray(bench.gyro_bias[0])
    if bench.imu.temperature is None or not np.any(found.gyro_bias_slope):
        return at_first
    return at_first + (found.gyro_temperature - float(bench.imu.temperature[0])) * bench.errors.gyro_slope


def still(seed: int) -> Normalised:
    """Errors divided by sigmas of the noise figures of a box that lies still."""
    rng = np.random.default_rng(FIRST_SEED + 10_000 + seed)
    count = int(NOISE_HOURS * 3600.0 * NOISE_RATE)
    values = np.stack([noise(count, NOISE_RATE, *NOISE_FIGURES, rng) for _ in range(6)], axis=1)
    figures = fit_noise(values, NOISE_RATE)
    z: Normalised = {}
    for k, name in enumerate(("noise density", "bias instability", "random walk")):
        _add(z, name, figures.value[:, k] - NOISE_FIGURES[k], figures.sigma[:, k])
    return z


def noise(count: int, rate: float, density: float, instability: float, walk: float, rng: np.random.Generator) -> Array:
    """White, flicker and random-walk noise (count,) of known figures; flicker by its spectrum over a longer time."""
    white = density * np.sqrt(rate) * rng.standard_normal(count)
    walking = np.cumsum(walk / np.sqrt(rate) * rng.standard_normal(count))
    longer = 4 * count
    frequency = np.fft.rfftfreq(longer, 1.0 / rate)
    power = np.zeros_like(frequency)
    power[1:] = instability**2 / (2.0 * np.pi * frequency[1:])
    phase = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    flicker = np.fft.irfft(phase * np.sqrt(0.5 * power * rate * longer), longer)[:count]
    return np.asarray(white + walking + flicker)


def _add(z: Normalised, name: str, error: Iterable[float], sigma: Iterable[float]) -> None:
    for i, (e, s) in enumerate(zip(error, sigma, strict=True)):
        z[f"{name} {i + 1}"] = float(e) / float(s)


def scores(tasks: list[Task], jobs: int) -> dict[str, Array]:
    """Normalised errors by parameter."""
    pooled: dict[str, list[float]] = {}
    with ProcessPoolExecutor(jobs) as pool:
        for one in pool.map(_score, tasks, chunksize=4):
            for name, value in one.items():
                pooled.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in pooled.items()}


def _score(task: Task) -> Normalised:
    return handled(task.seed) if task.kind == "handled" else still(task.seed)


def report(found: dict[str, Array]) -> tuple[str, bool]:
    """Return a table in Markdown, and whether all figures lie inside their bounds."""
    tail = (1.0 - CONFIDENCE) / len(found) / 2.0
    lines = ["| parameter | recordings | mean (error / sigma)² | bounds | within 1 sigma, % | within 2 sigma, % |"]
    lines.append("|---|---:|---:|---:|---:|---:|")
    good = True
    for name, z in found.items():
        low, high = chi2.ppf([tail, 1.0 - tail], len(z)) / len(z)
        nees = float(np.mean(z**2))
        inside = low < nees < high
        good &= inside
        one, two = (100.0 * float(np.mean(np.abs(z) < k)) for k in (1, 2))
        mark = "" if inside else " **outside**"
        lines.append(f"| {name} | {len(z)} | {nees:.2f}{mark} | {low:.2f} to {high:.2f} | {one:.0f} | {two:.0f} |")
    everything = np.concatenate(list(found.values()))
    one, two = (float(np.mean(np.abs(everything) < k)) for k in (1, 2))
    good &= ONE_SIGMA[0] < one < ONE_SIGMA[1] and TWO_SIGMA[0] < two < TWO_SIGMA[1]
    lines.append(
        f"| **all** | {len(everything)} | {np.mean(everything**2):.2f} | | **{100 * one:.1f}** | **{100 * two:.1f}** |"
    )
    return "\n".join(lines), good


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kind", choices=["handled", "still", "both"], default="both")
    arguments = parser.parse_args()
    kinds = ["handled", "still"] if arguments.kind == "both" else [arguments.kind]
    tasks = [Task(kind, seed) for kind in kinds for seed in range(arguments.recordings)]
    text, good = report(scores(tasks, arguments.jobs))
    print(text)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
