"""Recordings of a car against a reference: two modules of one make against each other, and one against RTK.

    SMOOTH_DATA=folder python benchmarks/twins.py

Nobody knows the delay of a reference receiver, so every comparison takes out one constant lag of its own, the one that
suits it best; and it is over the same times for the fixes as they came and for the smoothed path. Between two modules
the difference also holds the distance of their antennas, alike for both.

Then comes how far the smoothed path wanders from the reference over some time, beside what its joint covariance says:
on that the sigmas of lap times count. There the distance of two antennas, which turns with the car, is taken out. Then,
of the two modules, how far their velocities and attitudes are apart, beside the sigmas of both: no reference has these.
Last, what the Doppler velocities of the two err by from one to the next, at rest and on the drive, before smoothing.
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

from smoother import api
from smoother.arrays import Array, BoolArray
from smoother.frames import wrap_angle
from smoother.samples import Session
from smoother.trajectory import Trajectory
from smoother.units import DEG
from thinning import DATA

TWINS = ("car_hi600_twin_a", "car_hi600_twin_b")
BESIDE_RTK = "car_hi600_rtk"
LONGEST_LAG = 1.0  # s
LONGEST_GAP = 1.5  # s between fixes of either, beyond which nothing is compared
SPACING = 0.1  # s
SECOND = 1.0  # s
WANDERED = (10.0, 30.0, 60.0)  # s
PAIRS = 400  # of times, at most, whose covariance is asked for
RTK_FIXED = 4  # of GGA; the float solutions of the same receiver are no reference
MOVING = 2.0  # m/s; slower there is no direction to be across of
AT_REST = 0.3  # m/s
LATER = (0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)  # s from one velocity to another
WILD = 0.5  # m/s apart, beyond which one of the velocities is no velocity


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


def position_at(path: Trajectory, t: Array) -> Array:
    """Positions (N, 3) m of `path` at t (N,) s."""
    return api.resample(path, t).position_n


def fixes_of(session: Session) -> Trajectory:
    """The fixes as a trajectory, one row each."""
    return api.resample(api.gps_alone(session), session.gnss.t)


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


@dataclass(frozen=True)
class Wander:
    """How the difference of two paths changes over some time, s, per axis of n: rms, and what is expected, m.

    ratio: rms over pairs of times of one over the other; usual: 1.48 times the median, which a reference that jumps at
    times does not move.
    """

    over: float
    rms: float
    sigma: float
    ratio: float
    usual: float


def wander(one: Trajectory, other: Trajectory, t: Array) -> list[Wander]:
    """Return how the difference of `one` from `other` at t (N,) changes, where the car moves.

    At the lag that suits the changes best: it is metres of slow offset that the other lag is judged by, too. What
    `other` has no joint covariance of is taken to be exact.
    """

    def apart(lag: float) -> Array:
        return _without_antennas(one, position_at(one, t + lag)[:, :2] - position_at(other, t)[:, :2], t + lag)

    def changes(lag: float) -> float:
        later = np.minimum(np.searchsorted(t, t + WANDERED[0] - 1e-3), len(t) - 1)
        return float(np.median(np.abs(apart(lag)[later] - apart(lag))))

    lag = float(minimize_scalar(changes, bounds=(-LONGEST_LAG, LONGEST_LAG), method="bounded").x)
    return [_wander(one, other, lag, t, apart(lag), over) for over in WANDERED]


def _without_antennas(one: Trajectory, apart: Array, t: Array) -> Array:
    """Return apart (N, 2) m without what is constant in the car, by its changes over a second."""
    yaw = np.unwrap(np.arctan2(one.R_nb[:, 1, 0], one.R_nb[:, 0, 0]))
    cos, sin = np.cos(at := np.interp(t, one.t, yaw)), np.sin(at)
    turned = np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)
    step = np.flatnonzero(np.diff(t) < 1.5 * SECOND)
    change, by = np.diff(apart, axis=0)[step].ravel(), np.diff(turned, axis=0)[step].reshape(-1, 2)
    few = np.abs(change) < 4.0 * np.median(np.abs(change))
    return np.asarray(apart - turned @ np.linalg.lstsq(by[few], change[few], rcond=None)[0])


def _wander(one: Trajectory, other: Trajectory, lag: float, t: Array, apart: Array, over: float) -> Wander:
    later = np.minimum(np.searchsorted(t, t + over - 1e-3), len(t) - 1)
    speed = np.linalg.norm(position_at(one, t + lag + 0.5) - position_at(one, t + lag - 0.5), axis=1)
    pairs = np.flatnonzero((np.abs(t[later] - t - over) < 0.1) & (speed > MOVING) & (speed[later] > MOVING))
    pairs = pairs[:: max(1, len(pairs) // PAIRS)]
    change = apart[later[pairs]] - apart[pairs]
    variance = np.array(
        [[_change(one, t[i] + lag, over, k) + _change(other, t[i], over, k) for k in range(2)] for i in pairs]
    )
    ratio = change / np.sqrt(variance)
    usual = 1.48 * float(np.median(np.abs(ratio)))
    return Wander(over, _rms(change), float(np.sqrt(np.mean(variance))), _rms(ratio), usual)


def _change(path: Trajectory, t: float, over: float, axis: int) -> float:
    """Variance, m^2, of the change of the error of `path` along an axis of n from t to t + over s."""
    if path.joint is None:
        return 0.0
    P = path.joint.covariance(np.array([t, t + over]), np.tile(np.eye(3)[axis], (2, 1)))
    return float(P[0, 0] + P[1, 1] - 2.0 * P[0, 1])


@dataclass(frozen=True)
class Apart:
    """How far two estimates of one quantity are apart, in the unit of `name`.

    rms; expected by the sigmas of both; rms ratio of one to the other; shares within one and two sigmas.
    """

    name: str
    rms: float
    expected: float
    ratio: float
    within: tuple[float, float]

    @staticmethod
    def of(name: str, apart: Array, variance: Array) -> "Apart":
        """Of differences and the variances that are expected of them, each (N,) or (N, c)."""
        ratio = np.abs(apart) / np.sqrt(variance)
        within = float(np.mean(ratio < 1.0)), float(np.mean(ratio < 2.0))
        return Apart(name, _rms(apart), float(np.sqrt(np.mean(variance))), _rms(ratio), within)


def motions(one: Trajectory, other: Trajectory, t: Array) -> list[Apart]:
    """Velocities and attitudes of two boxes in one car, which moves, at the lag that suits the velocities best."""

    def apart(lag: float) -> Array:
        return np.asarray(_rows(one, one.velocity_n, t + lag) - _rows(other, other.velocity_n, t))

    lag = float(
        minimize_scalar(lambda s: _rms(apart(s)[:, :2]), bounds=(-LONGEST_LAG, LONGEST_LAG), method="bounded").x
    )
    moving = np.hypot(*_rows(other, other.velocity_n, t)[:, :2].T) > MOVING
    t = t[moving]

    def variance(values: str) -> Array:
        sigmas = (_rows(path, getattr(path.sigmas, values), at) for path, at in ((one, t + lag), (other, t)))
        return np.asarray(sum(sigma**2 for sigma in sigmas))

    velocity, of_velocity = apart(lag), variance("velocity_n")
    angles, others = (np.unwrap(path.euler, axis=0) for path in (one, other))
    turned = wrap_angle(_rows(one, angles, t + lag) - _rows(other, others, t))
    of_angle = variance("attitude")
    out = [
        Apart.of("velocity, level, m/s", velocity[:, :2], of_velocity[:, :2]),
        Apart.of("velocity upwards, m/s", velocity[:, 2], of_velocity[:, 2]),
    ]
    return out + [
        Apart.of(f"{name}, deg", turned[:, i] / DEG, of_angle[:, i] / DEG**2)
        for i, name in enumerate(("roll", "pitch", "yaw"))
    ]


@dataclass(frozen=True)
class Lasting:
    """What one module's level Doppler velocities err by, half of what two differ by, m/s per axis: rms, and of it what
    lasts for each of LATER, the root of the mean product (below zero as its negative)."""

    name: str
    rms: float
    lasts: list[float]


def lasting(first: Session, second: Session) -> list[Lasting]:
    """Errors that last in the velocities of the fixes, at rest and moving, at the lag that suits them best.

    The two antennas turn with the car: what that adds is a part of what moves, and lasts as bends do.
    """
    t, level = first.gnss.t, first.gnss.velocity_n[:, :2]
    other, other_t = second.gnss.velocity_n[:, :2], second.gnss.t
    moving = np.hypot(*level.T) > MOVING

    def apart(lag: float) -> Array:
        return np.asarray(level - np.column_stack([np.interp(t + lag, other_t, values) for values in other.T]))

    def usual(lag: float) -> float:
        return float(np.median(np.abs(apart(lag)[moving])))

    difference = apart(float(minimize_scalar(usual, bounds=(-LONGEST_LAG, LONGEST_LAG), method="bounded").x))
    sane = np.all(np.abs(difference) < WILD, axis=1)
    kinds = {"at rest": ~moving & (np.hypot(*level.T) < AT_REST), "moving": moving}
    spacing = float(np.median(np.diff(t)))
    return [_lasting(name, difference, sane & of_kind, spacing) for name, of_kind in kinds.items()]


def _lasting(name: str, difference: Array, use: BoolArray, spacing: float) -> Lasting:
    def product(later: int) -> float:
        both = use[: len(use) - later] & use[later:]
        return 0.5 * float(np.mean((difference[: len(use) - later] * difference[later:])[both]))

    products = [product(round(seconds / spacing)) for seconds in LATER]
    return Lasting(name, float(np.sqrt(product(0))), [float(np.sign(p) * np.sqrt(abs(p))) for p in products])


def _rows(path: Trajectory, values: Array, t: Array) -> Array:
    """Values (N, c) of the rows of `path` at t (M,) s, straight lines between."""
    return np.column_stack([np.interp(t, path.t, values[:, i]) for i in range(values.shape[1])])


def beside_rtk(data: Path) -> tuple[Difference, Difference, list[Wander], list[Apart]]:
    """Fixes and smoothed path of the car against RTK, at the epochs of RTK, which knows nothing of motions."""
    session = api.read(data / BESIDE_RTK)
    truth = api.read_truth(data / BESIDE_RTK, session.origin)
    rows = pl.read_csv(data / BESIDE_RTK / "truth.csv", columns=["t_s", "fix"])
    fixed = rows.filter(pl.col("fix") == RTK_FIXED)["t_s"].to_numpy()
    t = common_times([session.gnss.t, truth.t], fixed)
    smoothed = api.smooth(session)
    found = differ("smoothed", smoothed, truth, t)
    return differ("fixes", fixes_of(session), truth, t), found, wander(smoothed, truth, t), []


def twin_sessions(data: Path) -> tuple[tuple[Session, Session], Array]:
    """Modules a and b in one n, and the times (N,) s at which both have fixes."""
    first, second = (api.read(data / name) for name in TWINS)
    stamps = [first.gnss.t, second.gnss.t]
    t = common_times(stamps, np.arange(max(s[0] for s in stamps), min(s[-1] for s in stamps), SPACING))
    return (first, _with_origin_of(second, first)), t


def between_twins(data: Path) -> tuple[Difference, Difference, list[Wander], list[Apart]]:
    """Difference of module b from module a: of their fixes, and of their smoothed paths and motions."""
    (first, second), t = twin_sessions(data)
    raw = differ("fixes", fixes_of(second), fixes_of(first), t)
    path, other = (api.smooth(session) for session in (second, first))
    found = differ("smoothed", path, other, t)
    return raw, found, wander(path, other, t), motions(path, other, t)


def _with_origin_of(session: Session, other: Session) -> Session:
    """The session in the axes of the other: both in one n."""
    return replace(session, origin=other.origin)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def table_of_lasting(kinds: list[Lasting]) -> str:
    """Return what lasts of the errors of velocities as a Markdown table."""
    lines = [
        f"| Doppler, m/s | rms | {' | '.join(f'after {s:g} s' for s in LATER)} |",
        f"|---|{'---:|' * (len(LATER) + 1)}",
    ]
    lines += [f"| {k.name} | {k.rms:.4f} | {' | '.join(f'{value:.4f}' for value in k.lasts)} |" for k in kinds]
    return "\n".join(lines)


def table(pair: tuple[Difference, Difference], wanders: list[Wander], apart: list[Apart]) -> str:
    """Return both differences, how the smoothed path wanders, and motions apart, as Markdown tables."""
    lines = [
        "| | lag taken out, s | horizontal, m | moving: along, m | across, m | over 1 s, m |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {d.name} | {d.lag:+.3f} | {d.horizontal:.3f} | {d.along:.3f} | {d.across:.3f} | {d.relative:.3f} |"
        for d in pair
    ]
    lines += [
        "",
        "| smoothed, change over | m per axis | expected, m | ratio | usual ratio |",
        "|---|---:|---:|---:|---:|",
    ]
    lines += [f"| {w.over:.0f} s | {w.rms:.3f} | {w.sigma:.3f} | {w.ratio:.2f} | {w.usual:.2f} |" for w in wanders]
    if apart:
        heading = "| smoothed, moving | apart, rms | expected | ratio | within one sigma | two |"
        lines += ["", heading, "|---|---:|---:|---:|---:|---:|"]
    for a in apart:
        shares = " | ".join(f"{100.0 * share:.0f} %" for share in a.within)
        lines.append(f"| {a.name} | {a.rms:.3f} | {a.expected:.3f} | {a.ratio:.2f} | {shares} |")
    return "\n".join(lines)


def main() -> None:
    """Compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    if not DATA.is_dir():
        parser.exit(0, f"no real recordings at {DATA}; set SMOOTH_DATA\n")
    for heading, comparison in (("against RTK", beside_rtk), ("two modules in one car", between_twins)):
        since = time.process_time()
        fixes, smoothed, wanders, apart = comparison(DATA)
        spent = time.process_time() - since
        print(
            f"\n{heading}: {fixes.count} times ({spent:.0f} s of one core)\n\n"
            f"{table((fixes, smoothed), wanders, apart)}",
            flush=True,
        )
    print(f"\n{table_of_lasting(lasting(*twin_sessions(DATA)[0]))}")


if __name__ == "__main__":
    main()
