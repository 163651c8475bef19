"""Magnetometer: hard iron and soft iron from readings in all directions, away from the kart's iron or mounted in it."""

import numpy as np

from calib.outcome import Comparison, Outcome, Value, rms
from calib.recording import Recording
from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.fit.correlation import correlation_growth
from smoother.fit.ellipsoid import COLUMNS, ROWS, Ellipsoid, FitError, fit_ellipsoid

PROCEDURE = "magnetometer"
LEAST_COVERAGE = 0.5  # of the sphere; with less, one noisy disturbance decides how the ellipsoid closes
FEWEST_TURNING = 500  # readings; with fewer those at rest are used too
SIDE = np.cos(np.radians(35.0))  # a side counts as seen when the field came this near to it
_SIDES = {"+x": 0, "-x": 0, "+y": 1, "-y": 1, "+z": 2, "-z": 2}


def calibrate(recording: Recording) -> Outcome:
    """Return hard and soft iron. Raises FitError, with the sides that are missing when too little was covered."""
    readings, origin = _readings(recording)
    fit = fit_ellipsoid(readings)
    missing = missing_sides(fit, readings)
    if fit.coverage < LEAST_COVERAGE:
        raise FitError(
            f"the readings cover only {100 * fit.coverage:.0f} % of the sphere; turn the sides "
            f"{', '.join(missing) or 'all six'} of the logger to the ground too, slowly, while turning it about itself "
            "(south of the equator: to the sky)"
        )
    growth = correlation_growth(np.linalg.norm(fit.apply(readings[fit.is_used]), axis=1) - 1.0)
    sigma = growth * np.sqrt(np.diagonal(fit.covariance))
    soft_sigma = np.empty((3, 3))
    soft_sigma[ROWS, COLUMNS] = soft_sigma[COLUMNS, ROWS] = sigma[3:]
    scale = float(np.mean(fit.semi_axes))
    values = (
        Value("hard iron", fit.centre, sigma[:3], "units"),
        Value("semi-axes", fit.semi_axes, growth * fit.semi_axes_sigma, "units"),
        Value("soft iron, times the mean semi-axis", scale * fit.to_unit_sphere, scale * soft_sigma, ""),
        Value("sphere covered", 100.0 * fit.coverage, None, "%", f"not seen: {', '.join(missing)}" if missing else ""),
    )
    outliers = len(readings) - int(np.sum(fit.is_used))
    remarks = [f"{len(readings)} readings from {origin}, {outliers} of them left out as outliers"]
    if growth > 1.1:
        remarks.append(f"errors of neighbouring readings are alike; sigmas are {growth:.1f} times larger for it")
    length = np.linalg.norm(readings[fit.is_used], axis=1)
    after = np.linalg.norm(fit.apply(readings[fit.is_used]), axis=1)
    comparison = Comparison("length of the field, rms about its mean", 100 * _spread(length), 100 * _spread(after), "%")
    return Outcome(
        PROCEDURE,
        recording.name,
        values,
        (comparison,),
        tuple(remarks),
        Calibration(
            hard_iron=fit.centre,
            soft_iron=fit.to_unit_sphere,
            sigmas={"hard_iron": sigma[:3], "soft_iron": soft_sigma},
        ),
        {"magnetometer": {"coverage": round(fit.coverage, 3), "semi_axes": fit.semi_axes}},
        {"readings": readings, "fit": fit},
    )


def _readings(recording: Recording) -> tuple[Array, str]:
    if recording.mag_field is not None:
        return recording.mag_field, "magcalib.txt"
    if recording.mag is None:
        raise FitError("no magnetometer was recorded")
    if recording.is_driven:
        raise FitError(
            "a kart that drives stays level; turn the logger in every direction by hand, or use the laps alone"
        )
    turning = _while_turned(recording)
    if np.count_nonzero(turning) < FEWEST_TURNING:
        return recording.mag.field, "the magnetometer"
    return recording.mag.field[turning], "the magnetometer while it was turned"


def _while_turned(recording: Recording) -> np.ndarray:
    """Mask (N,) of the magnetometer's readings outside rests, where readings repeat one rounding error."""
    assert recording.mag is not None
    if recording.imu is None:
        return np.ones(len(recording.mag.t), dtype=np.bool_)
    at_rest = np.interp(recording.mag.t, recording.imu.t, recording.is_at_rest.astype(np.float64))
    return np.asarray(at_rest < 0.5)


def _spread(length: Array) -> float:
    return rms(length / float(np.mean(length)) - 1.0)


def missing_sides(fit: Ellipsoid, readings: Array) -> list[str]:
    """Names of the axis directions near which the calibrated field was never seen."""
    unit = fit.apply(readings[fit.is_used])
    unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    signs = {"+": 1.0, "-": -1.0}
    return [name for name, axis in _SIDES.items() if np.max(signs[name[0]] * unit[:, axis]) < SIDE]
