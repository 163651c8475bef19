"""Exit codes, arguments and options of several commands, and the check that a session exists."""

import difflib
import math
from pathlib import Path
from typing import Any

import click

from smoother.cli.commands import COMMAND_NAMES
from smoother.cli.output import warn
from smoother.errors import UsageError

EXIT_DONE, EXIT_UNUSABLE, EXIT_QUALITY, EXIT_INTERRUPTED = 0, 2, 3, 130  # 1 is Python's own, for bugs; 130 the shell's
ABOUT_EXIT = (
    "Exit codes: 0 done, 1 a bug in this program, 2 wrong usage or unusable data, 3 done but not to be trusted, 130 "
    "stopped."
)


class Number(click.FloatRange):
    """A number within bounds; anything else is refused with a plain message."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; the error names the bounds."""
        try:
            number = float(super().convert(value, param, ctx))
        except click.BadParameter:
            number = math.nan
        if math.isnan(number):
            self.fail(f"{value} is not a number {_bounds(self.min, self.max)}", param, ctx)
        return number


class Whole(click.IntRange):
    """A whole number within bounds, refused likewise."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the number; the error names the bounds."""
        try:
            return int(super().convert(value, param, ctx))
        except click.BadParameter:
            self.fail(f"{value} is not a whole number {_bounds(self.min, self.max)}", param, ctx)


def _bounds(least: float | None, most: float | None) -> str:
    return f"of {least:.10g} or more" if most is None else f"from {least:.10g} to {most:.10g}"


sessions_argument = click.argument("sessions", nargs=-1, metavar="SESSION...", type=click.Path(path_type=Path))
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
recording_option = click.option(
    "--recording", metavar="N", type=Whole(1), help="Number of the recording on a card with several."
)
solver_option = click.option(
    "--solver",
    type=click.Choice(["batch", "isam2"]),
    default="batch",
    help="Whole session at once, or as a stream.",
)
rate_option = click.option("--rate", metavar="HZ", type=Number(1.0, 1000.0), default=50.0, help="Rows a second [50].")
no_baseline_option = click.option("--no-baseline", is_flag=True, help="Leave out the comparison with the older method.")


def require_sessions(sessions: tuple[Path, ...], command: str) -> None:
    """Raise UsageError unless every session exists, naming a similar path or command."""
    if not sessions:
        raise UsageError(f"no session given; see `{command} --help`")
    for path in sessions:
        if path.exists():
            continue
        if str(path) in COMMAND_NAMES:
            raise UsageError(
                f"{path}: no such file or folder; if the command is meant it comes first: smooth {path} ..."
            )
        near = difflib.get_close_matches(str(path), [*COMMAND_NAMES, *_neighbours(path)], n=1)
        raise UsageError(f"{path}: no such file or folder" + (f"; did you mean {near[0]}?" if near else ""))


def each_once(sessions: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return the sessions without repetitions, also by another path; each repetition is reported in a line."""
    names: dict[Path, list[str]] = {}
    for path in sessions:
        names.setdefault(path.resolve(), []).append(str(path))
    for first, *more in names.values():
        if more:
            others = dict.fromkeys(name for name in more if name != first)
            also = f" (also as {', '.join(others)})" if others else ""
            warn(f"{first}: named {len(more) + 1} times{also}; taken once")
    return tuple(Path(first) for first, *_ in names.values())


def _neighbours(path: Path) -> list[str]:
    parent = path.parent
    return [str(parent / entry.name) for entry in parent.iterdir()] if parent.is_dir() else []
