"""NMEA whose UTC was set in mid-file, or that holds several days: the order of the file and the dates tell."""

import datetime as dt
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from smoother.session.nmea import NmeaReading

from .test_nmea import codes, read, sentence

BEGIN = dt.datetime(2026, 5, 16, 10, 0, tzinfo=dt.UTC).timestamp()
METRES = 111_195.0  # of a degree
Clock = Callable[[float], float]


def place(t: float) -> tuple[float, float]:
    """North and east, m: round a track of 60 s with 9 to 15 m/s, slowly drifting so that no place comes twice."""
    turn = 2.0 * np.pi * t / 60.0
    return 120.0 * float(np.sin(turn)) + 0.02 * t, 90.0 * float(np.cos(turn))


def at(unix: float, north: float, east: float, kinds: Sequence[str] = ("RMC", "GGA"), dated: bool = True) -> str:
    """Sentences of one fix."""
    moment = dt.datetime.fromtimestamp(round(unix, 3), dt.UTC)
    clock = f"{moment:%H%M%S}.{moment.microsecond // 10_000:02d}"
    where = f"450{2 + 60 * north / METRES:.7f},N,012{8.94 + 60 * east / METRES / 0.7071:010.7f},E"
    date = f"{moment:%d%m%y}" if dated else ""
    return "".join(
        sentence(
            {
                "RMC": f"GPRMC,{clock},A,{where},,,{date},,,A",
                "GGA": f"GPGGA,{clock},{where},1,8,0.9,12.5,M,44,M,,",
                "ZDA": f"GPZDA,{clock},{moment:%d,%m,%Y},00,00",
            }[kind]
        )
        for kind in kinds
    )


def drive(
    utc: Clock = lambda t: t,
    *,
    rate: float = 5.0,
    seconds: float = 100.0,
    begin: float = BEGIN,
    where: Callable[[float], tuple[float, float]] = place,
    kinds: Sequence[str] = ("RMC", "GGA"),
    stamps: float | None = None,
    dated: bool = True,
) -> list[str]:
    """A burst per fix of a drive, whose UTC is `begin` and utc(t); stamps s : receive time of the first."""
    bursts = []
    for k in range(round(seconds * rate)):
        t = k / rate
        text = at(begin + utc(t), *where(t), kinds, dated)
        prefix = "" if stamps is None else f"{stamps + t + 0.02 * (k % 3):.3f},"
        bursts.append("".join(prefix + line for line in text.splitlines(keepends=True)))
    return bursts


def joined(bursts: Sequence[str]) -> NmeaReading:
    return read("".join(bursts))


def moved_and_copied(bursts: list[str]) -> dict[str, list[str]]:
    """Files of the same bursts in another order, or some of them twice."""
    return {
        "a block of 10 s written twice": [*bursts[:200], *bursts[150:]],
        "a block of 2 s written twice": [*bursts[:200], *bursts[190:]],
        "a block of 10 s too early": [*bursts[:200], *bursts[250:300], *bursts[200:250], *bursts[300:]],
        "a block of 2 s too late": [*bursts[:200], *bursts[210:300], *bursts[200:210], *bursts[300:]],
        "a copy of a block later": [*bursts[:200], *bursts[150:160], *bursts[200:]],
    }


@pytest.mark.parametrize("name", list(moved_and_copied([""] * 500)))
@pytest.mark.parametrize("where", [place, lambda t: (3.0, 5.0)], ids=["driving", "standing"])
def test_what_is_written_twice_or_out_of_order_is_no_clock_that_was_set(
    name: str, where: Callable[[float], tuple[float, float]]
) -> None:
    bursts = drive(where=where)
    whole, reading = joined(bursts), joined(moved_and_copied(bursts)[name])
    np.testing.assert_array_equal(reading.gnss.t, whole.gnss.t)
    np.testing.assert_array_equal(reading.gnss.lat_deg, whole.gnss.lat_deg)
    assert codes(reading).keys() <= {"gps_duplicate_sentence", "gps_misplaced_sentence"} and reading.problems


@pytest.mark.parametrize("lost", [1, 2, 3, 18])
@pytest.mark.parametrize("rate", [1.0, 5.0, 25.0])
@pytest.mark.parametrize(
    "where",
    [
        place,
        lambda t: (0.02 * t, 0.0),
        lambda t: (12.0 * min(t, 102.0 - t), 4.0 * (t > 51.0)),  # back again, on the other side of a hairpin
    ],
    ids=["driving", "standing", "hairpin"],
)
def test_a_gap_of_whole_seconds_stays_a_gap(
    lost: int, rate: float, where: Callable[[float], tuple[float, float]]
) -> None:
    bursts, count = drive(rate=rate, where=where), round(lost * rate)
    first = round(50.0 * rate)
    reading = joined([*bursts[:first], *bursts[first + count :]])
    assert np.max(np.diff(reading.gnss.t)) == pytest.approx(lost + 1.0 / rate) and reading.problems == []


@pytest.mark.parametrize("turns_over", [0.0, 0.4, 30.0, 1e9])
def test_a_date_that_turns_over_late_or_never_makes_no_other_day(turns_over: float) -> None:
    midnight = BEGIN + 14 * 3600.0
    bursts = drive(begin=midnight - 50.0)
    late = [
        sentence(burst.split("*")[0][1:].replace(",170526,", ",160526,")) if t < 50.0 + turns_over else burst
        for t, burst in zip(0.2 * np.arange(500), bursts, strict=True)
    ]
    np.testing.assert_allclose(joined(late).gnss.t, 0.2 * np.arange(500), rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("unknown", ["060180", "010100", "220899", "010106"])
@pytest.mark.parametrize("goes_on", [True, False])
def test_dates_before_a_receiver_has_the_day_are_none(unknown: str, goes_on: bool) -> None:
    begin = drive(begin=BEGIN if goes_on else BEGIN - 4000.0)[:100]
    begin = [sentence(burst.split("*")[0][1:].replace(",160526,", f",{unknown},")) for burst in begin]
    gnss = joined([*begin, *drive()[100:]]).gnss
    assert gnss.unix_s is not None and gnss.unix_s[-1] == pytest.approx(BEGIN + 99.8, abs=1e-3)
    assert gnss.t[-1] - gnss.t[0] < 5000.0


def test_without_dates_midnight_is_still_crossed_and_days_are_unknown() -> None:
    gnss = joined(drive(begin=BEGIN + 14 * 3600.0 - 50.0, dated=False)).gnss
    np.testing.assert_allclose(gnss.t, 0.2 * np.arange(500), rtol=0.0, atol=1e-6)
