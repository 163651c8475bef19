"""Samples made up where they are missing: what a kart on the path of its fixes would have felt."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.gnss_path import GnssMotion
from smoother.estimate.initial.align import Alignment
from smoother.estimate.initial.missing_samples import FORGOTTEN, SPACINGS, TOLD, MissingSamples
from smoother.estimate.model.imu import bin_imu
from smoother.frames import rotation_from_euler
from smoother.samples import ImuSamples
from smoother.units import DEG, STANDARD_GRAVITY

RADIUS, LATENCY = 20.0, 0.15
GYRO_BIAS, ACCEL_BIAS = np.array([0.02, -0.05, 0.03]), np.array([0.1, -0.2, 0.05])
R_BS = rotation_from_euler(2.0, -0.7, 1.1)


@dataclass(frozen=True)
class Circle:
    """A path round a circle that swings to and fro: speed m/s, faster and slower by `swing`. Late by LATENCY."""

    speed: float
    swing: float = 0.0
    position_latency: float = 0.0

    def angle(self, t: Array, derivative: int = 0) -> Array:
        """How far round, rad, or its derivatives."""
        wave = self.swing * np.sin(t + 0.5 * np.pi * derivative)
        steady = (self.speed / RADIUS * t, np.full(len(t), self.speed / RADIUS), np.zeros(len(t)))[derivative]
        return np.asarray(steady + wave)

    def at(self, t: Array) -> GnssMotion:
        """As a GnssPath would say."""
        angle, rate, change = (self.angle(t - LATENCY, i) for i in range(3))
        out, along, zero = (
            np.array([np.cos(angle), np.sin(angle)]),
            np.array([-np.sin(angle), np.cos(angle)]),
            0.0 * t,
        )
        position, velocity = RADIUS * out, RADIUS * rate * along
        acceleration = RADIUS * (change * along - rate**2 * out)
        vectors = (np.column_stack([*value, zero]) for value in (position, velocity, acceleration))
        return GnssMotion(*vectors, np.zeros((len(t), 3)))

    def felt(self, t: Array) -> tuple[Array, Array]:
        """Force and rate (N, 3) in s of a kart on it that neither slides nor leans, biases included."""
        rate, change = self.angle(t, 1), self.angle(t, 2)
        force_b = np.column_stack([RADIUS * change, RADIUS * rate**2, np.full(len(t), STANDARD_GRAVITY)])
        rate_b = np.column_stack([0.0 * t, 0.0 * t, rate])
        return force_b @ R_BS + ACCEL_BIAS, rate_b @ R_BS + GYRO_BIAS


def made_up(
    path: Circle, holes: list[tuple[float, float]], *, noise: float = 0.0, every: float = 0.2, level_only: bool = False
) -> MissingSamples:
    """Of samples at 100 Hz for 20 s with holes, the rate's noise rad/s; fixes with speeds in every so many s."""
    t = np.arange(0.01, 20.0, 0.01)
    for begin, end in holes:
        t = t[(t <= begin) | (t >= end)]
    force, rate = path.felt(t)
    rate = rate + noise * np.random.default_rng(0).standard_normal(rate.shape)
    at = np.arange(0.0, 20.0, every)
    gnss = SimpleNamespace(t=at, velocity_n=np.zeros((len(at), 3)))
    alignment = Alignment(R_BS, GYRO_BIAS, 0.0, 0.9, level_only)
    return MissingSamples(ImuSamples(t, force, rate), path, alignment, LATENCY, gnss)  # type: ignore[arg-type]


@pytest.mark.parametrize("hole", [(4.0, 4.3), (4.0, 14.0)])
def test_a_kart_that_neither_slides_nor_leans_has_felt_what_is_made_up(hole: tuple[float, float]) -> None:
    path = Circle(15.0, swing=0.3)
    t = np.linspace(*hole, 30)[1:-1]
    force, rate = made_up(path, [hole]).at(t)
    want_force, want_rate = path.felt(t)
    np.testing.assert_allclose(rate, want_rate, atol=1e-6)
    assert np.max(np.abs(force - want_force)) < np.max(np.abs(ACCEL_BIAS)) + 1e-6  # it is forgotten in long holes


def test_what_is_made_up_in_a_hole_does_not_depend_on_other_holes() -> None:
    path, holes = Circle(15.0, swing=0.3), [(-1.0, 2.0), (4.0, 4.1), (4.3, 5.0), (12.0, 21.0)]
    some = made_up(path, holes, noise=1.0)
    times = [np.linspace(begin + 0.02, end - 0.02, 10) for begin, end in holes]
    alone = [np.hstack(some.at(t)) for t in times]
    np.testing.assert_allclose(np.hstack(some.at(np.concatenate(times))), np.concatenate(alone), atol=1e-9)
    assert np.all(np.abs(np.concatenate(alone)) < 50.0)


def test_noise_at_the_edges_is_averaged() -> None:
    path, hole = Circle(15.0), (4.0, 4.3)
    t = np.linspace(*hole, 30)[1:-1]
    _, rate = made_up(path, [hole], noise=1.0).at(t)
    off = np.mean(rate - path.felt(t)[1], axis=0)
    assert np.max(np.abs(off)) < 3.0 / np.sqrt(2 * 10)  # ten samples on either side


def test_what_differs_beside_the_hole_is_forgotten_in_it() -> None:
    slides = Circle(15.0)  # the samples are of a kart at 15 m/s, the path of one at 12
    samples = made_up(slides, [(4.0, 14.0)])
    samples = MissingSamples(samples.imu, Circle(12.0), samples.alignment, LATENCY, samples.gnss)  # type: ignore[arg-type]
    begin, middle = samples.at(np.array([4.01, 9.0]))[1] @ R_BS.T - GYRO_BIAS @ R_BS.T
    assert begin[2] == pytest.approx(15.0 / RADIUS, rel=0.02)
    assert middle[2] == pytest.approx(12.0 / RADIUS, rel=0.02)


def test_at_rest_and_where_the_nose_may_point_anywhere_nothing_turns() -> None:
    for samples in (made_up(Circle(0.5), [(4.0, 14.0)]), made_up(Circle(15.0), [(4.0, 14.0)], level_only=True)):
        force, rate = samples.at(np.array([9.0]))
        np.testing.assert_allclose(rate[0], GYRO_BIAS, atol=1e-4)
        np.testing.assert_allclose(force[0] @ R_BS.T, [0.0, 0.0, STANDARD_GRAVITY], atol=1e-3)


def test_fixes_say_how_long_nothing_is_told() -> None:
    keyframes, hole = 5.0 + 0.2 * np.arange(11), np.full(10, 9.0)
    often, seldom = (made_up(Circle(15.0), [(4.0, 14.0)], every=every) for every in (0.2, 2.0))
    np.testing.assert_allclose(often.blind(keyframes, hole), np.tile([0.2, 0.4], (10, 1)))
    np.testing.assert_allclose(seldom.blind(keyframes, hole), np.tile([1.0, 2.0], (10, 1)))
    np.testing.assert_allclose(often.blind(keyframes, 0.01 * hole), 0.09)  # a hole is no longer than it is
    slow = made_up(Circle(0.5), [(4.0, 14.0)])
    np.testing.assert_allclose(slow.blind(keyframes, hole), np.tile([0.2, 9.0], (10, 1)))


def test_each_interval_is_told_by_the_fixes_around_it_the_last_one_by_those_before() -> None:
    keyframes, hole = np.array([4.9, 5.1, 6.9, 7.1, 13.0, 13.2]), np.full(5, 99.0)
    usual = made_up(Circle(15.0), [(4.0, 14.0)])
    gnss = SimpleNamespace(t=np.array([0.0, 5.0, 5.5, 8.0, 11.0]), velocity_n=np.zeros((5, 3)))
    found = replace(usual, gnss=gnss).blind(keyframes, hole)  # type: ignore[arg-type]
    middle = 0.5 * (keyframes[1:] + keyframes[:-1]) + LATENCY
    between = np.array([0.5, 2.5, 2.5, 3.0, middle[-1] - 8.0])
    assert [5.0 < middle[0] < 5.5, middle[-1] > 11.0] == [True, True]
    np.testing.assert_allclose(found[:, 0], np.maximum(TOLD[0], SPACINGS[0] * between))


def test_what_differs_on_the_two_sides_of_a_hole_goes_over_from_one_to_the_other() -> None:
    before, after = 1.0, 3.0  # rad/s
    samples = made_up(Circle(15.0), [(4.0, 4.4)])
    begin, end = samples.imu.t[samples.imu.t < 4.2][-1], samples.imu.t[samples.imu.t > 4.2][0]
    more = np.where(samples.imu.t <= begin, before, after)[:, None] * R_BS[2]
    imu = replace(samples.imu, angular_rate_s=samples.imu.angular_rate_s + more)
    t = np.linspace(begin, end, 9)[1:-1]
    made = replace(samples, imu=imu).at(t)[1] @ R_BS.T - samples.at(t)[1] @ R_BS.T
    share = (t - begin) / (end - begin)
    want = (1.0 - share) * np.exp(-(t - begin) / FORGOTTEN) * before + share * np.exp(-(end - t) / FORGOTTEN) * after
    np.testing.assert_allclose(made, np.column_stack([0.0 * t, 0.0 * t, want]), atol=1e-9)


def test_a_stated_latency_does_not_move_the_time_without_fixes() -> None:
    keyframes, hole = np.array([9.2, 9.4]), np.full(1, 9.0)
    usual = made_up(Circle(15.0), [(4.0, 14.0)])
    for path, latency in ((Circle(15.0), 0.5), (Circle(15.0, position_latency=0.5), 0.0)):
        gnss = SimpleNamespace(t=np.array([0.0, 9.6, 19.0]), velocity_n=np.zeros((3, 3)))
        some = replace(usual, path=path, latency=latency, gnss=gnss)  # type: ignore[arg-type]
        np.testing.assert_allclose(some.blind(keyframes, hole), [[0.5 * 9.4, 9.0]])


def test_bins_hold_what_is_made_up_in_place_of_a_line_from_edge_to_edge() -> None:
    path = Circle(15.0, swing=0.5)
    samples = made_up(path, [(4.0, 14.0)])
    t = np.arange(2.0, 17.0, 0.2)
    binned, whole = (
        bin_imu(imu, t, 10, np.zeros(3), GYRO_BIAS, samples.at) for imu in (samples.imu, made_up(path, []).imu)
    )
    assert np.max(np.abs(binned.angular_rate_s - whole.angular_rate_s)) < 0.5 * DEG
    line = bin_imu(samples.imu, t, 10, np.zeros(3), GYRO_BIAS)
    assert np.max(np.abs(line.angular_rate_s - whole.angular_rate_s)) > 20.0 * DEG
