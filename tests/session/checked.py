"""A table of checks on samples and fixes that a test made."""

from collections.abc import Iterable

from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.checks.table import Check, run
from smoother.session.recorded import Recording


def checked(
    checks: Iterable[Check[Recording]], gnss: GnssFixes, imu: RawImu | None = None
) -> tuple[Recording, list[Problem]]:
    """What the checks leave of a recording, and what they say."""
    return run(checks, Recording(gnss, "gps.csv", (), (), imu, "imu.csv"))


def of_code(checks: Iterable[Check[Recording]], code: str) -> list[Check[Recording]]:
    """The checks of one code."""
    return [check for check in checks if check.code == code]
