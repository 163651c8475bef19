"""A test skipped for want of a system package is said loudly, and fails the build machine."""

from pathlib import Path

import pytest

CONFTEST = (Path(__file__).parent / "conftest.py").read_text(encoding="utf-8")
SKIPPING = """
import pytest

def test_runs():
    pass

@pytest.mark.skip(reason="{reason}")
def test_skips():
    pass
"""


@pytest.mark.parametrize(
    ("reason", "ci", "exit_code"),
    [
        ("needs system package gcc-arm-none-eabi", "true", 1),
        ("needs system package gcc-arm-none-eabi", "", 0),
        ("no real recordings here", "true", 0),
    ],
)
def test_only_a_missing_package_on_the_build_machine_fails_the_run(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, reason: str, ci: str, exit_code: int
) -> None:
    monkeypatch.setenv("CI", ci)
    pytester.makeconftest(CONFTEST)
    pytester.makepyfile(SKIPPING.format(reason=reason))
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    assert result.ret == exit_code
    result.assert_outcomes(passed=1, skipped=1)
    loud = "TESTS WERE SKIPPED: needs system package gcc-arm-none-eabi"
    assert (loud in result.stdout.str()) == reason.startswith("needs system package")
