"""What tells whether a change of the code lost anything: a table of figures made through the command line alone.

    python benchmarks/golden.py                            make all anew, print what moved against the stored table
    python benchmarks/golden.py --against first_edition    against the table of commit 932ea06
    python benchmarks/golden.py --only simulated,hard      some tables only
    python benchmarks/golden.py --quick                    what `make test` compares, under two minutes
    python benchmarks/golden.py --write                    store the tables, if no row is missing
    python benchmarks/golden.py --smooth DIR/.venv/bin/smooth   of another checkout, on the same sessions

Tables stand in tests/golden/present, one value a line; their heads have the tolerances. tests/golden/first_edition is
never rewritten. costs.txt beside them has processor time, time on the wall and peak memory: read, never compared.
Recordings are those of SMOOTH_DATA; without it their rows are missing.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import golden_continuity
import golden_damaged
import golden_hard
import golden_recordings
import golden_simulated
import golden_thinned
from golden_command import Bench, Command
from golden_tables import (
    Columns,
    Rows,
    Texts,
    beyond,
    changes,
    read_table,
    summary,
    texts_of,
    write_table,
)

ROOT = Path(__file__).resolve().parents[1]
STORED = ROOT / "tests" / "golden"
FIRST, PRESENT = "first_edition", "present"
COSTS = "costs"
RECORDED = frozenset({"recordings", "thinned", "continuity_recordings"})  # tables that need SMOOTH_DATA
DERIVED = {"thinned": golden_thinned.over_phases}  # rows made of other rows of a table
DATA = Path(os.environ.get("SMOOTH_DATA", ROOT.parent / "shared" / "data"))


class Job(Protocol):
    """Something that runs the command and gives one row or several of a table."""

    @property
    def name(self) -> str:
        """Unique within its table."""

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows it gives."""

    @property
    def quick(self) -> bool:
        """Whether it is one of the quick ones."""

    def run(self, bench: Bench, work: Path) -> Rows:
        """Return the rows; `work` is an empty folder."""


@dataclass(frozen=True)
class Done:
    """Rows of one job, and what they cost."""

    table: str
    job: str
    rows: Rows
    cost: Columns


def jobs_of(recorded: bool) -> dict[str, tuple[Job, ...]]:
    """Return all jobs by table; those of recordings if wanted."""
    jobs: dict[str, tuple[Job, ...]] = {
        "simulated": golden_simulated.SESSIONS,
        "continuity": golden_continuity.SIMULATED,
        "hard": golden_hard.SESSIONS,
        "damaged": golden_damaged.CASES,
        "recordings": golden_recordings.RECORDINGS,
        "thinned": golden_thinned.SESSIONS,
        "continuity_recordings": golden_continuity.RECORDED,
    }
    return {table: some for table, some in jobs.items() if recorded or table not in RECORDED}


def default_bench(smooth: Path | None = None) -> Bench:
    """Return the bench of an executable; that of this checkout simulates."""
    own = Path(sys.executable).with_name("smooth")
    return Bench(Command(smooth or own), own, ROOT / "build" / "golden", DATA if DATA.is_dir() else None)


def run_job(bench: Bench, table: str, name: str) -> Done:
    """Run one job in a folder of its own."""
    job = next(job for job in jobs_of(recorded=True)[table] if job.name == name)
    bench.cache.mkdir(parents=True, exist_ok=True)
    command = Command(bench.command.smooth)
    with tempfile.TemporaryDirectory(dir=bench.cache) as work:
        rows = job.run(Bench(command, bench.simulator, bench.cache, bench.recordings), Path(work))
    cost = command.cost
    columns: Columns = {"seconds": cost.seconds, "wall_s": cost.wall, "peak_megabytes": cost.megabytes}
    return Done(table, name, rows, columns)


def run_all(bench: Bench, wanted: Sequence[tuple[str, str]], processes: int) -> list[Done]:
    """Run jobs, each (table, name), side by side; a line on stderr for each."""
    done = []
    with ProcessPoolExecutor(processes) as pool:
        waiting = {pool.submit(run_job, bench, *job): job for job in wanted}
        for future in as_completed(waiting):
            done.append(future.result())
            table, name = waiting[future]
            print(f"{len(done)}/{len(wanted)}  {table}  {name}  {done[-1].cost['wall_s']:.1f} s", file=sys.stderr)
    return sorted(done, key=lambda d: (d.table, d.job))


def tables_of(done: Iterable[Done]) -> dict[str, Texts]:
    """Return the texts of every table, costs included."""
    rows: dict[str, Rows] = {}
    for one in done:
        rows.setdefault(one.table, {}).update(one.rows)
        rows.setdefault(COSTS, {})[f"{one.table}.{one.job}"] = one.cost
    for table, derive in DERIVED.items():
        if table in rows:
            rows[table] |= derive(rows[table])
    return {table: texts_of(some) for table, some in rows.items()}


def compare(folder: Path, tables: dict[str, Texts], rows: dict[str, set[str]]) -> int:
    """Print what moved against the stored tables, worst first; return how many values exceed their tolerance."""
    count = 0
    for table in sorted(rows):
        path = folder / f"{table}.txt"
        if not path.exists():
            print(f"{table}: nothing stored at {path.relative_to(STORED.parent)}")
            continue
        before, tolerances = read_table(path)
        wanted = rows[table] | {row for row, _ in tables.get(table, {})}
        found = changes(before, tables.get(table, {}), tolerances, wanted)
        worse = beyond(found)
        count += len(worse)
        print(f"\n{table}: {len(worse)} values beyond their tolerance, {len(found) - len(worse)} moved within it")
        for change in worse:
            print(f"  {change}")
        kept = {key: text for key, text in before.items() if key[0] in wanted}
        for line in summary(found, kept):
            print(f"    {line}")
    return count


def store(folder: Path, tables: dict[str, Texts], rows: dict[str, set[str]], keep: bool, whole: bool = True) -> None:
    """Write tables, or, if not `whole`, some rows of them; an edition that is to be kept is refused where it exists."""
    for table, names in rows.items():
        missing = names - {row for row, _ in tables.get(table, {})}
        if missing:
            raise SystemExit(f"{table}: not written, rows are missing: {', '.join(sorted(missing))}")
        if keep and (folder / f"{table}.txt").exists():
            raise SystemExit(f"{folder.name}/{table}.txt: this edition is never rewritten")
    for table, names in rows.items():
        path = folder / f"{table}.txt"
        before = {} if whole or not path.exists() else read_table(path)[0]
        write_table(path, {key: text for key, text in before.items() if key[0] not in names} | tables[table])
    path = folder / f"{COSTS}.txt"
    costs = read_table(path)[0] if path.exists() else {}
    prefixes = tuple(f"{table}." for table in rows) if whole else ()
    others = {key: text for key, text in costs.items() if not key[0].startswith(prefixes)}
    write_table(path, others | tables[COSTS])


def main() -> None:
    """Parse the arguments, run, print, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smooth", type=Path, help="the executable under test; default: that of this environment")
    parser.add_argument("--only", help="tables, with commas between")
    parser.add_argument("--row", help="only jobs whose name holds this")
    parser.add_argument("--quick", action="store_true", help="the quick rows alone")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--against", choices=(PRESENT, FIRST), default=PRESENT)
    parser.add_argument("--write", nargs="?", const=PRESENT, choices=(PRESENT, FIRST), help="store them")
    arguments = parser.parse_args()
    bench = default_bench(arguments.smooth)
    every = jobs_of(recorded=bench.recordings is not None)
    names = arguments.only.split(",") if arguments.only else list(every)
    if unknown := set(names) - every.keys():
        parser.error(f"no such table: {', '.join(sorted(unknown))}; there are {', '.join(every)}")
    chosen = {
        table: [
            job
            for job in every[table]
            if (job.quick or not arguments.quick) and (not arguments.row or arguments.row in job.name)
        ]
        for table in names
    }
    wanted = [(table, job.name) for table, some in chosen.items() for job in some]
    rows = {table: {row for job in some for row in job.rows} for table, some in chosen.items() if some}
    if arguments.write == FIRST and any((STORED / FIRST / f"{table}.txt").exists() for table in rows):
        parser.error(f"{FIRST}: this edition is never rewritten")
    tables = tables_of(run_all(bench, wanted, arguments.jobs))
    if arguments.write:
        whole = not (arguments.quick or arguments.row)
        store(STORED / arguments.write, tables, rows, keep=arguments.write == FIRST, whole=whole)
        return
    sys.exit(1 if compare(STORED / arguments.against, tables, rows) else 0)


if __name__ == "__main__":
    main()
