"""Golden rows of damaged files: what the command makes of each, never a traceback.

All come from a session of 40 s at 100 samples and 5 fixes a second: as the simulator writes it, and the same fixes in
the formats of other programs. Damage is seeded; a row has exit code, problems, the last line of a refusal, and rows
kept of every file.
"""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import reduce
from gzip import compress
from operator import xor
from pathlib import Path

import numpy as np

from golden_command import Bench, read_table
from golden_measures import OPTIONS, outcome_columns, without_numbers
from golden_sessions import simulated
from golden_tables import Columns, Rows

COMMON = ("--preset", "kart", "--seed", "5", "--duration", "40", "--imu-rate", "100", "--set", "gnss.outages=")
BLOCK = 512  # bytes of a .KLG that are written at once
KNOT = 1852.0 / 3600.0  # m/s
SEED = 55
MEASURES = {"duration": "duration_s", "distance": "distance_m"}
COUNTS = ("rows", "fixes", "fixes_used", "imu_samples", "mag_samples")

Lines = list[bytes]
Mutate = Callable[[bytes], bytes]
Make = Callable[[Path, Path], None]
"""Makes a damaged session from the folder of good ones (a folder a format) in a folder that does not exist."""


@dataclass(frozen=True)
class DamagedFile:
    """One damaged session."""

    name: str
    make: Make
    quick: bool = False

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows this job gives."""
        return (self.name,)

    def run(self, bench: Bench, work: Path) -> Rows:
        """Damage and smooth; the session has the same name for all, so that messages are the same."""
        self.make(good_sessions(bench), work / "session")
        outcome = bench.command("session", *OPTIONS, folder=work)
        found: Columns = dict(outcome_columns(outcome))
        if "message" in found:
            found["message"] = str(found["message"]).replace(f"{work}/", "")
        document = outcome.document
        for problem in document.get("problems", ()):
            name = f"problem.{problem['code']}"
            found[name] = int(found.get(name, 0)) + int(problem["count"])
        if reasons := document.get("quality", {}).get("reasons"):
            found["reason"] = without_numbers(reasons[0])
        session = document.get("session", {})  # numbers that are read wrong make another way
        found |= {name: float(session[key]) for name, key in MEASURES.items() if key in session}
        counts = document.get("counts", {})
        found |= {f"counts.{name}": int(counts[name]) for name in COUNTS if name in counts}
        return {self.name: found}


def good_sessions(bench: Bench) -> Path:
    """Return the folder of the undamaged sessions, made on the first call for these arguments and this simulator."""
    made = {form: simulated(bench, (*COMMON, "--format", form)) for form in ("csv", "klg", "thesis")}
    folder = bench.cache / "damaged" / made["csv"].name
    if folder.is_dir():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
        staging = Path(temporary) / "good"
        for form, source in made.items():
            (staging / form).mkdir(parents=True)
            for path in source.iterdir():
                if path.name.endswith((".csv", ".KLG", "out.txt", ".toml")) and "truth" not in path.name:
                    shutil.copyfile(path, staging / form / path.name)
        write_other_formats(staging)
        if not folder.is_dir():
            try:
                staging.rename(folder)
            except OSError:  # another process was first: its files are the same
                if not folder.is_dir():
                    raise
    return folder


def write_other_formats(folder: Path) -> None:
    """Write the fixes of csv/gps.csv as NMEA beside the samples, and alone as .vbo, .gpx and RaceChrono's CSV."""
    fixes = read_table(folder / "csv" / "gps.csv")
    t, unix, lat, lon, alt = (fixes[name] for name in ("t_s", "unix_s", "lat_deg", "lon_deg", "alt_m"))
    speed, course = fixes["speed_mps"], fixes["course_deg"]
    moments = [datetime.fromtimestamp(round(float(u) * 100) / 100, UTC) for u in unix]
    for form in ("nmea", "vbo", "gpx", "racechrono"):
        (folder / form).mkdir()
    shutil.copyfile(folder / "csv" / "imu.csv", folder / "nmea" / "imu.csv")
    rmc = [
        f"GPRMC,{m:%H%M%S}.{m.microsecond // 10000:02d},A,{_minutes(a, 2)},N,{_minutes(o, 3)},E,"
        f"{v / KNOT:.3f},{c:.2f},{m:%d%m%y},,,A"
        for m, a, o, v, c in zip(moments, lat, lon, speed, course, strict=True)
    ]
    text = "".join(f"{at:.6f},${body}*{_checksum(body):02X}\r\n" for at, body in zip(t, rmc, strict=True))
    (folder / "nmea" / "gps.nmea").write_bytes(text.encode())
    head = (
        *("File created on 16/05/2026 at 10:00:00", "", "[header]", "satellites", "time", "latitude", "longitude"),
        *("velocity kmh", "heading", "height", "", "[column names]", "sats time lat long velocity heading height"),
        *("", "[data]"),
    )
    rows = [
        f"010 {m:%H%M%S}.{m.microsecond // 1000:03d} {60 * a:+013.6f} {-60 * o:+013.6f} "
        f"{3.6 * v:07.3f} {c:07.3f} {h:+09.3f}"
        for m, a, o, v, c, h in zip(moments, lat, lon, speed, course, alt, strict=True)
    ]
    (folder / "vbo" / "run.vbo").write_bytes("\r\n".join([*head, *rows, ""]).encode())
    points = [
        f'<trkpt lat="{a:.9f}" lon="{o:.9f}"><ele>{h:.2f}</ele><time>{m:%Y-%m-%dT%H:%M:%S}.{m.microsecond // 1000:03d}Z'
        f"</time><extensions><speed>{v:.3f}</speed><course>{c:.2f}</course></extensions></trkpt>\n"
        for m, a, o, v, c, h in zip(moments, lat, lon, speed, course, alt, strict=True)
    ]
    top = '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">\n'
    (folder / "gpx" / "run.gpx").write_bytes(f"{top}<trk><trkseg>\n{''.join(points)}</trkseg></trk></gpx>\n".encode())
    top = (
        "This file is created using RaceChrono v9.1.3 ( http://racechrono.com/ ).\nFormat,3\nSession title,x\n\n"
        "timestamp,fragment_id,accuracy,altitude,bearing,fix_type,latitude,longitude,satellites,speed\n"
        "unix time,,m,m,deg,,deg,deg,sats,m/s\n," + 8 * ",100: gps" + "\n"
    )
    rows = [
        f"{u:.3f},0,2.00,{h:.2f},{c:.2f},3,{a:.9f},{o:.9f},10,{v:.3f}\n"
        for u, h, c, a, o, v in zip(unix, alt, course, lat, lon, speed, strict=True)
    ]
    (folder / "racechrono" / "session.csv").write_bytes((top + "".join(rows)).encode())


def _minutes(degrees: float, width: int) -> str:
    whole, rest = divmod(round(degrees * 6_000_000), 6_000_000)
    return f"{whole:0{width}d}{rest / 100_000:08.5f}"


def _checksum(body: str) -> int:
    return reduce(xor, body.encode())


def damaged(form: str, **files: Mutate | bytes | None) -> Make:
    """Copy the good session of a format and damage files of it, `imu_csv` for imu.csv; bytes replace, None removes."""

    def make(good: Path, target: Path) -> None:
        shutil.copytree(good / form, target)
        for word, mutate in files.items():
            stem, _, ending = word.rpartition("_")
            path = target / f"{stem}.{ending}"
            if mutate is None:
                path.unlink()
            else:
                path.write_bytes(mutate if isinstance(mutate, bytes) else mutate(path.read_bytes()))

    return make


def only_file(form: str, ending: str, mutate: Mutate) -> Make:
    """Copy the good session of a format and damage its one file of an ending."""

    def make(good: Path, target: Path) -> None:
        shutil.copytree(good / form, target)
        (path,) = target.glob(f"*.{ending}")
        path.write_bytes(mutate(path.read_bytes()))

    return make


def gzipped(mutate: Mutate) -> Make:
    """The samples are packed, and the archive is damaged."""

    def make(good: Path, target: Path) -> None:
        shutil.copytree(good / "csv", target)
        data = (target / "imu.csv").read_bytes()
        (target / "imu.csv").unlink()
        (target / "imu.csv.gz").write_bytes(mutate(compress(data, mtime=0)))

    return make


def folder_for_file(name: str) -> Make:
    """A folder has the name of a file."""

    def make(good: Path, target: Path) -> None:
        shutil.copytree(good / "csv", target)
        (target / name).unlink()
        (target / name).mkdir()

    return make


def fixes_of_another(form: str, name: str) -> Make:
    """gps.csv is the file of another kind."""

    def make(good: Path, target: Path) -> None:
        shutil.copytree(good / "csv", target)
        shutil.copyfile(good / form / name, target / "gps.csv")

    return make


def nothing(_: Path, target: Path) -> None:
    """An empty folder."""
    target.mkdir()


def cut(share: float) -> Mutate:
    """The file ends early, in the middle of a line."""
    return lambda data: data[: int(len(data) * share)]


def overwritten(value: int, share: float, length: int) -> Mutate:
    """A stretch of bytes, `length` at `share` of the file, has one value: a sector never written, or erased."""

    def mutate(data: bytes) -> bytes:
        at = int(len(data) * share)
        return data[:at] + bytes([value]) * len(data[at : at + length]) + data[at + length :]

    return mutate


def noise(share: float, length: int) -> Mutate:
    """A stretch of random bytes, `length` at `share` of the file."""

    def mutate(data: bytes) -> bytes:
        at = int(len(data) * share)
        bad = np.random.default_rng(SEED).bytes(len(data[at : at + length]))
        return data[:at] + bad + data[at + length :]

    return mutate


def bits_flipped(count: int) -> Mutate:
    """Single bits anywhere."""

    def mutate(data: bytes) -> bytes:
        rng, changed = np.random.default_rng(SEED), bytearray(data)
        for at, bit in zip(rng.integers(len(data), size=count), rng.integers(8, size=count), strict=True):
            changed[at] ^= 1 << int(bit)
        return bytes(changed)

    return mutate


def rows(change: Callable[[Lines], Lines]) -> Mutate:
    """Change the lines after the header."""

    def mutate(data: bytes) -> bytes:
        head, *lines = data.splitlines(keepends=True)
        return b"".join([head, *change(lines)])

    return mutate


def repeated(first: int, count: int) -> Mutate:
    """Rows stand there twice, one block after the other."""
    return rows(lambda lines: [*lines[: first + count], *lines[first:]])


def swapped(i: int) -> Mutate:
    """Two neighbouring rows changed places."""
    return rows(lambda lines: [*lines[:i], lines[i + 1], lines[i], *lines[i + 2 :]])


def shuffled(lines: Lines) -> Lines:
    """Rows in any order."""
    return [lines[i] for i in np.random.default_rng(SEED).permutation(len(lines))]


def lost(first: int, count: int) -> Mutate:
    """Rows are missing."""
    return rows(lambda lines: [*lines[:first], *lines[first + count :]])


def cells(column: str, change: Callable[[bytes], bytes], first: int = 0, last: int = 10**9, step: int = 1) -> Mutate:
    """Change the cells of a column in some rows."""

    def mutate(data: bytes) -> bytes:
        head, *lines = data.splitlines()
        i = head.split(b",").index(column.encode())
        for k in range(first, min(last, len(lines)), step):
            parts = lines[k].split(b",")
            parts[i] = change(parts[i])
            lines[k] = b",".join(parts)
        return b"\n".join([head, *lines, b""])

    return mutate


def all_of(*mutations: Mutate) -> Mutate:
    """One damage after the other."""
    return lambda data: reduce(lambda so_far, mutate: mutate(so_far), mutations, data)


def filled(text: bytes, column: str, first: int, last: int, step: int = 1) -> Mutate:
    """Cells of a column become a text."""
    return cells(column, lambda _: text, first, last, step)


def scaled(factor: float, *columns: str) -> Mutate:
    """Columns are in another unit."""
    return all_of(*(cells(column, lambda cell: b"%.8g" % (float(cell) * factor)) for column in columns))


def without_column(column: str) -> Mutate:
    """A column is missing."""

    def mutate(data: bytes) -> bytes:
        table = [line.split(b",") for line in data.splitlines()]
        i = table[0].index(column.encode())
        return b"\n".join([b",".join([*cells[:i], *cells[i + 1 :]]) for cells in table]) + b"\n"

    return mutate


def recoded(coding: str) -> Mutate:
    """The text is in another encoding."""
    return lambda data: data.decode().encode(coding)


def without_header(data: bytes) -> bytes:
    """The line of names is missing."""
    return data.partition(b"\n")[2]


def decimal_commas(data: bytes) -> bytes:
    """Semicolons between cells, commas in numbers."""
    return data.replace(b",", b";").replace(b".", b",")


def checksums_bad(data: bytes) -> bytes:
    """Every tenth sentence has one digit changed, and the checksum of before."""
    lines = data.splitlines(keepends=True)
    return b"".join(line.replace(b",N,", b",S,") if k % 10 == 5 else line for k, line in enumerate(lines))


def blocks(change: Callable[[list[bytes]], list[bytes]]) -> Mutate:
    """Change the blocks of a .KLG."""
    return lambda data: b"".join(change([data[i : i + BLOCK] for i in range(0, len(data), BLOCK)]))


def blocks_damaged(whole: list[bytes]) -> list[bytes]:
    """A bit is wrong in every twentieth block."""
    return [bits_flipped(1)(block) if k % 20 == 10 else block for k, block in enumerate(whole)]


IMU_UNITS = 180.0 / np.pi  # degrees per second for radians per second
LATE_FIX = b"60.0,1778925660.0,52.1,17.4,100.0,0,0,2,4,0.3,0.9,10,1\n"


def _cases() -> dict[str, Make]:
    csv, klg = "csv", "KLG"
    imu = {  # damage of imu.csv
        "cut_in_line": cut(0.7001),
        "nuls": overwritten(0, 0.5, 4096),
        "erased_block": overwritten(255, 0.5, 4096),
        "bits_flipped": bits_flipped(20),
        "rows_swapped": swapped(1500),
        "rows_shuffled": rows(shuffled),
        "nan": filled(b"nan", "gz", 1000, 1100),
        "empty_cells": filled(b"", "ax", 0, 4000, 7),
        "huge_number": filled(b"1e308", "gx", 1500, 1501),
        "no_header": without_header,
        "no_gz_column": without_column("gz"),
        "no_time_column": without_column("t_s"),
        "semicolons": lambda data: data.replace(b",", b";"),
        "decimal_commas": decimal_commas,
        "utf16": recoded("utf-16"),
        "crlf": lambda data: data.replace(b"\n", b"\r\n"),
        "gyro_in_deg": scaled(IMU_UNITS, "gx", "gy", "gz"),
        "accel_in_g": scaled(1.0 / 9.80665, "ax", "ay", "az"),
        "time_in_ms": scaled(1000.0, "t_s"),
        "time_constant": filled(b"5.0", "t_s", 0, 10**9),
        "time_set_back": cells("t_s", lambda cell: b"%.6f" % (float(cell) - 15.0), 2000),
    }
    gps = {  # damage of gps.csv
        "erased_block": overwritten(255, 0.5, 2048),
        "rows_repeated": repeated(80, 20),
        "rows_shuffled": rows(shuffled),
        "one_fix": rows(lambda lines: lines[:1]),
        "no_fix": rows(lambda lines: []),
        "absurd_latitude": filled(b"95.0", "lat_deg", 100, 103),
        "zero_island": all_of(filled(b"0", "lat_deg", 0, 30), filled(b"0", "lon_deg", 0, 30)),
        "speed_in_kmh": scaled(3.6, "speed_mps"),
        "radians": scaled(np.pi / 180.0, "lat_deg", "lon_deg"),
        "no_longitude": without_column("lon_deg"),
        "no_header": without_header,
        "last_fix_late": lambda data: data + LATE_FIX,
        "decimal_commas": decimal_commas,
    }
    made = {f"imu_{name}": damaged(csv, imu_csv=mutate) for name, mutate in imu.items()}
    made |= {f"gps_{name}": damaged(csv, gps_csv=mutate) for name, mutate in gps.items()}
    made |= {
        "nothing": nothing,
        "imu_empty": damaged(csv, imu_csv=b""),
        "gps_empty": damaged(csv, gps_csv=b""),
        "gps_missing": damaged(csv, gps_csv=None),
        "imu_garbage": damaged(csv, imu_csv=noise(0.0, 10**9)),
        "mag_garbage": damaged(csv, mag_csv=noise(0.0, 10**9)),
        "imu_folder": folder_for_file("imu.csv"),
        "gps_folder": folder_for_file("gps.csv"),
        "gps_is_a_klg": fixes_of_another("klg", "LOG00002.KLG"),
        "gps_is_a_gpx": fixes_of_another("gpx", "run.gpx"),
        "gz_cut": gzipped(cut(0.6)),
        "settings_unknown_key": damaged(csv, session_toml=b"[gps]\nposition_latensy = 0.1\n"),
        "settings_no_toml": damaged(csv, session_toml=b"[gps\nposition_latency 0.1\n"),
        "settings_latency_nan": damaged(csv, session_toml=b"[gps]\nposition_latency = nan\n"),
        "calibration_bad": damaged(csv, calibration_toml=b"[accelerometer]\noffset = [1, 2]\n"),
        "calibration_singular": damaged(
            csv, calibration_toml=b"[accelerometer]\nmatrix = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]\n"
        ),
        "klg_block_bits": only_file("klg", klg, blocks(blocks_damaged)),
        "klg_blocks_lost": only_file("klg", klg, blocks(lambda b: b[:200] + b[230:])),
        "klg_blocks_swapped": only_file("klg", klg, blocks(lambda b: [*b[:200], b[201], b[200], *b[202:]])),
        "klg_cut": only_file("klg", klg, cut(0.6001)),
        "klg_erased": only_file("klg", klg, overwritten(255, 0.4, 8 * BLOCK)),
        "klg_empty": only_file("klg", klg, lambda data: b""),
        "klg_garbage": only_file("klg", klg, noise(0.0, 10**9)),
        "nmea_checksums": damaged("nmea", gps_nmea=checksums_bad),
        "nmea_noise": damaged("nmea", gps_nmea=noise(0.5, 700)),
        "vbo_cut": damaged("vbo", run_vbo=cut(0.7)),
        "vbo_decimal_commas": damaged("vbo", run_vbo=lambda data: data.replace(b".", b",")),
        "vbo_no_data": damaged("vbo", run_vbo=lambda data: data.partition(b"[data]")[0]),
        "gpx_cut": damaged("gpx", run_gpx=cut(0.7)),
        "gpx_nul_in_tag": damaged("gpx", run_gpx=lambda data: data.replace(b"<time>", b"<ti\x00me>", 3)),
        "racechrono_bits_flipped": damaged("racechrono", session_csv=bits_flipped(20)),
        "thesis_bits_flipped": damaged("thesis", out_txt=bits_flipped(40)),
        "thesis_noise": damaged("thesis", out_txt=noise(0.5, 2000)),
    }
    return {**{f"undamaged_{form}": damaged(form) for form in ("csv", "klg")}, **made}


QUICK = {
    *("imu_cut_in_line", "imu_utf16", "imu_no_gz_column", "gps_rows_shuffled", "gps_no_fix", "gz_cut"),
    *("settings_unknown_key", "klg_block_bits", "nmea_checksums", "gpx_cut"),
}
CASES: tuple[DamagedFile, ...] = tuple(DamagedFile(name, make, name in QUICK) for name, make in _cases().items())
