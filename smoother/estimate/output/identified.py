"""The constants and the noise of a session that were identified: value, sigma, source, and whether it is observable."""

import math

import numpy as np

from smoother.arrays import Array
from smoother.config import SessionConfig
from smoother.estimate.factors.graph import TABLE
from smoother.estimate.fixes.offset import OffsetModel
from smoother.estimate.fixes.reported_noise import OBSERVABLE, noise_of_fixes, scatter_of_fixes, wander_of_fixes
from smoother.estimate.model.heading import ANY_HARD_IRON, ANY_IRON, Heading
from smoother.estimate.model.state import COLUMNS, CONSTANTS, Constant
from smoother.estimate.output.estimated import Estimated
from smoother.estimate.output.mounting import FittedMounting
from smoother.estimate.output.residuals import ANY_SLIP
from smoother.estimate.solvers.variance_components import SMALLEST_POSITION
from smoother.fit.noise_spread import ANY_NOISE
from smoother.samples import Sampling
from smoother.trajectory import Identified

# s^2, apparent response of an antenna half a metre above a logger that leans by 2.2 mrad per m/s^2
ANTENNA_LEANS = 1.1e-3
# m, motion of a logger on a steering wheel about the column
ROUND_THE_COLUMN = 0.1
# s, sigma of the delay of the filter before the sampling: usual ones of 41 to 184 Hz have 0 to 4 ms
FILTERS = 1.5e-3


def sample_time_sigma(sampling: Sampling, stated: float | None) -> float:
    """Sigma, s, of the time at which a sample of `sampling` is true; stated: its delay, s, where it is known.

    Otherwise a sample is the mean since the one before. With a logger that stamps instantaneous values all latencies
    are longer by half of that, with one behind a filter they are shorter.
    """
    of_samples = math.hypot(0.5 * sampling.every / math.sqrt(3.0), FILTERS) if stated is None else 0.0
    return math.hypot(of_samples, sampling.stamp_sigma)


def identified_values(
    found: Estimated, mounting: FittedMounting, config: SessionConfig, unseen: Array, sampling: Sampling
) -> dict[str, Identified]:
    """Return each value by its name in `identified` of summary.json.

    Sigmas are those of the priors where the kart did not drive. unseen (3,) m^2: variance of the GPS offset beyond what
    the session shows. sampling: see :func:`sample_time_sigma`.
    """
    known = found.known
    return {
        **_of_the_receiver(found, config, sample_time_sigma(sampling, config.imu_delay)),
        "lever_arm_b": _lever_arm(found, mounting, config),
        "R_bs": _mounting(found, mounting, config),
        **_noise(found, config),
        **_of_factors(found),
        **wander_of_fixes(
            OffsetModel(np.sqrt(known.noise.offset_sigma**2 + unseen), known.noise.offset_tau, known.offset_tau_spread),
            known.noise_uncertainty.hidden,
        ),
    }


def _covariance(found: Estimated, name: str) -> Array:
    """Covariance (size, size) of a constant, its prior's where the kart did not drive."""
    if not found.known.drives:
        return np.diag(found.known.prior_sigma(name) ** 2)
    return found.known.constants_covariance[COLUMNS[name], COLUMNS[name]]


def _sigma(found: Estimated, name: str) -> Array:
    return np.sqrt(np.diag(_covariance(found, name)))


def _is_observable(found: Estimated, name: str) -> bool:
    return bool(_sigma(found, name)[0] < OBSERVABLE * found.known.priors.constants[name][1][0])


def field_values(heading: Heading | None, found: Estimated) -> dict[str, Identified]:
    """Return the values of the magnetometer; nothing where it is not used. Iron only where it was fitted."""
    if heading is None:
        return {}
    column = COLUMNS["heading_offset"].start
    sigma = float(np.sqrt(found.known.constants_covariance[column, column]))
    value = found.state.constant("heading_offset")
    out = {"mag_heading_offset": _value(value, sigma, "rad", sigma < OBSERVABLE * heading.offset_sigma, False)}
    fit = heading.fit
    if fit is None or not fit.is_reported:
        return out
    seen = bool(np.all(fit.iron_sigma < OBSERVABLE * ANY_HARD_IRON * fit.strength))
    out["mag_hard_iron"] = _value(fit.iron.tolist(), fit.iron_sigma.tolist(), "of the readings", seen, False)
    soft, of_soft = fit.soft_iron, fit.soft_iron_sigma
    seen = bool(np.median(of_soft) < OBSERVABLE * ANY_IRON)
    source = "identified" if seen else "default"
    return {**out, "mag_soft_iron": Identified(soft.tolist(), of_soft.tolist(), "1", seen, source)}


def _of_the_receiver(found: Estimated, config: SessionConfig, moment: float) -> dict[str, Identified]:
    """Its latencies, and its response to a change of acceleration; moment: see :func:`sample_time_sigma`."""
    state, known = found.state, found.known
    out: dict[str, Identified] = {}
    for name, configured in (
        ("position_latency", config.gps.position_latency),
        ("velocity_latency", config.gps.velocity_latency),
    ):
        own = math.hypot(_sigma(found, name)[0], moment if known.drives else 0.0)
        out[f"gps_{name}"] = _value(state.constant(name), own, "s", _is_observable(found, name), configured is not None)
    own = float(_sigma(found, "velocity_response")[0])
    if known.priors.held_s is not None:
        own = math.hypot(own, ANTENNA_LEANS)
    if state.geometry.is_steered:
        # the arm follows the course, the antenna the heading: they differ by the sideslip
        slip = float(known.priors.constants["slip"][1][1])
        own = math.hypot(own, slip * float(np.linalg.norm(state.constants["lever_arm"])))
    observable = _is_observable(found, "velocity_response")
    out["gps_velocity_response"] = _value(state.constant("velocity_response"), own, "s^2", observable, False)
    return out


def _lever_arm(found: Estimated, mounting: FittedMounting, config: SessionConfig) -> Identified:
    """The arm from the IMU to the antenna, in b."""
    state, known = found.state, found.known
    geometry, prior = state.geometry, known.priors.constants["lever_arm"][1][0]
    covariance_s = _covariance(found, "lever_arm")
    if known.priors.held_s is not None and known.drives:
        covariance_s = covariance_s + prior**2 * np.outer(known.priors.held_s, known.priors.held_s)
    R_bs = geometry.level_axes_s if geometry.is_steered else mounting.R_bs
    arm_b, covariance = R_bs @ state.constants["lever_arm"], R_bs @ covariance_s @ R_bs.T
    beside = ROUND_THE_COLUMN if geometry.is_steered else 0.0
    sigma_b = np.hypot(np.sqrt(np.diag(covariance)), beside * np.array([1.0, 1.0, 0.0]))
    # The value stays where it is not observable: it is the one between IMU and antenna in the trajectory.
    observable = bool(np.all(sigma_b[:2] < OBSERVABLE * prior))
    return _value(arm_b.tolist(), sigma_b.tolist(), "m", observable, config.mounting.lever_arm_b is not None)


def _mounting(found: Estimated, mounting: FittedMounting, config: SessionConfig) -> Identified:
    """How the IMU is mounted in the kart."""
    stated, by_wheels = config.mounting.R_bs is not None, mounting.by_wheels
    common = np.diag(mounting.R_bs @ found.known.common_attitude @ mounting.R_bs.T)
    # misalignment of the axes in their case is not observable: as much as scale
    askew = found.known.prior_sigma("accel_scale")[0]
    variance = mounting.sigma**2 + askew**2 + common * [1.0, 1.0, 0.0 if by_wheels else 1.0]
    return Identified(
        mounting.R_bs.tolist(),
        None if stated else np.sqrt(variance).tolist(),
        "1 (sigma: rad)",
        mounting.is_observable,
        "configured" if stated else "identified" if mounting.is_observable else "default",
    )


def _of_factors(found: Estimated) -> dict[str, Identified]:
    """Constants that belong to one factor, and sigmas of factors that their residuals show, where they are used."""
    counts = {name: int(np.count_nonzero(np.isfinite(rows.sigma))) for name, rows in found.rows.items()}
    units = {name: unit for factor in TABLE for name, unit in factor.units.items()}
    out: dict[str, Identified] = {}
    for constant in CONSTANTS:
        if counts.get(constant.factor):
            out[constant.name] = _of_one_factor(found, constant)
    for name, value in found.known.noise.sigmas.items():
        if counts.get(name):
            out[f"{name}_noise"] = _value(value, value / math.sqrt(2.0 * counts[name]), units[name], True, False)
    return out


def _of_one_factor(found: Estimated, constant: Constant) -> Identified:
    columns, value = COLUMNS[constant.name], found.state.constants[constant.name]
    sigma = np.sqrt(np.diag(found.known.constants_covariance)[columns])
    seen = bool(np.all(sigma < OBSERVABLE * found.known.prior_sigma(constant.name)))
    if constant.size == 1:
        return _value(float(value[0]), float(sigma[0]), constant.unit, seen, False)
    return _value(value.tolist(), sigma.tolist(), constant.unit, seen, False)


def _noise(found: Estimated, config: SessionConfig) -> dict[str, Identified]:
    """How noisy wheels, samples and fixes are."""
    noise, known, stated = found.known.noise, found.known.noise_uncertainty, config.imu
    out: dict[str, Identified] = {}
    if noise.slip is not None and known.slip is not None:
        out["slip_sigma"] = _value(
            noise.slip, known.slip, "rad", known.slip < min(OBSERVABLE * ANY_SLIP, noise.slip), False
        )
    for name, value, spread, unit, given in (
        ("accel_noise", noise.inertial.accel, known.accel, "m/s^2/sqrt(Hz)", stated.accel_noise),
        ("gyro_noise", noise.inertial.gyro, known.gyro, "rad/s/sqrt(Hz)", stated.gyro_noise),
    ):
        out[name] = _value(value, value * spread, unit, spread < OBSERVABLE * ANY_NOISE, given is not None)
    out["gps_position_noise"] = scatter_of_fixes(noise.position, known.position, known.wandered, SMALLEST_POSITION)
    return {**out, "gps_velocity_noise": noise_of_fixes(noise.velocity, known.velocity, "m/s")}


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
