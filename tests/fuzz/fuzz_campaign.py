"""Damaged sessions by the thousand: readers must end in time, in memory, with a session or with one clear line.

    python tests/fuzz/fuzz_campaign.py --seconds 600           readers
    python tests/fuzz/fuzz_campaign.py --seconds 600 --whole   the whole command

Prints the counts, and for each finding the format and seed that repeat it: `--format log --first 17 --count 1`.
"""

import argparse
import contextlib
import io
import os
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from fuzz_corpus import CORPUS, Files, write_files
from fuzz_mutators import mutate

from smoother.calibration import find_calibration, load_calibration
from smoother.cli.main import run
from smoother.config import SessionConfig
from smoother.errors import SmootherError
from smoother.laps.tracks import load_tracks, named_tracks
from smoother.session.load import load_raw

LONGEST = 10.0  # s of CPU for files of less than a megabyte
CODES = (0, 2, 3)


@dataclass(frozen=True)
class Outcome:
    """What became of one damaged session: `kind` is read, refused, a code of the command, or finding."""

    kind: str
    text: str = ""


def damaged(form: str, seed: int) -> tuple[Files, str]:
    """Return the files of case `seed` of a format and what was done to them."""
    return mutate(CORPUS[form](), np.random.default_rng([seed, sorted(CORPUS).index(form)]))


def check_readers(directory: Path) -> Outcome:
    """Read a session with everything that belongs to it; a finding is any end but a session or one line."""
    since = time.process_time()
    try:
        outcome = Outcome(_read_all(directory))
    except SmootherError as error:
        text = str(error)
        outcome = Outcome("refused", text) if "\n" not in text and len(text) < 2000 else Outcome("finding", text[:500])
    except Exception:
        return Outcome("finding", traceback.format_exc())
    spent = time.process_time() - since
    return outcome if spent < LONGEST else Outcome("finding", f"took {spent:.0f} s")


def _read_all(directory: Path) -> str:
    """Each part for itself, so that one that is refused does not spare the others."""
    refused: list[SmootherError] = []
    config = SessionConfig()
    try:
        config = load_raw(directory).config
    except SmootherError as error:
        refused.append(error)
    for path in sorted(directory.iterdir()):
        try:
            if path.suffix in (".json", ".geojson"):
                load_tracks(path)
            elif path.name == "calibration.toml":
                load_calibration(find_calibration(directory) or path)
        except SmootherError as error:
            refused.append(error)
    if config.track:
        named_tracks(config.track, directory)
    if refused:
        raise refused[0]
    return "read"


def check_command(directory: Path) -> Outcome:
    """Smooth a session as a person would; a finding is a traceback, another code, or more than a line of complaint."""
    since, errors = time.process_time(), io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            code = run([str(directory), "--json", "--no-baseline", "--no-figures"])
    except Exception:
        return Outcome("finding", traceback.format_exc())
    spent, said = time.process_time() - since, errors.getvalue()
    if code not in CODES:
        return Outcome("finding", f"code {code}: {said}")
    if code == 2 and said.count("\n") != 1:
        return Outcome("finding", f"not one line: {said}")
    return Outcome(f"code {code}", said) if spent < 3 * LONGEST else Outcome("finding", f"took {spent:.0f} s")


def main() -> int:
    """Parse the arguments, run, print; the exit code says whether there were findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--format", action="append", choices=sorted(CORPUS), help="default: all")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=10**9, help="number of seeds")
    parser.add_argument("--seconds", type=float, default=60.0, help="stop after so much CPU time")
    parser.add_argument("--whole", action="store_true", help="the whole command instead of the readers")
    parser.add_argument("--keep", type=Path, help="leave the sessions of findings in this directory")
    arguments = parser.parse_args()
    warnings.simplefilter("error")
    check = check_command if arguments.whole else check_readers
    counts: Counter[str] = Counter()
    for seed in range(arguments.first, arguments.first + arguments.count):
        if time.process_time() > arguments.seconds:
            break
        for form in arguments.format or sorted(CORPUS):
            files, done = damaged(form, seed)
            with tempfile.TemporaryDirectory() as name:
                outcome = check(write_files(Path(name) / "session", files))
            counts[outcome.kind] += 1
            if outcome.kind == "finding":
                print(f"--- {form} {seed} ({done})\n{outcome.text}", flush=True)
                if arguments.keep:
                    write_files(arguments.keep / f"{form}-{seed}", files)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{dict(counts)}, {time.process_time():.0f} s of CPU, {peak:.0f} MB at most")
    return int(counts["finding"] > 0)


if __name__ == "__main__":
    sys.exit(main())
