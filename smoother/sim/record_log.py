"""Simulations as the logger would have recorded them: `*.klg` files (firmware/FORMAT.md), with the truth beside them.

What the logger cannot hold is left out as it would leave it out: values are counts of its sensors. Velocities
are those of NAV-VELNED, which has three components and a sigma; a receiver simulated without a vertical one sends none.
"""

import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array, IntArray
from smoother.errors import UsageError
from smoother.samples import GnssFixes, RawImu
from smoother.session.log import COUNTS, MAG_SCALE, TICKS_PER_SECOND
from smoother.session.log_encode import encode
from smoother.session.log_format import (
    GAP_SENSOR,
    IMU,
    PURPOSE_DRIVE,
    PURPOSE_MAG_CALIBRATION,
    STOP_BUTTON,
    STOP_CALIBRATED,
    Gap,
    LogRecords,
    Setup,
    Stop,
)
from smoother.session.velned import message
from smoother.sim.record import nmea_sentences, write_truth
from smoother.sim.simulation import Simulation
from smoother.units import DEG, STANDARD_GRAVITY

DRIVE_FILE, CALIBRATION_FILE = "LOG00002.KLG", "LOG00001.KLG"
SENTENCES = ("RMC", "GGA", "GST")
ACCEL_RANGES, GYRO_RANGES = (2, 4, 8, 16), (250, 500, 1000, 2000)  # g, deg/s
FASTEST_IMU = 1000.0  # Hz
_BAUD, _FAST_BAUD, _SLOW_RATE = 57600, 115200, 10.0  # above this rate of fixes the three sentences need the faster line
_GPS_EPOCH, _LEAP_SECONDS = 315_964_800.0, 18.0  # s: 6 January 1980, and by how much GPS time is ahead of UTC


def write_klg(simulation: Simulation, directory: Path) -> None:
    """Write LOG00002.KLG, truth.csv, truth_laps.csv, and LOG00001.KLG if there are readings to calibrate the compass.

    Ranges are the smallest of the sensor's that hold those of the simulation. Raises UsageError for what the logger
    cannot record: a faster IMU, or times before its clock starts.
    """
    records = drive_records(simulation)
    directory.mkdir(parents=True, exist_ok=True)
    (directory / DRIVE_FILE).write_bytes(encode(records, _session(records)))
    if simulation.raw.mag_calibration_field is not None:
        calibration = calibration_records(simulation.raw.mag_calibration_field)
        (directory / CALIBRATION_FILE).write_bytes(encode(calibration, _session(calibration)))
    write_truth(simulation, directory)


def _session(records: LogRecords) -> int:
    """An id that is the same for the same simulation."""
    return zlib.crc32(records.imu.tobytes() + records.mag.tobytes() + repr(records.sentences[:9]).encode()) | 1


def drive_records(simulation: Simulation) -> LogRecords:
    """Return the records of a simulated drive. Raises UsageError as :func:`write_klg`."""
    raw = simulation.raw
    setup = _setup(simulation)
    imu_t, imu = np.zeros(0, dtype=np.int64), np.zeros((0, 6), dtype=np.int16)
    if raw.imu is not None:
        imu_t, imu = _ticks(raw.imu.t), _imu_counts(raw.imu, setup)
    mag_t, mag = np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int16)
    if raw.mag is not None:
        mag_t, mag = _ticks(raw.mag.t), _mag_counts(raw.mag.field)
    sentences = _sentences(raw.gnss, setup.gps_baud)
    gaps = _gaps(simulation, imu_t, setup)
    lost = sum(gap.count for gap in gaps)
    end = max([int(t[-1]) for t in (imu_t, mag_t) if t.size] + [t for t, _ in sentences[-1:]], default=0)
    stop = Stop(end, STOP_BUTTON, len(imu_t), lost, len(sentences), 1, 0)
    flags = np.zeros(len(mag_t), dtype=np.uint8)
    return LogRecords(setup, _config(setup), imu_t, imu, mag_t, mag, flags, sentences=sentences, gaps=gaps, stop=stop)


def calibration_records(field: Array) -> LogRecords:
    """Return the recording of a calibration of the magnetometer: field (K, 3) uT, axes s."""
    times = np.arange(1, len(field) + 1) * round(TICKS_PER_SECOND / 100.0)  # Hz, of the AK8963
    setup = Setup(PURPOSE_MAG_CALIBRATION, boot_number=1)
    stop = Stop(int(times[-1]), STOP_CALIBRATED, 0, 0, 0, 1, 0)
    flags = np.zeros(len(field), dtype=np.uint8)
    return LogRecords(setup, _config(setup), mag_t=times, mag=_mag_counts(field), mag_flags=flags, stop=stop)


def _setup(simulation: Simulation) -> Setup:
    """A simulated sample is as late as half its period, which is therefore stated as the delay of the low-pass."""
    imu, gnss, mag = simulation.scenario.imu, simulation.scenario.gnss, simulation.scenario.mag
    if imu is not None and imu.rate > FASTEST_IMU:
        raise UsageError(f"the logger samples at most {FASTEST_IMU:.0f} times a second; choose another rate or format")
    period = 0 if imu is None else round(TICKS_PER_SECOND / imu.rate)
    lowpass = 0 if imu is None or imu.anti_alias_hz is None else round(imu.anti_alias_hz)
    return Setup(
        purpose=PURPOSE_DRIVE,
        imu_who_am_i=0xFF if imu is None else 0x71,
        mag_who_am_i=0x00 if mag is None else 0x48,
        imu_period_us=period,
        accel_range_g=_range(None if imu is None else imu.accel_range, STANDARD_GRAVITY, ACCEL_RANGES),
        gyro_range_dps=_range(None if imu is None else imu.gyro_range, DEG, GYRO_RANGES),
        accel_lowpass_hz=lowpass,
        gyro_lowpass_hz=lowpass,
        accel_delay_us=period // 2,
        gyro_delay_us=period // 2,
        mag_period_us=0 if mag is None else round(TICKS_PER_SECOND / mag.rate),
        gps_period_us=round(TICKS_PER_SECOND / gnss.rate),
        gps_baud=_BAUD if gnss.rate <= _SLOW_RATE else _FAST_BAUD,
        boot_number=2,
    )


def _range(full_scale: float | None, unit: float, ranges: tuple[int, ...]) -> int:
    """Smallest range in `unit` that holds a full scale in SI; the widest without one."""
    wanted = ranges[-1] if full_scale is None else full_scale / unit
    return next((value for value in ranges if value >= wanted - 1e-6), ranges[-1])


def _config(setup: Setup) -> str:
    rate = round(TICKS_PER_SECOND / setup.imu_period_us) if setup.imu_period_us else 1000
    settings = {
        "imu_rate": rate,
        "accel_range": setup.accel_range_g,
        "gyro_range": setup.gyro_range_dps,
        "lowpass": setup.gyro_lowpass_hz,
        "magnetometer": "yes" if setup.mag_who_am_i else "no",
        "gps_rate": round(TICKS_PER_SECOND / setup.gps_period_us),
        "gps_baud": setup.gps_baud,
        "autostart": "yes",
        "self_test": "no",
        "stream": 0,
        "stream_baud": 115200,
    }
    return "".join(f"{key}={value}\n" for key, value in settings.items())


def _ticks(t: Array) -> IntArray:
    """Times (N,) us, in order and no two the same; jitter before power-on is moved to it. Raises UsageError."""
    if t.size and t[0] < -1.0:  # s; stamps this much before power-on are jitter
        raise UsageError(f"the logger's clock starts at 0, not at {t[0]:.1f} s; leave imu.clock_offset above 0")
    index = np.arange(len(t))
    ticks = np.clip(np.round(t * TICKS_PER_SECOND), 0, None).astype(np.int64)
    return np.asarray(np.maximum.accumulate(ticks - index) + index)


def _imu_counts(imu: RawImu, setup: Setup) -> npt.NDArray[np.int16]:
    accel_unit, gyro_unit = setup.accel_range_g * STANDARD_GRAVITY / COUNTS, setup.gyro_range_dps * DEG / COUNTS
    return np.hstack([_int16(imu.accel * imu.accel_scale / accel_unit), _int16(imu.gyro * imu.gyro_scale / gyro_unit)])


def _mag_counts(field: Array) -> npt.NDArray[np.int16]:
    """Counts (K, 3) in the magnetometer's axes of a field (K, 3) uT in those of the IMU: the way back of log.py."""
    return _int16((field * [1.0, 1.0, -1.0])[:, [1, 0, 2]] / MAG_SCALE)


def _int16(values: Array) -> npt.NDArray[np.int16]:
    limits = np.iinfo(np.int16)
    return np.clip(np.round(values), limits.min, limits.max).astype(np.int16)


def _sentences(fixes: GnssFixes, baud: int) -> tuple[tuple[int, bytes], ...]:
    """The sentences of all fixes, each with the time of its first byte: the first at the fix, the next right behind."""
    sentences = []
    for i, start in enumerate(_ticks(fixes.t).tolist()):
        at = start
        for text in nmea_sentences(fixes, SENTENCES, i):
            sentence = f"{text}\r\n".encode("ascii")
            sentences.append((at, sentence))
            at += len(sentence) * 10_000_000 // baud
        sentences += [(at, velocity) for velocity in _velocity(fixes, i)]
    return tuple(sentences)


def _velocity(fixes: GnssFixes, i: int) -> list[bytes]:
    """NAV-VELNED of fix i, none where a part of it is unknown."""
    assert fixes.sigma_velocity is not None and fixes.unix_s is not None
    sigma = float(fixes.sigma_velocity[i])
    if not np.isfinite([*fixes.velocity_n[i], sigma]).all():
        return []
    week_ms = round((fixes.unix_s[i] - _GPS_EPOCH + _LEAP_SECONDS) * 1000.0) % (7 * 86_400_000)
    return [message(week_ms, fixes.velocity_n[i], sigma)]


def _gaps(simulation: Simulation, imu_t: IntArray, setup: Setup) -> tuple[Gap, ...]:
    """The stretches without samples, as the logger would note them: the sensor was not read."""
    errors = simulation.scenario.imu
    if errors is None or imu_t.size == 0:
        return ()
    gaps = []
    for interval in errors.gaps:
        first = simulation.truth.clock.to_session(np.array([interval.start])) * TICKS_PER_SECOND
        after = int(np.searchsorted(imu_t, first[0]))
        if 0 < after < len(imu_t):
            before, next_one = int(imu_t[after - 1]), int(imu_t[after])
            count = round((next_one - before) / setup.imu_period_us) - 1
            if count > 0:
                period = setup.imu_period_us
                gaps.append(Gap(IMU, GAP_SENSOR, count, before + period, next_one - period))
    return tuple(gaps)
