"""Magnetometer from laps alone: the observable part of hard and soft iron while driving on the level.

The result is written as information and not applied to sessions: the smoother fits the magnetometer to each session,
including a constant heading offset, which is assumed zero here. Applied, it made the yaw of simulated karts worse (0.8
to 1.2 deg).
"""

import datetime as dt

import numpy as np

from calib.outcome import Comparison, Outcome, Value, rms
from calib.recording import Recording
from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.fit.ellipsoid import FitError
from smoother.fit.level_field import fit_level_field, up_from_turning
from smoother.fit.magnetic_model import earth_field

PROCEDURE = "magnetometer, in the kart"
TABLE = "magnetometer_in_kart"
COMMENT = (
    "# `smooth` does not use it: it fits the compass to each session. To have it used, call the table [magnetometer]."
)
DRIVING = 3.0  # m/s


def calibrate(recording: Recording) -> Outcome:
    """Return the observable part of hard and soft iron; the rest is assumed and named. Raises FitError."""
    if recording.mag is None:
        raise FitError("no magnetometer was recorded")
    if recording.imu is None or not recording.is_driven:
        raise FitError("laps are needed for a calibration in the kart: fixes and motion sensor of a drive")
    assert recording.origin is not None
    inclination = earth_field(recording.origin, recording.date or dt.date(2027, 7, 1)).inclination
    up = up_from_turning(recording.imu.t, recording.force, recording.rate)
    driving = _driving(recording)
    t, field = recording.mag.t[driving], recording.mag.field[driving]
    fit = fit_level_field(t, field, up, inclination)
    values = (
        Value("hard iron, across the vertical", fit.level.T @ fit.hard_iron, fit.centre_sigma, "units"),
        Value("radius of the level ellipse", 100.0, 100.0 * fit.shape_sigma, "%"),
        Value("headings seen", 100.0 * fit.sectors, None, "%"),
        *(Value(text, float("nan"), None, "", "not observable from laps; assumed") for text in fit.assumed),
    )
    level = field @ fit.level
    before = np.linalg.norm(level, axis=1)
    unit = (field - fit.hard_iron) @ fit.matrix @ fit.level
    after = np.linalg.norm(unit, axis=1)
    comparison = Comparison("length of the level field, rms about its mean", _percent(before), _percent(after), "%")
    return Outcome(
        PROCEDURE,
        recording.name,
        values,
        (comparison,),
        (f"{len(field)} readings while driving; disturbances of {100 * fit.rms:.1f} % of the level field remain",),
        Calibration(hard_iron=fit.hard_iron, soft_iron=fit.matrix),
        {
            TABLE: {
                "comment": COMMENT,
                "hard_iron": fit.hard_iron,
                "soft_iron": fit.matrix,
                "level_hard_iron_sigma": fit.centre_sigma,
                "assumed": list(fit.assumed),
            }
        },
        {"before": level, "after": unit},
    )


def _driving(recording: Recording) -> np.ndarray:
    """Mask (N,) of the magnetometer readings taken at more than DRIVING."""
    assert recording.mag is not None and recording.fixes is not None and recording.fixes.speed is not None
    velocity = np.hypot(recording.fixes.velocity_n[:, 0], recording.fixes.velocity_n[:, 1])
    speed = np.where(np.isfinite(velocity), velocity, recording.fixes.speed)
    known = np.isfinite(speed)
    if not np.any(known):
        return np.ones(len(recording.mag.t), dtype=np.bool_)
    return np.asarray(np.interp(recording.mag.t, recording.fixes.t[known], speed[known]) > DRIVING)


def _percent(length: Array) -> float:
    return 100.0 * rms(length / float(np.mean(length)) - 1.0)
