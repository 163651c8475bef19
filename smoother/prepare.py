"""The arrow from RawSession to Session: choose the origin of n, find the calibration, apply it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from smoother.arrays import Array
from smoother.calibration import Calibration, load_calibration
from smoother.errors import SessionError
from smoother.frames import Origin
from smoother.samples import AppliedValue, GnssFixes, Problem, RawSession, Session

FEWEST_DECIMALS = 4  # of degrees: 11 m; with three, 111 m, a track has no shape
UNIT_FIELD = (0.75, 1.33)  # median length of a calibrated field; outside, it was calibrated somewhere else


def prepare(raw: RawSession, calibration_file: Path | None = None) -> Session:
    """Return the calibrated session, with n placed at the first good fix.

    The calibration is `calibration_file` if given, and what magcalib.txt offers for a magnetometer it says nothing of.
    What was applied stands in `calibration` of the session.
    Raises SessionError without two usable fixes and for positions of too few digits, ConfigError for a flawed
    calibration file.
    """
    if len(raw.gnss) == 0:
        raise SessionError(f"{raw.name}: no usable GPS fix; the antenna needs a view of the sky before the start")
    if len(raw.gnss) < 2:
        reasons = "; ".join(problem.text for problem in raw.problems if problem.code.startswith("gps_"))
        raise SessionError(f"{raw.name}: only one usable fix, which is no track{f' ({reasons})' if reasons else ''}")
    if (decimals := _decimals(raw.gnss)) < FEWEST_DECIMALS:
        metres = 111_195.0 / 10.0**decimals
        text = f"positions have {decimals} decimals of a degree, steps of {metres:.0f} m, which show no track"
        raise SessionError(f"{raw.name}: {text}; record at least six, as by Serial.print(latitude, 7)")
    calibration = Calibration() if calibration_file is None else load_calibration(calibration_file)
    problems = list(raw.problems)
    mag_source = calibration.source
    if calibration.hard_iron is None and raw.mag_calibration_field is not None:
        calibration = _with_ellipsoid(calibration, raw.mag_calibration_field, problems)
        mag_source = "magcalib.txt"
    session = calibration.apply(raw, choose_origin(raw.gnss))
    applied = tuple(_from(mag_source, value) for value in session.calibration)
    problems += _doubts(session)
    return replace(session, problems=tuple(problems), calibration=applied)


def _decimals(fixes: GnssFixes) -> int:
    """Decimals of degrees that positions have, up to FEWEST_DECIMALS: so many and more are enough."""
    degrees = np.concatenate([fixes.lat_deg, fixes.lon_deg])
    degrees = degrees[np.isfinite(degrees)]
    for decimals in range(FEWEST_DECIMALS):
        scaled = degrees * 10.0**decimals
        if np.all(np.abs(scaled - np.round(scaled)) < 1e-6):
            return decimals
    return FEWEST_DECIMALS


def _from(mag_source: str, value: AppliedValue) -> AppliedValue:
    """The value with the source of the magnetometer's calibration, if it is of that sensor."""
    return replace(value, source=mag_source) if value.quantity in ("hard_iron", "soft_iron") else value


def _doubts(session: Session) -> list[Problem]:
    """A problem where the calibration does not fit the magnetometer: another logger, or iron that was added later."""
    if session.mag is None or not session.mag.is_calibrated or not len(session.mag.t):
        return []
    length = float(np.median(np.linalg.norm(session.mag.field_s, axis=1)))
    if UNIT_FIELD[0] <= length <= UNIT_FIELD[1]:
        return []
    text = (
        f"the calibrated magnetic field has length {length:.2f} instead of 1; calibrate the logger where it is mounted"
    )
    return [Problem("mag_calibration_misfit", text)]


def choose_origin(fixes: GnssFixes) -> Origin:
    """Return the position of the first good fix: reported sigma within bounds if any is, and near its neighbours.

    A first fix far from the median of the session (a wrong hemisphere, a cold start) would put the plane of n
    somewhere else, so fixes farther than 50 km from the median are passed over.
    """
    assert fixes.sigma_horizontal is not None
    sigma = fixes.sigma_horizontal
    good = ~(sigma > 10.0)  # m; a receiver that reports worse is still searching
    lat, lon = np.median(fixes.lat_deg), np.median(fixes.lon_deg)
    near = (np.abs(fixes.lat_deg - lat) < 0.5) & (np.abs(fixes.lon_deg - lon) * np.cos(np.radians(lat)) < 0.5)
    for mask in (good & near, near):
        if np.any(mask):
            i = int(np.argmax(mask))
            break
    else:
        i = 0
    known = fixes.alt_m[np.isfinite(fixes.alt_m)]
    alt = fixes.alt_m[i] if np.isfinite(fixes.alt_m[i]) else (np.median(known) if known.size else 0.0)
    return Origin(float(fixes.lat_deg[i]), float(fixes.lon_deg[i]), float(alt))


def _with_ellipsoid(calibration: Calibration, field: Array, problems: list[Problem]) -> Calibration:
    from smoother.fit.ellipsoid import FitError, fit_ellipsoid  # a session with a magcalib.txt is rare

    try:
        ellipsoid = fit_ellipsoid(field)
    except FitError as error:
        problems.append(Problem("magcalib_unusable", f"magcalib.txt: {error}; the magnetometer is used uncalibrated"))
        return calibration
    return calibration.with_magnetometer(ellipsoid.centre, ellipsoid.to_unit_sphere)
