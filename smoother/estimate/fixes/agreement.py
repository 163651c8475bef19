"""Whether the velocities of fixes agree with the positions that they come with, by less than a single fix shows.

A magnetic course, the speed of a wheel, a course that was made of degrees as if these were metres: each velocity agrees
with its neighbours, but over a lap their integral leaves the positions. Steps of some seconds by both are compared over
the whole session. What neither the wander of the fixes nor the delay, the filter or the bias
of the velocities explains is a factor of the speeds, a turn of the courses, or an error of the courses that goes with
their direction, as a Fourier series of two terms has it.

A turn and a factor are undone. Courses that err by their direction are not used, whatever made them so: what is left of
such a velocity is its speed, which is a measurement of its own.

Errors of positions that belong to a place, as beside a wall that reflects, come again every lap and look like either,
and those that last for seconds are in several steps. The sigmas count both once.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from smoother.arrays import Array, IntArray, median
from smoother.estimate.fixes.screen import MEDIAN_TO_SIGMA, has_velocities, unbroken_runs
from smoother.fit.spline import CubicSpline
from smoother.samples import Problem, Session
from smoother.units import DEG

# problem codes
TURNED, SCALED, WRONG = "gps_velocity_turned", "gps_velocity_scaled", "gps_course_wrong"
SIGMAS = 5.0
# and as much as counts: at 17 m/s 0.05 m/s, which is a sigma of smoothed velocities; recorded receivers stay below
LEAST_SHARE, LEAST_TURN = 0.003, 0.2 * DEG
STEP, AVERAGED = 2.0, 1.0  # s from one place to the next, and of the fixes that are averaged for each
SLOWEST_FIXES = 1.1  # s between fixes; at longer intervals a kart takes a whole bend
MOVING = 3.0  # m/s; at rest receivers hold their place, and would seem to wander less than they do
PLACE = 25.0  # m, as far as a wall spoils positions
FEWEST_STEPS, FEWEST_PLACES = 30, 10
LASTING = 6  # steps within which an error of positions is another
LOSES_WEIGHT = 3.0  # usual sizes from which on a step counts less: a jump
ROUNDS = 5  # of weights, noise, and what is not linear in lag and turn
# sigmas of the lag of velocities, s, of the square of their filter, s^2 (a mean over 0.8 s has 0.027; a receiver once a
# second had 0.15), and of their bias, m/s
LAG_SIGMA, FILTER_SIGMA, BIAS_SIGMA = 0.3, 0.1, 0.05
FARTHEST = 0.5  # of lag, s, of a turn, rad, and of the logarithm of the factor: beyond, other things are wrong
ORDERS = (1.0, 2.0)  # of the Fourier series: iron beside a compass, and scales of the two axes

FACTOR, TURN = 0, 1
BY_DIRECTION = slice(2, 6)  # cosine and sine of each order, rad
LAG, FILTER, BIAS_NORTH, BIAS_WEST = 6, 7, 8, 9
N_FOUND, N_UNKNOWN = 6, 10
_PRIOR = np.array([FARTHEST] * N_FOUND + [LAG_SIGMA, FILTER_SIGMA, BIAS_SIGMA, BIAS_SIGMA]) ** -2.0
_LEAST = np.array([LEAST_SHARE] + [LEAST_TURN] * 5)


@dataclass(frozen=True, eq=False)
class Disagreement:
    """What makes the velocities of a session agree with its positions.

    value (6,): logarithm of the factor of the speeds, turn of the courses, rad, anticlockwise, and the coefficients of
    what they are wrong by with their direction. Zero where nothing is wrong. sigma (6,).
    """

    value: Array
    sigma: Array

    @property
    def is_found(self) -> bool:
        """Whether anything is to be undone."""
        return bool(np.any(self.value))

    @property
    def is_course_wrong(self) -> bool:
        """Whether the courses err by their direction, so that none is used."""
        return bool(np.any(self.value[BY_DIRECTION]))


NOTHING = Disagreement(np.zeros(N_FOUND), np.full(N_FOUND, np.inf))


def disagreement(session: Session) -> Disagreement:
    """Find how the velocities of the fixes are turned and scaled against their positions, if steps are enough."""
    steps = _steps_of(session)
    if steps is None:
        return NOTHING
    value, covariance = _compared(steps)
    return _significant(value, covariance) if np.all(np.abs(value) < FARTHEST) else NOTHING


def in_agreement(session: Session, found: Disagreement) -> Session:
    """Return the session with the velocities of its fixes turned and scaled to their positions."""
    if not found.is_found:
        return session
    sent, speed = session.gnss.velocity_n, session.gnss.speed
    size = math.exp(found.value[FACTOR])
    velocity_n = np.column_stack([_turned(sent[:, :2], found.value[TURN]) * size, sent[:, 2]])
    if found.is_course_wrong:
        speed = np.where(has_velocities(sent), size * np.hypot(sent[:, 0], sent[:, 1]), np.nan)
        velocity_n[:, :2] = np.nan
    return replace(session, gnss=replace(session.gnss, velocity_n=velocity_n, speed=speed))


def disagreement_problems(found: Disagreement) -> tuple[Problem, ...]:
    """Say what was turned and scaled, and by how much."""
    problems = []
    if found.is_course_wrong:
        by = math.hypot(*found.value[BY_DIRECTION]) / DEG
        text = (
            f"the courses of the fixes are wrong by up to {by:.1f} deg, by their direction, as of a compass near iron "
            "or made of degrees without the cosine of the latitude; the speeds are used alone"
        )
        problems.append(Problem(WRONG, text))
    elif found.value[TURN]:
        side, size, sigma = "right" if found.value[TURN] > 0.0 else "left", *np.abs([found.value, found.sigma])[:, TURN]
        text = (
            f"the velocities of the fixes point {size / DEG:.2f} ± {sigma / DEG:.2f} deg to the {side} of the way "
            "their positions go; turned back. Record the true course, not a magnetic one or one of a grid"
        )
        problems.append(Problem(TURNED, text))
    if found.value[FACTOR]:
        text = (
            f"the speeds of the fixes are {_percent(found.value[FACTOR])} (± {100.0 * found.sigma[FACTOR]:.2f} %) than "
            "their positions go; scaled to them. Record the receiver's own speed, not a wheel's, and true seconds"
        )
        problems.append(Problem(SCALED, text))
    return tuple(problems)


def _percent(factor: float) -> str:
    """By how much velocities are faster or slower that a factor, of which this is the logarithm, makes right."""
    share = 100.0 * math.expm1(-factor)
    return f"{abs(share):.2f} % {'faster' if share > 0.0 else 'slower'}"


def _turned(level: Array, angle: Array | float) -> Array:
    """Vectors `level` (N, 2) turned anticlockwise by an angle, rad, or one for each (N,)."""
    cos, sin = np.cos(angle), np.sin(angle)
    north, west = level.T
    return np.stack([cos * north - sin * west, sin * north + cos * west], axis=1)


def _harmonics(way: Array) -> Array:
    """Cosines and sines (S, 4) of the direction of ways (S, 2), of each order."""
    direction = np.arctan2(way[:, 1], way[:, 0])
    return np.stack([f(order * direction) for order in ORDERS for f in (np.cos, np.sin)], axis=1)


@dataclass(frozen=True, eq=False)
class _Steps:
    """S steps between places at speed: by how much positions, the way by the velocities, velocities and accelerations
    change in each, (S, 2); how long it lasts, (S,) s; where it is, (S, 2) m.
    """

    position: Array
    way: Array
    velocity: Array
    acceleration: Array
    lasts: Array
    middle: Array

    @cached_property
    def place(self) -> IntArray:
        """Number (S,) of the place of each step."""
        cells = np.floor(self.middle / PLACE).astype(np.int64)
        _, number = np.unique(cells[:, 0] * (1 << 32) + cells[:, 1], return_inverse=True)
        return np.asarray(number, dtype=np.int64)


def _steps_of(session: Session) -> _Steps | None:
    """Steps of a session, None where they are too few, or in too few places."""
    t, position_n, velocity_n = session.gnss.t, session.fix_position_n[:, :2], session.gnss.velocity_n[:, :2]
    known = np.flatnonzero(has_velocities(position_n) & has_velocities(velocity_n))
    runs = [rows for rows in unbroken_runs(t, known) if t[rows[-1]] - t[rows[0]] > 2.0 * STEP]
    parts = [
        _steps(t[rows], position_n[rows], velocity_n[rows]) for rows in runs if median(np.diff(t[rows])) < SLOWEST_FIXES
    ]
    if not parts:
        return None
    steps = _Steps(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    is_enough = len(steps.lasts) >= FEWEST_STEPS and steps.place.max() + 1 >= FEWEST_PLACES
    return steps if is_enough else None


def _steps(t: Array, position: Array, velocity: Array) -> tuple[Array, ...]:
    """Columns of the steps of fixes at t (M,) s without a gap; position, velocity (M, 2)."""
    # straight lines between velocities would be shorter than a bend, by 0.3 % where a kart turns by 0.2 rad from one to
    # the next
    spline = CubicSpline(t, velocity)
    columns = np.column_stack([t, position, spline.integral(), velocity, spline.with_slope(t)[1]])
    first = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], AVERAGED)))
    averaged = np.add.reduceat(columns, first) / np.diff(np.append(first, len(t)))[:, None]
    at = averaged[np.unique(np.searchsorted(averaged[:, 0], np.arange(averaged[0, 0], averaged[-1, 0], STEP)))]
    steps, middle = np.diff(at, axis=0), 0.5 * (at[1:, 1:3] + at[:-1, 1:3])
    lasts = steps[:, 0]
    usable = (lasts < 2.0 * STEP) & (np.hypot(steps[:, 3], steps[:, 4]) > MOVING * lasts)
    steps = steps[usable]
    return (*(steps[:, k : k + 2] for k in (1, 3, 5, 7)), steps[:, 0], middle[usable])


def _compared(steps: _Steps) -> tuple[Array, Array]:
    """What is unknown (10,) by least squares, and covariance (6, 6) of what is to be found."""
    count = len(steps.lasts)
    x, weight, variance = np.zeros(N_UNKNOWN), np.ones(count), 1.0
    for _ in range(ROUNDS):
        left, design = _linearised(steps, x)
        weighted = design * weight[:, None, None]
        covariance = np.linalg.inv(np.einsum("sai,saj->ij", weighted, design) / variance + np.diag(_PRIOR))
        change = covariance @ (np.einsum("sai,sa->i", weighted, left) / variance - _PRIOR * x)
        x = np.clip(x + change, -FARTHEST, FARTHEST)
        left = left - design @ change
        size = np.hypot(left[:, 0], left[:, 1])
        weight = np.minimum(1.0, (LOSES_WEIGHT * MEDIAN_TO_SIGMA * median(size) / np.maximum(size, 1e-9)) ** 2)
        variance = float(np.sum(weight * size**2) / max(2.0 * np.sum(weight) - N_UNKNOWN, 1.0)) + 1e-8
    score = np.einsum("sai,sa,s->si", design, left, weight) / variance
    robust = [covariance @ together @ covariance for together in (_of_places(score, steps.place), _lasting(score))]
    wider = np.sqrt(np.max([np.diag(other) / np.diag(covariance) for other in robust], axis=0))
    covariance = covariance * np.outer(*[np.maximum(wider, 1.0)] * 2)
    return x, covariance[:N_FOUND, :N_FOUND]


def _linearised(steps: _Steps, x: Array) -> tuple[Array, Array]:
    """What positions change by (S, 2) m beyond what the unknowns x (10,) explain, and its derivatives (S, 2, 10)."""
    harmonics = _harmonics(steps.way)
    angle = x[TURN] + harmonics @ x[BY_DIRECTION]
    way, velocity, acceleration = (
        math.exp(x[FACTOR]) * _turned(v, angle) for v in (steps.way, steps.velocity, steps.acceleration)
    )
    bias, lag = x[BIAS_NORTH:], x[LAG]
    explained = way + lag * velocity + (0.5 * lag**2 + x[FILTER]) * acceleration + bias * steps.lasts[:, None]
    design = np.zeros((*way.shape, N_UNKNOWN))
    design[:, :, FACTOR] = way
    design[:, 0, TURN], design[:, 1, TURN] = -way[:, 1], way[:, 0]
    design[:, :, BY_DIRECTION] = design[:, :, TURN, None] * harmonics[:, None]
    design[:, :, LAG] = velocity + lag * acceleration
    design[:, :, FILTER] = acceleration
    design[:, 0, BIAS_NORTH] = design[:, 1, BIAS_WEST] = steps.lasts
    return steps.position - explained, design


def _of_places(score: Array, place: IntArray) -> Array:
    """Information (10, 10) of scores (S, 10); those of one place (S,) are one. Source: Liang and Zeger 1986."""
    count = int(place.max()) + 1
    of_each = np.stack([np.bincount(place, column, count) for column in score.T])
    return np.asarray(of_each @ of_each.T * count / max(count - N_UNKNOWN, 1))


def _lasting(score: Array) -> Array:
    """Information (10, 10) of scores (S, 10) that last for some steps. Source: Newey and West 1987."""
    total = score.T @ score
    for k in range(1, LASTING):
        together = score[k:].T @ score[:-k]
        total += (1.0 - k / LASTING) * (together + together.T)
    return np.asarray(total)


def _significant(value: Array, covariance: Array) -> Disagreement:
    """What of the value (6,) is beyond doubt, and counts; found anew with the rest, as if it were none, left out."""
    value, kept = value[:N_FOUND].copy(), np.ones(N_FOUND, dtype=np.bool_)
    covariance = covariance.copy()
    for _ in range(N_FOUND):
        sigma = np.sqrt(np.diag(covariance))
        beyond = np.minimum(np.abs(value) / (SIGMAS * np.maximum(sigma, 1e-12)), np.abs(value) / _LEAST)
        beyond[~kept] = np.inf
        least = int(np.argmin(beyond))
        if beyond[least] >= 1.0:
            break
        kept[least] = False
        gain = covariance[:, least] / covariance[least, least]
        value = np.where(kept, value - gain * value[least], 0.0)
        covariance = covariance - np.outer(gain, covariance[least])
    return Disagreement(value, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
