"""Problems of an estimate: samples that cannot be used, and results less certain than their sigmas."""

from collections.abc import Mapping

import numpy as np

from smoother.estimate.initial.align import Alignment
from smoother.estimate.initial.guess import have_samples
from smoother.estimate.model.imu import sampled_spans
from smoother.estimate.model.noise import Noise
from smoother.estimate.output.estimated import Estimated
from smoother.samples import GnssFixes, ImuSamples, Problem, Session
from smoother.trajectory import IMU_SHAKEN, Identified
from smoother.words import counted

FEWEST_FIXES = 10
SHORTEST_OVERLAP = 5.0  # s of inertial samples and fixes together
FEWEST_SAMPLED = 3  # fixes in that time; fewer are an outage
# Least share of rate and force that the fixes must explain: karts 0.86 and more, a motorway 0.38, noise 0.04. And of
# what course and velocity change by between rare ones: real karts and cars, one fix in 3 to 10 s, have 0.95 and more,
# harsh simulated karts 0.96; with samples of another lap or time real ones have 0.6 and less
LEAST_EXPLAINED, LEAST_EXPLAINED_OF_CHANGES = 0.15, 0.9
LONGEST_ARM = 2.5  # m from IMU to antenna, more than any kart is long
SHAKEN = 0.9  # m/s^2/sqrt(Hz); simulated karts below it have latencies and arm within their sigmas, those above do not
EARLY, EARLY_SIGMAS = 0.05, 3.0  # s by which a fix arrives before it is true, and their sigmas

UNLIKE = (
    "the inertial samples do not show the motion of the fixes; smoothed from the fixes alone. Is t_s of both files on "
    "one clock? If the latency of the fixes is known, state it: [gps] position_latency in session.toml"
)
FAR_APART = (
    "the inertial samples fit the fixes only with the antenna {:.1f} m from the logger, which this motion cannot "
    "separate from a latency or average of the speed; smoothed from the fixes alone. If the receiver averages its "
    "speed, leave speed and course out of the file. If the antenna is that far away, state [mounting] lever_arm_b in "
    "session.toml"
)


def too_few(imu: ImuSamples, fixes: GnssFixes) -> tuple[Problem, ...]:
    """Report samples and fixes that are too few, or too short a time together, to align one with the other."""
    if len(fixes) < FEWEST_FIXES:
        text = f"{counted(len(fixes), 'fix')} are too few to find the mounting (at least {FEWEST_FIXES})"
        return (Problem("gps_too_few", f"{text}; smoothed from the fixes alone"),)
    together = _overlap(imu, fixes)
    if together <= 0.0:
        text = "the inertial samples and the fixes have no time in common; smoothed from the fixes alone"
        return (Problem("imu_elsewhere", text),)
    if together < SHORTEST_OVERLAP:
        text = f"the inertial samples and the fixes have only {together:.1f} s in common"
        return (Problem("imu_too_short", f"{text} (at least {SHORTEST_OVERLAP:.0f}); smoothed from the fixes alone"),)
    sampled = int(np.count_nonzero(have_samples(sampled_spans(imu.t), fixes.t)))
    if sampled < FEWEST_SAMPLED:
        text = f"only {counted(sampled, 'fix')} came while there were inertial samples (at least {FEWEST_SAMPLED})"
        return (Problem("imu_too_short", f"{text}; smoothed from the fixes alone"),)
    return ()


def _overlap(imu: ImuSamples, fixes: GnssFixes) -> float:
    """Longest time, s, that both cover without a gap."""
    if len(imu.t) < 2:
        return 0.0
    first, last = np.clip(sampled_spans(imu.t), fixes.t[0], fixes.t[-1]).T
    return float(np.max(last - first))


def unlike(alignment: Alignment) -> tuple[Problem, ...]:
    """Report samples and fixes of different motions, by the share that the fixes explain."""
    least = LEAST_EXPLAINED_OF_CHANGES if alignment.by_changes else LEAST_EXPLAINED
    if alignment.is_level_only or alignment.share_explained >= least:
        return ()
    return (*alignment.problems, Problem("imu_unusable", UNLIKE))


def too_far(session: Session, found: Estimated, alignment: Alignment) -> tuple[Problem, ...]:
    """Report an estimated lever arm that is longer than a kart."""
    arm = float(np.linalg.norm(found.state.geometry.level_axes_s[:2] @ found.state.constants["lever_arm"]))
    if session.config.mounting.lever_arm_b is not None or arm <= LONGEST_ARM:
        return ()
    return (*alignment.problems, Problem("arm_too_long", FAR_APART.format(arm)))


def early(identified: Mapping[str, Identified]) -> tuple[Problem, ...]:
    """Report fixes that arrive before they are true: stamps of samples and fixes are then not on one clock."""
    latency = identified["gps_position_latency"]
    if not (latency.observable and isinstance(latency.value, float) and isinstance(latency.sigma, float)):
        return ()
    if latency.value + EARLY_SIGMAS * latency.sigma > -EARLY:
        return ()
    text = (
        f"the fixes seem to arrive {-latency.value:.2f} s before they are true: the samples' t_s is late by more than "
        "that against theirs. Times are those of the samples; with columns of your own, write both on one clock"
    )
    return (Problem("gps_early", text),)


def shaken(session: Session, noise: Noise) -> tuple[Problem, ...]:
    """Report aliased engine vibration: it is correlated with the motion, lap by lap, as a latency or a lever arm is."""
    density = noise.inertial.accel
    if session.config.imu.accel_noise is not None or density < SHAKEN:
        return ()
    text = (
        f"the accelerations differ from the motion by {density:.1f} m/s^2/sqrt(Hz), as with aliased engine vibration: "
        "latencies and lever arm may be wrong by many times their sigma. Mount the logger farther from the engine, or "
        "sample faster with the sensor's low-pass filter on"
    )
    return (Problem(IMU_SHAKEN, text),)
