"""summary.json: all results of smoothing a session, as one document of plain values."""

from collections.abc import Mapping

import numpy as np

import smoother
from smoother.arrays import are_near, median
from smoother.estimate.judge.quality import Quality
from smoother.estimate.preprocess.clock import utc_clock
from smoother.frames import euler_from_rotation, euler_jacobian
from smoother.laps.results import LapAnalysis
from smoother.laps.top_speed import reliable_rows, speed_sigma, top_speed
from smoother.samples import Problem, Session
from smoother.trajectory import EstimateReport, Identified, Trajectory
from smoother.units import DEG

Document = dict[str, object]

# reported only if identified; most loggers have none
ONLY_IF_IDENTIFIED = (
    "gps_velocity_response",
    "accel_delay",
    "imu_clock_drift",
)
IMU_CONSTANTS = ("lever_arm_b", "R_bs", "accel_noise", "gyro_noise")


def summary(
    session: Session,
    estimate: Trajectory,
    quality: Quality,
    timings: Mapping[str, float],
    options: Mapping[str, object],
    laps: LapAnalysis | None = None,
) -> Document:
    """Return the document; `timings` are seconds per stage, `options` those of the estimate."""
    report = estimate.report
    return {
        "version": smoother.__version__,
        "session": _about(session, estimate, laps),
        "inputs": list(session.inputs),
        "options": dict(options),
        "mode": report.mode,
        "counts": _counts(session, estimate),
        "origin": {"lat_deg": session.origin.lat_deg, "lon_deg": session.origin.lon_deg, "alt_m": session.origin.alt_m},
        "calibration": list(session.calibration),
        "problems": reported_problems(session, report),
        "identified": report.identified,
        "residuals": report.residuals,
        "quality": quality,
        "sigma_median": _median_sigmas(session, estimate),
        "timings": {**timings, **{f"smoothing_{name}": seconds for name, seconds in report.timings.items()}},
    }


def reported_problems(session: Session, report: EstimateReport) -> list[Problem]:
    """Return the problems of reader and estimator without repetitions."""
    return list(dict.fromkeys([*session.problems, *report.problems]))


def is_reported(name: str, found: Identified, mode: str) -> bool:
    """Whether an identified value is reported; without samples, the defaults of the IMU's constants are not."""
    if name in ONLY_IF_IDENTIFIED and found.source == "default":
        return False
    if name == "mag_soft_iron":  # nine numbers, of use to a calibration only
        return False
    if name == "gps_velocity_response":
        return smoothing_time(found) is not None
    return mode != "gps-only" or name not in IMU_CONSTANTS or found.source != "default"


def smoothing_time(found: Identified) -> tuple[float, float] | None:
    """Return the time over which a receiver smooths its speed, and its sigma, s; None where it is not significant.

    found: `gps_velocity_response`, half the square of that time.
    """
    if not (
        isinstance(found.value, float) and isinstance(found.sigma, float) and found.value > 2.0 * found.sigma  # sigma
    ):
        return None
    time = float(np.sqrt(2.0 * found.value))
    return time, found.sigma / time


def known_axes(name: str, found: Identified) -> slice:
    """The components of a value that are shown. Of a lever arm that is not stated: forward and left, because the height
    of the antenna is not observable."""
    return slice(0, 2) if name == "lever_arm_b" and found.source != "configured" else slice(None)


def mounting_angles(found: Identified) -> tuple[list[float], list[float]]:
    """Return roll, pitch, yaw (deg) of `R_bs` and their sigmas, none where the mounting was stated."""
    R_bs = np.asarray(found.value, dtype=np.float64)
    angles = [float(angle) / DEG for angle in euler_from_rotation(R_bs)]
    if found.sigma is None:
        return angles, []
    by_turn_b = euler_jacobian(R_bs) @ R_bs.T  # the sigmas are those of rotations about the axes of the kart
    sigma = np.sqrt(by_turn_b**2 @ np.square(found.sigma)) / DEG
    return angles, np.minimum(sigma, 180.0).tolist()


def distance_driven(estimate: Trajectory) -> float:
    """Return the horizontal length of the path, m, from the speed; rest adds next to nothing."""
    return float(np.sum(0.5 * (estimate.speed[1:] + estimate.speed[:-1]) * np.diff(estimate.t)))


def fastest_row(estimate: Trajectory) -> int:
    """Return the row of the highest speed among the reliable ones (:func:`smoother.laps.top_speed.reliable_rows`)."""
    speed = estimate.speed
    return int(np.argmax(np.where(reliable_rows(speed, speed_sigma(estimate)), speed, -np.inf)))


def _about(session: Session, estimate: Trajectory, laps: LapAnalysis | None) -> Document:
    config, top, clock = session.config, top_speed(estimate, laps), utc_clock(session, estimate)
    names = {"title": config.title, "driver": config.driver, "kart": config.kart, "track": config.track}
    return {
        "name": session.name,
        **{key: value for key, value in names.items() if value is not None},
        "start_s": float(estimate.t[0]),
        **({"start_utc": None} if clock is None else clock.as_summary()),
        "duration_s": float(estimate.t[-1] - estimate.t[0]),
        "distance_m": distance_driven(estimate),
        "top_speed_mps": top.speed,
        "top_speed_sigma_mps": top.sigma,
    }


def _counts(session: Session, estimate: Trajectory) -> Document:
    report = estimate.report
    used = 0 if report.fixes is None else len(report.fixes.index)
    return {
        "rows": len(estimate),
        "keyframes": 0 if report.keyframes is None else len(report.keyframes.t),
        "fixes": len(session.gnss),
        "fixes_used": used,
        "imu_samples": 0 if session.imu is None else len(session.imu.t),
        "mag_samples": 0 if session.mag is None else len(session.mag.t),
        **({} if session.wheel_speed is None else {"wheel_speed_samples": len(session.wheel_speed.t)}),
    }


def _median_sigmas(session: Session, estimate: Trajectory) -> Document | None:
    """Median sigma of each quantity, in the units of trajectory.csv, over the rows with fixes near them."""
    sigmas = estimate.sigmas
    if sigmas is None:
        return None
    # s, within which a row counts in what is typical; a longer outage than a minute does not
    near = are_near(estimate.t, session.gnss.t, 30.0)
    rows = slice(None) if near.all() or not near.any() else near
    position_n, attitude = sigmas.position_n[rows], sigmas.attitude[rows]
    roll, pitch, yaw = (_median(np.degrees(attitude[:, i])) for i in range(3))
    return {
        "horizontal_m": _median(np.hypot(position_n[:, 0], position_n[:, 1])),
        "up_m": _median(position_n[:, 2]),
        "track_m": _median(sigmas.track[rows]),
        "speed_mps": _median(sigmas.speed[rows]),
        "roll_deg": roll,
        "pitch_deg": pitch,
        "yaw_deg": yaw,
    }


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return median(known) if known.size else float("nan")
