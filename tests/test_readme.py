"""The commands of the README and of the guides run, copied out of them, in their order, in one directory."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from smoother.cli import arguments
from smoother.cli.smoothing import EPILOG, HELP
from smoother.sim.bench import BenchPlan, simulate_bench, write_bench
from smoother.sim.scenario import ImuErrors, MagErrors

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
GUIDES = ("driver", "laps", "calibration", "live", "batch")


def commands(text: str) -> list[str]:
    """Lines of the blocks of shell, without what is explained behind them."""
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [line.partition(" #")[0].strip() for block in blocks for line in block.splitlines()]


OF_GUIDES = [
    command for name in GUIDES for command in commands((ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8"))
]
COMMANDS = [*commands(README), *OF_GUIDES]
SMOOTH = [command for command in COMMANDS if command.startswith("smooth ")]


def test_the_readme_shows_the_commands_people_need() -> None:
    assert {"make demo", "smooth session/", "smooth check session/"} <= set(commands(README))
    assert {"smooth calibrate bench/", "smooth evaluate demo/", "smooth export --list"} <= set(OF_GUIDES)


def test_it_and_the_help_name_every_exit_code() -> None:
    codes = [str(code) for name, code in vars(arguments).items() if name.startswith("EXIT_")]
    assert len(codes) >= 4
    for text in (README, "".join(EPILOG)):
        listed = text.partition("Exit codes:")[2].partition("## How accurate")[0]
        assert {"0", "1", *codes} <= set(re.findall(r"\b\d+\b", listed))


def test_the_help_names_every_kind_of_file_that_can_go_in() -> None:
    table = README.partition("## Your recording")[2].partition("What you know")[0]
    endings = set(re.findall(r"`[*\w]*(\.\w+)`", table))
    assert endings >= {".KLG", ".csv", ".vbo", ".gpx", ".ubx"}
    assert not [ending for ending in endings if ending not in HELP]


def test_its_smooth_commands_run(tmp_path: Path) -> None:
    scripts = Path(sys.executable).parent
    environment = dict(os.environ, PATH=f"{scripts}{os.pathsep}{os.environ['PATH']}", SMOOTH_DEMO_SECONDS="130")
    # the session a reader has recorded
    subprocess.run(
        [scripts / "smooth", "simulate", tmp_path / "session", "--duration", "30"], check=True, capture_output=True
    )
    _record_bench(tmp_path / "bench")
    # and the demo that `make demo` has left
    subprocess.run([scripts / "smooth", "demo", "demo"], cwd=tmp_path, env=environment, check=True, capture_output=True)
    for command in SMOOTH:
        done = subprocess.run(
            command, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{command}: {done.stderr}"
    for name in ("session", "demo"):  # no command takes away what an earlier one has made for the reader
        assert (tmp_path / name / "smoothed" / "report.html").exists()
        assert (tmp_path / name / "smoothed" / "figures" / "overview.png").exists()


def _record_bench(directory: Path) -> None:
    """The calibration recording a reader has made, in a shorter form."""
    plan = BenchPlan(still=62.0, positions=10, rest=5.0, waving=20.0)
    imu = ImuErrors(rate=50.0, accel_noise=0.004, gyro_noise=2e-4)
    mag = MagErrors(rate=25.0, noise=0.01)
    field_n = np.array([22.0, -1.0, -42.0])
    write_bench(simulate_bench(imu, mag, field_n, np.random.default_rng(1), plan), directory)


def test_its_make_commands_exist() -> None:
    if shutil.which("make") is None:
        pytest.skip("needs system package make")
    for command in (command for command in COMMANDS if command.startswith("make ")):
        done = subprocess.run([*command.split(), "--dry-run"], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_everything_else_in_its_shell_blocks_is_known() -> None:
    others = [command for command in COMMANDS if not command.startswith(("smooth ", "make "))]
    assert others == ["source .venv/bin/activate"]


def test_the_files_it_points_to_exist() -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target
