"""Level and heading of the logger at rest (thesis, eq. 2.17-2.32 with its errata), with declination and inclination."""

import datetime as dt
from typing import Any

import numpy as np

from calib.outcome import Comparison, Outcome, Value, rms
from calib.recording import Recording
from smoother import so3
from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.fit.ellipsoid import FitError
from smoother.fit.levelling import level_angles, yaw_from_field
from smoother.fit.magnetic_model import EarthField, earth_field
from smoother.fit.resting import RestingPosition, rounding_step, rounding_variance
from smoother.frames import Origin, rotation_from_euler
from smoother.units import DEG, STANDARD_GRAVITY

PROCEDURE = "level and heading"
DECLINATION_SIGMA, INCLINATION_SIGMA = 0.36 * DEG, 0.2 * DEG  # error model of the World Magnetic Model
FEWEST_READINGS = 5
OUTLIER = 5.0  # times the median distance of a reading
AXES_SIGMA = 0.5 * DEG  # rotation between two chips on one board
COMMENT = "# of the logger as it lay; `smooth` does not use it: it finds the mounting while driving"
DRAWN = 4000  # samples in the figure


def calibrate(
    recording: Recording,
    calibration: Calibration,
    has_common_axes: bool = True,
    place: Origin | None = None,
    date: dt.date | None = None,
) -> Outcome:
    """Return roll and pitch at the longest rest, and yaw where a calibrated magnetometer was recorded.

    `calibration` is applied first. has_common_axes: the magnetometer is known to be in the axes of the accelerometer;
    else AXES_SIGMA goes into the sigmas. place and date: for the magnetic model; None: those of the recording.
    Raises FitError without a rest.
    """
    if recording.imu is None:
        raise FitError("no motion sensor was recorded")
    if not recording.positions:
        raise FitError("the logger never lay still, so nothing says where up is")
    rest = max(recording.positions, key=lambda position: position.end - position.start)
    force, force_covariance = _force(rest, calibration)
    model = _model(recording, place, date)
    field = _field(recording, rest, calibration, 0.0 if has_common_axes else AXES_SIGMA)
    angles, covariance = _attitude(force, force_covariance, field, _declination(recording, model))
    sigma = np.sqrt(np.diagonal(covariance))
    names = ("roll", "pitch", "yaw")
    values = [Value(n, a / DEG, s / DEG, "deg") for n, a, s in zip(names, angles, sigma, strict=False)]
    values += _magnetic_values(model, force, force_covariance, field)
    roll, pitch, yaw = (*angles, 0.0)[:3]
    R_ns = rotation_from_euler(np.asarray(roll), np.asarray(pitch), np.asarray(yaw))
    drawing = _drawing(recording, calibration, R_ns, rest)
    inside = (drawing["t"] >= rest.start) & (drawing["t"] <= rest.end)
    before, after = (rms(np.linalg.norm(drawing[key][inside, :2], axis=1)) for key in ("before", "after"))
    comparison = Comparison("level part of the force at rest, rms", before, after, "m/s²")
    notes: dict[str, object] = {value.name.replace(" ", "_") + "_deg": value.value for value in values}
    return Outcome(
        PROCEDURE,
        recording.name,
        tuple(values),
        (comparison,),
        _remarks(calibration, field, model, recording, rest),
        notes={"alignment": {"comment": COMMENT, **notes}},
        drawing=drawing,
    )


def _force(rest: RestingPosition, calibration: Calibration) -> tuple[Array, Array]:
    """Mean calibrated force (3,) and its covariance (3, 3), that of the offset included."""
    A = calibration.accel_matrix
    covariance = A @ rest.force_covariance @ A.T
    if "accel_offset" in calibration.sigmas:
        covariance = covariance + np.diag(calibration.sigmas["accel_offset"] ** 2)
    if "accel_matrix" in calibration.sigmas:
        covariance = covariance + np.diag(calibration.sigmas["accel_matrix"] ** 2 @ rest.force**2)
    return np.asarray(A @ (rest.force - calibration.accel_offset)), np.asarray(covariance)


def _field(
    recording: Recording, rest: RestingPosition, calibration: Calibration, axes_sigma: float
) -> tuple[Array, Array] | None:
    """Mean calibrated field (3,) during the rest and its covariance (3, 3); None without one."""
    if recording.mag is None or calibration.hard_iron is None or calibration.soft_iron is None:
        return None
    inside = (recording.mag.t >= rest.start) & (recording.mag.t <= rest.end)
    field, raw = calibration.apply_to_mag(recording.mag).field_s[inside], recording.mag.field[inside]
    if len(field) < FEWEST_READINGS:
        return None
    off = np.linalg.norm(field - np.median(field, axis=0), axis=1)
    field, raw = field[off < OUTLIER * np.median(off) + 1e-9], raw[off < OUTLIER * np.median(off) + 1e-9]
    mean = field.mean(axis=0)
    hidden = (
        calibration.soft_iron
        @ np.diag(rounding_variance(raw, rounding_step(recording.mag.field)))
        @ calibration.soft_iron.T
    )
    covariance = np.cov(field, rowvar=False) / len(field) + hidden + axes_sigma**2 * np.eye(3)
    if "hard_iron" in calibration.sigmas:
        W = calibration.soft_iron
        covariance = covariance + W @ np.diag(calibration.sigmas["hard_iron"] ** 2) @ W.T
    if "soft_iron" in calibration.sigmas:
        reading = np.linalg.solve(calibration.soft_iron, mean)
        covariance = covariance + np.diag(calibration.sigmas["soft_iron"] ** 2 @ reading**2)
    return np.asarray(mean), np.asarray(covariance)


def _attitude(
    force: Array, force_covariance: Array, field: tuple[Array, Array] | None, declination: tuple[float, float]
) -> tuple[Array, Array]:
    """Roll, pitch and, with a field, yaw (rad), and their covariance by first-order propagation."""

    def angles(x: Array) -> Array:
        level = level_angles(x[:3])
        return np.array(level if field is None else (*level, yaw_from_field(x[3:6], x[:3], float(x[6]))))

    if field is None:
        x, covariance = force, force_covariance
    else:
        x = np.concatenate([force, field[0], [declination[0]]])
        covariance = np.zeros((7, 7))
        covariance[:3, :3], covariance[3:6, 3:6], covariance[6, 6] = force_covariance, field[1], declination[1] ** 2
    J = so3.numerical_jacobian(angles, x, 1e-7)
    return angles(x), np.asarray(J @ covariance @ J.T)


def _model(recording: Recording, place: Origin | None, date: dt.date | None) -> EarthField | None:
    place, date = place or recording.origin, date or recording.date
    return None if place is None or date is None else earth_field(place, date)


def _declination(recording: Recording, model: EarthField | None) -> tuple[float, float]:
    """Declination and its sigma, rad: as stated, by the model, or zero: then yaw counts from magnetic north."""
    stated = recording.config.magnetometer.declination_deg
    if stated is not None:
        return stated * DEG, 0.0
    return (0.0, 0.0) if model is None else (model.declination, DECLINATION_SIGMA)


def _magnetic_values(
    model: EarthField | None, force: Array, force_covariance: Array, field: tuple[Array, Array] | None
) -> list[Value]:
    values = []
    if model is not None:
        values.append(
            Value("declination", model.declination / DEG, DECLINATION_SIGMA / DEG, "deg", "World Magnetic Model")
        )
        values.append(
            Value("inclination", model.inclination / DEG, INCLINATION_SIGMA / DEG, "deg", "World Magnetic Model")
        )
    if field is not None:
        x = np.concatenate([force, field[0]])
        covariance = np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = force_covariance, field[1]
        J = so3.numerical_jacobian(lambda y: np.array([_dip(y)]), x, 1e-7)
        sigma = float(np.sqrt((J @ covariance @ J.T).item()))
        values.append(Value("inclination measured", _dip(x) / DEG, sigma / DEG, "deg"))
    return values


def _dip(x: Array) -> float:
    """Angle of the field x[3:] below the plane across the force x[:3], rad."""
    return float(np.arcsin(np.clip(-(x[:3] @ x[3:]) / np.linalg.norm(x[:3]) / np.linalg.norm(x[3:]), -1.0, 1.0)))


def _remarks(
    calibration: Calibration,
    field: tuple[Array, Array] | None,
    model: EarthField | None,
    recording: Recording,
    rest: RestingPosition,
) -> tuple[str, ...]:
    remarks = [f"the longest rest, {rest.start:.0f} to {rest.end:.0f} s"]
    if "accel_offset" not in calibration.sigmas:
        remarks.append("the accelerometer is not calibrated: its offset (0.5 m/s² tilts by 3 deg) is not in the sigmas")
    if field is None:
        remarks.append("no calibrated magnetometer, so no heading")
    elif model is None and recording.config.magnetometer.declination_deg is None:
        remarks.append("place and date are unknown: yaw counts from magnetic north; --place and --date mend that")
    if model is not None and model.note:
        remarks.append(model.note)
    return tuple(remarks)


def _drawing(recording: Recording, calibration: Calibration, R_ns: Array, rest: RestingPosition) -> dict[str, Any]:
    assert recording.imu is not None
    i, j = np.searchsorted(recording.imu.t, [rest.start, rest.end])
    rows = slice(int(i), int(j), max(1, int(j - i) // DRAWN))
    force = recording.calibrated(calibration)[0][rows]
    before = recording.force[rows]
    return {"t": recording.imu.t[rows], "before": before, "after": force @ R_ns.T, "gravity": STANDARD_GRAVITY}
