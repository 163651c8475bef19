"""Kinds of simulated sessions for the ablations: a preset, figures changed, and what befalls samples and fixes."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.fit.running import gaussian_mean
from smoother.frames import nwu_to_geodetic
from smoother.samples import GnssFixes, Session
from smoother.sim.motion import Stop
from smoother.units import DEG

COURSE_LATE = 0.1  # s behind the speed
RARELY = 5.0  # s from fix to fix
CORRECTED_FOR = 30.0  # s that corrections come, and then do not
COASTS, COASTS_EVERY = 3.0, 30.0  # s that a receiver goes straight on, and how often
COLD, FADES = 36.0, 15.0  # m off when the first satellites are found, s in which a third of it is left
COUNTED = 3e-3  # drift of samples that are stamped by counting them: the oscillator of an MPU9250 is good to a per cent
APART = 7.0  # s between two clocks
BUMPS, BUMPS_EVERY = 6.0, 20.0  # s that a box is pushed about, and how often
PUSHED, PUSHED_FOR = 1.0, 0.15  # m/s^2 and s: slower than vibration, quicker than a kart
LASTING = 0.015  # m/s, of velocities at rest
HELD = 0.5  # m/s, below which receivers hold what they show
DECLINATION = 4.0 * DEG  # of a compass, as in the middle of Europe


@dataclass(frozen=True)
class World:
    """What a group of simulated sessions is like."""

    preset: str
    changes: dict[str, Any] = field(default_factory=dict)
    befalls: Callable[[Session, int], Session] | None = None


def _moved(session: Session, offset_n: Array, velocity_n: Array | None = None) -> GnssFixes:
    """Fixes that are `offset_n` (n, 3), m, off, with another velocity (n, 3), m/s, where one is given."""
    lat, lon, alt = nwu_to_geodetic(session.fix_position_n + offset_n, session.origin)
    gnss = replace(session.gnss, lat_deg=lat, lon_deg=lon, alt_m=alt)
    return gnss if velocity_n is None else replace(gnss, velocity_n=velocity_n)


def _times(t: Array, shares: Array, lasts: float) -> BoolArray:
    """Which of the times `t` (n,) are within `lasts` s after shares (k,) of all of it."""
    return np.asarray(np.any([(t > start) & (t < start + lasts) for start in t[0] + np.ptp(t) * shares], axis=0))


def _poor_sky(session: Session, seed: int) -> Session:
    """Under trees for 12 s three times: fixes ten times as noisy, and the receiver says so."""
    rng, gnss = np.random.default_rng(9000 + seed), session.gnss
    poor = _times(gnss.t, np.array([0.25, 0.5, 0.75]), 12.0)
    noise_n = poor[:, None] * rng.normal(size=(len(gnss.t), 3)) * [2.0, 2.0, 4.0]
    velocity_n = gnss.velocity_n + poor[:, None] * rng.normal(size=(len(gnss.t), 3)) * 1.5
    said = np.where(poor, 10.0, 1.0)
    gnss = replace(
        _moved(session, noise_n, velocity_n),
        sigma_horizontal=0.3 * said,
        sigma_up=0.6 * said,
        sigma_velocity=0.15 * said,
    )
    return replace(session, gnss=gnss)


def _loose_plug(session: Session, seed: int) -> Session:
    """Three times no inertial samples for 3 s."""
    assert session.imu is not None
    t, rng = session.imu.t, np.random.default_rng(9500 + seed)
    kept = ~_times(t, np.array([0.25, 0.5, 0.75]) + rng.uniform(-0.1, 0.1, 3), 3.0)
    force, rate = session.imu.specific_force_s[kept], session.imu.angular_rate_s[kept]
    return replace(session, imu=replace(session.imu, t=t[kept], specific_force_s=force, angular_rate_s=rate))


def _coasts(session: Session, seed: int) -> Session:
    """A receiver that loses its satellites now and then and goes straight on meanwhile."""
    gnss, rng = session.gnss, np.random.default_rng(9700 + seed)
    offset_n, velocity_n = np.zeros((len(gnss), 3)), gnss.velocity_n.copy()
    for start in np.arange(gnss.t[0] + COASTS_EVERY, gnss.t[-1] - COASTS, COASTS_EVERY) + rng.uniform(-5.0, 5.0):
        last = int(np.searchsorted(gnss.t, start))
        lost = np.flatnonzero((gnss.t > gnss.t[last]) & (gnss.t < start + COASTS))  # none in an outage
        gone = (gnss.t[lost] - gnss.t[last])[:, None] * np.nan_to_num(velocity_n[last])  # upwards there is none
        offset_n[lost] = session.fix_position_n[last] + gone - session.fix_position_n[lost]
        velocity_n[lost] = velocity_n[last]
    return replace(session, gnss=_moved(session, offset_n, velocity_n))


def _cold_start(session: Session, seed: int) -> Session:
    """A receiver that has just found its satellites and comes in from somewhere."""
    since, azimuth = session.gnss.t - session.gnss.t[0], np.random.default_rng(9800 + seed).uniform(0.0, 2.0 * np.pi)
    direction_n = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return replace(session, gnss=_moved(session, COLD * np.exp(-since / FADES)[:, None] * direction_n))


def _magnetic(session: Session, _: int) -> Session:
    """A receiver that sends its course from magnetic north."""
    north, west, up = session.gnss.velocity_n.T
    cos, sin = np.cos(DECLINATION), np.sin(DECLINATION)
    velocity_n = np.stack([cos * north + sin * west, cos * west - sin * north, up], axis=1)
    return replace(session, gnss=replace(session.gnss, velocity_n=velocity_n))


def _counted(session: Session, _: int) -> Session:
    """Samples are stamped by counting them, fixes by UTC."""
    return _stamped(session, 1.0 + COUNTED, 0.0)


def _clocks_apart(session: Session, _: int) -> Session:
    """Samples are stamped by a clock that shows another time."""
    return _stamped(session, 1.0, APART)


def _stamped(session: Session, pace: float, apart: float) -> Session:
    assert session.imu is not None
    start = session.imu.t[0]
    imu = replace(session.imu, t=start + (session.imu.t - start) * pace + apart)
    if session.mag is None:
        return replace(session, imu=imu)
    return replace(session, imu=imu, mag=replace(session.mag, t=start + (session.mag.t - start) * pace + apart))


def _bumps(session: Session, seed: int) -> Session:
    """Some seconds in twenty the box is pushed about, too slowly for vibration."""
    assert session.imu is not None
    t, rng = session.imu.t, np.random.default_rng(9900 + seed)
    pushed = gaussian_mean(rng.normal(size=(len(t), 3)), PUSHED_FOR / float(np.median(np.diff(t))))
    pushed *= np.where((t - t[0]) % BUMPS_EVERY > BUMPS_EVERY - BUMPS, PUSHED / np.std(pushed), 0.0)[:, None]
    return replace(session, imu=replace(session.imu, specific_force_s=session.imu.specific_force_s + pushed))


def _lasting(session: Session, seed: int) -> Session:
    """A receiver whose velocities at rest err by what is another in every stand, as those of real ones do."""
    gnss, rng = session.gnss, np.random.default_rng(9950 + seed)
    still = np.hypot(gnss.velocity_n[:, 0], gnss.velocity_n[:, 1]) < HELD
    stand = np.cumsum(still & ~np.roll(still, 1))
    wrong = LASTING * rng.normal(size=(stand[-1] + 1, 3))[stand]
    velocity_n = gnss.velocity_n + np.where(still[:, None], wrong, 0.0)
    return replace(session, gnss=replace(gnss, velocity_n=velocity_n))


def _holds(session: Session, _: int) -> Session:
    """A receiver that shows one place and no speed while the kart stands."""
    gnss = session.gnss
    still = np.hypot(gnss.velocity_n[:, 0], gnss.velocity_n[:, 1]) < HELD
    first = np.maximum.accumulate(np.where(still & ~np.roll(still, 1), np.arange(len(gnss)), 0))
    offset_n = np.where(still[:, None], session.fix_position_n[first] - session.fix_position_n, 0.0)
    return replace(session, gnss=_moved(session, offset_n, np.where(still[:, None], 0.0, gnss.velocity_n)))


def _filtered(session: Session, _: int) -> Session:
    """A receiver that shows the mean of five velocities, two before and two after the moment it stands for."""
    gnss = session.gnss
    level, velocity_n = gnss.velocity_n[:, :2], gnss.velocity_n.copy()
    steady = np.diff(gnss.t) < 1.5 * float(median(np.diff(gnss.t)))
    use = 2 + np.flatnonzero(steady[:-3] & steady[1:-2] & steady[2:-1] & steady[3:])  # none at an outage
    velocity_n[use, :2] = sum(level[use + beside] for beside in range(-2, 3)) / 5.0
    return replace(session, gnss=replace(gnss, velocity_n=velocity_n))


def _late_course(session: Session, _: int) -> Session:
    """A logger that smooths the course and not the speed."""
    gnss = session.gnss
    known = np.isfinite(gnss.velocity_n[:, 0])
    of_speed = np.hypot(*gnss.velocity_n[known, :2].T)
    course = np.unwrap(np.arctan2(gnss.velocity_n[known, 1], gnss.velocity_n[known, 0]))
    late = np.interp(gnss.t[known] - COURSE_LATE, gnss.t[known], course)
    velocity_n = gnss.velocity_n.copy()
    velocity_n[known, :2] = of_speed[:, None] * np.stack([np.cos(late), np.sin(late)], axis=1)
    return replace(session, gnss=replace(gnss, velocity_n=velocity_n))


def _rare(session: Session, _: int) -> Session:
    """A receiver that is asked once in five seconds."""
    every = max(1, round(RARELY / float(median(np.diff(session.gnss.t)))))
    return replace(session, gnss=session.gnss.select(np.arange(0, len(session.gnss), every)))


def _corrected(session: Session, seed: int) -> Session:
    """A receiver that has fixed carrier phases for half a minute, and for half a minute not, and says so."""
    gnss, rng = session.gnss, np.random.default_rng(9960 + seed)
    lost = (gnss.t - gnss.t[0]) % (2.0 * CORRECTED_FOR) > CORRECTED_FOR
    wander_n = np.zeros((len(gnss), 3))
    for k in range(1, len(gnss)):
        kept = np.exp(-(gnss.t[k] - gnss.t[k - 1]) / 60.0) if lost[k - 1] else 0.0
        wander_n[k] = kept * wander_n[k - 1] + np.sqrt(1.0 - kept**2) * rng.normal(size=3) * [1.5, 1.5, 2.5]
    off_n = lost[:, None] * (wander_n + rng.normal(size=(len(gnss), 3)) * [0.2, 0.2, 0.35])
    said = np.where(lost, 1.5, 0.02)
    moved = replace(_moved(session, off_n), sigma_horizontal=said, sigma_up=1.7 * said)
    return replace(session, gnss=moved)


NOISY = {"imu_accel_noise": 0.9, "imu_gyro_noise": 0.04}
QUICK = {"gnss_rate": 25.0, "gnss_velocity_sigma": 0.05, "gnss_has_vertical_velocity": True}
FILTERED = {"gnss_rate": 10.0, "gnss_velocity_sigma": 0.05, "gnss_velocity_lasting": 0.025, "imu_accel_noise": 0.05}
CORRECTED = {
    "gnss_white_horizontal": 0.015,
    "gnss_white_up": 0.03,
    "gnss_offset_horizontal": 0.01,
    "gnss_offset_up": 0.02,
}
CENTIMETRES = {
    "gnss_white_horizontal": 0.02,
    "gnss_white_up": 0.04,
    "gnss_offset_horizontal": 0.02,
    "gnss_offset_up": 0.04,
    "gnss_velocity_sigma": 0.05,
    "gnss_velocity_lasting": 0.1,
    "motion_standstill": 30.0,
}
STOPPING = {"motion_stops": (Stop(30.0, 60.0),)}
# The presets, and what some effects are for: ranges that are too small, a box that warms up, trees over the track, a
# plug that works loose, samples as noisy as those of recorded karts, noisy samples beside a good receiver, a box on the
# steering wheel whose accelerometer is late; receivers and clocks as they should not be
WORLDS = {
    "white": World("white"),
    "kart": World("kart"),
    "kart_harsh": World("kart_harsh"),
    "kart, 2 g and 150 deg/s": World("kart", {"imu_accel_range": 2.0 * 9.81, "imu_gyro_range": 150.0 * DEG}),
    "kart, box that warms up": World("kart", {"imu_accel_bias_walk": 0.03, "imu_gyro_bias_walk": 0.1 * DEG}),
    "kart, poor sky at times": World("kart", {}, _poor_sky),
    "kart, no samples at times": World("kart", {}, _loose_plug),
    "kart, samples as noisy as real ones": World("kart", NOISY),
    "kart_harsh, good receiver": World("kart_harsh", {"gnss_velocity_sigma": 0.05}),
    "kart, quick receiver on a long arm": World("kart", {**NOISY, **QUICK, "lever_arm_b": np.array([0.9, 0.2, 0.3])}),
    "kart, late force on the wheel": World("kart", {"motion_steering": 10.0 * DEG, "imu_accel_delay": 0.05}),
    "kart, receiver that goes straight on": World("kart", {}, _coasts),
    "kart, receiver from cold": World("kart", {}, _cold_start),
    "kart, magnetic course": World("kart", {}, _magnetic),
    "kart, Doppler that is a mean of five": World("kart", {}, _filtered),
    "kart at an even speed, such a Doppler": World("kart", {"motion_top_speed": 12.0}, _filtered),
    "kart at an even speed, such a Doppler of 10 Hz": World(
        "kart", {"motion_top_speed": 12.0, "gnss_rate": 10.0}, _filtered
    ),
    "kart at an even speed": World("kart", {"motion_top_speed": 12.0}),
    "kart, samples stamped by counting": World("kart", {}, _counted),
    "kart, clocks 7 s apart": World("kart", {}, _clocks_apart),
    "kart, bumps in places": World("kart", {}, _bumps),
    "kart, errors of Doppler that last at rest": World("kart", {"gnss_velocity_sigma": 0.03, **STOPPING}, _lasting),
    "kart, errors of Doppler that last for a while": World(
        "kart", {"gnss_velocity_lasting": 0.075, "motion_standstill": 30.0}
    ),
    "kart, fixes that hardly wander": World(
        "kart", {"gnss_offset_horizontal": 0.02, "gnss_velocity_lasting": 0.005, "gnss_velocity_tau": 30.0}
    ),
    "kart, centimetres beside velocities that err for a while": World("kart", CENTIMETRES),
    "kart, quick receiver that errs for a while": World("kart", {**FILTERED, "motion_standstill": 30.0}),
    "kart, course later than speed": World("kart", {"gnss_rate": 10.0}, _late_course),
    "kart, one fix in five seconds": World("kart", {}, _rare),
    "kart, corrections that come and go": World("kart", CORRECTED, _corrected),
    "kart, stops with a receiver that holds": World("kart", STOPPING, _holds),
    "kart, stops without Doppler": World("kart", {"gnss_velocity": False, **STOPPING}),
}
