"""batch.json beside the results of a session: from what they were made, so that they need not be made again."""

import json
from dataclasses import asdict
from pathlib import Path

import smoother
from smoother.batch import outcome, stamps
from smoother.batch.outcome import Outcome
from smoother.batch.stamps import Stamp
from smoother.batch.task import REPORT, SUMMARY, TRAJECTORY, Task, is_there
from smoother.documents import load_json, replacing
from smoother.errors import SmootherError

FILE_NAME = "batch.json"
FORM = 1


def finished(task: Task) -> Outcome | None:
    """Return the outcome of a session that need not be smoothed again, else None.

    It need not if it has results, these lie there as the batch left them, and neither the files they were made from,
    nor the arguments, nor the version of this program have changed.
    """
    try:
        document = load_json(task.out / FILE_NAME)
        made_by = (document["form"], document["version"], tuple(document["arguments"]))
        known, results = stamps.from_plain(document["inputs"]), stamps.from_plain(document["results"])
        said = outcome.from_plain(document["outcome"])
    except (SmootherError, KeyError, TypeError, ValueError):
        return None
    if made_by != (FORM, smoother.__version__, task.arguments) or not said.has_results:
        return None
    if not stamps.are_unchanged(known, task.inputs, task.folder):
        return None
    return said if stamps.are_unchanged(results, _sealed(task.out), task.out) and _are_whole(task) else None


def keep(task: Task, inputs: dict[str, Stamp], said: Outcome) -> None:
    """Write the record of a session; `inputs` as stamped before it was read. Raises OSError."""
    document = {
        "form": FORM,
        "version": smoother.__version__,
        "arguments": task.arguments,
        "inputs": stamps.to_plain(inputs),
        "results": stamps.to_plain(stamps.stamps(_sealed(task.out), task.out)),
        "outcome": asdict(said),
    }
    with replacing(task.out / FILE_NAME) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _sealed(out: Path) -> tuple[Path, ...]:
    """summary.json is written last, and by every run: it stands for all of the results."""
    return (out / SUMMARY,)


def _are_whole(task: Task) -> bool:
    wanted = (TRAJECTORY, *(() if "--no-figures" in task.arguments else (REPORT,)))
    return all(is_there(task.out / name) for name in wanted)
