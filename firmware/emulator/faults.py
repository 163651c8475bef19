"""The fault campaign: every row of the fault table (DESIGN.md, sections 4 and 7) happens to the release image.

    python firmware/emulator/faults.py [--only WORDS] [--quick] [--random 40]
    python firmware/emulator/faults.py --bugs            # bugs put in on purpose are noticed

Each case states what the LED, the messages and the recordings must show, and what is kept; that is compared with what
the run left, and `fsck.fat` is asked. Then so many lives with faults at random. Prints the counts; exit code 0; 1 if an
expectation is not met; 2 if a tool is missing.
"""

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import emulation
from altered import Workshop
from emulation import build
from evidence import Evidence, numbered_stimulus
from expectations import Case, always
from fault_bugs import BUGS
from fault_cases import CASES
from fault_lives import random_cases
from insides import resolve


@dataclass(frozen=True)
class Verdict:
    """A case, the flaws found (text of the expectation, what was seen), and what it took."""

    case: Case
    flaws: tuple[tuple[str, str], ...]
    expectations: int
    samples: int
    simulated_s: float


def run_case(case: Case, folder: Path, image: Path, program: Path = emulation.PROGRAM) -> Verdict:
    """Run a case and compare what it left with what it must leave. FileNotFoundError without the image."""
    if not image.exists():
        raise FileNotFoundError(image)
    shutil.rmtree(folder, ignore_errors=True)
    expects = case.expects + always(case)
    stimulus, script = numbered_stimulus(case.duration), case.script()
    script.actions = [(t, resolve(line, image)) for t, line in script.actions]
    try:
        seen = Evidence(emulation.run(folder, image, stimulus, script, program))
    except RuntimeError as error:
        return Verdict(case, (("the machine meets no fault", str(error)),), len(expects), 0, case.duration)
    flaws = [(expected.text, expected.find_flaw(seen)) for expected in expects]
    samples = sum(found.account.recorded for found in seen.recordings)
    return Verdict(
        case,
        tuple((text, flaw) for text, flaw in flaws if flaw),
        len(expects),
        samples,
        seen.outcome.number("simulated_s"),
    )


def report(verdicts: Iterable[Verdict], is_loud: bool = True) -> bool:
    """Print each case with what it stated, and the counts; whether everything was met."""
    done = []
    for verdict in verdicts:
        done.append(verdict)
        case = verdict.case
        print(f"{'ok    ' if not verdict.flaws else 'FAILS '} {case.row}: {case.name}", flush=True)
        for expected in case.expects if is_loud else ():
            print(f"         {expected.text}")
        for text, flaw in verdict.flaws:
            print(f"    not so: {text}: {flaw}")
    rows = {verdict.case.row for verdict in done}
    bad = sum(bool(verdict.flaws) for verdict in done)
    print(
        f"{len(done)} cases of {len(rows)} rows, {sum(v.expectations for v in done)} expectations,"
        f" {sum(len(v.flaws) for v in done)} not met in {bad} cases;"
        f" {sum(v.samples for v in done)} samples compared, {sum(v.simulated_s for v in done):.0f} s simulated"
    )
    return bad == 0


def run_bugs(folder: Path, image: Path) -> bool:
    """The image as it is must pass the case meant for each bug, the image with the bug must not."""
    is_good, workshop = True, Workshop(folder / "workshop")
    for name, bug, words in BUGS:
        (case,) = choose(CASES, words, is_quick=False)
        before = run_case(case, folder / "run", image)
        after = run_case(case, folder / "run", workshop.build([bug]))
        is_noticed = not before.flaws and bool(after.flaws)
        print(f"{'noticed    ' if is_noticed else 'NOT NOTICED'} {name}: {case.row}: {case.name}", flush=True)
        for text, flaw in after.flaws[:2] if is_noticed else before.flaws:
            print(f"    not so: {text}: {flaw[:300]}")
        is_good = is_good and is_noticed
    print(f"{len(BUGS)} bugs put in on purpose, {'all' if is_good else 'NOT all'} noticed")
    return is_good


def choose(cases: Iterable[Case], word: str, is_quick: bool) -> list[Case]:
    """Cases whose name or row holds a word; without the long ones if it is to be quick."""
    return [case for case in cases if word in f"{case.row}: {case.name}" and not (is_quick and case.is_long)]


def main() -> int:
    """Run the campaign; the exit code."""
    parser = argparse.ArgumentParser(description="Every fault of the table happens to the release image")
    parser.add_argument("--only", default="", help="cases whose name or row holds this")
    parser.add_argument("--quick", action="store_true", help="without the cases that take minutes")
    parser.add_argument("--random", type=int, default=40, help="lives with faults at random")
    parser.add_argument("--bugs", action="store_true", help="put bugs in instead: each must be noticed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--image", type=Path, help="another logger.bin than the one built here")
    parser.add_argument("--keep", type=Path, help="folder to leave the last run in")
    options = parser.parse_args()
    try:
        emulation.build_emulator()
        image = options.image or emulation.build_image()
        build.find_tools(("fsck.fat",))
    except build.MissingError as error:
        print(f"emulator: {error}", file=sys.stderr)
        return 2
    lives = random_cases(options.random, np.random.default_rng(options.seed))
    chosen = choose([*CASES, *lives], options.only, options.quick)
    with tempfile.TemporaryDirectory() as name:
        if options.bugs:
            return 0 if run_bugs(Path(name), image) else 1
        folder = options.keep or Path(name) / "run"
        return 0 if report(run_case(case, folder, image) for case in chosen) else 1


if __name__ == "__main__":
    sys.exit(main())
