"""Hard sessions, shortened: right within their sigmas, or refused by the gate with a reason; none worse than GPS alone.

The whole catalogue is benchmarks/hard_sessions.py; this runs those that end each in a different way.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

CATALOGUE = Path(__file__).resolve().parents[2] / "benchmarks" / "hard_sessions.py"


@pytest.fixture(scope="module")
def catalogue() -> ModuleType:
    spec = importlib.util.spec_from_file_location("hard_sessions", CATALOGUE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_a_name_that_no_session_has_is_refused_with_those_there_are(
    catalogue: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["hard_sessions.py", "--case", "nosuch"])
    with pytest.raises(SystemExit, match="2"):
        catalogue.main()
    assert "'nosuch'" in (said := capsys.readouterr().err) and "four spins" in said


@pytest.mark.parametrize(
    "name",
    [
        *("no standstill", "wrong start heading", "GPS outage of 60 s", "wrong hemisphere once"),
        "the same, accelerometer 50 ms late",
        "box turned over",
    ],
)
def test_what_can_be_mended_is_right(name: str, catalogue: ModuleType) -> None:
    outcome = catalogue.run_by_name(name, seed=1)
    assert outcome.verdict == "right", outcome


def test_a_clock_that_is_off_costs_no_honesty(catalogue: ModuleType) -> None:
    outcome = catalogue.run_by_name("IMU clock 2 % slow", seed=1)
    assert outcome.verdict == "right", outcome
    assert float(outcome.worst.split()[-1]) > 0.83  # of errors within two sigma; the plain session has 0.86


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("box slips by 4 deg", "did the box move"),
        ("box turns by 6 deg", "did the box move"),
        ("box loose for 20 s", "was the box loose"),
        ("parked", "hardly drove"),
        ("30 m off for a minute", "leaves the fixes"),
    ],
)
def test_what_cannot_is_refused_with_the_reason(name: str, reason: str, catalogue: ModuleType) -> None:
    outcome = catalogue.run_by_name(name, seed=1)
    assert outcome.verdict == "code 3"
    assert reason in outcome.reasons
    assert outcome.horizontal < outcome.gps
