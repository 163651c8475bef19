"""The catalogue of hard sessions: each right within its sigma, or refused with a reason; none worse than GPS alone.

    python benchmarks/hard_sessions.py --jobs 2                    all of docs/hard_sessions.md
    python benchmarks/hard_sessions.py --case "IMU gap" --seed 3   those whose name holds the words

A session is simulated, damaged, written as CSV, read, smoothed and judged as `smooth` does it, then held against truth
and against the fixes joined by straight lines. "right" means: of every quantity at least `INSIDE` of the errors lie
within two sigma; the error of position is not above that of GPS alone.
"""

import argparse
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.errors import SmootherError
from smoother.estimate.evaluate import evaluate
from smoother.estimate.gps_alone import GpsAlone
from smoother.estimate.graph.response import low_passed
from smoother.estimate.graph.smoother import GraphOptions, GraphSmoother
from smoother.estimate.quality import assess
from smoother.prepare import prepare
from smoother.samples import RawSession
from smoother.session.load import load_raw
from smoother.sim.motion import Spin, Stop
from smoother.sim.record import write_csv
from smoother.sim.scenario import Interval, Jump
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.units import DEG

DURATION = 240.0  # s
MIDDLE = 120.0  # s
INSIDE = 0.8  # of the errors within two sigma; 0.95 would be perfect, but minutes of one session are correlated
SLACK = 1.02  # times the error of GPS alone, plus
SLACK_M = 0.02  # m: a standing kart with perfect fixes has nothing to gain
COMMON = {"gnss_outages": (), "gnss_jumps": (), "imu_gaps": ()}  # of the preset: each case has one trouble
QUANTITIES = ("north", "west", "vel_north", "vel_west", "roll", "pitch", "yaw")

METRES_PER_DEGREE = 111_200.0  # of latitude

Damage = Callable[[RawSession], RawSession]


@dataclass(frozen=True)
class Hard:
    """One hard session: figures changed, what then happens to the samples, and what is expected of the result.

    receiver_tau: time constant, s, of a low-pass that its velocities come through.
    """

    name: str
    expectation: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    damage: Damage | None = None
    duration: float = DURATION
    receiver_tau: float | None = None

    def simulate(self, seed: int) -> Simulation:
        """Return the session; `raw` holds the damaged samples."""
        simulation = simulate_preset("kart", seed, duration=self.duration, **{**COMMON, **self.changes})
        if self.receiver_tau is not None:
            return replace(simulation, raw=speed_behind_low_pass(simulation, self.receiver_tau))
        return simulation if self.damage is None else replace(simulation, raw=self.damage(simulation.raw))


@dataclass(frozen=True)
class Outcome:
    """What became of a hard session: errors in m and m/s, shares within two sigma, reasons of the gate, CPU s, MB."""

    name: str
    expectation: str
    verdict: str
    mode: str
    horizontal: float
    gps: float
    velocity: float
    gps_velocity: float
    worst: str
    reasons: str
    seconds: float
    megabytes: float


def turned_after(t: float, rotation: Array) -> Damage:
    """The box moves in its mounting at time t (s): all sensors read in axes turned by `rotation` (3,) rad."""

    def damage(raw: RawSession) -> RawSession:
        assert raw.imu is not None
        R = so3.exp(rotation)
        later = (raw.imu.t > t)[:, None]
        accel, gyro = (np.where(later, values @ R.T, values) for values in (raw.imu.accel, raw.imu.gyro))
        mag = raw.mag
        if mag is not None:
            mag = replace(mag, field=np.where((mag.t > t)[:, None], mag.field @ R.T, mag.field))
        return replace(raw, imu=replace(raw.imu, accel=accel, gyro=gyro), mag=mag)

    return damage


def rattling_after(t: float, seconds: float) -> Damage:
    """The box comes loose at t and swings about its forward axis, 15 deg at 1 Hz, until it is fastened again."""

    def damage(raw: RawSession) -> RawSession:
        assert raw.imu is not None
        phase = 2.0 * np.pi * (raw.imu.t - t)
        loose = (raw.imu.t > t) & (raw.imu.t < t + seconds)
        angle = np.where(loose, 15.0 * DEG * np.sin(phase), 0.0)
        rate = np.where(loose, 15.0 * DEG * 2.0 * np.pi * np.cos(phase), 0.0)
        c, s = np.cos(angle), np.sin(angle)
        accel, gyro = (_about_x(values, c, s) for values in (raw.imu.accel, raw.imu.gyro))
        gyro[:, 0] += rate / raw.imu.gyro_scale
        return replace(raw, imu=replace(raw.imu, accel=accel, gyro=gyro))

    return damage


def _about_x(values: Array, c: Array, s: Array) -> Array:
    return np.stack([values[:, 0], c * values[:, 1] + s * values[:, 2], c * values[:, 2] - s * values[:, 1]], axis=-1)


def one_fix_south(raw: RawSession) -> RawSession:
    """One fix has the letter of the other hemisphere."""
    lat = raw.gnss.lat_deg.copy()
    lat[len(lat) // 2] *= -1.0
    return replace(raw, gnss=replace(raw.gnss, lat_deg=lat))


def compass_reversed(raw: RawSession) -> RawSession:
    """The field is mirrored, so that a heading from it is half a turn wrong."""
    assert raw.mag is not None
    return replace(raw, mag=replace(raw.mag, field=raw.mag.field * [-1.0, -1.0, 1.0]))


def samples_on_a_clock_of_their_own(fast: float) -> Damage:
    """The samples are stamped by another clock than the fixes, which begins with theirs and runs fast."""

    def damage(raw: RawSession) -> RawSession:
        assert raw.imu is not None
        zero = raw.gnss.t[0]
        mag = raw.mag if raw.mag is None else replace(raw.mag, t=zero + (raw.mag.t - zero) * (1.0 + fast))
        return replace(raw, imu=replace(raw.imu, t=zero + (raw.imu.t - zero) * (1.0 + fast)), mag=mag)

    return damage


def coming_in(north: float, memory: float) -> Damage:
    """The receiver has just found its satellites: positions come in from `north` m off, by 1/e in `memory` s."""

    def damage(raw: RawSession) -> RawSession:
        off = north * np.exp(-(raw.gnss.t - raw.gnss.t[0]) / memory)
        return replace(raw, gnss=replace(raw.gnss, lat_deg=raw.gnss.lat_deg + off / METRES_PER_DEGREE))

    return damage


def velocity_off(turn: float, factor: float) -> Damage:
    """Velocities point `turn` rad to the right of where they should, as with a magnetic course, and are longer."""
    cos, sin = factor * np.cos(turn), factor * np.sin(turn)

    def damage(raw: RawSession) -> RawSession:
        north, west, up = raw.gnss.velocity_n.T
        velocity_n = np.stack([cos * north + sin * west, cos * west - sin * north, up], axis=1)
        return replace(raw, gnss=replace(raw.gnss, velocity_n=velocity_n))

    return damage


def speed_behind_low_pass(simulation: Simulation, tau: float) -> RawSession:
    """The receiver smooths its velocity by a low-pass of first order."""
    timing, dt = simulation.gnss.velocity_time, 0.005
    t = np.arange(simulation.truth.first, timing[-1], dt)
    true_n = simulation.truth.antenna_velocity_n(t, simulation.scenario.lever_arm_b)
    late_n = low_passed(true_n, dt, tau) - true_n
    late_n[:, 2] = 0.0
    added = np.column_stack([np.interp(timing, t, late_n[:, i]) for i in range(3)])
    gnss = simulation.raw.gnss
    return replace(simulation.raw, gnss=replace(gnss, velocity_n=gnss.velocity_n + added))


HARD = (
    Hard("plain", "right; what all others are compared with", {"motion_standstill": 5.0}),
    Hard("no standstill", "right: biases come from driving", {"motion_standstill": None}),
    Hard("parked", "right, or says that nothing moved", {"motion_driving": False}),
    Hard("wrong start heading", "right: the compass is not believed", damage=compass_reversed),
    Hard("box loose for 20 s", "code 3", damage=rattling_after(MIDDLE, 20.0)),
    Hard("box slips by 10 deg", "right, or code 3", damage=turned_after(MIDDLE, np.array([0.0, 10.0 * DEG, 0.0]))),
    Hard("box slips by 4 deg", "right, or code 3", damage=turned_after(MIDDLE, np.array([0.0, 4.0 * DEG, 0.0]))),
    Hard("box turns by 6 deg", "right, or code 3", damage=turned_after(MIDDLE, np.array([0.0, 0.0, 6.0 * DEG]))),
    Hard(
        "box turned over",
        "right: the part with less way is left out",
        damage=turned_after(MIDDLE, np.array([np.pi, 0.0, 0.0])),
    ),
    Hard("box on the wheel", "right: roll and yaw as unsure as the wheel makes them", {"motion_steering": 10.0 * DEG}),
    Hard(
        "the same, accelerometer 50 ms late",
        "right: the delay is taken out",
        {"motion_steering": 10.0 * DEG, "imu_accel_delay": 0.05},
    ),
    Hard("IMU gap of 30 s", "right; GPS carries it", {"imu_gaps": (Interval(MIDDLE, 30.0),)}),
    Hard("GPS outage of 60 s", "right: sigma grows", {"gnss_outages": (Interval(MIDDLE - 30.0, 60.0),)}),
    Hard(
        "30 m off for a minute", "code 3, or sigma says so", {"gnss_jumps": (Jump(90.0, 60.0, np.array([30.0, 0, 0])),)}
    ),
    Hard("wrong hemisphere once", "right: one fix rejected", damage=one_fix_south),
    Hard("accelerometer clips at 2 g", "right, or code 3", {"imu_accel_range": 2.0 * 9.80665}),
    Hard("gyro clips at 60 deg/s", "right, or code 3", {"imu_gyro_range": 60.0 * DEG}),
    Hard("IMU clock 2 % fast", "right: UTC shows it, and it is taken out", {"imu_clock_drift": 0.02}),
    Hard("IMU clock 2 % slow", "right: UTC shows it, and it is taken out", {"imu_clock_drift": -0.02}),
    Hard(
        "samples' clock 100 ppm slow",
        "right: found by the fixes, and taken out",
        damage=samples_on_a_clock_of_their_own(-1e-4),
    ),
    Hard(
        "samples' clock 0.7 % fast",
        "right: found by the fixes, and taken out",
        damage=samples_on_a_clock_of_their_own(7e-3),
    ),
    Hard("cold start, 40 m off", "right: what comes in is left out", damage=coming_in(40.0, 12.0)),
    Hard("speed smoothed over 0.6 s", "right: found, and taken out", receiver_tau=0.6),
    Hard("magnetic course, 4 deg off", "right: found, and turned back", damage=velocity_off(4.0 * DEG, 1.0)),
    Hard("speed of a wheel, 3 % fast", "right: found, and scaled", damage=velocity_off(0.0, 1.03)),
    Hard("magnetometer at the motor", "right: the field is not believed", {"mag_engine_disturbance": 1.0}),
    Hard("GPS at 1 Hz", "right", {"gnss_rate": 1.0}),
    Hard("GPS at 25 Hz", "right", {"gnss_rate": 25.0}),
    Hard("IMU at 25 Hz", "right, or code 3", {"imu_rate": 25.0}),
    Hard("IMU at 50 Hz", "right", {"imu_rate": 50.0}),
    Hard("IMU at 1 kHz", "right", {"imu_rate": 1000.0}),
    Hard("IMU at 2 kHz", "right", {"imu_rate": 2000.0}),
    Hard("fixes without velocity", "right", {"gnss_velocity": False}),
    Hard("four spins", "right", {"motion_spins": tuple(Spin(45.0 * k, 2.5) for k in range(1, 5))}),
    Hard("ten stops", "right", {"motion_stops": tuple(Stop(20.0 * k, 6.0) for k in range(1, 11))}),
)
PARKED_LONG = Hard(
    "parked for an hour", "right, or says that nothing moved", {"motion_driving": False}, duration=3600.0
)


def run(hard: Hard, seed: int) -> Outcome:
    """Simulate, write, read, smooth, judge."""
    simulation = hard.simulate(seed)
    with tempfile.TemporaryDirectory() as name:
        write_csv(simulation, Path(name), truth_rate=10.0)
        since = time.process_time()
        try:
            session = prepare(load_raw(Path(name)))
            estimate = GraphSmoother(GraphOptions()).estimate(session)
        except SmootherError as error:
            return _refused(hard, str(error), time.process_time() - since)
        spent = time.process_time() - since
    quality = assess(session, estimate)
    grid = np.arange(max(estimate.t[0], simulation.truth.first), min(estimate.t[-1], simulation.truth.last), 0.1)
    truth = simulation.truth.trajectory(grid, simulation.scenario.lever_arm_b, origin=session.origin)
    ours, gps = evaluate(estimate, truth), evaluate(GpsAlone().estimate(session), truth)
    inside = {name: ours.coverage[name][1] for name in QUANTITIES if np.isfinite(ours.coverage[name][1])}
    worst = min(inside, key=lambda name: inside[name]) if inside else "-"
    too_far = ours.horizontal_rms_m > SLACK * gps.horizontal_rms_m + SLACK_M
    wrong = bool(inside) and inside[worst] < INSIDE
    verdict = (
        "code 3" if not quality.passed else "worse than GPS" if too_far else "sigma too small" if wrong else "right"
    )
    return Outcome(
        hard.name,
        hard.expectation,
        verdict,
        estimate.report.mode,
        ours.horizontal_rms_m,
        gps.horizontal_rms_m,
        ours.horizontal_velocity_rms_mps,
        gps.horizontal_velocity_rms_mps,
        f"{worst} {inside.get(worst, np.nan):.2f}",
        "; ".join(quality.reasons),
        spent,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )


def _refused(hard: Hard, text: str, seconds: float) -> Outcome:
    nan = float("nan")
    return Outcome(hard.name, hard.expectation, "code 2", "-", nan, nan, nan, nan, "-", text, seconds, nan)


def table(outcomes: list[Outcome]) -> str:
    """Return the table of docs/hard_sessions.md."""
    lines = [
        "| session | expected | result | mode | position m | GPS alone m | velocity m/s | GPS m/s "
        "| least within 2 sigma | CPU s |",
        "|---|---|---|---|--:|--:|--:|--:|---|--:|",
    ]
    for o in outcomes:
        result = o.verdict + (f": {o.reasons}" if o.reasons else "")
        lines.append(
            f"| {o.name} | {o.expectation} | {result} | {o.mode} | {o.horizontal:.2f} | {o.gps:.2f} "
            f"| {o.velocity:.2f} | {o.gps_velocity:.2f} | {o.worst} | {o.seconds:.1f} |"
        )
    return "\n".join(lines)


def main() -> int:
    """Parse the arguments, run, print; the exit code says whether a session was wrong without a word."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", default="", help="words of the name")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--long", action="store_true", help="also the hour in the paddock")
    arguments = parser.parse_args()
    known = (*HARD, *([PARKED_LONG] if arguments.long else []))
    wanted = [hard for hard in known if arguments.case in hard.name]
    if not wanted:
        names = "; ".join(hard.name for hard in known)
        parser.error(f"no session has {arguments.case!r} in its name; there are {names}")
    work = partial(run_by_name, seed=arguments.seed)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        outcomes = list(pool.map(work, [hard.name for hard in wanted]))
    print(table(outcomes))
    return int(any(outcome.verdict not in ("right", "code 3") for outcome in outcomes))


def run_by_name(name: str, seed: int) -> Outcome:
    """Run one session of the catalogue; its name travels between processes, where functions cannot."""
    return run(next(hard for hard in (*HARD, PARKED_LONG) if hard.name == name), seed)


if __name__ == "__main__":
    sys.exit(main())
