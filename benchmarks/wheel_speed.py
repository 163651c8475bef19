"""What a wheel speed is worth: a real car's and simulated karts', with and without the factor.

Run: SMOOTH_DATA=... python benchmarks/wheel_speed.py [seeds]
"""

import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from smoother.api import prepared, read, read_truth, simulate, smooth
from smoother.arrays import Array, BoolArray
from smoother.samples import Session
from smoother.sim.scenario import Interval
from smoother.trajectory import Identified, Trajectory

FACTOR = "wheel_speed"
TRUE = {"wheel_scale": 0.03, "wheel_slip": 0.004, "wheel_side": 0.5}
SENSOR: dict[str, Any] = TRUE | {"wheel_rate": 50.0, "wheel_noise": 0.05}
LASTING = 0.1  # m/s, as a tyre's errors that go with neither force nor turning
OUTAGE = (120.0, 20.0)  # s, start and length


def error(trajectory: Trajectory, truth: Trajectory, rows: BoolArray, free: BoolArray) -> tuple[float, float]:
    """Horizontal rms of position, m, beside the mean error of the rows `free`, and of velocity, m/s, of some rows."""
    apart = trajectory.position_n - truth.position_n
    apart = apart - np.nanmean(apart[free], axis=0)
    velocity = trajectory.velocity_n - truth.velocity_n
    return rms(apart[rows]), rms(velocity[rows])


def rms(error_n: Array) -> float:
    """Root mean square of horizontal errors (N, 3)."""
    return float(np.sqrt(np.nanmean(np.sum(error_n[:, :2] ** 2, axis=1))))


def at_times(truth: Trajectory, t: Array) -> Trajectory:
    """The truth at rows t (N,) s, linearly between its own."""
    columns = [
        np.stack([np.interp(t, truth.t, values[:, i], np.nan, np.nan) for i in range(3)], axis=1)
        for values in (truth.position_n, truth.velocity_n)
    ]
    return Trajectory(t, columns[0], columns[1], np.zeros((len(t), 3, 3)), *np.zeros((2, len(t), 3)))


def left_out(session: Session) -> Iterator[tuple[str, Session, tuple[float, float]]]:
    """Name, session and the span, s, to be judged, of several ways to leave out fixes."""
    t = session.gnss.t
    whole = float(t[0]), float(t[-1])
    yield "all fixes", session, whole
    kept = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], 5.0)))
    yield "one fix in 5 s", replace(session, gnss=session.gnss.select(kept)), whole
    for length in (10.0, 20.0, 30.0):
        begin = float(0.5 * (t[0] + t[-1] - length))
        outage = (t > begin) & (t < begin + length)
        yield f"outage of {length:.0f} s", replace(session, gnss=session.gnss.select(~outage)), (begin, begin + length)


def real(folder: Path) -> None:
    """Print errors of a real car."""
    session = read(folder)
    truth = read_truth(folder, session.origin)
    print(f"{folder.name}: rms position m, velocity m/s; without the wheel, with it")
    for name, some, (begin, end) in left_out(session):
        parts = []
        for without in ((FACTOR,), ()):
            found = smooth(some, without=without)
            rows = (found.t >= begin) & (found.t <= end)
            free = ~rows if np.any(~rows) and "outage" in name else rows
            parts.append("{:6.3f} {:6.3f}".format(*error(found, at_times(truth, found.t), rows, free)))
        print(f"  {name:16s} {'   '.join(parts)}   {told(found)}")


def told(found: Trajectory) -> str:
    """What was identified of the wheel."""
    values = {name: value for name, value in found.report.identified.items() if name.startswith("wheel")}
    return ", ".join("{} {:.4f} +- {:.4f}".format(name[6:], *first(value)) for name, value in values.items())


def first(found: Identified) -> tuple[float, float]:
    """The first number of a value, and its sigma."""
    return float(np.asarray(found.value).flat[0]), float(np.asarray(found.sigma).flat[0])


def simulated(seeds: int) -> None:
    """Print errors of simulated karts in an outage, and how far constants are off, in sigmas."""
    print(f"kart, 300 s, outage of {OUTAGE[1]:.0f} s: rms position m, velocity m/s in it, (error / sigma)^2 of each")
    for lasting in (0.0, LASTING):
        runs = [of_seed(seed, lasting) for seed in range(seeds)]
        print(f"  errors that last: {lasting:.1f} m/s")
        for with_wheel, name in enumerate(("without", "with")):
            numbers = np.array([judged[with_wheel] for judged, _ in runs])
            print(f"    {name:8s}", *(f"{x:6.3f}" for x in np.sqrt(np.mean(numbers[:, :2] ** 2, axis=0))), end="  ")
            print(*(f"{x:5.2f}" for x in np.mean(numbers[:, 2:], axis=0)))
        for k, name in enumerate(TRUE):
            print(f"    {name} off by", *(f"{off[k]:+.1f}" for _, off in runs), "sigmas")


def of_seed(seed: int, lasting: float) -> tuple[list[Array], list[float]]:
    """Errors (4,) in the outage without and with the wheel, and of the constants in sigmas."""
    drive = simulate("kart", seed, duration=300.0, gnss_outages=(Interval(*OUTAGE),), wheel_lasting=lasting, **SENSOR)
    session, judged = prepared(drive.raw), []
    for without in ((FACTOR,), ()):
        found = smooth(session, without=without)
        truth = drive.truth.trajectory(found.t, drive.scenario.lever_arm_b, session.origin)
        at = found.t - drive.truth.clock.to_session(np.array([OUTAGE[0]]))[0]
        rows, sigmas = (at > 0.0) & (at < OUTAGE[1]), found.sigmas
        assert sigmas is not None
        position, velocity = found.position_n - truth.position_n, found.velocity_n - truth.velocity_n
        normalised = (position / sigmas.position_n, velocity / sigmas.velocity_n)
        squares = [float(np.mean(values[rows, :2] ** 2)) for values in normalised]
        judged.append(np.array([*error(found, truth, rows, ~rows), *squares]))
    numbers = (first(found.report.identified[name]) for name in TRUE)
    return judged, [(value - true) / sigma for (value, sigma), true in zip(numbers, TRUE.values(), strict=True)]


if __name__ == "__main__":
    if "SMOOTH_DATA" in os.environ:
        real(Path(os.environ["SMOOTH_DATA"]) / "car_comma2k19")
    simulated(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
