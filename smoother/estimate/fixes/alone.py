"""The smoother for sessions without a usable IMU: the path through the fixes, as a Trajectory.

Positions are in the frame of the fixes: the path with the slow GPS offset left in it, because separating the two takes
a better Doppler than real receivers have. (Of four receivers carried beside RTK for 840 s, removing the offset by their
own Doppler made three worse, one by a factor of two.) Attitude is unknown; acceleration and yaw rate are those of a
level vehicle along its course, and unknown where it hardly moves. The latency of the fixes is not observable: it is in
the sigma of absolute positions, but not of speed, line and laps, which a constant latency does not change.
"""

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from smoother.arrays import Array
from smoother.estimate.fixes.offset import UNFILTERED, OffsetModel, offset_model, reported_share, unseen_variance
from smoother.estimate.fixes.path import GnssMotion, GnssPath, GnssPathOptions, GnssPathSigmas
from smoother.estimate.fixes.path_noise import LEAST_SIGMA
from smoother.estimate.fixes.pieces import fit_path
from smoother.estimate.fixes.reported_noise import (
    hidden_wander,
    noise_of_fixes,
    scatter_of_fixes,
    unseen_wander,
    wander_from_laps,
    wander_of_fixes,
)
from smoother.estimate.fixes.screen import settling_problems, unsettled, without_positions
from smoother.fit.lap_registration import register_laps
from smoother.samples import Problem, Session
from smoother.trajectory import (
    EstimateReport,
    FixResiduals,
    Identified,
    ResidualStatistics,
    Sigmas,
    Trajectory,
)

UNUSUAL, UNUSUAL_SHARE, LEAST_UNUSUAL = 3.0, 95.0, 3.0  # times the percentile of what moves, m/s^2: no driving, a step
STEP_REACH = 1.5  # fixes on either side of a step whose path it bends
ANY_ARM = 0.5  # m, along each axis: of the antenna from a logger at an unknown position, as the prior of the graph
ANY_TURN = np.pi / np.sqrt(3.0)  # rad, about each axis: any turn
ACCEPTED = 0.5  # robust weight below which a fix counts as rejected


@dataclass(frozen=True)
class GnssOnlyOptions:
    """rate: rows per second, Hz. slowest, m/s, and speed_sigmas: above both, the direction of travel is known.

    position_latency_sigma s: how far the default of the unobservable position latency may be off (0.05-0.5 s seen).
    """

    rate: float = 50.0
    slowest: float = 1.0
    speed_sigmas: float = 4.0
    position_latency_sigma: float = 0.15
    path: GnssPathOptions = field(default_factory=GnssPathOptions)


class GnssSmoother:
    """Positions and Doppler velocity smoothed together, no inertial sensor."""

    name = "gps-only"

    def __init__(self, options: GnssOnlyOptions | None = None) -> None:
        self._options = GnssOnlyOptions() if options is None else options

    def estimate(self, session: Session) -> Trajectory:
        """Return the trajectory from the first fix to the last; without a height the Up of the origin, 100 m unsure."""
        options, started = self._options, time.perf_counter()
        early = unsettled(session)
        session = without_positions(session, early) if early.any() else session
        path = fit_path(session, options.path)
        found, offset = _offset(session, path, options.path)
        laps = register_laps(session.gnss.t, path.at(session.gnss.t).track_n[:, :2])
        fitted = time.perf_counter()
        first, last = session.gnss.t[0], session.gnss.t[-1]
        t = first + np.arange(int(np.floor((last - first) * options.rate + 1e-6)) + 1) / options.rate
        motion, sigma = path.at(t), path.sigma_at(t)
        acceleration_b, angular_rate_b = _body_motion(motion, sigma, options)
        latency_sigma = 0.0 if _is_latency_stated(session, options) else options.position_latency_sigma
        wander = wander_of_fixes(offset, _hidden(session, path, offset))
        report = EstimateReport(
            identified={
                **_identified(session, path, options, latency_sigma),
                **_of_fixes(session, path, found),
                **(wander if laps is None else wander_from_laps(laps, wander)),
                **_inertial(session),
            },
            residuals=_statistics(path),
            fixes=FixResiduals(np.arange(len(session.gnss)), path.position_residual_n, path.position_weight),
            timings={"fixes": fitted - started, "output": time.perf_counter() - fitted},
            problems=(*settling_problems(session.gnss.t, early), *_unknown_delay(latency_sigma)),
            left_out=early if early.any() else None,
            mode="gps-only",
        )
        return Trajectory(
            t=t,
            position_n=motion.track_n,
            velocity_n=motion.velocity_n,
            R_nb=np.full((t.size, 3, 3), np.nan),
            acceleration_b=acceleration_b,
            angular_rate_b=angular_rate_b,
            sigmas=_sigmas(motion, _widened(t, motion, sigma, path, session), offset.sigma, latency_sigma),
            report=report,
        )


def _offset(session: Session, path: GnssPath, options: GnssPathOptions) -> tuple[OffsetModel, OffsetModel]:
    """The slow offset of the fixes as far as Doppler shows it, else the population's; and the same as reported."""
    usual = OffsetModel(np.asarray(options.offset_sigma), options.offset_tau)
    population = usual.sigma * reported_share(session.gnss, float(usual.sigma[0]))
    white = float(path.position_sigma[0])
    found = offset_model(session.gnss.t, path, usual, white < UNFILTERED)
    hidden = unseen_wander(session.gnss.t, path, usual.tau)
    unseen = unseen_variance(found, white, population, len(session.gnss), hidden)
    return found, replace(found, sigma=np.sqrt(found.sigma**2 + unseen))


def _widened(t: Array, motion: GnssMotion, sigma: GnssPathSigmas, path: GnssPath, session: Session) -> GnssPathSigmas:
    """The sigmas at t (N,) s, wider where positions alone make the path step.

    One density of jerk and one noise describe the whole session, so that a place where fixes move 60 m aside is to them
    as sure as any other. Without Doppler nothing contradicts such a step: the speed there is as unsure as the step
    changes it, and the line by how far that leads from fix to fix.
    """
    if len(session.gnss) < 3 or np.any(path.velocity_weight > 0.0):
        return sigma
    acceleration = np.hypot(motion.acceleration_n[:, 0], motion.acceleration_n[:, 1])
    moves = np.hypot(motion.velocity_n[:, 0], motion.velocity_n[:, 1]) > GnssOnlyOptions.slowest
    usual = float(np.percentile(acceleration[moves], UNUSUAL_SHARE)) if moves.any() else 0.0
    is_step = acceleration > max(UNUSUAL * usual, LEAST_UNUSUAL)
    if not is_step.any():
        return sigma
    interval = float(np.median(np.diff(session.gnss.t)))
    changed = np.concatenate([[0.0], np.cumsum(np.where(is_step, acceleration, 0.0)[1:] * np.diff(t))])
    reach = STEP_REACH * interval
    unsure = (np.interp(t + reach, t, changed) - np.interp(t - reach, t, changed))[:, None] * np.array([1.0, 1.0, 0.0])
    return GnssPathSigmas(
        position_n=np.hypot(sigma.position_n, unsure * interval),
        track_n=np.hypot(sigma.track_n, unsure * interval),
        velocity_n=np.hypot(sigma.velocity_n, unsure),
        velocity_cross=sigma.velocity_cross,
    )


def _body_motion(motion: GnssMotion, sigma: GnssPathSigmas, options: GnssOnlyOptions) -> tuple[Array, Array]:
    """Acceleration and rotation rate (N, 3) of a level vehicle along its course, NaN where it hardly moves."""
    velocity, acceleration = motion.velocity_n[:, :2], motion.acceleration_n[:, :2]
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    moves = speed > np.maximum(options.slowest, options.speed_sigmas * sigma.velocity_n[:, :2].max(axis=1))
    along = velocity / np.where(moves, speed, np.nan)[:, None]
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    acceleration_b, angular_rate_b = np.full((speed.size, 3), np.nan), np.full((speed.size, 3), np.nan)
    acceleration_b[:, 0] = np.sum(acceleration * along, axis=1)
    acceleration_b[:, 1] = np.sum(acceleration * left, axis=1)
    angular_rate_b[moves, 2] = acceleration_b[moves, 1] / speed[moves]
    return acceleration_b, angular_rate_b


def _is_latency_stated(session: Session, options: GnssOnlyOptions) -> bool:
    return session.config.gps.position_latency is not None or options.path.position_latency is not None


def _unknown_delay(latency_sigma: float) -> tuple[Problem, ...]:
    """The problem of an unknown latency of the fixes, of sigma latency_sigma s."""
    if latency_sigma == 0.0:
        return ()
    text = (
        f"without a usable motion sensor the latency of the fixes is unknown: all times may be off by a constant, "
        f"usually up to {latency_sigma:.2g} s; laps, line and speeds are the same. `position_latency` in session.toml "
        "states it"
    )
    return (Problem("gps_delay_unknown", text),)


def _sigmas(motion: GnssMotion, sigma: GnssPathSigmas, offset_sigma: Array, latency_sigma: float) -> Sigmas:
    """Absolute position carries the whole population's offset, which is left in, and the delay; the track neither."""
    velocity = motion.velocity_n[:, :2]
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    along = np.where(speed[:, None] > 0.0, velocity / np.where(speed > 0.0, speed, 1.0)[:, None], np.sqrt(0.5))
    of_speed = np.sum((along * sigma.velocity_n[:, :2]) ** 2, axis=1)
    of_speed += 2.0 * along[:, 0] * along[:, 1] * sigma.velocity_cross
    return Sigmas(
        position_n=np.sqrt(sigma.track_n**2 + offset_sigma**2 + (latency_sigma * motion.velocity_n) ** 2),
        velocity_n=sigma.velocity_n,
        speed=np.sqrt(np.maximum(of_speed, 0.0)),
        attitude=np.full(motion.velocity_n.shape, np.nan),
        track=np.sqrt(np.mean(sigma.track_n[:, :2] ** 2, axis=1)),
    )


def _statistics(path: GnssPath) -> dict[str, ResidualStatistics]:
    """Residuals of horizontal position, height and horizontal velocity, of the accepted ones; per axis."""
    position, velocity = path.position_residual_n, path.velocity_residual_n
    parts = {
        "gps_position": ("m", position[:, :2], path.position_weight, path.position_sigma[0] * path.position_scale),
        "gps_height": ("m", position[:, 2:], path.up_weight, path.position_sigma[2] * path.up_scale),
        "gps_velocity": ("m/s", velocity[:, :2], path.velocity_weight, path.velocity_sigma[0] * path.velocity_scale),
    }
    return {
        name: _statistic(unit, residual, weight, sigma)
        for name, (unit, residual, weight, sigma) in parts.items()
        if np.isfinite(residual).any()
    }


def _statistic(unit: str, residual: Array, weight: Array, sigma: Array) -> ResidualStatistics:
    measured = np.isfinite(residual).all(axis=1)
    used = measured & (weight >= ACCEPTED)
    values, normalised = residual[used], residual[used] / sigma[used, None]
    return ResidualStatistics(
        unit=unit,
        count=int(np.count_nonzero(measured)),
        mean=float(np.mean(values)) if used.any() else np.nan,
        rms=_rms(values),
        normalised_rms=_rms(normalised),
        rejected=int(np.count_nonzero(measured & ~used)),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else np.nan


def _identified(
    session: Session, path: GnssPath, options: GnssOnlyOptions, latency_sigma: float
) -> dict[str, Identified]:
    """The session's delays and where they are from. latency_sigma s: of the position latency, 0 where it is stated."""
    lag, latency = path.velocity_lag, path.position_latency
    stated = latency_sigma == 0.0
    found = {
        "gps_position_latency": Identified(
            latency, None if stated else latency_sigma, "s", stated, "configured" if stated else "default"
        ),
        "gps_velocity_latency": Identified(
            latency + lag.value,
            None if lag.source == "configured" else float(np.hypot(lag.sigma, latency_sigma)),
            "s",
            lag.source == "configured" or (stated and lag.observable),
            lag.source if stated or lag.source == "configured" else "default",
        ),
        "gps_velocity_lag": Identified(
            lag.value,
            None if lag.source == "configured" else lag.sigma,
            "s",
            lag.observable or lag.source == "configured",
            lag.source,
        ),
    }
    if _has_velocity(path):
        bias, bias_sigma = path.velocity_bias.tolist(), path.velocity_bias_sigma.tolist()
        is_seen = max(bias_sigma[:2]) < 0.5 * options.path.velocity_bias_sigma
        found["gps_velocity_bias"] = Identified(
            bias, bias_sigma, "m/s", is_seen, "identified" if is_seen else "default"
        )
    return found


def _has_velocity(path: GnssPath) -> bool:
    return bool(np.any(path.velocity_weight > 0.0))


def _of_fixes(session: Session, path: GnssPath, offset: OffsetModel) -> dict[str, Identified]:
    """Noise of the fixes, whose `offset` is as the session shows it.

    Fixes that come more quickly than there are nodes share them, and what their offset does in between is no noise.
    """
    t = session.gnss.t - path.position_latency
    after = np.clip(np.searchsorted(path.t, t), 1, len(path.t) - 1)
    step = path.t[after] - path.t[after - 1]
    part = np.clip((t - path.t[after - 1]) / step, 0.0, 1.0)
    wandered = 2.0 * offset.sigma**2 / offset.tau * np.mean(step * part * (1.0 - part))
    least = LEAST_SIGMA[[0, 0, 1]]
    found = {"gps_position_noise": scatter_of_fixes(path.position_sigma, path.position_spread, wandered, least)}
    if _has_velocity(path):
        found["gps_velocity_noise"] = noise_of_fixes(path.velocity_sigma, path.velocity_spread, "m/s")
    return found


def _hidden(session: Session, path: GnssPath, offset: OffsetModel) -> Array:
    """How far the offset may go (3,) m beneath the noise of the fixes."""
    t = session.gnss.t
    lasts = float(t[-1] - t[0])
    return hidden_wander(path.position_sigma, path.velocity_sigma, lasts / len(t), lasts, offset.tau)


def _inertial(session: Session) -> dict[str, Identified]:
    """What only an IMU could show: as stated, else the values that leave out its part, NaN where there is none.

    The mounting is unknown then, and the lever arm has its prior.
    """
    mounting, imu = session.config.mounting, session.config.imu

    def stated(value: Any, otherwise: Any, unit: str, sigma: list[float] | None = None) -> Identified:
        if value is not None:
            return Identified(value, None, unit, True, "configured")
        return Identified(otherwise, sigma, unit, False, "default")

    arm = None if mounting.lever_arm_b is None else mounting.lever_arm_b.tolist()
    R_bs = None if mounting.R_bs is None else mounting.R_bs.tolist()
    return {
        "lever_arm_b": stated(arm, [0.0, 0.0, 0.0], "m", [ANY_ARM] * 3),
        "R_bs": stated(R_bs, np.eye(3).tolist(), "1 (sigma: rad)", [ANY_TURN] * 3),
        "accel_noise": stated(imu.accel_noise, np.nan, "m/s^2/sqrt(Hz)"),
        "gyro_noise": stated(imu.gyro_noise, np.nan, "rad/s/sqrt(Hz)"),
    }
