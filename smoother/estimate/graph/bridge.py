"""Where there are no samples for long: a level kart that points along the path of the fixes, and feels what that does.

Made-up samples that know nothing of the path would have the graph find attitudes that explain the difference, tens of
degrees off, and velocities worse than those of the fixes alone. These come from the fixes, and must not tell anything
that the fixes have yet to tell, the delays above all: constants are found without them (:func:`where_sampled`).
"""

from dataclasses import replace

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release, roomy
from smoother.estimate.align import MIN_SPEED
from smoother.estimate.gnss_path import GnssPath
from smoother.estimate.graph.imu import TOGETHER, BinnedImu
from smoother.frames import GRAVITY_N, rotation_from_euler


def along_path(path: GnssPath, t: Array, latency: float, R_bs: Array) -> Array | None:
    """Attitude R_ns (K, 3, 3) at t (K,) s of a box of mounting R_bs on a level kart that points where the path goes.

    At rest it points where it did and will. latency s: of the fixes. None where the path never moves.
    """
    velocity_n = path.at(t + latency - path.position_latency).velocity_n
    moving = np.hypot(velocity_n[:, 0], velocity_n[:, 1]) > MIN_SPEED
    if not np.any(moving):
        return None
    course = np.unwrap(np.arctan2(velocity_n[moving, 1], velocity_n[moving, 0]))
    level = np.zeros(len(t))
    return np.asarray(rotation_from_euler(level, level, np.interp(t, t[moving], course)) @ R_bs)


def with_path(
    binned: BinnedImu, at: BoolArray, path: GnssPath, latency: float, R_ns: Array, biases: tuple[Array, Array]
) -> BinnedImu:
    """Return the bins, those of the intervals `at` (K-1,) as they would be along the path, level.

    R_ns (K, 3, 3): attitudes at the keyframes; latency s: of the fixes; biases (3,) of force and rate, m/s^2 and rad/s.
    """
    force, rate, T = roomy(binned.specific_force_s.shape), roomy(binned.angular_rate_s.shape), binned.dt * binned.n_bins
    shares, (accel_bias, gyro_bias) = np.arange(binned.n_bins + 1) / binned.n_bins, biases
    late = latency - path.position_latency
    for part in pieces(len(at), TOGETHER):
        force[part], rate[part] = binned.specific_force_s[part], binned.angular_rate_s[part]
        k = part.start + np.flatnonzero(at[part])
        edges = binned.t[k, None] + T * shares
        velocity_n = path.at(edges.ravel() + late).velocity_n.reshape(*edges.shape, 3)
        acceleration_n = np.diff(velocity_n, axis=1) / binned.dt
        acceleration_n[:, :, 2] = 0.0
        turn = so3.log(R_ns[k].transpose(0, 2, 1) @ R_ns[k + 1])
        R_bins = R_ns[k, None] @ so3.exp(shares[:-1, None] * turn[:, None])
        force[k] = np.einsum("kbji,kbj->kbi", R_bins, acceleration_n - GRAVITY_N) + accel_bias
        rate[k] = (turn / T)[:, None] + gyro_bias
        release(binned, force, rate)
    rough = None if binned.rough is None else np.where(at[:, None], 1.0, binned.rough)
    level = np.sqrt(path.covariance[:2, :, 2, 2].mean(axis=0))
    path_sigma = np.where(at, np.interp(binned.t[:-1] + 0.5 * T + late, path.t, level), 0.0)
    return replace(binned, specific_force_s=force, angular_rate_s=rate, rough=rough, path_sigma=path_sigma)
