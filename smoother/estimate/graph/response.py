"""How a receiver answers to a change of velocity, beyond a delay: as a low-pass, a mean, or between both.

What the constants velocity_response and evenness of a session mean (:class:`smoother.estimate.graph.state.Constants`).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array
from smoother.estimate.graph.arm import arm_axes_along
from smoother.estimate.graph.expected import ExpectedMotion, Motion
from smoother.estimate.graph.imu import DensePath, at_times
from smoother.estimate.graph.state import Constants

# s^2: a response below the first is as much noise as not, above the second a receiver's low-pass (tau of 0.09 s)
LOW_PASS = (1e-3, 4e-3)
PARTS = 2000  # of a spectrum; velocities that tell little are told by its first hundredth
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

    def even(values: Array) -> Array:
        return at_times(path, _level(evened(values, dt, tau)), t)

    antenna_n, jerk_n = _antenna_velocity(path, motion, session), _jerk(felt.slow, dt)
    filtered, by_filter, by_evenness = late(antenna_n), late(jerk_n, 2), simple.by_evenness_n
    if not session.is_steered:
        filtered = filtered + evenness * (even(antenna_n) - filtered)
        by_filter = by_filter + evenness * (even(jerk_n) - by_filter)
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


@dataclass(frozen=True, eq=False)
class PassedNoise:
    """What a receiver's filter leaves of the noise in its velocities.

    power (N,): share of its power, in N equal parts of the spectrum from nothing to half of the velocities' rate; of
    what is slow all. several: velocities, an odd number, that it goes on for.
    """

    power: Array
    several: int

    @property
    def angle(self) -> Array:
        """Middles (N,) of the parts, rad from one velocity to the next."""
        return np.asarray(np.pi * (np.arange(len(self.power)) + 0.5) / len(self.power))

    def of_means(self) -> Array:
        """Share (N,) of a power that running means of `several` leave."""
        return left_of_mean(self.several, self.angle)


def passed_noise(session: Constants, unsure: tuple[float, float], every: float) -> PassedNoise | None:
    """What the filter of a receiver leaves of the noise in velocities `every` s apart; None where it shows no filter.

    unsure: sigmas of response, s^2, and of evenness. Of the least response within its sigma, and of an evenness within
    its own of what filters have: where a filter is in doubt, velocities seem to be worth little, and hold neither
    response nor delay. Means of less than two velocities pass the noise. Of a box on the wheel the response is not the
    receiver's alone.
    v_i = v_(i-1) + a (x_i - v_(i-1)) with that response leaves 1 / (1 + 8 response / every^2 sin^2(angle / 2)); a mean
    of n velocities has a response of (n^2 - 1) / 24 every^2.
    """
    response, evenness = session.velocity_response - unsure[0], min(max(session.evenness, 0.0), 1.0)
    squared = low_pass_share(response)[0] * response / every**2
    n = math.sqrt(1.0 + 24.0 * max(squared, 0.0))
    if session.is_steered or n < 2.0 or abs(session.evenness - evenness) > unsure[1]:
        return None
    found = PassedNoise(np.ones(PARTS), 1 + 2 * round(0.5 * (n - 1.0)))
    late = 1.0 / (1.0 + 8.0 * squared * np.sin(0.5 * found.angle) ** 2)
    return replace(found, power=late + evenness * (left_of_mean(n, found.angle) - late))


def left_of_mean(n: float, angle: Array) -> Array:
    """Share (N,) of a power at angle (N,), rad from one value to the next, that means of n values leave."""
    return np.asarray((np.sin(0.5 * n * angle) / (n * np.sin(0.5 * angle))) ** 2)


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
    """Values (M, c), dt s apart and straight lines in between, after a mean over as much before as after.

    Of a length with the response of a low-pass of time constant tau; what is at the ends goes on beyond them.
    """
    half = math.sqrt(3.0) * tau
    beyond = int(half / dt) + 2
    padded = np.pad(values, ((beyond, beyond), (0, 0)), mode="edge")
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(0.5 * dt * (padded[1:] + padded[:-1]), axis=0)])
    steps, part = int(half / dt), half - dt * int(half / dt)

    def integral(at: int, sign: float) -> Array:
        """From the beginning to `part` s after (sign 1) or before (-1) the edges from `at` on."""
        here, beside = padded[at : at + len(values)], padded[at + int(sign) : at + int(sign) + len(values)]
        return total[at : at + len(values)] + sign * part * (here + 0.5 * part / dt * (beside - here))

    after, before = integral(beyond + steps, 1.0), integral(beyond - steps, -1.0)
    return np.asarray((after - before) / (2.0 * half))
