"""The thesis' Kalman filter: position, velocity and acceleration on two axes, constant acceleration (eq. 2.46-2.69).

State `(p_x, p_y, v_x, v_y, a_x, a_y)`, eq. 2.50; x and y are north and west here. At every step the IMU measures the
acceleration (H of eq. 2.65), with a fix also the position (H of eq. 2.62).

The six states are filtered as two times three: in the principal axes of the accelerometer's covariance (eq. 2.67)
nothing couples one axis to the other. The result equals that of the 6 x 6 matrices at a tenth of the cost.

Note on eq. 2.54: the text calls sigma_da a variance and sets alpha = sigma_da; the matrix printed is alpha times the
outer product of eq. 2.53's vector, so alpha is the variance by which the acceleration may change from one step to the
next, m^2/s^4 *per step*. It belongs to a rate; it is tuned at the thesis' 50 Hz.

The thesis measures both covariances (eq. 2.66 and 2.67) in 30 s at rest. Here that of the fixes is their scatter while
driving. At rest accelerations scatter by 0.3 m/s^2, but in a corner gravity leaks in through a tilt of tens of degrees
and stays there for seconds. Such an error acts like white noise of the same spectral density, `variance * step =
density`, which the velocity changes of accelerometer and fixes show. The covariance at rest stays available.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import pieces, release, roomy
from smoother.estimate.baseline.alignment import FEWEST, MOVING, Course, velocities_at_fixes
from smoother.estimate.baseline.steps import CHUNK, collect
from smoother.samples import GnssFixes

START_VELOCITY, START_ACCELERATION = 15.0, 5.0  # m/s, m/s^2: sigma before anything is measured; a kart in motion
START_POSITION = 1e3  # m, sigma about the first fix


@dataclass(frozen=True, eq=False)
class KalmanInput:
    """Measurements at K steps of `step` s.

    acceleration (K, 2) m/s^2, a row of NaN without a reading; accel_covariance (2, 2), eq. 2.67. M fixes: at_step (M,)
    the step nearest to each, ascending; delay (M,) s by which the fix is later than that step; position (M, 2) m;
    fix_variance (M,) m^2 per axis, the upper left block of eq. 2.66.
    """

    step: float
    acceleration: Array
    accel_covariance: Array
    at_step: IntArray
    delay: Array
    position: Array
    fix_variance: Array


@dataclass(frozen=True, eq=False)
class KalmanOutput:
    """After the update of each step: position, velocity, acceleration (K, 2) and their covariances (K, 2, 2)."""

    position: Array
    velocity: Array
    acceleration: Array
    position_covariance: Array
    velocity_covariance: Array


def run_kalman(data: KalmanInput, alpha: float) -> KalmanOutput:
    """Run the filter forwards over all steps, from the first fix on, or from zero without any fix."""
    variances, principal = np.linalg.eigh(data.accel_covariance)  # columns: principal axes
    acceleration, position = data.acceleration @ principal, data.position @ principal
    axes = [
        _run_axis(data, acceleration[:, i], float(variances[i]), position[:, i], alpha) for i in range(2)
    ]  # each (K, 5): p, v, a, var p, var v
    n = len(acceleration)
    out = KalmanOutput(*(roomy((n, 2)) for _ in range(3)), *(roomy((n, 2, 2)) for _ in range(2)))
    for part in pieces(n):
        both = np.stack([axis[part] for axis in axes], axis=-1)
        turned = both[:, :3] @ principal.T
        covariance = np.einsum("ij,kcj,lj->kcil", principal, both[:, 3:], principal)
        out.position[part], out.velocity[part], out.acceleration[part] = turned[:, 0], turned[:, 1], turned[:, 2]
        out.position_covariance[part], out.velocity_covariance[part] = covariance[:, 0], covariance[:, 1]
        release(axes, out)
    return out


def _run_axis(data: KalmanInput, acceleration: Array, accel_variance: float, position: Array, alpha: float) -> Array:
    rows = _axis_states(data, acceleration, accel_variance, position, alpha)
    return collect(rows, len(acceleration), 5)


def _floats(values: Array) -> Iterator[float]:
    """Plain floats, in chunks that fit into memory."""
    for part in pieces(len(values), CHUNK):
        yield from values[part].tolist()


def _axis_states(
    data: KalmanInput, acceleration: Array, accel_variance: float, position: Array, alpha: float
) -> Iterator[tuple[float, float, float, float, float]]:
    """One axis in plain floats, because numpy's overhead on 3 x 3 matrices is ten times the arithmetic."""
    dt = data.step
    half = 0.5 * dt * dt
    qpp, qpv, qpa, qvv, qva = (alpha * f for f in (half * half, half * dt, half, dt * dt, dt))  # eq. 2.54
    p, v, a = (float(position[0]) if position.size else 0.0), 0.0, 0.0
    pp, pv, pa = START_POSITION**2, 0.0, 0.0
    vv, va, aa = START_VELOCITY**2, 0.0, START_ACCELERATION**2
    fixes = zip(data.at_step.tolist(), data.delay.tolist(), position.tolist(), data.fix_variance.tolist(), strict=True)
    fix = next(fixes, None)
    for k, measured in enumerate(_floats(acceleration)):
        if k:
            p += dt * v + half * a  # eq. 2.46 to 2.48
            v += dt * a
            # eq. 2.52, written out: P = A P A' + Q
            ppv, ppa, pva = pv + dt * vv + half * va, pa + dt * va + half * aa, va + dt * aa
            pp += dt * pv + half * pa + dt * ppv + half * ppa + qpp
            pv = ppv + dt * ppa + qpv
            pa = ppa + qpa
            vv += dt * va + dt * pva + qvv
            va = pva + qva
            aa += alpha
        if measured == measured:  # not NaN
            s = 1.0 / (aa + accel_variance)  # eq. 2.55, 2.68, 2.69 with the H of eq. 2.65
            kp, kv, ka, innovation = pa * s, va * s, aa * s, measured - a
            p, v, a = p + kp * innovation, v + kv * innovation, a + ka * innovation
            pp, pv, vv = pp - kp * pa, pv - kp * va, vv - kv * va
            pa, va, aa = pa - kp * aa, va - kv * aa, aa - ka * aa
        while fix is not None and fix[0] <= k:
            _, delay, measured, variance = fix
            s = 1.0 / (pp + variance)  # the further rows of eq. 2.62; eq. 2.66 connects them with none of eq. 2.65
            # The fix is of an instant up to half a step away, where the position differs by velocity times that.
            kp, kv, ka, innovation = pp * s, pv * s, pa * s, measured - p - delay * v
            p, v, a = p + kp * innovation, v + kv * innovation, a + ka * innovation
            vv, va, aa = vv - kv * pv, va - kv * pa, aa - ka * pa
            pp, pv, pa = pp - kp * pp, pv - kp * pv, pa - kp * pa
            fix = next(fixes, None)
        yield p, v, a, pp, vv


COMPARED = 2.0  # s over which velocity changes are compared: about the length of a corner
UNREPORTED = 2.5  # m, sigma of the fixes of a receiver that reports none
LEAST_FIX_SIGMA = 0.2  # m; receivers that scatter less do so by filtering
FEWEST_STEPS_AT_REST = 50  # for a variance good to a fifth


def fix_variance(fixes: GnssFixes, position: Array) -> Array:
    """Variance (M,) m^2 per axis of each fix, of positions (M, 2) m.

    The scatter of neighbouring fixes about a straight line, at most what the receiver reports (UNREPORTED if nothing),
    because slow fixes bend with the path. Reports also say which fixes are worse than the usual.
    """
    reported = fixes.sigma_horizontal
    assert reported is not None
    known = np.isfinite(reported) & (reported > 0.0)
    usual = float(np.median(reported[known])) if np.any(known) else UNREPORTED
    sigma = max(min(_scatter(fixes.t, position), usual), LEAST_FIX_SIGMA)
    relative = np.where(known, np.maximum(np.where(known, reported, usual) / usual, 1.0), 1.0)
    return np.asarray((sigma * relative) ** 2)


def _scatter(t: Array, position: Array) -> float:
    """Sigma (m) per axis from bends between three fixes equally far apart; jumps are included."""
    step = np.diff(t)
    if step.size < 2:
        return float("inf")
    regular = np.abs(step - np.median(step)) < 0.2 * np.median(step)
    bend = (position[1:-1] - 0.5 * (position[:-2] + position[2:]))[regular[1:] & regular[:-1]]
    return float(np.sqrt(np.mean(bend**2) / 1.5)) if bend.size else float("inf")


def accel_covariance_in_motion(t: Array, acceleration: Array, course: Course, period: float) -> Array | None:
    """Covariance (2, 2) per step of `period` s that is equivalent to the error in motion; None with too few fixes.

    acceleration (N, 2) m/s^2 at t (N,) s, north and west. Spans in motion count, or all if there are too few.
    """
    fix_t, own, fixes = velocities_at_fixes(t, acceleration, course)
    later = np.searchsorted(fix_t, fix_t + COMPARED - 1e-6)
    first = np.flatnonzero(later < fix_t.size)
    first = first[fix_t[later[first]] - fix_t[first] < 1.5 * COMPARED]  # not across an outage
    moving = first[np.hypot(fixes[first, 0], fixes[first, 1]) > MOVING]
    first = moving if moving.size >= FEWEST else first
    if first.size < FEWEST:
        return None
    error = own - fixes
    change = error[later[first]] - error[first]
    duration = float(np.mean(fix_t[later[first]] - fix_t[first]))
    return np.asarray(change.T @ change / first.size / (duration * period))


def accel_covariance_at_rest(acceleration: Array, is_at_rest: BoolArray) -> Array | None:
    """Covariance (2, 2) of the accelerations (N, 2) m/s^2 of the steps at rest (N,): eq. 2.67; None with too few."""
    if np.count_nonzero(is_at_rest) < FEWEST_STEPS_AT_REST:
        return None
    return np.cov(acceleration[is_at_rest], rowvar=False)
