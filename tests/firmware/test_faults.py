"""Faults happen to the release image on the emulated board: a few of the campaign's cases, and that they can fail."""

import fcntl
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
OUT = FIRMWARE.parent / "build"
sys.path.insert(0, str(FIRMWARE / "emulator"))
import emulation  # noqa: E402
import evidence  # noqa: E402
import expectations  # noqa: E402
import fault_cases  # noqa: E402
import faults  # noqa: E402
from emulation import build  # noqa: E402
from smoother.session.log_decode import Losses  # noqa: E402
from smoother.session.log_format import IMU, Gap, LogRecords  # noqa: E402

SELECTION = (
    "loose: away for 0.1 s",
    "another card is put in",
    "write-protected from the start",
    "noise between the sentences",
    "WHO_AM_I FF",
    "measures the same",
    "main loop stuck: main loop stuck",
    "an interrupt before every instruction",
)


@pytest.fixture(scope="session")
def image():
    """The built image and emulator, one for all processes of the run."""
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / "firmware.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            emulation.build_emulator()
            build.find_tools(("fsck.fat",))
            return emulation.build_image()
        except build.MissingError as error:
            pytest.skip(f"needs system packages gcc-arm-none-eabi and dosfstools, and unicorn and FatFs: {error}")


@pytest.mark.parametrize("words", SELECTION)
def test_fault_is_shown_recorded_and_survived_as_stated(image, tmp_path, words):
    (case,) = faults.choose(fault_cases.CASES, words, is_quick=True)
    assert faults.run_case(case, tmp_path / "run", image).flaws == ()


def test_campaign_notices_a_fault_where_none_was_expected(image, tmp_path):
    case = replace(fault_cases.AS_EVER, actions=((6, "card_absent 1"), (8, "card_absent 0")))
    flaws = " ".join(text for text, _ in faults.run_case(case, tmp_path / "run", image).flaws)
    assert "every sample" in flaws
    assert "LED: recording" in flaws
    assert "no EVENT" in flaws
    assert "in 1 file" in flaws


def test_every_case_has_a_name_of_its_own_and_expects_something():
    names = [f"{case.row}: {case.name}" for case in fault_cases.CASES]
    assert len(set(names)) == len(names)
    assert all(case.expects for case in fault_cases.CASES)


def test_samples_tell_their_number_and_others_do_not():
    samples = evidence.numbered(100_000, 6)
    assert np.array_equal(evidence.numbers_of(samples), np.arange(100_000))
    samples[500, 4] ^= 1
    assert evidence.numbers_of(samples)[500] == -1
    assert evidence.numbers_of(np.full((1, 6), 7, dtype=np.int16))[0] == -1


def blink(folder, period_s, flash_s, flashes, seconds=20.0):
    """Write the changes of an LED and return the evidence of it."""
    starts = [n * period_s + i * 2 * flash_s for n in range(int(seconds / period_s)) for i in range(flashes)]
    rows = [f"{(start + 0.123 + off) * 1e6:.0f} {on}" for start in starts for off, on in ((0, 1), (flash_s, 0))]
    (folder / "led.txt").write_text("\n".join(rows) + "\n")
    return evidence.Evidence(emulation.Outcome(folder, {}, 0.0))


@pytest.mark.parametrize("name", [name for name in evidence.LED_PATTERNS if name not in ("on", "dark")])
def test_pattern_of_the_led_is_recognised(tmp_path, name):
    seen = blink(tmp_path, *evidence.LED_PATTERNS[name])
    assert seen.led(3.0, 9.0) == name
    assert seen.led(25.0, 30.0) == "dark"


def test_led_that_changes_its_pattern_shows_none(tmp_path):
    assert blink(tmp_path, *evidence.LED_PATTERNS["card missing"]).led(17.0, 23.0) == ""


def test_only_gaps_at_the_right_time_tell_of_a_sample():
    number = np.delete(np.arange(1000), [300, 301, 302])
    imu = evidence.numbered(1000, 6)[number]
    gap = Gap(IMU, 1, 3, 301_000, 303_000)
    records = LogRecords(imu_t=(number + 1) * 1000, imu=imu, gaps=(gap,))
    seen = evidence.account(records)
    assert (seen.missing, seen.told, seen.untold, seen.strange, seen.disorder) == (3, 3, 0, 0, 0)
    late = replace(gap, first_us=401_000, last_us=403_000)
    assert evidence.account(replace(records, gaps=(late,))).untold == 3
    flaw = expectations.all_told(0.1, 0.9, lost=(3, 3)).find_flaw
    recording = evidence.Recording(("LOG00001.KLG",), replace(records, gaps=(late,)), Losses())
    assert flaw(type("Seen", (), {"recordings": (recording,)}))
