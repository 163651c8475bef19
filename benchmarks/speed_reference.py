"""Speed and memory: the smoother against one Levenberg-Marquardt solve of a reference graph; `speed.py` runs it.

The reference graph has the same keyframes (one to a fix) and wrapped C++ factors only: CombinedImuFactor, GPSFactorArm
and PriorFactorVector for the Doppler velocity, with true noise, arm and latency, built beforehand from a guess by fixes
and course. `estimate` is api.smooth alone; `smooth` is the whole command in a process of its own,
`--no-baseline --no-figures`, from the start of the interpreter to its end. Everything is run in turns, reference,
estimate and command one after the other, and at 1 kHz and of an hour the ten minutes at 200 Hz beside them; the ratio
is the middle one of those of each turn, since machines change their pace from one minute to the next. Seconds are the
best of all turns. CPU seconds stand in brackets: on a busy machine they are the better figure. Below stand the seconds
of each stage of the estimate, then of the command; what a stage of the command imports counts for it, and `start` is
what comes before the first.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from cost import Cost, cost_of, least
from smoother import api
from smoother.arrays import Array
from smoother.frames import rotation_from_euler
from smoother.samples import ImuSamples, Session
from smoother.sim.simulation import Simulation
from smoother.units import STANDARD_GRAVITY

HOUR_TURNS = 3
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
    """One session, turn by turn: estimation alone and the whole command; its peak memory, GB; the stages of both, s."""

    estimates: list[Cost]
    commands: list[Cost]
    memory: float
    stages: dict[str, float]
    command_stages: dict[str, float]

    @property
    def estimate(self) -> Cost:
        """The least of all turns."""
        return least(self.estimates)

    @property
    def command(self) -> Cost:
        """The least of all turns."""
        return least(self.commands)


def run(session: Session, directory: Path, turns: int, before: Callable[[], object] | None = None) -> Run:
    """Smooth what was written into `directory` in this process and by the command; `before` is called in each turn."""
    stages: dict[str, float] = {}

    def estimate() -> None:
        stages.update(api.smooth(session).report.timings)

    estimates, commands, memory = [], [], 0.0
    for _ in range(turns):
        if before is not None:
            before()
        estimates.append(cost_of(estimate))
        command, peak = _command(directory)
        commands.append(command)
        memory = max(memory, peak)
    return Run(estimates, commands, memory, stages, _command_stages(directory, commands[-1]))


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


def ratios(ones: list[Cost], others: list[Cost], part: str) -> list[float]:
    """Ratios of the costs of each turn, of `wall` or `cpu` seconds."""
    return [getattr(one, part) / getattr(other, part) for one, other in zip(ones, others, strict=True)]


def turns_verdict(text: str, of_turns: list[float], limit: float) -> None:
    """Print the middle one of the ratios beside its limit, and between which they all are."""
    text = f"{text}, middle of {len(of_turns)} turns from {min(of_turns):.2f} to {max(of_turns):.2f}"
    verdict(text, float(np.median(of_turns)), limit)


def smoothed(minutes: float, rate: float, seed: int, turns: int, before: Callable[[], object] | None = None) -> Run:
    """Simulate, run, show; `before` is called in each turn."""
    simulation = api.simulate("kart", seed, duration=60.0 * minutes, imu_rate=rate)
    with tempfile.TemporaryDirectory() as directory:
        api.write_session(simulation, Path(directory))
        result = run(api.read(Path(directory)), Path(directory), turns, before)
    show(f"{minutes:g} min, {rate:g} Hz", result)
    return result


def measure(minutes: list[float], turns: int, seed: int, quick: bool) -> None:
    """Ten minutes at 200 Hz; unless quick also at 1 kHz, an hour, and sessions of further lengths."""
    ten, references, session = beside_reference(seed, turns)
    for part, name in (("wall", "wall"), ("cpu", "CPU")):
        turns_verdict(f"estimate / reference solve, {name}", ratios(ten.estimates, references, part), TIMES_REFERENCE)
    turns_verdict("whole command / reference solve, CPU", ratios(ten.commands, references, "cpu"), TIMES_COMMAND)
    if quick:
        return
    beside: list[Cost] = []
    again = partial(api.smooth, session)
    kilohertz = smoothed(10.0, 1000.0, seed, turns, lambda: beside.append(cost_of(again)))
    turns_verdict("1 kHz / 200 Hz, estimate, CPU", ratios(kilohertz.estimates, beside, "cpu"), TIMES_KILOHERTZ)
    beside.clear()
    hour = smoothed(60.0, 200.0, seed, HOUR_TURNS, lambda: beside.append(cost_of(again)))
    turns_verdict("60 min / 10 min, estimate, CPU", ratios(hour.estimates, beside, "cpu"), TIMES_HOUR)
    verdict("60 min, memory of the whole command, GB", hour.memory, MEMORY_HOUR)
    for length in minutes:
        smoothed(length, 200.0, seed, 1)


def beside_reference(seed: int, turns: int) -> tuple[Run, list[Cost], Session]:
    """Ten minutes at 200 Hz, and in each turn one solve of the reference graph; both are shown. The session, too."""
    simulation = api.simulate("kart", seed, duration=600.0)
    optimizers: list[gtsam.LevenbergMarquardtOptimizer] = []
    references: list[Cost] = []

    def solve() -> None:
        optimizers[:] = [gtsam.LevenbergMarquardtOptimizer(graph, values)]
        optimizers[0].optimize()

    with tempfile.TemporaryDirectory() as directory:
        api.write_session(simulation, Path(directory))
        session = api.read(Path(directory))
        graph, values = reference_graph(simulation, session)
        ten = run(session, Path(directory), turns, lambda: references.append(cost_of(solve)))
    show("10 min, 200 Hz", ten)
    last = optimizers[0]
    print(
        f"{'reference graph':<22} solve    {least(references)}   {last.iterations()} iterations, "
        f"error {graph.error(values):.3g} -> {last.error():.3g} of {graph.size()} factors",
        flush=True,
    )
    return ten, references, session
