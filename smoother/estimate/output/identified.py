"""What a session told of its constants and its noise: each value with its sigma, its source, and whether it shows."""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.config import SessionConfig
from smoother.estimate.gnss_offset import OffsetModel
from smoother.estimate.graph.components import SMALLEST_POSITION
from smoother.estimate.graph.heading import ANY_HARD_IRON, ANY_IRON, Heading
from smoother.estimate.graph.inputs import SENSOR_ERRORS, Noise, Priors, constants_sigma
from smoother.estimate.graph.mounting import FittedMounting
from smoother.estimate.graph.options import GraphOptions
from smoother.estimate.graph.slip import ANY_SLIP
from smoother.estimate.graph.slip import PRIOR as SLIP_PRIOR
from smoother.estimate.graph.state import (
    ACCEL_ERROR,
    COURSE_DELAY,
    HEADING_OFFSET,
    LEVER_ARM,
    RECTIFICATION,
    VELOCITY_RESPONSE,
    Constants,
)
from smoother.estimate.noise_of_fixes import OBSERVABLE, noise_of_fixes, scatter_of_fixes, wander_of_fixes
from smoother.fit.noise_spread import ANY_NOISE
from smoother.samples import Sampling
from smoother.trajectory import Identified
from smoother.units import DEG

# s^2, of the response: what an antenna half a metre above a box that leans by 2.2 mrad to a m/s^2 shows of its own
ANTENNA_LEANS = 1.1e-3
# m, by which a box on a steering wheel goes round the column, beside which an arm that stays has no meaning
ROUND_THE_COLUMN = 0.1
# s, of what a filter before the sampling holds a sample back by beyond the mean that it is taken for: those that are
# usual with sensors of loggers, of 41 to 184 Hz, do so by 0 to 4 ms, and no file says which it was
FILTERS = 1.5e-3
# s, and m of the arm, that delays of boxes whose rates do not tell attitudes are off by beyond their own sigmas, rms:
# 14 sessions of three sorts, karts and boxes on wheels with 60-90 deg/s of vibration in samples of 25 Hz
UNSTEADY_DELAY, UNSTEADY_ARM = 0.02, 0.2
# rad/s/sqrt(Hz) of the rates about the motion, from which on delays miss some of that, and all. Harsh simulated karts
# and real ones on the wheel have 2.4 to 3.2 deg/s; six shaken boxes of 4.4 to 5.7 were off by 20 ms and 0.3 m rms
DOUBTED, UNTOLD = 3.5 * DEG, 5.0 * DEG


@dataclass(frozen=True)
class _Latency:
    key: str
    index: int
    configured: float | None


def doubt_by_rates(gyro: float) -> float:
    """Share, 0 to 1, of UNSTEADY_DELAY and UNSTEADY_ARM that delays and arm miss beside rates of density `gyro`."""
    return float(np.clip(math.log(max(gyro, 1e-12) / DOUBTED) / math.log(UNTOLD / DOUBTED), 0.0, 1.0))


def unsure_moment(sampling: Sampling, stated: float | None, unsteady: float = 0.0) -> float:
    """Sigma, s, of when a sample of `sampling` is true; stated: its delay, s, where it is known.

    unsteady: in parts of UNSTEADY_DELAY, what delays miss where rates do not tell attitudes.
    Else it is taken for the mean since the one before. Of a logger that stamps what is at that moment all latencies are
    longer by half of that, of one behind a filter they are shorter.
    """
    of_samples = math.hypot(0.5 * sampling.every / math.sqrt(3.0), FILTERS) if stated is None else 0.0
    return math.hypot(of_samples, sampling.stamp_sigma, UNSTEADY_DELAY * unsteady)


def identified_values(
    constants: Constants,
    covariance: Array,
    common_attitude: Array,
    noise: Noise,
    priors: Priors,
    mounting: FittedMounting,
    config: SessionConfig,
    unseen: Array,
    sampling: Sampling,
    doubt: float = 0.0,
) -> dict[str, Identified]:
    """Return each value by its name in `identified` of summary.json.

    covariance (31, 31) of `constants`, their priors' where the kart did not drive; common_attitude (3, 3) rad^2 in s:
    of the mean error of all attitudes; unseen (3,) m^2: variance of the GPS offset beyond what the session shows.
    sampling: see :func:`unsure_moment`. doubt: what delays and arm miss beyond their sigmas, at least, in parts
    of UNSTEADY_DELAY and UNSTEADY_ARM.
    """
    S = covariance if priors.drives else np.diag(constants_sigma(priors, noise) ** 2)
    sigma, unsteady = np.sqrt(np.diag(S)), max(doubt_by_rates(noise.inertial.gyro), doubt)
    return {
        **_of_the_receiver(constants, sigma, priors, config, unsure_moment(sampling, config.imu_delay, unsteady)),
        "lever_arm_b": _lever_arm(constants, S, priors, mounting, config, unsteady),
        "R_bs": _mounting(noise, mounting, config, common_attitude),
        **_rectification(constants, sigma, noise),
        **_noise(noise, config),
        **_offset(noise, unseen),
    }


def field_values(heading: Heading | None, constants: Constants, covariance: Array) -> dict[str, Identified]:
    """Return what was found of the magnetometer; nothing where it is not used. covariance (31, 31) of `constants`.

    Hard and soft iron only where the graph had to find them, and the kart turned about: those of a calibration are not
    asked for, and at a place nothing tells them.
    """
    if heading is None:
        return {}
    sigma, out = float(np.sqrt(covariance[HEADING_OFFSET, HEADING_OFFSET][0, 0])), {}
    observable = sigma < OBSERVABLE * heading.offset_sigma
    out["mag_heading_offset"] = _value(constants.heading_offset, sigma, "rad", observable, False)
    fit = heading.fit
    if fit is None or not fit.is_told:
        return out
    seen = bool(np.all(fit.iron_sigma < OBSERVABLE * ANY_HARD_IRON * fit.strength))
    out["mag_hard_iron"] = _value(fit.iron.tolist(), fit.iron_sigma.tolist(), "of the readings", seen, False)
    soft, of_soft = fit.soft_iron, fit.soft_iron_sigma
    seen = bool(np.median(of_soft) < OBSERVABLE * ANY_IRON)
    source = "identified" if seen else "default"
    return {**out, "mag_soft_iron": Identified(soft.tolist(), of_soft.tolist(), "1", seen, source)}


def _of_the_receiver(
    constants: Constants, sigma: Array, priors: Priors, config: SessionConfig, moment: float
) -> dict[str, Identified]:
    """Its delays, and what it answers to a change of acceleration; sigma (31,) of all constants.

    moment: see :func:`unsure_moment`.
    """
    values = constants.as_vector()
    out: dict[str, Identified] = {}
    for latency in (
        _Latency("gps_position_latency", 0, config.gps.position_latency),
        _Latency("gps_velocity_latency", 1, config.gps.velocity_latency),
    ):
        i = latency.index
        observable = bool(sigma[i] < OBSERVABLE * priors.constants_sigma[i])
        own = math.hypot(sigma[i], moment) if priors.drives else sigma[i]
        out[latency.key] = _value(values[i], own, "s", observable, latency.configured is not None)
    response = VELOCITY_RESPONSE.start
    observable = bool(sigma[response] < OBSERVABLE * priors.constants_sigma[response])
    own = math.hypot(sigma[response], ANTENNA_LEANS) if priors.holds_height else sigma[response]
    if constants.is_steered:
        # the arm keeps to the course, the antenna to the nose: beside it by the slip, which goes with the acceleration
        own = math.hypot(own, SLIP_PRIOR[1] * float(np.linalg.norm(constants.lever_arm_s)))
    out["gps_velocity_response"] = _value(values[response], own, "s^2", observable, False)
    course, beforehand = COURSE_DELAY.start, priors.constants_sigma[COURSE_DELAY.start]
    sought = bool(beforehand > GraphOptions.course_delay_sigma)  # else it stands for nothing
    out["gps_course_delay"] = _value(
        values[course], sigma[course], "s", sought and bool(sigma[course] < OBSERVABLE * beforehand), False
    )
    return out


def _lever_arm(
    constants: Constants,
    covariance: Array,
    priors: Priors,
    mounting: FittedMounting,
    config: SessionConfig,
    unsteady: float,
) -> Identified:
    """The arm from the box to the antenna, in b; covariance (31, 31) of all constants.

    unsteady: see :func:`unsure_moment`.
    """
    arm_covariance_s, up_s = covariance[LEVER_ARM, LEVER_ARM], constants.level_axes_s[2]
    if priors.holds_height and priors.drives:
        arm_covariance_s = arm_covariance_s + priors.constants_sigma[2] ** 2 * np.outer(up_s, up_s)
    # an arm that keeps to the course is not in the axes of a box that turns beside it
    R_bs = constants.level_axes_s if constants.is_steered else mounting.R_bs
    arm_b, arm_covariance = R_bs @ constants.lever_arm_s, R_bs @ arm_covariance_s @ R_bs.T
    beside = math.hypot(ROUND_THE_COLUMN if constants.is_steered else 0.0, UNSTEADY_ARM * unsteady)
    sigma_b = np.hypot(np.sqrt(np.diag(arm_covariance)), beside * np.array([1.0, 1.0, 0.0]))
    # The value stays where nothing shows it: it is the one that leads from the box to the antenna in the trajectory.
    observable = bool(np.all(sigma_b[:2] < OBSERVABLE * priors.constants_sigma[2]))
    stated = config.mounting.lever_arm_b is not None
    return _value(arm_b.tolist(), sigma_b.tolist(), "m", observable, stated)


def _mounting(noise: Noise, mounting: FittedMounting, config: SessionConfig, common_attitude: Array) -> Identified:
    """How the box stands in the kart."""
    stated = config.mounting.R_bs is not None
    common = np.diag(mounting.R_bs @ common_attitude @ mounting.R_bs.T) * [1.0, 1.0, 0.0 if mounting.by_wheels else 1.0]
    # by how much the axes are askew in their own case, no drive can show: as much as they are out of square and scale
    askew = noise.sensor_error[SENSOR_ERRORS.index(ACCEL_ERROR)]
    source = "configured" if stated else "identified" if mounting.is_observable else "default"
    return Identified(
        mounting.R_bs.tolist(),
        None if stated else np.sqrt(mounting.sigma**2 + askew**2 + common).tolist(),
        "1 (sigma: rad)",
        mounting.is_observable,
        source,
    )


def _rectification(constants: Constants, sigma: Array, noise: Noise) -> dict[str, Identified]:
    """What vibration pushes; sigma (31,) of all constants."""
    out: dict[str, Identified] = {}
    pushed, sigmas = constants.rectification.T, sigma[RECTIFICATION].reshape(3, 2).T
    beforehand = noise.sensor_error[SENSOR_ERRORS.index(RECTIFICATION)]
    for name, value, own in zip(("accel_rectification", "accel_rectification_by_rate"), pushed, sigmas, strict=True):
        seen = bool(np.min(own) < OBSERVABLE * beforehand)
        source = "identified" if seen else "default"
        out[name] = Identified(value.tolist(), own.tolist(), "m/s^2", seen, source)
    return out


def _noise(noise: Noise, config: SessionConfig) -> dict[str, Identified]:
    """How noisy wheels, samples and fixes are."""
    out: dict[str, Identified] = {}
    if noise.slip is not None:
        # not what slip has in common: its process takes a part of that over, and yaw is the same
        sigma = noise.slip.unsure_sigma
        out["slip_sigma"] = _value(noise.slip.sigma, sigma, "rad", sigma < OBSERVABLE * ANY_SLIP, False)
    inertial, told, stated = noise.inertial, noise.told, config.imu
    for name, value, spread, unit, given in (
        ("accel_noise", inertial.accel, told.accel, "m/s^2/sqrt(Hz)", stated.accel_noise),
        ("gyro_noise", inertial.gyro, told.gyro, "rad/s/sqrt(Hz)", stated.gyro_noise),
    ):
        out[name] = _value(value, value * spread, unit, spread < OBSERVABLE * ANY_NOISE, given is not None)
    out["gps_position_noise"] = scatter_of_fixes(noise.position, told.position, told.wandered, SMALLEST_POSITION)
    # with what lasts of them: laps add it up, and a stream has it beside the noise of force that was found with it.
    # That it lasts on the drive as it does at rest, no drive shows
    with_lasting = noise.of_velocities
    velocity = noise_of_fixes(with_lasting, told.velocity, "m/s", with_lasting - noise.velocity)
    return {**out, "gps_velocity_noise": velocity}


def _offset(noise: Noise, unseen: Array) -> dict[str, Identified]:
    """How far fixes wander, and how long that lasts."""
    sigma = np.sqrt(noise.offset_sigma**2 + unseen)
    offset = OffsetModel(sigma, noise.offset_tau, noise.offset_tau_spread)
    return wander_of_fixes(offset, noise.told.hidden)


def _value(
    value: float | list[float], sigma: float | list[float] | None, unit: str, observable: bool, configured: bool
) -> Identified:
    if configured:
        return Identified(value, None, unit, True, "configured")
    return Identified(
        float(value) if isinstance(value, float) else value,
        float(sigma) if isinstance(sigma, float) else sigma,
        unit,
        observable,
        "identified" if observable else "default",
    )
