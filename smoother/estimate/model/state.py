"""The unknowns of the graph: variables of each keyframe and constants of the session, as GTSAM values and as arrays.

Keyframe k has the pose of the sensor X(k) = T_ns, its velocity V(k) in n, the biases B(k) of specific force and angular
rate, and the slow error O(k) of the fixes in n (fix = position + error). The tangent of a keyframe has these 18 columns
in this order; a rotation is `R_ns @ exp(w)` and a translation `p + R_ns @ d`, both in s, as in GTSAM's Pose3.

A constant of the session is a small vector with a key of its own. To add one, add a line to CONSTANTS and a factor with
its Jacobian.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, O, V, X

from smoother.arrays import Array

ROTATION, TRANSLATION, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9)
ACCEL_BIAS, GYRO_BIAS, OFFSET = slice(9, 12), slice(12, 15), slice(15, 18)
DIMENSIONS = (6, 3, 6, 3)  # of X, V, B, O
KEYFRAME_SIZE = 18
Sigma = float | tuple[float, ...]  # of a constant, or of each of its numbers


@dataclass(frozen=True)
class Constant:
    """A constant of the session: name, size, meaning, and sigma of its prior about 0.

    sigma: of all of them or of each. factor: the factor that it belongs to; where a session has that, `identified` of
    summary.json has the constant, in `unit`. Those without one are reported by output/identified.py in other terms.
    """

    name: str
    size: int
    meaning: str
    sigma: Sigma
    factor: str = ""
    unit: str = ""


# Priors: latencies of receivers; lever arms on a kart; doppler_bias 0.01-0.05 m/s on real kart logs; velocity_response:
# a low-pass of 0.1 s has 5e-3, recordings -6e-3 to 13e-3, loggers that smooth their speed up to 0.2; slip: cars had
# -0.004 to -0.007 rad per m/s^2, -0.001 to -0.003 rad per m/s^3, and the rear axle 1.2 m behind the logger; scales: the
# data sheet's limit is 3 %. Wheel: circumferences entered by hand; a tyre that slips by 5 % at 5 m/s^2, and slides by
# 8 deg at 1 g; half the width of a kart.
CONSTANTS = (
    Constant("position_latency", 1, "s: a position stamped t was true at t - latency", 0.25),
    Constant("velocity_latency", 1, "s: likewise of a Doppler velocity", 0.25),
    Constant("lever_arm", 3, "m in s: from the IMU to the antenna", 0.5),
    Constant("doppler_bias", 3, "m/s in n: constant error of the receiver's velocity", 0.03),
    Constant("velocity_response", 1, "s^2: times the jerk, what a receiver's low-pass adds to the velocity", 0.1),
    Constant("heading_offset", 1, "rad: by which the magnetic heading is too large", math.pi / 4.0),
    Constant(
        "slip",
        4,
        "rad, rad per m/s^2, rad per m/s^3, m: sideslip by lateral acceleration, its rate, curvature",
        (0.5, 0.01, 2e-3, 1.0),
    ),
    Constant("accel_scale", 6, "1: error of specific force by force along the two level axes, (3, 2)", 0.01),
    Constant("gyro_scale", 3, "1: error of angular rate by the rate about up", 0.01),
    Constant("wheel_scale", 1, "1: by which a wheel's speed is too large, over the speed", 0.2, "wheel_speed", "1"),
    Constant(
        "wheel_slip",
        2,
        "s^2/m, s^4/m^2: the same, by forward acceleration and by the square of that to the left",
        (0.01, 1e-4),
        "wheel_speed",
        "s^2/m, s^4/m^2",
    ),
    Constant("wheel_side", 1, "m: from the IMU to the left, to the wheel", 0.5, "wheel_speed", "m"),
)
KEYS: Mapping[str, int] = {c.name: gtsam.symbol("c", i) for i, c in enumerate(CONSTANTS)}
SIZES: Mapping[str, int] = {c.name: c.size for c in CONSTANTS}
_ENDS = np.cumsum([c.size for c in CONSTANTS])
COLUMNS: Mapping[str, slice] = {
    c.name: slice(int(end) - c.size, int(end)) for c, end in zip(CONSTANTS, _ENDS, strict=True)
}
"""Where each constant is among the columns of all of them: for matrices that go to GTSAM, and covariances."""
CONSTANTS_SIZE = int(_ENDS[-1])


OF_KEYFRAMES = ("t", "R_ns", "position_n", "velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")


def keyframe_keys(k: int) -> list[int]:
    """GTSAM's keys of keyframe k, in the order of its tangent."""
    return [X(k), V(k), B(k), O(k)]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Geometry of the sensor besides the unknowns.

    level_axes_s (3, 3): rows are two level axes and up, in s. is_steered: the sensor is on the steering wheel, and
    the lever arm rotates with the course.
    """

    level_axes_s: Array
    is_steered: bool = False


@dataclass(frozen=True, eq=False)
class State:
    """All unknowns as arrays: t (K,) s, evenly spaced; R_ns (K, 3, 3); position_n of the IMU m, velocity_n m/s,
    accel_bias_s m/s^2, gyro_bias_s rad/s, offset_n m, each (K, 3); constants by name, each (size,).
    """

    t: Array
    R_ns: Array
    position_n: Array
    velocity_n: Array
    accel_bias_s: Array
    gyro_bias_s: Array
    offset_n: Array
    constants: Mapping[str, Array]
    geometry: Geometry

    @property
    def interval(self) -> float:
        """Time between keyframes, s."""
        return float(self.t[1] - self.t[0])

    def constant(self, name: str) -> float:
        """A constant that is one number."""
        return float(self.constants[name][0])

    def part(self, keys: slice) -> "State":
        """A copy of some of the keyframes."""
        return replace(self, **{name: getattr(self, name)[keys].copy() for name in OF_KEYFRAMES})

    def values(self) -> gtsam.Values:
        """The same as GTSAM's values."""
        values = gtsam.Values()
        for k in range(len(self.t)):
            values.insert(X(k), gtsam.Pose3(gtsam.Rot3(self.R_ns[k]), self.position_n[k]))
            values.insert(V(k), self.velocity_n[k])
            values.insert(B(k), gtsam.imuBias.ConstantBias(self.accel_bias_s[k], self.gyro_bias_s[k]))
            values.insert(O(k), self.offset_n[k])
        for name, key in KEYS.items():
            values.insert(key, self.constants[name])
        return values

    def with_values(self, values: gtsam.Values) -> "State":
        """The state with all unknowns as GTSAM's values have them."""
        pose = gtsam.utilities.extractPose3(values)  # rows by key, as all of these
        biases = np.array([values.atConstantBias(B(k)).vector() for k in range(len(self.t))])
        return replace(
            self,
            R_ns=pose[:, :9].reshape(-1, 3, 3),
            position_n=pose[:, 9:],
            velocity_n=gtsam.utilities.extractVectors(values, "v"),
            accel_bias_s=biases[:, :3],
            gyro_bias_s=biases[:, 3:],
            offset_n=gtsam.utilities.extractVectors(values, "o"),
            constants={name: values.atVector(key) for name, key in KEYS.items()},
        )


def vector_values(keyframes: Array, constants: Array) -> gtsam.VectorValues:
    """A tangent, keyframes (K, 18) and constants (C,), as GTSAM's: a vector for each variable."""
    out = gtsam.VectorValues()
    for k, x in enumerate(keyframes):
        for key, part in zip(keyframe_keys(k), _PARTS, strict=True):
            out.insert(key, x[part])
    for name, key in KEYS.items():
        out.insert(key, constants[COLUMNS[name]])
    return out


_PARTS = (slice(0, 6), VELOCITY, slice(9, 15), OFFSET)
