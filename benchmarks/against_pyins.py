"""The smoother beside the extended Kalman filter of `pyins` (PyPI: python-ins), on the same simulated sessions.

    python benchmarks/against_pyins.py --seeds 6 --duration 200

The filter gets everything that the smoother has to find out, as the truth has it: both latencies (each fix is put to
the time at which it was true), lever arm, mounting, the effective noise densities of force and rate with the engine
in them, the biases of the start, sizes of their walks, of scale and misalignment, the noise of fixes and Doppler, the
attitude at the start to half a degree and the velocity likewise; jumps are taken out of its fixes. Its position
starts at its first fix, with the sigma of one, as a filter's does: a true one would tell it the slow offset of the
GPS, which no session contains. It has no model of the slow GPS offset, so every session is filtered with several
sigmas of a fix, from the white noise alone to one that allows for the correlation, and in every column the best of
them counts, chosen with the truth; where it diverges (inf), it is run again without the states of scale and
misalignment. Its estimate at each time knows only what came before; the smoother's knows all of the session. That
difference is the point of smoothing afterwards.
"""

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from pyins import filters, inertial_sensor, measurements, strapdown, transform

from scoring import SCORED_RATE, Case, cases, compare, effective_density, recorded, rms_errors
from smoother import api
from smoother.arrays import Array
from smoother.frames import geodetic_to_nwu, nwu_to_geodetic
from smoother.samples import Session
from smoother.sim.simulation import Simulation
from smoother.trajectory import EstimateReport, Trajectory

NED_FROM_NWU = np.diag([1.0, -1.0, -1.0])  # and forward, right, down from forward, left, up
START = 1.0  # s after the first fix: all data are there
START_SIGMA = {"velocity_sd": 0.2, "level_sd": 0.5, "azimuth_sd": 0.5}  # m/s, deg, deg
TIME_STEP = 0.2  # s; the covariance is propagated to every measurement, ten a second, so this is never reached
RUNAWAY = 1e3  # m/s; a filter that is there has diverged, though it may still count
LEFT_OF_BIAS = 0.1  # what the filter thinks of the biases after the true ones of the start were taken off
MIN_BIAS, MIN_MATRIX = 1e-4, 1e-5  # what it takes for a state to be there at all
SIGMAS = ("white", "total", "correlated")  # of a fix: its white noise; with the offset; that, allowing for correlation
COLUMNS = ("velocity", "relative", "position", "roll", "pitch", "yaw")
HEADINGS = (
    "horizontal velocity, m/s",
    "position over 1 s, m",
    "horizontal position, m",
    "roll, deg",
    "pitch, deg",
    "yaw, deg",
)


class HorizontalVelocity(measurements.NedVelocity):  # type: ignore[misc]
    """Speed and course tell of two components; the library's own class wants three."""

    def compute_matrices(self, time: float, pva: Any, error_model: Any) -> Any:
        """Return the library's (z, H, R) without the row of the vertical velocity."""
        found = super().compute_matrices(time, pva, error_model)
        return None if found is None else (found[0].iloc[:2], found[1][:2], found[2][:2, :2])


def fix_sigmas(simulation: Simulation, names: Sequence[str]) -> dict[str, float]:
    """Sigmas (m) of a fix to try, those of SIGMAS that are asked for; one where fixes have no slow offset."""
    errors = simulation.scenario.gnss
    if errors.offset_horizontal == 0.0:
        return {"white": errors.white_horizontal}
    total = _sigma_of_fix(simulation)
    # N correlated fixes are worth N / (2 tau rate) independent ones
    correlated = total * float(np.sqrt(2.0 * errors.offset_tau * errors.rate))
    return {k: v for k, v in zip(SIGMAS, (errors.white_horizontal, total, correlated), strict=True) if k in names}


def run_best(simulation: Simulation, session: Session, fix_sigma: float) -> Trajectory | None:
    """Return what the filter makes of `session`; where it diverges, without scale factors; None if it does so again."""
    for with_matrix in (True, False):
        with contextlib.suppress(ValueError, np.linalg.LinAlgError), np.errstate(all="ignore"):
            found = run_filter(simulation, session, fix_sigma, with_matrix=with_matrix)
            if np.abs(found.velocity_n).max() < RUNAWAY:
                return found
    return None


def run_filter(simulation: Simulation, session: Session, fix_sigma: float, *, with_matrix: bool = True) -> Trajectory:
    """Return what the library's feedback filter makes of `session`, antenna and kart like every estimator.

    Raises ValueError or LinAlgError, from the library, when it diverges.
    """
    models = _sensor_models(simulation, with_matrix=with_matrix)
    imu = _imu_table(simulation, session)
    start = float(session.gnss.t[0]) + START
    before = imu[imu.index < start]
    increments = strapdown.compute_increments_from_imu(imu[imu.index >= before.index[-1]], "increment")
    pva = _initial(simulation, session, float(before.index[-1]))
    result = filters.run_feedback_filter(
        pva,
        position_sd=_sigma_of_fix(simulation),
        **START_SIGMA,
        increments=increments,
        gyro_model=models[0],
        accel_model=models[1],
        measurements=_measurements(simulation, session, fix_sigma),
        time_step=TIME_STEP,
    )
    return _trajectory(result.trajectory, simulation, session)


def _sensor_models(simulation: Simulation, *, with_matrix: bool) -> tuple[Any, Any]:
    """Models of gyro and accelerometer with the true sizes of everything; densities with what folds of the engine."""
    errors = simulation.scenario.imu
    assert errors is not None
    density = effective_density(simulation)
    out = []
    for noise, bias, walk, matrix in (
        (density[1], errors.gyro_bias, errors.gyro_bias_walk, errors.gyro_matrix),
        (density[0], errors.accel_bias, errors.accel_bias_walk, errors.accel_matrix),
    ):
        size = max(LEFT_OF_BIAS * float(np.sqrt(np.mean(bias**2))), MIN_BIAS)
        crooked = simulation.scenario.R_bs @ (matrix - np.eye(3)) @ simulation.scenario.R_bs.T
        spread = np.full((3, 3), float(np.sqrt(np.mean(crooked**2))))
        modelled = spread if with_matrix and spread[0, 0] > MIN_MATRIX else None
        out.append(
            inertial_sensor.EstimationModel(bias_sd=size, noise=noise, bias_walk=walk or None, scale_misal_sd=modelled)
        )
    return out[0], out[1]


def _imu_table(simulation: Simulation, session: Session) -> pd.DataFrame:
    """Increments of each sample in forward, right, down, without the biases of the start.

    A sample is the mean over the step that ends at its time.
    """
    assert session.imu is not None
    errors = simulation.scenario.imu
    assert errors is not None
    imu, R = session.imu, NED_FROM_NWU @ simulation.scenario.R_bs
    rate, force = imu.angular_rate_s - errors.gyro_bias, imu.specific_force_s - errors.accel_bias
    step = np.diff(imu.t, prepend=imu.t[0] - float(np.median(np.diff(imu.t))))[:, None]
    values = np.concatenate([rate @ R.T * step, force @ R.T * step], axis=1)
    names = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    return pd.DataFrame(values, index=imu.t, columns=names)


def _initial(simulation: Simulation, session: Session, t: float) -> pd.Series:
    """Velocity and attitude at t as they are, position of the IMU as far off as the first fix that did not jump."""
    truth = simulation.truth.trajectory(np.array([t]), np.zeros(3), session.origin)
    first = np.flatnonzero(~np.any(simulation.gnss.jump_n != 0.0, axis=1))[:1]
    epoch, arm_b = simulation.gnss.position_time[first], simulation.scenario.lever_arm_b
    antenna = simulation.truth.trajectory(epoch, arm_b, session.origin)
    error_n = session.fix_position_n[first] - antenna.position_n
    lla = np.stack(nwu_to_geodetic(truth.position_n + error_n, session.origin), axis=1)[0]
    velocity = NED_FROM_NWU @ truth.velocity_n[0]
    angles = transform.mat_to_rph(NED_FROM_NWU @ truth.R_nb[0] @ NED_FROM_NWU)
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    return pd.Series(np.concatenate([lla, velocity, angles]), index=names, name=t)


def _sigma_of_fix(simulation: Simulation) -> float:
    """Sigma of a fix with its slow offset, m per horizontal axis."""
    errors = simulation.scenario.gnss
    return float(np.hypot(errors.white_horizontal, errors.offset_horizontal))


def _measurements(simulation: Simulation, session: Session, fix_sigma: float) -> list[Any]:
    """Fixes and Doppler at the times at which they were true, without those that jumped."""
    errors, gnss = simulation.scenario.gnss, session.gnss
    good = ~np.any(simulation.gnss.jump_n != 0.0, axis=1)
    arm = NED_FROM_NWU @ simulation.scenario.lever_arm_b
    fixes = pd.DataFrame(
        np.stack([gnss.lat_deg, gnss.lon_deg, gnss.alt_m], axis=1)[good],
        index=gnss.t[good] - errors.position_latency,
        columns=["lat", "lon", "alt"],
    )
    out: list[Any] = [measurements.Position(fixes, fix_sigma, arm)]
    known = good & np.isfinite(gnss.velocity_n[:, :2]).all(axis=1)
    if np.any(known):
        t = gnss.t[known] - errors.velocity_latency
        velocity = (np.nan_to_num(gnss.velocity_n[known]) - _swing_n(simulation, t)) @ NED_FROM_NWU
        table = pd.DataFrame(velocity, index=t, columns=["VN", "VE", "VD"])
        out.append(HorizontalVelocity(table, errors.velocity_sigma))
    return out


def _swing_n(simulation: Simulation, t: Array) -> Array:
    """True velocity (N, 3) m/s of the antenna relative to the IMU.

    Taken off the Doppler, and added to the result: the library would take it from one sample of the gyro, which in a
    kart is mostly vibration.
    """
    states, arm_b = simulation.truth.at(t), simulation.scenario.lever_arm_b
    return np.asarray(np.einsum("nij,nj->ni", states.R_nb, np.cross(states.angular_rate_b, arm_b)))


def _trajectory(table: pd.DataFrame, simulation: Simulation, session: Session) -> Trajectory:
    """The library's trajectory of the IMU as ours of the antenna."""
    t = table.index.to_numpy()
    R_ned = transform.mat_from_rph(table[["roll", "pitch", "heading"]].to_numpy())
    R_nb = NED_FROM_NWU @ R_ned @ NED_FROM_NWU
    lat, lon, alt = (table[name].to_numpy() for name in ("lat", "lon", "alt"))
    position_n = geodetic_to_nwu(lat, lon, alt, session.origin)
    arm_n = R_nb @ simulation.scenario.lever_arm_b
    velocity_n = table[["VN", "VE", "VD"]].to_numpy() @ NED_FROM_NWU + _swing_n(simulation, t)
    unknown = np.full((len(t), 3), np.nan)
    report = EstimateReport(mode="full")
    return Trajectory(t, position_n + arm_n, velocity_n, R_nb, unknown, unknown, report=report)


@dataclass(frozen=True)
class Comparison:
    """Errors on one session by quantity: of the smoother, and of the filter by the name of its fixes' sigma; CPU s."""

    case: Case
    smoother: dict[str, float]
    pyins: dict[str, dict[str, float]]
    seconds: tuple[float, float]

    def best(self, quantity: str) -> float:
        """Least error of the filter in one quantity."""
        return min(errors[quantity] for errors in self.pyins.values())


def run(case: Case, names: Sequence[str] = SIGMAS) -> Comparison:
    """Simulate a session and give it to both."""
    simulation = case.simulate()
    session = recorded(simulation)
    since = time.process_time()
    ours = api.smooth(session)
    between = time.process_time()
    theirs = {name: run_best(simulation, session, sigma) for name, sigma in fix_sigmas(simulation, names).items()}
    seconds = between - since, (time.process_time() - between) / len(theirs)
    errors = partial(_errors, simulation, session)
    return Comparison(case, errors(ours), {name: errors(trajectory) for name, trajectory in theirs.items()}, seconds)


def _errors(simulation: Simulation, session: Session, estimate: Trajectory | None) -> dict[str, float]:
    if estimate is None:
        return dict.fromkeys(COLUMNS, np.inf)
    return rms_errors(simulation, compare(simulation, session, estimate, SCORED_RATE))


def table(batch: Sequence[Comparison]) -> str:
    """Return the errors of the sessions of a preset, pooled (rms), as a Markdown table, one row for each estimator."""
    rows = {"smoother": [c.smoother for c in batch]}
    for name in batch[0].pyins:
        rows[f"pyins, fixes: {name}"] = [c.pyins[name] for c in batch]
    lines = [f"| rms | {' | '.join(HEADINGS)} |", f"|---|{'---:|' * len(HEADINGS)}"]
    for name, errors in rows.items():
        lines.append(f"| {name} | {' | '.join(f'{_rms([e[q] for e in errors]):.3g}' for q in COLUMNS)} |")
    best = {q: [c.best(q) for c in batch] for q in COLUMNS}
    lines.append(f"| **pyins, best of each session** | {' | '.join(f'{_rms(best[q]):.3g}' for q in COLUMNS)} |")
    ratio = [_rms(best[q]) / _rms([c.smoother[q] for c in batch]) for q in COLUMNS]
    lines.append(f"| that over the smoother's | {' | '.join(f'{r:.2f}' for r in ratio)} |")
    wins = [sum(c.smoother[q] < c.best(q) for c in batch) for q in COLUMNS]
    lines.append(f"| sessions in which the smoother is better | {' | '.join(f'{w} of {len(batch)}' for w in wins)} |")
    return "\n".join(lines)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", action="append", choices=("white", "kart", "kart_harsh"), help="default: all three")
    parser.add_argument("--seeds", type=int, default=6, help="sessions of each preset, tracks and starts in turn")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=200.0, help="s")
    parser.add_argument("--fix-sigma", action="append", choices=SIGMAS, help="of the filter's fixes; default: all")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for preset in arguments.preset or ["white", "kart", "kart_harsh"]:
        wanted, batch = cases(preset, seeds, arguments.duration), []
        work = partial(run, names=tuple(arguments.fix_sigma or SIGMAS))
        with ProcessPoolExecutor(arguments.jobs) as pool:
            for comparison in pool.map(work, wanted) if arguments.jobs > 1 else map(work, wanted):
                batch.append(comparison)
                print(
                    f"{comparison.case.name}: {comparison.seconds[0]:.0f} and {comparison.seconds[1]:.0f} s",
                    file=sys.stderr,
                )
        print(
            f"\n## {preset}: {len(batch)} sessions of {arguments.duration:.0f} s, seeds {seeds.start}-{seeds.stop - 1}"
        )
        print(f"\n{table(batch)}", flush=True)


if __name__ == "__main__":
    main()
