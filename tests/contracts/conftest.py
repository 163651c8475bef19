"""Sessions that the contract tests run the command line on, simulated by the command itself and made once.

These tests hold for any inside: of the program they import `run`, the entry point, and nothing else.
"""

import contextlib
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from smoother.cli.main import run

TABLES_ONLY = ("--no-figures", "--no-baseline")


@dataclass(frozen=True)
class Printed:
    """Exit code and both streams of one command."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        """The one JSON document that stdout has to be; NaN and Infinity are not JSON."""

        def refuse(constant: str) -> None:
            raise AssertionError(f"{constant} is not JSON")

        return json.loads(self.out, parse_constant=refuse)

    @property
    def last(self) -> str:
        return self.out.rstrip("\n").splitlines()[-1]


Command = Callable[..., Printed]


@pytest.fixture
def smooth(capsys: pytest.CaptureFixture[str]) -> Command:
    """Run one command line, its words as paths or text."""

    def command(*words: object) -> Printed:
        capsys.readouterr()
        code = run([str(word) for word in words])
        printed = capsys.readouterr()
        return Printed(code, printed.out, printed.err)

    return command


def table(path: Path) -> pl.DataFrame:
    return pl.read_csv(path, infer_schema_length=None)


@pytest.fixture(scope="session")
def read() -> Callable[[Path], pl.DataFrame]:
    """Read a table, NaN and empty cells as they are written."""
    return table


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """130 s of a kart on a track with two timed laps: a turned IMU, an antenna away from it, late fixes, GPS wander."""
    directory = tmp_path_factory.mktemp("drive") / "monday"
    figures = {"gnss.position_latency": 0.2, "gnss.velocity_latency": 0.3, "lever_arm_b": "-0.6,0.3,0.2"}
    settings = [word for name, value in figures.items() for word in ("--set", f"{name}={value}")]
    made = ["simulate", directory, "--track", "tinbarn", "--duration", "130", "--seed", "5", *settings]
    assert run([str(word) for word in made]) == 0
    (directory / "session.toml").write_text('[session]\ntrack = "tinbarn"\n')
    return directory


@pytest.fixture(scope="session")
def smoothed_drive(drive: Path) -> Printed:
    """What `smooth SESSION` prints for `drive`, of which it writes everything."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        code = run([str(drive)])
    return Printed(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def results(drive: Path, smoothed_drive: Printed) -> Path:
    """The folder with everything that `smooth SESSION` writes for `drive`."""
    assert smoothed_drive.code == 0
    return drive / "smoothed"


@pytest.fixture(scope="session")
def summary(results: Path) -> dict[str, Any]:
    return dict(json.loads((results / "summary.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="session")
def trajectory(results: Path) -> pl.DataFrame:
    return table(results / "trajectory.csv")


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a minute of driving that costs little to smooth: white noise, no latencies, axes of the kart."""
    directory = tmp_path_factory.mktemp("simulated") / "tuesday"
    made = ["simulate", str(directory), "--duration", "30", "--seed", "11", "--preset", "white", "--track", "tinbarn"]
    assert run([*made, "--set", "motion.standstill=2"]) == 0
    return directory


@pytest.fixture
def short(simulated: Path, tmp_path: Path) -> Path:
    """A copy of that half minute, to be changed."""
    return Path(shutil.copytree(simulated, tmp_path / "tuesday"))


@pytest.fixture
def fixes_alone(short: Path) -> Path:
    """The fixes of that copy: the quickest session to smooth."""
    for name in ("imu.csv", "mag.csv"):
        (short / name).unlink()
    return short


@pytest.fixture(scope="session")
def short_results(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables of that half minute as it is; what they hold may be compared with those of a changed copy."""
    out = tmp_path_factory.mktemp("short") / "results"
    assert run([str(simulated), "--out", str(out), *TABLES_ONLY]) == 0
    return out
