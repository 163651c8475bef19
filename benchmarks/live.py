"""Delay, memory and frames of `smooth live` on a pseudo-terminal, and how right its smoother is.

    python benchmarks/live.py                          accuracy: --seeds N --duration S, as fast as it goes
    xvfb-run python benchmarks/live.py --real-time     in the window, as fast as the logger sends (--speed X: faster)
    python benchmarks/live.py --terminal               the same without a display
    ... --stream FILE                                  what a logger sent, as serial.txt of the emulated one
    ... --preset kart_harsh --outage S                 other karts; no fixes for S s until half a second before the end

Accuracy: the error of the attitude over the last ten seconds against the information bound at the end of the session
(the bound of a filter: nothing comes later), and the difference to the batch smoother at the end and over its last
second, divided by sqrt(P_lag - P_batch), for each component.

P_lag - P_batch is what the later data take away, and the variance of the difference, only if both are of one model
(Hausman 1978). The batch smoother identifies its own noise, and the sigma of the fixes' slow offset, nearly all of a
position's, differs by some per cent, which adds to the difference; tests/live/test_lag.py compares with the same noise.
The part of the offset that no data show (unseen_offset) is the same in both positions and left out of both variances.
In a last state both have the same data, and P_lag - P_batch vanishes or is negative by how the two linearise: it counts
as a hundredth of P_lag at least, a tenth of a sigma.
"""

import argparse
import os
import pty
import resource
import subprocess
import sys
import tempfile
import time
import tty
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bound import BoundOptions, information_bound
from live_here import Foreground, LocalNavigator
from smoother import api, so3
from smoother.arrays import Array
from smoother.live.engine import Engine, Snapshot
from smoother.live.lag import LagState
from smoother.live.receiver import Chunk, Receiver
from smoother.live.remote_navigator import RemoteNavigator
from smoother.live.running import Drawn, run
from smoother.live.sources import ReplaySource, SerialSource
from smoother.live.terminal import TerminalView
from smoother.sim.record_log import DRIVE_FILE, write_klg
from smoother.sim.scenario import Interval
from smoother.sim.simulation import Simulation
from smoother.trajectory import Trajectory
from smoother.units import DEG

TICKS = 25.0  # steps a second of stream, in the accuracy runs
LEFT = 0.5  # s of fixes after an outage


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--duration", type=float, default=60.0, help="s of driving")
    parser.add_argument("--preset", default="kart")
    parser.add_argument("--outage", type=float, default=0.0, help="s without fixes, until shortly before the end")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--real-time", action="store_true")
    parser.add_argument("--terminal", action="store_true")
    parser.add_argument("--speed", type=float, default=1.0, help="how many times too fast the sender is")
    parser.add_argument("--stream", type=Path, help="a capture to send instead of a simulated drive")
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
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    scores = [_score(_drive(options.preset, seed, options.duration, options.outage)) for seed in seeds]
    error, bound, sigma = (np.array([getattr(score, name) for score in scores]) for name in ("error", "bound", "sigma"))
    for name, values in (("error", error), ("bound", bound), ("sigma", sigma)):
        print(f"{name}, deg rms of {options.seeds} seeds: ", np.round(np.sqrt(np.mean(values**2, axis=0)), 2))
    print("error / bound:", round(float(np.sqrt(np.mean(error**2) / np.mean(bound**2))), 2))
    print("largest error of a seed, deg:", round(float(error.max()), 2))
    for which, rows in (("last state", slice(-1, None)), ("last second", slice(None))):
        apart = np.concatenate([score.apart[rows] for score in scores])
        print(f"lag - batch over sqrt(P_lag - P_batch), {which}: {len(apart)} states")
        for name, columns in (("attitude", slice(0, 3)), ("velocity", slice(3, 6)), ("position", slice(6, 9))):
            z = apart[:, columns]
            rms, worst, within = np.sqrt(np.mean(z**2, axis=0)), z.max(axis=0), np.mean(z <= 3.0, axis=0)
            print(f"  {name}: rms {np.round(rms, 2)} worst {np.round(worst, 1)} within 3: {np.round(within, 3)}")


def _drive(preset: str, seed: int, duration: float, outage: float) -> Simulation:
    """Return a drive, at the end of which no fixes come for `outage` s."""
    usual = api.simulate(preset, seed, duration=duration)
    if outage == 0.0:
        return usual
    last = Interval(duration - LEFT - outage, outage)
    before = tuple(o for o in usual.scenario.gnss.outages if o.start + o.duration < last.start)
    return api.simulate(preset, seed, duration=duration, gnss_outages=(*before, last))


@dataclass(frozen=True, eq=False)
class Score:
    """Of one session: error, bound and sigma (3,) deg of roll, pitch, yaw; differences (N, 9) to the batch smoother."""

    error: Array
    bound: Array
    sigma: Array
    apart: Array


def _score(simulation: Simulation) -> Score:
    aboard = LocalNavigator(Foreground())
    states = [s.lag for s in stream_through(stream_of(simulation), aboard) if s.lag is not None]
    if not states:
        raise SystemExit(f"{simulation.raw.name}: the smoother never began; a longer --duration is needed")
    end = states[-1].t
    last = [s for s in states if s.t > end - 10.0]
    truth = simulation.truth.at(np.array([s.t for s in last]))
    error = so3.log(np.swapaxes(truth.R_nb, 1, 2) @ np.array([s.R_nb for s in last]))
    bound = information_bound(simulation, BoundOptions(imu_matrix=True)).attitude[-1]
    session = api.prepared(simulation.raw)
    assert session.imu is not None
    batch = api.smooth(session)
    row = np.sqrt(np.mean(error**2, axis=0)) / DEG
    end, imu_end = batch.t[-1], session.imu.t[-1]
    apart = np.array([apart_from(batch, s, imu_end) for s in last if end - 1.0 < s.t <= end])
    print(
        f"{simulation.raw.name}: error {np.round(row, 2)} bound {np.round(bound / DEG, 2)} deg; "
        f"apart {apart[-1].max():.1f} ({apart.max():.1f})",
        flush=True,
    )
    return Score(row, bound / DEG, last[-1].attitude_sigma / DEG, apart)


def apart_from(batch: Trajectory, s: LagState, samples_end: float) -> Array:
    """Normalised differences (9,) of attitude (axes of b), velocity and position to the batch at the same time.

    The batch's covariance lies on the line through those of two keyframes before the samples end.
    """
    k = int(np.clip(np.searchsorted(batch.t, s.t), 1, len(batch.t) - 1))
    share = (s.t - batch.t[k - 1]) / (batch.t[k] - batch.t[k - 1])
    velocity_n = (1.0 - share) * batch.velocity_n[k - 1] + share * batch.velocity_n[k]
    position_n = (1.0 - share) * batch.position_n[k - 1] + share * batch.position_n[k]
    R_nb = batch.R_nb[k - 1] @ so3.exp(share * so3.log(batch.R_nb[k - 1].T @ batch.R_nb[k]))
    keyframes = batch.report.keyframes
    assert keyframes is not None
    j = int(np.clip(np.searchsorted(keyframes.t, s.t), 1, np.searchsorted(keyframes.t, samples_end) - 1))
    share = (s.t - keyframes.t[j - 1]) / (keyframes.t[j] - keyframes.t[j - 1])
    P = (1.0 - share) * keyframes.covariance[j - 1] + share * keyframes.covariance[j]
    assert keyframes.unseen_offset is not None
    shown = np.diag(P)[6:] - keyframes.unseen_offset
    batchs = np.concatenate([np.diag(R_nb.T @ P[:3, :3] @ R_nb), np.diag(P)[3:6], shown])
    own = np.concatenate([s.attitude_sigma**2, s.velocity_sigma**2, s.position_sigma**2 - s.unseen_offset])
    difference = np.concatenate([so3.log(R_nb.T @ s.R_nb), s.velocity_n - velocity_n, s.position_n - position_n])
    return np.asarray(np.abs(difference) / np.sqrt(np.maximum(own - batchs, 0.01 * own)))


def stream_of(simulation: Simulation) -> bytes:
    """Return what the logger sends while it records `simulation`."""
    with tempfile.TemporaryDirectory() as folder:
        write_klg(simulation, Path(folder))
        source = ReplaySource(Path(folder) / DRIVE_FILE, float("inf"))
        source.open()
        return b"".join(iter(source.read, None))


def stream_through(stream: bytes, aboard: LocalNavigator) -> list[Snapshot]:
    """Return all snapshots of a stream that is taken in small pieces."""
    engine = Engine(aboard)
    size = max(1, round(4500 / TICKS))  # bytes a second of the usual stream
    return [engine.step([Chunk(1.0, stream[at : at + size])])[0] for at in range(0, len(stream), size)]


# ---- real time -------------------------------------------------------------------------------------------------------


def real_time(options: argparse.Namespace) -> None:
    """Show a drive from a pseudo-terminal and print delay, memory and frames."""
    path = Path(os.environ.get("TMPDIR", "/tmp")) / f"live-{os.getpid()}.frames"
    if options.stream:
        path.write_bytes(options.stream.read_bytes())
    else:
        path.write_bytes(stream_of(api.simulate(options.preset, 1, duration=options.duration)))
    command = [sys.executable, __file__, "--feed", str(path), "--speed", str(options.speed)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as feeder:
        assert feeder.stdout is not None
        try:
            _show(feeder.stdout.readline().strip(), options)
        finally:
            feeder.terminate()
    path.unlink()


def _show(port: str, options: argparse.Namespace) -> None:
    drawn: list[Drawn] = []
    memory: list[tuple[float, float, float]] = []
    began, cpu = time.monotonic(), time.process_time()

    def watch(newest: Drawn) -> None:
        drawn.append(newest)
        memory.append((time.monotonic() - began, _resident(os.getpid()), _resident(navigating.process_id)))

    stop = time.monotonic() + options.duration / options.speed - 0.5
    view = _view(options.terminal, port)
    with RemoteNavigator() as navigating, Receiver(SerialSource(port)) as receiver, view as shown:
        last = run(receiver, Engine(navigating), shown, None, lambda: time.monotonic() > stop, watch)
        link = receiver.status
    _print(drawn, memory, time.monotonic() - began, time.process_time() - cpu)
    print("ended in stage:", last.stage, "at", round(last.t, 1), "s; lost:", last.losses, link.dropped_bytes, "bytes")


def _print(drawn: list[Drawn], memory: list[tuple[float, float, float]], seconds: float, cpu: float) -> None:
    cost = np.array([d.cost for d in drawn]) * 1e3
    print(f"{len(drawn) / seconds:.1f} frames a second; drawing {np.median(cost):.1f} ms, worst {cost.max():.0f} ms")
    smoothed = [d.smoother_delay for d in drawn if np.isfinite(d.smoother_delay)]
    for name, values in (("delay", [d.delay for d in drawn]), ("delay of the smoother", smoothed)):
        if values:
            ms = np.array(values) * 1e3
            print(f"{name} median {np.median(ms):.0f} ms, 99 % {np.percentile(ms, 99):.0f}, worst {ms.max():.0f} ms")
    print(f"{cpu / seconds:.0%} of a core, {_of_children() / seconds:.0%} in the processes beside")
    late = [row for row in memory if row[0] > 0.5 * seconds]
    for i, name in ((1, "here"), (2, "in the smoother's process")):
        print(
            f"memory {name} {memory[0][i]:.0f} MB at the start, {late[0][i]:.0f} half way, {late[-1][i]:.0f} at the end"
        )
    print(f"largest {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def _of_children() -> float:
    """Processor time, s, of processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _resident(process: int) -> float:
    """Memory of a process now, MB."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


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
