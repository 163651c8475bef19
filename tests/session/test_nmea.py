"""NMEA: everything a receiver, a cable and a card do to sentences."""

import functools
import operator
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smoother.errors import SessionError
from smoother.session.nmea import NmeaReading, fixes_from_sentences, read_nmea

KNOT = 1852.0 / 3600.0


def sentence(body: str) -> str:
    return f"${body}*{functools.reduce(operator.xor, body.encode(), 0):02X}\r\n"


def clock(seconds: float) -> str:
    seconds %= 86400.0
    return f"{int(seconds // 3600):02d}{int(seconds % 3600 // 60):02d}{seconds % 60:05.2f}"


def rmc(
    tod: float,
    *,
    status: str = "A",
    speed: str = "19.4",
    course: str = "90.0",
    date: str = "310524",
    talker: str = "GP",
    north: float = 0.0,
) -> str:
    place = f"450{2 + north / 1852:.7f},N,01208.9400,E" if status == "A" else ",,,"
    return sentence(f"{talker}RMC,{clock(tod)},{status},{place},{speed},{course},{date},,,A")


def gga(tod: float, quality: int = 1, satellites: str = "8", talker: str = "GP", north: float = 0.0) -> str:
    return sentence(
        f"{talker}GGA,{clock(tod)},450{2 + north / 1852:.7f},N,01208.9400,E,{quality},{satellites},0.9,12.5,M,44,M,,"
    )


def gst(tod: float) -> str:
    return sentence(f"GPGST,{clock(tod)},5.0,3.0,2.0,45.0,1.2,1.6,2.5")


def read(text: str | bytes) -> NmeaReading:
    return fixes_from_sentences([(float("nan"), text.encode() if isinstance(text, str) else text)], "log.nmea")


def codes(reading: NmeaReading) -> dict[str, int]:
    return {problem.code: problem.count for problem in reading.problems}


START = 36000.0


def epochs(count: int, start: float = START) -> list[str]:
    """Bursts of RMC, GGA, GST at 5 Hz, moving north at 2 m an epoch."""
    return [
        rmc(start + 0.2 * k, north=2.0 * k) + gga(start + 0.2 * k, north=2.0 * k) + gst(start + 0.2 * k)
        for k in range(count)
    ]


def test_sentences_of_one_utc_make_one_fix_with_the_values_of_all() -> None:
    reading = read("".join(epochs(50)))
    fixes = reading.gnss
    assert reading.problems == [] and not reading.has_receive_times
    np.testing.assert_allclose(fixes.t, 0.2 * np.arange(50), atol=1e-9)
    assert fixes.lat_deg[0] == pytest.approx(45 + 2 / 60) and fixes.lon_deg[0] == pytest.approx(12 + 8.94 / 60)
    np.testing.assert_allclose(fixes.alt_m, 12.5)
    np.testing.assert_allclose(fixes.speed, 19.4 * KNOT)
    np.testing.assert_allclose(fixes.velocity_n[:, :2], [[0.0, -19.4 * KNOT]] * 50, atol=1e-9)  # east is minus west
    assert np.all(np.isnan(fixes.velocity_n[:, 2]))
    np.testing.assert_allclose(fixes.sigma_horizontal, np.sqrt((1.2**2 + 1.6**2) / 2))
    np.testing.assert_allclose(fixes.sigma_up, 2.5)
    assert set(fixes.num_sv) == {8} and set(fixes.fix) == {1} and set(fixes.hdop) == {0.9}
    assert fixes.unix_s[0] == 1717149600.0  # 2024-05-31 10:00:00 UTC


def test_south_and_west_are_negative() -> None:
    fixes = read(sentence("GPRMC,100000.00,A,3330.0000,S,07015.0000,W,1.0,2.0,310524,,,A")).gnss
    assert (fixes.lat_deg[0], fixes.lon_deg[0]) == (-33.5, -70.25)


@pytest.mark.parametrize("talker", ["GP", "GN", "GL", "GA", "BD"])
def test_any_talker_is_understood(talker: str) -> None:
    fixes = read(rmc(START, talker=talker) + gga(START, talker=talker)).gnss
    assert len(fixes) == 1 and fixes.num_sv[0] == 8


def test_of_several_talkers_in_one_epoch_the_combined_one_counts() -> None:
    text = (
        gga(START, satellites="5", talker="GL") + gga(START, satellites="7") + gga(START, satellites="12", talker="GN")
    )
    reading = read(text)
    assert reading.gnss.num_sv[0] == 12 and reading.problems == []


def test_gns_and_vtg_and_zda_stand_in_for_rmc_and_gga() -> None:
    text = "".join(
        sentence(f"GNGNS,{clock(START + k)},4502.{k:05d},N,01208.94,E,AAN,11,0.8,30.0,44.0,,")
        + sentence("GNVTG,180.0,T,,M,,N,36.0,K,A")
        + sentence(f"GNZDA,{clock(START + k)},31,05,2024,00,00")
        for k in range(5)
    )
    fixes = read(text).gnss
    np.testing.assert_allclose(fixes.velocity_n[:, 0], -10.0)
    assert fixes.unix_s[0] == 1717149600.0 and fixes.num_sv[0] == 11


def test_vtg_that_leads_its_burst_belongs_to_the_fix_that_follows() -> None:
    text = "".join(sentence(f"GPVTG,0.0,T,,M,{k}.0,N,,K,A") + gga(START + k, north=9.0 * k) for k in range(5))
    np.testing.assert_allclose(read(text).gnss.speed, np.arange(5) * KNOT)


def test_bad_checksums_cut_lines_and_garbage_are_counted_and_cost_only_themselves() -> None:
    bursts = epochs(40)
    bursts[5] = bursts[5].replace(",A,", ",B,", 1)  # the text no longer fits its checksum
    bursts[10] = rmc(START + 2.0)[:30] + gga(START + 2.0, north=20.0)
    bursts[15] = "\x00\xff\x12" + bursts[15] + "\xb5b\x01\x07garbage"
    bursts[20] = rmc(START + 4.0)[:-2] + bursts[20]  # line end lost: two sentences on one line
    reading = read("".join(bursts).encode("latin-1"))
    assert len(reading.gnss) == 40  # GGA still gives the position of 5 and 10
    assert codes(reading) == {"gps_bad_checksum": 1, "gps_bad_sentence": 1, "gps_duplicate_sentence": 1}
    assert np.isnan(reading.gnss.speed[5]) and np.isnan(reading.gnss.speed[10])


def test_a_log_without_any_checksum_is_read() -> None:
    text = "".join(epochs(5))
    bare = "".join(line.split("*")[0] + "\r\n" for line in text.splitlines())
    reading = read(bare)
    assert len(reading.gnss) == 5 and reading.problems == []


def test_duplicated_and_misplaced_lines_do_not_move_a_fix() -> None:
    bursts = epochs(30)
    expected = read("".join(bursts)).gnss
    reading = read("".join([*bursts[:10], bursts[12], bursts[10], bursts[11], *bursts[13:20], bursts[5], *bursts[20:]]))
    np.testing.assert_array_equal(reading.gnss.t, expected.t)
    np.testing.assert_array_equal(reading.gnss.lat_deg, expected.lat_deg)
    assert codes(reading)["gps_duplicate_sentence"] == 3 and codes(reading)["gps_misplaced_sentence"] >= 2


def test_an_empty_course_leaves_the_velocity_open_unless_the_kart_stands() -> None:
    fixes = read(rmc(START, course="", speed="5.0") + rmc(START + 1, course="", speed="0.05", north=3.0)).gnss
    assert np.all(np.isnan(fixes.velocity_n[0]))
    np.testing.assert_array_equal(fixes.velocity_n[1, :2], [0.0, 0.0])
    assert fixes.speed[0] == pytest.approx(5.0 * KNOT)


def test_a_negative_course_is_the_same_direction_as_its_positive_one() -> None:
    fixes = read(rmc(START, course="-20.73")).gnss
    assert fixes.course_deg[0] == pytest.approx(339.27)
    np.testing.assert_allclose(
        fixes.velocity_n[0, :2], 19.4 * KNOT * np.array([np.cos(0.36181), np.sin(0.36181)]), atol=1e-4
    )


def test_an_absurd_number_of_satellites_costs_that_value_and_not_the_fix() -> None:
    reading = read(gga(START, satellites="14000") + gga(START + 1, north=2.0))
    assert list(reading.gnss.num_sv) == [-1, 8]
    assert codes(reading) == {"gps_satellites_absurd": 1}


def test_sentences_without_a_fix_are_counted_and_not_used() -> None:
    text = (
        rmc(START, status="V")
        + rmc(START + 1, status="V")
        + gga(START + 2, quality=0)
        + rmc(START + 2)
        + rmc(START + 3)
    )
    reading = read(text)
    np.testing.assert_array_equal(reading.gnss.t, [3.0])  # counts from the first sentence with a time, fix or not
    assert codes(reading) == {"gps_no_fix": 3}


@pytest.mark.parametrize("first", [True, False])
def test_one_sentence_without_a_fix_invalidates_it(first: bool) -> None:
    denied = [rmc(START, status="V"), gga(START)]
    reading = read("".join(denied if first else denied[::-1]) + rmc(START + 1))
    np.testing.assert_array_equal(reading.gnss.t, [1.0])


def estimated(tod: float, kind: str) -> str:
    """A fix of the receiver's own dead reckoning, as the three sentences tell it."""
    return {
        "GGA": gga(tod, quality=6),
        "RMC": sentence(f"GPRMC,{clock(tod)},A,4502.0,N,01208.9400,E,19.4,90.0,310524,,,E"),
        "GNS": sentence(f"GNGNS,{clock(tod)},4502.0,N,01208.9400,E,EEN,08,0.9,12.5,44.0,,"),
    }[kind]


@pytest.mark.parametrize("kind", ["GGA", "RMC", "GNS"])
def test_what_a_receiver_estimates_without_satellites_is_no_fix(kind: str) -> None:
    reading = read(gga(START) + estimated(START + 1, kind) + gga(START + 2))
    np.testing.assert_array_equal(reading.gnss.t, [0.0, 2.0])
    assert codes(reading) == {"gps_no_fix": 1}


def test_missing_fields_are_unknown_and_never_zero() -> None:
    fixes = read(sentence("GPGGA,100000.00,4502.0,N,01208.9,E,1,,,,M,,M,,")).gnss
    assert np.isnan(fixes.alt_m[0]) and np.isnan(fixes.hdop[0]) and fixes.num_sv[0] == -1
    no_hemisphere = sentence("GPGGA,100001.00,4502.0,,01208.9,E,1,8,0.9,5,M,,M,,")
    assert len(read(no_hemisphere + gga(START)).gnss) == 1


@pytest.mark.parametrize("with_date", [True, False])
def test_midnight_is_crossed_with_and_without_dates(with_date: bool) -> None:
    bursts = []
    for k in range(20):
        tod = 86398.0 + 0.2 * k
        date = "" if not with_date else ("310524" if tod < 86400 else "010624")
        bursts.append(gga(tod, north=2.0 * k) + (rmc(tod, date=date, north=2.0 * k) if with_date else ""))
    fixes = read("".join(bursts)).gnss
    np.testing.assert_allclose(fixes.t, 0.2 * np.arange(20), atol=1e-9)
    if with_date:
        np.testing.assert_allclose(fixes.unix_s, 1717149600.0 - 36000.0 + 86398.0 + 0.2 * np.arange(20), atol=1e-6)
    else:
        assert np.all(np.isnan(fixes.unix_s))


def test_one_wrong_date_or_time_does_not_shift_the_others() -> None:
    bursts = [rmc(START + k, north=5.0 * k, date="060180" if k == 4 else "310524") for k in range(20)]
    bursts[9] = rmc(80.0, north=45.0)
    fixes = read("".join(bursts)).gnss
    assert len(fixes) == 19
    np.testing.assert_allclose(fixes.unix_s - fixes.t, 1717149600.0)


def test_receive_times_before_the_sentences_are_the_times_of_the_fixes() -> None:
    lines = [
        f"{12.5 + 0.2 * k:.3f},{rmc(START + 0.2 * k, north=2.0 * k)}"
        f"{12.53 + 0.2 * k:.3f}, {gga(START + 0.2 * k, north=2.0 * k)}"
        for k in range(10)
    ]
    reading = read("t_s,sentence\r\n" + "".join(lines))
    assert reading.has_receive_times
    np.testing.assert_allclose(reading.gnss.t, 12.5 + 0.2 * np.arange(10))


def test_a_lost_receive_time_is_replaced_by_the_utc() -> None:
    lines = [f"{12.5 + k:.3f},{rmc(START + k, north=9.0 * k)}" for k in range(10)]
    lines[4] = rmc(START + 4, north=36.0)
    np.testing.assert_allclose(read("".join(lines)).gnss.t, 12.5 + np.arange(10))


def test_gaps_stay_gaps() -> None:
    bursts = epochs(100)
    fixes = read("".join(bursts[:30] + bursts[80:])).gnss
    assert np.max(np.diff(fixes.t)) == pytest.approx(10.2)


@pytest.mark.parametrize(
    "data", [b"", b"\n\n", b"hello world", b"$GPGSV,1,1,00*79\r\n", b"$GPRMC,,V,,,,,,,,,,N*53\r\n"]
)
def test_a_log_without_a_usable_sentence_is_one_clear_error(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "log.nmea"
    path.write_bytes(data)
    with pytest.raises(SessionError, match=r"^log.nmea: "):
        read_nmea(path)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_random_damage_raises_nothing_but_a_session_error(data: st.DataObject) -> None:
    text = bytearray("".join(epochs(12)).encode())
    for _ in range(data.draw(st.integers(0, 60))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(text)))
    try:
        reading = read(bytes(text[:cut]))
    except SessionError as error:
        assert "\n" not in str(error)
    else:
        assert np.all(np.diff(reading.gnss.t) > 0)


def velned(north: float, east: float, down: float, sacc: float, week_ms: int = 0) -> bytes:
    """NAV-VELNED as the receiver's description has it, in cm/s."""
    level = (round(100 * v) for v in (north, east, down))
    payload = struct.pack("<IiiiIIiII", week_ms, *level, 0, 0, 0, round(100 * sacc), 0)
    body = b"\x01\x12\x24\x00" + payload
    first = sum(body) & 255
    second = sum((len(body) - i) * byte for i, byte in enumerate(body)) & 255
    return b"\xb5\x62" + body + bytes((first, second))


@pytest.mark.parametrize("is_first", [True, False])
def test_velocity_among_sentences_belongs_to_the_fix_it_comes_with(is_first: bool) -> None:
    received: list[tuple[float, bytes]] = []
    for k, text in enumerate(epochs(20)):
        velocity = velned(k, -2.0, -0.5, 0.25)
        if k == 7:
            velocity = velocity[:-1] + bytes((velocity[-1] ^ 1,))
        parts = [text.encode(), velocity]
        times = (5.0 + 0.2 * k, 5.0 + 0.2 * k + 0.04)
        received += zip(times, parts[::-1] if is_first else parts, strict=True)
    fixes = fixes_from_sentences(received, "LOG.KLG").gnss
    has = np.arange(20) != 7
    np.testing.assert_allclose(fixes.velocity_n[has], [(k, 2.0, 0.5) for k in range(20) if k != 7])
    np.testing.assert_allclose(fixes.sigma_velocity[has], 0.25)
    assert np.isnan(fixes.sigma_velocity[7]) and np.isnan(fixes.velocity_n[7, 2])
    assert fixes.velocity_n[7, 1] == pytest.approx(-19.4 * KNOT)  # that of RMC
