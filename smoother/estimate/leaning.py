"""Vehicles that lean into corners, as two wheels do: the model of all else is a kart's, whose floor stays level."""

import numpy as np

from smoother.arrays import Array, median
from smoother.frames import euler_from_rotation, to_left
from smoother.samples import Problem
from smoother.trajectory import Trajectory
from smoother.units import DEG, STANDARD_GRAVITY

LEANS = "vehicle_leans"  # code of the problem that says so
# roll in parts of the angle at which nothing pushes sideways, and its rms: motorcycles -0.5 to -0.7 and 25 deg; karts
# and cars lean outwards, by 0.02 to 0.06 of it
LEAST_LEAN, LEAST_ROLL = -0.35, 12.0 * DEG
MIN_SPEED, LEAST_PUSH, FEWEST = 5.0, 2.0, 50  # m/s, m/s^2 and rows, in corners that tell
APART = 0.1  # s from one row that is looked at to the next; in a second a corner is half over


def leaning_problems(trajectory: Trajectory) -> tuple[Problem, ...]:
    """Say so where roll goes with the push to the side as that of two wheels does."""
    roll, push = _roll_and_push(trajectory)
    if len(roll) < FEWEST:
        return ()
    lean = float(np.sum(roll * push) / np.sum(push**2)) * STANDARD_GRAVITY
    usual = float(np.sqrt(np.mean(roll**2)))
    if lean > LEAST_LEAN or usual < LEAST_ROLL:
        return ()
    text = (
        f"it leans into corners by {usual / DEG:.0f} deg, as two wheels do, and is smoothed as a kart is: line, speed "
        "and laps hold; roll may be off by some degrees, delays of the GPS by hundredths of a second, beyond their ±"
    )
    return (Problem(LEANS, text),)


def _roll_and_push(trajectory: Trajectory) -> tuple[Array, Array]:
    """Roll (K,) rad and acceleration to the left of the path (K,) m/s^2, in corners.

    At the keyframes where there are any: rows are as far apart as they were asked for.
    """
    path = trajectory if trajectory.report.keyframes is None else trajectory.report.keyframes
    if len(path.t) < 3:
        return np.empty(0), np.empty(0)
    every = max(1, round(APART / median(np.diff(path.t))))
    t, velocity, R_nb = path.t[::every], path.velocity_n[::every, :2], path.R_nb[::every]
    if len(t) < 3:
        return np.empty(0), np.empty(0)
    speed = np.hypot(*velocity.T)
    change = np.stack([np.gradient(velocity[:, i], t) for i in range(2)], axis=1)
    push = to_left(velocity, change) / np.maximum(speed, 1.0)
    roll = euler_from_rotation(R_nb)[0]
    tells = (speed > MIN_SPEED) & (np.abs(push) > LEAST_PUSH) & np.isfinite(roll)
    return roll[tells], push[tells]
