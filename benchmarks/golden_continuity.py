"""Golden rows of continuity: a session changed so that the result should hardly move, and how far it moves.

Changes are rms over their own reported sigma. A smoother whose result jumps when a fix is left out is overconfident
or stops too early, and a figure measured on one session says little of the next.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from golden_command import Bench, Outcome, Table, columns, link_files, read_table
from golden_measures import RESULTS, difference, has_results, resampled, smooth
from golden_sessions import Edit, copy_of_simulated, edit_column, edit_csv, keep_rows, set_columns, simulated
from golden_tables import Columns, Rows
from golden_thinned import kept_fixes, with_one_more

FILES = ("gps.csv", "imu.csv", "mag.csv")
LATER = 1000.0  # s
EASTWARD = 50.0  # degrees
LATENCIES = ("gps_position_latency", "gps_velocity_latency")
VELOCITY = ("vel_north_mps", "vel_west_mps")

Change = Callable[[Path], None]
"""Changes the files of a session in place."""


def drop_one_fix(folder: Path) -> None:
    """Leave out the fix in the middle."""
    edit_csv(folder / "gps.csv", lambda h, rows: (h, rows[: len(rows) // 2] + rows[len(rows) // 2 + 1 :]))


def swap_two_rows(folder: Path) -> None:
    """Swap two fixes in the middle of the file."""

    def edit(header: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
        k = len(rows) // 2
        return header, [*rows[:k], rows[k + 1], rows[k], *rows[k + 2 :]]

    edit_csv(folder / "gps.csv", edit)


def cut_first_second(folder: Path) -> None:
    """Leave out what was sampled in the first second."""
    since = read_table(folder / "imu.csv")["t_s"][0] + 1.0
    for path in _present(folder, "imu.csv", "mag.csv"):
        edit_csv(path, keep_rows(np.flatnonzero(read_table(path)["t_s"] >= since)))


def move_times(folder: Path) -> None:
    """Start the clock of all files later."""
    for path in _present(folder, *FILES):
        edit_csv(path, edit_column("t_s", lambda t: t + LATER, 6))


def move_site(folder: Path) -> None:
    """Drive the same further east."""
    edit_csv(folder / "gps.csv", edit_column("lon_deg", lambda lon: (lon + EASTWARD + 180) % 360 - 180, 10))


def turn_box(folder: Path) -> None:
    """Screw the box to the kart another way round: one rotation of all vectors it measures."""
    turn, _ = np.linalg.qr(np.random.default_rng(55).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    for file, names in (
        ("imu.csv", ("ax", "ay", "az")),
        ("imu.csv", ("gx", "gy", "gz")),
        ("mag.csv", ("mx", "my", "mz")),
    ):
        for path in _present(folder, file):
            edit_csv(path, set_columns(names, columns(read_table(path), *names) @ turn.T, 9))


def reorder_columns(folder: Path) -> None:
    """Write the columns of every file in reverse."""
    for path in _present(folder, *FILES):
        edit_csv(path, lambda header, rows: (header[::-1], [row[::-1] for row in rows]))


CHANGES: dict[str, Change] = {
    "fix_dropped": drop_one_fix,
    "rows_swapped": swap_two_rows,
    "first_second_cut": cut_first_second,
    "times_moved": move_times,
    "site_moved": move_site,
    "box_turned": turn_box,
    "columns_reordered": reorder_columns,
}


@dataclass(frozen=True)
class Continuity:
    """One base session and its changes, a row each.

    place writes the files of the session; further, those of the change "fix_added". without: changes that do mean
    something here.
    """

    name: str
    place: Callable[[Bench, Path], None]
    further: Callable[[Bench, Path], None] | None = None
    without: frozenset[str] = field(default_factory=frozenset)
    quick: bool = False

    @property
    def changes(self) -> tuple[str, ...]:
        """Names of the changes."""
        some = tuple(name for name in CHANGES if name not in self.without)
        return (*some, "fix_added") if self.further is not None else some

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows this job gives."""
        return tuple(f"{self.name}.{change}" for change in self.changes)

    def run(self, bench: Bench, work: Path) -> Rows:
        """Smooth the session and every changed one; compare."""
        base = work / self.name
        self.place(bench, base)
        before = smooth(bench, base)
        if not has_results(base):
            return {}
        found: Rows = {}
        for change in self.changes:
            folder = work / change
            if change == "fix_added":
                assert self.further is not None
                self.further(bench, folder)
            else:
                self.place(bench, folder)
                CHANGES[change](folder)
            shift = LATER if change == "times_moved" else 0.0
            after = smooth(bench, folder)
            found[f"{self.name}.{change}"] = change_columns(base, folder, before, after, shift)
        return found


def change_columns(base: Path, changed: Path, before: Outcome, after: Outcome, shift: float) -> Columns:
    """How far a result moved over its own sigma; times of the changed one are `shift` s later."""
    found: Columns = {"exit": after.code}
    if not has_results(changed):
        return found
    found["mode"] = after.document["mode"]
    one = read_table(base / RESULTS / "trajectory.csv")
    other = dict(read_table(changed / RESULTS / "trajectory.csv"))
    other["t_s"] = other["t_s"] - shift
    found |= trajectory_change(one, other)
    for name in LATENCIES:
        entries = [outcome.document["identified"].get(name) for outcome in (before, after)]
        if all(entry is not None and entry["source"] == "identified" for entry in entries):
            found[f"change.{name}"] = abs(entries[1]["value"] - entries[0]["value"]) / entries[0]["sigma"]
    return found


def trajectory_change(one: Table, other: Table) -> Columns:
    """Rms change of velocity, yaw and line over the sigmas of the first trajectory, at common times.

    The line is the horizontal position without its mean; its sigma is sigma_track_m, of both axes together. That has
    no slow wander of the fixes in it, which the line may share out anew: more than velocity and yaw, it may exceed 1.
    """
    t = one["t_s"]
    found: Columns = {}
    velocity = difference(other, one, VELOCITY, t) / columns(one, *(f"sigma_{name}" for name in VELOCITY))
    line = difference(other, one, ("north_m", "west_m"), t)
    line = line - np.nanmean(line, axis=0)
    yaw = difference(other, one, ("yaw_deg",), t) / columns(one, "sigma_yaw_deg")
    track = line / (columns(one, "sigma_track_m") / np.sqrt(2.0))
    for name, change in (("velocity", velocity), ("yaw", yaw), ("line", track)):
        known = change[np.isfinite(change).all(axis=1)]
        if len(known):
            found[f"change.{name}"] = float(np.sqrt(np.mean(known**2)))
    sigma = resampled(other, ("sigma_track_m",), t)[:, 0] / one["sigma_track_m"]
    found["ratio.sigma_track"] = float(np.nanmedian(sigma))
    return found


def _present(folder: Path, *files: str) -> list[Path]:
    return [folder / file for file in files if (folder / file).exists()]


def _simulated(*arguments: str, interval: float | None = None, more: bool = False) -> Callable[[Bench, Path], None]:
    def place(bench: Bench, folder: Path) -> None:
        copy_of_simulated(simulated(bench, ("--duration", "200", "--set", "gnss.outages=", *arguments)), folder)
        _thin(folder, interval, more)

    return place


def _recorded(source: str, interval: float | None = None, more: bool = False) -> Callable[[Bench, Path], None]:
    def place(bench: Bench, folder: Path) -> None:
        assert bench.recordings is not None
        link_files(bench.recordings / source, folder, FILES)
        _thin(folder, interval, more)

    return place


def _thin(folder: Path, interval: float | None, more: bool) -> None:
    if interval is None:
        return
    fixes = read_table(folder / "gps.csv")
    kept = kept_fixes(fixes, interval, 0.0)
    edit: Edit = keep_rows(with_one_more(fixes, kept) if more else kept)
    edit_csv(folder / "gps.csv", edit)


DECLINATION = frozenset(
    {"site_moved"}
)  # a magnetometer that is moved points elsewhere: no wonder that the result moves
NO_SAMPLES = frozenset({"first_second_cut", "box_turned"})
RARE = ("--no-mag", "--seed", "12")
ADRIA = "kart_adria_first_half"

SIMULATED = (
    Continuity("kart", _simulated("--seed", "11"), without=DECLINATION),
    Continuity("kart_5s", _simulated(*RARE, interval=5), _simulated(*RARE, interval=5, more=True)),
    Continuity("fixes_alone", _simulated("--seed", "13", "--no-imu", "--no-mag"), without=NO_SAMPLES, quick=True),
)
RECORDED = (
    Continuity("adria", _recorded(ADRIA)),
    Continuity("adria_5s", _recorded(ADRIA, 5), _recorded(ADRIA, 5, more=True)),
    Continuity("massa", _recorded("kart_massafinalese_racechrono"), without=NO_SAMPLES),
)
