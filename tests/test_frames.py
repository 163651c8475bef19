"""The conventions of frames.py, each by a truth that a person can check with a hand and three fingers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother import frames, so3
from smoother.frames import Origin
from smoother.units import DEG

HERE = Origin(44.95, 12.05, 3.0)


def test_gravity_points_down_and_cannot_be_changed() -> None:
    np.testing.assert_array_equal(frames.GRAVITY_N, [0.0, 0.0, -9.80665])
    with pytest.raises(ValueError, match="read-only"):
        frames.GRAVITY_N[2] = 0.0


def test_north_west_and_up_are_where_the_map_says() -> None:
    lat = np.array([HERE.lat_deg + 1e-3, HERE.lat_deg, HERE.lat_deg])
    lon = np.array([HERE.lon_deg, HERE.lon_deg + 1e-3, HERE.lon_deg])
    alt = np.array([3.0, 3.0, 10.0])
    north, east, up = frames.geodetic_to_nwu(lat, lon, alt, HERE)
    # a thousandth of a degree: 111.1 m of meridian and 78.9 m of the parallel of 44.95 deg on WGS-84
    np.testing.assert_allclose(north, [111.13, 0.0, 0.0], atol=0.05)
    np.testing.assert_allclose(east, [0.0, -78.92, 0.0], atol=0.05)
    np.testing.assert_allclose(up, [0.0, 0.0, 7.0], atol=1e-9)


@pytest.mark.parametrize("origin", [HERE, Origin(-33.9, 151.2, 40.0), Origin(0.0, 179.9999, 0.0)])
def test_geodetic_and_nwu_take_each_other_back(origin: Origin) -> None:
    position_n = np.random.default_rng(0).uniform(-2000.0, 2000.0, (100, 3))
    back = frames.geodetic_to_nwu(*frames.nwu_to_geodetic(position_n, origin), origin)
    np.testing.assert_allclose(back, position_n, atol=1e-6)  # a micrometre: the iteration of the library


def test_course_east_is_a_velocity_to_minus_west() -> None:
    v = frames.velocity_n_from_course(np.array([10.0, 10.0, 2.0, 3.0]), np.array([0.0, 90.0, 180.0, 270.0]))
    np.testing.assert_allclose(v[:, :2], [[10.0, 0.0], [0.0, -10.0], [-2.0, 0.0], [0.0, 3.0]], atol=1e-14)
    assert np.all(np.isnan(v[:, 2]))


def test_wrapped_angles_lie_in_the_half_open_circle() -> None:
    angle = np.array([0.0, np.pi, -np.pi, 3.0 * np.pi, 2.0 * np.pi, -0.1, 6.0])
    wrapped = frames.wrap_angle(angle)
    np.testing.assert_allclose(wrapped, [0.0, np.pi, np.pi, np.pi, 0.0, -0.1, 6.0 - 2.0 * np.pi], atol=1e-14)
    assert np.all((wrapped > -np.pi) & (wrapped <= np.pi))


def test_left_of_a_northward_course_is_west() -> None:
    forward = np.array([[2.0, 0.0, 9.0], [0.0, -1.0, 9.0]])  # north, and east
    np.testing.assert_array_equal(frames.to_left(forward, np.array([3.0, 5.0])), [10.0, 3.0])


def test_signs_of_roll_pitch_and_yaw() -> None:
    forward, left, up = np.eye(3)
    quarter = 0.3
    R = frames.rotation_from_euler(np.zeros(1), np.full(1, quarter), np.zeros(1))[0]
    assert (R @ forward)[2] < 0.0  # positive pitch is nose down
    R = frames.rotation_from_euler(np.full(1, quarter), np.zeros(1), np.zeros(1))[0]
    assert (R @ left)[2] > 0.0  # positive roll is right side down
    R = frames.rotation_from_euler(np.zeros(1), np.zeros(1), np.full(1, quarter))[0]
    assert (R @ forward)[1] > 0.0  # positive yaw turns the nose to the west
    np.testing.assert_allclose(R @ up, up)


def test_euler_angles_agree_with_an_independent_library_and_take_each_other_back() -> None:
    rng = np.random.default_rng(1)
    roll, yaw = rng.uniform(-np.pi, np.pi, (2, 200))
    pitch = rng.uniform(-89.0, 89.0, 200) * DEG
    R = frames.rotation_from_euler(roll, pitch, yaw)
    reference = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    np.testing.assert_allclose(R, reference, atol=1e-14)
    back = frames.euler_from_rotation(R)
    for got, want in zip(back, (roll, pitch, yaw), strict=True):
        np.testing.assert_allclose(frames.wrap_angle(got - want), 0.0, atol=1e-12)


@pytest.mark.parametrize("pitch", [np.pi / 2.0, -np.pi / 2.0])
def test_at_vertical_pitch_the_rotation_survives_with_zero_roll(pitch: float) -> None:
    R = frames.rotation_from_euler(np.full(1, 0.4), np.full(1, pitch), np.full(1, -1.1))
    roll, found, yaw = frames.euler_from_rotation(R)
    assert roll[0] == 0.0
    # arcsine is flat at a right angle: rounding of 1e-16 comes back as 1e-8
    np.testing.assert_allclose(frames.rotation_from_euler(roll, found, yaw), R, atol=3e-8)


def test_euler_jacobian_is_the_numerical_one() -> None:
    rng = np.random.default_rng(2)
    for _ in range(30):
        euler = rng.uniform([-3.0, -1.4, -3.0], [3.0, 1.4, 3.0])
        R = frames.rotation_from_euler(*euler)
        numerical = so3.numerical_jacobian(
            lambda w, R=R, euler=euler: frames.wrap_angle(np.stack(frames.euler_from_rotation(R @ so3.exp(w))) - euler),
            np.zeros(3),
        )
        np.testing.assert_allclose(frames.euler_jacobian(R), numerical, atol=1e-6)


def test_euler_jacobian_stays_finite_on_its_nose() -> None:
    R = frames.rotation_from_euler(np.zeros(2), np.array([np.pi / 2.0, -np.pi / 2.0]), np.zeros(2))
    assert np.all(np.isfinite(frames.euler_jacobian(R)))
