"""Receivers that learn on the way how many leap seconds there are."""

from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import GnssFixes, Problem
from smoother.session.leap_seconds import with_learnt_leap_seconds

from .folders import Folder, codes, gps_csv

BEGIN = 1_780_000_000.0  # s since 1970


def read(t: Array, unix_s: Array) -> tuple[Array, list[Problem]]:
    place = np.full(t.size, 45.0)
    fixes = GnssFixes(t, place, place, place, np.full((t.size, 3), np.nan), unix_s=unix_s)
    problems: list[Problem] = []
    made = with_learnt_leap_seconds(fixes, "gps.csv", problems)
    assert made.unix_s is not None and (problems or made is fixes)
    return made.unix_s, problems


@pytest.mark.parametrize("period", [0.04, 0.2, 1.0])
@pytest.mark.parametrize("learnt", [6, 210, 594])
@pytest.mark.parametrize("seconds", [2.0, 18.0])
def test_utc_from_before_leap_seconds_are_known_is_moved_and_said(period: float, learnt: int, seconds: float) -> None:
    true = BEGIN + period * np.arange(600)
    t = true - BEGIN + np.random.default_rng(1).uniform(0.0, 0.1 * period, true.size)
    unix_s = true + seconds * (np.arange(600) < learnt)
    unix_s[::50] = np.nan
    made, (problem,) = read(t, unix_s)
    np.testing.assert_allclose(made[np.isfinite(unix_s)], true[np.isfinite(unix_s)], rtol=0.0, atol=1e-6)
    told = f"gps.csv: its UTC falls by {seconds:.0f} s at {t[learnt]:.0f} s, as where a receiver learns"
    assert problem.code == "gps_leap_seconds" and problem.text.startswith(told)


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda row, utc: utc, "it goes on"),
        (lambda row, utc: utc - 18.5 * (row > 300), "of no whole seconds"),
        (lambda row, utc: utc + 18.0 * (row > 300), "rows may have been lost"),
        (lambda row, utc: utc - 3600.0 * (row > 300), "an hour has other causes"),
        (lambda row, utc: utc - 18.0 * (row == 300), "one damaged stamp"),
        (lambda row, utc: np.floor(utc), "without fractions"),
        (lambda row, utc: utc[::-1], "no clock at all"),
        (lambda row, utc: np.full_like(utc, np.nan), "unknown"),
        (lambda row, utc: utc + np.random.default_rng(1).uniform(0.0, 5.0, utc.size), "stamped at random"),
    ],
)
def test_other_utc_stays(spoil: object, why: str) -> None:
    t = 0.2 * np.arange(600)
    unix_s = spoil(np.arange(600), BEGIN + t)  # type: ignore[operator]
    made, problems = read(t, unix_s)
    assert problems == [], why
    np.testing.assert_array_equal(made, unix_s)


def test_after_a_pause_it_may_be_another_clock() -> None:
    t = 0.2 * np.arange(600) + 30.0 * (np.arange(600) > 300)
    assert read(t, BEGIN + t - 48.0 * (t > 61.0))[1] == []


def test_the_date_of_a_session_is_the_later_one_however_short(tmp_path: Path) -> None:
    header, *rows = gps_csv(100).splitlines()
    stamped = [f"{row},{BEGIN + 0.2 * k + 18.0 * (k < 80):.1f}" for k, row in enumerate(rows)]
    raw = Folder(tmp_path).write(gps__csv="\n".join([f"{header},unix_s", *stamped])).load()
    assert codes(raw)["gps_leap_seconds"] == 1 and raw.unix_at_zero == pytest.approx(BEGIN, abs=1e-3)
    assert "gps_gap" not in codes(raw)
