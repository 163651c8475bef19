"""Logs of phones, simulated as a check: top speed and lap times beside the truth, and how honest their sigmas are.

    python benchmarks/phones.py                  # twenty phones; some seconds each

A phone has fixes at 1 Hz without a motion sensor, a Doppler speed of 0.2 m/s, and states an accuracy of 5 to 50 m. Its
positions either wander by a share of that over seconds to a minute, or come late by a time that varies by a second or
two. A lap counts if its truth is known.
"""

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from lap_times import true_crossings, true_line
from scoring import TRACKS, rms
from smoother import api
from smoother.arrays import Array
from smoother.frames import nwu_to_geodetic
from smoother.laps.top_speed import top_speed
from smoother.samples import GnssFixes
from smoother.sim.simulation import Simulation

DURATION = 480.0  # s
DOPPLER = 0.2  # m/s per axis


@dataclass(frozen=True)
class Score:
    """A phone: what it stated, top speed and true one m/s, errors of lap times s and these over their sigmas."""

    name: str
    top: float
    true_top: float
    errors: list[float]
    z: Array


def phone(seed: int) -> tuple[str, Simulation]:
    """A phone and the session that it logged."""
    rng = np.random.default_rng(1000 + seed)
    stated, is_late = float(np.exp(rng.uniform(np.log(5.0), np.log(50.0)))), seed % 2 == 1
    wander = 0.0 if is_late else min(0.4 * stated, 12.0)
    tau = float(np.exp(rng.uniform(np.log(8.0), np.log(60.0))))
    simulation = api.simulate(
        "kart",
        seed,
        track=TRACKS[seed % 3],
        duration=DURATION,
        motion_standstill=None,
        gnss_rate=1.0,
        gnss_white_horizontal=1.0,
        gnss_offset_horizontal=wander,
        gnss_offset_tau=tau,
        gnss_velocity_sigma=DOPPLER,
        gnss_outages=(),
    )
    fixes = simulation.raw.gnss
    if is_late:
        fixes = _late(simulation, fixes, rng)
    accuracy = stated * np.exp(rng.normal(0.0, 0.2, len(fixes)))
    fixes = replace(fixes, sigma_horizontal=accuracy, sigma_up=1.5 * accuracy, hdop=None)
    raw = replace(simulation.raw, gnss=fixes, imu=None, mag=None, mag_calibration_field=None)
    kind = "late" if is_late else f"wanders by {wander:.1f} m, {tau:.0f} s"
    return f"{stated:3.0f} m stated, {kind}", replace(simulation, raw=raw)


def _late(simulation: Simulation, fixes: GnssFixes, rng: np.random.Generator) -> GnssFixes:
    """The fixes with positions that were true up to two seconds before, by a time that varies over ten seconds."""
    t = fixes.t - simulation.scenario.gnss.position_latency
    knots = np.arange(t[0], t[-1] + 20.0, 10.0)
    late = np.interp(t, knots, rng.uniform(0.2, 1.8, len(knots)))
    place = simulation.truth.antenna_position_n(np.maximum(t - late, 0.0), simulation.scenario.lever_arm_b)
    place[:, :2] += rng.normal(0.0, 1.0, (len(t), 2))
    lat, lon, _ = nwu_to_geodetic(place, simulation.truth.origin)
    return replace(fixes, lat_deg=lat, lon_deg=lon)


def run(seed: int) -> Score:
    """Smooth and score one phone."""
    name, simulation = phone(seed)
    session = api.prepared(simulation.raw)
    estimate = api.smooth(session)
    line = true_line(simulation, session.origin)
    analysis = api.laps(session, estimate, line)
    assert analysis.start_line is not None
    crossings = true_crossings(simulation, analysis.start_line, session.origin, estimate)
    laps = [lap for lap in analysis.laps if lap.is_timed]
    ends = [
        (int(np.argmin(np.abs(crossings - lap.start))), int(np.argmin(np.abs(crossings - lap.end)))) for lap in laps
    ]
    errors = [
        lap.time - float(crossings[last] - crossings[first])  # wherever a late position has both
        for lap, (first, last) in zip(laps, ends, strict=True)
        if last == first + 1
    ]
    sigmas = [lap.sigma for lap, (first, last) in zip(laps, ends, strict=True) if last == first + 1]
    fine = np.arange(max(0.5, estimate.t[0]), estimate.t[-1] - 0.5, 0.05)
    true = simulation.truth.antenna_velocity_n(fine, simulation.scenario.lever_arm_b)
    return Score(
        name,
        top_speed(estimate, analysis).speed,
        float(np.max(np.hypot(true[:, 0], true[:, 1]))),
        errors,
        np.array(errors) / np.array(sigmas),
    )


def main() -> int:
    """Print a row a phone, and all together."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    scores = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for s in pool.map(run, range(options.seeds)):
            off, worst = 100.0 * (s.top / s.true_top - 1.0), float(np.max(np.abs(s.z), initial=0.0))
            laps = f"{len(s.z):2d} laps, rms {rms(s.errors):5.2f} s, z {rms(s.z):4.2f}, largest {worst:4.2f}"
            print(f"{s.name:<40} top {3.6 * s.top:5.1f} km/h ({off:+4.1f} %)  {laps}", flush=True)
            scores.append(s)
    for kind in ("wanders", "late"):
        these = [s for s in scores if kind in s.name]
        z, tops = np.abs(np.concatenate([s.z for s in these])), np.array([s.top / s.true_top - 1.0 for s in these])
        print(
            f"{kind}: top speed within 3 % of {np.count_nonzero(np.abs(tops) < 0.03)} of {len(tops)}, largest error "
            f"{100.0 * np.max(np.abs(tops)):.1f} %; {z.size} laps, {100.0 * np.mean(z < 2.0):.0f} % within 2 sigma, "
            f"largest {np.max(z):.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
