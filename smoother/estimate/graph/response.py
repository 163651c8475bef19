"""How a receiver answers to a change of velocity, beyond a delay: as a low-pass, a mean, or between both.

What the constants velocity_response and evenness of a session mean (:class:`smoother.estimate.graph.state.Constants`).
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.estimate.graph.arm import arm_axes_along
from smoother.estimate.graph.expected import ExpectedMotion, Motion
from smoother.estimate.graph.imu import DensePath, at_times
from smoother.estimate.graph.state import Constants

# s^2: a response below the first is as much noise as not, above the second a receiver's low-pass (tau of 0.09 s)
LOW_PASS = (1e-3, 4e-3)
FORGOTTEN = 1e-9  # share of a value that is left


@dataclass(frozen=True, eq=False)
class Response:
    """What a receiver shows of a velocity beyond a delay, m/s in n (N, 3), and its slopes by its constants.

    slope_n (N, 3) by velocity_response, by_evenness_n (N, 3).
    """

    beyond_n: Array
    slope_n: Array
    by_evenness_n: Array


def response_of(path: DensePath, felt: ExpectedMotion, session: Constants, t: Array) -> Response:
    """Response at t (N,) s to the motion that the antenna is expected to have had, without up.

    The second derivative, of what is slow enough for keyframes and for that; of a response beyond its own noise it is
    that of a low-pass of first order, late by its time constant tau, or of a mean to both sides of its delay, or
    between both: tau^2 / 2 is left beyond that delay in slow motion, less in quick. Of the same motion: of vibration
    that samples fold, which no receiver shows, a low-pass would be denied as soon as the second derivative, of slow
    motion, has told it, and neither would stay.

    Slopes by a filter are of slow motion, as those by latencies are: two filters with the same response differ in quick
    motion, and the response is to be that of the slow motion that tells the delay.
    Of a box on the wheel the antenna goes beside where the arm has it, by the slip: with the acceleration, as behind a
    filter. There the shape is that of the low-pass.
    """
    dt, response, motion = float(path.t[1] - path.t[0]), session.velocity_response, felt.answered
    slope = at_times(path, _level(_jerk(motion, dt)), t)
    simple = Response(response * slope, slope, np.zeros_like(slope))
    share, rise = low_pass_share(response)
    if share == 0.0:
        return simple
    tau, evenness = math.sqrt(2.0 * response), session.evenness

    def late(values: Array, times: int = 1) -> Array:
        for _ in range(times):
            values = low_passed(values, dt, tau)
        return at_times(path, _level(values), t + tau)

    def even(values: Array, times: int = 1) -> Array:
        for _ in range(times):
            values = evened(values, dt, tau)
        return at_times(path, _level(values), t)

    antenna_n, jerk_n = _antenna_velocity(path, motion, session), _jerk(felt.slow, dt)
    filtered, by_filter, by_evenness = late(antenna_n), late(jerk_n, 2), simple.by_evenness_n
    if not session.is_steered:
        filtered = filtered + evenness * (even(antenna_n) - filtered)
        by_filter = by_filter + evenness * (even(jerk_n, 2) - by_filter)
        slow_n = _antenna_velocity(path, felt.slow, session)
        by_evenness = share * (even(slow_n) - late(slow_n))
    shown = filtered - at_times(path, _level(antenna_n), t)
    return Response(
        simple.beyond_n + share * (shown - simple.beyond_n),
        slope + share * (by_filter - slope) + rise * (shown - simple.beyond_n),
        by_evenness,
    )


def low_pass_share(response: float) -> tuple[float, float]:
    """Share, 0 to 1, in which a response, s^2, is a filter's and no noise, and the slope of that by the response."""
    u = min(max((response - LOW_PASS[0]) / (LOW_PASS[1] - LOW_PASS[0]), 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u) / (LOW_PASS[1] - LOW_PASS[0])


def _jerk(motion: Motion, dt: float) -> Array:
    """Second derivative of the level velocity (M, 2), m/s^3 in n."""
    return np.asarray(np.gradient(motion.acceleration_n[:, :2], dt, axis=0))


def _antenna_velocity(path: DensePath, motion: Motion, session: Constants) -> Array:
    """Level velocity (M, 2) of the antenna, m/s in n."""
    arm_n = arm_axes_along(path, session)[:, :2] @ session.lever_arm_s
    swing_n = motion.turn_rate[:, None] * np.column_stack([-arm_n[:, 1], arm_n[:, 0]])
    return np.asarray(motion.velocity_n[:, :2] + swing_n)


def _level(values: Array) -> Array:
    return np.column_stack([values, np.zeros(len(values))])


def low_passed(values: Array, dt: float, tau: float) -> Array:
    """Values (M, c), dt s apart and straight lines in between, after a low-pass of first order that began at rest.

    What is left of a value after k steps is the k-th power of what is left after one. Sums of two, four, eight .. of
    them are made from one another. (SciPy's lfilter would take half a second to import.)
    """
    left = math.exp(-dt / tau)
    gone = tau / dt * (1.0 - left)
    passed = values.copy()
    passed[1:] = (1.0 - gone) * values[1:] + (gone - left) * values[:-1]
    steps = 1
    while steps < len(values) and (share := left**steps) > FORGOTTEN:
        passed[steps:] = passed[steps:] + share * passed[:-steps]
        steps *= 2
    return passed


def evened(values: Array, dt: float, tau: float) -> Array:
    """Values (M, c) after a mean over as much before as after, with the response of a low-pass of time constant tau.

    A low-pass and the same one backwards, each with half of the square of tau: no delay is left.
    """
    each = tau / math.sqrt(2.0)
    return low_passed(low_passed(values, dt, each)[::-1], dt, each)[::-1]
