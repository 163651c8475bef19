"""contracts.md 5: stdout, stderr, `--json` and exit codes."""

import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import polars as pl
import pytest

TABLES_ONLY = ("--no-figures", "--no-baseline")
ENTRY = "from smoother.cli.main import main; main()"


def test_stdout_is_a_short_table_and_the_report_s_path_its_last_line(
    smoothed_drive: Any, results: Path, summary: dict[str, Any]
) -> None:
    printed = smoothed_drive
    assert printed.err == ""
    assert printed.last == str(results / "report.html")
    assert Path(printed.last).stat().st_size > 10_000
    assert len(printed.out.splitlines()) < 60
    assert re.search(r"2 min 10 s, \d\.\d+ km", printed.out)
    assert "GPS position latency" in printed.out and "±" in printed.out
    for lap in summary["laps"]:
        if lap["lap_time_s"] is not None:
            row = rf"{lap['lap_time_s']:.3f}\s+{lap['lap_time_sigma_s']:.3f}\b"
            assert re.search(row, printed.out), row


def test_problems_stand_in_the_table(fixes_alone: Path, smooth: Any) -> None:
    short = fixes_alone
    rows = (short / "gps.csv").read_text().splitlines()
    rows[40] = rows[40].replace(rows[40].split(",")[2], "nan")
    (short / "gps.csv").write_text("\n".join(rows) + "\n")
    printed = smooth(short, *TABLES_ONLY)
    assert printed.code == 0
    text = json.loads((short / "smoothed" / "summary.json").read_text())["problems"][0]["text"]
    assert text.split(":")[0] in printed.out


def test_json_is_the_summary_as_one_document_and_nothing_else(fixes_alone: Path, smooth: Any) -> None:
    printed = smooth(fixes_alone, "--json", *TABLES_ONLY)
    assert printed.code == 0
    assert printed.document == json.loads((fixes_alone / "smoothed" / "summary.json").read_text())


def test_no_colour_and_no_progress_where_there_is_no_terminal(fixes_alone: Path, smooth: Any) -> None:
    printed = smooth(fixes_alone, *TABLES_ONLY)
    assert "\x1b" not in printed.out + printed.err and printed.err == ""


@pytest.mark.slow
@pytest.mark.parametrize("no_color", [True, False])
def test_progress_goes_to_stderr_of_a_terminal_with_colour_unless_no_color(simulated: Path, no_color: bool) -> None:
    terminal, other_end = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k != "NO_COLOR"} | {"TERM": "xterm-256color"}
    environment |= {"NO_COLOR": "1"} if no_color else {}
    command = [sys.executable, "-c", ENTRY, "check", str(simulated), "--json"]  # the quickest command that draws
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=other_end, env=environment) as process:
        os.close(other_end)
        drawn = b""
        while True:
            try:
                block = os.read(terminal, 4096)
            except OSError:  # how Linux says that the other end is closed
                break
            drawn += block
            if not block:
                break
        assert process.stdout is not None
        printed = process.stdout.read()
    os.close(terminal)
    assert process.returncode in (0, 3)
    json.loads(printed)
    assert b"reading" in drawn
    assert (re.search(rb"\x1b\[[0-9;]*3[0-9]", drawn) is not None) != no_color


@pytest.mark.slow
def test_exit_code_1_and_a_traceback_are_for_internal_errors(simulated: Path, tmp_path: Path) -> None:
    """A library that fails as it never should; the error is let through by every layer."""
    code = f"""
import json
def broken(*_, **__):
    raise ZeroDivisionError("never")
json.dumps = broken
{ENTRY}
"""
    words = [str(simulated), "--out", str(tmp_path / "out"), *TABLES_ONLY]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "Traceback" in done.stderr and "ZeroDivisionError: never" in done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rate", "fast", "SESSION"], "fast is not a number"),
        (["--wat", "SESSION"], "--wat"),
        (["--solver", "magic", "SESSION"], "magic"),
        (["nowhere"], "nowhere: no such file or folder"),
        (["check"], "no session given"),
        (["laps", "SESSION", "--line", "nowhere"], "nowhere"),
        (["export", "SESSION", "pdf"], "pdf"),
        (["compare", "SESSION"], "two sessions"),
    ],
)
def test_exit_code_2_and_one_line_are_for_wrong_usage(
    simulated: Path, smooth: Any, words: list[str], message: str
) -> None:
    printed = smooth(*(simulated if word == "SESSION" else word for word in words))
    assert (printed.code, printed.out) == (2, "")
    assert printed.err.count("\n") == 1 and message in printed.err and "Traceback" not in printed.err


@pytest.mark.parametrize(
    "spoil",
    [
        lambda d: [path.unlink() for path in d.iterdir()],
        lambda d: (d / "gps.csv").unlink(),
        lambda d: (d / "gps.csv").write_text(""),
        lambda d: (d / "gps.csv").write_text("t_s,lat_deg\n1,2\n"),
        lambda d: (d / "gps.csv").write_text("t_s,lat_deg,lon_deg\n1,nan,2\n"),
        lambda d: (d / "calibration.toml").write_text("not toml"),
    ],
    ids=["nothing", "no fixes", "empty", "no longitude", "no usable fix", "calibration"],
)
@pytest.mark.parametrize("command", [[], ["check"], ["evaluate"]], ids=lambda words: " ".join(words) or "smooth")
def test_exit_code_2_and_one_line_are_for_unusable_input(
    short: Path, smooth: Any, spoil: Any, command: list[str]
) -> None:
    spoil(short)
    printed = smooth(*command, short, "--json")
    assert (printed.code, printed.out) == (2, "")
    assert printed.err.count("\n") == 1 and printed.err.startswith("smooth: ")


@pytest.mark.slow
def test_exit_code_3_and_one_line_are_for_results_that_fail_their_gate_and_files_are_written(
    short: Path, smooth: Any
) -> None:
    """Every longitude has the wrong sign, so the kart turns to the other side than the gyroscope says."""
    fixes = pl.read_csv(short / "gps.csv", infer_schema_length=None)
    fixes.with_columns(-pl.col("lon_deg")).write_csv(short / "gps.csv")
    printed = smooth(short, *TABLES_ONLY)
    assert printed.code == 3
    assert printed.err.count("\n") == 1 and "quality gate" in printed.err
    assert {"trajectory.csv", "gps.csv", "summary.json"} <= {path.name for path in (short / "smoothed").iterdir()}
    quality = json.loads((short / "smoothed" / "summary.json").read_text())["quality"]
    assert quality["passed"] is False and quality["reasons"]
    assert quality["reasons"][0] in " ".join(printed.err.split())
    assert smooth("export", short, "gpx").code == 3
