"""Options of the graph, each with where its figure comes from."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.arrays import Array, median
from smoother.units import DEG

FIXES_BETWEEN = 2  # from keyframe to keyframe, if there are so many in the longest interval
LEAST_INTERVAL = 0.08  # s between keyframes; of less, too few bins would remain
Sigma = float | tuple[float, ...]  # of a constant, or of each of its numbers
SIGMAS: dict[str, Sigma] = {
    "position_latency": 0.25,
    "velocity_latency": 0.25,
    "lever_arm": 0.5,
    "doppler_bias": 0.03,
    "velocity_response": 0.1,
    "heading_offset": math.pi / 4.0,
    "slip": (0.5, 0.01, 2e-3, 1.0),
    "accel_scale": 0.01,
    "gyro_scale": 0.01,
    "rectification": 0.1,
}


@dataclass(frozen=True)
class GraphOptions:
    """Options of the graph, in SI; where each figure comes from.

    rate Hz: rows of the trajectory a second. solver: "batch", or "isam2", which goes through the session as a stream.
    in_step: a force that is late behind the rate is taken to its time.
    wheels: the kart is asked to point nearly along its path.
    without: names of factors of the table (factors/graph.py) that are left out.
    keyframe_interval s: 0.2 is one keyframe to a fix of a 5 Hz receiver; less beyond 10 Hz (:meth:`for_fixes`).
    bin_interval s: of the averaged inertial samples.
    accel_bias_sigma, gyro_bias_sigma: priors; zero-g tolerance of the MPU9250, 0.6-0.8 m/s^2, and what the alignment
        leaves of the gyroscope's bias.
    accel_bias_walk, gyro_bias_walk: temperature drift of the same part while it warms up.
    sigmas: of the priors of the constants, by name. latencies s: what receivers do; lever_arm m: what fits on a kart;
        doppler_bias: 0.01-0.05 m/s on real kart logs; velocity_response s^2: a low-pass of 0.1 s has 5e-3, recordings
        -6e-3 to 13e-3, loggers that smooth their speed up to 0.2; slip: cars had -0.004 to -0.007 rad per m/s^2, -0.001
        to -0.003 rad per m/s^3, and the rear axle 1.2 m behind the box; scales: the data sheet's 3 % is the limit, not
        the spread; rectification m/s^2.
    offset_sigma (3,) m, offset_tau s: slow offset of the fixes of receivers in general.
    identification_span s: the busiest stretch as long as this shows constants and noise before the whole is solved.
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
    sigmas: dict[str, Sigma] = field(default_factory=lambda: dict(SIGMAS))
    offset_sigma: tuple[float, float, float] = (2.0, 2.0, 3.4)
    offset_tau: float = 60.0
    identification_span: float = 120.0

    def for_fixes(self, t: Array) -> "GraphOptions":
        """Return the options for fixes at t (N,) s: no more than FIXES_BETWEEN of them from one keyframe to the next.

        A cubic of 0.2 s is stiffer than five good velocities in it: what it misses of the motion would pass for noise.
        """
        spacing = float(median(np.diff(t))) if len(t) > 1 else math.inf
        interval = max(FIXES_BETWEEN * spacing, LEAST_INTERVAL)
        return replace(self, keyframe_interval=interval) if interval < 0.99 * self.keyframe_interval else self
