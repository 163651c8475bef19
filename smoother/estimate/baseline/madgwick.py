"""Madgwick's orientation filter of 2010, as the thesis uses it: MARG form with a field reading, IMU form without.

Source: Madgwick 2010, "An efficient orientation filter for inertial and inertial/magnetic sensor arrays"; equation
numbers in the code are that report's. Symbols: q is the attitude of the sensor in an Earth frame whose x axis points to
magnetic north and z up (the conjugate of the report's, so `R(q)` takes sensor to Earth); beta, rad/s, weighs the
correction; zeta, rad/s^2, lets the gyro's bias follow it.

The gradient is that of a function on all quaternions, so it has a part along q that depends on the sensor's axes. The
baseline therefore turns the readings first and starts from the unit quaternion, as the thesis does.

Erratum: listing 5.G sets the two gains as `beta=.13, alpha=.04`, and eq. 2.45 speaks of alpha. The report has no such
gain; its second one is zeta, and the value is read so.
"""

from collections.abc import Iterator
from math import sqrt

import numpy as np

from smoother.arrays import Array
from smoother.estimate.baseline.steps import CHUNK, collect

BETA, ZETA = 0.13, 0.04  # listing 5.G
Quaternion = tuple[float, float, float, float]
Sample = tuple[float, list[float], list[float], list[float] | None]


def run_madgwick(
    step: Array,
    specific_force: Array,
    angular_rate: Array,
    field: Array | None,
    start: Array,
    beta: float = BETA,
    zeta: float = ZETA,
) -> tuple[Array, Array]:
    """Attitudes and gyro biases after each sample.

    step (N,) s, of which the sample is the mean; specific_force (N, 3) of any unit, up at rest; angular_rate (N, 3)
    rad/s; field (N, 3) of any unit, a row of NaN where there is no reading, None without a magnetometer; start (4,)
    unit quaternion wxyz. Returns quaternions (N, 4) wxyz and biases (N, 3) rad/s.
    """
    states = _states(_samples(step, specific_force, angular_rate, field), tuple(start.tolist()), beta, zeta)
    rows = collect(states, len(step), 7)
    return rows[:, :4], rows[:, 4:]


def _samples(step: Array, specific_force: Array, angular_rate: Array, field: Array | None) -> Iterator[Sample]:
    """Plain floats, which are twenty times as fast as numpy scalars; in chunks, as in `collect`."""
    for i in range(0, len(step), CHUNK):
        chunk = slice(i, i + CHUNK)
        readings: list[list[float] | None] = [None] * len(step[chunk])
        if field is not None:
            readings = _rows_or_none(field[chunk])
        yield from zip(
            step[chunk].tolist(), specific_force[chunk].tolist(), angular_rate[chunk].tolist(), readings, strict=True
        )


def _rows_or_none(field: Array) -> list[list[float] | None]:
    known = np.all(np.isfinite(field), axis=1) & np.any(field != 0.0, axis=1)
    return [row if is_known else None for row, is_known in zip(field.tolist(), known.tolist(), strict=True)]


def _states(
    samples: Iterator[Sample], q: Quaternion, beta: float, zeta: float
) -> Iterator[tuple[float, float, float, float, float, float, float]]:
    """Quaternion and bias after each sample."""
    bx = by = bz = 0.0
    for dt, (ax, ay, az), (gx, gy, gz), m in samples:
        w, x, y, z = q
        if m is None:
            sw, sx, sy, sz = _gravity_gradient(q, ax, ay, az)
        else:
            sw, sx, sy, sz = _gravity_and_field_gradient(q, ax, ay, az, *m)
        gain = 2.0 * zeta * dt  # eq. 47 to 49: the error of the rate is 2 conj(q) s
        bx += gain * (w * sx - x * sw - y * sz + z * sy)
        by += gain * (w * sy - y * sw - z * sx + x * sz)
        bz += gain * (w * sz - z * sw - x * sy + y * sx)
        gx, gy, gz = gx - bx, gy - by, gz - bz
        # eq. 12 and 43: rate of q from the gyro, less beta along the gradient
        w, x, y, z = (
            w + dt * (0.5 * (-x * gx - y * gy - z * gz) - beta * sw),
            x + dt * (0.5 * (w * gx + y * gz - z * gy) - beta * sx),
            y + dt * (0.5 * (w * gy - x * gz + z * gx) - beta * sy),
            z + dt * (0.5 * (w * gz + x * gy - y * gx) - beta * sz),
        )
        scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
        q = (w * scale, x * scale, y * scale, z * scale)
        yield (*q, bx, by, bz)


def _gravity_gradient(q: Quaternion, ax: float, ay: float, az: float) -> Quaternion:
    """Unit gradient of eq. 25 and 26; zero where the force is zero or already along the estimated up."""
    w, x, y, z = q
    length = sqrt(ax * ax + ay * ay + az * az)
    if length == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    fx = 2.0 * (x * z - w * y) - ax / length
    fy = 2.0 * (w * x + y * z) - ay / length
    fz = 1.0 - 2.0 * (x * x + y * y) - az / length
    return _unit(
        2.0 * (x * fy - y * fx),
        2.0 * (z * fx + w * fy) - 4.0 * x * fz,
        2.0 * (z * fy - w * fx) - 4.0 * y * fz,
        2.0 * (x * fx + y * fy),
    )


def _gravity_and_field_gradient(
    q: Quaternion, ax: float, ay: float, az: float, mx: float, my: float, mz: float
) -> Quaternion:
    """Unit gradient of eq. 31 and 32, the field's reference made from the reading itself (eq. 45 and 46).

    That reference has the measured inclination and no west component, so a disturbance can turn the estimate about up
    but not tilt it.
    """
    w, x, y, z = q
    length = sqrt(ax * ax + ay * ay + az * az)
    if length == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    ax, ay, az = ax / length, ay / length, az / length
    length = sqrt(mx * mx + my * my + mz * mz)
    mx, my, mz = mx / length, my / length, mz / length
    ww, wx, wy, wz = w * w, w * x, w * y, w * z
    xx, xy, xz, yy, yz, zz = x * x, x * y, x * z, y * y, y * z, z * z
    hx = (ww + xx - yy - zz) * mx + 2.0 * (xy - wz) * my + 2.0 * (xz + wy) * mz
    hy = 2.0 * (xy + wz) * mx + (ww - xx + yy - zz) * my + 2.0 * (yz - wx) * mz
    bz = 2.0 * (xz - wy) * mx + 2.0 * (yz + wx) * my + (ww - xx - yy + zz) * mz
    bx = sqrt(hx * hx + hy * hy)
    fx = 2.0 * (xz - wy) - ax
    fy = 2.0 * (wx + yz) - ay
    fz = 1.0 - 2.0 * (xx + yy) - az
    ex = bx * (1.0 - 2.0 * (yy + zz)) + 2.0 * bz * (xz - wy) - mx
    ey = 2.0 * bx * (xy - wz) + 2.0 * bz * (wx + yz) - my
    ez = 2.0 * bx * (wy + xz) + bz * (1.0 - 2.0 * (xx + yy)) - mz
    return _unit(
        2.0 * (x * fy - y * fx - bz * y * ex + (bz * x - bx * z) * ey + bx * y * ez),
        2.0 * (z * fx + w * fy - 2.0 * x * fz + bz * z * ex + (bx * y + bz * w) * ey + (bx * z - 2.0 * bz * x) * ez),
        2.0
        * (
            z * fy
            - w * fx
            - 2.0 * y * fz
            - (2.0 * bx * y + bz * w) * ex
            + (bx * x + bz * z) * ey
            + (bx * w - 2.0 * bz * y) * ez
        ),
        2.0 * (x * fx + y * fy + (bz * x - 2.0 * bx * z) * ex + (bz * y - bx * w) * ey + bx * x * ez),
    )


def _unit(w: float, x: float, y: float, z: float) -> Quaternion:
    length = sqrt(w * w + x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return w / length, x / length, y / length, z / length
