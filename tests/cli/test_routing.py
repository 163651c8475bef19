"""Which command is meant: a path that exists is a session, whatever its name."""

import subprocess
import sys
from pathlib import Path

import pytest

from smoother.cli.checking import check
from smoother.cli.commands import COMMAND_NAMES, named_command
from smoother.cli.demo import demo
from smoother.cli.directories import FIGURE_NAMES
from smoother.cli.main import choose, run
from smoother.cli.simulating import PRESETS, TRACKS
from smoother.cli.smoothing import output_directories, smooth
from smoother.sim import presets, track


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_command_is_a_command_where_no_path_has_its_name(here: Path) -> None:
    assert choose(["check", "monday"]) == (check, ["monday"], "smooth check")
    assert choose(["demo"]) == (demo, [], "smooth demo")


def test_a_lone_path_is_a_session_even_if_it_is_called_like_a_command(here: Path) -> None:
    (here / "check").mkdir()
    (here / "demo").mkdir()
    assert choose(["check"])[0] is smooth
    assert choose(["demo", "--json", "--rate", "10"])[0] is smooth
    assert choose(["./check"])[0] is smooth
    assert choose(["--json", "check"])[0] is smooth


def test_more_words_mean_the_command(here: Path) -> None:
    (here / "check").mkdir()
    (here / "demo").mkdir()
    assert choose(["check", "demo"])[0] is check
    assert choose(["check", "check", "--json"]) == (check, ["check", "--json"], "smooth check")
    assert choose(["demo", "elsewhere"])[0] is demo


def test_options_that_only_the_command_knows_mean_the_command(here: Path) -> None:
    (here / "demo").mkdir()
    assert choose(["demo", "--seed", "3"])[0] is demo
    assert choose(["demo", "--help"])[0] is demo


def test_a_file_called_like_a_command_is_a_session(here: Path) -> None:
    (here / "simulate").write_text("")
    assert choose(["simulate"])[0] is smooth


def test_a_word_that_is_no_command_is_a_session_that_is_not_there(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["monday"]) == 2
    assert "no such file or folder" in capsys.readouterr().err


def test_names_that_are_listed_for_speed_are_those_of_their_modules() -> None:
    from smoother.report import figures

    assert [named_command(name).name for name in COMMAND_NAMES] == list(COMMAND_NAMES)
    assert set(PRESETS) == set(presets.PRESETS)
    assert set(TRACKS) == set(track.TRACKS)
    assert tuple(figures.FIGURES) == FIGURE_NAMES


def test_help_names_every_command_and_fits_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"smooth {name}" in text for name in COMMAND_NAMES)
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("name", COMMAND_NAMES)
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([name, "--help"]) == 0
    assert f"Usage: smooth {name}" in capsys.readouterr().out


def test_no_arguments_show_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([]) == 0
    assert "Usage: smooth" in capsys.readouterr().out


def test_the_version_is_the_package_s(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert "0.1.0" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rate", "fast", "x"], "fast is not a number"),
        (["--wat"], "--wat"),
        (["nowhere"], "nowhere: no such file or folder"),
        (["chek"], "did you mean check?"),
        (["--json"], "no session given"),
        (["--solver", "magic", "x"], "magic"),
        (["check"], "no session given"),
        (["simulate"], "no folder given"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(
    here: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert run(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert words in output.err
    assert output.err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--rate", "abc"], "abc is not a number from 1 to 1000"),
        (["--rate", "nan"], "nan is not a number from 1 to 1000"),
        (["--rate", "0"], "0 is not a number from 1 to 1000"),
        (["check", "--recording", "x"], "x is not a whole number of 1 or more"),
        (["live", "--baud", "2.5"], "2.5 is not a whole number from 1200 to 4000000"),
        (["live", "--seconds", "0"], "0 is not a number of 0.1 or more"),
    ],
)
def test_expected_numbers_are_named_in_plain_words(
    here: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], wanted: str
) -> None:
    assert run([*arguments, "monday"]) == 2
    said = capsys.readouterr().err
    assert wanted in said and "range" not in said


@pytest.mark.parametrize("command", [[], ["compare"], ["batch"], ["export"], ["calibrate"]])
def test_out_has_a_short_name_everywhere(capsys: pytest.CaptureFixture[str], command: list[str]) -> None:
    assert run([*command, "--help"]) == 0
    assert "-o, --out" in capsys.readouterr().out


@pytest.mark.parametrize(
    "command", [[], ["check"], ["laps"], ["export"], ["evaluate"], ["compare"], ["demo"], ["batch"]]
)
def test_help_names_the_exit_codes(here: Path, capsys: pytest.CaptureFixture[str], command: list[str]) -> None:
    assert run([*command, "--help"]) == 0
    said = capsys.readouterr().out
    assert "Exit code" in said
    assert "3" in said[said.index("Exit code") :]


@pytest.mark.parametrize("module", ["smoother", "smoother.cli"])
def test_the_package_runs_as_a_module(module: str) -> None:
    done = subprocess.run([sys.executable, "-m", module, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "smooth" in done.stdout


def test_of_several_sessions_each_gets_a_folder_of_its_own(tmp_path: Path) -> None:
    sessions = tuple(tmp_path / name for name in ("a/run", "b/run", "c"))
    for session in sessions:
        session.mkdir(parents=True)
    out = tmp_path / "out"
    assert output_directories(out, sessions) == [out / "run", out / "run-2", out / "c"]
    assert output_directories(out, sessions[:1]) == [out]
    assert output_directories(None, sessions) == [None, None, None]


def test_help_does_not_wait_for_the_heavy_libraries() -> None:
    code = (
        "import sys; from smoother.cli.main import run; run(['--help']); "
        "print([m for m in ('numpy', 'scipy', 'polars', 'gtsam', 'matplotlib') if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize("stopped", ["KeyboardInterrupt", "ImportError from KeyboardInterrupt()"])
@pytest.mark.parametrize("module", ["click", "numpy"])
def test_to_be_stopped_while_libraries_load_is_one_line(tmp_path: Path, module: str, stopped: str) -> None:
    code = f"""
import sys
class Stopping:
    def find_spec(self, name, *_):
        if name == {module!r}:
            raise {stopped}
sys.meta_path.insert(0, Stopping())
from smoother.cli import main
main()
"""
    (tmp_path / "gps.csv").write_text("t_s,lat_deg,lon_deg\n")
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip()) == (130, "smooth: stopped")
