"""Accelerometer offset, scale and misalignment from six or more resting positions; gyroscope scale from the turns."""

import numpy as np

from calib.outcome import Comparison, Outcome, Value, rms
from calib.recording import Recording
from smoother.calibration import Calibration
from smoother.fit.allan import fit_noise
from smoother.fit.ellipsoid import COLUMNS, ROWS, FitError
from smoother.fit.gyro_turns import fit_gyro_matrix
from smoother.fit.six_position import AccelFit, fit_accelerometer
from smoother.units import DEG, STANDARD_GRAVITY
from smoother.words import counted

PROCEDURE = "accelerometer"
TURNS_PROCEDURE = "gyroscope scale"
_PRIOR = "not seen: lay the logger on edges too"


def calibrate(recording: Recording) -> Outcome:
    """Return offset, scale and misalignment of the accelerometer. Raises FitError for too few positions."""
    fit = fit_positions(recording)
    positions = recording.positions
    force = np.array([position.force for position in positions])
    diagonal = ROWS == COLUMNS
    sigma = np.sqrt(np.diagonal(fit.covariance)[3:])
    entries = fit.matrix[ROWS, COLUMNS]
    seen = bool(np.all(fit.observed))
    values = (
        Value("offset", fit.offset, fit.offset_sigma, "m/s²"),
        Value("scale", 100.0 * (entries[diagonal] - 1.0), 100.0 * sigma[diagonal], "%"),
        Value(
            "misalignment xy, xz, yz", entries[~diagonal] / DEG, sigma[~diagonal] / DEG, "deg", "" if seen else _PRIOR
        ),
    )
    before = np.linalg.norm(force, axis=1) - STANDARD_GRAVITY
    remarks = [counted(len(positions), "resting position")]
    if not np.all(fit.is_used):
        left_out = ", ".join(f"{p.start:.0f} s" for p, used in zip(positions, fit.is_used, strict=True) if not used)
        remarks.append(f"left out because they contradict the others: at {left_out}")
    if fit.scatter > 1.0:
        remarks.append(
            f"the positions scatter {fit.scatter:.1f} times more than the readings at rest; sigmas include it"
        )
    return Outcome(
        PROCEDURE,
        recording.name,
        values,
        (Comparison("error of gravity's length, rms", rms(before), rms(fit.residual[fit.is_used]), "m/s²"),),
        tuple(remarks),
        Calibration(
            accel_offset=fit.offset,
            accel_matrix=fit.matrix,
            sigmas={"accel_offset": fit.offset_sigma, "accel_matrix": fit.matrix_sigma},
        ),
        {"accelerometer": {"positions": len(positions)}},
        {"force": force, "fit": fit},
    )


def fit_positions(recording: Recording) -> AccelFit:
    """Fit the accelerometer. Raises FitError; see :func:`smoother.fit.six_position.fit_accelerometer`."""
    if recording.imu is None:
        raise FitError("no motion sensor was recorded")
    if recording.is_driven:
        raise FitError("a kart that drives shows too few positions; lay the logger on its six faces on a bench")
    return fit_accelerometer(recording.positions)


def calibrate_gyro_scale(recording: Recording) -> Outcome:
    """Return scale and misalignment of the gyroscope against the accelerometer. Raises FitError."""
    try:
        accel = fit_positions(recording)
    except FitError as error:
        raise FitError("the gyroscope's scale needs the positions that calibrate the accelerometer") from error
    assert recording.imu is not None
    i, j = recording.longest_rest
    density = float(np.max(fit_noise(recording.rate[i:j], recording.imu_rate).value[:, 0])) if j - i > 1000 else 0.0
    if density == 0.0:
        density = _density_of_rests(recording)
    fit = fit_gyro_matrix(recording.imu.t, recording.rate, recording.positions, accel, density)
    diagonal = np.eye(3, dtype=np.bool_)
    values = (
        Value("scale", 100.0 * (np.diagonal(fit.matrix) - 1.0), 100.0 * np.diagonal(fit.sigma), "%"),
        Value("misalignment xy, xz, yx, yz, zx, zy", fit.matrix[~diagonal] / DEG, fit.sigma[~diagonal] / DEG, "deg"),
    )
    remarks = [f"{fit.count} turns between resting positions"]
    if fit.scatter > 1.0:
        remarks.append(f"the turns scatter {fit.scatter:.1f} times more than noise explains; sigmas include it")
    return Outcome(
        TURNS_PROCEDURE,
        recording.name,
        values,
        (Comparison("error of a turn between rests, rms", fit.rms_before / DEG, fit.rms_after / DEG, "deg"),),
        tuple(remarks),
        Calibration(gyro_matrix=fit.matrix, sigmas={"gyro_matrix": fit.sigma}),
        {"gyroscope": {"turns": fit.count}},
    )


def _density_of_rests(recording: Recording) -> float:
    """Noise density of the gyroscope, rad/s/sqrt(Hz), from the covariances of the means."""
    return float(np.sqrt(max(np.max(np.diagonal(p.rate_covariance)) * (p.end - p.start) for p in recording.positions)))
