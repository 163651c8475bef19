"""Recordings of a car against a reference: two modules of one make against each other, and one against RTK.

    SMOOTH_DATA=../shared/data python benchmarks/twins.py

Nobody knows the delay of a reference receiver, so every comparison takes out one constant lag of its own, the one that
suits it best; and it is over the same times for the fixes as they came and for the smoothed path. Between two modules
the difference also holds the distance of their antennas, alike for both.
"""

import argparse
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import polars as pl
from scipy.optimize import minimize_scalar

from smoother.arrays import Array, BoolArray
from smoother.estimate.gps_alone import fixes_as_trajectory
from smoother.estimate.graph.smoother import GraphSmoother
from smoother.estimate.resample import position_at
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.session.load import load_raw
from smoother.session.truth import load_truth
from smoother.trajectory import Trajectory
from thinning import DATA

TWINS = ("car_hi600_twin_a", "car_hi600_twin_b")
BESIDE_RTK = "car_hi600_rtk"
LONGEST_LAG = 1.0  # s
LONGEST_GAP = 1.5  # s between fixes of either, beyond which nothing is compared
SPACING = 0.1  # s
SECOND = 1.0  # s
RTK_FIXED = 4  # of GGA; the float solutions of the same receiver are no reference
MOVING = 2.0  # m/s; slower there is no direction to be across of


@dataclass(frozen=True)
class Difference:
    """Horizontal rms of one path against another at the lag (s) that suits them best, m.

    along and across are its parts where the car moves; relative is of the change of the difference over a second.
    """

    name: str
    lag: float
    horizontal: float
    along: float
    across: float
    relative: float
    count: int


def differ(name: str, one: Trajectory, other: Trajectory, t: Array) -> Difference:
    """Compare `one` at t + lag with `other` at t (N,); parts are by the direction of travel of `other`."""
    reference = position_at(other, t)[:, :2]
    step = 0.5
    direction = position_at(other, t + step)[:, :2] - position_at(other, t - step)[:, :2]
    length = np.linalg.norm(direction, axis=1)
    moving = length > 2.0 * step * MOVING

    def error(lag: float) -> Array:
        return np.asarray(position_at(one, t + lag)[:, :2] - reference)

    def rms_at(lag: float) -> float:
        return _rms(np.linalg.norm(error(lag), axis=1))

    lag = float(minimize_scalar(rms_at, bounds=(-LONGEST_LAG, LONGEST_LAG), method="bounded").x)
    later = np.searchsorted(t, t + SECOND - 1e-3)
    pairs = np.flatnonzero((later < len(t)) & (np.abs(t[np.minimum(later, len(t) - 1)] - t - SECOND) < 0.1))
    change = error(lag)[later[pairs]] - error(lag)[pairs]
    left, ahead = error(lag)[moving], direction[moving] / length[moving, None]
    across = left[:, 1] * ahead[:, 0] - left[:, 0] * ahead[:, 1]
    parts = _rms(np.sum(left * ahead, axis=1)), _rms(across), _rms(np.linalg.norm(change, axis=1))
    return Difference(name, lag, rms_at(lag), *parts, len(t))


def common_times(sources: list[Array], every: Array) -> Array:
    """Return those of the times `every` (N,) that have a row of each of the `sources` (M,) close by on either side."""
    keep = np.full(len(every), True)
    for rows in sources:
        keep &= _is_covered(rows, every)
    return np.asarray(every[keep])


def _is_covered(rows: Array, t: Array) -> BoolArray:
    margin = LONGEST_LAG + 1.0
    inside = (t > rows[0] + margin) & (t < rows[-1] - margin)
    after = np.clip(np.searchsorted(rows, t), 1, len(rows) - 1)
    return np.asarray(inside & (rows[after] - rows[after - 1] < LONGEST_GAP))


def beside_rtk(data: Path) -> tuple[Difference, Difference]:
    """Fixes and smoothed path of the car against RTK, at the epochs of RTK."""
    session = prepare(load_raw(data / BESIDE_RTK))
    truth = load_truth(data / BESIDE_RTK, session.origin)
    rows = pl.read_csv(data / BESIDE_RTK / "truth.csv", columns=["t_s", "fix"])
    fixed = rows.filter(pl.col("fix") == RTK_FIXED)["t_s"].to_numpy()
    t = common_times([session.gnss.t, truth.t], fixed)
    smoothed = GraphSmoother().estimate(session)
    return differ("fixes", fixes_as_trajectory(session), truth, t), differ("smoothed", smoothed, truth, t)


def twin_sessions(data: Path) -> tuple[tuple[Session, Session], Array]:
    """Modules a and b in one n, and the times (N,) s at which both have fixes."""
    first, second = (prepare(load_raw(data / name)) for name in TWINS)
    stamps = [first.gnss.t, second.gnss.t]
    t = common_times(stamps, np.arange(max(s[0] for s in stamps), min(s[-1] for s in stamps), SPACING))
    return (first, _with_origin_of(second, first)), t


def between_twins(data: Path) -> tuple[Difference, Difference]:
    """Difference of module b from module a: of their fixes, and of their smoothed paths."""
    (first, second), t = twin_sessions(data)
    raw = differ("fixes", fixes_as_trajectory(second), fixes_as_trajectory(first), t)
    path, other = (GraphSmoother().estimate(session) for session in (second, first))
    return raw, differ("smoothed", path, other, t)


def _with_origin_of(session: Session, other: Session) -> Session:
    """The session in the axes of the other: both in one n."""
    return replace(session, origin=other.origin)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def table(pair: tuple[Difference, Difference]) -> str:
    """Return both differences as a Markdown table."""
    lines = [
        "| | lag taken out, s | horizontal, m | moving: along, m | across, m | over 1 s, m |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {d.name} | {d.lag:+.3f} | {d.horizontal:.3f} | {d.along:.3f} | {d.across:.3f} | {d.relative:.3f} |"
        for d in pair
    ]
    return "\n".join(lines)


def main() -> None:
    """Compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    if not DATA.is_dir():
        parser.exit(0, f"no real recordings at {DATA}; set SMOOTH_DATA\n")
    for heading, comparison in (("against RTK", beside_rtk), ("two modules in one car", between_twins)):
        since = time.process_time()
        pair = comparison(DATA)
        print(
            f"\n{heading}: {pair[0].count} times ({time.process_time() - since:.0f} s of one core)\n\n{table(pair)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
