"""Drives not of the simulator's making: a road car's over hills, with vibration that grows with speed and a body that
rocks, laps of a track that is not level across, and of an oval over hills.
"""

from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.fit.running import gaussian_mean
from smoother.frames import GRAVITY_N, Origin, nwu_to_geodetic, rotation_from_euler
from smoother.prepare import prepare
from smoother.samples import GnssFixes, RawImu, RawSession, Session
from smoother.units import STANDARD_GRAVITY

RATE, LASTS, LATENCY = 200.0, 400.0, 0.1  # Hz, s, s
FORCE_NOISE = 0.5  # m/s^2, of each sample of a kart


@dataclass(frozen=True, eq=False)
class Road:
    """The session, and the true velocity (N, 3) m/s in n of the antenna at t (N,) s."""

    session: Session
    t: Array
    velocity_n: Array


@dataclass(frozen=True, eq=False)
class Track:
    """The session, and the true roll (N,) rad of the kart at t (N,) s."""

    session: Session
    t: Array
    roll: Array


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
    session = _recorded(rng, t, force, turn, np.cumsum(velocity, axis=0) / RATE + above, at_antenna)
    return Road(session, t, at_antenna)


def unlevel_track(fall: float, varies: float) -> Track:
    """Laps of 40 s, with bends to both sides, of a kart that leans as its tyres do, by a degree per g.

    fall, rad, by which the track lies lower to the right of the kart, on average over a lap; varies, rad rms, by which
    it does so more here and less there. The box is at the antenna, and askew by some degrees.
    """
    rng = np.random.default_rng(6)
    t = np.arange(0.0, LASTS, 1.0 / RATE)
    phase = 2.0 * np.pi * (t / 40.0 + 0.01 * np.sin(2.0 * np.pi * t / 73.0))  # no lap is as fast as the one before
    position = np.stack([90.0 * np.cos(phase), 45.0 * np.sin(phase), np.zeros_like(t)], axis=1)
    position[:, :2] += np.stack([20.0 * np.sin(3.0 * phase), 20.0 * np.cos(3.0 * phase)], axis=1)
    fall = fall + varies * (np.sin(2.0 * phase + 1.0) + np.sin(5.0 * phase))
    return _driven(rng, t, position, fall)


def hilly_oval(hills: float, height: float) -> Track:
    """Laps of 14 s at nearly one speed around an ellipse, all to the left, over several hills of some `hills` m a lap.

    height, m, of the antenna above the box, which nobody states. The track is level across.
    """
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 0.4 * LASTS, 1.0 / RATE)
    angle = np.linspace(0.0, 2.0 * np.pi, 2001)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(34.0 * np.diff(np.cos(angle)), 26.0 * np.diff(np.sin(angle))))])
    way = 13.0 * (t + 0.2 * np.sin(2.0 * np.pi * t / 31.0))  # nearly one speed
    lap = np.floor(way / length[-1])
    phase = np.interp(way - lap * length[-1], length, angle) + 2.0 * np.pi * lap
    turns = 2.0 * np.pi * way / length[-1]
    up = np.zeros_like(t)
    for waves, share, begin in ((2, 1.0, 1.4), (3, 1.4, 2.2), (4, 0.6, -2.3), (5, 0.9, -1.5)):
        up += hills * share * np.cos(waves * turns + begin)
    position = np.stack([34.0 * np.cos(phase), 26.0 * np.sin(phase), up], axis=1)
    return _driven(rng, t, gaussian_mean(position, 0.06 * RATE), np.zeros_like(t), height)


def _driven(rng: np.random.Generator, t: Array, position: Array, ground: Array, height: float = 0.0) -> Track:
    """Track of a kart whose box, askew by some degrees, is at position (N, 3) m in n at t (N,) s.

    ground (N,) rad, by which it falls to the right; the kart leans by a degree per g beside. height, m, of the antenna.
    """
    velocity = np.gradient(position, t, axis=0)
    acceleration = np.gradient(velocity, t, axis=0)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    to_left = (velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]) / speed
    roll, pitch = ground + 0.0018 * to_left, -np.arctan2(velocity[:, 2], speed)
    R_nb = rotation_from_euler(roll, pitch, np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0])))
    force = np.einsum("nji,nj->ni", R_nb, acceleration - GRAVITY_N)
    turn = so3.log(R_nb[:-1].transpose(0, 2, 1) @ R_nb[1:]) * RATE
    R_bs = so3.exp(np.array([0.05, -0.03, 0.1]))
    force_s = (force + FORCE_NOISE * rng.standard_normal(force.shape)) @ R_bs
    antenna = position + height * R_nb[:, :, 2]
    velocity = np.gradient(antenna, t, axis=0)
    return Track(_recorded(rng, t, force_s, np.vstack([turn, turn[-1:]]) @ R_bs, antenna, velocity), t, roll)


def _recorded(
    rng: np.random.Generator, t: Array, force: Array, turn: Array, antenna_n: Array, velocity_n: Array
) -> Session:
    """Session of force (N, 3) m/s^2 and turn (N, 3) rad/s in s, and of fixes at 10 Hz of where the antenna is."""
    at = slice(0, None, int(RATE) // 10)
    fixes = antenna_n[at] + 0.3 * rng.standard_normal((t[at].size, 3))
    lat_deg, lon_deg, alt_m = nwu_to_geodetic(fixes, Origin(45.0, 12.0, 0.0))
    sent = velocity_n[at] + 0.05 * rng.standard_normal((t[at].size, 3))
    gnss = GnssFixes(t[at] + LATENCY, lat_deg, lon_deg, alt_m, sent)
    noisy = turn + 2e-3 * rng.standard_normal((t.size, 3))
    return prepare(RawSession("road", gnss, RawImu(t, force, noisy)))
