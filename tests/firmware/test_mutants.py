"""The emulated chip obeys the manual: eight mistakes that would kill a board end a drive, and every rule has one."""

import fcntl
import re
import sys
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
OUT = FIRMWARE.parent / "build"
sys.path.insert(0, str(FIRMWARE / "emulator"))
import emulation  # noqa: E402
import mutants  # noqa: E402
from altered import Edit, Workshop  # noqa: E402
from emulation import build  # noqa: E402
from mutant_table import MUTANTS, Mutant  # noqa: E402

SELECTION = (
    "clock of GPIOA",
    "clock of SPI1",
    "clock of DMA",
    "no wait states of the flash",
    "PLL x 16",
    "SPI without SSI",
    "SPI mode 1 for the card",
    "watchdog never unlocked",
)
SOURCE = re.compile(r"(RM0008|PM0056|PM0075|DS5319|SD|PS|RM-MPU-9250A) \d+(\.\d+)*")


@pytest.fixture(scope="module")
def drive_and_workshop(tmp_path_factory):
    """A drive and a copy of the sources to put mistakes in."""
    OUT.mkdir(parents=True, exist_ok=True)
    folder = tmp_path_factory.mktemp("mutants")
    with (OUT / "firmware.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            build.find_tools()
            emulation.build_emulator()
            return mutants.Drive(folder / "drive"), Workshop(folder / "workshop")
        except build.MissingError as error:
            pytest.skip(f"needs system package gcc-arm-none-eabi, and unicorn and FatFs: {error}")


def find(name: str) -> Mutant:
    (found,) = (mutant for mutant in MUTANTS if mutant.name == name)
    return found


def test_image_as_it_is_breaks_no_rule(drive_and_workshop):
    drive, workshop = drive_and_workshop
    assert drive.find_flaw(workshop.build(())) == ""


@pytest.mark.parametrize("name", SELECTION)
def test_mistake_ends_the_drive_by_the_rule_it_breaks(drive_and_workshop, name):
    drive, workshop = drive_and_workshop
    mutant = find(name)
    flaw = drive.find_flaw(workshop.build(mutant.edits))
    assert mutants.read_rules()[mutant.rule] in flaw
    assert re.search(r" at 0800[0-9a-f]{4}$", flaw), "the place in the image"


def test_every_rule_has_a_mistake_that_breaks_it_with_its_place():
    rules = mutants.read_rules()
    assert len(rules) > 40
    assert {mutant.rule for mutant in MUTANTS} - {""} == set(rules)
    assert [text for text in rules.values() if not SOURCE.match(text)] == []


def test_names_differ_and_every_place_is_there_once():
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)
    for mutant in MUTANTS:
        for edit in mutant.edits:
            assert (FIRMWARE / edit.file).read_text().count(edit.old) == 1, mutant.name


def test_mistake_that_another_rule_notices_is_not_taken_for_noticed():
    rules = mutants.read_rules()
    assert mutants.is_meant(find("PLL x 16"), f"fault {rules['PLL_TOO_FAST']}", rules)
    assert not mutants.is_meant(find("PLL x 16"), f"fault {rules['NO_CLOCK']}", rules)
    assert not mutants.is_meant(Mutant("none", "", (Edit("", "", ""),)), "", rules)
