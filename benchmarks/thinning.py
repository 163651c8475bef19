"""Real karts with fixes left out: how near does each method come to the fixes it was not given?

    SMOOTH_DATA=folder python benchmarks/thinning.py
    SMOOTH_DATA=folder python benchmarks/thinning.py --phases 6

Every recording is thinned to one fix in 1, 2 and 5 s, beginning with the first one; with `--phases` also with later
ones, since which fixes are kept is an accident: 66 of them more or less know the delay. The error is that of the
horizontal position at the dropped fixes. A fix stamped t was true at t - latency, so an estimator is read there, with
the latency it found itself from the thinned data. The fixes contain the slow GPS offset; `+ offset` adds the
estimator's own estimate of it, which is what predicts a fix, as interpolation does. The Hermite interpolation is
given the lag of the Doppler velocity that suits it best; `all Doppler` takes the velocities at its knots from the
dropped fixes too, which nobody else has. Not scored: rows that repeat a position (the reader drops them), dropped
fixes whose own reported accuracy is worse than three times the median, and the first second.
"""

import argparse
import itertools
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from smoother import api
from smoother.arrays import Array, BoolArray
from smoother.samples import Session
from smoother.trajectory import Trajectory

RECORDINGS = ("kart_adria_first_half", "kart_lignano_racebox")
DATA = Path(os.environ.get("SMOOTH_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
WORST_ACCURACY = 3.0  # times the median of the reported accuracy
SETTLING = 1.0  # s after the first fix that nobody is scored on: longer than any latency
LAGS = np.arange(0.0, 0.401, 0.01)  # s, of Doppler velocity behind position


@dataclass(frozen=True)
class Result:
    """Horizontal error of one method at the dropped fixes, m: rms, and what 95 % stay below."""

    recording: str
    interval: float
    method: str
    rms: float
    p95: float
    count: int
    note: str = ""


def thin(session: Session, interval: float, phase: float = 0.0) -> tuple[Session, BoolArray]:
    """Return the session with the first fix of every `interval` s only, and the mask (N,) of the fixes kept.

    phase, a part of the interval, is how much later than the first fix of all the first one kept is.
    """
    t = session.gnss.t
    slot = np.floor((t - t[0]) / interval - phase + 1e-6)
    kept = np.concatenate([[phase == 0.0], np.diff(slot) > 0])
    return replace(session, gnss=session.gnss.select(kept)), kept


def scored(session: Session, kept: BoolArray) -> BoolArray:
    """Mask (N,) of the dropped fixes that count."""
    gnss = session.gnss
    t, accuracy = gnss.t, gnss.sigma_horizontal
    assert accuracy is not None
    first, last = t[kept][[0, -1]]
    good = (
        ~(accuracy > WORST_ACCURACY * np.nanmedian(accuracy))
        if np.any(np.isfinite(accuracy))
        else np.full(len(t), True)
    )
    return np.asarray(~kept & good & (t > max(first, t[0] + SETTLING)) & (t < last))


def interpolations(thinned: Session, t: Array) -> dict[str, Callable[[], Array]]:
    """Return the plain methods: each gives positions (N, 2) m at the stamps t."""
    knots, position = thinned.gnss.t, thinned.fix_position_n[:, :2]
    return {
        "linear": lambda: np.stack([np.interp(t, knots, position[:, i]) for i in range(2)], axis=1),
        "cubic": lambda: np.asarray(CubicSpline(knots, position)(t)),
    }


def hermite(
    knots: Array, position: Array, doppler_t: Array, doppler: Array, t: Array, truth: Array
) -> tuple[Array, float]:
    """Positions (N, 2) m at t by cubic Hermite, and the lag (s) of the Doppler that comes nearest to the truth (N, 2).

    knots (K,) s, position (K, 2) m; doppler (M, 2) m/s stamped doppler_t (M,), true `lag` before a position so stamped.
    """
    known = np.isfinite(doppler).all(axis=1)
    best, best_rms, best_lag = np.empty_like(truth), np.inf, np.nan
    for lag in LAGS:
        stamps, values = doppler_t[known] - lag, doppler[known]
        straight = np.stack([np.interp(knots, stamps, values[:, i]) for i in range(2)], axis=1)
        for at_knots in (straight, np.asarray(CubicSpline(stamps, values)(knots))):
            found = np.asarray(CubicHermiteSpline(knots, position, at_knots)(t))
            if (rms := _rms(found - truth)) < best_rms:
                best, best_rms, best_lag = found, rms, float(lag)
    return best, best_lag


def read_estimate(trajectory: Trajectory, t: Array) -> tuple[Array, Array | None, float]:
    """Positions (N, 2) m at which fixes stamped t are predicted, likewise with the offset, and the latency used."""
    value = trajectory.report.identified["gps_position_latency"].value
    latency = float(np.asarray(value))
    at = t - latency
    position = np.stack([CubicSpline(trajectory.t, trajectory.position_n[:, i])(at) for i in range(2)], axis=1)
    keyframes = trajectory.report.keyframes
    if keyframes is None or keyframes.gps_offset_n is None:
        return position, None, latency
    offset = np.stack([np.interp(at, keyframes.t, keyframes.gps_offset_n[:, i]) for i in range(2)], axis=1)
    return position, position + offset, latency


def run(case: tuple[Path, float, float]) -> list[Result]:
    """All methods on one recording, thinned to one fix in `interval` s from a phase on."""
    path, interval, phase = case
    session = api.read(path)
    thinned, kept = thin(session, interval, phase)
    wanted = scored(session, kept)
    t, truth = session.gnss.t[wanted], session.fix_position_n[wanted, :2]
    results = []

    def add(method: str, found: Array, note: str = "") -> None:
        error = np.linalg.norm(found - truth, axis=1)
        results.append(
            Result(path.name, interval, method, _rms(found - truth), float(np.percentile(error, 95)), len(t), note)
        )

    for name, interpolate in interpolations(thinned, t).items():
        add(name, interpolate())
    for method, source in (("Hermite", thinned), ("Hermite, all Doppler", session)):
        given = thinned.gnss.t, thinned.fix_position_n[:, :2], source.gnss.t, source.gnss.velocity_n[:, :2]
        found, lag = hermite(*given, t, truth)
        add(method, found, f"Doppler lag {lag:.2f} s")
    for name, imu in (("gps-only", False), ("smoother", True)):
        since = time.perf_counter()
        trajectory = api.smooth(thinned, imu=imu)
        seconds = time.perf_counter() - since
        position, with_offset, latency = read_estimate(trajectory, t)
        note = f"latency {latency:.3f} s, {trajectory.report.mode}, {seconds:.1f} s"
        add(name, position, note)
        if with_offset is not None:
            add(f"{name} + offset", with_offset, _noise_note(trajectory))
    return results


def _noise_note(trajectory: Trajectory) -> str:
    values = trajectory.report.identified
    names = ("accel_noise", "gyro_noise", "gps_position_noise", "gps_velocity_noise")
    return ", ".join(
        f"{name} {float(np.ravel(np.asarray(values[name].value, dtype=np.float64))[0]):.3g}"
        for name in names
        if name in values
    )


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def together(phases: list[list[Result]]) -> list[Result]:
    """One result of each method for all phases, and in the note the least and the largest rms of a phase."""
    if len(phases) == 1:
        return phases[0]
    out = []
    for results in zip(*phases, strict=True):
        rms = np.array([r.rms for r in results])
        p95 = float(np.mean([r.p95 for r in results]))
        note = f"{rms.min():.3f} to {rms.max():.3f} m in {len(rms)} phases"
        count = sum(r.count for r in results)
        out.append(replace(results[0], rms=float(np.sqrt(np.mean(rms**2))), p95=p95, count=count, note=note))
    return out


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recording", action="append", help=f"default: {' and '.join(RECORDINGS)}")
    parser.add_argument("--interval", action="append", type=float, help="s between fixes; default 1, 2 and 5")
    parser.add_argument("--phases", type=int, default=1, help="ways to thin, evenly spread over the interval")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", metavar="FILE", help="write all figures")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.exit(0, f"no real recordings at {DATA}; set SMOOTH_DATA\n")
    wanted = [
        (DATA / name, interval, phase / arguments.phases)
        for name in arguments.recording or RECORDINGS
        for interval in arguments.interval or (1.0, 2.0, 5.0)
        for phase in range(arguments.phases)
    ]
    every: list[Result] = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        done = iter(pool.map(run, wanted) if arguments.jobs > 1 else map(run, wanted))
        while phases := list(itertools.islice(done, arguments.phases)):
            results = together(phases)
            first = results[0]
            print(f"\n{first.recording}, one fix in {first.interval:g} s, {first.count} dropped fixes")
            for r in results:
                print(f"  {r.method:<20} rms {r.rms:8.3f} m   95 % below {r.p95:8.3f} m   {r.note}", flush=True)
            every += results
    if arguments.json:
        Path(arguments.json).write_text(json.dumps([asdict(r) for r in every], indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
