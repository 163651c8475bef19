"""Gyroscope bias from all rests, with its dependence on temperature if that was recorded."""

import numpy as np

from calib.outcome import Comparison, Outcome, Value, rms
from calib.recording import Recording
from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.fit.ellipsoid import FitError
from smoother.fit.gyro_bias import (
    THESIS_SAMPLES,
    TemperatureFit,
    fit_gyro_bias,
    fit_gyro_bias_of_first,
    fit_temperature,
)
from smoother.fit.resting import batch_means
from smoother.fit.six_position import excess_scatter
from smoother.units import DEG
from smoother.words import counted

PROCEDURE = "gyroscope bias"
TEMPERATURE_BATCH = 5.0  # s over which readings are averaged before they are compared with the temperature


def calibrate(recording: Recording, use_first_samples: bool = False) -> Outcome:
    """Return bias, covariance of a reading and, with temperatures, the bias' slope. Raises FitError without a rest.

    use_first_samples: the thesis' form, the mean of the first 1000 samples, whatever they are.
    """
    if recording.imu is None:
        raise FitError("no motion sensor was recorded")
    if use_first_samples:
        return _of_first(recording)
    if not recording.positions:
        raise FitError("the logger never lay still for three seconds; lay it down and do not touch it for a minute")
    at_rest = _inside(recording)
    noise = fit_gyro_bias(recording.rate, at_rest).noise_covariance
    bias, sigma = mean_bias(recording)
    seconds = sum(position.end - position.start for position in recording.positions)
    remarks = [f"{counted(len(recording.positions), 'rest')}, {seconds:.0f} s in all"]
    values = [Value("bias", bias / DEG, sigma / DEG, "deg/s")]
    calibration = Calibration(gyro_bias=bias, sigmas={"gyro_bias": sigma})
    drawing: dict[str, object] = {}
    try:
        fit, temperature, means = _by_temperature(recording)
    except FitError as error:
        if recording.imu.temperature is not None:
            remarks.append(str(error))
    else:
        calibration = _with_temperature(fit)
        warmth = f"deg/s at {fit.temperature:.1f} °C"
        values = [
            Value("bias", fit.bias / DEG, fit.bias_sigma / DEG, warmth),
            Value("change of the bias", fit.slope / DEG, fit.slope_sigma / DEG, "deg/s/K"),
        ]
        drawing = {"temperature": temperature, "means": means, "fit": fit}
    values.append(Value("noise of a reading", np.sqrt(np.diagonal(noise)) / DEG, None, "deg/s"))
    comparison = _comparison(recording, calibration)
    notes = {"gyroscope": {"noise_covariance": noise, "rest_s": round(seconds, 1)}}
    return Outcome(PROCEDURE, recording.name, tuple(values), (comparison,), tuple(remarks), calibration, notes, drawing)


def mean_bias(recording: Recording) -> tuple[Array, Array]:
    """Bias (3,) rad/s and sigma (3,): the mean over all rests by their length; larger where the rests disagree."""
    positions = recording.positions
    weight = np.array([position.end - position.start for position in positions])
    weight = weight / np.sum(weight)
    rates = np.array([position.rate for position in positions])
    variance = np.array([np.diagonal(position.rate_covariance) for position in positions])
    bias = weight @ rates
    chi_square = np.sum((rates - bias) ** 2 / np.maximum(variance, 1e-300), axis=0)
    scatter = np.array([excess_scatter(float(value), len(positions) - 1) for value in chi_square])
    return np.asarray(bias), np.asarray(scatter * np.sqrt(weight**2 @ variance))


def _inside(recording: Recording) -> np.ndarray:
    """Mask (N,) of the samples inside the resting positions."""
    assert recording.imu is not None
    mask = np.zeros(len(recording.imu.t), dtype=np.bool_)
    for position in recording.positions:
        mask |= (recording.imu.t >= position.start) & (recording.imu.t <= position.end)
    return mask


def _by_temperature(recording: Recording) -> tuple[TemperatureFit, Array, Array]:
    assert recording.imu is not None
    if recording.imu.temperature is None:
        raise FitError("no temperature was recorded")
    warmth, means = [], []
    for position in recording.positions:
        i, j = np.searchsorted(recording.imu.t, [position.start, position.end])
        both = np.column_stack([recording.imu.temperature[i:j], recording.rate[i:j]])
        _, batch = batch_means(recording.imu.t[i:j], both, TEMPERATURE_BATCH)
        warmth.append(batch[:, 0])
        means.append(batch[:, 1:])
    temperature, rate = np.concatenate(warmth), np.concatenate(means)
    return fit_temperature(temperature, rate), temperature, rate


def _with_temperature(fit: TemperatureFit) -> Calibration:
    return Calibration(
        gyro_bias=fit.bias,
        gyro_bias_slope=fit.slope,
        gyro_temperature=fit.temperature,
        gyro_temperature_span=fit.span,
        sigmas={"gyro_bias": fit.bias_sigma, "gyro_bias_slope": fit.slope_sigma},
    )


def _comparison(recording: Recording, calibration: Calibration) -> Comparison:
    """Rms of the mean rates of the rests, before and after."""
    assert recording.imu is not None
    after = recording.calibrated(calibration)[1]
    spans = [np.searchsorted(recording.imu.t, [p.start, p.end]) for p in recording.positions]
    before_means = np.array([recording.rate[i:j].mean(axis=0) for i, j in spans])
    after_means = np.array([after[i:j].mean(axis=0) for i, j in spans])
    return Comparison("mean rate at rest, rms", rms(before_means) / DEG, rms(after_means) / DEG, "deg/s")


def _of_first(recording: Recording) -> Outcome:
    found = fit_gyro_bias_of_first(recording.rate)
    values = (
        Value("bias", found.bias / DEG, found.sigma / DEG, "deg/s"),
        Value("noise of a reading", np.sqrt(np.diagonal(found.noise_covariance)) / DEG, None, "deg/s"),
    )
    calibration = Calibration(gyro_bias=found.bias, sigmas={"gyro_bias": found.sigma})
    first = recording.rate[:THESIS_SAMPLES].mean(axis=0)
    comparison = Comparison("mean rate of these, rms", rms(first) / DEG, rms(first - found.bias) / DEG, "deg/s")
    remarks = (f"the first {found.count} samples were taken to be at rest, as asked",)
    notes = {"gyroscope": {"noise_covariance": found.noise_covariance}}
    return Outcome(PROCEDURE, recording.name, values, (comparison,), remarks, calibration, notes)
