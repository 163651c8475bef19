"""Accuracy of the smoother on simulated sessions, beside the information bound; honesty of its sigmas.

    python benchmarks/accuracy.py --preset kart --seeds 3 --duration 200

Each figure stands as `error (times the bound)`; the lines `all` pool the sessions (rms of errors over rms of bounds).
Errors count from 10 s after the kart drives off to the last fix, outages and all.
"""

import argparse
import ast
import dataclasses
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.stats import chi2

from scoring import ANGLES, QUANTITIES, Case, Score, ScoreOptions, cases, other_values, recorded, rms, score
from smoother import api

HEADINGS = ("vel m/s", "1 s m", "roll deg", "pitch deg", "yaw deg")
VALUES = (("gps_position_latency", 1e3), ("gps_velocity_latency", 1e3), ("arm_x", 1.0), ("arm_y", 1.0), ("arm_z", 1.0))
VALUE_HEADINGS = ("lat_p ms", "lat_v ms", "arm x m", "arm y m", "arm z m")
MOUNTING = (("mount_x", 1.0), ("mount_y", 1.0), ("mount_z", 1.0))
NOISE = ("accel_noise", "gyro_noise", "gps_position_noise", "gps_velocity_noise")


def run(case: Case, options: ScoreOptions) -> Score:
    """Simulate, smooth and score one session."""
    simulation = case.simulate()
    session = recorded(simulation)
    since = time.perf_counter()
    estimate = api.smooth(session)
    return score(case, simulation, session, estimate, time.perf_counter() - since, options)


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", action="append", choices=("white", "kart", "kart_harsh"), help="default: kart")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds, each on the next track")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--grid", action="store_true", help="every seed on every track, standing and rolling")
    parser.add_argument("--duration", type=float, default=600.0, help="s")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--full-bound", action="store_true", help="bound with engine tone and unknown scale factors")
    parser.add_argument("--without-outages", action="store_true", help="errors and bound only where there are fixes")
    parser.add_argument("--set", action="append", default=[], metavar="FIGURE=VALUE", help="e.g. gnss_jumps=()")
    parser.add_argument("--json", metavar="FILE", help="write everything measured, for further evaluation")
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    changes = {key: ast.literal_eval(value) for key, _, value in (text.partition("=") for text in arguments.set)}
    scores: list[Score] = []
    for preset in arguments.preset or ["kart"]:
        print(f"\n{preset}: {arguments.duration:.0f} s each; error (times the bound), then values (z: error / sigma)")
        print(_heading())
        wanted = cases(preset, seeds, arguments.duration, grid=arguments.grid)
        batch = _run_all([dataclasses.replace(case, changes=changes) for case in wanted], arguments)
        print(_pooled(batch))
        print(_mountings(batch))
        print(_coverage(batch))
        print(_nees(batch))
        scores += batch
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump([dataclasses.asdict(s) for s in scores], file, indent=1)


def _run_all(wanted: list[Case], arguments: argparse.Namespace) -> list[Score]:
    work = partial(run, options=ScoreOptions(arguments.full_bound, not arguments.without_outages))
    batch = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for result in pool.map(work, wanted) if arguments.jobs > 1 else map(work, wanted):
            print(_row(result))
            sys.stdout.flush()
            batch.append(result)
    return batch


def _heading() -> str:
    cells = "".join(f"{h:>14}" for h in (*HEADINGS, *VALUE_HEADINGS))
    return f"{'session':<33}{cells}  noise found/true a g p v  track m      s"


def _row(s: Score) -> str:
    cells = "".join(_times(s.rms[q], s.bound[q]) for q in QUANTITIES)
    for key, scale in VALUES:
        value = s.values.get(key)
        text = "-" if value is None else f"{value.error * scale:+.{_digits(scale)}f} ({value.z:+.1f})"
        cells += f"{text + ('' if value is None or value.observable else '?'):>14}"
    noise = " ".join(f"{s.noise.get(key, np.nan):4.2f}" for key in NOISE)
    flag = "" if s.mode == "full" else f" {s.mode}"
    return f"{s.case.name:<33}{cells}   {noise:>22}  {s.rms['track']:8.3f} {s.seconds:6.1f}{flag}"


def _times(error: float, bound: float) -> str:
    return f"{f'{error:.3f} ({error / bound:.2f})':>14}"


def _digits(scale: float) -> int:
    return 1 if scale > 1.0 else 3


def _pooled(batch: list[Score]) -> str:
    """Pooled errors over pooled bounds, and the largest ratio of a session."""
    pooled = "".join(_times(rms(s.rms[q] for s in batch), rms(s.bound[q] for s in batch)) for q in QUANTITIES)
    for key, scale in VALUES:
        values = [s.values[key] for s in batch if key in s.values]
        error, bound = rms(v.error for v in values), rms(v.bound for v in values if v.bound is not None)
        pooled += f"{f'{error * scale:.{_digits(scale)}f} ({error / bound:.2f})':>14}"
    bounds = "".join(f"{rms(s.bound[q] for s in batch):>14.3f}" for q in QUANTITIES)
    bounds += "".join(f"{rms(s.values[k].bound for s in batch if k in s.values) * c:>14.4f}" for k, c in VALUES)
    worst = "".join(f"{f'({max(s.rms[q] / s.bound[q] for s in batch):.2f})':>14}" for q in QUANTITIES)
    worst += "".join(f"{_largest_z(batch, key):>14}" for key, _ in VALUES)
    lines = [f"{name:<33}{cells}" for name, cells in (("all", pooled), ("bound", bounds), ("worst", worst))]
    counts = ", ".join(
        f"{key} {sum(s.values[key].observable for s in batch if key in s.values)}/{len(batch)}" for key, _ in VALUES
    )
    lines.append(f"observable: {counts}")
    lines += other_values(batch)
    lines += _beyond(batch)
    lines.append(f"lever arm, error in parts of the true value: {', '.join(_attenuation(batch))}")
    return "\n".join(lines)


def _beyond(batch: list[Score]) -> list[str]:
    """One line for each session with values more than 2.6 of their own sigmas off."""
    lines = []
    for s in batch:
        names = [f"{key} {value.z:+.1f}" for key, value in s.values.items() if abs(value.z) > 2.6]
        if names:
            lines.append(f"beyond 2.6 sigma: {s.case.name:<33} {', '.join(names)}")
    return lines


def _attenuation(batch: list[Score]) -> list[str]:
    """Slope of error over truth: noise in what multiplies an unknown pulls it to zero in every session alike."""
    out = []
    for axis in "xyz":
        values = [s.values[f"arm_{axis}"] for s in batch if f"arm_{axis}" in s.values]
        size = sum(v.true**2 for v in values)
        if size > 0.0:
            out.append(f"{axis} {sum(v.true * v.error for v in values) / size:+.2f}")
    return out


def _largest_z(batch: list[Score], key: str) -> str:
    z = [abs(s.values[key].z) for s in batch if key in s.values]
    return f"(z {np.nanmax(z):.1f})" if z and np.any(np.isfinite(z)) else "-"


def _mountings(batch: list[Score]) -> str:
    parts = []
    for key, _ in MOUNTING:
        values = [s.values[key] for s in batch if key in s.values]
        if values:
            z = rms(v.z for v in values)
            parts.append(f"{key[-1]} {rms(v.error for v in values):.2f} deg (rms z {z:.2f})")
    error, bound = (
        {key: rms(getattr(s, kind)[key] for s in batch) for key in ("position", "track")} for kind in ("rms", "bound")
    )
    position = f"position {error['position']:.2f} m (bound {bound['position']:.2f})"
    track = f"track {error['track']:.3f} m per axis where there are fixes (bound {bound['track']:.3f})"
    sensor = ", ".join(f"{a} {rms(s.rms['sensor_' + a] for s in batch):.3f}" for a in ANGLES)
    return f"mounting error about {', '.join(parts)}; attitude but for it (deg): {sensor}\n{position}; {track}"


def _coverage(batch: list[Score]) -> str:
    """Shares within one and two sigma; +- is the spread over sessions, which are independent, over their number."""
    lines = ["within 1 sigma (63-73 % is honest), 2 sigma (93-97 %):"]
    cells = []
    for name in batch[0].coverage:
        shares = 100.0 * np.array([s.coverage[name] for s in batch if name in s.coverage])
        spread = shares.std(axis=0, ddof=1) / np.sqrt(len(shares)) if len(shares) > 1 else np.full(2, np.nan)
        mean = shares.mean(axis=0)
        cells.append(f"{name:>9} {mean[0]:5.1f} +-{spread[0]:4.1f}, {mean[1]:5.1f} +-{spread[1]:4.1f}")
    lines += ["   ".join(cells[i : i + 3]) for i in range(0, len(cells), 3)]
    return "\n".join(lines)


def _nees(batch: list[Score]) -> str:
    """Mean NEES per degree of freedom over the sessions at fixed times, with Bonferroni bounds."""
    count = min(len(s.nees) for s in batch)
    if count == 0:
        return "no NEES"
    n, lines = len(batch), []
    for name, dimension in (("full", 9), ("attitude", 3), ("velocity", 3), ("position", 3)):
        level = 0.05 / count
        low, high = chi2.ppf([level / 2.0, 1.0 - level / 2.0], n * dimension) / (n * dimension)
        means = [float(np.mean([getattr(s.nees[i], name) for s in batch])) / dimension for i in range(count)]
        outside = sum(not low <= m <= high for m in means)
        values = " ".join(f"{m:.2f}" for m in means)
        lines.append(f"NEES/{dimension} {name:<9} {low:.2f} to {high:.2f}: {values}  ({outside} outside)")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
