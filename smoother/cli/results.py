"""The results of a session, which is smoothed first where they are missing or outdated."""

from __future__ import annotations

from pathlib import Path

from smoother.cli.directories import TRAJECTORY, holds_results, read_summary, usual_output
from smoother.cli.output import Progress, no_progress, warn
from smoother.cli.pipeline import Options, files_beside, require_recording, smooth_session


def results_of(path: Path, progress: Progress = no_progress) -> tuple[Path, bool]:
    """Return the directory of the results of a session, and whether they passed the quality gate.

    Smooths with the usual options where results are missing, of another recording in the same place, older than any
    file of the session, or made from other files.
    """
    require_recording(path)
    directory = usual_output(path)
    document = read_summary(directory)
    if document is not None and _is_current(path, directory, document):
        passed, reasons = _verdict(document)
    else:
        result = smooth_session(path, None, Options(), progress)
        directory, passed, reasons = result.directory, result.quality.passed, list(result.quality.reasons)
    if not passed:
        warn(f"{path}: the result failed its quality gate: {'; '.join(reasons)}")
    return directory, passed


def _is_current(path: Path, directory: Path, document: dict[str, object]) -> bool:
    from smoother.session.files import list_files

    if not holds_results(directory):
        return False
    files, about = list_files(path), document.get("session")
    if not isinstance(about, dict) or about.get("name") != files.session_name():
        return False
    now, then = files_beside(path), document.get("files")
    if then is not None and then != now:  # a file was added, removed, or replaced by an older one
        return False
    written = (directory / TRAJECTORY).stat().st_mtime
    return all((files.directory / name).stat().st_mtime <= written for name in now)


def _verdict(document: dict[str, object]) -> tuple[bool, list[str]]:
    quality = document.get("quality")
    if not isinstance(quality, dict):
        return False, ["summary.json has no verdict"]
    return quality.get("passed") is True, [str(reason) for reason in quality.get("reasons") or ()]
