"""Delay, memory and frames of `smooth live` on a pseudo-terminal, and how right its smoother is.

    python benchmarks/live.py                          accuracy: --seeds N --duration S, as fast as it goes
    xvfb-run python benchmarks/live.py --real-time     in the window, as fast as the logger sends (--speed X: faster)
    python benchmarks/live.py --terminal               the same without a display

Accuracy: the error of the attitude over the last ten seconds against the information bound at the end of the session
(the bound of a filter: nothing comes later), and the difference to the batch smoother over its last second, divided by
sqrt(P_lag - P_batch), which is held at a tenth of P_lag where the batch knows as little: at the very end.
"""

import argparse
import os
import pty
import resource
import subprocess
import sys
import time
import tty
from pathlib import Path

import numpy as np

from smoother import so3
from smoother.estimate.bound import BoundOptions, information_bound
from smoother.estimate.graph.smoother import GraphSmoother
from smoother.live.beside import Beside
from smoother.live.engine import Engine, Snapshot
from smoother.live.identify import Foreground
from smoother.live.navigator import Aboard
from smoother.live.receiver import Chunk, Receiver
from smoother.live.running import Drawn, run
from smoother.live.sources import ReplaySource, SerialSource
from smoother.live.terminal import TerminalView
from smoother.prepare import prepare
from smoother.session.log_frames import encode_frames
from smoother.sim.record_log import drive_records
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.units import DEG

TICKS = 25.0  # steps a second of stream, in the accuracy runs


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--duration", type=float, default=60.0, help="s of driving")
    parser.add_argument("--preset", default="kart")
    parser.add_argument("--real-time", action="store_true")
    parser.add_argument("--terminal", action="store_true")
    parser.add_argument("--speed", type=float, default=1.0, help="how many times too fast the sender is")
    parser.add_argument("--feed", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.feed:
        feed(options.feed, options.speed)
    elif options.real_time or options.terminal:
        real_time(options)
    else:
        accuracy(options)


# ---- accuracy --------------------------------------------------------------------------------------------------------


def accuracy(options: argparse.Namespace) -> None:
    """Print errors, bounds and differences of every seed, and their rms."""
    rows = [_score(simulate_preset(options.preset, s, duration=options.duration)) for s in range(1, options.seeds + 1)]
    error, bound, sigma, attitude, velocity = (np.array(column) for column in zip(*rows, strict=True))
    for name, values in (("error", error), ("bound", bound), ("sigma", sigma)):
        print(f"{name}, deg rms of {options.seeds} seeds: ", np.round(np.sqrt(np.mean(values**2, axis=0)), 2))
    print("error / bound:", round(float(np.sqrt(np.mean(error**2) / np.mean(bound**2))), 2))
    print("largest error of a seed, deg:", round(float(error.max()), 2))
    for name, values in (("attitude", attitude), ("velocity", velocity)):
        within = float(np.mean(values <= 3.0))
        print(f"stream - batch, {name}: {within:.1%} within 3 sqrt(P_lag - P_batch), worst {values.max():.1f}")


def _score(simulation: Simulation) -> tuple[np.ndarray, ...]:
    states = [s.lag for s in stream_through(encode_frames(drive_records(simulation))) if s.lag is not None]
    end = states[-1].t
    last = [s for s in states if s.t > end - 10.0]
    truth = simulation.truth.at(np.array([s.t for s in last]))
    error = so3.log(np.swapaxes(truth.R_nb, 1, 2) @ np.array([s.R_nb for s in last]))
    bound = information_bound(simulation, BoundOptions(imu_matrix=True)).attitude[-1]
    batch = GraphSmoother().estimate(prepare(simulation.raw))
    attitude, velocity = _apart(last, batch)
    row = np.sqrt(np.mean(error**2, axis=0)) / DEG
    print(f"{simulation.raw.name}: error {np.round(row, 2)} bound {np.round(bound / DEG, 2)} deg", flush=True)
    return row, bound / DEG, last[-1].attitude_sigma / DEG, attitude, velocity


def _apart(states: list, batch) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def, type-arg]
    """Largest normalised differences (3,) over the batch's last second of attitude (axes of b) and velocity."""
    keyframes = batch.report.keyframes
    rows_attitude, rows_velocity = [np.zeros(3)], [np.zeros(3)]
    for s in states:
        k = int(np.argmin(np.abs(batch.t - s.t)))
        if abs(batch.t[k] - s.t) > 0.011 or s.t < batch.t[-1] - 1.0:
            continue
        j = int(np.argmin(np.abs(keyframes.t - s.t)))
        R = keyframes.R_nb[j]
        own = np.diag(R.T @ keyframes.covariance[j, :3, :3] @ R)
        more = np.maximum(s.attitude_sigma**2 - own, 0.1 * s.attitude_sigma**2)
        rows_attitude.append(np.abs(so3.log(batch.R_nb[k].T @ s.R_nb)) / np.sqrt(more))
        faster = np.maximum(s.velocity_sigma**2 - batch.sigmas.velocity_n[k] ** 2, 0.1 * s.velocity_sigma**2)
        rows_velocity.append(np.abs(batch.velocity_n[k] - s.velocity_n) / np.sqrt(faster))
    return np.max(rows_attitude, axis=0), np.max(rows_velocity, axis=0)


def stream_through(stream: bytes) -> list[Snapshot]:
    """Return all snapshots of a stream that is taken in small pieces."""
    engine = Engine(Aboard(Foreground()))
    size = max(1, round(4500 / TICKS))  # bytes a second of the usual stream
    return [engine.step([Chunk(1.0, stream[at : at + size])])[0] for at in range(0, len(stream), size)]


# ---- real time -------------------------------------------------------------------------------------------------------


def real_time(options: argparse.Namespace) -> None:
    """Show a drive from a pseudo-terminal and print delay, memory and frames."""
    path = Path(os.environ.get("TMPDIR", "/tmp")) / f"live-{os.getpid()}.frames"
    path.write_bytes(encode_frames(drive_records(simulate_preset(options.preset, 1, duration=options.duration))))
    command = [sys.executable, __file__, "--feed", str(path), "--speed", str(options.speed)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as feeder:
        assert feeder.stdout is not None
        try:
            _show(feeder.stdout.readline().strip(), options)
        finally:
            feeder.terminate()
    path.unlink()


def _show(port: str, options: argparse.Namespace) -> None:
    frames: list[Drawn] = []
    memory: list[tuple[float, float]] = []
    began, cpu = time.monotonic(), time.process_time()

    def watch(frame: Drawn) -> None:
        frames.append(frame)
        memory.append((time.monotonic() - began, _resident()))

    stop = time.monotonic() + options.duration / options.speed - 0.5
    view = _view(options.terminal, port)
    with Beside() as navigating, Receiver(SerialSource(port)) as receiver, view as shown:
        last = run(receiver, Engine(navigating), shown, None, lambda: time.monotonic() > stop, watch)
        link = receiver.status
    _print(frames, memory, time.monotonic() - began, time.process_time() - cpu)
    print("ended in stage:", last.stage, "at", round(last.t, 1), "s; lost:", last.losses, link.dropped_bytes, "bytes")


def _print(frames: list[Drawn], memory: list[tuple[float, float]], seconds: float, cpu: float) -> None:
    delay, cost = np.array([f.delay for f in frames]) * 1e3, np.array([f.cost for f in frames]) * 1e3
    print(f"{len(frames) / seconds:.1f} frames a second; drawing {np.median(cost):.1f} ms, worst {cost.max():.0f} ms")
    print(f"delay median {np.median(delay):.0f} ms, 99 % {np.percentile(delay, 99):.0f} ms, worst {delay.max():.0f} ms")
    print(f"{cpu / seconds:.0%} of a core")
    half = [mb for t, mb in memory if t > 0.5 * seconds]
    print(f"memory {memory[0][1]:.0f} MB at the start, {half[0]:.0f} half way, {half[-1]:.0f} MB at the end")
    print(f"largest {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def _resident() -> float:
    """Memory of this process now, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def _view(is_terminal: bool, name: str):  # type: ignore[no-untyped-def]
    if is_terminal:
        return TerminalView(name)
    from smoother.live.window import WindowView

    return WindowView(name)


def feed(path: Path, speed: float) -> None:
    """Be the logger: write a stream to a pseudo-terminal when it is due."""
    controller, terminal = pty.openpty()
    tty.setraw(terminal)
    print(os.ttyname(terminal), flush=True)
    source = ReplaySource(path, speed)
    source.open()
    while (piece := source.read()) is not None:
        while piece:
            piece = piece[os.write(controller, piece) :]


if __name__ == "__main__":
    main()
