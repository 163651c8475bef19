"""`smooth calibrate DIR...`: identify the errors of the sensors, and write calibration.toml."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from smoother.cli.arguments import EXIT_DONE, json_option, require_sessions, sessions_argument
from smoother.cli.directories import session_directory, unwritable
from smoother.cli.output import open_page, plain, print_json, print_line, print_pairs, progress_on_terminal, warn
from smoother.errors import SessionError, UsageError
from smoother.words import MOST_DIGITS, sigma_digits

if TYPE_CHECKING:
    from calib.outcome import Comparison, Outcome, Value
    from calib.run import Results
    from smoother.calibration import Calibration
    from smoother.cli.output import Progress
    from smoother.frames import Origin
    from smoother.report.calibration_page import Section

PAGE, FIGURES = "calibration.html", "calibration"
MOST_DIGITS_SHOWN = 6  # significant digits of a number


@click.command(short_help="Calibrate the sensors; writes calibration.toml and a page of figures.")
@sessions_argument
@click.option("-o", "--out", metavar="DIR", type=click.Path(path_type=Path), help="Where results go [the first DIR].")
@click.option("--first-samples", is_flag=True, help="Gyro bias from the first 1000 samples, as in the thesis.")
@click.option("--place", metavar="LAT,LON", help="For the magnetic model, in degrees [from the fixes].")
@click.option("--date", metavar="YYYY-MM-DD", help="For the magnetic model [from the fixes or session.toml].")
@click.option("--no-figures", is_flag=True, help="Write calibration.toml only.")
@json_option
@click.option("--open", "open_it", is_flag=True, help="Show the page when done.")
def calibrate(
    sessions: tuple[Path, ...],
    out: Path | None,
    first_samples: bool,
    place: str | None,
    date: str | None,
    no_figures: bool,
    as_json: bool,
    open_it: bool,
) -> int:
    """Identify the errors of the sensors from recordings of the logger at rest, on its faces, and turned by hand.

    Every procedure that a recording is sufficient for is run; several recordings of one logger may be named. The values
    are written to calibration.toml in the first folder, with a page of figures; earlier values that these recordings
    do not determine are kept. `smooth SESSION` uses the calibration.toml in the folder of the session or the folder
    above it. docs/calibration.md describes how to record.
    """
    require_sessions(sessions, "smooth calibrate")
    directory = session_directory(sessions[0]) if out is None else out
    with progress_on_terminal() as progress:
        results = _run(sessions, first_samples, _place(place), _date(date), progress)
        progress("writing", 0.95)
        try:
            page = _write(results, directory, not no_figures)
        except OSError as error:
            raise unwritable(directory, error) from error
    if as_json:
        from smoother.report.files import to_json

        print_json(to_json(_document(results)))
    else:
        _show(results)
        print_line(str(page))
    if open_it:
        open_page(page)
    return EXIT_DONE


def _run(
    paths: tuple[Path, ...], first_samples: bool, place: Origin | None, date: dt.date | None, progress: Progress
) -> Results:
    from calib.recording import load_recordings
    from calib.run import RunOptions, run

    progress("reading", 0.0)
    recordings = [recording for path in paths for recording in load_recordings(path)]
    for recording in recordings:
        for problem in recording.problems:
            warn(problem.text)
    results = run(recordings, RunOptions(first_samples, place, date), progress)
    if not results.outcomes:
        reasons = "; ".join(f"{procedure}: {reason}" for procedure, reason in _refused(results))
        raise SessionError(f"{', '.join(map(str, paths))}: nothing could be calibrated ({reasons})")
    return results


def _place(text: str | None) -> Origin | None:
    from smoother.frames import Origin

    if text is None:
        return None
    try:
        lat, lon = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"--place {text}: wanted two numbers, as 45.05,12.21") from error
    if not (abs(lat) <= 90.0 and abs(lon) <= 360.0):
        raise UsageError(f"--place {text}: no such place; latitude first, in degrees")
    return Origin(lat, lon, 0.0)


def _date(text: str | None) -> dt.date | None:
    try:
        return None if text is None else dt.date.fromisoformat(text)
    except ValueError as error:
        raise UsageError(f"--date {text}: wanted a date as 2026-05-16") from error


# ---- writing --------------------------------------------------------------------------------------------------------


def _write(results: Results, directory: Path, with_figures: bool) -> Path:
    """Write calibration.toml and the page; return the file to open first."""
    from smoother.calibration import FILE_NAME, load_calibration, load_notes, merged

    directory.mkdir(parents=True, exist_ok=True)
    target = directory / FILE_NAME
    calibration, notes = results.calibration, dict(results.notes)
    if target.is_file():
        calibration = merged(load_calibration(target), calibration)
        notes = {**load_notes(target, results.calibration), **notes}
    if calibration.applied() or notes:
        _save(target, calibration, notes)
    else:
        warn("nothing was found that a session could be calibrated by, so no calibration.toml is written")
    if with_figures:
        return _write_page(results, directory)
    return target if target.is_file() else directory


def _save(target: Path, calibration: Calibration, notes: Mapping[str, Mapping[str, object]]) -> None:
    """Write calibration.toml completely or not at all."""
    from smoother.calibration import save_calibration

    # First to a temporary file, because the disk may be full.
    temporary = target.with_suffix(".tmp")
    save_calibration(temporary, calibration, notes)
    temporary.replace(target)


def _write_page(results: Results, directory: Path) -> Path:
    from smoother.report.calibration_page import write_page

    folder = directory / FIGURES
    folder.mkdir(exist_ok=True)
    sections = [_section(outcome, i, folder) for i, outcome in enumerate(results.outcomes)]
    drawn = {section.figure for section in sections}
    for stale in folder.glob("*.png"):
        if stale not in drawn:
            stale.unlink()
    title = f"Calibration from {', '.join(dict.fromkeys(outcome.recording for outcome in results.outcomes))}"
    write_page(directory / PAGE, title, sections, _refused(results))
    return directory / PAGE


def _section(outcome: Outcome, number: int, folder: Path) -> Section:
    from smoother.report.calibration_figures import FIGURES as DRAWN
    from smoother.report.calibration_figures import draw
    from smoother.report.calibration_page import Section

    figure = None
    if outcome.drawing and outcome.procedure in DRAWN:
        function, name = DRAWN[outcome.procedure]
        figure = folder / f"{name}.png"
        if figure.exists() and number and outcome.procedure.startswith("timing"):
            figure = folder / f"{name}_{number + 1}.png"
        draw(function, **outcome.drawing).savefig(figure, format="png")
    rows = [(value.name, _with_sigma(value), value.unit, value.note) for value in outcome.values]
    comparisons = [(c.name, *_before_and_after(c)) for c in outcome.comparisons]
    return Section(f"{outcome.procedure} ({outcome.recording})", rows, comparisons, outcome.remarks, figure)


# ---- output ---------------------------------------------------------------------------------------------------------


def _show(results: Results) -> None:
    for outcome in results.outcomes:
        pairs = [(value.name, _value_text(value)) for value in outcome.values]
        pairs += [(comparison.name, _comparison_text(comparison)) for comparison in outcome.comparisons]
        pairs += [("", remark) for remark in outcome.remarks]
        print_pairs(f"{outcome.procedure} ({outcome.recording})", pairs)
        print_line("")
    if results.refusals:
        print_pairs("not calibrated", _refused(results))
        print_line("")


def _refused(results: Results) -> list[tuple[str, str]]:
    """What was not calibrated and why, each reason once; with the recordings that have it where there are several."""
    recordings: dict[tuple[str, str], list[str]] = {}
    for refusal in results.refusals:
        recordings.setdefault((refusal.procedure, refusal.reason), []).append(refusal.recording)
    several = len({refusal.recording for refusal in results.refusals} | {o.recording for o in results.outcomes}) > 1
    return [
        (procedure, f"{reason} ({', '.join(names)})" if several else reason)
        for (procedure, reason), names in recordings.items()
    ]


def _value_text(value: Value) -> str:
    numbers = _with_sigma(value)
    if not numbers:
        return value.note
    text = f"{numbers} {value.unit}".rstrip()
    return f"{text} ({value.note})" if value.note else text


def _comparison_text(comparison: Comparison) -> str:
    before, after = _before_and_after(comparison)
    return f"{before} before, {after} after"


def _before_and_after(comparison: Comparison) -> tuple[str, str]:
    """Both values with four significant digits of the larger."""
    digits = sigma_digits(max(comparison.before, comparison.after))
    places = 2 if digits is None else digits + 2
    return _at_least(comparison.before, places, comparison.unit), _at_least(comparison.after, places, comparison.unit)


def _at_least(value: float, places: int, unit: str) -> str:
    least = 10.0**-places
    return f"{value:.{places}f} {unit}" if value >= least or value == 0.0 else f"below {least:.{places}f} {unit}"


def _with_sigma(value: Value) -> str:
    """Numbers with their sigmas, rows of a matrix on separate lines; empty for an unknown one."""
    import numpy as np

    values = np.atleast_1d(np.asarray(value.value, dtype=float))
    if not np.any(np.isfinite(values)):
        return ""
    if values.ndim == 2:
        sigmas = [None] * len(values) if value.sigma is None else list(np.asarray(value.sigma))
        rows = [replace(value, value=row, sigma=sigma) for row, sigma in zip(values, sigmas, strict=True)]
        return " | ".join(_with_sigma(row) for row in rows)
    if value.sigma is None:
        return ", ".join(f"{item + 0.0:.4g}" for item in values)
    pairs = zip(values, np.atleast_1d(np.asarray(value.sigma, dtype=float)), strict=True)
    return ", ".join(_pair(float(item), float(sigma)) for item, sigma in pairs)


def _pair(value: float, sigma: float) -> str:
    """A number and its sigma with two significant digits, unless the number would have more than MOST_COUNTING."""
    if not math.isfinite(sigma) or value == sigma == 0.0:
        return f"{value:.{MOST_DIGITS_SHOWN}g}"
    before = math.floor(math.log10(abs(value))) + 1 if value else 0
    most = min(max(0, MOST_DIGITS_SHOWN - before), MOST_DIGITS)
    wanted = sigma_digits(sigma)
    digits = most if wanted is None else min(wanted, most)
    least = 10.0**-digits
    error = f"{sigma:.{digits}f}" if sigma >= 0.5 * least else f"below {least:.{digits}f}"
    return f"{round(value, digits) + 0.0:.{digits}f} ± {error}"


def _document(results: Results) -> Mapping[str, object]:
    """The results as plain values, for --json."""
    return {
        "procedures": [
            {
                "procedure": outcome.procedure,
                "recording": plain(outcome.recording),
                "values": outcome.values,
                "comparisons": outcome.comparisons,
                "remarks": outcome.remarks,
            }
            for outcome in results.outcomes
        ],
        "refused": results.refusals,
        "calibration": results.calibration.applied(),
    }
