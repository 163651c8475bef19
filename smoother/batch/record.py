"""batch.json beside the results of a session: from what they were made, so that they need not be made again."""

import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import smoother
from smoother.batch import outcome
from smoother.batch.outcome import Outcome
from smoother.batch.task import REPORT, SUMMARY, TRAJECTORY, Task, is_there
from smoother.documents import load_json, replacing
from smoother.errors import SmootherError

FILE_NAME = "batch.json"
FORM = 2


def finished(task: Task) -> Outcome | None:
    """Return the outcome of a session that need not be smoothed again, else None.

    It need not if it has results, these lie there as the batch left them, and neither the files they were made from,
    nor the arguments, nor the version of this program have changed.
    """
    try:
        document = load_json(task.out / FILE_NAME)
        made_by = (document["form"], document["version"], tuple(document["arguments"]))
        known, results = document["inputs"], document["results"]
        kept = outcome.from_plain(document["outcome"])
    except (SmootherError, KeyError, TypeError, ValueError):
        return None
    if made_by != (FORM, smoother.__version__, task.arguments) or not kept.has_results:
        return None
    if known != digests(task.inputs, task.folder) or results != digests(_sealed(task.out), task.out):
        return None
    return kept if _are_whole(task) else None


def digests(paths: Iterable[Path], folder: Path) -> dict[str, str]:
    """Return the SHA-256 of files by their names as seen from `folder`; a file that cannot be read has none."""
    found = {}
    for path in paths:
        try:
            with path.open("rb") as file:
                found[os.path.relpath(path, folder)] = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError:
            continue
    return found


def keep(task: Task, inputs: dict[str, str], made: Outcome) -> None:
    """Write the record of a session; `inputs` are the digests of its files before it was read. Raises OSError."""
    document = {
        "form": FORM,
        "version": smoother.__version__,
        "arguments": task.arguments,
        "inputs": inputs,
        "results": digests(_sealed(task.out), task.out),
        "outcome": asdict(made),
    }
    with replacing(task.out / FILE_NAME) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _sealed(out: Path) -> tuple[Path, ...]:
    """summary.json is written last, and by every run: it represents all results."""
    return (out / SUMMARY,)


def _are_whole(task: Task) -> bool:
    wanted = (TRAJECTORY, *(() if "--no-figures" in task.arguments else (REPORT,)))
    return all(is_there(task.out / name) for name in wanted)
