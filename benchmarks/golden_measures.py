"""Columns of the golden table from the files a run wrote: errors, reported sigmas, identified values, laps.

Frame n: north, west, up, metres, origin of the summary. Angles in degrees. `t_s` of all files is one clock.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from golden_command import Array, Bench, Outcome, Table, columns, read_table
from golden_laps import change_of_line, crossings, lap_times, slow_change
from golden_tables import Columns

OPTIONS = ("--json", "--no-baseline", "--no-figures")
RESULTS = "smoothed"
SEMI_MAJOR, ECCENTRICITY_SQUARED = 6378137.0, 6.69437999014e-3  # WGS84
KINDS = {  # name of an error, columns it is made of
    "horizontal": ("north_m", "west_m"),
    "up": ("up_m",),
    "velocity": ("vel_north_mps", "vel_west_mps"),
    "vel_up": ("vel_up_mps",),
    "roll": ("roll_deg",),
    "pitch": ("pitch_deg",),
    "yaw": ("yaw_deg",),
}
ALONE = ("speed_mps", "track_m")  # further sigmas of the trajectory
UNCHECKED = ("accel_forward_mps2", "accel_left_mps2", "accel_up_mps2", "yaw_rate_dps", "speed_mps")
LARGEST_LAG = 1.0  # s, between a trajectory and a reference
TRUE_FIGURES = {"gps_position_latency": "gnss.position_latency", "gps_velocity_latency": "gnss.velocity_latency"}


def smooth(bench: Bench, folder: Path, file: str = "") -> Outcome:
    """Smooth a session, or a file of it, into its own folder of results."""
    return bench.command(Path(folder.name) / file, *OPTIONS, folder=folder.parent)


def run_columns(bench: Bench, folder: Path, file: str = "") -> tuple[Columns, Outcome]:
    """Smooth, check and time the laps of a session, or a file of it; return all columns that need no reference."""
    outcome = smooth(bench, folder, file)
    found = outcome_columns(outcome)
    session = Path(folder.name) / file
    check = bench.command("check", "--json", session, folder=folder.parent)
    found["check.exit"] = check.code
    found["check.good"] = str(check.document.get("good", "-"))
    if not has_results(folder):
        return found, outcome
    found |= summary_columns(outcome.document)
    trajectory = read_table(folder / RESULTS / "trajectory.csv")
    found |= sigma_columns(trajectory)
    found |= content_columns(trajectory, outcome.document)
    laps = bench.command("laps", "--json", session, folder=folder.parent)
    found["laps.exit"] = laps.code
    found |= lap_columns(laps.document, folder)
    return found, outcome


def has_results(folder: Path) -> bool:
    """Whether a run wrote a trajectory."""
    return (folder / RESULTS / "trajectory.csv").exists()


def outcome_columns(outcome: Outcome) -> Columns:
    """Exit code, and what a refusal said, without numbers."""
    found: Columns = {"exit": outcome.code, "traceback": "yes" if "Traceback" in outcome.stderr else "no"}
    if outcome.code not in (0, 3):
        found["message"] = without_numbers((outcome.stderr.strip().splitlines() or ["-"])[-1])
    return found


def without_numbers(text: str) -> str:
    """Return a sentence with `#` for its numbers, which move by little from version to version."""
    return re.sub(r"\d+(?:[.,]\d+)*", "#", text)


def summary_columns(document: Mapping[str, Any]) -> Columns:
    """Mode, counts, problems, quality, identified values and residuals of a summary."""
    found: Columns = {
        "mode": document["mode"],
        "fixes_used": document["counts"]["fixes_used"],
        "duration": float(document["session"]["duration_s"]),
        "distance": float(document["session"]["distance_m"]),
    }
    for problem in document["problems"]:
        name = f"problem.{problem['code']}"
        found[name] = int(found.get(name, 0)) + int(problem["count"])
    quality = document["quality"]
    found["quality.passed"] = str(quality["passed"])
    if quality["reasons"]:
        found["quality.reasons"] = "; ".join(without_numbers(reason) for reason in quality["reasons"])
    for name, residual in document["residuals"].items():
        found[f"rejected.{name}"] = int(residual["rejected"])
        if residual["normalised_rms"] is not None:
            found[f"residual.{name}"] = float(residual["normalised_rms"])
    for name, entry in document["identified"].items():
        found |= identified_columns(name, entry)
    return found


def identified_columns(name: str, entry: Mapping[str, Any]) -> Columns:
    """Value and sigma of each element that was identified; of defaults and what was given only that."""
    found: Columns = {f"identified.{name}.source": entry["source"]}
    if entry["source"] != "identified":
        return found
    values = np.ravel(np.array(entry["value"], dtype=np.float64))
    sigmas = np.ravel(np.array(entry["sigma"], dtype=np.float64))
    for suffix, numbers in (("", values), (".sigma", sigmas)):
        for i, value in enumerate(numbers):
            at = f".{i}" if len(numbers) > 1 else ""
            found[f"identified.{name}{at}{suffix}"] = float(value)
    return found


def sigma_columns(trajectory: Table) -> Columns:
    """Median reported sigma of each kind; horizontal is rms of both axes."""
    found: Columns = {}
    for kind, names in KINDS.items():
        reported = columns(trajectory, *(f"sigma_{name}" for name in names))
        found[f"sigma.{kind}"] = _median(np.sqrt(np.sum(reported**2, axis=1)))
    for name in ALONE:
        found[f"sigma.{name}"] = _median(trajectory[f"sigma_{name}"])
    return found


def content_columns(trajectory: Table, summary: Mapping[str, Any]) -> Columns:
    """Size of what has no truth, and whether degrees and metres of a position agree, m."""
    found: Columns = {f"size.{name}": _rms(columns(trajectory, name)) for name in UNCHECKED}
    n = to_n(trajectory["lat_deg"], trajectory["lon_deg"], trajectory["alt_m"], summary["origin"])
    apart = np.linalg.norm((n - columns(trajectory, "north_m", "west_m", "up_m"))[:, :2], axis=1)
    found["size.degrees_from_metres"] = float(np.nanmax(apart))
    return found


def lap_columns(document: Mapping[str, Any], folder: Path) -> Columns:
    """Lap times with sigma, and how much the line changes from lap to lap, smoothed and raw."""
    laps = document.get("laps", [])
    valid = [lap for lap in laps if lap["valid"]]
    found: Columns = {"laps": len(laps), "laps.valid": len(valid)}
    for lap in valid:
        found[f"lap.{lap['lap']:02d}.time"] = float(lap["lap_time_s"])
        if lap["lap_time_sigma_s"] is not None:
            found[f"lap.{lap['lap']:02d}.time.sigma"] = float(lap["lap_time_sigma_s"])
    starts, ends = (np.array([float(lap[key]) for lap in valid]) for key in ("start_s", "end_s"))
    return found | line_columns(folder, starts, ends)


def line_columns(folder: Path, starts: Array, ends: Array) -> Columns:
    """How much the line changes from a lap to the next, and by a slow error, smoothed and raw, m; laps (L,) in s."""
    found: Columns = {}
    for name, file in (("smoothed", "trajectory.csv"), ("raw", "gps.csv")):
        table = read_table(folder / RESULTS / file)
        path = columns(table, "north_m", "west_m")
        known = np.isfinite(path).all(axis=1)
        for kind, measure in (("", change_of_line), (".slow", slow_change)):
            change = measure(table["t_s"][known], path[known], starts, ends)
            if change is not None:
                found[f"line_change.{name}{kind}"] = change
    return found


def truth_columns(trajectory: Table, truth: Table, summary: Mapping[str, Any], *, fit_lag: bool = False) -> Columns:
    """Errors against a truth, and the shares of them within 1 and 2 reported sigma.

    fit_lag: the truth's clock is not the session's; positions and velocities are compared each at the lag (s, of the
    truth behind the trajectory) that fits best. Attitude then goes with positions.
    """
    truth = truth_in_n(truth, summary["origin"])
    t = truth["t_s"]
    found: Columns = {}
    lags = {"position": 0.0, "velocity": 0.0}
    for name, kind in (("position", "horizontal"), ("velocity", "velocity")):
        if fit_lag and all(column in truth for column in KINDS[kind]):
            lags[name] = best_lag(trajectory, truth, KINDS[kind])
            found[f"lag.{name}"] = lags[name]
    for kind, names in KINDS.items():
        if not all(name in truth for name in names):
            continue
        at = t - lags["velocity" if kind in ("velocity", "vel_up") else "position"]
        error = difference(trajectory, truth, names, at)
        sigma = _at(trajectory, [f"sigma_{name}" for name in names], at)
        known = np.isfinite(error).all(axis=1)
        if not known.any():
            continue
        error, sigma = error[known], sigma[known]
        found[f"error.{kind}"] = _rms(error)
        if kind == "horizontal":
            found["error.horizontal_shape"] = _rms(error - error.mean(axis=0))
            found |= _relative(t[known], error)
        for times in (1, 2):
            within = np.abs(error) <= times * sigma
            found[f"within{times}.{kind}"] = float(np.mean(within[np.isfinite(sigma)]))
    return found


def difference(trajectory: Table, truth: Table, names: tuple[str, ...], at: Array) -> Array:
    """Trajectory at the times `at` (N,) minus truth (N, K); NaN outside the trajectory."""
    error = _at(trajectory, names, at, [name.endswith("deg") for name in names]) - columns(truth, *names)
    turn = np.array([360.0 if name.endswith("deg") else 0.0 for name in names])
    return np.asarray(error - turn * np.round(error / 360.0))


def best_lag(trajectory: Table, truth: Table, names: tuple[str, ...]) -> float:
    """Return the lag, s, of a truth behind a trajectory at which the error without its mean is least."""

    def cost(lag: float) -> float:
        error = difference(trajectory, truth, names, truth["t_s"] - lag)
        error = error[np.isfinite(error).all(axis=1)]
        return float(np.mean((error - np.median(error, axis=0)) ** 2)) if len(error) else np.inf

    coarse = np.arange(-LARGEST_LAG, LARGEST_LAG + 0.01, 0.05)
    near = float(coarse[np.argmin([cost(float(lag)) for lag in coarse])])
    found = minimize_scalar(cost, bounds=(near - 0.06, near + 0.06), method="bounded", options={"xatol": 1e-5})
    return float(found.x)


def simulated_columns(document: Mapping[str, Any], figures: Mapping[str, Array]) -> Columns:
    """How many reported sigmas the identified values are from the true ones of a simulation."""
    found: Columns = {}
    identified = document["identified"]
    for name, figure in TRUE_FIGURES.items():
        entry = identified.get(name)
        if entry is not None and entry["source"] == "identified" and entry["sigma"]:
            found[f"z.{name}"] = (entry["value"] - float(figures[figure][0])) / entry["sigma"]
    arm = identified.get("lever_arm_b")
    if arm is not None and arm["source"] == "identified":
        for i, axis in enumerate("xyz"):
            found[f"z.lever_arm_b.{axis}"] = (arm["value"][i] - float(figures["lever_arm_b"][i])) / arm["sigma"][i]
    mount = identified.get("R_bs")
    if mount is not None and mount["source"] == "identified":
        turn = np.array(mount["value"]) @ figures["R_bs"].reshape(3, 3).T
        vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        found["error.mount_deg"] = float(np.degrees(np.linalg.norm(vector)))
        found["z.mount_rms"] = _rms((vector / np.array(mount["sigma"]))[:, None]) / np.sqrt(3)
    return found


def true_lap_columns(document: Mapping[str, Any], truth: Table) -> Columns:
    """Lap times against those of the true path over the same line: rms of the errors over their sigmas, and in s."""
    analysis = document.get("lap_analysis") or {}
    line = analysis.get("start_line")
    if line is None:
        return {}
    north_west = truth_in_n(truth, document["origin"])
    ends = {key: np.array([line[side][key] for side in ("left", "right")]) for key in ("lat_deg", "lon_deg")}
    height = np.full(2, document["origin"]["alt_m"])
    gate = to_n(ends["lat_deg"], ends["lon_deg"], height, document["origin"])[:, :2]
    times = crossings(truth["t_s"], columns(north_west, "north_m", "west_m"), gate)
    errors, scores = lap_times(document["laps"], times)
    if not len(errors):
        return {}
    return {"error.laps_s": float(np.sqrt(np.mean(errors**2))), "z.laps_rms": float(np.sqrt(np.mean(scores**2)))}


def truth_in_n(truth: Table, origin: Mapping[str, float]) -> Table:
    """Return a truth with positions in n, whichever of the two forms they have."""
    if "north_m" in truth or "lat_deg" not in truth:
        return truth
    height = truth.get("alt_m", np.full(len(truth["t_s"]), origin["alt_m"]))
    n = to_n(truth["lat_deg"], truth["lon_deg"], height, origin)
    known = {"north_m": n[:, 0], "west_m": n[:, 1], **({"up_m": n[:, 2]} if "alt_m" in truth else {})}
    return {**truth, **known}


def to_n(lat_deg: Array, lon_deg: Array, alt_m: Array, origin: Mapping[str, float]) -> Array:
    """Return geodetic positions in n (N, 3), m: the tangent plane at the origin."""
    away = _earth_centred(lat_deg, lon_deg, alt_m) - _earth_centred(
        np.array([origin["lat_deg"]]), np.array([origin["lon_deg"]]), np.array([origin["alt_m"] or 0.0])
    )
    lat, lon = np.radians(origin["lat_deg"]), np.radians(origin["lon_deg"])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    west = np.array([np.sin(lon), -np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    return np.asarray(away @ np.stack([north, west, up], axis=1))


def resampled(table: Table, names: tuple[str, ...], at: Array) -> Array:
    """Return columns of a trajectory at other times (N, K); angles go the short way, NaN outside."""
    return _at(table, names, at, [name.endswith("deg") and not name.startswith("sigma") for name in names])


def _earth_centred(lat_deg: Array, lon_deg: Array, alt_m: Array) -> Array:
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    radius = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(lat) ** 2)
    across = (radius + alt_m) * np.cos(lat)
    along = (radius * (1 - ECCENTRICITY_SQUARED) + alt_m) * np.sin(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), along], axis=-1)


def _at(table: Table, names: Any, at: Array, angular: list[bool] | None = None) -> Array:
    t = table["t_s"]
    found = []
    for i, name in enumerate(names):
        values = table[name]
        if angular is not None and angular[i]:
            values = np.unwrap(values, period=360.0)
        found.append(np.interp(at, t, values, left=np.nan, right=np.nan))
    return np.stack(found, axis=1)


def _relative(t: Array, error: Array) -> Columns:
    """Rms error of the change of position over 1 s."""
    later = np.stack([np.interp(t + 1.0, t, error[:, i], right=np.nan) for i in range(2)], axis=1)
    change = (later - error)[np.isfinite(later).all(axis=1)]
    return {"error.relative_1s": _rms(change)} if len(change) else {}


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
