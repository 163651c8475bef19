"""What no result may hang on: where on Earth a kart drives, which way round, when, and how its box lies.

The recording is changed in a way whose effect on the result is known exactly; the result has to change by just that.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.smoother import GraphSmoother
from smoother.frames import Origin, euler_from_rotation, nwu_to_geodetic, rotation_from_euler, wrap_angle
from smoother.prepare import choose_origin, prepare
from smoother.samples import RawSession
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import Trajectory

LATER = 86_399.5  # s
TURN = rotation_from_euler(0.0, 0.0, 1.3)  # of the world about up
LEANS = rotation_from_euler(2.0, -0.4, 0.9)  # of the box
MIRROR = np.diag([1.0, -1.0, 1.0])  # east and west
ELSEWHERE = Origin(-37.85, 179.9995, 12.0)  # a track that the date line crosses
# of a sigma: what rounding and the order of sums change; and what priors of biases do, and the last step of an
# iteration that begins elsewhere, where the box's own figures are others
ROUNDED, SETTLED = 0.005, 0.15


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A change of a recording, and what takes the result of the changed one back: times, and vectors in n (3, 3).

    within : of a sigma, what comes back.
    """

    change: Callable[[RawSession], RawSession]
    within: float = ROUNDED
    later: float = 0.0
    vectors: Array = field(default_factory=lambda: np.eye(3))


def with_sensors(raw: RawSession, force: Array, rate: Array) -> RawSession:
    """The recording with force and rate of the box multiplied by matrices (3, 3), without a compass."""
    assert raw.imu is not None
    return replace(raw, imu=replace(raw.imu, accel=raw.imu.accel @ force.T, gyro=raw.imu.gyro @ rate.T))


def with_offsets(raw: RawSession) -> RawSession:
    imu = raw.imu
    assert imu is not None
    accel = imu.accel + np.array([0.3, -0.25, 0.2]) / imu.accel_scale
    return replace(raw, imu=replace(imu, accel=accel, gyro=imu.gyro + np.array([0.03, -0.05, 0.04]) / imu.gyro_scale))


def later(raw: RawSession) -> RawSession:
    assert raw.imu is not None
    at_zero = None if raw.unix_at_zero is None else raw.unix_at_zero - LATER
    imu, gnss = replace(raw.imu, t=raw.imu.t + LATER), replace(raw.gnss, t=raw.gnss.t + LATER)
    return replace(raw, imu=imu, gnss=gnss, unix_at_zero=at_zero)


def in_world(raw: RawSession, matrix: Array, origin: Origin | None = None) -> RawSession:
    """The recording with places and velocities multiplied by `matrix` (3, 3), around the same origin or another."""
    gnss, here = raw.gnss, choose_origin(raw.gnss)
    lat, lon, alt = nwu_to_geodetic(gnss.position_n(here) @ matrix.T, origin or here)
    level = gnss.velocity_n[:, :2] @ matrix[:2, :2].T
    velocity = np.column_stack([level, gnss.velocity_n[:, 2]])
    course = np.degrees(-np.arctan2(level[:, 1], level[:, 0])) % 360.0
    moved = replace(gnss, lat_deg=lat, lon_deg=lon, alt_m=alt, velocity_n=velocity, course_deg=course)
    return replace(raw, gnss=moved)


def mirrored(raw: RawSession) -> RawSession:
    """Left and right exchanged: a rate is an axial vector, and keeps the component across the mirror."""
    box = np.diag([-1.0, 1.0, 1.0])
    return with_sensors(in_world(raw, MIRROR), box, -box)


SYMMETRIES = {
    "the box lies another way": Symmetry(lambda raw: with_sensors(raw, LEANS, LEANS), SETTLED),
    "its sensors are off by more": Symmetry(with_offsets, SETTLED),
    "a day later": Symmetry(later, later=LATER),
    "the track is turned": Symmetry(lambda raw: in_world(raw, TURN), vectors=TURN),
    "the track is mirrored": Symmetry(mirrored, vectors=MIRROR),
    "across the date line in the south": Symmetry(lambda raw: in_world(raw, np.eye(3), ELSEWHERE), SETTLED),
}


@cache
def recording() -> RawSession:
    """Two minutes of a kart, without a compass: the field does not turn with the track."""
    return replace(simulate_preset("kart", 5, duration=120.0).raw, mag=None)


@cache
def as_given() -> Trajectory:
    return GraphSmoother().estimate(prepare(recording()))


@pytest.mark.parametrize("name", SYMMETRIES)
def test_the_result_changes_by_just_that(name: str) -> None:
    symmetry, want = SYMMETRIES[name], as_given()
    found = GraphSmoother().estimate(prepare(symmetry.change(recording())))
    assert found.t == pytest.approx(want.t + symmetry.later, abs=1e-6)
    back, sigmas = symmetry.vectors, want.sigmas
    place = found.position_n @ back - want.position_n
    place -= place.mean(axis=0)  # n begins at the first fix, which the date line may make another one
    turned = back.T @ found.R_nb @ np.diag([1.0, np.linalg.det(back), 1.0])
    angles = wrap_angle(np.stack(euler_from_rotation(turned), axis=-1) - want.euler)
    speed = found.velocity_n @ back - want.velocity_n
    for apart, sigma in ((place, sigmas.position_n), (speed, sigmas.velocity_n), (angles, sigmas.attitude)):
        most = float(np.max(np.abs(apart) / sigma))
        assert most < symmetry.within
    for sigma, other in ((found.sigmas.attitude, sigmas.attitude), (found.sigmas.speed, sigmas.speed)):
        most = float(np.max(np.abs(other / sigma - 1.0)))
        assert most < symmetry.within


def test_a_delay_of_all_samples_is_one_of_both_latencies() -> None:
    late = 0.1
    raw, want = recording(), as_given().report.identified
    assert raw.imu is not None
    found = GraphSmoother().estimate(prepare(replace(raw, imu=replace(raw.imu, t=raw.imu.t - late)))).report.identified
    for name in ("gps_position_latency", "gps_velocity_latency"):
        one, other, sigma = (np.asarray(v) for v in (want[name].value, found[name].value, want[name].sigma))
        assert abs(other - one - late) < 0.3 * sigma
