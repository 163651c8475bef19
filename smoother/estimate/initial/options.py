"""Options of the graph, each with where its figure comes from."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.arrays import Array, median
from smoother.estimate.model.state import CONSTANTS, Sigma
from smoother.units import DEG

FIXES_BETWEEN = 2  # from keyframe to keyframe, if there are so many in the longest interval
LEAST_INTERVAL = 0.08  # s between keyframes; of less, too few bins would remain


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
    sigmas: of the priors of the constants, by name (model/state.py).
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
    sigmas: dict[str, Sigma] = field(default_factory=lambda: {c.name: c.sigma for c in CONSTANTS})
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
