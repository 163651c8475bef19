"""`smooth evaluate SESSION...`: every estimator against truth.csv, for sessions that have one."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from smoother.cli.arguments import (
    ABOUT_EXIT,
    EXIT_DONE,
    EXIT_QUALITY,
    Number,
    json_option,
    recording_option,
    require_sessions,
    sessions_argument,
    solver_option,
)
from smoother.cli.card import one
from smoother.cli.directories import session_directory
from smoother.cli.output import number, print_json, print_table, progress_on_terminal, warn
from smoother.cli.pipeline import Options, Stopwatch, calibrated, estimate, naming, read

if TYPE_CHECKING:
    from smoother.cli.output import Progress
    from smoother.estimate.judge.quality import Quality

SETTLED = 10.0  # s; attitude is also scored without them, as it needs motion to become known
BESIDE, MOSTLY = 5.0, 0.5  # s before the first and after the last row; share of a truth with other times
LABELS = {"gps": "GPS alone", "baseline": "baseline", "smoother": "smoother"}
Figures = dict[str, object]

_ROWS = (  # label, key, digits
    ("horizontal (m)", "horizontal_rms_m", 3),
    ("horizontal, at the fixes (m)", "horizontal_rms_at_fixes_m", 3),
    ("horizontal, over 1 s (m)", "relative_1s_rms_m", 3),
    ("along the track (m)", "along_track_rms_m", 3),
    ("across the track (m)", "cross_track_rms_m", 3),
    ("late by, best fit (s)", "lag_s", 3),
    ("horizontal, lag removed (m)", "horizontal_rms_at_lag_m", 3),
    ("up (m)", "up_rms_m", 3),
    ("velocity, horizontal (m/s)", "horizontal_velocity_rms_mps", 3),
    ("roll (deg)", "roll_rms_deg", 2),
    ("pitch (deg)", "pitch_rms_deg", 2),
    ("yaw (deg)", "yaw_rms_deg", 2),
    ("position within 1 sigma (%)", "coverage_1sigma", 0),
    ("position within 2 sigma (%)", "coverage_2sigma", 0),
)


@click.command(short_help="Accuracy against truth.csv: GPS alone, baseline, smoother.", epilog=ABOUT_EXIT)
@sessions_argument
@recording_option
@solver_option
@click.option("--skip", metavar="S", type=Number(0.0), default=0.0, help="Leave out the first S seconds [0].")
@json_option
def evaluate(sessions: tuple[Path, ...], recording: int | None, solver: str, skip: float, as_json: bool) -> int:
    """Compare GPS alone, the baseline and the smoother with the truth in SESSION/truth.csv.

    Everything is estimated again; nothing is written. Figures are root mean squares; "over 1 s" is the error of the
    change of position in a second. "Within 1 sigma" is the share of position errors, per axis, within one reported
    sigma; correct sigmas give 68 and 95 % (one and two sigma).
    """
    require_sessions(sessions, "smooth evaluate")
    documents, passed = [], True
    for path in [one(session, recording) for session in sessions]:
        with progress_on_terminal() as progress, naming(path):
            document, quality = score(path, Options(solver=solver), skip, progress)
        documents.append(document)
        passed &= quality.passed
        if not quality.passed:
            warn(f"{path}: the result failed its quality gate: {'; '.join(quality.reasons)}")
        if not as_json:
            _show(path, document)
    if as_json:
        from smoother.report.files import to_json

        print_json(to_json(documents[0] if len(documents) == 1 else documents))
    return EXIT_DONE if passed else EXIT_QUALITY


def score(path: Path, options: Options, skip: float, progress: Progress) -> tuple[dict[str, Figures], Quality]:
    """Return the figures of each estimator by its key in LABELS, and the quality gate of the smoother."""
    from smoother import api
    from smoother.estimate.judge.evaluate import at_fixes, without_doubtful_velocity
    from smoother.estimate.judge.evaluate import evaluate as evaluate_against

    progress("reading", 0.0)
    directory = session_directory(path)
    session = calibrated(read(path), directory)
    given = api.read_truth(directory, session.origin)
    truth = without_doubtful_velocity(given)
    if truth is not given:
        warn(f"{path}: the velocity in truth.csv contradicts its positions, so it is not used")
    estimates = estimate(session, options, Stopwatch(), progress)
    session, t = estimates.session, estimates.smoothed.t
    outside = float(((truth.t < t[0] - BESIDE) | (truth.t > t[-1] + BESIDE)).mean())
    if MOSTLY < outside < 1.0:  # without any overlap there is an error
        warn(f"{path}: {outside:.0%} of truth.csv lie outside the session; are its times on the session's clock, in s?")
    trajectories = {"gps": api.gps_alone(session, options.rate), "smoother": estimates.smoothed}
    if estimates.baseline is not None:
        trajectories["baseline"] = estimates.baseline
    document: dict[str, Figures] = {}
    for name in (name for name in LABELS if name in trajectories):
        trajectory = trajectories[name]
        settled = (
            evaluate_against(trajectory, truth, skip + SETTLED) if truth.t[-1] - truth.t[0] > 2 * SETTLED else None
        )
        document[name] = {
            "session": session.name,
            **asdict(evaluate_against(trajectory, truth, skip)),
            "horizontal_rms_at_fixes_m": at_fixes(trajectory, truth, session),
        }
        if settled is not None:
            angles = ("roll_rms_deg", "pitch_rms_deg", "yaw_rms_deg")
            document[name]["settled"] = {"after_s": SETTLED, **{angle: getattr(settled, angle) for angle in angles}}
    return document, estimates.quality


def _show(path: Path, document: dict[str, Figures]) -> None:
    rows = []
    for text, key, digits in _ROWS:
        factor = 100.0 if "%" in text else 1.0
        cells = [_float(figures[key]) for figures in document.values()]
        rows.append([text, *(number(None if cell is None else cell * factor, digits) for cell in cells)])
    rows.append(["NEES (honest: its dimension)", *(_nees(figures["nees"]) for figures in document.values())])
    print_table(f"{path}: rms error against truth.csv", ["", *(LABELS[name] for name in document)], rows)


def _float(value: object) -> float | None:
    return float(value) if isinstance(value, (int, float)) else None


def _nees(value: object) -> str:
    return f"{value['mean']:.1f} of {value['dimension']}" if isinstance(value, dict) else "-"
