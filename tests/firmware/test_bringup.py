"""The page of the first start says what the image says: some of its rows, run again."""

import fcntl
import sys
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
OUT = FIRMWARE.parent / "build"
sys.path.insert(0, str(FIRMWARE / "emulator"))
import bringup  # noqa: E402
import emulation  # noqa: E402
from emulation import build  # noqa: E402

SELECTION = ("all is well", "card missing", "IMU's NCS", "receiver's RX")


@pytest.fixture(scope="module")
def image():
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / "firmware.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            emulation.build_emulator()
            return emulation.build_image()
        except build.MissingError as error:
            pytest.skip(f"needs system package gcc-arm-none-eabi, and unicorn and FatFs: {error}")


@pytest.mark.parametrize("words", SELECTION)
def test_row_of_the_page_is_that_of_the_image(image, tmp_path, words):
    (fault,) = (fault for fault in bringup.FAULTS if fault.name.startswith(words))
    row = bringup.row_of(fault, tmp_path / "run", image)
    assert row in bringup.PAGE.read_text().splitlines()


def test_page_has_a_row_for_every_fault_and_no_two_say_the_same_but_where_stated():
    lines = bringup.PAGE.read_text().split("\n\n")[2].splitlines()
    rows = [line for line in lines if line.startswith("| ")][1:]
    assert [row.split(" | ")[0].removeprefix("| ") for row in rows] == [fault.name for fault in bringup.FAULTS]
    said = [row.split(" | ", 1)[1] for row in rows if "no difference" not in row and "noise" not in row]
    assert len(set(said)) == len(said)


def test_what_differs_from_run_to_run_is_left_out():
    text = (
        "old\n[power off and on at 3 us]\nrecording a1\n5 s: state 3, 7 samples\n10 s: state 3, 9 samples\nevent 13 1\n"
    )
    assert bringup.lines_of(text) == ["recording ..", "5 s: state 3, .."]
