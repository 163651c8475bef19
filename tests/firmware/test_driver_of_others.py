"""The host tests' model of the card under a driver that others wrote: crate embedded-sdmmc."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CRATE = ROOT / "firmware" / "emulator" / "driver_of_others"
LONGEST_S = 300.0
KINDS = ("version 1", "version 2", "high capacity")
LINE = re.compile(r"(.+), sums (on|off), a flip in (\d+): 401 sectors as written, (\d+) bits flipped, (\d+) refused .*")


def cargo(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = ["cargo", *arguments, "--quiet", "--locked", "--manifest-path", str(CRATE / "Cargo.toml")]
    environment = os.environ | {"CARGO_TARGET_DIR": str(ROOT / "build" / "driver_of_others")}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LONGEST_S)


def test_strangers_driver_understands_the_card_and_its_sums():
    if shutil.which("cargo") is None or cargo("fetch").returncode != 0:
        pytest.skip("needs system package cargo, and the crate embedded-sdmmc")
    run = cargo("run")
    assert run.returncode == 0, run.stdout + run.stderr
    rows = [match.groups() for match in map(LINE.fullmatch, run.stdout.splitlines()) if match]
    assert [row[0] for row in rows] == [kind for kind in KINDS for _ in range(4)]
    for _, sums, flip_every, flipped, refused in rows:
        is_disturbed = flip_every != "0"
        assert sums == "on" or not is_disturbed
        assert (int(flipped) > 50) == is_disturbed
        assert (int(refused) > 10) == is_disturbed
