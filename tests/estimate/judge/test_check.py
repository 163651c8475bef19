"""`check` on simulated recordings, sound ones and ones with a single known flaw."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from smoother.disc import pieces
from smoother.estimate.judge import check as module
from smoother.estimate.judge.check import Check, check
from smoother.prepare import prepare
from smoother.report.page import recorded_check
from smoother.samples import IMU_AXES_UNKNOWN, GnssFixes, Problem, RawImu, RawSession
from smoother.session.clock import describe_time_base, regularize
from smoother.session.load import load_raw
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG, STANDARD_GRAVITY
from smoother.words import span


@pytest.fixture(scope="module")
def kart() -> RawSession:
    return simulate_preset("kart", 4, duration=90.0).raw


def changed(raw: RawSession, **parts: object) -> RawSession:
    return dataclasses.replace(raw, **parts)  # type: ignore[arg-type]


def with_imu(raw: RawSession, **columns: object) -> RawSession:
    assert raw.imu is not None
    return changed(raw, imu=dataclasses.replace(raw.imu, **columns))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def still() -> RawSession:
    """A minute of a kart that stands, engine off, and the seconds in which it starts."""
    return simulate_preset("kart", 5, duration=70.0, motion_standstill=65.0).raw


def first_seconds(raw: RawSession, seconds: float) -> RawSession:
    assert raw.imu is not None
    end = raw.gnss.t[0] + seconds + 0.05
    keep = raw.imu.t <= end
    columns = {"t": raw.imu.t[keep], "accel": raw.imu.accel[keep], "gyro": raw.imu.gyro[keep], "temperature": None}
    return with_imu(changed(raw, gnss=raw.gnss.select(raw.gnss.t <= end)), **columns)


def texts(result: Check, level: str) -> str:
    return "; ".join(finding.text for finding in result.findings if finding.level == level)


@pytest.mark.parametrize("preset", ["white", "kart", "kart_harsh"])
def test_a_simulated_kart_is_good_to_drive(preset: str) -> None:
    result = check(simulate_preset(preset, 3, duration=300.0).raw)
    assert result.is_good, result.reasons
    assert result.measures["imu_rate_hz"] == pytest.approx(200.0, rel=0.05)
    assert result.measures["fix_rate_hz"] == pytest.approx(5.0, rel=0.01)


def test_one_outage_is_a_warning_with_its_length(kart: RawSession) -> None:
    result = check(kart)
    assert "1 gap, the longest 5" in texts(result, "warning")
    assert result.measures["fix_gap_longest_s"] == pytest.approx(5.2, abs=0.3)  # 5 s and the step around it


def test_gaps_of_a_slow_receiver_are_those_of_reading(tmp_path: Path) -> None:
    """At 1 Hz one fix is missing, then four."""
    t = [k for k in range(90) if k != 30 and not 60 <= k < 64]
    rows = [f"{k},{45.0 + 9e-5 * k:.7f},12" for k in t]
    (tmp_path / "gps.csv").write_text("\n".join(["t_s,lat_deg,lon_deg", *rows]) + "\n")
    raw = load_raw(tmp_path)
    assert "2 gaps in the fixes, the longest 5 s" in [p.text.partition(": ")[2] for p in raw.problems]
    assert "2 gaps, the longest 5.0 s" in texts(check(raw), "warning")


def test_a_recording_without_fixes_is_not_good(kart: RawSession) -> None:
    none = changed(kart, gnss=kart.gnss.select(np.zeros(len(kart.gnss), dtype=bool)))
    assert "no GPS fix" in texts(check(none), "stop")


@pytest.mark.parametrize("seconds", [1.0, 3.0, 9.0])
def test_a_few_seconds_are_too_short_to_judge(still: RawSession, seconds: float) -> None:
    result = check(first_seconds(still, seconds))
    assert not result.is_good
    assert f"only {seconds:.0f} s of fixes, too short to judge; record a minute" in result.reasons


@pytest.mark.parametrize("seconds", [1.0, 3.0])
def test_a_few_seconds_without_a_motion_sensor_are_too_short_as_well(still: RawSession, seconds: float) -> None:
    alone = changed(first_seconds(still, seconds), imu=None, mag=None, inputs=("gps.csv",))
    assert "too short to judge" in texts(check(alone), "stop")


@pytest.mark.parametrize("seconds", [12.0, 60.0])
def test_a_standing_kart_is_good_to_drive_when_it_was_recorded_for_long_enough(
    still: RawSession, seconds: float
) -> None:
    result = check(first_seconds(still, seconds))
    assert result.is_good, result.reasons


def test_fixes_lost_for_most_of_the_time_are_not_good(kart: RawSession) -> None:
    holes = changed(kart, gnss=kart.gnss.select(np.floor(kart.gnss.t / 10.0) % 3 == 0))
    assert "free view of the sky" in texts(check(holes), "stop")


def test_an_inaccurate_receiver_is_not_good(kart: RawSession) -> None:
    poor = dataclasses.replace(kart.gnss, sigma_horizontal=np.full(len(kart.gnss), 40.0))
    assert "accuracy of 40.0 m" in texts(check(changed(kart, gnss=poor)), "stop")


def test_fixes_without_speed_are_a_warning(kart: RawSession) -> None:
    n = len(kart.gnss)
    blank = dataclasses.replace(kart.gnss, velocity_n=np.full((n, 3), np.nan))
    assert "no speed and course" in texts(check(changed(kart, gnss=blank)), "warning")


def test_a_speed_in_every_fifth_fix_is_no_want_of_sentences(kart: RawSession) -> None:
    held = np.arange(len(kart.gnss))[:, None] % 5 == 0
    seldom = dataclasses.replace(kart.gnss, velocity_n=np.where(held, kart.gnss.velocity_n, np.nan))
    assert "no speed and course" not in texts(check(changed(kart, gnss=seldom)), "warning")


def test_gaps_of_the_motion_sensor_are_those_of_the_reader(kart: RawSession) -> None:
    assert kart.imu is not None
    keep = np.ones(len(kart.imu.t), dtype=bool)
    keep[4000:4003] = keep[9000:9015] = False  # 3 and 15 samples of 5 ms
    t = kart.imu.t[keep]
    lost = with_imu(kart, t=t, accel=kart.imu.accel[keep], gyro=kart.imu.gyro[keep], temperature=None)
    result = check(lost)
    (told,) = (p for p in describe_time_base(regularize(t), "imu", "imu.csv") if p.code == "imu_gap")
    assert result.measures["imu_gaps"] == told.count == 2
    assert f"the longest {result.measures['imu_gap_longest_s']:.3g} s" in told.text
    assert "2 gaps, the longest 0.08" in texts(result, "warning")
    keep[4003:] = np.arange(4003, len(keep)) < 9000
    few = {"t": kart.imu.t[keep], "accel": kart.imu.accel[keep], "gyro": kart.imu.gyro[keep], "temperature": None}
    short = with_imu(kart, **few)
    assert "1 gap, the longest 0.02" in texts(check(short), "ok")


def test_gaps_are_one_count_for_the_reader_the_check_and_the_page(kart: RawSession) -> None:
    """A logger whose clock wanders by half a percent: of stamps evened out, few gaps would be left."""
    assert kart.imu is not None
    n, rng = 9000, np.random.default_rng(5)
    period = 0.01 * (1.0 + 0.005 * np.sin(np.arange(n) / 300.0))
    period[[900, 2000, 3100, 6000, 7500]] *= [2.2, 1.7, 14.5, 2.5, 1.8]
    stamps = np.cumsum(period) + rng.uniform(0.0, 0.002, n)
    base = regularize(stamps)
    (told,) = (p for p in describe_time_base(base, "imu", "imu.csv") if p.code == "imu_gap")
    some = {"accel": kart.imu.accel[:n], "gyro": kart.imu.gyro[:n], "temperature": None}
    read = with_imu(kart, t=base.t, longest_step=base.longest_step, **some)
    result = check(read)
    assert result.measures["imu_gaps"] == told.count == 5
    longest = f"the longest {span(result.measures['imu_gap_longest_s'])}"
    assert longest in told.text and f"5 gaps, {longest}" in texts(result, "warning")
    assert recorded_check(prepare(read)).measures["imu_gaps"] == told.count


@pytest.mark.parametrize(
    ("file", "remedy"), [("A.KLG", "try another card"), ("imu.csv", ", of samples that were lost")]
)
def test_another_card_is_of_use_to_a_logger_that_writes_on_one(kart: RawSession, file: str, remedy: str) -> None:
    assert kart.imu is not None
    keep = np.ones(len(kart.imu.t), dtype=bool)
    keep[9000:9015] = False
    columns = {name: getattr(kart.imu, name)[keep] for name in ("t", "accel", "gyro")}
    lost = changed(with_imu(kart, **columns, temperature=None), inputs=(file,))
    (text,) = (f.text for f in check(lost).findings if f.topic == "IMU" and "gap" in f.text)
    assert text.endswith(remedy)


@pytest.mark.parametrize("inputs", [("RUN00001.KLG",), ("out.txt",), ("imu.csv", "gps.csv", "session.toml")])
def test_no_motion_sensor_where_there_is_one_is_not_good(kart: RawSession, inputs: tuple[str, ...]) -> None:
    result = check(changed(kart, imu=None, mag=None, inputs=inputs))
    assert "no usable motion sensor" in texts(result, "stop")
    assert not result.is_gps_only


def test_a_compass_without_its_motion_sensor_is_not_good(kart: RawSession) -> None:
    assert kart.mag is not None
    assert not check(changed(kart, imu=None, inputs=("gps.csv", "mag.csv"))).is_good


@pytest.mark.parametrize("inputs", [("race.vbo",), ("race.nmea",), ("race.gpx", "session.toml"), ("gps.csv",)])
def test_a_logger_without_a_motion_sensor_is_good_and_gps_only(kart: RawSession, inputs: tuple[str, ...]) -> None:
    result = check(changed(kart, imu=None, mag=None, inputs=inputs))
    assert result.is_good and result.is_gps_only
    assert "no motion sensor" in texts(result, "warning")


SLOW = "the motion sensor is too slow (10 samples a second, 20 are needed)"


@pytest.mark.parametrize(
    ("code", "reason", "said"),
    [
        ("imu_too_slow", SLOW, SLOW),
        ("imu_missing", "only 5 usable samples", "the motion sensor cannot be used (only 5 usable samples)"),
    ],
)
def test_a_motion_sensor_of_no_use_is_a_fault_of_the_own_logger_only(
    kart: RawSession, code: str, reason: str, said: str
) -> None:
    for files, is_own in ((("imu.csv", "gps.csv", "mag.csv"), False), (("a.vbo",), False), (("A.KLG",), True)):
        problem = Problem(code, f"{files[0]}: {reason}: smoothed from GPS alone")
        result = check(changed(kart, imu=None, inputs=files, problems=(problem,)))
        assert result.is_good == result.is_gps_only == (not is_own)
        if not is_own:
            alone = f"{said}; the GPS alone gives no roll, pitch or sideslip"
            assert [f.text for f in result.findings if f.topic in ("IMU", "file")] == [alone]


def test_the_page_reports_a_motion_sensor_as_the_check(kart: RawSession) -> None:
    problem = Problem("imu_too_slow", f"imu.csv: {SLOW}: smoothed from GPS alone")
    slow = changed(kart, imu=None, mag=None, inputs=("imu.csv", "gps.csv"), problems=(problem,))
    said = [f.text for f in recorded_check(prepare(slow)).findings if f.topic in ("IMU", "file")]
    assert said == [f"{SLOW}; the GPS alone gives no roll, pitch or sideslip"]


def test_a_motion_sensor_that_is_not_read_is_not_called_missing(kart: RawSession) -> None:
    axes = Problem(IMU_AXES_UNKNOWN, "a.vbo: the inertial channels (x, y, z) are not used: their axes are not known")
    missing = Problem("imu_missing", "no IMU that can be used: smoothed from GPS alone")
    result = check(changed(kart, imu=None, mag=None, inputs=("a.vbo",), problems=(axes, missing)))
    assert result.is_gps_only and axes.text in texts(result, "warning")
    assert "no motion sensor" not in texts(result, "warning")


def test_clipping_is_found_from_the_stated_range(kart: RawSession) -> None:
    assert kart.imu is not None
    limit = 1.0 * STANDARD_GRAVITY
    clipped = np.clip(kart.imu.accel * kart.imu.accel_scale, -limit, limit)
    result = check(with_imu(kart, accel=clipped, accel_scale=1.0, accel_full_scale=limit))
    # not onto rubber or foam: what shakes by itself is not the kart (README, "Mount the box and the antenna")
    told = "acceleration samples are clipped; set a wider range, or mount the logger farther from the engine"
    assert told in texts(result, "stop")


def test_clipping_is_found_without_a_stated_range(kart: RawSession) -> None:
    assert kart.imu is not None
    limit = 250.0 * DEG
    turn = np.clip(kart.imu.gyro * kart.imu.gyro_scale * 8.0, -limit, limit)
    result = check(with_imu(kart, gyro=turn, gyro_scale=1.0, gyro_full_scale=None))
    assert result.measures["gyro_clipped_share"] > 0.001
    assert "turn rate samples are clipped" in texts(result, "warning") + texts(result, "stop")


def test_a_coarsely_rounded_sensor_at_rest_does_not_clip() -> None:
    t = np.arange(0.0, 30.0, 0.01)
    rng = np.random.default_rng(1)
    accel = np.round(rng.normal([0.0, 0.0, 9.8], 0.02, (len(t), 3)) / 0.05) * 0.05
    gyro = np.round(rng.normal(0.0, 0.005, (len(t), 3)) / 0.01) * 0.01
    fixes = GnssFixes(np.arange(0.0, 30.0, 0.2), *np.zeros((3, 150)), np.zeros((150, 3)))
    result = check(RawSession("rest", fixes, RawImu(t, accel, gyro)))
    assert result.measures["accel_clipped_share"] == result.measures["gyro_clipped_share"] == 0.0


def test_an_accelerometer_in_g_and_a_gyroscope_in_degrees_are_found(kart: RawSession) -> None:
    assert kart.imu is not None
    in_g = with_imu(kart, accel_scale=kart.imu.accel_scale / STANDARD_GRAVITY, accel_full_scale=None)
    assert "another unit" in texts(check(in_g), "stop")
    in_degrees = with_imu(kart, gyro_scale=kart.imu.gyro_scale / DEG, gyro_full_scale=None)
    assert "in deg/s instead of rad/s" in texts(check(in_degrees), "stop")


def test_a_dead_axis_is_named(kart: RawSession) -> None:
    assert kart.imu is not None
    assert "z axis of the gyroscope" in texts(check(with_imu(kart, gyro=kart.imu.gyro * [1.0, 1.0, 0.0])), "stop")


def test_a_recorder_that_loses_samples_is_not_good(kart: RawSession) -> None:
    assert kart.imu is not None
    keep = np.floor(kart.imu.t / 0.5) % 4 != 0
    lossy = RawImu(
        kart.imu.t[keep], kart.imu.accel[keep], kart.imu.gyro[keep], kart.imu.accel_scale, kart.imu.gyro_scale
    )
    assert "try another card" in texts(check(changed(kart, imu=lossy)), "stop")


def test_gravity_that_clipped_vibration_bends_is_no_unit(kart: RawSession) -> None:
    assert kart.imu is not None
    force = kart.imu.accel * kart.imu.accel_scale
    force[:, 2] += 60.0 * np.random.default_rng(1).standard_normal(len(force))
    force[:, 2] = np.clip(force[:, 2], None, 50.0)
    found = check(with_imu(kart, accel=force, accel_scale=1.0, accel_full_scale=None))
    assert "another unit" not in texts(found, "stop")
    told = "as where vibration is clipped; set a wider range, or mount the logger farther from the engine"
    assert told in texts(found, "warning")


def test_strong_vibration_is_a_warning_with_a_remedy(kart: RawSession) -> None:
    assert kart.imu is not None
    shaken = kart.imu.accel + np.random.default_rng(1).normal(0.0, 8.0 / kart.imu.accel_scale, kart.imu.accel.shape)
    assert "mount the logger on the frame" in texts(check(with_imu(kart, accel=shaken)), "warning")


def test_a_logger_on_the_steering_wheel_is_a_warning(kart: RawSession) -> None:
    wheel = simulate_preset("kart", 4, duration=90.0, motion_steering=10.0 * DEG).raw
    said = "the logger turns with the steering wheel"
    assert said in texts(check(wheel), "warning") and check(wheel).is_good
    assert said not in texts(check(kart), "warning")


def test_a_motion_sensor_that_ran_for_half_the_drive_is_not_good(kart: RawSession) -> None:
    assert kart.imu is not None
    early = kart.imu.t < 30.0
    short = RawImu(
        kart.imu.t[early], kart.imu.accel[early], kart.imu.gyro[early], kart.imu.accel_scale, kart.imu.gyro_scale
    )
    assert "covers only" in texts(check(changed(kart, imu=short)), "stop")


def test_what_the_reader_found_is_passed_on(kart: RawSession) -> None:
    flawed = changed(kart, problems=(Problem("x", "imu.csv: 3 rows dropped", 3),))
    assert "3 rows dropped" in texts(check(flawed), "warning")


@pytest.mark.parametrize("reach", [None, 22.0])
def test_a_recording_judged_in_parts_is_judged_as_at_once(
    kart: RawSession, reach: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert kart.imu is not None
    end = 22.0 / kart.imu.accel_scale
    raw = with_imu(kart, accel=np.clip(kart.imu.accel, -end, end), accel_full_scale=reach)
    at_once = check(raw)
    monkeypatch.setattr(module, "pieces", lambda n: pieces(n, 13))
    in_parts = check(raw)
    assert in_parts.findings == at_once.findings
    assert at_once.measures["accel_clipped_share"] > 0.0
    assert in_parts.measures == pytest.approx(at_once.measures, rel=1e-6)  # one step's median differs in its rounding
