"""The time of day of a session, as a summary keeps it."""

import pytest

from smoother.utc_clock import UtcClock

SLOW = UtcClock(12.5, 1_775_907_141.25, 1.0 + 5e-4)


def test_a_clock_that_is_slow_falls_behind() -> None:
    assert SLOW.at(12.5) == 1_775_907_141.25
    assert SLOW.at(1212.5) == pytest.approx(1_775_907_141.25 + 1200.6, abs=1e-6)


def test_a_summary_keeps_it() -> None:
    kept = SLOW.as_summary()
    assert kept["start_utc"] == "2026-04-11T11:32:21.250Z"
    assert UtcClock.of_summary({"start_s": 12.5, **kept}) == SLOW


def test_an_older_summary_holds_the_start_alone() -> None:
    said = {"start_s": 12.5, "start_utc": "2026-04-11T11:32:21.250Z"}
    assert UtcClock.of_summary(said) == UtcClock(12.5, SLOW.start_unix, 1.0)


def test_without_a_time_from_the_receiver_there_is_no_clock() -> None:
    assert UtcClock.of_summary({"start_s": 12.5, "start_utc": None}) is None
    assert UtcClock.of_summary({}) is None


@pytest.mark.parametrize("broken", [{"start_utc": "noon"}, {"start_utc": 5}, {"start_s": None}, {"utc_rate": "fast"}])
def test_a_damaged_one_raises(broken: dict[str, object]) -> None:
    with pytest.raises((ValueError, TypeError)):
        UtcClock.of_summary({"start_s": 12.5, **SLOW.as_summary(), **broken})
