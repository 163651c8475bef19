"""Simulations as files: the CSV form and the thesis' two files, each with the truth beside it; NMEA sentences.

Values are rounded where a file would round them anyway (microseconds, 0.1 mm), never to hide a difference.
"""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.errors import UsageError
from smoother.frames import wrap_angle
from smoother.samples import GnssFixes, RawImu, RawMag, WheelSpeed
from smoother.session import thesis
from smoother.session.csv_form import FIX_COLUMNS
from smoother.sim.simulation import Simulation
from smoother.units import DEG, KNOT, MILLISECOND

_TIME_DECIMALS = 6
_DEGREE_DECIMALS = 10  # of latitude and longitude: 0.01 mm
_TRUTH_CHUNK = 200_000  # rows evaluated at once
_INT16 = (-32768, 32767)
NMEA_BLOCK = 96  # bytes of the receiver's buffer in out.txt for each sentence, of which none is longer than 82


def write_csv(simulation: Simulation, directory: Path) -> None:
    """Write imu.csv, gps.csv, mag.csv, wheel_speed.csv, truth.csv and truth_laps.csv into `directory`, made if need be.

    A magnetometer that was calibrated before the session also gets its calibration.toml.
    """
    directory.mkdir(parents=True, exist_ok=True)
    raw = simulation.raw
    if raw.imu is not None:
        write_table(imu_table(raw.imu), directory / "imu.csv")
    write_table(fix_table(raw.gnss), directory / "gps.csv")
    if raw.mag is not None:
        write_table(mag_table(raw.mag), directory / "mag.csv")
    if raw.wheel_speed is not None:
        write_table(wheel_table(raw.wheel_speed), directory / "wheel_speed.csv")
    if raw.mag_calibration_field is not None:
        write_mag_calibration(simulation, directory / "calibration.toml")
    write_truth(simulation, directory)


def write_thesis(simulation: Simulation, directory: Path, sentences: Sequence[str] = ("RMC",)) -> None:
    """Write out.txt, magcalib.txt (if there are readings), truth.csv and truth_laps.csv into `directory`.

    The format has millisecond stamps, 4 g and 500 deg/s; magnetometer and sentences come with the fixes only. The
    thesis recorded RMC alone, so heights are unknown; GGA after it adds them.
    Raises UsageError for a simulation that the format cannot hold: without IMU, or faster than its stamps.
    """
    raw = simulation.raw
    if raw.imu is None or len(raw.imu.t) > 1000.0 * simulation.scenario.duration:
        raise UsageError("the thesis' format needs an IMU of at most 1000 Hz; choose another rate or format")
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "out.txt").write_bytes(_thesis_records(raw.imu, raw.mag, raw.gnss, sentences))
    if raw.mag_calibration_field is not None:
        rows = [thesis.RECORD_START + triple for triple in _mag_triples(raw.mag_calibration_field)]
        (directory / "magcalib.txt").write_bytes(b"".join(rows))
    write_truth(simulation, directory)


def write_truth(simulation: Simulation, directory: Path, rate: float = 50.0) -> None:
    """Write truth.csv (antenna and attitude at `rate` Hz) and truth_laps.csv into `directory`.

    Times are on the session's clock; lap_time_s is in true seconds, what a transponder shows.
    """
    write_table(truth_table(simulation, rate), directory / "truth.csv")
    write_table(lap_table(simulation), directory / "truth_laps.csv")


def write_settings(simulation: Simulation, path: Path, *, states_delay: bool = False) -> None:
    """Write a session.toml that states the true mounting, noise and latencies, which leaves nothing to identify.

    states_delay: see :func:`write_title`.
    """
    scenario = simulation.scenario
    date = datetime.fromtimestamp(scenario.start_unix, UTC).date().isoformat()
    lines = [
        *("[session]", _title(simulation), f'track = "{scenario.track}"', f'date = "{date}"'),
        *("[mounting]", f"lever_arm_b = {_toml(scenario.lever_arm_b)}", f"R_bs = {_toml(scenario.R_bs)}"),
        "[gps]",
        f"position_latency = {scenario.gnss.position_latency!r}",
        f"velocity_latency = {scenario.gnss.velocity_latency!r}",
    ]
    if scenario.imu is not None:
        names = ("accel_noise", "gyro_noise", "accel_bias_walk", "gyro_bias_walk")
        lines += ["[imu]", *(f"{name} = {float(getattr(scenario.imu, name))!r}" for name in names)]
    if states_delay:
        lines += _filter_delay(simulation)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_title(simulation: Simulation, path: Path, *, states_delay: bool = False) -> None:
    """Write a session.toml that says that this was simulated, so that no report of it passes for a drive.

    states_delay: also what the low-pass of the samples holds them back by, which tables have no place for.
    """
    delay = _filter_delay(simulation) if states_delay else []
    lines = ["[session]", _title(simulation), *(["[imu]", *delay] if delay else [])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _filter_delay(simulation: Simulation) -> list[str]:
    delay = simulation.raw.config.imu_delay
    return [] if delay is None else [f"delay = {delay!r}"]


def _title(simulation: Simulation) -> str:
    return f'title = "Simulated session ({simulation.scenario.name}, {simulation.scenario.track})"'


def write_mag_calibration(simulation: Simulation, path: Path) -> None:
    """Write a calibration.toml with the true hard and soft iron."""
    errors = simulation.scenario.mag
    assert errors is not None
    to_unit = np.linalg.solve(errors.soft_iron, np.eye(3)) / np.linalg.norm(simulation.field_n)
    text = f"[magnetometer]\nhard_iron = {_toml(errors.hard_iron_s)}\nsoft_iron = {_toml(to_unit)}\n"
    path.write_text(text, encoding="utf-8")


def _toml(values: Array) -> str:
    return repr(np.asarray(values, dtype=np.float64).tolist())


def write_table(table: pl.DataFrame, path: Path) -> None:
    """Write a table as CSV, whatever the name of the folder."""
    with path.open("wb") as file:  # polars takes no path that is not UTF-8
        table.write_csv(file)


def imu_table(imu: RawImu) -> pl.DataFrame:
    """Columns of imu.csv, in SI."""
    accel, gyro = imu.accel * imu.accel_scale, imu.gyro * imu.gyro_scale
    columns = {"t_s": np.round(imu.t, _TIME_DECIMALS)}
    columns |= {name: np.round(accel[:, i], 6) for i, name in enumerate(("ax", "ay", "az"))}
    columns |= {name: np.round(gyro[:, i], 8) for i, name in enumerate(("gx", "gy", "gz"))}
    return pl.DataFrame(columns)


def mag_table(mag: RawMag) -> pl.DataFrame:
    """Columns of mag.csv."""
    columns = {"t_s": np.round(mag.t, _TIME_DECIMALS)}
    columns |= {name: np.round(mag.field[:, i], 4) for i, name in enumerate(("mx", "my", "mz"))}
    return pl.DataFrame(columns)


def wheel_table(wheel: WheelSpeed) -> pl.DataFrame:
    """Columns of wheel_speed.csv."""
    return pl.DataFrame({"t_s": np.round(wheel.t, _TIME_DECIMALS), "speed_mps": np.round(wheel.speed, 4)})


def fix_table(fixes: GnssFixes) -> pl.DataFrame:
    """Columns of gps.csv that the fixes have; components of velocity only where the receiver sent Up.

    Time and place are there without a fix too: a table without a header line would be none.
    """
    columns = {
        "t_s": np.round(fixes.t, _TIME_DECIMALS),
        "unix_s": _rounded(fixes.unix_s, 3),
        "lat_deg": np.round(fixes.lat_deg, _DEGREE_DECIMALS),
        "lon_deg": np.round(fixes.lon_deg, _DEGREE_DECIMALS),
        "alt_m": np.round(fixes.alt_m, 4),
        "speed_mps": _rounded(fixes.speed, 6),
        "course_deg": _rounded(fixes.course_deg, 5),
        "hacc_m": _rounded(fixes.sigma_horizontal, 4),
        "vacc_m": _rounded(fixes.sigma_up, 4),
        "sacc_mps": _rounded(fixes.sigma_velocity, 4),
        "hdop": _rounded(fixes.hdop, 2),
        "num_sv": fixes.num_sv,
        "fix": fixes.fix,
    }
    if np.any(np.isfinite(fixes.velocity_n[:, 2])):
        for name, axis, sign in (("vel_n_mps", 0, 1.0), ("vel_e_mps", 1, -1.0), ("vel_u_mps", 2, 1.0)):
            columns[name] = np.round(sign * fixes.velocity_n[:, axis], 6)
    sent = {name: values for name, values in columns.items() if values is not None}
    known = {name: values for name, values in sent.items() if name in FIX_COLUMNS or not np.all(np.isnan(values))}
    return pl.DataFrame(known).fill_nan(None)


def _rounded(values: Array | None, decimals: int) -> Array | None:
    return None if values is None else np.round(values, decimals)


def truth_table(simulation: Simulation, rate: float) -> pl.DataFrame:
    """Columns of truth.csv: antenna position and velocity, attitude of the kart."""
    truth, arm = simulation.truth, simulation.scenario.lever_arm_b
    start, end = truth.clock.to_session(np.array([0.0, simulation.scenario.duration]))
    t = np.round(np.arange(np.ceil(start * rate), np.floor(end * rate) + 1) / rate, _TIME_DECIMALS)
    pieces = [_truth_columns(simulation, t[i : i + _TRUTH_CHUNK], arm) for i in range(0, len(t), _TRUTH_CHUNK)]
    return pl.concat(pieces)


def _truth_columns(simulation: Simulation, t: Array, arm: Array) -> pl.DataFrame:
    trajectory = simulation.truth.trajectory(t, arm)
    lat, lon, alt = simulation.truth.antenna_geodetic(t, arm)
    angles = wrap_angle(trajectory.euler) / DEG
    columns = {
        "t_s": t,
        "lat_deg": np.round(lat, _DEGREE_DECIMALS),
        "lon_deg": np.round(lon, _DEGREE_DECIMALS),
        "alt_m": np.round(alt, 5),
    }
    columns |= {f"vel_{axis}_mps": np.round(trajectory.velocity_n[:, i], 6) + 0.0 for i, axis in enumerate(_AXES)}
    columns |= {f"{angle}_deg": np.round(angles[:, i], 6) for i, angle in enumerate(("roll", "pitch", "yaw"))}
    return pl.DataFrame(columns)


_AXES = ("north", "west", "up")


def lap_table(simulation: Simulation) -> pl.DataFrame:
    """Columns of truth_laps.csv: a row per full lap, crossings by the antenna."""
    crossing = simulation.lap_crossings()
    true_time = simulation.truth.clock.to_true(crossing)
    return pl.DataFrame(
        {
            "lap": np.arange(1, max(len(crossing), 1)),
            "start_s": np.round(crossing[:-1], _TIME_DECIMALS),
            "end_s": np.round(crossing[1:], _TIME_DECIMALS),
            "lap_time_s": np.round(np.diff(true_time), _TIME_DECIMALS),
        }
    )


def nmea_sentences(fixes: GnssFixes, kinds: Sequence[str], i: int) -> list[str]:
    """The sentences of fix i, without line end, as a NEO-6M writes them. kinds: of RMC, GGA, VTG, GST."""
    return [_with_checksum(_SENTENCES[kind](fixes, i)) for kind in kinds]


def _with_checksum(body: str) -> str:
    checksum = 0
    for byte in body.encode("ascii"):
        checksum ^= byte
    return f"${body}*{checksum:02X}"


def _rmc(fixes: GnssFixes, i: int) -> str:
    time, date = _utc(fixes, i)
    speed, course = _speed_and_course(fixes, i)
    return f"GPRMC,{time},A,{_place(fixes, i)},{speed},{course},{date},,,A"


def _gga(fixes: GnssFixes, i: int) -> str:
    assert fixes.hdop is not None and fixes.num_sv is not None
    time, _ = _utc(fixes, i)
    satellites, hdop = int(fixes.num_sv[i]), fixes.hdop[i]
    return f"GPGGA,{time},{_place(fixes, i)},1,{satellites:02d},{hdop:.2f},{fixes.alt_m[i]:.1f},M,0.0,M,,"


def _vtg(fixes: GnssFixes, i: int) -> str:
    assert fixes.speed is not None
    speed, course = _speed_and_course(fixes, i)
    kmh = "" if np.isnan(fixes.speed[i]) else f"{fixes.speed[i] * 3.6:.3f}"
    return f"GPVTG,{course},T,,M,{speed},N,{kmh},K,A"


def _gst(fixes: GnssFixes, i: int) -> str:
    assert fixes.sigma_horizontal is not None and fixes.sigma_up is not None
    time, _ = _utc(fixes, i)
    horizontal, up = ("" if np.isnan(s[i]) else f"{s[i]:.1f}" for s in (fixes.sigma_horizontal, fixes.sigma_up))
    return f"GPGST,{time},,,,,{horizontal},{horizontal},{up}"


_SENTENCES = {"RMC": _rmc, "GGA": _gga, "VTG": _vtg, "GST": _gst}


def _utc(fixes: GnssFixes, i: int) -> tuple[str, str]:
    assert fixes.unix_s is not None
    hundredths = round(fixes.unix_s[i] * 100.0)
    at = datetime.fromtimestamp(hundredths // 100, UTC)
    return f"{at:%H%M%S}.{hundredths % 100:02d}", f"{at:%d%m%y}"


def _place(fixes: GnssFixes, i: int) -> str:
    lat, lon = fixes.lat_deg[i], fixes.lon_deg[i]
    return f"{_minutes(lat, 2)},{'N' if lat >= 0.0 else 'S'},{_minutes(lon, 3)},{'E' if lon >= 0.0 else 'W'}"


def _minutes(degrees: float, width: int) -> str:
    hundred_thousandths = round(abs(degrees) * 60.0 * 1e5)  # whole, so that 59.999999 carries into the degree
    whole, rest = divmod(hundred_thousandths, 60 * 100_000)
    return f"{whole:0{width}d}{rest // 100_000:02d}.{rest % 100_000:05d}"


def _speed_and_course(fixes: GnssFixes, i: int) -> tuple[str, str]:
    assert fixes.speed is not None and fixes.course_deg is not None
    if np.isnan(fixes.speed[i]):
        return "", ""
    return f"{fixes.speed[i] / KNOT:.3f}", f"{fixes.course_deg[i]:.2f}"


def _thesis_records(imu: RawImu, mag: RawMag | None, fixes: GnssFixes, sentences: Sequence[str]) -> bytes:
    """All records of out.txt: each IMU sample, with magnetometer and sentences at the first after a fix came in."""
    index = np.arange(len(imu.t))
    start_ms = np.clip(np.floor(imu.t / MILLISECOND), 0, None).astype(np.int64)
    start_ms = np.maximum.accumulate(start_ms - index) + index  # one timer interrupt in a millisecond
    accel = _counts(imu.accel * imu.accel_scale / thesis.ACCEL_SCALE)
    gyro = _counts(imu.gyro * imu.gyro_scale / thesis.GYRO_SCALE)
    carrier = np.searchsorted(imu.t, fixes.t)
    block_of = {int(k): block for k, block in zip(carrier, _gps_blocks(mag, fixes, sentences), strict=True)}
    records = []
    for k, (ms, values) in enumerate(zip(start_ms.tolist(), np.hstack([accel, gyro]).tolist(), strict=True)):
        block = block_of.get(k)
        records.append(thesis.RECORD_START + thesis.IMU_STRUCT.pack(ms & 0xFFFFFFFF, *values))
        records.append(bytes([thesis.NO_GPS_FLAG]) if block is None else bytes([thesis.GPS_FLAG]) + block)
        records.append(thesis.END_STRUCT.pack((ms + 1) & 0xFFFFFFFF))  # reading the sensors takes 1 ms
    return b"".join(records)


def _gps_blocks(mag: RawMag | None, fixes: GnssFixes, sentences: Sequence[str]) -> list[bytes]:
    """Magnetometer triple and receiver's buffer of each fix; where a new sentence is shorter, the old one shows."""
    if mag is None:
        triples = [thesis.MAG_STRUCT.pack(0, 0, 0)] * len(fixes)
    else:
        latest = np.clip(np.searchsorted(mag.t, fixes.t, side="right") - 1, 0, None)
        triples = _mag_triples(mag.field[latest])
    buffer = bytearray(NMEA_BLOCK * len(sentences))
    blocks = []
    for i, triple in enumerate(triples):
        text = "".join(sentence + "\r\n" for sentence in nmea_sentences(fixes, sentences, i)).encode("ascii")
        buffer[: len(text)] = text
        blocks.append(triple + bytes(buffer))
    return blocks


def _mag_triples(field: Array) -> list[bytes]:
    counts = _counts(field / 0.15)  # uT per count of the AK8963
    return [thesis.MAG_STRUCT.pack(my, mx, -mz) for mx, my, mz in np.maximum(counts, -32767).tolist()]


def _counts(values: Array) -> np.ndarray:
    return np.clip(np.round(values), *_INT16).astype(np.int64)
