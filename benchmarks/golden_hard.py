"""Golden rows of hard sessions: each right within its sigma, or refused with a reason; none worse than the fixes alone.

A session is simulated, its files are damaged, and it is smoothed by the command; the results are held against
truth.csv and against the fixes joined by straight lines. Only verdict and exit code count in a comparison; figures
are there to read. Expectations are in docs/tables/hard.csv.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from golden_command import Array, Bench, Outcome, Table, columns, read_table
from golden_measures import RESULTS, has_results, smooth, truth_in_n, without_numbers
from golden_sessions import copy_of_simulated, simulated
from golden_tables import Columns, Rows

MIDDLE = 120.0  # s, of the 240 s a session lasts
INSIDE = 0.8  # of the errors within two sigma; 0.95 would be perfect, but minutes of one session are correlated
SLACK = 1.02  # times the error of the fixes alone, plus
SLACK_M = 0.02  # m: a standing kart with perfect fixes has nothing to gain
STRIDE = 5  # every fifth row of 50 Hz is compared
QUANTITIES = {
    "north": "north_m",
    "west": "west_m",
    "vel_north": "vel_north_mps",
    "vel_west": "vel_west_mps",
    "roll": "roll_deg",
    "pitch": "pitch_deg",
    "yaw": "yaw_deg",
}
ACCEL, GYRO, FIELD = ("ax", "ay", "az"), ("gx", "gy", "gz"), ("mx", "my", "mz")
METRES_PER_DEGREE = 111_200.0  # of latitude
GRAVITY = 9.80665  # m/s^2
VELOCITY_LATENCY = 0.2907233663  # s: that of seed 1, stated where a damage has to know it

Damage = Callable[[Path], None]
"""Changes the files of a session in its folder."""


@dataclass(frozen=True)
class Comparison:
    """Errors of a session against its truth, rms in m and m/s; shares of errors within two sigma by quantity."""

    horizontal: float
    horizontal_gps: float
    velocity: float
    velocity_gps: float
    inside: Mapping[str, float]

    @property
    def least(self) -> str:
        """The quantity of which the smallest share is inside."""
        return min(self.inside, key=lambda name: self.inside[name])


@dataclass(frozen=True)
class HardSession:
    """One hard session: arguments of `smooth simulate`, what then happens to its files, what is expected."""

    name: str
    expectation: str
    simulate: tuple[str, ...]
    damage: Damage | None = None
    quick: bool = False

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows this job gives."""
        return (self.name,)

    def run(self, bench: Bench, work: Path) -> Rows:
        """Damage, smooth, judge."""
        folder = work / self.name
        copy_of_simulated(simulated(bench, self.simulate), folder)
        if self.damage is not None:
            self.damage(folder)
        outcome = smooth(bench, folder)
        compared = comparison_of(folder, outcome.document) if has_results(folder) else None
        found: Columns = {"exit": outcome.code, "verdict": verdict(outcome, compared)}
        if compared is not None:
            figures = {
                "error_horizontal": compared.horizontal,
                "error_horizontal_fixes": compared.horizontal_gps,
                "error_velocity": compared.velocity,
                "error_velocity_fixes": compared.velocity_gps,
                **{f"within2_{name}": share for name, share in compared.inside.items()},
            }
            found |= {f"figure.{name}": float(value) for name, value in figures.items() if np.isfinite(value)}
        return {self.name: found}


def verdict(outcome: Outcome, compared: Comparison | None) -> str:
    """Return `right`, `exit N` with the first reason of the gate, or `silently wrong` with what is."""
    if outcome.code == 3:
        reasons = outcome.document.get("quality", {}).get("reasons", [])
        return f"exit 3: {without_numbers(reasons[0])}" if reasons else "exit 3: no reason"
    if outcome.code != 0:
        return f"exit {outcome.code}"
    if compared is None:
        return "silently wrong: exit 0 without results"
    if not np.isfinite(compared.horizontal):
        return "silently wrong: results do not overlap the truth"
    if compared.horizontal > SLACK * compared.horizontal_gps + SLACK_M:
        return "silently wrong: position worse than the fixes alone"
    if not compared.inside:
        return "silently wrong: no quantity has a sigma"
    if compared.inside[compared.least] < INSIDE:
        return f"silently wrong: sigma of {compared.least} too small"
    return "right"


def comparison_of(folder: Path, summary: Mapping[str, Any]) -> Comparison:
    """Compare the results in a session's folder with its truth.csv."""
    truth = truth_in_n(read_table(folder / "truth.csv"), summary["origin"])
    return compare(read_table(folder / RESULTS / "trajectory.csv"), truth, read_table(folder / RESULTS / "gps.csv"))


def compare(trajectory: Table, truth: Table, fixes: Table) -> Comparison:
    """Compare a trajectory, and its fixes joined by straight lines, with a truth, all in n, at rows of the trajectory.

    Of the trajectory counts what the truth covers; of the fixes what is also between the first and the last of them.
    """
    at = trajectory["t_s"][::STRIDE]
    true = {column: resampled_truth(truth, column, at) for column in QUANTITIES.values()}
    inside, errors = {}, {}
    for name, column in QUANTITIES.items():
        error = trajectory[column][::STRIDE] - true[column]
        if column.endswith("_deg"):
            error = error - 360.0 * np.round(error / 360.0)
        errors[name] = error
        sigma = trajectory[f"sigma_{column}"][::STRIDE]
        known = np.isfinite(error) & np.isfinite(sigma)
        if known.any():
            inside[name] = float(np.mean(np.abs(error[known]) <= 2.0 * sigma[known]))
    alone = {
        name: np.interp(at, fixes["t_s"], fixes[column], left=np.nan, right=np.nan) - true[column]
        for name, column in QUANTITIES.items()
        if column in fixes
    }
    return Comparison(
        *(_rms(errors["north"], errors["west"]), _rms(alone["north"], alone["west"])),
        *(_rms(errors["vel_north"], errors["vel_west"]), _rms(alone["vel_north"], alone["vel_west"])),
        inside,
    )


def resampled_truth(truth: Table, column: str, at: Array) -> Array:
    """Return a column of a truth at other times (N,), straight lines between rows; NaN outside."""
    values = truth[column]
    if column.endswith("_deg"):
        values = np.unwrap(values, period=360.0)
    return np.interp(at, truth["t_s"], values, left=np.nan, right=np.nan)


def _rms(north: Array, west: Array) -> float:
    squared = north**2 + west**2
    known = squared[np.isfinite(squared)]
    return float(np.sqrt(np.mean(known))) if len(known) else float("nan")


def edit_numbers(path: Path, names: tuple[str, ...], change: Callable[[Array, Array], Array], digits: int) -> None:
    """Replace columns of a CSV file: `change` gets t_s (N,) and values (N, K), and returns values (N, K)."""
    frame = pl.read_csv(path, infer_schema_length=None)
    values = frame.select(pl.col(names).cast(pl.Float64)).to_numpy().astype(np.float64)
    changed = np.round(change(frame["t_s"].to_numpy().astype(np.float64), values), digits)
    path.unlink()  # a link into the cache: what it leads to stays
    frame.with_columns(pl.Series(name, changed[:, i]).fill_nan(None) for i, name in enumerate(names)).write_csv(path)


def rotation(vector: Array) -> Array:
    """Return the matrix (3, 3) of a rotation vector (3,), rad."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def turned_after(t: float, vector_deg: tuple[float, float, float]) -> Damage:
    """The box moves in its mounting at time t (s): all sensors read in axes turned by a rotation vector, degrees."""
    R = rotation(np.radians(vector_deg))

    def change(times: Array, values: Array) -> Array:
        return np.where((times > t)[:, None], values @ R.T, values)

    def damage(folder: Path) -> None:
        edit_numbers(folder / "imu.csv", ACCEL, change, 6)
        edit_numbers(folder / "imu.csv", GYRO, change, 8)
        edit_numbers(folder / "mag.csv", FIELD, change, 4)

    return damage


def rattling_after(t: float, seconds: float) -> Damage:
    """The box comes loose at t and swings about its forward axis, 15 deg at 1 Hz, until it is fastened again."""
    amplitude = np.radians(15.0)

    def swung(times: Array, values: Array) -> Array:
        angle = np.where(_loose(times), amplitude * np.sin(2.0 * np.pi * (times - t)), 0.0)
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = values.T
        return np.stack([x, c * y + s * z, c * z - s * y], axis=1)

    def swung_rates(times: Array, values: Array) -> Array:
        rate = np.where(_loose(times), amplitude * 2.0 * np.pi * np.cos(2.0 * np.pi * (times - t)), 0.0)
        return np.asarray(swung(times, values) + np.outer(rate, [1.0, 0.0, 0.0]))

    def _loose(times: Array) -> np.ndarray:
        return (times > t) & (times < t + seconds)

    def damage(folder: Path) -> None:
        edit_numbers(folder / "imu.csv", ACCEL, swung, 6)
        edit_numbers(folder / "imu.csv", GYRO, swung_rates, 8)

    return damage


def one_fix_south(folder: Path) -> None:
    """One fix has the letter of the other hemisphere."""

    def change(_: Array, lat: Array) -> Array:
        lat = lat.copy()
        lat[len(lat) // 2] *= -1.0
        return lat

    edit_numbers(folder / "gps.csv", ("lat_deg",), change, 10)


def compass_reversed(folder: Path) -> None:
    """The field is mirrored, so that a heading from it is half a turn wrong."""
    edit_numbers(folder / "mag.csv", FIELD, lambda _, field: field * [-1.0, -1.0, 1.0], 4)


def samples_on_a_clock_of_their_own(fast: float) -> Damage:
    """The samples are stamped by another clock than the fixes, which begins with theirs and runs fast."""

    def damage(folder: Path) -> None:
        zero = float(read_table(folder / "gps.csv")["t_s"][0])
        for name in ("imu.csv", "mag.csv"):
            edit_numbers(folder / name, ("t_s",), lambda _, t: zero + (t - zero) * (1.0 + fast), 6)

    return damage


def coming_in(north: float, memory: float) -> Damage:
    """The receiver has just found its satellites: positions come in from `north` m off, by 1/e in `memory` s."""

    def change(t: Array, lat: Array) -> Array:
        return np.asarray(lat + (north * np.exp(-(t - t[0]) / memory) / METRES_PER_DEGREE)[:, None])

    return lambda folder: edit_numbers(folder / "gps.csv", ("lat_deg",), change, 10)


def velocity_off(turn_deg: float, factor: float) -> Damage:
    """Velocities point to the right of where they should, as with a magnetic course, and are longer."""

    def change(_: Array, values: Array) -> Array:
        return np.stack([values[:, 0] * factor, (values[:, 1] + turn_deg) % 360.0], axis=1)

    return lambda folder: edit_numbers(folder / "gps.csv", ("speed_mps", "course_deg"), change, 6)


def speed_behind_low_pass(tau: float, latency: float) -> Damage:
    """The receiver, late by `latency` (s), smooths its velocity by a low-pass of first order."""
    dt = 0.005  # s

    def damage(folder: Path) -> None:
        truth = read_table(folder / "truth.csv")
        t = np.arange(truth["t_s"][0], truth["t_s"][-1], dt)
        true_n = columns(truth, "vel_north_mps", "vel_west_mps")
        added = np.zeros((len(t), 2))
        for i in range(2):
            exact = np.interp(t, truth["t_s"], true_n[:, i])
            added[:, i] = low_passed(exact, dt, tau) - exact

        def change(times: Array, values: Array) -> Array:
            speed, course = values[:, 0], np.radians(values[:, 1])
            north = speed * np.cos(course) + np.interp(times - latency, t, added[:, 0])
            west = -speed * np.sin(course) + np.interp(times - latency, t, added[:, 1])
            return np.stack([np.hypot(north, west), np.degrees(np.arctan2(-west, north)) % 360.0], axis=1)

        edit_numbers(folder / "gps.csv", ("speed_mps", "course_deg"), change, 6)

    return damage


def low_passed(values: Array, dt: float, tau: float) -> Array:
    """Return values (N,), dt seconds apart, behind a low-pass of first order that begins settled."""
    share, out = 1.0 - np.exp(-dt / tau), values.copy()
    for i in range(1, len(values)):
        out[i] = out[i - 1] + share * (values[i] - out[i - 1])
    return out


def _hard(
    name: str, expectation: str, *changes: str, damage: Damage | None = None, quick: bool = False, seconds: int = 240
) -> HardSession:
    """A session of preset kart with no trouble of its own but these changes of figures."""
    common = ("gnss.outages=", "gnss.jumps=", "imu.gaps=", *changes)
    words = ("--preset", "kart", "--seed", "1", "--duration", str(seconds))
    return HardSession(name, expectation, (*words, *(w for c in common for w in ("--set", c))), damage, quick)


STEERING = f"motion.steering={float(np.radians(10.0))!r}"
SPINS = "motion.spins=" + ",".join(f"{45 * k}:2.5" for k in range(1, 5))
STOPS = "motion.stops=" + ",".join(f"{20 * k}:6" for k in range(1, 11))

SESSIONS: tuple[HardSession, ...] = (
    _hard("plain", "right; what all others are compared with", "motion.standstill=5"),
    _hard("no_standstill", "right: biases come from driving", "motion.standstill=none"),
    _hard("parked", "right, or says that nothing moved", "motion.driving=false", quick=True),
    _hard("wrong_start_heading", "right: the compass is not believed", damage=compass_reversed),
    _hard("box_loose_for_20_s", "exit 3", damage=rattling_after(MIDDLE, 20.0), quick=True),
    _hard("box_slips_by_10_deg", "right, or exit 3", damage=turned_after(MIDDLE, (0.0, 10.0, 0.0))),
    _hard("box_slips_by_4_deg", "right, or exit 3", damage=turned_after(MIDDLE, (0.0, 4.0, 0.0)), quick=True),
    _hard("box_turns_by_6_deg", "right, or exit 3", damage=turned_after(MIDDLE, (0.0, 0.0, 6.0))),
    _hard(
        "box_turned_over",
        "the fixes alone, late by what no IMU shows; reported",
        damage=turned_after(MIDDLE, (180.0, 0.0, 0.0)),
        quick=True,
    ),
    _hard("box_on_the_wheel", "right: roll and yaw as unsure as the wheel makes them", STEERING),
    _hard("box_on_the_wheel_accel_late", "right: the delay is removed", STEERING, "imu.accel_delay=0.05"),
    _hard("imu_gap_30_s", "right; GPS carries it", f"imu.gaps={MIDDLE:g}:30"),
    _hard("gps_outage_60_s", "right: sigma grows", f"gnss.outages={MIDDLE - 30:g}:60", quick=True),
    _hard("30_m_off_for_a_minute", "exit 3, or sigma covers it", "gnss.jumps=90:60:30:0:0", quick=True),
    _hard("wrong_hemisphere_once", "right: one fix rejected", damage=one_fix_south),
    _hard("accelerometer_clips_at_2_g", "right, or exit 3", f"imu.accel_range={2 * GRAVITY!r}"),
    _hard("gyro_clips_at_60_dps", "right, or exit 3", f"imu.gyro_range={float(np.radians(60.0))!r}"),
    _hard("imu_clock_2_percent_fast", "right: UTC shows it, and it is removed", "imu.clock_drift=0.02"),
    _hard("imu_clock_2_percent_slow", "right: UTC shows it, and it is removed", "imu.clock_drift=-0.02"),
    _hard(
        "samples_clock_100_ppm_slow",
        "right: found by the fixes, and removed",
        damage=samples_on_a_clock_of_their_own(-1e-4),
    ),
    _hard(
        "samples_clock_0.7_percent_fast",
        "right: found by the fixes, and removed",
        damage=samples_on_a_clock_of_their_own(7e-3),
    ),
    _hard("cold_start_40_m_off", "right: what comes in is left out", damage=coming_in(40.0, 12.0)),
    _hard(
        "speed_smoothed_over_0.6_s",
        "right: found, and removed",
        f"gnss.velocity_latency={VELOCITY_LATENCY}",
        damage=speed_behind_low_pass(0.6, VELOCITY_LATENCY),
    ),
    _hard("magnetic_course_4_deg_off", "right: found, and turned back", damage=velocity_off(4.0, 1.0)),
    _hard("speed_of_a_wheel_3_percent_fast", "right: found, and scaled", damage=velocity_off(0.0, 1.03)),
    _hard("magnetometer_at_the_motor", "right: the field is not believed", "mag.engine_disturbance=1"),
    _hard("gps_1_hz", "right", "gnss.rate=1"),
    _hard("gps_25_hz", "right", "gnss.rate=25"),
    _hard("imu_25_hz", "right, or exit 3", "imu.rate=25"),
    _hard("imu_50_hz", "right", "imu.rate=50"),
    _hard("imu_1_khz", "right", "imu.rate=1000"),
    _hard("imu_2_khz", "right", "imu.rate=2000"),
    _hard("fixes_without_velocity", "right", "gnss.velocity=false"),
    _hard("four_spins", "right", SPINS),
    _hard("ten_stops", "right", STOPS),
    _hard("parked_for_an_hour", "right, or says that nothing moved", "motion.driving=false", seconds=3600),
)
