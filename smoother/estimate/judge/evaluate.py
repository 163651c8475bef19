"""Accuracy of a trajectory against truth: errors, coverage of the reported sigmas, NEES.

Errors are estimate - truth, at the times of the truth inside the estimate's span. Quantities that truth or estimate
lacks are NaN.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from smoother import so3
from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.estimate.output.resample import is_known, known_rotation, position_at, resample
from smoother.frames import wrap_angle
from smoother.samples import Session
from smoother.trajectory import Keyframes, Trajectory
from smoother.units import DEG

LONGEST_LAG = 1.0  # s, of an estimate against a reference of unknown latency
VELOCITY_DOUBT = 0.5, 0.1  # m/s, and share of the speed, by which a truth's velocity may differ from its own positions
TRUTH_GAP = 0.5  # s; between truth rows farther apart than this nothing is interpolated
_AXES = ("north", "west", "up")
_ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class Nees:
    """Normalised estimation error squared, the mean over keyframes; `dimension` for a consistent covariance.

    The keyframes of one session are correlated, so its mean scatters far more than chi-square over K.
    """

    mean: float
    dimension: int
    count: int


@dataclass(frozen=True)
class Evaluation:
    """Root mean square errors against truth, NaN where truth or estimate lacks the quantity.

    horizontal_rms_m: of the 2-D error; velocity_rms_mps: of the 3-D one; relative_1s_rms_m: horizontal error of the
    change of position over 1 s. along_track, cross_track: parts of the horizontal error along and across the true
    direction of travel. lag_s: the constant time shift that fits best (positive: the estimate is late);
    horizontal_rms_at_lag_m: the error with it removed. coverage_1sigma, coverage_2sigma: shares of position errors per
    axis within one and two sigma; coverage: both for each quantity.
    """

    count: int
    horizontal_rms_m: float
    horizontal_max_m: float
    up_rms_m: float
    along_track_rms_m: float
    cross_track_rms_m: float
    lag_s: float
    horizontal_rms_at_lag_m: float
    velocity_rms_mps: float
    horizontal_velocity_rms_mps: float
    roll_rms_deg: float
    pitch_rms_deg: float
    yaw_rms_deg: float
    relative_1s_rms_m: float
    coverage_1sigma: float
    coverage_2sigma: float
    coverage: dict[str, tuple[float, float]]
    nees: Nees | None


@dataclass(frozen=True, eq=False)
class Errors:
    """Estimate - truth at t (N,): position_n, velocity_n (N, 3) m, m/s; euler (N, 3) rad; NaN where unknown."""

    t: Array
    position_n: Array
    velocity_n: Array
    euler: Array


def evaluate(estimate: Trajectory, truth: Trajectory, skip: float = 0.0) -> Evaluation:
    """Return the accuracy of `estimate`, leaving out the first `skip` seconds of what both cover.

    Raises SessionError when the two do not overlap.
    """
    truth = _overlap(truth, estimate, skip)
    lag, rms_at_lag = best_lag(estimate, truth)
    at_truth = resample(estimate, truth.t)
    errors = errors_between(at_truth, truth)
    along, cross = _split_by_direction(errors.position_n, _direction(truth))
    coverage = _coverage(errors, at_truth)
    position = [coverage[axis] for axis in _AXES]
    roll, pitch, yaw = (_rms(errors.euler[:, i]) / DEG for i in range(3))
    horizontal = np.hypot(errors.position_n[:, 0], errors.position_n[:, 1])
    return Evaluation(
        count=len(truth),
        horizontal_rms_m=_rms(horizontal),
        horizontal_max_m=float(np.nanmax(horizontal)) if np.any(np.isfinite(horizontal)) else np.nan,
        up_rms_m=_rms(errors.position_n[:, 2]),
        along_track_rms_m=_rms(along),
        cross_track_rms_m=_rms(cross),
        lag_s=lag,
        horizontal_rms_at_lag_m=rms_at_lag,
        velocity_rms_mps=_rms(np.linalg.norm(errors.velocity_n, axis=1)),
        horizontal_velocity_rms_mps=_rms(np.hypot(errors.velocity_n[:, 0], errors.velocity_n[:, 1])),
        roll_rms_deg=roll,
        pitch_rms_deg=pitch,
        yaw_rms_deg=yaw,
        relative_1s_rms_m=relative_rms(errors, 1.0),
        coverage_1sigma=_mean([one for one, _ in position]),
        coverage_2sigma=_mean([two for _, two in position]),
        coverage=coverage,
        nees=nees(estimate.report.keyframes, truth),
    )


def errors_between(estimate: Trajectory, truth: Trajectory) -> Errors:
    """Return estimate - truth of two trajectories with the same times."""
    euler = wrap_angle(estimate.euler - truth.euler)
    return Errors(truth.t, estimate.position_n - truth.position_n, estimate.velocity_n - truth.velocity_n, euler)


def relative_rms(errors: Errors, interval: float) -> float:
    """Return the rms, in m, of the horizontal error of the change of position over `interval` seconds."""
    later = np.searchsorted(errors.t, errors.t + interval - 1e-6)
    inside = later < errors.t.size
    i, j = np.flatnonzero(inside), later[inside]
    # rows of an irregular truth count if they are within a tenth of the interval
    near = np.abs(errors.t[j] - errors.t[i] - interval) <= 0.1 * interval
    change = errors.position_n[j[near], :2] - errors.position_n[i[near], :2]
    return _rms(np.hypot(change[:, 0], change[:, 1]))


def best_lag(estimate: Trajectory, truth: Trajectory) -> tuple[float, float]:
    """Return the lag (s) of the estimate behind the truth, within LONGEST_LAG, and the horizontal rms (m) it leaves."""
    inside = (truth.t - LONGEST_LAG >= estimate.t[0]) & (truth.t + LONGEST_LAG <= estimate.t[-1])
    t, position_n = truth.t[inside], truth.position_n[inside]
    if t.size < 3:
        return np.nan, np.nan

    def rms(lag: float) -> float:
        error = position_at(estimate, t + lag)[:, :2] - position_n[:, :2]
        return _rms(np.hypot(error[:, 0], error[:, 1]))

    best = minimize_scalar(rms, bounds=(-LONGEST_LAG, LONGEST_LAG), method="bounded", options={"xatol": 1e-4})
    return float(best.x), float(best.fun)


def without_doubtful_velocity(truth: Trajectory) -> Trajectory:
    """Return the truth, its velocity unknown where most of it contradicts the positions (a wrong sign or frame)."""
    step = np.diff(truth.t)[:, None]
    moved, mean = np.diff(truth.position_n, axis=0) / step, 0.5 * (truth.velocity_n[1:] + truth.velocity_n[:-1])
    difference = np.linalg.norm((moved - mean)[:, :2], axis=1)
    known = np.isfinite(difference) & (step[:, 0] < 2.0)  # over longer steps the mean of two ends is not the velocity
    if not known.any():
        return truth
    limit = VELOCITY_DOUBT[0] + VELOCITY_DOUBT[1] * np.linalg.norm(moved[known, :2], axis=1)
    if np.median(difference[known] - limit) < 0.0:
        return truth
    return replace(truth, velocity_n=np.full_like(truth.velocity_n, np.nan))


def nees(keyframes: Keyframes | None, truth: Trajectory) -> Nees | None:
    """Return the NEES of attitude, velocity and position, or of those the truth knows; None without any.

    The error is (rotation vector in n: truth = exp(error) @ estimate; velocity; position), as in Keyframes.covariance.
    """
    if keyframes is None or len(truth) < 2:
        return None
    inside = (keyframes.t >= truth.t[0]) & (keyframes.t <= truth.t[-1])
    reference = resample(truth, keyframes.t[inside], TRUTH_GAP)
    turn = reference.R_nb @ np.swapaxes(keyframes.R_nb[inside], 1, 2)
    error = np.concatenate(
        [
            np.where(is_known(turn)[:, None], so3.log(known_rotation(turn)), np.nan),
            reference.velocity_n - keyframes.velocity_n[inside],
            reference.position_n - keyframes.position_n[inside],
        ],
        axis=1,
    )
    known = np.isfinite(error).any(axis=0)
    covariance = keyframes.covariance[inside][:, known][:, :, known]
    usable = is_known(error[:, known]) & is_known(covariance)
    if not known.any() or not usable.any():
        return None
    e = error[usable][:, known, None]
    squared = np.swapaxes(e, 1, 2) @ np.linalg.solve(covariance[usable], e)
    return Nees(float(np.mean(squared)), int(known.sum()), int(usable.sum()))


def at_fixes(trajectory: Trajectory, truth: Trajectory, session: Session) -> float:
    """Return the horizontal rms error, in m, at the receive times of the fixes only; NaN where truth is too sparse."""
    t = session.gnss.t
    start, end = max(trajectory.t[0], truth.t[0]), min(trajectory.t[-1], truth.t[-1])
    t = t[(t >= start) & (t <= end)]
    if t.size == 0:
        return np.nan
    error = resample(trajectory, t).position_n - resample(truth, t, TRUTH_GAP).position_n
    return _rms(np.hypot(error[:, 0], error[:, 1]))


def _overlap(truth: Trajectory, estimate: Trajectory, skip: float) -> Trajectory:
    if len(truth) == 0 or len(estimate) == 0:
        raise SessionError("nothing to compare: the truth or the estimate is empty")
    start, end = max(truth.t[0], estimate.t[0]) + skip, min(truth.t[-1], estimate.t[-1])
    rows = (truth.t >= start) & (truth.t <= end)
    if not rows.any():
        raise SessionError(
            f"{_span('truth', truth)} and {_span('estimate', estimate)} do not overlap; one clock for both?"
        )
    names = ("t", "position_n", "velocity_n", "R_nb", "acceleration_b", "angular_rate_b")
    return Trajectory(**{name: getattr(truth, name)[rows] for name in names})


def _span(name: str, trajectory: Trajectory) -> str:
    return f"{name} ({trajectory.t[0]:.1f} to {trajectory.t[-1]:.1f} s)"


def _direction(truth: Trajectory) -> Array:
    """Unit vector of travel (N, 2), NaN below 1 m/s; from positions where the truth has no velocity."""
    velocity = truth.velocity_n[:, :2]
    if not np.isfinite(velocity).any() and len(truth) > 2:
        velocity = np.gradient(truth.position_n[:, :2], truth.t, axis=0)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    return velocity / np.where(speed > 1.0, speed, np.nan)[:, None]


def _split_by_direction(error_n: Array, direction: Array) -> tuple[Array, Array]:
    along = error_n[:, 0] * direction[:, 0] + error_n[:, 1] * direction[:, 1]
    cross = error_n[:, 1] * direction[:, 0] - error_n[:, 0] * direction[:, 1]
    return along, cross


def _coverage(errors: Errors, estimate: Trajectory) -> dict[str, tuple[float, float]]:
    if estimate.sigmas is None:
        unknown = (np.nan, np.nan)
        return dict.fromkeys((*_AXES, *(f"vel_{axis}" for axis in _AXES), *_ANGLES), unknown)
    pairs = {}
    for i in range(3):
        pairs[_AXES[i]] = (errors.position_n[:, i], estimate.sigmas.position_n[:, i])
        pairs[f"vel_{_AXES[i]}"] = (errors.velocity_n[:, i], estimate.sigmas.velocity_n[:, i])
        pairs[_ANGLES[i]] = (errors.euler[:, i], estimate.sigmas.attitude[:, i])
    return {name: (_share(e, sigma, 1.0), _share(e, sigma, 2.0)) for name, (e, sigma) in pairs.items()}


def _share(error: Array, sigma: Array, factor: float) -> float:
    known = np.isfinite(error) & np.isfinite(sigma)
    return float(np.mean(np.abs(error[known]) <= factor * sigma[known])) if known.any() else np.nan


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan


def _mean(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else np.nan
