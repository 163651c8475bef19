"""Covariances of a chain: those of gtsam.Marginals and of a dense inverse, whatever the factors."""

import gtsam
import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.factors.gaussian import CONSTANTS_BLOCK, block, columns_of, linear_factors
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import CONSTANTS, CONSTANTS_SIZE, KEYFRAME_SIZE, SIZES
from smoother.estimate.solvers.covariance import Chain

ALL, ALL_NAMES = np.arange(CONSTANTS_SIZE), tuple(SIZES)


def random_system(rng: np.random.Generator, n: int) -> tuple[gtsam.GaussianFactorGraph, Array]:
    """A chain of n keyframes with IMU factors, measurements in some intervals and priors; and its information."""
    interval = np.sort(rng.integers(0, n - 1, 3 * n))
    shape = (len(interval), 2, KEYFRAME_SIZE)
    constants = {c.name: rng.standard_normal((len(interval), 2, c.size)) for c in CONSTANTS[::2]}
    unknown = rng.random((len(interval), 2)) < 0.2
    sigma = np.where(unknown, np.inf, rng.uniform(0.5, 2.0, unknown.shape))
    rows = Rows(
        "random",
        interval,
        np.zeros(unknown.shape),
        sigma,
        rng.standard_normal(shape),
        rng.standard_normal(shape),
        constants,
        rng.uniform(0.1, 1.0, len(interval)),
    )
    system = linear_factors([imu_like(rng, n, ALL_NAMES), rows], n - 1, ALL_NAMES)
    for key, size in [*((block(k), KEYFRAME_SIZE) for k in range(n)), (CONSTANTS_BLOCK, CONSTANTS_SIZE)]:
        system.add(key, 0.3 * rng.standard_normal((size, size)) + np.eye(size), np.zeros(size), unit(size))
    return system, system.hessian(ordering(n))[0]


def imu_like(rng: np.random.Generator, n: int, names: tuple[str, ...]) -> Rows:
    """Rows of 15 in all intervals, of the constants that are named."""
    shape = (n - 1, 15)
    left, right = rng.standard_normal((2, *shape, KEYFRAME_SIZE))
    constants = {name: rng.standard_normal((*shape, SIZES[name])) for name in names}
    one = np.ones(shape)
    return Rows("imu", np.arange(n - 1), np.zeros(shape), one, left, right, constants, one[:, 0])


def ordering(n: int) -> gtsam.Ordering:
    return gtsam.Ordering([*map(block, range(n)), CONSTANTS_BLOCK])


def unit(size: int) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Unit.Create(size)


def chain_of(system: gtsam.GaussianFactorGraph, n: int) -> Chain:
    return Chain.of(system.eliminateSequential(ordering(n)), ALL, np.zeros(CONSTANTS_SIZE))


@pytest.mark.parametrize("n", [3, 4, 11])
def test_they_are_the_blocks_of_the_inverse(n: int) -> None:
    system, information = random_system(np.random.default_rng(n), n)
    dense, found = np.linalg.inv(information), chain_of(system, n).covariances()
    constants = slice(n * KEYFRAME_SIZE, None)
    for k in range(n):
        own = slice(k * KEYFRAME_SIZE, (k + 1) * KEYFRAME_SIZE)
        np.testing.assert_allclose(found.keyframes[k], dense[own, own], atol=1e-9)
        np.testing.assert_allclose(found.with_constants[k], dense[own, constants], atol=1e-9)
        if k + 1 < n:
            after = slice(own.stop, own.stop + KEYFRAME_SIZE)
            np.testing.assert_allclose(found.neighbours[k], dense[own, after], atol=1e-9)
    np.testing.assert_allclose(found.constants, dense[constants, constants], atol=1e-9)


def test_they_are_those_of_gtsam_marginals() -> None:
    n = 9
    system, _ = random_system(np.random.default_rng(1), n)
    found = chain_of(system, n).covariances()
    values = gtsam.Values()
    marginals = gtsam.Marginals(system, values)
    for k in range(n):
        np.testing.assert_allclose(found.keyframes[k], marginals.marginalCovariance(block(k)), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.constants, marginals.marginalCovariance(CONSTANTS_BLOCK), rtol=1e-6, atol=1e-9)


def test_constants_that_nothing_measures_stay_at_their_priors() -> None:
    """Left out of the system they have the covariance of their priors, and all else is as with them."""
    n, rng = 5, np.random.default_rng(6)
    measured = ALL_NAMES[:3] + ALL_NAMES[5:]
    sigma, found, imu = rng.uniform(0.5, 2.0, CONSTANTS_SIZE), [], imu_like(rng, n, measured)
    for names in (ALL_NAMES, measured):
        system, some = linear_factors([imu], n - 1, names), columns_of(names)
        for k in range(n):
            system.add(block(k), np.eye(KEYFRAME_SIZE), np.zeros(KEYFRAME_SIZE), unit(KEYFRAME_SIZE))
        system.add(CONSTANTS_BLOCK, np.diag(1.0 / sigma[some]), np.zeros(len(some)), unit(len(some)))
        found.append(Chain.of(system.eliminateSequential(ordering(n)), some, sigma**2).covariances())
    np.testing.assert_allclose(found[1].constants, found[0].constants, atol=1e-9)
    np.testing.assert_allclose(found[1].keyframes, found[0].keyframes, atol=1e-9)
    np.testing.assert_allclose(found[1].with_constants, found[0].with_constants, atol=1e-9)


def test_the_joint_of_any_functions_is_that_of_the_inverse() -> None:
    n, q, rng = 40, 25, np.random.default_rng(3)
    system, information = random_system(rng, n)
    first = rng.integers(0, n - 1, q)
    left, right = rng.standard_normal((2, q, KEYFRAME_SIZE))
    constants = rng.standard_normal((q, CONSTANTS_SIZE))
    A = np.zeros((q, len(information)))
    for i, k in enumerate(first.tolist()):
        A[i, k * KEYFRAME_SIZE : (k + 1) * KEYFRAME_SIZE] = left[i]
        A[i, (k + 1) * KEYFRAME_SIZE : (k + 2) * KEYFRAME_SIZE] = right[i]
    A[:, n * KEYFRAME_SIZE :] = constants
    expected = A @ np.linalg.inv(information) @ A.T
    np.testing.assert_allclose(chain_of(system, n).joint(first, left, right, constants), expected, atol=1e-9)


def test_a_thinned_chain_has_the_same_covariance_of_its_keyframes() -> None:
    n, every = 13, 4
    system, _ = random_system(np.random.default_rng(4), n)
    whole = chain_of(system, n)
    few, all_of_them = whole.thinned(every).covariances(), whole.covariances()
    np.testing.assert_allclose(few.keyframes, all_of_them.keyframes[::every], atol=1e-9)
    np.testing.assert_allclose(few.with_constants, all_of_them.with_constants[::every], atol=1e-9)
    for n in (14, 15):  # keyframes behind the last one that is kept
        chain = chain_of(random_system(np.random.default_rng(n), n)[0], n)
        np.testing.assert_allclose(
            chain.thinned(every).covariances().keyframes, chain.covariances().keyframes[::every], atol=1e-9
        )


def test_free_constants_follow_those_that_are_held() -> None:
    n, rng = 6, np.random.default_rng(8)
    chain = chain_of(random_system(rng, n)[0], n)
    free = np.array([3, 4, 9])
    others = np.delete(ALL, free)
    np.testing.assert_allclose(chain.with_constants(chain.constants, free).constants, chain.constants, atol=1e-12)
    root = rng.standard_normal((CONSTANTS_SIZE, CONSTANTS_SIZE))
    held = root @ root.T
    found = chain.with_constants(held, free).constants
    information = np.linalg.inv(chain.constants)
    follow = -np.linalg.solve(information[np.ix_(free, free)], information[np.ix_(free, others)])
    of_others = held[np.ix_(others, others)]
    np.testing.assert_allclose(found[np.ix_(others, others)], of_others)
    np.testing.assert_allclose(found[np.ix_(free, others)], follow @ of_others, atol=1e-9)
    left = np.linalg.inv(information[np.ix_(free, free)])
    np.testing.assert_allclose(found[np.ix_(free, free)], left + follow @ of_others @ follow.T, atol=1e-9)
