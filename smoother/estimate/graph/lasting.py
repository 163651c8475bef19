"""Errors of velocities that last for a second or two: what a drive does not show of them, and a stand does.

Receivers filter, and reflections last: of two modules in one car a part of the error, 0.021 m/s beside 0.036 m/s that
is white, goes on from velocity to velocity on the drive. It can not be seen there. Over the time that a path follows
velocities for, an error that is forgotten in a second or two is a random walk, and so is what noise of the force adds
up to: whatever is left of the velocities fits noisier samples as well, and has been put down to them. What else is
identified, delays, arm and attitude, is right: it rests on the sum of both. Velocities are not: the kart is said to
have moved as the receiver erred.

At rest all of a velocity is its error. The same two modules show 0.020 m/s there that lasts, against 0.021 on the
drive, though a quarter of what is white (`benchmarks/twins.py`, 0.2 s later). So what lasts at rest is taken to last on
the drive, by as much; a receiver that shows none, holds its speed at zero or never stood counts as it did. It is moved
from the force, whose noise it was taken for, to the velocities, which count at the number of independent ones that they
amount to.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.estimate.graph.inertial_noise import InertialNoise

TAU = 2.0  # s after which it is forgotten; the two modules at rest, up to 2 s
LONGEST = 3.0  # s between two velocities, up to which they tell of it; what lasts longer is a bias or nearly so
BEYOND_DOUBT = 1.5  # sigmas of what white velocities would show by chance, of which as much is taken off
MOST_LEFT = 0.98  # of the variance of velocities in that of the path: where these are all that is known
ROUNDS = 30  # of the fixed point; each leaves half of the difference at most


def lasting_at_rest(t: Array, velocity_n: Array, standing: BoolArray) -> float:
    """Sigma, m/s per level axis, of what lasts of the errors of velocities; 0 where nothing shows any.

    t (N,) s; velocity_n (N, 3) m/s, NaN where unknown; standing (N,): at rest, where a velocity is its own error.
    Products of two velocities, up to LONGEST apart, are fitted by the covariance of a Gauss-Markov process: least
    squares. Each has the variance of chance in white noise; what is found is drawn to zero as it is within that.
    """
    use = standing & np.all(np.isfinite(velocity_n[:, :2]), axis=1)
    if np.count_nonzero(use) < 2:
        return 0.0
    at, level = t[use], velocity_n[use, :2]
    products, weight = 0.0, 0.0
    for later in range(1, min(len(at) - 1, max(1, round(LONGEST / float(median(np.diff(t)))))) + 1):
        apart = at[later:] - at[:-later]
        shape = np.where(apart <= LONGEST, np.exp(-apart / TAU), 0.0)
        products += float(shape @ np.sum(level[later:] * level[:-later], axis=1))
        weight += 2.0 * float(shape @ shape)
    if products <= 0.0:
        return 0.0
    found, chance = products / weight, float(np.mean(level**2)) / math.sqrt(weight)
    return math.sqrt(found * max(0.0, 1.0 - (BEYOND_DOUBT * chance / found) ** 2))


@dataclass(frozen=True)
class Memory:
    """How a path remembers velocities, one in `every` s, between which its motion is known to a random walk.

    kept: share of the weight of a velocity that the next one has, to either side.
    """

    kept: float
    every: float

    @staticmethod
    def of(sigma: float, density: float, every: float) -> "Memory":
        """Of velocities with white noise of `sigma` m/s, and a walk of `density` m/s^2/sqrt(Hz) between them."""
        ratio = density**2 * every / sigma**2
        return Memory(1.0 + 0.5 * ratio - math.sqrt(ratio + 0.25 * ratio**2), every)

    @staticmethod
    def shown(sigma: float, variance: float, every: float) -> "Memory":
        """Of a path whose velocity is left with `variance`, (m/s)^2: of attitudes and vibration in it, too."""
        left = min(variance / sigma**2, MOST_LEFT)
        return Memory((1.0 - left) / (1.0 + left), every)

    @property
    def seconds(self) -> float:
        """Time, s, after which a velocity counts 1/e of what it did."""
        return self.every / (1.0 - self.kept)

    def density(self, sigma: float) -> float:
        """Density of the walk, m/s^2/sqrt(Hz), that this is the memory of, with velocities of `sigma` m/s."""
        return sigma * (1.0 - self.kept) / math.sqrt(self.kept * self.every)

    def variance(self, lasting: float) -> float:
        """Variance of white noise that errs a path by as much as a lasting error of `lasting` m/s does.

        Both as sums of the error's autocovariance times that of the weights: all of it where the memory is long.
        """
        left = self.kept * math.exp(-self.every / TAU)
        of_weights = (1.0 - self.kept**2) / (1.0 + self.kept**2)
        return lasting**2 * ((1.0 + left) / (1.0 - left) + of_weights * 2.0 * left / (1.0 - left) ** 2)


def counted(sigma: float, lasting: float, density: float, every: float) -> float:
    """Factor of the sigma, m/s, of velocities, by which they count as many as they amount to.

    lasting m/s: what lasts beside `sigma`; density m/s^2/sqrt(Hz): of the walk between them, one in `every` s.
    The path then errs by what it says: the less they count, the longer it remembers them.
    """
    variance = sigma**2
    for _ in range(ROUNDS):
        variance = sigma**2 + Memory.of(math.sqrt(variance), density, every).variance(lasting)
    return math.sqrt(variance) / sigma


def shared_out(
    noise: InertialNoise, lasting: float, memory: Memory, level_axes_s: Array, least: float
) -> tuple[InertialNoise, float, float]:
    """Noise of the force without the errors of velocities that it was taken for.

    Also the sigma, m/s, of these, and by how much the square of the density of level force is less. lasting m/s: at
    rest; memory: of a path that takes them for white. level_axes_s (3, 3): rows are forward, left and up in s. least
    m/s^2/sqrt(Hz): what is left of level force at least.
    An error that is forgotten with rate 1/TAU walks with density 2 lasting^2 / TAU; slower than that it does not, and
    a path with a long memory sees less of a walk in it. What lasts on the drive is no more than all of that noise.
    """
    up_s, covariance = level_axes_s[2], noise.accel**2 * np.array(noise.accel_shape)
    level = level_axes_s[:2] @ covariance @ level_axes_s[:2].T
    walk = 2.0 / (TAU + memory.seconds)  # squared density of a walk over the variance of what it was
    lasting = min(lasting, math.sqrt(0.5 * float(np.trace(level)) / walk))
    moved = min(walk * lasting**2, max(float(np.linalg.eigvalsh(level)[0]) - least**2, 0.0))
    covariance -= moved * (np.eye(3) - np.outer(up_s, up_s))
    mean = float(np.trace(covariance)) / 3.0
    a, b, c = (covariance / mean).tolist()
    return replace(noise, accel=math.sqrt(mean), accel_shape=(tuple(a), tuple(b), tuple(c))), lasting, moved
