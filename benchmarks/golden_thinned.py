"""Golden rows of two real karts with fixes left out: how near the smoothed path is to the fixes it was not given.

Each recording is thinned to one fix in 1, 2 and 5 s at six phases, with and without one more fix some 0.25 s behind
the last one kept, which should change next to nothing. A fix stamped t was true at t - latency: the path is read
there, with the latency that was identified from the thinned fixes. Stamps that the logger rounded are put back onto
their grid first, as a reader does who has all fixes; nobody can see it from few. Not scored: repeated positions,
fixes whose own accuracy is worse than three times the median, the first second.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from golden_command import Array, Bench, IntArray, Table, columns, link_files, read_table
from golden_measures import RESULTS, has_results, outcome_columns, sigma_columns, smooth, summary_columns, to_n
from golden_sessions import edit_column, edit_csv, keep_rows
from golden_tables import Columns, Rows

WORST_ACCURACY = 3.0  # times the median of the reported accuracy
SETTLING = 1.0  # s after the first fix: longer than any latency
BEHIND = 0.25  # s, of the further fix behind the last one kept
PHASES = 6
KEPT = (
    *("exit", "traceback", "message", "mode", "problem.", "quality.", "rejected.", "identified.gps_position_latency"),
    *("identified.gps_velocity_latency", "identified.lever_arm_b", "identified.gyro_noise"),
)
"""How the columns begin that these rows have of a summary's."""


@dataclass(frozen=True)
class Thinned:
    """One recording thinned to one fix in `interval` s; the first fix kept is phase/PHASES of that after the first.

    grid: s between fixes as the receiver gave them, where the file has rounded stamps.
    """

    recording: str
    source: str
    grid: float | None
    interval: int
    phase: int
    more: bool
    quick: bool = False

    @property
    def group(self) -> str:
        """Name without the phase."""
        return f"{self.recording}_{self.interval}s{'_more' if self.more else ''}"

    @property
    def name(self) -> str:
        """Name of the row."""
        return f"{self.group}_phase{self.phase}"

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows this job gives."""
        return (self.name,)

    def run(self, bench: Bench, work: Path) -> Rows:
        """Smooth and compare with the fixes left out."""
        assert bench.recordings is not None
        folder = work / self.name
        link_files(bench.recordings / self.source, folder, ("imu.csv", "gps.csv"))
        if (grid := self.grid) is not None:
            edit_csv(folder / "gps.csv", edit_column("t_s", lambda t: np.round(t / grid) * grid, 4))
        fixes = read_table(folder / "gps.csv")
        kept = kept_fixes(fixes, self.interval, self.phase / PHASES)
        given = with_one_more(fixes, kept) if self.more else kept
        edit_csv(folder / "gps.csv", keep_rows(given))
        outcome = smooth(bench, folder)
        found = outcome_columns(outcome)
        if has_results(folder):
            trajectory = read_table(folder / RESULTS / "trajectory.csv")
            summary = outcome.document
            every = summary_columns(summary)
            found |= {name: value for name, value in every.items() if name.startswith(KEPT)}
            found |= sigma_columns(trajectory)
            n = to_n(fixes["lat_deg"], fixes["lon_deg"], fixes["alt_m"], summary["origin"])[:, :2]
            left_out = scored(fixes, kept)
            latency = float(summary["identified"]["gps_position_latency"]["value"])
            found |= left_out_columns(trajectory, fixes["t_s"][left_out] - latency, n[left_out])
        return {self.name: found}


def usable(fixes: Table) -> IntArray:
    """Numbers (K,) of the rows that are fixes: with a position, not repeated, fix type at least 1."""
    position = columns(fixes, "lat_deg", "lon_deg")
    good = np.isfinite(position).all(axis=1) & ~(fixes.get("fix", np.ones(len(position))) < 1)
    rows = np.flatnonzero(good)
    new = np.concatenate([[True], np.any(np.diff(position[rows], axis=0) != 0, axis=1)])
    return np.asarray(rows[new])


def kept_fixes(fixes: Table, interval: float, phase: float) -> IntArray:
    """Numbers of the fixes kept: the first of every interval (s); the intervals begin `phase` of one later."""
    rows = usable(fixes)
    t = fixes["t_s"][rows]
    slot = np.floor((t - t[0]) / interval - phase + 1e-6)
    return np.asarray(rows[np.concatenate([[phase == 0.0], np.diff(slot) > 0])])


def with_one_more(fixes: Table, kept: IntArray) -> IntArray:
    """The fixes kept and the one nearest to BEHIND seconds after the last of them, if there is a later one."""
    rows = usable(fixes)
    t = fixes["t_s"]
    later = rows[t[rows] > t[kept[-1]]]
    if not len(later):
        return kept
    return np.append(kept, later[np.argmin(np.abs(t[later] - t[kept[-1]] - BEHIND))])


def scored(fixes: Table, kept: IntArray) -> IntArray:
    """Numbers of the fixes left out that count."""
    rows = np.setdiff1d(usable(fixes), kept)
    t = fixes["t_s"]
    accuracy = fixes.get("hacc_m", np.full(len(t), np.nan))[rows]
    poor = accuracy > WORST_ACCURACY * np.nanmedian(fixes["hacc_m"]) if "hacc_m" in fixes else np.zeros(len(rows), bool)
    after = max(t[kept[0]], t[usable(fixes)[0]] + SETTLING)
    return np.asarray(rows[~poor & (t[rows] > after) & (t[rows] < t[kept[-1]])])


def left_out_columns(trajectory: Table, at: Array, fixes: Array) -> Columns:
    """Distance of the path, read at the times `at` (N,), from fixes (N, 2): rms, and what 95 % are below, m."""
    t = trajectory["t_s"]
    inside = (at >= t[0]) & (at <= t[-1])
    path = CubicSpline(t, columns(trajectory, "north_m", "west_m"))(at[inside])
    distance = np.linalg.norm(path - fixes[inside], axis=1)
    return {
        "left_out.rms": float(np.sqrt(np.mean(distance**2))),
        "left_out.p95": float(np.percentile(distance, 95)),
        "left_out.count": len(distance),
    }


def over_phases(rows: Rows) -> Rows:
    """Rows for the groups whose phases are all there: rms over the phases, the least and the largest."""
    out: Rows = {}
    for group in sorted({job.group for job in SESSIONS}):
        names = [job.name for job in SESSIONS if job.group == group]
        found = [rows[name].get("left_out.rms") for name in names if name in rows]
        values = np.array([value for value in found if isinstance(value, float)])
        if len(values) == len(names):
            rms = float(np.sqrt(np.mean(values**2)))
            out[group] = {"left_out.rms": rms, "left_out.least": values.min(), "left_out.largest": values.max()}
    return out


KARTS = (("kart_adria", "kart_adria_first_half", None), ("kart_lignano", "kart_lignano_racebox", 0.04))
SESSIONS = tuple(
    Thinned(name, source, grid, interval, phase, more, quick=(name, interval, phase) == ("kart_adria", 5, 0))
    for name, source, grid in KARTS
    for interval in (1, 2, 5)
    for more in (False, True)
    for phase in range(PHASES)
)
