"""From a solved graph to the trajectory people use: dense rows, antenna, body axes, sigmas, and the report."""

from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph.batch import Noise, Priors, Solved, unseen_offset
from smoother.estimate.graph.chain import ChainFactor
from smoother.estimate.graph.imu import (
    JERK_RATE,
    YAW_JERK_RATE,
    BinnedImu,
    at_times,
    averaged,
    corrected,
    dense_path,
    motion_at,
)
from smoother.estimate.graph.mounting import FittedMounting
from smoother.estimate.graph.rows import Rows, antenna_jacobian
from smoother.estimate.graph.state import (
    ACCEL_BIAS,
    CONSTANTS_SIZE,
    GYRO_BIAS,
    LEVER_ARM,
    OFFSET,
    ROTATION,
    ROW_CONSTANTS_SIZE,
    TRANSLATION,
    VELOCITY,
    ChainState,
)
from smoother.frames import euler_jacobian
from smoother.samples import Session
from smoother.trajectory import (
    EstimateReport,
    FixResiduals,
    Identified,
    Keyframes,
    ResidualStatistics,
    Sigmas,
    Trajectory,
)
from smoother.units import DEG

OBSERVABLE = 0.5  # a value is observable when its sigma is below this share of its prior's
AXES_SIGMA = 0.5 * DEG  # by which the axes of a sensor of this class are askew in its own case, which no drive can show
REJECTED_WEIGHT = 0.1  # a fix whose robust weight is below this counts as rejected


def build_trajectory(
    session: Session,
    solved: Solved,
    noise: Noise,
    mounting: FittedMounting,
    binned: BinnedImu,
    priors: Priors,
    rate: float,
    population: Array,
) -> Trajectory:
    """Return rows at `rate` Hz from the first to the last fix: antenna in n, attitude and accelerations of the kart.

    population (3,) m: sigma of the GPS offset of receivers like this one, the least that absolute positions are unsure.
    """
    state = solved.state
    binned = corrected(binned, state.constants.accel_matrix, state.constants.gyro_matrix)
    path = dense_path(binned, state.R_ns, state.position_n, state.velocity_n, state.accel_bias_s, state.gyro_bias_s)
    arm_s = state.constants.lever_arm_s
    t = row_times(session.gnss.t[0], session.gnss.t[-1], rate)
    motion = motion_at(path, t)
    rate_s = at_times(path, averaged(path, path.angular_rate_s, noise.inertial.gyro, YAW_JERK_RATE), t)
    acceleration_n = at_times(path, averaged(path, path.acceleration_n, noise.inertial.accel, JERK_RATE), t)
    R_nb = motion.R_ns @ mounting.R_bs.T
    swing_n = np.einsum("nij,nj->ni", motion.R_ns, np.cross(rate_s, arm_s))
    unseen = unseen_offset(noise, population)
    keyframes = _keyframes(solved, mounting, arm_s, unseen)
    return Trajectory(
        t=t,
        position_n=motion.position_n + motion.R_ns @ arm_s,
        velocity_n=motion.velocity_n + swing_n,
        R_nb=R_nb,
        acceleration_b=np.einsum("nji,nj->ni", R_nb, acceleration_n),
        angular_rate_b=rate_s @ mounting.R_bs.T,
        sigmas=_sigmas(t, solved, keyframes, R_nb, motion.velocity_n),
        report=EstimateReport(
            identified=_identified(solved, noise, priors, mounting, arm_s, session, unseen),
            residuals={
                name: _statistics(solved.rows[name], unit) for name, unit in _UNITS.items() if name in solved.rows
            },
            fixes=_fix_residuals(solved.rows["gps_position"]),
            keyframes=keyframes,
            mode="full",
        ),
        joint=None if solved.solution.factor is None else ChainJoint(state, solved.solution.factor, unseen),
    )


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """How the errors of the antenna's position at several times hang together: a JointPosition.

    unseen (3,) m^2: variance of the GPS offset that a session cannot show, the same at all its times.
    """

    state: ChainState
    factor: ChainFactor
    unseen: Array

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        interval, *jacobians = antenna_jacobian(self.state, t)
        left, right, by_row_constants = (np.einsum("qi,qij->qj", direction_n, J) for J in jacobians)
        constants = np.zeros((len(t), CONSTANTS_SIZE))
        constants[:, :ROW_CONSTANTS_SIZE] = by_row_constants
        return self.factor.covariance(interval, left, right, constants) + (direction_n * self.unseen) @ direction_n.T


def row_times(start: float, end: float, rate: float) -> Array:
    """Times (N,) s from start to end at `rate` Hz, without a hole."""
    return np.asarray(start + np.arange(int(np.floor((end - start) * rate + 1e-6)) + 1) / rate)


def _keyframes(solved: Solved, mounting: FittedMounting, arm_s: Array, unseen: Array) -> Keyframes:
    """Antenna and kart at the keyframes, with the covariance of attitude (in n), velocity and position."""
    state, P = solved.state, solved.solution.covariance
    R = state.R_ns
    K = len(state.t)
    turn = so3.log(R[:-1].transpose(0, 2, 1) @ R[1:]) / state.interval
    turn = np.concatenate([turn, turn[-1:]])
    arm_n, swing_n = R @ arm_s, np.einsum("kij,kj->ki", R, np.cross(turn, arm_s))
    # errors in n of (attitude, velocity, position) by the tangent of the keyframe and by the constants
    J = np.zeros((K, 9, P.shape[1]))
    J[:, 0:3, ROTATION] = R
    J[:, 3:6, ROTATION], J[:, 3:6, VELOCITY] = -so3.skew(swing_n) @ R, np.eye(3)
    J[:, 6:9, ROTATION], J[:, 6:9, TRANSLATION] = -so3.skew(arm_n) @ R, R
    C = np.zeros((K, 9, solved.solution.constants_covariance.shape[0]))
    C[:, 3:6, LEVER_ARM], C[:, 6:9, LEVER_ARM] = R @ so3.skew(turn), R
    S, cross = solved.solution.constants_covariance, J @ solved.solution.constants_cross @ C.transpose(0, 2, 1)
    covariance = J @ P @ J.transpose(0, 2, 1) + C @ S @ C.transpose(0, 2, 1) + cross + cross.transpose(0, 2, 1)
    R_nb = R @ mounting.R_bs.T
    covariance[:, 6:9, 6:9] += np.diag(unseen)
    covariance[:, 0:3, 0:3] += (R_nb * mounting.sigma**2) @ R_nb.transpose(0, 2, 1)
    sigma = np.sqrt(np.einsum("kii->ki", P))
    return Keyframes(
        t=state.t,
        position_n=state.position_n + arm_n,
        velocity_n=state.velocity_n + swing_n,
        R_nb=R_nb,
        covariance=covariance,
        accel_bias_s=state.accel_bias_s,
        gyro_bias_s=state.gyro_bias_s,
        sigma_accel_bias=sigma[:, ACCEL_BIAS],
        sigma_gyro_bias=sigma[:, GYRO_BIAS],
        gps_offset_n=state.offset_n,
    )


def _sigmas(t: Array, solved: Solved, keyframes: Keyframes, R_nb: Array, velocity_n: Array) -> Sigmas:
    """Interpolate the covariances of the keyframes, which are closer than any of them changes."""
    P = solved.solution.covariance
    i = np.clip(np.searchsorted(keyframes.t, t) - 1, 0, len(keyframes.t) - 2)
    share = ((t - keyframes.t[i]) / (keyframes.t[i + 1] - keyframes.t[i]))[:, None, None]
    covariance = (1.0 - share) * keyframes.covariance[i] + share * keyframes.covariance[i + 1]
    diagonal = np.maximum(np.einsum("nii->ni", covariance), 0.0)
    R_bn = R_nb.transpose(0, 2, 1)
    by_turn = euler_jacobian(R_nb) @ R_bn
    attitude = np.einsum("nri,nri->nr", by_turn @ covariance[:, 0:3, 0:3], by_turn)
    direction = velocity_n[:, :2] / np.maximum(np.linalg.norm(velocity_n[:, :2], axis=1), 1e-12)[:, None]
    speed = np.einsum("ni,nij,nj->n", direction, covariance[:, 3:5, 3:5], direction)
    track = _track_variance(solved.state, P)
    track = (1.0 - share[:, 0, 0]) * track[i] + share[:, 0, 0] * track[i + 1]
    return Sigmas(
        position_n=np.sqrt(diagonal[:, 6:9]),
        velocity_n=np.sqrt(diagonal[:, 3:6]),
        speed=np.sqrt(np.maximum(speed, 0.0)),
        attitude=np.sqrt(np.maximum(attitude, 0.0)),
        track=np.sqrt(np.maximum(track, 0.0)),
    )


def _track_variance(state: ChainState, P: Array) -> Array:
    """Variance (K,) m^2, per horizontal axis, of position plus offset: the line in the frame of the fixes."""
    R = state.R_ns
    position, offset = P[:, TRANSLATION, TRANSLATION], P[:, OFFSET, OFFSET]
    cross = R @ P[:, TRANSLATION, OFFSET]
    total = R @ position @ R.transpose(0, 2, 1) + offset + cross + cross.transpose(0, 2, 1)
    return np.asarray(0.5 * (total[:, 0, 0] + total[:, 1, 1]))


_UNITS = {"gps_position": "m", "gps_velocity": "m/s", "heading": "rad", "standstill": "m/s, rad"}


def _statistics(rows: Rows, unit: str) -> ResidualStatistics:
    known = np.isfinite(rows.sigma)
    residual = rows.residual[known]
    if residual.size == 0:
        return ResidualStatistics(unit, 0, 0.0, 0.0, 0.0, 0)
    weight = np.broadcast_to(rows.weight[:, None], known.shape)[known]
    normalised = residual / rows.sigma[known] * np.sqrt(weight)
    return ResidualStatistics(
        unit,
        int(np.count_nonzero(np.any(known, axis=1))),
        float(np.average(residual, weights=weight)),
        float(np.sqrt(np.average(residual**2, weights=weight))),
        float(np.sqrt(np.mean(normalised**2))),
        int(np.count_nonzero(rows.weight < REJECTED_WEIGHT)),
    )


def _fix_residuals(rows: Rows) -> FixResiduals:
    residual = np.where(np.isfinite(rows.sigma), rows.residual, np.nan)
    return FixResiduals(np.arange(len(rows.interval)), residual, rows.weight)


@dataclass(frozen=True)
class _Latency:
    key: str
    index: int
    configured: float | None


def _identified(
    solved: Solved,
    noise: Noise,
    priors: Priors,
    mounting: FittedMounting,
    arm_s: Array,
    session: Session,
    unseen: Array,
) -> dict[str, Identified]:
    config, S = session.config, solved.solution.constants_covariance
    sigma = np.sqrt(np.diag(S))
    constants = solved.state.constants.as_vector()
    out: dict[str, Identified] = {}
    for latency in (
        _Latency("gps_position_latency", 0, config.gps.position_latency),
        _Latency("gps_velocity_latency", 1, config.gps.velocity_latency),
    ):
        i = latency.index
        observable = bool(sigma[i] < OBSERVABLE * priors.constants_sigma[i])
        out[latency.key] = _value(constants[i], sigma[i], "s", observable, latency.configured is not None)
    arm_covariance_s, up_s = S[LEVER_ARM, LEVER_ARM], solved.state.constants.level_axes_s[2]
    if priors.holds_height:
        arm_covariance_s = arm_covariance_s + priors.constants_sigma[2] ** 2 * np.outer(up_s, up_s)
    arm_b, arm_covariance = mounting.R_bs @ arm_s, mounting.R_bs @ arm_covariance_s @ mounting.R_bs.T
    sigma_b = np.sqrt(np.diag(arm_covariance))
    stated = config.mounting.lever_arm_b is not None
    out["lever_arm_b"] = Identified(
        arm_b.tolist(),
        None if stated else sigma_b.tolist(),
        "m",
        bool(np.all(sigma_b[:2] < OBSERVABLE * priors.constants_sigma[2])) or stated,
        "configured" if stated else "identified",
    )
    stated = config.mounting.R_bs is not None
    source = "configured" if stated else "identified" if mounting.is_observable else "default"
    out["R_bs"] = Identified(
        mounting.R_bs.tolist(),
        None if stated else np.hypot(mounting.sigma, AXES_SIGMA).tolist(),
        "1 (sigma: rad)",
        mounting.is_observable,
        source,
    )
    inertial = noise.inertial
    out["accel_noise"] = _value(inertial.accel, None, "m/s^2/sqrt(Hz)", True, config.imu.accel_noise is not None)
    out["gyro_noise"] = _value(inertial.gyro, None, "rad/s/sqrt(Hz)", True, config.imu.gyro_noise is not None)
    out["gps_position_noise"] = _value(noise.position.tolist(), None, "m", True, False)
    out["gps_velocity_noise"] = _value(noise.velocity.tolist(), None, "m/s", True, False)
    sigma_offset, shown = np.sqrt(noise.offset_sigma**2 + unseen), bool(unseen[0] == 0.0)
    source = "identified" if shown else "default"
    out["gps_offset_sigma"] = Identified(sigma_offset.tolist(), None, "m", shown, source)
    out["gps_offset_tau"] = Identified(noise.offset_tau, None, "s", False, "default")
    return out


def _value(
    value: float | list[float], sigma: float | None, unit: str, observable: bool, configured: bool
) -> Identified:
    if configured:
        return Identified(value, None, unit, True, "configured")
    return Identified(
        float(value) if isinstance(value, float) else value,
        None if sigma is None else float(sigma),
        unit,
        observable,
        "identified" if observable else "default",
    )
