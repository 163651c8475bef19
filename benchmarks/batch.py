"""Many sessions: how the time falls with workers, what a session costs, and what finding and listing them costs.

    python benchmarks/batch.py                         8 sessions of 5 minutes; 1 and 2 at a time, and 2 Dask workers
    python benchmarks/batch.py --sessions 16 --minutes 10 --workers 1 2 4
    python benchmarks/batch.py --waiting 4 --sessions 32 --workers 1 2 4 8 16    sessions that only wait, for 4 s each
    python benchmarks/batch.py --parts                 what each part of a session costs, with its memory and disk
    python benchmarks/batch.py --finished 1000         as many finished sessions: found, compared, listed
    python benchmarks/batch.py --tasks 20000           what a Dask scheduler takes for so many tasks that do nothing

The sessions are simulated karts as the logger writes them (200 Hz, 5 Hz, preset kart), smoothed with the defaults of
`smooth batch`. Times are those of the whole command in a process of its own; `load` is what others wanted of the
machine when it began (0 for figures of a quiet machine; beside other programs trust the processor time). With two
workers of Dask these are processes started before, so that only the batch is timed.
"""

import argparse
import gzip
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import polars as pl

from smoother import api
from smoother.batch.local import run_here
from smoother.batch.task import Task
from smoother.sim.record_log import write_klg

COMMAND = (sys.executable, "-P", "-m", "smoother.cli")


@dataclass(frozen=True)
class Run:
    """One batch: s on the clock, s of processor time of the command without its sessions, the load before."""

    name: str
    wall: float
    own_cpu: float
    load: float
    document: dict[str, object]

    def column(self, name: str) -> np.ndarray:
        """A figure of every session."""
        sessions = self.document["sessions"]
        assert isinstance(sessions, list)
        return np.array([session[name] for session in sessions], dtype=np.float64)


def main() -> None:
    """Measure what was asked for and print it as tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--dask", type=int, default=2, help="workers of the Dask cluster; 0: none")
    parser.add_argument("--finished", type=int, default=0, help="measure finding and listing so many sessions instead")
    parser.add_argument("--waiting", type=float, default=0.0, help="let the sessions wait so many s, and do nothing")
    parser.add_argument("--parts", action="store_true", help="measure what each part of a session costs instead")
    parser.add_argument("--tasks", type=int, default=0, help="measure so many empty tasks of a Dask scheduler instead")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name) / "day"
        if given.finished:
            show_finished(directory, given.finished)
        elif given.waiting:
            show_waiting(directory, given.sessions, given.waiting, given.workers)
        elif given.parts:
            show_parts(directory, given.sessions, given.minutes)
        elif given.tasks:
            show_tasks(directory.parent, given.tasks)
        else:
            show_workers(directory, given.sessions, given.minutes, given.workers, given.dask)


def show_workers(directory: Path, sessions: int, minutes: float, workers: Sequence[int], dask: int) -> None:
    """Print the table of workers, and what a session takes."""
    for i in range(sessions):
        write_klg(api.simulate("kart", i, duration=60.0 * minutes), directory / f"kart{i % 4 + 1}" / f"run{i + 1}")
    runs = [batch(f"{n} at a time", directory, "--again", "--jobs", str(n)) for n in workers]
    if dask:
        with cluster(dask, directory.parent) as address:
            runs.append(batch(f"Dask, {dask} workers", directory, "--again", "--scheduler", address))
    print(f"{sessions} sessions of {minutes:g} min")
    print("| run | clock, s | times faster | sessions: processor, s | command itself: processor, s | load |")
    print("|---|---|---|---|---|---|")
    for run in runs:
        faster, cpu = runs[0].wall / run.wall, run.column("cpu_s").sum()
        print(f"| {run.name} | {run.wall:.1f} | {faster:.2f} | {cpu:.1f} | {run.own_cpu:.2f} | {run.load:.1f} |")
    show_cost(directory, runs[0])
    again = batch("again", directory)
    print(f"\nThe same again, all finished: {again.wall:.2f} s on the clock, {again.own_cpu:.2f} s of processor time")


def show_cost(directory: Path, run: Run) -> None:
    """Print what one session takes: time, memory, disk."""
    read = sum(path.stat().st_size for path in directory.rglob("*.KLG"))
    report = sum(path.stat().st_size for path in directory.rglob("report.html"))
    rows = sum(path.stat().st_size for path in directory.rglob("trajectory.csv"))
    written = sum(path.stat().st_size for path in directory.rglob("smoothed/**/*") if path.is_file())
    n = len(run.column("cpu_s"))
    cpu, memory = run.column("cpu_s"), run.column("memory_mb")
    print(f"\nOne session: {cpu.mean():.1f} s of processor time ({cpu.min():.1f} to {cpu.max():.1f}), ", end="")
    print(
        f"{memory.max():.0f} MB of memory at most, {read / n / 1e6:.1f} MB read, {written / n / 1e6:.1f} MB written ",
        end="",
    )
    print(f"(report {report / n / 1e6:.1f}, trajectory {rows / n / 1e6:.1f})")


def show_waiting(directory: Path, sessions: int, seconds: float, workers: Sequence[int]) -> None:
    """Print how the time falls with more workers than this machine has cores: what the batch itself allows."""
    command = ("-S", "-c", f"import time; time.sleep({seconds})")
    tasks = [Task(directory, directory / str(i), (), str(i)) for i in range(sessions)]
    print(f"{sessions} sessions that wait {seconds:g} s; least possible: the rounds times {seconds:g} s")
    print("| at a time | clock, s | least possible, s | processor of the batch, s | load |")
    print("|---|---|---|---|---|")
    for n in workers:
        load, start, cpu = os.getloadavg()[0], time.perf_counter(), time.process_time()
        assert len(list(run_here(tasks, n, command))) == sessions
        wall, cpu = time.perf_counter() - start, time.process_time() - cpu
        print(f"| {n} | {wall:.1f} | {-(-sessions // n) * seconds:.1f} | {cpu:.2f} | {load:.1f} |")


def show_parts(directory: Path, sessions: int, minutes: float) -> None:
    """Print the processor time, memory and disk of a session with ever more of its parts."""
    for i in range(sessions):
        write_klg(api.simulate("kart", i, duration=60.0 * minutes), directory / f"run{i + 1}")
    start = [_start_of_interpreter() for _ in range(5)]
    print(f"{sessions} sessions of {minutes:g} min; the interpreter with its libraries alone: {min(start):.2f} s")
    print("| options | processor, s (least .. most) | memory, MB | written, MB |")
    print("|---|---|---|---|")
    for options in (("--no-baseline", "--no-figures"), ("--no-baseline",), (), ("--pictures",)):
        run = batch("parts", directory, "--again", "--jobs", "1", *options)
        written = sum(path.stat().st_size for path in directory.rglob("smoothed/**/*") if path.is_file()) / sessions
        cpu, memory = run.column("cpu_s"), run.column("memory_mb").max()
        name = f"`{' '.join(options)}`" if options else "none"
        spread = f"{np.median(cpu):.1f} ({cpu.min():.1f} .. {cpu.max():.1f})"
        print(f"| {name} | {spread} | {memory:.0f} | {written / 1e6:.1f} |")
    (rows,) = list(directory.glob("run1/smoothed/trajectory.csv"))
    table = pl.read_csv(rows, infer_schema_length=None)
    table.write_parquet(rows.with_suffix(".parquet"), compression="zstd")
    sizes = [path.stat().st_size / 1e6 for path in (rows, rows.with_suffix(".parquet"))]
    print(f"trajectory.csv {sizes[0]:.1f} MB, as Parquet {sizes[1]:.1f} MB", end="; ")
    (log,) = list(directory.glob("run1/*.KLG"))
    print(f"recording {log.stat().st_size / 1e6:.1f} MB, as .gz {len(gzip.compress(log.read_bytes(), 6)) / 1e6:.1f} MB")


def _start_of_interpreter() -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    imports = "import gtsam, smoother.cli.main, smoother.report.page, smoother.session.load"
    subprocess.run([sys.executable, "-P", "-c", imports], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def show_tasks(directory: Path, count: int) -> None:
    """Print what a scheduler takes for tasks that do nothing: its share of a batch."""
    from distributed import Client

    with cluster(2, directory) as address, Client(address) as client:
        memory = client.run_on_scheduler(_memory)
        start, cpu = time.perf_counter(), client.run_on_scheduler(time.process_time)
        futures = client.map(abs, range(count), pure=False)
        client.gather(futures)
        wall = time.perf_counter() - start
        cpu = client.run_on_scheduler(time.process_time) - cpu
        held = client.run_on_scheduler(_memory) - memory
    each = 1e3 / count
    print(f"{count} empty tasks, 2 workers: {wall * each:.2f} ms each on the clock; of the scheduler")
    print(f"{cpu * each:.2f} ms of processor time and {held / count / 1e3:.1f} kB of memory each")


def _memory() -> int:
    """Bytes that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def show_finished(directory: Path, count: int) -> None:
    """Print what it takes to find, compare and list sessions of which none has changed."""
    first = directory / "kart1" / "run1"
    write_klg(api.simulate("kart", 1, duration=120.0), first)
    batch("first", directory)
    for i in range(1, count):
        kart = directory / f"kart{i % 20 + 1}"
        kart.mkdir(exist_ok=True)
        shutil.copytree(
            first, kart / f"run{i + 1}", copy_function=shutil.copyfile
        )  # other times of change: everything is read and compared
    copied = batch("copied", directory)
    again = batch("again", directory)
    assert all(run.column("kept").all() for run in (copied, again))
    print(f"{count} finished sessions, s on the clock (processor): {copied.wall:.2f} ({copied.own_cpu:.2f}) where they")
    print(
        f"were copied and so are read and compared, {again.wall:.2f} ({again.own_cpu:.2f}) where they were not touched"
    )
    sizes = {path.name: path.stat().st_size / 1e6 for path in sorted(directory.glob("sessions.*"))}
    print(", ".join(f"{name} {size:.2f} MB" for name, size in sizes.items()))


def batch(name: str, directory: Path, *options: str) -> Run:
    """Run `smooth batch` on a directory."""
    load, start = os.getloadavg()[0], time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [*COMMAND, "batch", directory, *options, "--json"], capture_output=True, text=True, check=True
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    document = json.loads(done.stdout)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if "--scheduler" not in options:  # the sessions are its children, and counted with it
        cpu -= sum(session["cpu_s"] for session in document["sessions"] if not session["kept"])
    return Run(name, wall, cpu, load, document)


@contextmanager
def cluster(workers: int, directory: Path) -> Iterator[str]:
    """Give the address of a scheduler with so many workers of one thread."""
    note = directory / "scheduler.json"
    module = (sys.executable, "-m", "distributed.cli.dask_")

    def start(kind: str, *arguments: str) -> subprocess.Popen[bytes]:
        call = [*module[:2], f"{module[2]}{kind}", *arguments, "--scheduler-file", str(note), "--no-dashboard"]
        return subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    with ExitStack() as stack:
        own = ("--host", "127.0.0.1")
        started = [start("scheduler", *own, "--port", "0", "--no-show")]
        while not (note.exists() and note.read_text().endswith("}")):
            time.sleep(0.1)
        started += [start("worker", *own, "--nthreads", "1", "--no-nanny") for _ in range(workers)]
        for process in started:
            stack.callback(process.wait)
            stack.callback(process.terminate)
        time.sleep(5.0)  # until the workers are there
        yield json.loads(note.read_text())["address"]


if __name__ == "__main__":
    main()
