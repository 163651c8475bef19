"""Check of timing and signal: rate, jitter, gaps, clipping, vibration, latency of the magnetometer."""

import numpy as np

from calib.outcome import Outcome, Value
from calib.recording import Recording
from smoother import so3
from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.fit.ellipsoid import FitError
from smoother.fit.timing import (
    Timing,
    clipped_share,
    magnetometer_against_gyro,
    sample_timing,
    vibration_spectrum,
)
from smoother.samples import RawImu
from smoother.units import DEG, MILLISECOND

PROCEDURE = "timing and vibration"
AGAINST_PROCEDURE = "magnetometer against gyroscope"


def calibrate(recording: Recording) -> Outcome:
    """Return rate, jitter, gaps, clipping and vibration. Raises FitError without a motion sensor."""
    if recording.imu is None or recording.imu_stamps is None:
        raise FitError("no motion sensor was recorded")
    timing = sample_timing(recording.imu_stamps)
    values = [*_timing_values("motion sensor", timing), *_clipping(recording.imu)]
    if recording.mag_stamps is not None and len(recording.mag_stamps) > 32:
        values += _timing_values("magnetometer", sample_timing(recording.mag_stamps))
    remarks: list[str] = []
    drawing: dict[str, object] = {}
    try:
        drawing = _vibration(recording, values)
    except FitError as error:
        remarks.append(str(error))
    if recording.is_thesis:
        remarks.append("the thesis' format stamps whole milliseconds")
    return Outcome(PROCEDURE, recording.name, tuple(values), remarks=tuple(remarks), drawing=drawing)


def _vibration(recording: Recording, values: list[Value]) -> dict[str, object]:
    """Add the strength of the vibration to values; return what its figure needs. Raises FitError."""
    force, rate = _longest_piece(recording)
    hz = recording.imu_rate
    spectra = {"accelerometer": vibration_spectrum(force, hz), "gyroscope": vibration_spectrum(rate, hz)}
    values.append(Value("vibration above 2 Hz, acceleration", spectra["accelerometer"].rms(2.0), None, "m/s²"))
    values.append(Value("vibration above 2 Hz, turning", spectra["gyroscope"].rms(2.0) / DEG, None, "deg/s"))
    return {"spectra": spectra}


def _timing_values(sensor: str, timing: Timing) -> list[Value]:
    steady = "" if timing.is_steady else "samples do not follow a clock"
    values = [
        Value(f"{sensor}, rate", timing.rate, timing.rate_sigma, "Hz", steady),
        Value(f"{sensor}, jitter of the stamps", timing.jitter / MILLISECOND, None, "ms"),
        Value(f"{sensor}, gaps", float(timing.gaps), None, ""),
    ]
    if timing.gaps:
        values.append(Value(f"{sensor}, longest gap", timing.longest_gap, None, "s"))
    return values


def _clipping(imu: RawImu) -> list[Value]:
    """Share of clipped readings of each axis, in percent; judged in counts or SI, as the file has them."""
    full = [
        None if scale is None else scale / unit
        for scale, unit in ((imu.accel_full_scale, imu.accel_scale), (imu.gyro_full_scale, imu.gyro_scale))
    ]
    return [
        Value("accelerometer, clipped", 100.0 * clipped_share(imu.accel, full[0]), None, "%"),
        Value("gyroscope, clipped", 100.0 * clipped_share(imu.gyro, full[1]), None, "%"),
    ]


def _longest_piece(recording: Recording) -> tuple[Array, Array]:
    """Force and rate in the longest stretch without a gap."""
    assert recording.imu is not None
    t = recording.imu.t
    cuts = np.flatnonzero(np.diff(t) > 1.5 * np.median(np.diff(t))) + 1
    bounds = np.concatenate([[0], cuts, [len(t)]])
    k = int(np.argmax(np.diff(bounds)))
    piece = slice(int(bounds[k]), int(bounds[k + 1]))
    return recording.force[piece], recording.rate[piece]


def calibrate_against_gyro(recording: Recording, calibration: Calibration) -> Outcome:
    """Return the latency of the magnetometer, and the rotation of its axes against the gyroscope's.

    An ellipsoid does not show that rotation; it is added to the soft iron. `calibration` is applied first. Raises
    FitError.
    """
    if recording.imu is None or recording.mag is None:
        raise FitError("gyroscope and magnetometer are both needed for the delay between them")
    if calibration.hard_iron is None or calibration.soft_iron is None:
        raise FitError("the magnetometer has to be calibrated before it can be compared with the gyroscope")
    if recording.is_driven:
        raise FitError("a kart turns too slowly about too few axes; turn the logger by hand")
    _, rate = recording.calibrated(calibration)
    field = calibration.apply_to_mag(recording.mag).field_s
    found = magnetometer_against_gyro(recording.imu.t, rate, recording.mag.t, field)
    values = (
        Value("stamps later than the gyroscope's", found.delay / MILLISECOND, found.delay_sigma / MILLISECOND, "ms"),
        Value("axes turned by, about x, y, z", found.turn / DEG, found.turn_sigma / DEG, "deg"),
    )
    soft_iron = so3.exp(found.turn) @ calibration.soft_iron
    before = calibration.sigmas.get("soft_iron", np.zeros((3, 3)))
    turned = np.abs(so3.skew(np.ones(3)) @ np.abs(calibration.soft_iron)) * np.max(found.turn_sigma)
    kept = {"hard_iron": calibration.sigmas["hard_iron"]} if "hard_iron" in calibration.sigmas else {}
    return Outcome(
        AGAINST_PROCEDURE,
        recording.name,
        values,
        calibration=Calibration(
            hard_iron=calibration.hard_iron,
            soft_iron=soft_iron,
            sigmas={**kept, "soft_iron": np.hypot(before, turned)},
        ),
        notes={
            "timing": {"magnetometer_delay": found.delay, "magnetometer_delay_sigma": found.delay_sigma},
            "magnetometer": {"axes_turned": found.turn, "axes_turned_sigma": found.turn_sigma},
        },
    )
