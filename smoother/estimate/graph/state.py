"""The unknowns of the graph: one block of 18 for each keyframe, and the constants of the session.

Tangent of a keyframe, in this order: rotation (s axes, `R_ns @ exp(w)`) and translation (s axes, `p + R_ns @ d`) as in
GTSAM's Pose3, velocity in n, bias of force, bias of rate, GPS offset in n. Poses are those of the sensor, T_ns.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from smoother.arrays import Array
from smoother.estimate.model.state import Geometry, State

ROTATION, TRANSLATION, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9)
ACCEL_BIAS, GYRO_BIAS, OFFSET = slice(9, 12), slice(12, 15), slice(15, 18)
KEYFRAME_SIZE = 18

# Constants of the session. The first sixteen enter the rows of rows.py, the sensor errors only the inertial factors.
POSITION_LATENCY, VELOCITY_LATENCY, LEVER_ARM, HEADING_OFFSET = slice(0, 1), slice(1, 2), slice(2, 5), slice(5, 6)
DOPPLER_BIAS, VELOCITY_RESPONSE, EVENNESS, SLIP = slice(6, 9), slice(9, 10), slice(10, 11), slice(11, 15)
COURSE_DELAY = slice(15, 16)
ROW_CONSTANTS_SIZE = 16
ACCEL_ERROR, GYRO_ERROR, RECTIFICATION = slice(16, 22), slice(22, 25), slice(25, 31)
CONSTANTS_SIZE = 31


def _no_bias() -> Array:
    return np.zeros(3)


def _no_slip() -> Array:
    return np.zeros(4)


def _no_accel_error() -> Array:
    return np.zeros((3, 2))


def _no_rectification() -> Array:
    return np.zeros((3, 2))


def _s_is_level() -> Array:
    return np.eye(3)


@dataclass(frozen=True, eq=False)
class Constants:
    """Constants of the session: latencies, s (a row stamped t was true at t - latency); lever_arm_s (3,) m, from the
    IMU to the antenna; heading_offset rad, by which the magnetometer's yaw is too large; doppler_bias_n (3,) m/s of the
    receiver's velocity; velocity_response s^2, by which that velocity contains the second derivative of the true one,
    beyond what its latency does: a low-pass of first order has half the square of its time constant, an antenna that
    leans outwards in bends less than nothing; evenness, 0 of such a low-pass, 1 of a mean over as much before its delay
    as after it, whose response is as large; slip (4,), where the path points beside level_axes_s: rad, always; rad per
    m/s^2 of lateral acceleration, and per m/s^3 of its rate; rad per 1/m of curvature, which is how far, m, the box is
    ahead of the rear axle; course_delay s, by which the direction of the receiver's velocity is later than its size:
    loggers smooth the one and not the other; accel_error (3, 2), scale and misalignment: by which the measured force
    grows per force along each of the two level axes; gyro_error (3,), likewise of the rate about up; rectification (3,
    2) m/s^2, by which force grows where the vibration of force or of rate has twice its usual power.

    level_axes_s (3, 3), not estimated: rows are those axes in s, two level ones and up. A scale multiplies what is felt
    across gravity and turned about it. Along gravity it is a bias; a kart's rates of roll and pitch are mostly noise,
    and a scale fitted to noise would be fitted to hide it.

    is_steered, not estimated: the box turns with the steering wheel, the arm with the course (arm.py).
    """

    position_latency: float
    velocity_latency: float
    lever_arm_s: Array
    heading_offset: float = 0.0
    doppler_bias_n: Array = field(default_factory=_no_bias)
    velocity_response: float = 0.0
    evenness: float = 0.0
    slip: Array = field(default_factory=_no_slip)
    course_delay: float = 0.0
    accel_error: Array = field(default_factory=_no_accel_error)
    gyro_error: Array = field(default_factory=_no_bias)
    rectification: Array = field(default_factory=_no_rectification)
    level_axes_s: Array = field(default_factory=_s_is_level)
    is_steered: bool = False

    @property
    def accel_matrix(self) -> Array:
        """Error of force as a matrix (3, 3) in s: measured = (1 + matrix) true + bias."""
        return np.asarray(self.accel_error @ self.level_axes_s[:2])

    @property
    def gyro_matrix(self) -> Array:
        """Error of rate as a matrix (3, 3) in s, likewise."""
        return np.outer(self.gyro_error, self.level_axes_s[2])

    def as_vector(self) -> Array:
        """All constants in the order of the tangent, (CONSTANTS_SIZE,)."""
        latencies, heading = [self.position_latency, self.velocity_latency], [self.heading_offset]
        receiver = [self.doppler_bias_n, [self.velocity_response], [self.evenness]]
        of_rows = [latencies, self.lever_arm_s, heading, *receiver, self.slip, [self.course_delay]]
        errors = [self.accel_error.ravel(), self.gyro_error, self.rectification.ravel()]
        return np.concatenate([*of_rows, *errors])

    @staticmethod
    def from_vector(x: Array, level_axes_s: Array, *, is_steered: bool = False) -> "Constants":
        """Inverse of :meth:`as_vector`."""
        return Constants(
            float(x[0]),
            float(x[1]),
            np.array(x[LEVER_ARM]),
            float(x[5]),
            np.array(x[DOPPLER_BIAS]),
            float(x[VELOCITY_RESPONSE.start]),
            float(x[EVENNESS.start]),
            np.array(x[SLIP]),
            float(x[COURSE_DELAY.start]),
            x[ACCEL_ERROR].reshape(3, 2),
            np.array(x[GYRO_ERROR]),
            x[RECTIFICATION].reshape(3, 2),
            level_axes_s,
            is_steered,
        )


@dataclass(frozen=True, eq=False)
class ChainState:
    """Keyframes, K of them: t (K,) s; R_ns (K, 3, 3); position_n of the IMU, velocity_n, accel_bias_s, gyro_bias_s, and
    offset_n, the slow error of the fixes (fix = position + offset), each (K, 3); constants.
    """

    t: Array
    R_ns: Array
    position_n: Array
    velocity_n: Array
    accel_bias_s: Array
    gyro_bias_s: Array
    offset_n: Array
    constants: Constants

    @property
    def interval(self) -> float:
        """Time between keyframes, s."""
        return float(self.t[1] - self.t[0])

    def between(self, first: int, last: int, every: int = 1) -> "ChainState":
        """Return keyframes first to last, exclusive, one in `every`."""
        names = ("t", "R_ns", "position_n", "velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")
        return replace(self, **{name: getattr(self, name)[first:last:every] for name in names})


def new_state(s: ChainState) -> State:
    """Return the state with the constants of the samples alone, in the graph's own type."""
    c = s.constants
    constants = {
        "accel_scale": c.accel_error.ravel(),
        "gyro_scale": c.gyro_error,
        "rectification": c.rectification.ravel(),
    }
    of_keyframes = s.t, s.R_ns, s.position_n, s.velocity_n, s.accel_bias_s, s.gyro_bias_s, s.offset_n
    return State(*of_keyframes, constants, Geometry(c.level_axes_s, c.is_steered))
