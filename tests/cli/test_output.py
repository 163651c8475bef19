"""What commands print: two columns that fit the terminal, without a stray control character."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from smoother.cli.output import open_page, print_pairs

TITLE = "monday \x1b[31m"
PAIRS = [("driven", "10 min, " + "far " * 30), ("", "x" * 100), ("a name of more than twelve", "")]


def test_pairs_stand_in_two_columns_and_long_values_are_wrapped(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "70")
    print_pairs(TITLE, PAIRS)
    title, *lines = capsys.readouterr().out.splitlines()
    width = len("a name of more than twelve")
    assert title == "monday  [31m"
    assert max(map(len, lines)) <= 70
    assert [line[: width + 2].rstrip() for line in lines if line[0] != " "] == ["driven", PAIRS[2][0]]
    values = [line[width + 2 :] for line in lines]
    assert " ".join(values[:4]) == PAIRS[0][1].strip()
    assert "".join(values[4:]) == "x" * 100


def test_names_longer_than_half_a_line_are_wrapped_beside_their_values(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    print_pairs("calibrated", [("a name " * 10, "a value " * 8), ("short", "one")])
    _, *lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 60
    assert " ".join(line[:29].strip() for line in lines[:-1]) == ("a name " * 10).strip()
    assert " ".join(line[31:].strip() for line in lines[:-1]).split() == ["a", "value"] * 8
    assert lines[-1].split() == ["short", "one"]


def test_a_terminal_too_narrow_for_a_value_still_gets_all_of_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "5")
    print_pairs("", [("best", "52.689 ± 0.016 (lap 8)")])
    assert "".join(capsys.readouterr().out.split()) == "best52.689±0.016(lap8)"


@pytest.mark.parametrize(("term", "is_styled"), [("xterm", True), ("dumb", False)])
def test_only_a_terminal_that_knows_styles_is_sent_some(term: str, is_styled: bool) -> None:
    code = f"from smoother.cli.output import open_page, print_pairs; print_pairs({TITLE!r}, [('name', 'value')])"
    terminal, other_end = pty.openpty()
    subprocess.run([sys.executable, "-c", code], stdout=other_end, env=os.environ | {"TERM": term}, check=True)
    os.close(other_end)
    shown = os.read(terminal, 4096).decode()
    os.close(terminal)
    assert ("\x1b[1m" in shown and "\x1b[2m" in shown) == is_styled
    assert ("\x1b" in shown) == is_styled
    assert "\x1b[31m" not in shown


def test_the_command_line_starts_without_what_only_some_commands_need() -> None:
    code = "import sys, smoother.cli.main; print([name for name in sys.modules if name.startswith(%r)])"
    for slow in ("rich", "numpy", "smoother.cli.batching", "smoother.cli.living"):
        shown = subprocess.run([sys.executable, "-c", code % slow], capture_output=True, text=True, check=True).stdout
        assert shown == "[]\n"


@pytest.mark.skipif(sys.platform == "win32", reason="has no program that opens others")
@pytest.mark.parametrize("tells", [None, "exit 0", "for i in 1 2 3 4 5 6 7; do echo nothing here >&2; done; exit 3"])
def test_a_page_that_no_browser_shows_is_named_in_one_line(
    tells: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    if tells is not None:
        for name in ("xdg-open", "open"):
            (tmp_path / name).write_text(f"#!/bin/sh\n{tells}\n")
            (tmp_path / name).chmod(0o755)
    open_page(tmp_path / "report.html")
    line = f"smooth: no browser found; open {tmp_path / 'report.html'}\n"
    assert capfd.readouterr().err == ("" if tells == "exit 0" else line)
