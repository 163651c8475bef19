"""The short tables on stdout, from the same document that summary.json holds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from smoother.cli.lap_tables import show_laps
from smoother.cli.output import number, print_line, print_pairs
from smoother.units import DEG, KMH
from smoother.words import counted, duration, measured, repeated, speed_digits

if TYPE_CHECKING:
    from pathlib import Path

    from smoother.cli.pipeline import Result
    from smoother.samples import AppliedValue, Problem
    from smoother.trajectory import Identified

_NAMES = {
    "gps_position_latency": "GPS position latency",
    "gps_velocity_latency": "GPS speed latency",
    "lever_arm_b": "antenna from logger",
    "R_bs": "mounting",
    "accel_noise": "accelerometer noise",
    "gyro_noise": "gyroscope noise",
    "accel_delay": "accelerometer latency",
    "imu_clock_drift": "IMU clock, fast by",
    "gps_offset_sigma": "GPS slow error",
    "gps_offset_tau": "GPS slow error, time constant",
}
# constants of no interest to a driver
_ONLY_ON_THE_PAGE = ("gps_velocity_response", "slip_sigma", "mag_hard_iron", "mag_heading_offset", "gps_offset_change")


def show_result(result: Result, path: Path | None = None) -> None:
    """Print duration, distance, sigmas, identified constants, problems and the verdict; last the path of the report.

    path: of the session, above its rows where several are shown.
    """
    from smoother.report.summary import is_reported

    document: Any = result.document
    about = document["session"]
    pairs = [("driven", _distance(about)), ("recorded", _recorded(document))]
    if document["sigma_median"]:
        pairs.append(("uncertainty", _sigma(document["sigma_median"])))
    pairs += _calibrated(document["calibration"])
    for name, identified in document["identified"].items():
        if name in _ONLY_ON_THE_PAGE or not is_reported(name, identified, document["mode"]):
            continue
        pairs.append((_NAMES.get(name, name.replace("_", " ").replace("gps", "GPS")), _identified(name, identified)))
    problems: list[Problem] = document["problems"]
    pairs += [("problem" if i == 0 else "", f"{repeated(p.text, p.count)} [{p.code}]") for i, p in enumerate(problems)]
    reasons = "; ".join(result.quality.reasons)
    pairs.append(("verdict", f"NOT TO BE TRUSTED: {reasons}" if reasons else "passed its quality gate"))
    title = about.get("title")
    if path is None:
        print_pairs(title or about["name"], pairs)
    else:
        print_pairs(f"{path}: {title}" if title else str(path), pairs)
    if "lap_analysis" in document:
        show_laps(document["laps"], document["lap_analysis"], result.clock)
    print_line(str(result.main_file))


_CALIBRATED = {
    "accel_offset": "accelerometer offset",
    "accel_matrix": "accelerometer scale and axes",
    "gyro_bias": "gyroscope bias",
    "gyro_bias_slope": "its change with temperature",
    "gyro_matrix": "gyroscope scale and axes",
    "hard_iron": "hard iron",
    "soft_iron": "soft iron",
}


def _calibrated(applied: list[AppliedValue]) -> list[tuple[str, str]]:
    """A row for each calibration file with the calibrated quantities."""
    sources = dict.fromkeys(value.source for value in applied)
    texts = [
        f"{', '.join(_CALIBRATED[value.quantity] for value in applied if value.source == source)} (by {source})"
        for source in sources
    ]
    return [("calibrated" if i == 0 else "", text) for i, text in enumerate(texts)]


def _distance(about: Any) -> str:
    kilometres, top = about["distance_m"] / 1000.0, about["top_speed_mps"] / KMH
    sigma = about.get("top_speed_sigma_mps")
    plus_minus = f" ± {sigma / KMH:.{speed_digits(sigma / KMH)}f}" if sigma is not None and math.isfinite(sigma) else ""
    return f"{duration(about['duration_s'])}, {kilometres:.2f} km, top speed {top:.1f}{plus_minus} km/h"


def _recorded(document: Any) -> str:
    counts = document["counts"]
    fixes, samples = counted(counts["fixes"], "fix"), counted(counts["imu_samples"], "IMU sample")
    if counts["imu_samples"] == 0:
        is_there = any(problem.code in ("imu_too_slow", "imu_implausible") for problem in document["problems"])
        samples = "no usable IMU samples" if is_there else "no IMU"
    return f"{fixes}, {samples}" + (", smoothed from GPS only" if document["mode"] == "gps-only" else "")


def _sigma(sigma: Any) -> str:
    known = [
        (f"position ±{number(sigma['horizontal_m'])} m", sigma["horizontal_m"]),
        (f"line on the track ±{number(sigma['track_m'])} m", sigma["track_m"]),
        (f"speed ±{number(sigma['speed_mps'] / KMH)} km/h", sigma["speed_mps"]),
        (
            f"roll, pitch, yaw ±{sigma['roll_deg']:.1f}, {sigma['pitch_deg']:.1f}, {sigma['yaw_deg']:.1f} deg",
            sigma["yaw_deg"],
        ),
    ]
    return ", ".join(text for text, value in known if math.isfinite(value)) + " (typical, one sigma)"


def _identified(name: str, identified: Identified) -> str:
    from smoother.report.summary import known_axes

    if name == "R_bs":
        return f"{_mounting(identified)} ({identified.source})"
    unit, factor, digits = _shown_unit(identified.unit)
    shown = known_axes(name, identified)
    values = _scaled(identified.value, factor)[shown]
    digits += 2 if max(map(abs, values)) < 0.1 else 0
    text = _with_sigma(values, [] if identified.sigma is None else _scaled(identified.sigma, factor)[shown], digits)
    axes = "" if name != "lever_arm_b" else " forward, left, up" if len(values) == 3 else " forward, left; up not known"
    return f"{text} {unit}{axes} ({identified.source})"


def _with_sigma(values: list[float], sigmas: list[float], digits: int) -> str:
    text, sigma = measured(values, sigmas, digits)
    return f"{text} ± {sigma}" if sigma else text


def _mounting(identified: Identified) -> str:
    from smoother.report.summary import mounting_angles

    angles, sigmas = mounting_angles(identified)
    texts = (_with_sigma([angle], sigmas[i : i + 1], 1) for i, angle in enumerate(angles))
    return ", ".join(f"{name} {text}" for name, text in zip(("roll", "pitch", "yaw"), texts, strict=True)) + " deg"


def _shown_unit(unit: str) -> tuple[str, float, int]:
    """Displayed unit, its factor, and the digits of a value without sigma."""
    if unit.startswith("rad"):
        return unit.replace("rad", "deg", 1), 1.0 / DEG, 2
    return unit, 1.0, 3 if unit == "s" else 2


def _scaled(value: Any, factor: float) -> list[float]:
    return [float(item) * factor for item in (value if isinstance(value, (list, tuple)) else [value])]
