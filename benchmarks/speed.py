"""Speed and memory: the smoother against one Levenberg-Marquardt solve of a reference graph.

    python benchmarks/speed.py                 10 minutes at 200 Hz and at 1 kHz, 60 minutes
    python benchmarks/speed.py --quick         10 minutes at 200 Hz only
    python benchmarks/speed.py --minutes 240   one more length

The reference graph has the same keyframes (one to a fix) and wrapped C++ factors only: CombinedImuFactor, GPSFactorArm
and PriorFactorVector for the Doppler velocity, with true noise, arm and latency, built beforehand from a guess by fixes
and course. `estimate` is GraphSmoother.estimate alone; `smooth` is the whole command in a process of its own,
`--no-baseline --no-figures`, from the start of the interpreter to its end; each the best of several runs. CPU seconds
stand in brackets: on a busy machine they are the better figure. Below stand the seconds of each stage of the estimate,
then of the command; what a stage of the command imports counts for it, and `start` is what comes before the first.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from cost import Cost, best_of
from smoother.arrays import Array
from smoother.estimate.graph.smoother import GraphSmoother
from smoother.frames import rotation_from_euler
from smoother.prepare import prepare
from smoother.samples import ImuSamples, Session
from smoother.session.load import load_raw
from smoother.sim.record import write_csv
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.units import STANDARD_GRAVITY

TIMES_REFERENCE, TIMES_COMMAND, TIMES_KILOHERTZ, TIMES_HOUR, MEMORY_HOUR = 4.0, 3.0, 1.3, 7.0, 1.0  # promised; GB


def reference_graph(simulation: Simulation, session: Session) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the reference graph and its first guess."""
    errors, scenario = simulation.scenario.gnss, simulation.scenario
    assert session.imu is not None and scenario.imu is not None
    fixes, truth_n = session.gnss, session.fix_position_n
    t = fixes.t - errors.position_latency
    rate = 1.0 / errors.rate
    t_all = np.arange(t[0], t[-1] + 0.5 * rate, rate)  # outages have keyframes too
    at_fix = np.clip(np.round((t - t_all[0]) / rate).astype(int), 0, len(t_all) - 1)
    velocity = np.where(np.isfinite(fixes.velocity_n), fixes.velocity_n, 0.0)
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > 1.0
    yaw = np.unwrap(np.arctan2(velocity[moving, 1], velocity[moving, 0]))
    guess_yaw = np.interp(t_all, t[moving], yaw)
    R_ns = rotation_from_euler(0.0 * guess_yaw, 0.0 * guess_yaw, guess_yaw) @ scenario.R_bs
    position = np.stack([np.interp(t_all, t, truth_n[:, i]) for i in range(3)], axis=1)
    guess_velocity = np.stack([np.interp(t_all, t, velocity[:, i]) for i in range(3)], axis=1)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    bias = gtsam.imuBias.ConstantBias()  # nothing is known of it
    for k in range(len(t_all)):
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(R_ns[k]), position[k]))
        values.insert(V(k), guess_velocity[k])
        values.insert(B(k), bias)
    graph.add(gtsam.PriorFactorPose3(X(0), values.atPose3(X(0)), _sigmas([1.0] * 3 + [10.0] * 3)))
    graph.add(gtsam.PriorFactorConstantBias(B(0), bias, _sigmas([0.3] * 3 + [0.1] * 3)))
    for k, preintegrated in enumerate(_preintegrated(simulation, session.imu, t_all, bias)):
        graph.add(gtsam.CombinedImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), preintegrated))
    horizontal, up = (
        np.hypot(errors.white_horizontal, errors.offset_horizontal),
        np.hypot(errors.white_up, errors.offset_up),
    )
    of_position = _sigmas([horizontal, horizontal, up])
    of_velocity = _sigmas([errors.velocity_sigma] * 2 + [10.0])
    arm_s = scenario.R_bs.T @ scenario.lever_arm_b
    for i, k in enumerate(at_fix.tolist()):
        graph.add(gtsam.GPSFactorArm(X(k), truth_n[i], arm_s, of_position))
        graph.add(gtsam.PriorFactorVector(V(k), velocity[i], of_velocity))
    return graph, values


def _sigmas(values: list[float]) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.array(values, dtype=np.float64))


def _preintegrated(
    simulation: Simulation, imu: ImuSamples, t: Array, bias: gtsam.imuBias.ConstantBias
) -> list[gtsam.PreintegratedCombinedMeasurements]:
    errors = simulation.scenario.imu
    assert errors is not None
    params, eye = gtsam.PreintegrationCombinedParams.MakeSharedU(STANDARD_GRAVITY), np.eye(3)
    params.setAccelerometerCovariance(eye * errors.accel_noise**2)
    params.setGyroscopeCovariance(eye * errors.gyro_noise**2)
    params.setIntegrationCovariance(eye * 1e-8)
    params.setBiasAccCovariance(eye * errors.accel_bias_walk**2)
    params.setBiasOmegaCovariance(eye * errors.gyro_bias_walk**2)
    edges = np.searchsorted(imu.t, t)
    out = []
    for first, last, start, end in zip(edges[:-1], edges[1:], t[:-1], t[1:], strict=True):
        measured = gtsam.PreintegratedCombinedMeasurements(params, bias)
        samples = range(first, last) if last > first else range(max(first - 1, 0), max(first, 1))
        dt = (end - start) / len(samples)
        for i in samples:
            measured.integrateMeasurement(imu.specific_force_s[i], imu.angular_rate_s[i], dt)
        out.append(measured)
    return out


@dataclass(frozen=True)
class Run:
    """One session: estimation alone, the whole command with its peak memory (GB), and the stages of both, s."""

    estimate: Cost
    command: Cost
    memory: float
    stages: dict[str, float]
    command_stages: dict[str, float]


def run(simulation: Simulation, directory: Path, repeats: int) -> tuple[Run, Session]:
    """Write the session, smooth it in this process and by the command."""
    write_csv(simulation, directory)
    session = prepare(load_raw(directory))
    stages: dict[str, float] = {}

    def estimate() -> None:
        stages.update(GraphSmoother().estimate(session).report.timings)

    cost = best_of(repeats, estimate)
    commands, memory = zip(*(_command(directory) for _ in range(repeats)), strict=True)
    command = Cost(min(each.wall for each in commands), min(each.cpu for each in commands))
    return Run(cost, command, max(memory), stages, _command_stages(directory, commands[-1])), session


def _command_stages(directory: Path, command: Cost) -> dict[str, float]:
    timings = json.loads((directory / "smoothed" / "summary.json").read_text(encoding="utf-8"))["timings"]
    parts = {name: float(seconds) for name, seconds in timings.items() if not name.startswith("smoothing_")}
    return {"start": command.wall - sum(parts.values()), **parts}


def _command(directory: Path) -> tuple[Cost, float]:
    """Cost of `smooth DIRECTORY --no-baseline --no-figures` in a process of its own, and its peak memory in GB."""
    code = "import sys; from smoother.cli import main; sys.exit(main())"
    arguments = [sys.executable, "-c", code, str(directory), "--no-baseline", "--no-figures"]
    # modules are compiled once after an installation, not at every start
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    since = time.perf_counter()
    child = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, env=environment)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 3):  # 3: done, but its own quality gate was not met
        raise RuntimeError(f"smooth ended with exit code {child.returncode}")
    unit = 1e9 if sys.platform == "darwin" else 1e6  # bytes there, kilobytes here
    return Cost(time.perf_counter() - since, usage.ru_utime + usage.ru_stime), usage.ru_maxrss / unit


def show(name: str, result: Run) -> None:
    """Print one line, and the stages under it."""
    print(f"{name:<22} estimate {result.estimate}   smooth {result.command}, {result.memory:.2f} GB", flush=True)
    for what, stages in (("estimate", result.stages), ("smooth", result.command_stages)):
        print(f"{'':<22} {what}: {', '.join(f'{stage} {seconds:.2f}' for stage, seconds in stages.items())}")


def verdict(text: str, value: float, limit: float) -> None:
    """Print a ratio beside its limit."""
    print(f"{'ok  ' if value <= limit else 'MISS'} {text}: {value:.2f} (limit {limit:g})", flush=True)


def smoothed(minutes: float, rate: float, seed: int, repeats: int) -> tuple[Run, Simulation, Session]:
    """Simulate, run, show."""
    simulation = simulate_preset("kart", seed, duration=60.0 * minutes, imu_rate=rate)
    with tempfile.TemporaryDirectory() as directory:
        result, session = run(simulation, Path(directory), repeats)
    show(f"{minutes:g} min, {rate:g} Hz", result)
    return result, simulation, session


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="10 minutes at 200 Hz only")
    parser.add_argument("--minutes", type=float, action="append", default=[], help="a further session of this length")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    ten, simulation, session = smoothed(10.0, 200.0, arguments.seed, arguments.repeats)
    reference = measure_reference(simulation, session, arguments.repeats)
    verdict("estimate / reference solve, wall", ten.estimate.wall / reference.wall, TIMES_REFERENCE)
    verdict("estimate / reference solve, CPU", ten.estimate.cpu / reference.cpu, TIMES_REFERENCE)
    verdict("whole command / reference solve, CPU", ten.command.cpu / reference.cpu, TIMES_COMMAND)
    if arguments.quick:
        return
    kilohertz, _, _ = smoothed(10.0, 1000.0, arguments.seed, arguments.repeats)
    verdict("1 kHz / 200 Hz, estimate, CPU", kilohertz.estimate.cpu / ten.estimate.cpu, TIMES_KILOHERTZ)
    hour, _, _ = smoothed(60.0, 200.0, arguments.seed, 1)
    verdict("60 min / 10 min, estimate, CPU", hour.estimate.cpu / ten.estimate.cpu, TIMES_HOUR)
    verdict("60 min, memory of the whole command, GB", hour.memory, MEMORY_HOUR)
    for minutes in arguments.minutes:
        smoothed(minutes, 200.0, arguments.seed, 1)


def measure_reference(simulation: Simulation, session: Session, repeats: int) -> Cost:
    """Return the cost of one solve of the reference graph, which is shown with its iterations."""
    graph, values = reference_graph(simulation, session)
    optimizers: list[gtsam.LevenbergMarquardtOptimizer] = []

    def solve() -> None:
        optimizers.append(gtsam.LevenbergMarquardtOptimizer(graph, values))
        optimizers[-1].optimize()

    cost = best_of(repeats, solve)
    last = optimizers[-1]
    print(
        f"{'reference graph':<22} solve    {cost}   {last.iterations()} iterations, "
        f"error {graph.error(values):.3g} -> {last.error():.3g} of {graph.size()} factors",
        flush=True,
    )
    return cost


if __name__ == "__main__":
    main()
