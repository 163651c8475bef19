"""`smooth export SESSION FORMAT`: the smoothed session as a file that another program opens."""

from __future__ import annotations

import math
from pathlib import Path

import click

from smoother.cli.arguments import ABOUT_EXIT, EXIT_DONE, EXIT_QUALITY, Number, recording_option, require_sessions
from smoother.cli.card import one
from smoother.cli.directories import require_no_recording, unwritable
from smoother.cli.output import print_line, print_pairs, progress_on_terminal, warn
from smoother.cli.results import results_of
from smoother.errors import UsageError

FORMAT_NAMES = ("vbo", "racechrono", "motec", "aim", "gpx", "kml", "geojson", "tum")


@click.command(short_help="The smoothed session for RaceChrono, MoTeC i2, Google Earth, ...", epilog=ABOUT_EXIT)
@click.argument("session", metavar="SESSION", required=False, type=click.Path(path_type=Path))
@click.argument("form", metavar="FORMAT", required=False)
@click.option(
    "-o", "--out", metavar="FILE", type=click.Path(path_type=Path), help="Where to [SESSION/smoothed/NAME.ENDING]."
)
@click.option("--rate", metavar="HZ", type=Number(0.1, 1000.0), help="Rows a second [as smoothed].")
@recording_option
@click.option("--list", "list_them", is_flag=True, help="List the formats and the programs that open them.")
def export(
    session: Path | None,
    form: str | None,
    out: Path | None,
    rate: float | None,
    recording: int | None,
    list_them: bool,
) -> int:
    """Write the smoothed session in a FORMAT that other programs open: vbo, racechrono, motec, aim, gpx, kml, geojson
    or tum. The session is smoothed first if it was not, or if a file changed since.

    Position, speed, acceleration, laps and delta to the best lap are written as far as the format can hold them, and
    uncertainties where it allows additional channels. `smooth export --list` names the programs that open each format.
    """
    if list_them:
        _list()
        return EXIT_DONE
    if session is None or form is None:
        raise UsageError("smooth export SESSION FORMAT; `smooth export --list` names the formats")
    if str(session) in FORMAT_NAMES and form not in FORMAT_NAMES and not session.exists():
        raise UsageError(f"the session comes before the format: smooth export {form} {session}")
    require_sessions((session,), "smooth export")
    if rate is not None and math.isnan(rate):
        raise UsageError("--rate nan: name a number of rows a second")
    if form not in FORMAT_NAMES:
        raise UsageError(f"unknown format {form!r}; known are {', '.join(FORMAT_NAMES)}")
    if out is not None:
        require_no_recording(out, (session,))
    with progress_on_terminal() as progress:
        results, passed = results_of(one(session, recording), progress)
        progress("exporting", 0.0)
        written = write(results, form, out, rate, session)
    print_line(str(written))
    return EXIT_DONE if passed else EXIT_QUALITY


def write(results: Path, form: str, out: Path | None, rate: float | None, session: Path) -> Path:
    """Write the results of a session, in a directory, as one format and return the file.

    Raises UsageError where it cannot be written, or would be written over a recording or over results.
    """
    from smoother.export.formats import BY_NAME
    from smoother.export.source import open_source

    source = open_source(results, rate)
    chosen = BY_NAME[form]
    path = results / f"{source.file_name}{chosen.ending}" if out is None else out
    if path.is_dir():
        path = path / f"{source.file_name}{chosen.ending}"
    require_no_recording(path, (session,))  # only now the name of the file is known
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        chosen.write(source, path)
    except OSError as error:
        raise UsageError(str(unwritable(path, error)).replace("--out DIR", "--out FILE")) from error
    if not source.has_utc and form != "tum":  # whose times are those of the session
        warn(f"{path.name}: the time of day is not known; times count from the start")
    return path


def _list() -> None:
    from smoother.export.formats import FORMATS

    print_pairs("smooth export SESSION FORMAT", [(form.name, f"{form.text} ({form.ending})") for form in FORMATS])
