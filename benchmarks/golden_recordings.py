"""Golden rows of the recordings in SMOOTH_DATA: whatever of them has fixes, as folder or as a logger's own file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from golden_command import Array, Bench, IntArray, Table, columns, link_files, read_table
from golden_measures import RESULTS, has_results, line_columns, resampled, run_columns, truth_columns
from golden_sessions import edit_csv
from golden_tables import Columns, Rows

Reference = Callable[[Bench, Path, Path, Mapping[str, Any]], Columns]
"""Columns that a reference gives: of the bench, the session, the recording's folder, the summary."""

SITE = 49.0, 8.43  # degrees, where the drive is put whose truth has no position on the earth
METRES_PER_DEGREE = 111_200.0
FIX_NOISE, FIX_OFFSET, FIX_OFFSET_TAU = 0.2, 1.5, 60.0  # m, m, s: of fixes made from a truth
SONOMA_LINE = "38.16140,-122.45462;38.16168,-122.45462"
SONOMA_LAPS = np.array([128.1, 126.3, 127.8, 126.4, 127.9, 130.6, 126.8])  # s
GATE = 8.0  # m, half the width of a line laid through where the logger's laps began


@dataclass(frozen=True)
class Recording:
    """One recording.

    source: folder or file in SMOOTH_DATA; of a folder all files are given. reference: what else there is to compare
    with. make: writes the session itself, where the files as they are will not do.
    """

    name: str
    source: str
    reference: Reference | None = None
    make: Callable[[Path, Path], None] | None = None
    quick: bool = False

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows this job gives."""
        return (self.name,)

    def run(self, bench: Bench, work: Path) -> Rows:
        """Smooth and measure."""
        assert bench.recordings is not None
        source = bench.recordings / self.source
        folder = work / self.name
        place(source, folder, self.make)
        names = [path.name for path in folder.iterdir() if path.name != "README"]
        found, outcome = run_columns(bench, folder, names[0] if len(names) == 1 else "")
        if self.reference is not None and has_results(folder):
            found |= self.reference(bench, folder, source if source.is_dir() else source.parent, outcome.document)
        return {self.name: found}


def place(source: Path, folder: Path, make: Callable[[Path, Path], None] | None = None) -> None:
    """Put the session of a recording into a folder: links to its files, or what `make` writes."""
    if make is not None:
        folder.mkdir(parents=True)
        make(source, folder)
    elif source.is_dir():
        link_files(source, folder)
    else:
        link_files(source.parent, folder, (source.name,))


def against_truth(bench: Bench, folder: Path, recording: Path, summary: Mapping[str, Any]) -> Columns:
    """Errors against the session's truth.csv, with one lag for positions and one for velocities."""
    trajectory = read_table(folder / RESULTS / "trajectory.csv")
    return truth_columns(trajectory, read_table(folder / "truth.csv"), summary, fit_lag=True)


def against_truth_on_its_clock(bench: Bench, folder: Path, recording: Path, summary: Mapping[str, Any]) -> Columns:
    """Errors against the session's truth.csv, of which both times are those of satellites; who walks shows no lag."""
    trajectory = read_table(folder / RESULTS / "trajectory.csv")
    return truth_columns(trajectory, read_table(folder / "truth.csv"), summary)


def against_logged_starts(bench: Bench, folder: Path, recording: Path, summary: Mapping[str, Any]) -> Columns:
    """Lap times against those the logger stored, over the line where its laps began."""
    logged = read_table(recording / "laps_logged.csv")
    trajectory = read_table(folder / RESULTS / "trajectory.csv")
    names = ("lat_deg", "lon_deg", "vel_north_mps", "vel_west_mps")
    lat, lon, north, west = np.nanmedian(resampled(trajectory, names, logged["start_s"]), axis=0)
    across = np.array([-west, north]) / np.hypot(north, west) * GATE  # to the left of the motion; north, west
    per_degree = METRES_PER_DEGREE * np.array([1.0, -np.cos(np.radians(lat))])
    ends = [np.array([lat, lon]) + sign * across / per_degree for sign in (1, -1)]
    found = logged_columns(bench, folder, ";".join(f"{a:.8f},{b:.8f}" for a, b in ends), logged)
    return found | line_columns(folder, logged["start_s"], logged["end_s"])


def against_track(bench: Bench, folder: Path, recording: Path, summary: Mapping[str, Any]) -> Columns:
    """Lap times against those the logger stored, over its own line."""
    return logged_columns(bench, folder, recording / "track_OKC.json", read_table(recording / "laps_logged.csv"))


def against_lap_counter(bench: Bench, folder: Path, recording: Path, summary: Mapping[str, Any]) -> Columns:
    """Lap times against those of Sonoma's own lap counter, over the line where it changes."""
    return logged_columns(bench, folder, SONOMA_LINE, {"lap_time_s": SONOMA_LAPS})


def logged_columns(bench: Bench, folder: Path, line: str | Path, logged: Table) -> Columns:
    """Rms of the differences of lap times from the logged ones, and over their sigmas.

    Laps are matched as two sequences: the shift counts at which most agree.
    """
    laps = bench.command("laps", "--json", "--line", line, folder.name, folder=folder.parent)
    timed = [lap for lap in laps.document.get("laps", []) if lap["lap_time_s"] and lap["lap_time_sigma_s"]]
    times, sigmas = (np.array([lap[key] for lap in timed]) for key in ("lap_time_s", "lap_time_sigma_s"))
    best = matched(times, logged["lap_time_s"])
    found: Columns = {"laps.matched": len(best)}
    if len(best):
        error = times[best[:, 0]] - logged["lap_time_s"][best[:, 1]]
        found["error.laps_s"] = float(np.sqrt(np.mean(error**2)))
        found["z.laps_rms"] = float(np.sqrt(np.mean((error / sigmas[best[:, 0]]) ** 2)))
    return found


def matched(times: Array, logged: Array, near: float = 0.5) -> IntArray:
    """Pairs (K, 2) of the numbers of equal laps, from the shift of the sequences at which most are `near` (s)."""
    best = np.empty((0, 2), dtype=np.int64)
    for shift in range(-len(logged) + 1, len(times)):
        pairs = np.array([(i, i - shift) for i in range(len(times)) if 0 <= i - shift < len(logged)])
        pairs = pairs[np.abs(times[pairs[:, 0]] - logged[pairs[:, 1]]) < near] if len(pairs) else pairs
        if len(pairs) > len(best):
            best = pairs
    return best


def with_fixes_of_truth(source: Path, folder: Path) -> None:
    """Samples as they are; fixes are the truth with a slow and a white error (seeded); truth as degrees."""
    link_files(source, folder, ("imu.csv",))
    truth = read_table(source / "truth.csv")
    random = np.random.default_rng(471)
    t, n = truth["t_s"], columns(truth, "north_m", "west_m", "up_m")
    slow = np.empty_like(n)
    slow[0] = FIX_OFFSET * random.standard_normal(3)
    for i, step in enumerate(np.diff(t), 1):
        kept = np.exp(-step / FIX_OFFSET_TAU)
        slow[i] = kept * slow[i - 1] + FIX_OFFSET * np.sqrt(1 - kept**2) * random.standard_normal(3)
    for name, position in (("truth", n), ("gps", n + slow + FIX_NOISE * random.standard_normal(n.shape))):
        lat = SITE[0] + position[:, 0] / METRES_PER_DEGREE
        lon = SITE[1] - position[:, 1] / (METRES_PER_DEGREE * np.cos(np.radians(SITE[0])))
        rows = (f"{a:.4f},{b:.9f},{c:.9f},{d:.3f}" for a, b, c, d in zip(t, lat, lon, position[:, 2], strict=True))
        (folder / f"{name}.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,alt_m", *rows]) + "\n", "utf-8")


def without_true_velocity(source: Path, folder: Path) -> None:
    """Leave out the truth's velocities, whose course is not that of its positions."""
    link_files(source, folder)
    velocity = ("vel_north_mps", "vel_west_mps", "vel_up_mps")

    def edit(header: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
        kept = [i for i, name in enumerate(header) if name not in velocity]
        return [header[i] for i in kept], [[row[i] for i in kept] for row in rows]

    edit_csv(folder / "truth.csv", edit)


def receiver(name: str) -> Callable[[Path, Path], None]:
    """Return what makes a session of one of the receivers that were carried side by side, RTK as truth."""

    def make(source: Path, folder: Path) -> None:
        (folder / "gps.csv").symlink_to((source / f"gps_{name}.csv").resolve())
        (folder / "truth.csv").symlink_to((source / "truth_F9P_rtk.csv").resolve())

    return make


FOLDERS = (
    Recording("bicycle", "bicycle_neo6m"),
    Recording("car_comma2k19", "car_comma2k19", against_truth, quick=True),
    Recording("car_hi600", "car_hi600_rtk", against_truth, without_true_velocity),
    Recording("car_kitti", "car_kitti", against_truth, with_fixes_of_truth),
    Recording("car_twin_a", "car_hi600_twin_a"),
    Recording("car_twin_b", "car_hi600_twin_b"),
    Recording("kart_adria", "kart_adria_first_half", against_logged_starts, quick=True),
    Recording("kart_lignano", "kart_lignano_racebox"),
    Recording("kart_massa", "kart_massafinalese_racechrono"),
    Recording("kart_okc", "kart_okc_doves", against_track),
    Recording("nmea_okc_25hz", "nmea_kart_okc/okc_2025-11-23_25hz.nmea"),
    Recording("nmea_okc_long_lap", "nmea_kart_okc/gps_race_data_long_lap.nmea"),
    Recording("nmea_okc_praga", "nmea_kart_okc/gps_race_data_praga_laps.nmea"),
    *(
        Recording(f"walk_{name}", "nmea_walk_vs_rtk", against_truth_on_its_clock, receiver(name))
        for name in ("AG3335", "M8P_1", "M8P_2", "RAC")
    ),
    Recording("vbo_lignano", "kart_lignano_racebox/raw_racebox_lignano.vbo"),
    Recording("vbo_massa", "kart_massafinalese_racechrono/raw_racechrono_massa.vbo"),
    Recording("aim_adria", "aim_xrk_adria_first_half"),
    Recording("racecapture_sonoma", "racecapture_sonoma", against_lap_counter),
    Recording("gopro_hero7", "gopro_hero7_raw"),
    Recording("gopro_hero11", "gopro_hero11_raw"),
    Recording("gopro_karma", "gopro_karma"),
)
# The samples of gopro_csv_folder and racecapture_log are of a drive at 17.41 E, their longitudes are west: the track
# is mirrored, and the gate rejects attitudes with reason. With east longitudes both pass.
CASES = tuple(
    Recording(f"case_{name}", f"cases/{name}")
    for name in (
        "aim_rs3_kart", "course_flat_degrees", "degrees_hemisphere_columns", "degrees_hemisphere_nocourse",
        "degrees_letters", "degrees_two_decimals", "gopro_csv_folder", "gpx_whole_seconds_10hz", "harry_en",
        "imu_raw_lsb", "kml_gxtrack", "position_jump_25m_named", "position_jump_25m_nocourse", "quoted_comma_note",
        "racecapture_log", "sensorlogger_folder", "time_ms_column", "time_ymdhms_columns", "vbo_colon_time",
    )
)  # fmt: skip
RECORDINGS = FOLDERS + CASES
