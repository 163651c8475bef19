"""What all tests share: where the real recordings are, and a loud word about tests that a missing package skipped."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
NEEDS_PACKAGE = "needs system package"
"""How the reason of every skip begins that `apt install` or `brew install` would lift."""

pytest_plugins = ["pytester"]


@pytest.fixture(scope="session")
def data_directory() -> Path:
    """The real recordings; the test is skipped where they are not."""
    directory = Path(os.environ.get("SMOOTH_DATA", ROOT.parent / "shared" / "data"))
    if not directory.is_dir():
        pytest.skip(f"no real recordings at {directory}; set SMOOTH_DATA")
    return directory


def _missing_packages(config: pytest.Config) -> list[str]:
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    skipped = [] if reporter is None else reporter.stats.get("skipped", [])
    reasons = [report.longrepr[2] for report in skipped if isinstance(report.longrepr, tuple)]
    return sorted({reason.removeprefix("Skipped: ") for reason in reasons if NEEDS_PACKAGE in reason})


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    missing = _missing_packages(config)
    if missing:
        terminalreporter.write_line(f"TESTS WERE SKIPPED: {'; '.join(missing)}", red=True, bold=True)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """On the build machine nothing may go untested for want of a package."""
    if os.environ.get("CI") == "true" and session.exitstatus == 0 and _missing_packages(session.config):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
