"""The rows of the fault table that are about the receiver and the IMU."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from evidence import Recording
from expectations import (
    POLLED_SPREAD_US,
    Case,
    Expectation,
    all_kept,
    all_told,
    event,
    led,
    no_event,
    no_samples,
    no_sentences,
    of_one,
    recordings,
    sentences,
    setup,
)
from smoother.session.log_format import (
    MAG_OVERFLOW,
)


def _flags(start_s: float, end_s: float) -> tuple[Expectation, ...]:
    def find_flaw(found: Recording) -> str:
        t = found.records.mag_t / 1e6
        is_within, is_flagged = (t > start_s + 0.1) & (t < end_s), (found.records.mag_flags & MAG_OVERFLOW) > 0
        is_outside = (t < start_s) | (t > end_s + 0.1)
        wrong = (is_within & ~is_flagged).sum() + (is_outside & is_flagged).sum()
        return f"{wrong} are not" if wrong or is_within.sum() < 100 else ""

    return (of_one(f"exactly the MAG records from {start_s:g} to {end_s:g} s carry the flag", find_flaw),)


def _find_repeats(found: Recording) -> str:
    repeats = int((found.records.mag[1:] == found.records.mag[:-1]).all(axis=1).sum())
    return f"{repeats} do" if repeats > 20 else ""


RECEIVER = (
    Case(
        "absent",
        "receiver absent",
        ((0, "gps_absent 1"),),
        (recordings(1), all_kept(1.5, 12.4), led("no fix", 4, 12), setup(gps_baud=0), no_sentences(0, 16)),
    ),
    Case(
        "silent for 8 s, then as after power-on",
        "receiver absent",
        ((8, "gps_absent 1"), (16, "gps_absent 0"), (16, "gps_restart 1")),
        (
            all_kept(1.5, 26),
            event("GPS_SILENT", "GPS_CONFIGURED"),
            led("no fix", 13, 16),
            led("recording", 23, 26),
            sentences(3, 7.9),
            no_sentences(8.2, 16),
            sentences(22, 26),
            setup(gps_baud=57600),
        ),
        duration=30,
    ),
    Case(
        "all it says is noise",
        "receiver garbage",
        ((0, "gps_garble 1"),),
        (recordings(1), all_kept(1.5, 16.4), led("no fix", 4, 16), setup(gps_baud=0)),
        duration=20,
    ),
    Case(
        "noise for 8 s",
        "receiver garbage",
        ((8, "gps_garble 1"), (16, "gps_garble 0")),
        (
            all_kept(1.5, 26),
            event("GPS_SILENT", "GPS_CONFIGURED"),
            led("no fix", 13, 16),
            led("recording", 22, 26),
            sentences(3, 7.9),
            sentences(22, 26),
        ),
        duration=30,
    ),
    Case(
        "noise between the sentences",
        "receiver garbage",
        ((4, "gps_chatter 200"),),
        (all_kept(1.5, 12.4), sentences(3, 12), led("recording", 5, 12), no_event("GPS_SILENT")),
    ),
    Case(
        "does not hear: its wire is missing",
        "receiver does not obey",
        ((0, "gps_deaf 1"),),
        (all_kept(1.5, 16.4), event("GPS_NOT_CONFIGURED"), setup(gps_baud=9600), led("recording", 10, 16)),
        duration=20,
    ),
    Case(
        "refuses its rate",
        "receiver does not obey",
        ((0, f"gps_refuse {0x0608}"),),
        (all_kept(1.5, 12.4), event("GPS_NOT_CONFIGURED"), setup(gps_baud=57600), led("recording", 5, 12)),
    ),
)

IMU_PART = (
    Case(
        "absent",
        "IMU absent",
        ((0, "imu_absent 1"),),
        (
            recordings(1),
            no_samples(),
            sentences(4, 12),
            event("IMU_LOST"),
            setup(imu_who_am_i=0xFF),
            led("GPS alone", 4, 12),
        ),
    ),
    Case(
        "absent for the first 7 s",
        "IMU absent",
        ((0, "imu_absent 1"), (7, "imu_absent 0")),
        (recordings(1), all_kept(13, 16.4), event("IMU_LOST"), setup(imu_who_am_i=0x71), led("recording", 13, 16)),
        duration=20,
    ),
    *(
        Case(
            f"WHO_AM_I {who:02X}",
            "WHO_AM_I",
            ((0, f"who {who}"),),
            (
                recordings(1),
                no_samples(),
                sentences(4, 12),
                event("IMU_LOST"),
                setup(imu_who_am_i=0xFF),
                led("GPS alone", 4, 12),
            ),
        )
        for who in (0x00, 0xFF)
    ),
    Case(
        "WHO_AM_I 70: an MPU6500, without magnetometer",
        "WHO_AM_I",
        ((0, "who 112"), (0, "mag_absent 1")),
        (
            recordings(1),
            all_kept(1.5, 12.4),
            setup(imu_who_am_i=0x70, mag_who_am_i=0, mag_period_us=0),
            event("MAG_ABSENT"),
            of_one("no MAG records", lambda found: str(len(found.records.mag) or "")),
            led("recording", 4, 12),
        ),
    ),
    *(
        Case(
            f"WHO_AM_I {who:02X}, with magnetometer",
            "WHO_AM_I",
            ((0, f"who {who}"),),
            (recordings(1), all_kept(1.5, 12.4), setup(imu_who_am_i=who, mag_who_am_i=0x48), led("recording", 4, 12)),
        )
        for who in (0x73, 0x12)
    ),
    Case(
        "a register does not keep its value",
        "IMU absent",
        ((0, f"imu_stuck {0x1B}"),),
        (
            recordings(1),
            no_samples(),
            sentences(4, 12),
            event("IMU_LOST"),
            led("GPS alone", 4, 12),
            setup(imu_who_am_i=0xFF),
        ),
    ),
    Case(
        "silent for 3 s",
        "IMU silent",
        ((6, "imu_absent 1"), (9, "imu_absent 0")),
        (
            recordings(1),
            all_told(1.5, 16.4, lost=(2900, 9000), slack=3),
            event("IMU_LOST", "IMU_BACK"),
            led("recording", 15, 16.4),
            sentences(3, 16),
        ),
        duration=20,
    ),
    Case(
        "measures the same for 1 s",
        "IMU frozen",
        ((6, "imu_frozen 1"), (7, "imu_frozen 0")),
        (
            recordings(1),
            all_told(1.5, 16.4, lost=(100, 2500), slack=5, strange=1000),
            event("IMU_LOST", "IMU_BACK"),
            led("recording", 13, 16),
        ),
        duration=20,
    ),
    Case(
        "its interrupt is not wired",
        "IMU wire",
        ((0, "imu_wire 0"),),
        (recordings(1), all_kept(1.5, 12.4), setup(flags=0x04), led("recording", 4, 12)),
        spread_us=POLLED_SPREAD_US,
    ),
    Case(
        "its interrupt's wire breaks at 7 s",
        "IMU wire",
        ((7, "imu_wire 0"),),
        (recordings(1), all_told(1.5, 12.4, lost=(25, 40), slack=1), no_event("IMU_LOST"), led("recording", 4, 12)),
        spread_us=POLLED_SPREAD_US,
    ),
    Case(
        "its interrupt's wire picks up 20 kHz for 2 s",
        "IMU wire",
        ((6, "imu_storm 50"), (8, "imu_storm 0")),
        (
            recordings(1),
            all_told(1.5, 12.4, lost=(0, 100), slack=1),
            no_event("IMU_LOST", "WATCHDOG"),
            led("recording", 9, 12),
        ),
        spread_us=POLLED_SPREAD_US,
    ),
    Case(
        "magnetometer absent",
        "magnetometer absent",
        ((0, "mag_absent 1"),),
        (
            recordings(1),
            all_kept(1.5, 12.4),
            setup(imu_who_am_i=0x71, mag_who_am_i=0),
            event("MAG_ABSENT"),
            led("recording", 4, 12),
        ),
    ),
    Case(
        "magnetometer hangs at the start: its bus is waiting",
        "magnetometer hangs",
        ((0, "mag_hang 1"),),
        (recordings(1), all_kept(1.5, 12.4), setup(mag_who_am_i=0x48), no_event("MAG_ABSENT"), led("recording", 4, 12)),
    ),
    Case(
        "magnetometer hangs from 6 s on, until nothing is recorded any more",
        "magnetometer hangs",
        ((6, "mag_hang 1"), (16, "button 1"), (16.12, "button 0")),
        (
            recordings(2),
            all_kept(1.5, 10),
            event("MAG_ABSENT"),
            of_one("no MAG records after 6.1 s", lambda found: str((found.records.mag_t > 6.1e6).sum() or "")),
            of_one("20 at most repeat the last", _find_repeats),
            of_one("MAG records again", lambda found: "" if len(found.records.mag) > 100 else "none", index=1),
        ),
        duration=20,
        stop=10.5,
    ),
    Case(
        "magnetometer overflows from 6 to 9 s",
        "magnetometer overflow",
        ((6, "mag_overflow 1"), (9, "mag_overflow 0")),
        (recordings(1), all_kept(1.5, 12.4), *_flags(6, 9), no_event("IMU_LOST")),
    ),
    Case(
        "neither IMU nor receiver for 16 s",
        "IMU and receiver absent",
        ((0, "imu_absent 1"), (0, "gps_absent 1"), (16, "gps_absent 0"), (16, "imu_absent 0")),
        (led("on", 11, 15.5), recordings(1), all_kept(24, 27.4), led("recording", 24, 27)),
        duration=31,
    ),
)
