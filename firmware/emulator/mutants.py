"""Mistakes put into the sources, each of which would be the death of a real board: the drive must end with each.

    python firmware/emulator/mutants.py [--only WORDS]

Prints what noticed each. Exit code 0 if the image as it is drives and every mistake is noticed, by the rule that is
meant (rules.h) if there is one; 1 if not; 2 if a tool is missing.
"""

import argparse
import re
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import emulate
import emulation
from altered import Workshop
from emulation import HERE, build
from mutant_table import MUTANTS, Mutant
from smoother.errors import SmootherError
from smoother.sim.record_log import drive_records
from smoother.sim.simulation import Simulation

DRIVE_S = 3.0
STAMPS_US = 100  # by which stamps may follow the sensor at different distances
WATCHDOG_US = (2e6, 6e6)


def read_rules(path: Path = HERE / "rules.h") -> dict[str, str]:
    """Text of each rule by its name."""
    return dict(re.findall(r'RULE\((\w+), "(.+?)"\)', path.read_text()))


class Drive:
    """A short drive with stalls, which every image has to go through."""

    def __init__(self, folder: Path, seed: int = 5, duration: float = DRIVE_S) -> None:
        """Simulate it."""
        self.folder, self.seed = folder, seed
        self.simulation: Simulation = emulate.simulated(seed, duration)
        self.direct, self.emulated = emulate.prepare_folder(self.simulation, folder)

    def find_flaw(self, image: Path) -> str:
        """What is wrong with a drive through an image; empty if nothing is."""
        settings = {"seed": self.seed, "stall_us": 700_000}
        try:
            outcome = emulate.through_firmware(self.simulation, self.emulated, image, **settings)
            return self.judge(outcome)
        except (RuntimeError, SmootherError, ValueError) as error:
            return str(error)

    def judge(self, outcome: emulation.Outcome) -> str:
        """What is wrong with what a run has left."""
        comparison = emulate.compare(self.simulation, self.direct, self.emulated, has_laps=False)
        wanted, (got, _) = drive_records(self.simulation), emulate.recorded(self.emulated)
        text = (self.emulated / "serial.txt").read_bytes()
        flaws = {
            f"not whole: {comparison}": not comparison.is_whole,
            "it was reset": outcome.number("resets") > 0,
            "writes to the file system": outcome.number("metadata_writes") > 0,
            "errors on the card's wires": outcome.number("protocol_errors") + outcome.number("crc_errors") > 0,
            "the watchdog": not WATCHDOG_US[0] < outcome.number("watchdog_us") < WATCHDOG_US[1],
            "the LED": outcome.number("led_changes") == 0,
            "no messages": b"kart logger" not in text or b"state" not in text,
            "stamps": _stamp_spread(wanted.imu, wanted.imu_t, got.imu, got.imu_t) > STAMPS_US,
        }
        return "; ".join(name for name, is_wrong in flaws.items() if is_wrong)


def _stamp_spread(wanted: np.ndarray, wanted_t: np.ndarray, got: np.ndarray, got_t: np.ndarray) -> float:
    """How far apart the errors of the stamps are, us; inf if the first samples are not found."""
    starts = [i for i in range(len(got) - len(wanted) + 1) if (got[i : i + 3] == wanted[:3]).all()]
    return float(np.ptp(got_t[starts[0] : starts[0] + len(wanted_t)] - wanted_t)) if starts else np.inf


def is_meant(mutant: Mutant, flaw: str, rules: dict[str, str]) -> bool:
    """Whether what was found is what the mutant is for."""
    return bool(flaw) and (not mutant.rule or rules[mutant.rule] in flaw)


def run(folder: Path, mutants: tuple[Mutant, ...]) -> bool:
    """Drive with the image as it is and with each mutant; whether all is as it must be."""
    drive, workshop, rules = Drive(folder / "drive"), Workshop(folder / "workshop"), read_rules()
    flaw = drive.find_flaw(workshop.build(()))
    print(f"as it is: {flaw or 'drives'}", flush=True)
    missed = 0
    for mutant in mutants:
        began = time.monotonic()
        flaw = drive.find_flaw(workshop.build(mutant.edits))
        is_noticed = is_meant(mutant, flaw, rules)
        missed += not is_noticed
        seconds = time.monotonic() - began
        print(
            f"{'noticed    ' if is_noticed else 'NOT NOTICED'} {mutant.name} ({seconds:.1f} s): {flaw[:200]}",
            flush=True,
        )
    print(f"{len(mutants)} mistakes, {len(mutants) - missed} noticed")
    return missed == 0


def choose(words: str) -> tuple[Mutant, ...]:
    """Mutants whose name holds the words."""
    return tuple(mutant for mutant in MUTANTS if words in mutant.name)


def main() -> int:
    """Run all that are asked for; the exit code."""
    parser = argparse.ArgumentParser(description="Mistakes put into the sources are noticed")
    parser.add_argument("--only", default="", help="words of the name")
    options = parser.parse_args()
    try:
        build.find_tools()
        emulation.build_emulator()
        with tempfile.TemporaryDirectory() as name:
            return 0 if run(Path(name), choose(options.only)) else 1
    except build.MissingError as error:
        print(f"emulator: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
