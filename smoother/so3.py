"""Rotations: exp, log, skew and the numerical Jacobian that checks the analytic ones.

All functions work on stacks: a leading shape (...,) is carried through. Rotation matrices multiply from the left,
`v_n = R_nb @ v_b`; perturbations are on the right, `R @ exp(w)`, as in GTSAM.
"""

from collections.abc import Callable

import numpy as np

from smoother.arrays import Array


def skew(w: Array) -> Array:
    """Cross-product matrix: `skew(a) @ b = a x b`. w : (..., 3). Returns (..., 3, 3)."""
    w = np.asarray(w, dtype=np.float64)
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -w[..., 2], w[..., 1]
    out[..., 1, 0], out[..., 1, 2] = w[..., 2], -w[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -w[..., 1], w[..., 0]
    return out


def axial(w: Array, identity: Array, cross: Array, outer: Array) -> Array:
    """Matrix `identity * I + cross * skew(w) + outer * w w^T`, as all functions of a turn are. w : (..., 3).

    identity, cross, outer : (...,). Returns (..., 3, 3).
    """
    ahead = w.ndim - 1
    along = np.ascontiguousarray(w.transpose(ahead, *range(ahead)))  # each component in one piece
    crossed, scaled, out = cross * along, outer * along, np.empty((3, 3, *along.shape[1:]))
    for i in range(3):
        np.add(scaled[i] * along[i], identity, out=out[i, i, ...])
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        product = scaled[i] * along[j]
        np.add(product, crossed[k], out=out[i, j, ...])
        np.subtract(product, crossed[k], out=out[j, i, ...])
    return np.ascontiguousarray(out.transpose(*range(2, ahead + 2), 0, 1))


def squared(w: Array) -> Array:
    """Squared lengths (...,) of w : (..., 3). Component by component: sums over short axes are slow."""
    return np.asarray(w[..., 0] ** 2 + w[..., 1] ** 2 + w[..., 2] ** 2)


def exp(w: Array) -> Array:
    """Rotation matrix of the rotation vector w : (..., 3) rad. Returns (..., 3, 3). Source: Rodrigues' formula."""
    w = np.asarray(w, dtype=np.float64)
    angle2 = squared(w)
    small = angle2 < 1e-8  # the series is exact to 1e-17 below this
    safe = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe)
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(angle) / angle)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(angle)) / safe)
    return axial(w, 1.0 - b * angle2, a, b)


def log(R: Array) -> Array:
    """Rotation vector of R : (..., 3, 3), the shortest one. Returns (..., 3) rad. Exact up to and at half a turn."""
    q = quaternion_wxyz(R)
    vector = q[..., 1:]
    norm = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(norm, q[..., :1])
    factor = np.where(norm < 1e-9, 2.0, angle / np.where(norm < 1e-9, 1.0, norm))
    return np.asarray(factor * vector)


def quaternion_wxyz(R: Array) -> Array:
    """Unit quaternion (w, x, y, z), w >= 0, of R : (..., 3, 3). Returns (..., 4).

    Source: Markley 2008, "Unit quaternion from rotation matrix": the largest of four equivalent columns.
    """
    R = np.asarray(R, dtype=np.float64)
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    if np.all(trace > 0.0):  # turns of less than 120 deg, whose w is large enough
        q = np.stack(
            [1.0 + trace, R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]],
            axis=-1,
        )
        return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))
    candidates = np.empty((*R.shape[:-2], 4, 4))
    candidates[..., 0, 0] = 1.0 + trace
    candidates[..., 0, 1] = candidates[..., 1, 0] = R[..., 2, 1] - R[..., 1, 2]
    candidates[..., 0, 2] = candidates[..., 2, 0] = R[..., 0, 2] - R[..., 2, 0]
    candidates[..., 0, 3] = candidates[..., 3, 0] = R[..., 1, 0] - R[..., 0, 1]
    for i in range(3):
        candidates[..., i + 1, i + 1] = 1.0 + 2.0 * R[..., i, i] - trace
        for j in range(i + 1, 3):
            candidates[..., i + 1, j + 1] = candidates[..., j + 1, i + 1] = R[..., i, j] + R[..., j, i]
    largest = np.argmax(np.diagonal(candidates, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(candidates, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q))


def from_quaternion_wxyz(q: Array) -> Array:
    """Rotation matrix of the unit quaternion q : (..., 4) as (w, x, y, z). Returns (..., 3, 3)."""
    q = np.asarray(q, dtype=np.float64)
    w, v = q[..., :1, None], q[..., 1:]
    V = skew(v)
    return np.asarray(np.eye(3) + 2.0 * w * V + 2.0 * (V @ V))


def normalized(R: Array) -> Array:
    """Return the rotation nearest to R : (..., 3, 3), in the sense of the Frobenius norm."""
    U, _, Vt = np.linalg.svd(R)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)


def numerical_jacobian(function: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Central-difference Jacobian of `function` at x : (n,). Returns (m, n)."""
    x = np.asarray(x, dtype=np.float64)
    columns = []
    for i in range(x.size):
        d = np.zeros(x.size)
        d[i] = step
        columns.append((np.asarray(function(x + d)) - np.asarray(function(x - d))) / (2.0 * step))
    return np.stack(columns, axis=-1)


def rotation_to_up(up_s: Array) -> Array:
    """Return the smallest rotation that takes the unit vector up_s (3,) to (0, 0, 1). Returns (3, 3)."""
    up = np.array([0.0, 0.0, 1.0])
    axis = np.cross(up_s, up)
    sine, cosine = float(np.linalg.norm(axis)), float(up_s @ up)
    if sine < 1e-9:
        return np.eye(3) if cosine > 0.0 else np.diag([1.0, -1.0, -1.0])
    return exp(axis / sine * np.arctan2(sine, cosine))
