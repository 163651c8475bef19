"""The firmware's drivers and the whole logger on this machine: against models of the chips, under sanitizers.

The programs are built from firmware/ with CMake, which fetches FatFs by its hash; `test_cuts every` ends the power at
every write of a life from the first boot to the end of a second recording.
"""

import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from smoother.session.log import list_recordings, read_records
from smoother.session.log_decode import Losses
from smoother.session.log_format import IMU

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
SOURCES = FIRMWARE / "tests" / "drivers"
FOLDER = FIRMWARE.parent / "build" / "host-tests"
sys.path.insert(0, str(FIRMWARE))
import build  # noqa: E402

HANGS_AFTER = 1800  # s; half a minute is enough on a machine that does nothing else
VOLUME_AT = 1 << 20  # where the volume begins on a card
PROGRAMS = ("sdcard", "mpu9250", "neo6m", "app")


def names_of(program: str) -> list[str]:
    """Names of the tests of a program, as its table has them."""
    rows = (SOURCES / f"test_{program}.c").read_text().splitlines()
    return [row.strip().removeprefix("TEST(").rstrip("),") for row in rows if row.strip().startswith("TEST(")]


@pytest.fixture(scope="session")
def programs():
    """Folder of the built test programs, one for all processes of the run; what is there already is not built again."""
    if not (shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")):
        pytest.skip("needs system package gcc")
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            build.find_tools(("cmake", "make"))
            fatfs = build.find_fatfs(build.FATFS_CACHE)
        except build.MissingError as error:
            pytest.skip(f"needs system package cmake, and FatFs: {error}")
        configure = ["cmake", "-S", str(FIRMWARE), "-B", str(FOLDER), "-G", "Unix Makefiles"]
        build.run([*configure, "-DSANITIZE=ON", "-DCMAKE_BUILD_TYPE=RelWithDebInfo", f"-DFATFS_DIR={fatfs}"])
        build.run(["cmake", "--build", str(FOLDER), "--parallel", "2"])
    return FOLDER / "tests" / "drivers"


def run(programs, program, *arguments):
    done = subprocess.run(
        [programs / f"test_{program}", *arguments],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=HANGS_AFTER,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


@pytest.mark.parametrize(("program", "name"), [(program, name) for program in PROGRAMS for name in names_of(program)])
def test_on_models(programs, program, name):
    run(programs, program, name)


def test_power_may_fail_at_every_write(programs):
    words = run(programs, "cuts", "every").split()
    assert int(words[2]) > 500, "lives"


def test_every_listed_test_exists(programs):
    for program in PROGRAMS:
        assert run(programs, program).split() == names_of(program)


def test_file_systems_made_and_left_here_please_fsck(programs, tmp_path):
    """The check the power cuts are judged by was written here; this lets a stranger's judge a sample of its cards."""
    try:
        build.find_tools(("fsck.fat",))
    except build.MissingError:
        pytest.skip("needs system package dosfstools")
    for cut_at, torn in ((3, 27), (9, 0), (20, 256), (70, 511), (100, 0), (150, 300)):
        image = tmp_path / "card.img"
        run(programs, "cuts", "save", str(cut_at), str(torn), str(image))
        # the volume stands behind a partition table: give fsck the volume alone
        volume = tmp_path / "volume.img"
        _cut_out(image, VOLUME_AT, volume)
        done = subprocess.run([build.find_tool("fsck.fat"), "-n", str(volume)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout
        image.unlink()
        volume.unlink()


def _cut_out(image: Path, first: int, volume: Path) -> None:
    """Copy what lies in `image` from byte `first` on, but for its holes: nearly all of its gigabytes are one."""
    with image.open("rb") as card, volume.open("wb") as out:
        size = os.fstat(card.fileno()).st_size
        out.truncate(size - first)
        end = first
        while end < size:
            try:
                begin = os.lseek(card.fileno(), end, os.SEEK_DATA)
            except OSError:  # a hole up to the end
                return
            end = os.lseek(card.fileno(), begin, os.SEEK_HOLE)
            out.seek(begin - first)
            out.write(os.pread(card.fileno(), end - begin, begin))


def test_reader_finds_what_the_logger_recorded(programs, tmp_path):
    path = tmp_path / "LOG00001.KLG"
    words = run(programs, "app", "save", str(path)).split()
    told = dict(zip(words[::2], map(int, words[1::2]), strict=True))
    (recording,) = list_recordings([path])
    records, losses = read_records(recording)
    assert losses == Losses()
    assert len(records.imu) == told["imu"]
    assert len(records.mag) == told["mag"]
    assert len(records.sentences) == told["gps"]
    assert sum(gap.count for gap in records.gaps if gap.source == IMU) == told["gap"] > 0
    assert records.stop is not None
    assert records.stop.imu_records == told["imu"]
    # what is missing from the even row of times is what the gaps say
    periods = np.round(np.diff(records.imu_t) / 1000).astype(int)
    assert (periods - 1).sum() == told["gap"]
    assert "imu_rate=1000" in records.config
