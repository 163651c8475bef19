"""The release image, run instruction by instruction on an emulated board: a short drive, a few power cuts."""

import fcntl
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.session.load import load_raw

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
OUT = FIRMWARE.parent / "build"
sys.path.insert(0, str(FIRMWARE / "emulator"))
import campaign  # noqa: E402
import emulate  # noqa: E402
import emulation  # noqa: E402
from emulation import build  # noqa: E402
from evidence import check_volume, numbered_stimulus  # noqa: E402

DURATION = 12.0  # s


@pytest.fixture(scope="session")
def image():
    """The built image and emulator, one for all processes of the run."""
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / "firmware.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            emulation.build_emulator()
            return emulation.build_image()
        except build.MissingError as error:
            pytest.skip(f"needs system package gcc-arm-none-eabi, and unicorn and FatFs: {error}")


@pytest.fixture(scope="session")
def driven(image, tmp_path_factory):
    """A drive with stalls of up to 700 ms: the simulation, its folders and what was measured."""
    simulation = emulate.simulated(seed=5, duration=DURATION)
    direct, emulated = emulate.prepare_folder(simulation, tmp_path_factory.mktemp("drive"))
    outcome = emulate.through_firmware(simulation, emulated, image, seed=5, stall_us=700_000)
    return simulation, direct, outcome


def test_drive_through_the_image_is_recorded_sample_by_sample_while_the_card_stalls(driven):
    simulation, direct, outcome = driven
    comparison = emulate.compare(simulation, direct, outcome.folder, has_laps=False)
    assert outcome.number("longest_stall_us") == 700_000
    assert comparison.samples == DURATION * 1000
    assert comparison.is_whole, comparison
    assert outcome.number("metadata_writes") == 0, "nothing but blocks is written while recording"


def test_machine_stays_within_its_means(driven):
    *_, outcome = driven
    assert outcome.number("watchdog_resets") == outcome.number("resets") == 0
    assert outcome.number("protocol_errors") == outcome.number("crc_errors") == 0, "what the card had to refuse"
    assert outcome.number("imu_fast_accesses") == 0, "registers are used at 1 MHz at most"
    assert 0.02 < outcome.number("load") < 0.5
    assert 500 < outcome.number("stack_used") < outcome.number("stack_size")
    assert outcome.number("irq6_wait_us") < 100.0, "the stamp of a sample is that of its edge"


def test_stamps_follow_the_sensor_to_some_microseconds(driven):
    simulation, _, outcome = driven
    wanted, (got, _) = emulate.drive_records(simulation), emulate.recorded(outcome.folder)
    first = next(i for i in range(len(got.imu)) if (got.imu[i : i + 3] == wanted.imu[:3]).all())
    late = got.imu_t[first : first + len(wanted.imu_t)] - wanted.imu_t
    assert late.max() - late.min() < 100, "us; another interrupt of the same priority may be in the way"


def test_every_sentence_is_recorded_as_it_was_sent(driven):
    simulation, _, outcome = driven
    got = {sentence for _, sentence in emulate.recorded(outcome.folder)[0].sentences}
    assert {sentence for _, sentence in emulate.drive_records(simulation).sentences} <= got


def test_fixes_of_the_card_have_velocities_with_their_accuracy(driven):
    simulation, _, outcome = driven
    fixes, true = load_raw(outcome.folder).gnss, simulation.raw.gnss
    own, of = np.nonzero(np.abs(fixes.unix_s[:, None] - true.unix_s) < 0.005)
    assert len(own) >= len(true) - 1  # one without a fix follows each outage, in sentences without a time
    np.testing.assert_allclose(fixes.velocity_n[own], true.velocity_n[of], atol=0.0051)
    np.testing.assert_allclose(fixes.sigma_velocity[own], true.sigma_velocity[of], atol=0.0051)


def test_magnetometer_is_recorded_at_the_rate_of_the_thesis(image, tmp_path):
    """At 50 Hz the sensor's I2C master, which set-up needs, works fifty times a second."""
    simulation = emulate.simulated(5, 3.0, **{"imu.rate": 50.0, "imu.jitter": 0.0})
    direct, emulated = emulate.prepare_folder(simulation, tmp_path)
    emulate.through_firmware(simulation, emulated, image)
    comparison = emulate.compare(simulation, direct, emulated, has_laps=False)
    wanted, (got, _) = emulate.drive_records(simulation), emulate.recorded(emulated)
    assert len(wanted.imu) == 150
    assert comparison.equal == 150
    assert len(got.mag) > 100
    assert got.setup is not None
    assert got.setup.mag_who_am_i == 0x48


def test_power_cuts_leave_a_clean_volume_and_what_was_recorded(image, tmp_path):
    try:
        build.find_tools(("fsck.fat",))
    except build.MissingError:
        pytest.skip("needs system package dosfstools")
    cuts = campaign.run_cuts(tmp_path, campaign.world_of(image, seed=3), count=6, seed=3)
    assert {cut.plan.phase for cut in cuts} == set(campaign.PHASES)
    assert [cut for cut in cuts if cut.complaints] == []


def test_recording_that_lacks_a_sample_is_noticed(driven, tmp_path):
    simulation, direct, outcome = driven
    name = max(outcome.recordings, key=lambda path: path.stat().st_size).name
    data = (outcome.folder / name).read_bytes()
    (tmp_path / name).write_bytes(data[: 100 * 512] + data[101 * 512 :])
    comparison = emulate.compare(simulation, direct, tmp_path, has_laps=False)
    assert not comparison.is_whole
    assert comparison.losses.blocks == 1


def test_direct_log_keeps_what_the_recording_spans(driven):
    _, direct, outcome = driven
    wanted, (got, _) = emulate.recorded(direct)[0], emulate.recorded(outcome.folder)
    whole = emulate.part_recorded(wanted, got)
    assert len(whole.imu) == len(wanted.imu), "the recording begins before the session and ends after it"
    inner = slice(2000, -2000)
    first = next(i for i in range(len(got.imu)) if (got.imu[i] == wanted.imu[0]).all())
    middle = slice(first + 2000, first + len(wanted.imu) - 2000)
    sentences = tuple(s for s in got.sentences if got.imu_t[middle][0] < s[0] < got.imu_t[middle][-1])
    shorter = replace(got, imu_t=got.imu_t[middle], imu=got.imu[middle], sentences=sentences)
    part = emulate.part_recorded(wanted, shorter)
    assert np.array_equal(part.imu_t, wanted.imu_t[inner])
    simulated = {text for _, text in wanted.sentences}  # the others say that there is no fix
    assert [text for _, text in part.sentences] == [text for _, text in sentences if text in simulated]


def test_every_write_of_a_life_belongs_to_a_phase():
    entry, block, table = 100, 200, 10
    sectors = [entry, table, entry, entry, block, block, table, entry, entry, table, entry, entry, block]
    assert campaign.label_writes(np.array(sectors), entry, block) == [
        *[campaign.SPARE] * 3,
        *[campaign.RENAME, campaign.LOGGING, campaign.LOGGING, campaign.STOP, campaign.STOP],
        *[campaign.SPARE] * 3,
        *[campaign.RENAME, campaign.LOGGING],
    ]


def test_what_a_power_cut_may_not_do_is_noticed(driven):
    *_, outcome = driven
    whole = max(outcome.recordings, key=lambda path: path.stat().st_size).read_bytes()
    records, _ = emulate.recorded(outcome.folder)
    begun, ended = int(records.imu_t[0]) - 540_000, int(records.imu_t[-1])

    def judged(data: bytes, cut_us: int) -> str:
        return campaign.judge_recording(data, whole, (begun, ended), cut_us, campaign.TAIL_MS)[0]

    blocks = campaign.find_blocks(whole)[0]
    cut_us = int(blocks.base_us[len(blocks.base_us) // 2]) + 5_000
    written = int(np.searchsorted(blocks.base_us, cut_us)) - 2  # one is being filled, one on its way
    assert judged(whole[: 512 * written], cut_us) == ""
    assert "are lost" in judged(whole[: 512 * (written - 2)], cut_us)
    assert "not what was recorded" in judged(whole[: 512 * written - 1] + b"?", cut_us)
    assert judged(whole, ended + 3_000_000) == ""
    assert "has changed" in judged(whole[:-512], ended + 3_000_000)
    assert campaign.judge_next([whole]) != "", "its clock did not begin anew"


def said_by_selftest(folder: Path) -> list[str]:
    return [line for line in (folder / "serial.txt").read_text(errors="replace").splitlines() if "selftest" in line]


def test_selftest_tries_each_part_and_leaves_the_card_as_it_was(image, tmp_path):
    script = emulation.Script({}, ["autostart=no"], [(5_000_000, "type"), (11_500_000, "type"), (12_500_000, "end")])
    script.press(10_500_000)
    outcome = emulation.run(tmp_path / "run", image, numbered_stimulus(13.0), script)
    heard, imu, magnetometer, card, gps, done, refused = said_by_selftest(outcome.folder)
    assert (heard, done) == ("selftest: heard; the LED is on until the end", "selftest: done")
    samples = re.fullmatch(r"selftest imu: well, id 71, (\d+) samples in a second, on the pin INT", imu)
    assert samples is not None and 990 <= int(samples[1]) <= 1010
    assert magnetometer == "selftest magnetometer: well, id 48"
    speed = re.fullmatch(r"selftest card: well, (\d+) kB/s, longest busy (\d+) us, sent again 0", card)
    assert speed is not None and 300 < int(speed[1]) < 1000 and 1000 < int(speed[2]) < 20_000
    assert gps == "selftest gps: well, 57600 baud, settings refused 0, fix"
    assert refused == "selftest: stop the recording first"
    assert check_volume(outcome.folder / "card.img") == ""


def test_selftest_names_the_parts_that_are_missing(image, tmp_path):
    faults = ("card_absent 1", "imu_absent 1", "gps_absent 1")
    actions = [*((0, fault) for fault in faults), (5_000_000, "type"), (9_000_000, "end")]
    outcome = emulation.run(tmp_path / "run", image, numbered_stimulus(10.0), emulation.Script({}, [], actions))
    _, imu, magnetometer, card, gps, _ = said_by_selftest(outcome.folder)
    assert imu.startswith("selftest imu: BAD, id ff, 0 samples") and magnetometer.startswith(
        "selftest magnetometer: NONE"
    )
    assert card == "selftest card: BAD, -3 -1" and gps.startswith("selftest gps: SILENT, 0 baud")
