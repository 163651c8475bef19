"""The firmware's card layer on QEMU's machine and card, which others wrote."""

import sys
from pathlib import Path

import numpy as np
import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
sys.path.insert(0, str(FIRMWARE / "emulator"))
import qemu_card  # noqa: E402
from emulation import build  # noqa: E402


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    try:
        qemu_card.find_tools()
        return qemu_card.build_program(tmp_path_factory.mktemp("qemu"))
    except build.MissingError as error:
        pytest.skip(
            f"needs system packages qemu-system-arm, dosfstools and mtools, gcc-arm-none-eabi and FatFs: {error}"
        )


def test_strangers_card_takes_recordings_that_strangers_can_read(program, tmp_path):
    opinion = qemu_card.run_starts(tmp_path, program, starts=3)
    assert opinion.complaints == ()
    assert opinion.recordings == 5
    assert opinion.samples > 3 * qemu_card.ENDED_SAMPLES


def test_recordings_survive_that_the_machine_is_killed(program, tmp_path):
    assert qemu_card.run_cuts(tmp_path, program, cuts=2, rng=np.random.default_rng(5)).complaints == ()


def test_damaged_recording_is_noticed(program, tmp_path):
    image = tmp_path / "card.img"
    qemu_card.make_card(image)
    qemu_card.start(program, image)
    data = qemu_card.read_files(image)["LOG00001.KLG"]
    assert qemu_card.judge_recording("as it is", data, qemu_card.ENDED_SAMPLES)[1] == ""
    for flawed in (data[:-512], data[:5120] + data[5632:], data[:5200] + b"?" + data[5201:]):
        assert qemu_card.judge_recording("flawed", flawed, qemu_card.ENDED_SAMPLES)[1] != ""
