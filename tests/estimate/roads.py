"""A road car's drive not of the simulator's making: hills, vibration that grows with speed, a body that rocks."""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.frames import Origin, nwu_to_geodetic
from smoother.prepare import prepare
from smoother.samples import GnssFixes, RawImu, RawSession, Session
from smoother.units import STANDARD_GRAVITY

RATE, LASTS, LATENCY = 200.0, 400.0, 0.1  # Hz, s, s


@dataclass(frozen=True, eq=False)
class Road:
    """The session, and the true velocity (N, 3) m/s in n of the antenna at t (N,) s."""

    session: Session
    t: Array
    velocity_n: Array


def country_road(slope: float = 0.0, vibration: float = 0.0, rocking: float = 0.0, height: float = 0.0) -> Road:
    """Bends at nearly one speed, fixes at 10 Hz: in every 40 s 8 s up or down a slope.

    vibration, m/s^2 rms, where it goes fast; rocking, rad, about the left axis at 1.3 Hz, now more, now less; height,
    m, of the antenna above the box.
    """
    rng = np.random.default_rng(5)
    t = np.arange(0.0, LASTS, 1.0 / RATE)
    none = np.zeros_like(t)
    speed = 14.0 + 3.0 * np.sin(2.0 * np.pi * t / 80.0)
    yaw = 1.5 * np.sin(2.0 * np.pi * t / 31.0) + 0.4 * np.sin(2.0 * np.pi * t / 7.3)
    ramp = np.clip(2.5 * np.cos(2.0 * np.pi * (t % 40.0 - 20.0) / 20.0) - 1.0, 0.0, 1.0)
    climb = slope * ramp * (np.abs(t % 40.0 - 20.0) < 10.0) * np.where(t % 80.0 < 40.0, 1.0, -1.0)
    tilt = climb + rocking * np.sin(2.0 * np.pi * 1.3 * t) * np.sin(2.0 * np.pi * t / 17.0)  # nose up
    accel = np.stack([np.gradient(speed, t), speed * np.gradient(yaw, t)], axis=1)
    force = np.stack(
        [
            accel[:, 0] * np.cos(tilt) + STANDARD_GRAVITY * np.sin(tilt),
            accel[:, 1],
            STANDARD_GRAVITY * np.cos(tilt) - accel[:, 0] * np.sin(tilt),
        ],
        axis=1,
    )
    force += (0.1 + vibration * np.clip((speed - 14.0) / 2.0, 0.0, 1.0))[:, None] * rng.standard_normal((t.size, 3))
    turn_up, turn_left = np.gradient(yaw, t), -np.gradient(tilt, t)
    turn = np.stack([turn_up * np.sin(tilt), turn_left, turn_up * np.cos(tilt)], axis=1)
    ahead = np.stack([np.cos(yaw), np.sin(yaw), none], axis=1)
    velocity = speed[:, None] * ahead + np.stack([none, none, speed * np.tan(climb)], axis=1)
    at_antenna = velocity + height * turn_left[:, None] * ahead
    above = height * (np.sin(-tilt)[:, None] * ahead + np.cos(tilt)[:, None] * np.array([0.0, 0.0, 1.0]))
    at = slice(0, None, int(RATE) // 10)
    fixes = (np.cumsum(velocity, axis=0) / RATE + above)[at] + 0.3 * rng.standard_normal((t[at].size, 3))
    lat_deg, lon_deg, alt_m = nwu_to_geodetic(fixes, Origin(45.0, 12.0, 0.0))
    sent = at_antenna[at] + 0.05 * rng.standard_normal((t[at].size, 3))
    gnss = GnssFixes(t[at] + LATENCY, lat_deg, lon_deg, alt_m, sent)
    turn += 2e-3 * rng.standard_normal((t.size, 3))
    return Road(prepare(RawSession("road", gnss, RawImu(t, force, turn))), t, at_antenna)
