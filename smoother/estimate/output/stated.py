"""Values that the settings state and the session contradicts: which, by how much, and what it would find itself.

A stated value is held by a prior far narrower than any session could tell it, so it comes out as it was stated, and
what is wrong with it goes into antenna, attitudes and noise. How strongly the session pulls at it is all the same in
what is left: by a millionth of a second, of known stiffness. With that prior loosened to what is known of a value
nobody stated, the pull is a step of so many sigmas (a score test; Rao 1948). The step is that of a linear model: of
what is far off it says the direction, and the size to a third.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.config import SessionConfig
from smoother.estimate.initial.first_noise import scatter_of
from smoother.estimate.initial.guess import Start
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.model.state import COLUMNS, CONSTANTS, Sigma
from smoother.estimate.output.estimated import Estimated
from smoother.estimate.output.identified import UNSTEADY_ARM, doubt_by_rates, unsure_moment
from smoother.estimate.output.mounting import FittedMounting
from smoother.estimate.solvers.variance_components import OWN_SCATTER
from smoother.samples import Problem, Session
from smoother.trajectory import STATED
from smoother.units import DEG

STATED_NOISE = "stated_noise_wrong"  # code of the problem of a density
# sigmas, and what a delay or the place of an antenna is known to at best where a session is no simulation
CERTAIN, LEAST_DELAY, LEAST_ARM = 6.0, 0.04, 0.4  # s, m
LEAST_ANGLE = 4.0 * DEG  # likewise of how the box stands: twice what a track falls to one side for the water
# times what neighbouring samples scatter by: half of the least that is ever found, and more than is
TOO_QUIET, TOO_LOUD = 0.5 * OWN_SCATTER, 10.0
# Whatever low-pass holds samples back for some time lets a 25th through, or less, of what is FAST times as fast as one
# period in that time. Of engines and roads that shake a box as much as it moves, 0.13 of what is slower is then left
FAST, LOUD = 4.0, 0.25
SOME, LOWEST, HIGHEST = 50_000, 0.2, 0.45  # samples that are looked at; Hz, and of their rate, that they tell of
REMEDY = "Correct it in session.toml, or leave it out to have it found"


@dataclass(frozen=True, eq=False)
class Loosened:
    """Constants (C,) that a session would find, were none of them stated, by one step; their covariance (C, C)."""

    value: Array
    covariance: Array


def loosened(found: Estimated, loose: dict[str, Sigma]) -> Loosened:
    """Take the step from what was `found`, with prior sigmas by name where those were narrower."""
    known = found.known
    sigma = np.concatenate([known.prior_sigma(c.name) for c in CONSTANTS])
    mean = np.concatenate([known.priors.constants[c.name][0] for c in CONSTANTS])
    value = np.concatenate([found.state.constants[c.name] for c in CONSTANTS])
    wider = sigma.copy()
    for name, own in loose.items():
        wider[COLUMNS[name]] = np.maximum(sigma[COLUMNS[name]], own)
    scale = np.sqrt(np.diag(known.constants_covariance))
    information = np.linalg.inv(known.constants_covariance / np.outer(scale, scale)) / np.outer(scale, scale)
    less = sigma**-2.0 - wider**-2.0
    covariance = np.linalg.inv(information - np.diag(less))
    return Loosened(value + covariance @ (less * (value - mean)), covariance)


def contradicted_constants(session: Session, found: Estimated) -> tuple[Problem, ...]:
    """Report which stated latencies and arm the session contradicts."""
    config, geometry = session.config, found.state.geometry
    timing, arm = config.gps, config.mounting.lever_arm_b
    usual, loose = GraphOptions().sigmas, dict[str, Sigma]()
    if timing.position_latency is not None:
        loose["position_latency"] = usual["position_latency"]
    if timing.velocity_latency is not None and np.any(np.isfinite(session.gnss.velocity_n[:, 0])):
        loose["velocity_latency"] = usual["velocity_latency"]
    if arm is not None:
        loose["lever_arm"] = usual["lever_arm"]
    if session.imu is None or not found.known.drives or not loose:
        return ()
    try:
        free = loosened(found, loose)
    except np.linalg.LinAlgError:
        return ()
    unsteady = doubt_by_rates(found.known.noise.inertial.gyro)
    moment = unsure_moment(session.imu.sampling, config.imu_delay, unsteady)
    problems = list(_delays(config, free, moment))
    if arm is not None and not geometry.is_steered:
        R_bs = geometry.level_axes_s if config.mounting.R_bs is None else config.mounting.R_bs
        problems += _arm(arm, free, R_bs, UNSTEADY_ARM * unsteady)
    return tuple(problems)


def contradicted_filter(session: Session) -> tuple[Problem, ...]:
    """Say so where samples hold vibration that the low-pass of the delay that is stated for them would have taken out.

    All delays and times shift with it alike, so that nothing else tells. Of shorter ones, and calm boxes, nothing does.
    """
    imu, delay = session.imu, session.config.imu_delay
    if imu is None or delay is None or delay < LEAST_DELAY or len(imu.t) < SOME // 10:
        return ()
    from smoother.fit.spectrum import vibration_spectrum  # here: a tenth of a second of imports that few sessions need

    first = max(0, (len(imu.t) - SOME) // 2)
    rate, some = 1.0 / imu.interval, slice(first, first + SOME)
    fast = FAST / delay
    if fast > HIGHEST * rate:
        return ()
    for values in (imu.specific_force_s[some], imu.angular_rate_s[some]):
        spectrum = vibration_spectrum(values, rate)
        above, below = (float(np.linalg.norm(spectrum.rms(*band))) for band in ((fast, rate), (LOWEST, fast)))
        if above > LOUD * below:
            text = (
                f"[imu] delay is stated as {delay:.3g} s, which no low-pass has that leaves vibration above {fast:.0f} "
                "Hz in the samples: all times, and delays of the fixes, are off by up to as much. "
                f"{REMEDY}. What samples took to arrive belongs to t_s"
            )
            return (Problem(STATED, text),)
    return ()


def _delays(config: SessionConfig, free: Loosened, moment: float) -> Iterator[Problem]:
    names = ("position_latency", config.gps.position_latency), ("velocity_latency", config.gps.velocity_latency)
    for name, stated in names:
        if stated is None:
            continue
        i = COLUMNS[name].start
        sigma = math.hypot(math.sqrt(free.covariance[i, i]), moment)
        off = float(free.value[i]) - stated
        if abs(off) > max(CERTAIN * sigma, LEAST_DELAY):
            text = (
                f"[gps] {name} is stated as {stated:.3g} s, which the motion contradicts by {abs(off) / sigma:.0f} "
                f"sigmas: it tells about {free.value[i]:.2f} s. {REMEDY}"
            )
            yield Problem(STATED, text)


def _arm(stated: Array, free: Loosened, R_bs: Array, unsteady: float) -> Iterator[Problem]:
    """Ahead and to the left; up hardly shows."""
    part = COLUMNS["lever_arm"]
    value, covariance = R_bs @ free.value[part], R_bs @ free.covariance[part, part] @ R_bs.T
    off, sigma = (value - stated)[:2], np.hypot(np.sqrt(np.diag(covariance))[:2], unsteady)
    if np.any(np.abs(off) > np.maximum(CERTAIN * sigma, LEAST_ARM)):
        text = (
            f"[mounting] lever_arm_b is stated as {_metres(stated[:2])} m ahead and to the left of the box, which the "
            f"motion contradicts by {np.max(np.abs(off) / sigma):.0f} sigmas: it tells about {_metres(value[:2])} m. "
            f"{REMEDY}"
        )
        yield Problem(STATED, text)


def contradicted_mounting(stated: Array, fitted: FittedMounting) -> tuple[Problem, ...]:
    """Say so where a box does not stand as its stated mounting (3, 3) says."""
    if not fitted.is_fitted:
        return ()
    off = so3.log(fitted.R_bs @ stated.T)
    if not np.any(np.abs(off) > np.maximum(CERTAIN * fitted.sigma, LEAST_ANGLE)):
        return ()
    rows = ", ".join("[" + ", ".join(f"{value:.3f}" for value in row) + "]" for row in fitted.R_bs)
    text = (
        f"the mounting that is stated (R_bs or axes) is {np.linalg.norm(off) / DEG:.0f} deg off that which the drive "
        f"shows: roll, pitch and yaw are off by as much. It shows R_bs = [{rows}]. {REMEDY}"
    )
    return (Problem(STATED, text),)


def contradicted_noise(start: Start) -> tuple[Problem, ...]:
    """Say so where a stated density is far from what neighbouring samples scatter by."""
    stated = start.stated
    if not (stated.accel_noise or stated.gyro_noise):
        return ()
    scatter = scatter_of(start.binned)
    shown = ("accel_noise", stated.accel_noise, scatter.accel), ("gyro_noise", stated.gyro_noise, scatter.gyro)
    out = []
    for (name, density, seen), unit in zip(shown, ("m/s^2/sqrt(Hz)", "rad/s/sqrt(Hz)"), strict=True):
        if not density or TOO_QUIET * seen < density < TOO_LOUD * seen:
            continue
        why = "samples count for more than they are worth" if density < seen else "samples hardly count"
        text = (
            f"[imu] {name} is stated as {density:.2g} {unit}, while the samples scatter by {seen:.2g} as the kart "
            f"drives: {why}, and the ± is not right. {REMEDY}"
        )
        out.append(Problem(STATED_NOISE, text))
    return tuple(out)


def _metres(values: Array) -> str:
    return " and ".join(f"{value:.2f}" for value in values)
