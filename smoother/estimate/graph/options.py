"""Options of the graph, each with where its figure comes from."""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, median
from smoother.units import DEG

FIXES_BETWEEN = 2  # from keyframe to keyframe, if there are so many in the longest interval
LEAST_INTERVAL = 0.08  # s between keyframes; of less, too few bins would remain


@dataclass(frozen=True)
class GraphOptions:
    """Options of the graph, in SI; where each figure comes from.

    rate Hz: rows of the trajectory a second. solver: "batch", "isam2", or "gtsam",
    which is to become the batch.
    in_step: a force that is late behind the rate is taken to its time.
    wheels: the kart is asked to point nearly along its path.
    without: names of factors of the table (factors/graph.py) that are left out, with the solver "gtsam".
    keyframe_interval s: 0.2 is one keyframe to a fix of a 5 Hz receiver; less beyond 10 Hz (:meth:`for_fixes`).
    bin_interval s: of the averaged inertial samples.
    accel_bias_sigma, gyro_bias_sigma: priors; zero-g tolerance of the MPU9250, 0.6-0.8 m/s^2, and what the alignment
        leaves of the gyroscope's bias.
    accel_bias_walk, gyro_bias_walk: temperature drift of the same part while it warms up.
    lever_arm_sigma m, latency_sigma s: priors; what fits on a kart, and what receivers do.
    doppler_bias_sigma: 0.01-0.05 m/s on real kart logs.
    velocity_response_sigma s^2: a low-pass of 0.1 s has 5e-3, an antenna half a metre up that leans by 1.5 mrad to a
        m/s^2 -0.8e-3, recordings -6e-3 to 13e-3.
    course_delay_sigma: receivers make course and speed of one velocity; more shows, and is then sought (start.py).
    evenness_sigma: receivers filter as a low-pass of first order, or their velocity is the mean of some, or between.
    sensor_error_sigma: scale and misalignment; the data sheet's 3 % is the limit, not the spread.
    rectification_sigma m/s^2: of vibration, to begin with.
    offset_sigma (3,) m, offset_tau s: slow offset of the fixes of receivers in general.
    identification_span s: the busiest stretch as long as this tells constants and noise before the whole is solved.
    rounds, final_rounds: turns of solving and of finding the noise, of that stretch and of the whole, at most.
    iterations: steps before the first of these turns. approaches: steps of the keyframes alone before all others.
    """

    rate: float = 50.0
    solver: str = "batch"
    in_step: bool = True
    wheels: bool = True
    without: frozenset[str] = frozenset()
    keyframe_interval: float = 0.2
    bin_interval: float = 0.02
    accel_bias_sigma: float = 0.5
    gyro_bias_sigma: float = 2.0 * DEG
    accel_bias_walk: float = 0.003
    gyro_bias_walk: float = 0.006 * DEG
    lever_arm_sigma: float = 0.5
    doppler_bias_sigma: float = 0.03
    velocity_response_sigma: float = 5e-3
    evenness_sigma: float = 0.5
    course_delay_sigma: float = 1.5e-3
    sensor_error_sigma: float = 0.01
    rectification_sigma: float = 0.1
    latency_sigma: float = 0.25
    offset_sigma: tuple[float, float, float] = (2.0, 2.0, 3.4)
    offset_tau: float = 60.0
    identification_span: float = 120.0
    rounds: int = 8
    iterations: int = 3
    approaches: int = 4
    final_rounds: int = 10

    def for_fixes(self, t: Array) -> "GraphOptions":
        """Return the options for fixes at t (N,) s: no more than FIXES_BETWEEN of them from one keyframe to the next.

        A cubic of 0.2 s is stiffer than five good velocities in it: what it misses of the motion would pass for noise.
        """
        spacing = float(median(np.diff(t))) if len(t) > 1 else math.inf
        interval = max(FIXES_BETWEEN * spacing, LEAST_INTERVAL)
        return replace(self, keyframe_interval=interval) if interval < 0.99 * self.keyframe_interval else self
