"""The magnetometer from laps alone, on simulated karts."""

import numpy as np
import pytest

from smoother.fit.ellipsoid import FitError
from smoother.fit.level_field import fit_level_field, up_from_turning
from smoother.frames import wrap_angle
from smoother.sim.simulation import simulate_preset


@pytest.fixture(scope="module", params=[1, 2])
def drive(request):
    return simulate_preset("kart", request.param, duration=120.0)


def si(imu):
    return imu.accel * imu.accel_scale, imu.gyro * imu.gyro_scale


def test_up_is_the_axis_of_turning_however_the_box_is_mounted(drive):
    imu = drive.raw.imu
    up = up_from_turning(imu.t, *si(imu))
    true = drive.scenario.R_bs.T @ [0.0, 0.0, 1.0]
    assert np.degrees(np.arccos(up @ true)) < 3.0  # kerbs and gyro misalignment of 0.5 deg


def heading_error(drive, field_s):
    attitude = drive.truth.at(drive.raw.mag.t).R_nb @ drive.scenario.R_bs
    field_n = np.einsum("nij,nj->ni", attitude, field_s)
    north = np.arctan2(drive.field_n[1], drive.field_n[0])
    return np.degrees(wrap_angle(np.arctan2(field_n[:, 1], field_n[:, 0]) - north))


def test_the_heading_becomes_right_although_only_part_was_observable(drive):
    imu, mag = drive.raw.imu, drive.raw.mag
    inclination = np.arctan2(-drive.field_n[2], np.hypot(*drive.field_n[:2]))
    fit = fit_level_field(mag.t, mag.field, up_from_turning(imu.t, *si(imu)), inclination)
    before = heading_error(drive, mag.field)
    after = heading_error(drive, (mag.field - fit.hard_iron) @ fit.matrix.T)
    assert np.sqrt(np.mean(before**2)) > 25.0
    assert np.sqrt(np.mean(after**2)) < 6.0  # of which 2.5 are noise and 2 the engine's
    assert len(fit.assumed) == 3
    error = fit.level.T @ (fit.hard_iron - drive.scenario.mag.hard_iron_s)
    assert np.all(np.abs(error) < 4.0 * fit.centre_sigma)


def ring(n=2000, headings=2.0 * np.pi, noise=0.2, seed=0):
    rng = np.random.default_rng(seed)
    turn = np.linspace(0.0, headings, n)
    field = np.stack([10.0 + 20.0 * np.cos(turn), 5.0 + 25.0 * np.sin(turn), np.full(n, -37.0)], axis=1)
    return np.arange(n) * 0.1, field + noise * rng.standard_normal((n, 3))


UP = np.array([0.0, 0.0, 1.0])


def test_the_calibrated_field_is_a_unit_vector_that_dips_as_it_should():
    t, field = ring()
    fit = fit_level_field(t, field, UP, np.radians(60.0))
    unit = (field - fit.hard_iron) @ fit.matrix.T
    np.testing.assert_allclose(np.linalg.norm(unit[:, :2], axis=1), np.cos(np.radians(60.0)), rtol=0.04)
    np.testing.assert_allclose(unit[:, 2], -np.sin(np.radians(60.0)), atol=0.02)
    np.testing.assert_allclose(fit.hard_iron[:2], [10.0, 5.0], atol=0.1)


@pytest.mark.parametrize(
    ("readings", "says"),
    [
        (ring(headings=3.0), "do not show all headings"),
        ((np.arange(3.0), np.ones((3, 3))), "too few"),
        ((np.arange(500.0), np.ones((500, 3))), "hardly change"),
        ((np.arange(500.0), np.full((500, 3), np.nan)), "not numbers"),
        ((np.arange(3000) * 0.1, np.random.default_rng(1).normal(size=(3000, 3))), "do not lie"),
    ],
    ids=["half a lap", "three", "constant", "nan", "cloud"],
)
def test_drives_that_show_too_little_are_refused(readings, says):
    with pytest.raises(FitError, match=says):
        fit_level_field(*readings, UP, np.radians(60.0))


@pytest.mark.parametrize("unit", [1e-3, 1e3])  # readings in mT and in nT instead of uT
def test_the_unit_of_the_readings_changes_no_sigma(unit):
    t, field = ring()
    one, other = (fit_level_field(t, field * scale, UP, np.radians(60.0)) for scale in (1.0, unit))
    np.testing.assert_allclose(other.centre_sigma / unit, one.centre_sigma, rtol=1e-3)
    assert other.shape_sigma == pytest.approx(one.shape_sigma, rel=1e-3)


def test_a_box_that_never_turned_shows_no_up():
    t = np.arange(1000) / 100.0
    with pytest.raises(FitError, match="no turning about one axis"):
        up_from_turning(t, np.tile(UP, (1000, 1)), 0.01 * np.random.default_rng(2).standard_normal((1000, 3)))


def test_soft_iron_that_tilts_the_ellipse_is_undone():
    turn = np.linspace(0.0, 2.0 * np.pi, 2000)
    dip = np.radians(60.0)
    level = np.cos(dip) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    unit = np.column_stack([level, np.full(2000, -np.sin(dip))])
    iron = np.array([[1.1, 0.03, 0.1], [0.03, 0.95, -0.08], [0.1, -0.08, 1.0]])
    fit = fit_level_field(np.arange(2000) * 0.1, 48.0 * unit @ iron + [5.0, -9.0, 20.0], UP, dip)
    calibrated = (48.0 * unit @ iron + [5.0, -9.0, 20.0] - fit.hard_iron) @ fit.matrix
    np.testing.assert_allclose(calibrated[:, 2], -np.sin(dip), atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(calibrated[:, :2], axis=1), np.cos(dip), rtol=1e-3)
    off = np.degrees(np.arctan2(calibrated[:, 1], calibrated[:, 0])) - np.degrees(turn)
    assert np.max(np.abs((off + 180.0) % 360.0 - 180.0)) < 2.0  # the turn that a symmetric matrix assumes away
