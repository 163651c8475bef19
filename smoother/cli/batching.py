"""`smooth batch DIR...`: every session under some folders, on all cores or on a cluster, with one page about all."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from smoother.cli.arguments import (
    EXIT_DONE,
    EXIT_QUALITY,
    EXIT_UNUSABLE,
    Number,
    Whole,
    json_option,
    no_baseline_option,
    rate_option,
    require_sessions,
    solver_option,
)
from smoother.cli.output import (
    number,
    open_page,
    plain,
    print_json,
    print_line,
    print_pairs,
    print_table,
    progress_on_terminal,
    warn,
)
from smoother.errors import UsageError
from smoother.laps.clock import lap_clock
from smoother.words import counted

if TYPE_CHECKING:
    from smoother.batch.entries import Entry
    from smoother.batch.outcome import Outcome
    from smoother.batch.task import Task

EXIT_BUG = 1
INDEX_EVERY = 20.0  # s between two versions of the index while sessions run
Show = Callable[["Task", "Outcome"], None]


@dataclass(frozen=True)
class Plan:
    """Resources and output of a batch."""

    jobs: int
    scheduler: str | None
    directory: Path
    title: str


@click.command(
    short_help="Many sessions at once, with one page about all of them.",
    epilog="Exit code: that of the worst session: 1 if one broke off or was lost, else 2 if one was unusable or over "
    "its limit (or the usage wrong), else 3 if the quality gate rejected one, else 0; 130 stopped.",
)
@click.argument("folders", nargs=-1, metavar="DIR...", type=click.Path(path_type=Path))
@click.option(
    "-o", "--out", metavar="DIR", type=click.Path(path_type=Path), help="Where all results go [beside sessions]."
)
@click.option("--jobs", metavar="N", type=Whole(1, 1024), help="Sessions at a time [one per core of this machine].")
@click.option("--scheduler", metavar="ADDRESS", help="Run on this Dask cluster, as tcp://host:8786, instead.")
@click.option("--again", is_flag=True, help="Also smooth sessions that are finished and unchanged.")
@click.option("--time-limit", metavar="S", type=Number(1.0), default=3600.0, help="For one session [3600].")
@click.option("--memory-limit", metavar="MB", type=Whole(64), default=4096, help="For one session [4096].")
@rate_option
@solver_option
@no_baseline_option
@click.option("--no-figures", is_flag=True, help="Write tables only, no reports.")
@click.option("--pictures", is_flag=True, help="Also write the figures as files; takes 1.5 times as long.")
@json_option
@click.option("--open", "open_it", is_flag=True, help="Show the page when done.")
def batch(folders: tuple[Path, ...], out: Path | None, as_json: bool, open_it: bool, **given: Any) -> int:
    """Smooth every session found under some folders, and write one page about all of them.

    A session that cannot be smoothed, crashes, hangs or needs too much memory does not stop the others. A finished
    session is not smoothed again unless its files, the options or this program changed, so the same command continues
    a batch that was stopped. sessions.html, .json and .csv are written to --out, else to the first DIR.
    """
    from smoother.batch.find import find_sessions
    from smoother.batch.index import DOCUMENT, PAGE
    from smoother.batch.local import cores
    from smoother.batch.task import Limits

    require_sessions(folders, "smooth batch")
    with progress_on_terminal(not as_json) as progress:
        progress("looking for sessions", 0.0)
        found = find_sessions(folders, out)
    for problem in found.problems:
        warn(problem)
    if not found.tasks:
        raise UsageError(f"{', '.join(map(str, folders))}: no session found; see `smooth --help`")
    limits = Limits(given["time_limit"], given["memory_limit"])
    tasks = [replace(task, arguments=_arguments(given), limits=limits) for task in found.tasks]
    directory = (out or (folders[0] if folders[0].is_dir() else folders[0].parent)).resolve()
    plan = Plan(given["jobs"] or cores(), given["scheduler"], directory, _title(folders))
    with _stopped_by_signals():
        entries, document = run(tasks, plan, bool(given["again"]), quiet=as_json)
    if as_json:
        from smoother.report.files import to_json

        print_json(to_json(document))
    else:
        show(document, str(directory / PAGE), str(directory / DOCUMENT))
    if open_it:
        open_page(directory / PAGE)
    return exit_code(entries)


def _arguments(given: dict[str, Any]) -> tuple[str, ...]:
    """The options of `smooth SESSION` that follow from those of the batch."""
    flags = [f"--{name.replace('_', '-')}" for name in ("no_baseline", "no_figures") if given[name]]
    pictures = () if given["pictures"] else ("--no-pictures",)
    return ("--rate", f"{given['rate']:g}", "--solver", given["solver"], *flags, *pictures)


def _title(folders: tuple[Path, ...]) -> str:
    names = [folder.resolve().name or str(folder) for folder in folders]
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"


@contextlib.contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """Let Ctrl-C (polars would wait for the end of a session), a closed terminal or SIGTERM stop the batch at once."""

    def stop(_: int, __: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# ---- running --------------------------------------------------------------------------------------------------------


def run(tasks: list[Task], plan: Plan, again: bool, quiet: bool) -> tuple[list[Entry], dict[str, Any]]:
    """Smooth the unfinished sessions; return all sessions and the index, which is also written every INDEX_EVERY s.

    Raises UsageError if the index cannot be written.
    """
    from smoother.batch.entries import Entry
    from smoother.batch.record import finished

    entries = {task.session: Entry(task, kept := None if again else finished(task), kept is not None) for task in tasks}
    waiting = [task for task in tasks if entries[task.session].outcome is None]
    try:
        _write(entries, plan)
        written = time.monotonic()
        with contextlib.closing(_outcomes(waiting, plan)) as outcomes, _bar(len(tasks), len(waiting), quiet) as report:
            for task, outcome in outcomes:
                entries[task.session] = Entry(task, outcome)
                report(task, outcome)
                if time.monotonic() - written > INDEX_EVERY:
                    _write(entries, plan)
                    written = time.monotonic()
    except KeyboardInterrupt as error:
        click.echo(err=True)  # behind the ^C of the terminal
        if not again:  # a session may have finished while the batch was stopped
            entries |= {task.session: Entry(task, finished(task)) for task in _without_outcome(entries)}
        raise click.Abort(_stopped(list(entries.values()), again)) from error
    finally:
        document = _write(entries, plan)
    return list(entries.values()), document


def _without_outcome(entries: dict[Path, Entry]) -> list[Task]:
    return [entry.task for entry in entries.values() if entry.outcome is None]


def _stopped(entries: list[Entry], again: bool) -> str:
    done = sum(entry.outcome is not None and entry.outcome.has_results for entry in entries)
    command = "the same command without --again" if again else "the same command"
    return f"stopped; {done} of {counted(len(entries), 'session')} done. {command.capitalize()} does the rest"


def _outcomes(tasks: list[Task], plan: Plan) -> Generator[tuple[Task, Outcome], None, None]:
    if plan.scheduler is None:
        from smoother.batch.local import run_here

        return run_here(tasks, plan.jobs)
    from smoother.batch.cluster import run_on_cluster

    return run_on_cluster(tasks, plan.scheduler)


def _write(entries: dict[Path, Entry], plan: Plan) -> dict[str, Any]:
    from smoother.batch.index import write_index
    from smoother.cli.directories import unwritable

    try:
        return write_index(plan.directory, plan.title, list(entries.values()))
    except OSError as error:
        raise unwritable(plan.directory, error) from error


@contextlib.contextmanager
def _bar(sessions: int, waiting: int, quiet: bool) -> Iterator[Show]:
    """Yield a function to call with each finished session: a progress bar on a terminal, a line for each failure."""
    import sys

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    if sessions > waiting and not quiet:
        warn(f"{sessions - waiting} of {sessions} sessions are finished and unchanged")
    with Bar(*columns, console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        line = bar.add_task("smoothing", total=sessions, completed=sessions - waiting)

        def report(task: Task, outcome: Outcome) -> None:
            bar.update(line, advance=1)
            if outcome.code:
                text = f"smooth: {plain(task.name)}: {plain(outcome.message)}"
                bar.console.print(text, markup=False, highlight=False, soft_wrap=True)

        yield report


# ---- output ---------------------------------------------------------------------------------------------------------


def show(document: dict[str, Any], page: str, index: str) -> None:
    """Print the states of the sessions and the best laps; the path of the page is the last line."""
    from smoother.batch.page import STATES

    counts = dict(document["counts"])
    total = counts.pop("sessions")
    what = ", ".join(f"{counts[state]} {word}" for state, word in STATES.items() if counts.get(state))
    cpu = sum(session["cpu_s"] or 0.0 for session in document["sessions"] if not session["kept"])
    print_pairs(document["title"], [("sessions", f"{total}: {what}"), ("processor", f"{cpu:.0f} s in this run")])
    for track in document["tracks"]:
        for kind in ("karts", "drivers"):
            if track[kind]:
                print_line("")
                print_table(f"best laps of {kind}, {track['track']}", *_bests(track[kind], kind[:-1]))
    print_line("")
    print_line(index)
    print_line(page)


def _bests(bests: list[dict[str, Any]], who: str) -> tuple[list[str], list[list[str]]]:
    rows = [
        [
            best[who] or "not named",
            lap_clock(best["best_s"]),
            number(best["best_sigma_s"], 3),
            str(best["laps"]),
            best["session"],
        ]
        for best in bests
    ]
    return [who, "best lap", "±", "laps", "session"], rows


def exit_code(entries: list[Entry]) -> int:
    """Return 1 if this program failed anywhere, else 2 if any session was unusable, else 3 if any was rejected, else 0.

    A session that was not run (the cluster has gone) counts as a failure.
    """
    codes = {EXIT_BUG if entry.outcome is None else entry.outcome.code for entry in entries}
    return next((code for code in (EXIT_BUG, EXIT_UNUSABLE, EXIT_QUALITY) if code in codes), EXIT_DONE)
