"""Counts and lengths of time in words."""

import math

import pytest

from smoother.errors import SessionError
from smoother.words import counted, duration, listed, loss_digits, repeated, span, speed_digits


@pytest.mark.parametrize(
    ("count", "noun", "text"), [(1, "lap", "1 lap"), (2, "lap", "2 laps"), (1, "fix", "1 fix"), (0, "fix", "0 fixes")]
)
def test_one_thing_is_singular(count: int, noun: str, text: str) -> None:
    assert counted(count, noun) == text


@pytest.mark.parametrize(
    ("seconds", "text"), [(199.6, "3 min 20 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (3599.7, "1 h 0 min")]
)
def test_a_length_of_time_is_rounded_and_never_has_60_seconds(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.1524, "0.152 s"), (5.2, "5.2 s"), (99.97, "1 min 40 s"), (3600.2, "1 h 0 min")]
)
def test_a_gap_has_three_digits_or_is_a_length_of_time(seconds: float, text: str) -> None:
    assert span(seconds) == text


@pytest.mark.parametrize(
    ("text", "count", "said"),
    [
        ("a.nmea: 14 sentences without a fix", 14, "a.nmea: 14 sentences without a fix"),
        ("10 of 975 fixes lie outside", 10, "10 of 975 fixes lie outside"),
        ("all were 14.", 14, "all were 14."),
        ("a gap of 14.5 s", 14, "a gap of 14.5 s (14 times)"),
        ("the longest is 0.14 s", 14, "the longest is 0.14 s (14 times)"),
        ("stopped at 140", 14, "stopped at 140 (14 times)"),
        ("it stopped", 1, "it stopped"),
    ],
)
def test_a_count_is_written_once(text: str, count: int, said: str) -> None:
    assert repeated(text, count) == said


def test_names_of_a_file_are_shown_shortened() -> None:
    assert listed(["t_s", "a\x07b", "x" * 30]) == f"t_s, a?b, {'x' * 22}.."
    assert listed([f"c{i}" for i in range(14)]) == ", ".join(f"c{i}" for i in range(12)) + ", .."


def test_an_error_quotes_no_control_characters() -> None:
    assert str(SessionError("gps.csv: \x1b[31mred\nmore")) == "gps.csv:  [31mred more"


@pytest.mark.parametrize(("sigma", "digits"), [(0.5, 2), (0.03, 2), (0.004, 3), (0.0003, 4), (0.0, 2), (math.nan, 2)])
def test_a_lost_time_has_the_digits_that_its_sigma_needs(sigma: float, digits: int) -> None:
    assert loss_digits(sigma) == digits


@pytest.mark.parametrize(("sigma", "text"), [(0.3, "0.3"), (0.05, "0.1"), (0.047, "0.05"), (0.006, "0.01")])
def test_no_speed_has_a_sigma_of_zero(sigma: float, text: str) -> None:
    assert f"{sigma:.{speed_digits(sigma)}f}" == text
