"""`smooth SESSION...`: the command without a name."""

from __future__ import annotations

import sys
from itertools import count
from pathlib import Path

import click

from smoother.cli.arguments import (
    ABOUT_EXIT,
    EXIT_DONE,
    EXIT_QUALITY,
    EXIT_UNUSABLE,
    each_once,
    json_option,
    no_baseline_option,
    rate_option,
    recording_option,
    require_sessions,
    sessions_argument,
    solver_option,
)
from smoother.cli.card import tasks
from smoother.cli.commands import COMMAND_NAMES, named_command
from smoother.cli.output import discard_output, open_page, print_json, progress_on_terminal, warn
from smoother.cli.pipeline import Options, Result, smooth_session
from smoother.cli.tables import show_result
from smoother.errors import SmootherError

HELP = """Smooth recorded kart sessions: position, speed, attitude, each with an error bar.

SESSION is the folder or card that your logger wrote (.KLG; imu.csv with gps.csv or .nmea; out.txt; of other loggers
.xrk, .xrz, .drk, .mp4, .log, .fit, .vbo, .gpx, .tcx, .kml, .ubx or .csv), or one file of it. The results go into a
folder "smoothed" inside it: a report for your browser (report.html), tables, figures, and summary.json with every
result and problem. Your recording is not changed, and no network is used.

\b
    smooth monday/           smooth a session
    smooth check monday/     is the recording good? (seconds, at the track)
    smooth demo              no recording yet? simulate one and smooth it
"""
EPILOG = (
    "If a folder has the name of a command, `smooth demo` smooths that folder, and `smooth check demo` runs the "
    "command. To smooth several folders of which the first has such a name: `smooth ./check other`.",
    ABOUT_EXIT,
)


class SmoothCommand(click.Command):
    """The command without a name; its help also lists the named ones."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of named commands, the rule for folders with such a name, and the exit codes."""
        with formatter.section("Commands"):
            formatter.write_dl(
                [(f"smooth {name}", named_command(name).get_short_help_str(70)) for name in COMMAND_NAMES]
            )
        for paragraph in EPILOG:
            formatter.write_paragraph()
            formatter.write_text(paragraph)


@click.command(cls=SmoothCommand, help=HELP)
@sessions_argument
@click.option(
    "-o", "--out", metavar="DIR", type=click.Path(path_type=Path), help="Where results go [SESSION/smoothed]."
)
@recording_option
@rate_option
@solver_option
@no_baseline_option
@click.option("--no-figures", is_flag=True, help="Write tables only, and delete an earlier report.")
@click.option("--no-pictures", is_flag=True, help="Write the report without figures/*.png, and delete earlier ones.")
@json_option
@click.option("--open", "open_it", is_flag=True, help="Show the report when done.")
@click.version_option(package_name="kart-smoother", prog_name="smooth")
def smooth(
    sessions: tuple[Path, ...],
    out: Path | None,
    recording: int | None,
    rate: float,
    solver: str,
    no_baseline: bool,
    no_figures: bool,
    no_pictures: bool,
    as_json: bool,
    open_it: bool,
) -> int:
    """Smooth sessions; HELP is the text of `smooth --help`."""
    require_sessions(sessions, "smooth")
    sessions = each_once(sessions)
    options = Options(rate, solver, not no_baseline, not no_figures, not no_pictures)
    outcomes: list[Result | SmootherError] = []
    places = zip(sessions, output_directories(out, sessions), strict=True)
    wanted = [task for path, place in places for task in tasks(path, place, recording)]
    for path, directory in wanted:
        outcomes.append(_attempt(path, directory, options, is_only=len(wanted) == 1))
        try:
            _report(outcomes[-1], path, as_json, is_only=len(wanted) == 1)
        except BrokenPipeError:
            discard_output(sys.stdout)  # the other sessions are smoothed all the same
    if as_json:
        print_json(_as_json([path for path, _ in wanted], outcomes))
    results = [outcome for outcome in outcomes if isinstance(outcome, Result)]
    if open_it and results:
        open_page(results[-1].main_file)
    return exit_code(outcomes)


def output_directories(out: Path | None, sessions: tuple[Path, ...]) -> list[Path | None]:
    """Return where each session goes: of several each gets a folder of its own in `out`, numbered if names repeat."""
    if out is None or len(sessions) == 1:
        return [out] * len(sessions)
    names = [session.resolve().stem if session.is_file() else session.resolve().name for session in sessions]
    taken = set(names)
    places: list[Path | None] = []
    for i, name in enumerate(names):
        place = name
        if name in names[:i]:
            place = next(numbered for k in count(2) if (numbered := f"{name}-{k}") not in taken)
            taken.add(place)
        places.append(out / place)
    return places


def exit_code(outcomes: list[Result | SmootherError]) -> int:
    """Return 2 if any session was unusable, else 3 if the quality gate rejected any result, else 0."""
    if any(isinstance(outcome, SmootherError) for outcome in outcomes):
        return EXIT_UNUSABLE
    passed = all(outcome.quality.passed for outcome in outcomes if isinstance(outcome, Result))
    return EXIT_DONE if passed else EXIT_QUALITY


def _attempt(path: Path, directory: Path | None, options: Options, is_only: bool) -> Result | SmootherError:
    """Smooth one session; of several, an unusable one does not stop the others."""
    with progress_on_terminal() as progress:
        try:
            return smooth_session(path, directory, options, progress)
        except SmootherError as error:
            if is_only:
                raise
            return error


def _report(outcome: Result | SmootherError, path: Path, as_json: bool, is_only: bool) -> None:
    if isinstance(outcome, SmootherError):
        warn(str(outcome))
        return
    if not outcome.quality.passed:
        warn(f"{path}: the result failed its quality gate: {'; '.join(outcome.quality.reasons)}")
    if not as_json:
        show_result(outcome, None if is_only else path)


def _as_json(sessions: list[Path], outcomes: list[Result | SmootherError]) -> str:
    """One session: its summary. Several: a list, with an `error` in place of the summary of an unusable one."""
    from smoother.report.files import to_json

    documents = [
        outcome.document if isinstance(outcome, Result) else {"session": {"name": str(path)}, "error": str(outcome)}
        for path, outcome in zip(sessions, outcomes, strict=True)
    ]
    return to_json(documents[0] if len(documents) == 1 else documents)
