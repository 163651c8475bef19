"""Allan deviation of a logger at rest: noise density, bias instability and random walk of each axis."""

import numpy as np

from calib.outcome import Outcome, Value
from calib.recording import Recording
from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.fit.allan import AllanDeviation, NoiseFigures, allan_deviation, fit_noise
from smoother.fit.ellipsoid import FitError
from smoother.units import DEG
from smoother.words import measured

PROCEDURE = "noise at rest"
SHORTEST = 60.0  # s, for the noise density; the bias instability needs ten minutes, the random walk an hour
_ADVICE = "let the logger lie still for ten minutes, better an hour"
COMMENT = (
    "# of the logger at rest, in the form of session.toml. A kart shakes it much more: leave it to `smooth` there."
)


def calibrate(recording: Recording, calibration: Calibration) -> Outcome:
    """Return the noise figures of both sensors with sigmas. Raises FitError without a minute at rest on a bench.

    The gyroscope's dependence on temperature, if `calibration` contains it, is removed before: it is not noise.
    """
    if recording.imu is None:
        raise FitError("no motion sensor was recorded")
    if recording.is_driven:
        raise FitError(f"a kart at rest has its engine running; on a bench, {_ADVICE}")
    i, j = recording.longest_rest
    seconds = float(recording.imu.t[j - 1] - recording.imu.t[i]) if j > i else 0.0
    if seconds < SHORTEST:
        raise FitError(f"the longest rest is {seconds:.0f} s, too short for an Allan deviation; {_ADVICE}")
    t = recording.imu.t[i:j]
    if np.max(np.diff(t)) > 10.0 * np.median(np.diff(t)):
        raise FitError(
            f"samples are missing during the longest rest, which an Allan deviation cannot bridge; {_ADVICE}"
        )
    rate = recording.imu_rate
    bias = np.broadcast_to(calibration.gyro_bias_at(recording.imu.temperature), recording.rate.shape)
    accel, gyro = recording.force[i:j], recording.rate[i:j] - bias[i:j]
    figures = {"accelerometer": fit_noise(accel, rate), "gyroscope": fit_noise(gyro, rate)}
    curves = {"accelerometer": allan_deviation(accel, rate), "gyroscope": allan_deviation(gyro, rate)}
    values = [
        *_values("accelerometer", figures["accelerometer"], 1.0, "m/s²"),
        *_values("gyroscope", figures["gyroscope"], 1.0 / DEG, "deg/s"),
    ]
    notes: dict[str, dict[str, object]] = {"imu": {"comment": COMMENT, **session_settings(figures)}}
    for name, found in figures.items():
        notes[f"allan.{name}"] = {
            "noise_density": found.value[:, 0],
            "bias_instability": found.value[:, 1],
            "random_walk": found.value[:, 2],
            "noise_density_sigma": found.sigma[:, 0],
            "bias_instability_sigma": found.sigma[:, 1],
            "random_walk_sigma": found.sigma[:, 2],
        }
    return Outcome(
        PROCEDURE,
        recording.name,
        tuple(values),
        remarks=(f"{seconds / 60.0:.1f} min at rest at {rate:.1f} Hz", *_drift(figures, curves)),
        notes=notes,
        drawing={"figures": figures, "curves": curves},
    )


def _drift(figures: dict[str, NoiseFigures], curves: dict[str, AllanDeviation]) -> tuple[str, ...]:
    """A sentence about each sensor whose long Allan deviations are larger than its noise explains."""
    drifting = []
    for name, curve in curves.items():
        excess = curve.deviation - figures[name].allan_deviation(curve.tau)
        if np.any(excess[-3:] > 3.0 * curve.sigma[-3:]):
            drifting.append(f"the {name} drifts more than noise does; let the logger warm up for 20 min before")
    return tuple(drifting)


def session_settings(figures: dict[str, NoiseFigures]) -> dict[str, object]:
    """The table [imu] of session.toml: of the three axes the quadratic mean; walks only where they were seen."""
    settings: dict[str, object] = {}
    for prefix, name in (("accel", "accelerometer"), ("gyro", "gyroscope")):
        found = figures[name]
        settings[f"{prefix}_noise"] = _mean(found.value[:, 0])
        if np.any(found.is_seen[:, 2]):
            settings[f"{prefix}_bias_walk"] = _mean(found.value[:, 2])
    return settings


def _mean(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _values(sensor: str, found: NoiseFigures, factor: float, unit: str) -> list[Value]:
    names = (("noise density", f"{unit}/√Hz"), ("bias instability", unit), ("random walk", f"{unit}/√s"))
    values = []
    for k, (name, its_unit) in enumerate(names):
        unseen = ["xyz"[axis] for axis in range(3) if not found.is_seen[axis, k]]
        upper = [factor * float(found.upper["xyz".index(axis), k]) for axis in unseen]
        most, _ = measured(upper, upper, 2)  # with two digits that count
        note = f"not seen on {', '.join(unseen)}: at most {most}" if unseen else ""
        values.append(Value(f"{sensor} {name}", factor * found.value[:, k], factor * found.sigma[:, k], its_unit, note))
    return values
