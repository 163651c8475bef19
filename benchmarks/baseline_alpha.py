"""Tune alpha (thesis, eq. 2.54) of the baseline on simulated sessions, and record the sweep.

    python benchmarks/baseline_alpha.py

The thesis proposes this for future work: simulate, and choose the filter's one free figure by the error against truth.
A session counts by the logarithm of the baseline's horizontal rms error over that of the fixes alone, so that no preset
outweighs another; the alpha with the least mean over all presets is the default of BaselineOptions. The seeds are not
those of any other evaluation. Draws docs/figures/baseline_alpha.png;
docs/tables/baseline_alpha.csv is made from what it prints (markdown_csv.py).
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from smoother import api
from smoother.arrays import Array
from smoother.trajectory import Trajectory

PRESETS = ("white", "kart", "kart_harsh")
TRACKS = ("larkfield", "tinbarn", "longmeadow")
ALPHAS = 10.0 ** np.arange(-4.0, 4.5, 0.5)
FIRST_SEED = 7000  # evaluations use small seeds
COVARIANCES: tuple[Literal["in motion", "at rest"], ...] = ("in motion", "at rest")
TRUTH_RATE = 20.0  # Hz
DOCS = Path(__file__).resolve().parent.parent / "docs"


@dataclass(frozen=True)
class Case:
    """One session to tune on."""

    preset: str
    seed: int
    track: str
    duration: float


@dataclass(frozen=True, eq=False)
class Sweep:
    """Horizontal position rms (m) and velocity rms (m/s) of the fixes alone (2,), and of the baseline (2, A, 2).

    The baseline's first axis is that of COVARIANCES, the second that of ALPHAS.
    """

    case: Case
    alone: Array
    baseline: Array


def sweep(case: Case) -> Sweep:
    """Simulate one session and run the baseline with every alpha."""
    simulation = api.simulate(case.preset, case.seed, track=case.track, duration=case.duration)
    session = api.prepared(simulation.raw)
    t = np.arange(session.gnss.t[0], session.gnss.t[-1], 1.0 / TRUTH_RATE)
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, session.origin)

    def errors(estimate: Trajectory) -> tuple[float, float]:
        found = api.evaluate(estimate, truth)
        return found.horizontal_rms_m, found.horizontal_velocity_rms_mps

    baseline = [
        [errors(api.baseline(session, alpha=float(a), accel_covariance=covariance)) for a in ALPHAS]
        for covariance in COVARIANCES
    ]
    return Sweep(case, np.array(errors(api.gps_alone(session))), np.array(baseline))


def of_preset(sweeps: list[Sweep], preset: str) -> list[Sweep]:
    """Return the sweeps of one preset."""
    return [one for one in sweeps if one.case.preset == preset]


def score(sweeps: list[Sweep], covariance: int = 0) -> Array:
    """Mean logarithm of the horizontal error over that of the fixes, by alpha (A,)."""
    return np.asarray(np.mean([np.log(one.baseline[covariance, :, 0] / one.alone[0]) for one in sweeps], axis=0))


def table(sweeps: list[Sweep], arguments: argparse.Namespace) -> str:
    """Return the report as Markdown."""
    total = score(sweeps)
    best = int(np.argmin(total))
    rms = {
        preset: np.sqrt(np.mean([one.baseline**2 for one in of_preset(sweeps, preset)], axis=0)) for preset in PRESETS
    }
    alone = {
        preset: np.sqrt(np.mean([one.alone**2 for one in of_preset(sweeps, preset)], axis=0)) for preset in PRESETS
    }
    names = [preset.replace("_", " ") for preset in PRESETS]
    lines = [
        "# The baseline's alpha",
        "",
        f"`python benchmarks/baseline_alpha.py --seeds {arguments.seeds} --duration {arguments.duration:g}`",
        "",
        f"{arguments.seeds} sessions of {arguments.duration:g} s of each preset, three tracks, seeds {FIRST_SEED} on.",
        "Horizontal rms error in m, in brackets velocity in m/s. Outages (5 s in `kart`, three of up to 20 s in",
        "`kart_harsh`) and jumps count, and are most of the error there: the filter runs forwards and has to go on",
        "blindly, while the straight line of the fixes alone knows where it ends. Score: mean over all sessions of the",
        "error of the position over that of the fixes alone (geometric; lower is better).",
        "",
        "The right part has the covariance of the accelerations measured at rest, as the thesis has it: no alpha mends",
        "that. (`kart_harsh` has no rest; a default stands in.)",
        "",
        "| alpha | score | " + " | ".join(names) + " | " + " | ".join(f"{name}, at rest" for name in names) + " |",
        "|" + "---:|" * (2 + 2 * len(names)),
        "| fixes alone | 1.00 | " + " | ".join(_pair(alone[preset]) for preset in PRESETS) + " | | | |",
    ]
    for k, alpha in enumerate(ALPHAS):
        cells = [_pair(rms[preset][c, k]) for c in range(len(COVARIANCES)) for preset in PRESETS]
        mark = "**" if k == best else ""
        lines.append(f"| {mark}{alpha:.3g}{mark} | {mark}{np.exp(total[k]):.2f}{mark} | " + " | ".join(cells) + " |")
    lines += [
        "",
        f"Best: alpha = {ALPHAS[best]:.3g} m^2/s^4 per step of 20 ms.",
        "",
    ]
    return "\n".join(lines)


def _pair(errors: Array) -> str:
    return f"{errors[0]:.3g} ({errors[1]:.3g})"


def draw(sweeps: list[Sweep], path: Path) -> None:
    """Plot the score of each preset over alpha."""
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    for color, preset in enumerate(PRESETS):
        for c, (covariance, style) in enumerate(zip(COVARIANCES, ("-", ":"), strict=True)):
            ratio = np.exp(score(of_preset(sweeps, preset), c))
            axes.loglog(ALPHAS, ratio, style, color=f"C{color}", label=f"{preset}, noise {covariance}")
    axes.loglog(ALPHAS, np.exp(score(sweeps)), "k", linewidth=2.5, label="all, noise in motion")
    axes.axhline(1.0, color="0.6", linewidth=0.8)
    axes.set_xlabel("alpha, m²/s⁴ per step of 20 ms")
    axes.set_ylabel("horizontal error / that of the fixes alone")
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Parse the arguments, sweep, write, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6, help="sessions of each preset")
    parser.add_argument("--duration", type=float, default=200.0, help="s")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=DOCS, help="directory of the report")
    arguments = parser.parse_args()
    cases = [
        Case(preset, FIRST_SEED + i, TRACKS[i % len(TRACKS)], arguments.duration)
        for preset in PRESETS
        for i in range(arguments.seeds)
    ]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        sweeps = list(pool.map(sweep, cases))
    report = table(sweeps, arguments)
    draw(sweeps, arguments.out / "figures" / "baseline_alpha.png")
    print(report)


if __name__ == "__main__":
    main()
