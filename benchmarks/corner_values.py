"""What laps did in corners, against the truth: how honest the sigmas are, and whether "what was different" was so.

    python benchmarks/corner_values.py                # six kart and six kart_harsh sessions; a minute on two cores
    python benchmarks/corner_values.py --lapses 4     # drivers who brake too early now and then

The true drive, moved by what the session lies beside it in the mean, is analysed on the same line and its laps are
compared with those of the session, corner by corner. A difference that is named beside a loss is luck where the true
one is less than a quarter of it or of other sign.
"""

import argparse
import dataclasses
import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from lap_times import estimated
from scoring import Case, cases, recorded
from smoother import api
from smoother.arrays import Array
from smoother.laps.lost import largest_losses
from smoother.laps.results import LapAnalysis
from theoretical_best import true_analysis

VALUES = {  # name: value and sigma among the fields of a corner, unit
    "entry speed": ("entry_speed", "entry_speed_sigma", "m/s"),
    "least speed": ("min_speed", "min_speed_sigma", "m/s"),
    "exit speed": ("exit_speed", "exit_speed_sigma", "m/s"),
    "braking point": ("braking_point", "braking_sigma", "m"),
    "slide": ("slide", "slide_sigma", "rad"),
    "line": ("lateral", "lateral_sigma", "m"),  # of the traces
}
FIELDS = {"braking": "braking_point", "entry": "entry_speed", "minimum": "min_speed", "exit": "exit_speed"}
LUCK = 0.25  # of a difference that is named: where the true one is less, it is luck


@dataclasses.dataclass(frozen=True, eq=False)
class ValueScores:
    """One session: errors and sigmas (2, K) of each kind of value; differences (2, D) named beside losses, and true."""

    case: Case
    values: dict[str, Array]
    named: Array


def run(case: Case, gps_only: bool = False) -> ValueScores | None:
    """Simulate, smooth and score one session; None where the true drive does not have the same laps."""
    simulation = case.simulate()
    session = recorded(simulation)
    estimate = estimated(session, gps_only)
    found = api.laps(session, estimate)
    if found.traces is None or found.start_line is None:
        return None
    true = true_analysis(found, simulation, session, estimate)
    if len(found.laps) != len(true.laps) or len(found.corners) != len(true.corners):
        return None
    return ValueScores(case, {name: _errors(found, true, name) for name in VALUES}, _named(found, true))


def _errors(found: LapAnalysis, true: LapAnalysis, name: str) -> Array:
    value, sigma, _ = VALUES[name]
    valid = np.array([lap.is_valid for lap in found.laps])
    places = (found.traces,) if name == "line" else found.corners
    theirs = (true.traces,) if name == "line" else true.corners
    pairs = [
        np.stack([(getattr(one, value) - getattr(other, value))[valid].ravel(), getattr(one, sigma)[valid].ravel()])
        for one, other in zip(places, theirs, strict=True)
    ]
    both = np.concatenate([np.empty((2, 0)), *pairs], axis=1)
    return np.asarray(both[:, np.isfinite(both).all(axis=0) & (both[1] > 0.0)])


def _named(found: LapAnalysis, true: LapAnalysis) -> Array:
    """Differences (2, D) that are named beside real losses, as shown and as they were."""
    out = []
    for loss in largest_losses(found, most=10**6):
        corner = next(one for one in true.corners if one.number == loss.corner.number)
        for each in loss.differences:
            values = getattr(corner, FIELDS[each.kind])
            out.append((each.by, float(values[found.reference_lap] - values[loss.lap])))
    return np.array(out).reshape(-1, 2).T


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6, help="number of seeds, each on the next track")
    parser.add_argument("--first-seed", type=int, default=3)
    parser.add_argument("--duration", type=float, default=600.0, help="s")
    parser.add_argument("--lapses", type=float, default=0.0, help="of the driver, a km")
    parser.add_argument("--gps-only", action="store_true", help="as without a motion sensor")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for preset in ("kart", "kart_harsh"):
        wanted = [
            dataclasses.replace(case, changes={"motion_lapse_rate": arguments.lapses})
            for case in cases(preset, seeds, arguments.duration)
        ]
        with ProcessPoolExecutor(arguments.jobs) as pool:
            scores = list(pool.map(partial(run, gps_only=arguments.gps_only), wanted))
        known = [score for score in scores if score is not None]
        print(
            f"{preset}, {len(known)} sessions of {arguments.duration:.0f} s ({len(scores) - len(known)} had other laps)"
        )
        print(summary(known), flush=True)


def summary(scores: list[ValueScores]) -> str:
    """Return errors and honesty of each kind of value, and how many of the differences named are luck."""
    lines = []
    for name, (_, _, unit) in VALUES.items():
        error, sigma = np.concatenate([score.values[name] for score in scores], axis=1)
        if not error.size:
            continue
        z = error / sigma
        within = " and ".join(f"{100.0 * np.mean(np.abs(z) < k):.0f}" for k in (1.0, 2.0))
        lines.append(
            f"  {name:<14} {error.mean():+.3f}, rms {np.sqrt(np.mean(error**2)):.3f} {unit:<4} error over sigma "
            f"{np.sqrt(np.mean(z**2)):.2f} rms, {within} % within one and two"
        )
    named = np.concatenate([score.named for score in scores], axis=1)
    luck = int(np.count_nonzero(named[1] < LUCK * named[0]))
    lines.append(f"  {named.shape[1]} differences named beside losses, {luck} of them luck")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
