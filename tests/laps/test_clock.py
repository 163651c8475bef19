"""Times of day as people read them."""

import time
from collections.abc import Iterator

import pytest

from smoother.laps.clock import chance_text, local_day, local_time, local_zone

NOON = 1_778_925_600.0  # 2026-05-16 10:00 UTC, noon in Berlin


@pytest.fixture(autouse=True)
def in_berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize("seconds", [0.0, -1e-4, 0.999])
def test_a_moment_that_is_noon_but_for_rounding_is_noon(seconds: float) -> None:
    assert local_time(NOON + seconds) == "12:00:00"
    assert local_day(NOON + seconds) == "2026-05-16 12:00 CEST"
    assert local_day(NOON + seconds, with_zone=False) == "2026-05-16 12:00"
    assert local_time(NOON - 0.001) == "11:59:59"


def test_the_zone_has_a_name_and_two_where_the_clock_was_changed() -> None:
    assert local_zone([NOON, NOON + 3600.0]) == "CEST"
    assert local_zone([NOON, NOON + 200 * 86400.0]) == "CEST/CET"
    assert local_zone([]) == ""


def test_the_bias_of_the_timing_is_the_difference_of_the_displayed_times() -> None:
    said = chance_text(65.5634, 65.5556, 66.0)
    assert said == "best sectors add up to 1:05.556, which is 0.007 s too fast by chance"
