"""What to report of the noise and the wander of fixes, whoever found them: with a graph, or from the fixes alone."""

import math
from collections.abc import Mapping

import numpy as np

from smoother.arrays import Array
from smoother.estimate.fixes.offset import BIN, TIMES, OffsetModel, is_reported
from smoother.estimate.fixes.path import GnssPath
from smoother.fit.lap_registration import LapRegistration
from smoother.fit.noise_spread import ANY_NOISE
from smoother.trajectory import Identified

OBSERVABLE = 0.5  # any value is observable when its sigma is below this share of its prior's
# Sigmas of the logarithms of wander and time where a session does not show them: receivers wander by half to twice the
# usual, for 30 to 150 s.
ANY_WANDER, ANY_TIME = 0.5, 0.6
# Of white noise where a session does not show it, by its unit: receivers that filter have centimetres, others metres.
ANY_SCATTER = {"m": 0.3, "m/s": 0.15}
DIGIT = 0.01  # m and m/s, resolution of receivers
UNSURE_WALK = 0.5  # of what the wander between keyframes takes off the noise of fixes
UNSEEN_WALK = 0.1  # of the walk of Doppler that is added up


def noise_of_fixes(sigma: Array, spread: Array, unit: str, beyond: Array | None = None) -> Identified:
    """Return the white noise per axis, sigma (3,) in `unit`, of which the logarithms are known to spread (3,).

    beyond (3,), in `unit`: what else may be wrong with it. It is observable where its level part is, since few
    receivers have a vertical velocity, and where it is larger than its sigma.
    """
    own = np.hypot(sigma * spread, 0.0 if beyond is None else beyond)
    own = np.hypot(own, DIGIT + ANY_SCATTER[unit] * (spread / ANY_NOISE) ** 2)
    observable = bool(np.all((spread[:2] < OBSERVABLE * ANY_NOISE) & (own[:2] < sigma[:2])))
    return Identified(sigma.tolist(), own.tolist(), unit, observable, "identified" if observable else "default")


def scatter_of_fixes(sigma: Array, spread: Array, wandered: Array, least: Array | float) -> Identified:
    """Return :func:`noise_of_fixes` of positions with sigma (3,) m, no less than `least` m, beside their wander.

    wandered (3,) m^2: what their offset adds to it by going its way between keyframes, which is no noise.
    """
    white = np.sqrt(np.maximum(sigma**2 - wandered, np.square(least)))
    return noise_of_fixes(white, spread, "m", UNSURE_WALK * (sigma - white))


def hidden_wander(white: Array, velocity: Array, interval: float, duration: float, tau: float) -> Array:
    """Return the wander (3,) m that may go unseen over tau s, with fixes one in `interval` s, for `duration` s.

    Beneath the mean of their white noise, `white` (3,) m, and beneath the walk that noise of `velocity` (3,) m/s adds
    up to, a tenth of which is not seen to be missing. And the fewer tau there are, the more of it may be chance.
    """
    of_doppler = 0.5 * tau * UNSEEN_WALK * velocity**2 * interval
    by_chance = 1.0 + TIMES * tau / max(duration, BIN)
    return np.asarray(np.sqrt((white**2 * min(1.0, interval / tau) + of_doppler) * by_chance))


def unseen_wander(t: Array, path: GnssPath, tau: float) -> float:
    """Return the level wander, m, that fixes of `path`, stamped t (M,) s, may have unseen; infinite without Doppler.

    However long they go on: what may be chance in a short session is not in it.
    """
    if not is_reported(t, path):
        return math.inf
    interval = float(t[-1] - t[0]) / len(t)
    return float(hidden_wander(path.position_sigma, path.velocity_sigma, interval, math.inf, tau)[0])


def wander_of_fixes(offset: OffsetModel, hidden: Array) -> dict[str, Identified]:
    """Return how far fixes wander, and how long that lasts.

    How large the offset is shows with how long it lasts, in sessions of many times that; else it is a guess at best.
    hidden (3,) m: see :func:`hidden_wander`.
    """
    found = math.isfinite(offset.tau_spread)
    spread, source = (offset.tau_spread, "identified") if found else (ANY_TIME, "default")
    of_sigma = min(spread, ANY_WANDER)
    return {
        "gps_offset_sigma": Identified(
            offset.sigma.tolist(),
            np.hypot(of_sigma * offset.sigma, hidden).tolist(),
            "m",
            found,
            source,
        ),
        "gps_offset_tau": Identified(offset.tau, spread * offset.tau, "s", found, source),
    }


def wander_from_laps(laps: LapRegistration, otherwise: Mapping[str, Identified]) -> dict[str, Identified]:
    """Return the same as laps show it; the height is that of `otherwise`.

    They show the change over a lap, and leave open which part of it is the size of the wander and which its time.
    """
    own = laps.sigma * laps.sigma_spread
    before = otherwise["gps_offset_sigma"]
    up, of_up = (float(np.ravel(np.asarray(values, dtype=np.float64))[2]) for values in (before.value, before.sigma))
    found = laps.sigma_spread < ANY_WANDER
    return {
        "gps_offset_sigma": Identified(
            [laps.sigma, laps.sigma, up],
            [own, own, of_up],
            "m",
            found,
            "identified" if found else "default",
        ),
        "gps_offset_tau": Identified(laps.tau, laps.tau * laps.tau_spread, "s", False, "default"),
        "gps_offset_change": Identified(laps.change, laps.change * laps.change_spread, "m", True, "identified"),
    }
