"""The mounting from path and attitude, on states whose slip and lean are known."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.model.imu import are_observed
from smoother.estimate.model.state import State
from smoother.estimate.output.mounting import (
    FittedMounting,
    along_wheels,
    fit_mounting,
    swing_on_the_wheel,
)
from smoother.frames import rotation_from_euler
from smoother.trajectory import Keyframes
from smoother.units import DEG

from .still_state import state_of

K, INTERVAL = 1500, 0.2
ROUGH = 4.0 * DEG


def state_of_drive(
    R_bs: np.ndarray, slip: float, lean: float, noise: float, seed: int = 0, turns: float = 0.1
) -> State:
    """A kart on winding road: slip angle, roll and pitch in proportion to acceleration, plus noise, all in rad.

    slip, lean: rad per m/s^2. turns: share by which one side outweighs the other.
    """
    rng = np.random.default_rng(seed)
    t = INTERVAL * np.arange(K)
    speed = 14.0 + 4.0 * np.sin(0.31 * t)
    course_rate = 0.5 * (np.sin(0.4 * t) + np.sin(0.17 * t)) + turns
    course = np.cumsum(course_rate) * INTERVAL
    left, forward = speed * course_rate, 4.0 * 0.31 * np.cos(0.31 * t)
    roll, pitch, slide = noise * rng.normal(size=(3, K))
    R_nb = rotation_from_euler(lean * left + roll, -lean * forward + pitch, course + slip * left + slide)
    velocity_n = np.stack([speed * np.cos(course), speed * np.sin(course), np.zeros(K)], axis=1)
    return state_of(t, R_nb @ R_bs, velocity_n)


def rough(R_bs: np.ndarray, seed: int) -> np.ndarray:
    return so3.exp(ROUGH * np.random.default_rng(100 + seed).uniform(-1.0, 1.0, 3)) @ R_bs


def random_rotation(seed: int) -> np.ndarray:
    return so3.exp(np.random.default_rng(seed).normal(size=3) * 2.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_known_mounting_is_found_though_the_kart_slides_and_leans_with_its_acceleration(seed: int) -> None:
    R_bs = random_rotation(seed)
    state = state_of_drive(R_bs, slip=0.6 * DEG, lean=0.3 * DEG, noise=0.5 * DEG, seed=seed)
    found = fit_mounting(state, rough(R_bs, seed))
    assert found.is_observable
    assert np.max(np.abs(so3.log(found.R_bs @ R_bs.T))) < 0.15 * DEG


def test_more_turns_to_one_side_do_not_pass_for_a_crooked_mounting() -> None:
    R_bs = random_rotation(1)
    state = state_of_drive(R_bs, slip=1.0 * DEG, lean=0.5 * DEG, noise=0.2 * DEG, turns=0.3)
    found = fit_mounting(state, R_bs)
    error = so3.log(found.R_bs @ R_bs.T)
    mean_slip = 1.0 * DEG * 14.0 * 0.3  # what an average would have taken for mounting: 4 deg
    assert np.abs(error[2]) < 0.05 * mean_slip
    assert np.abs(error[0]) < 0.05 * mean_slip


@pytest.mark.parametrize("corner", [1.0, 2.0, 6.0])
def test_sigma_covers_the_error_of_slips_however_long_they_last(corner: float) -> None:
    """Errors in units of sigma over drives whose slips last for `corner` seconds, which the fit has to find out."""
    normalised = []
    for seed in range(30):
        R_bs = random_rotation(seed)
        rng = np.random.default_rng(1000 + seed)
        state = state_of_drive(R_bs, slip=0.6 * DEG, lean=0.3 * DEG, noise=0.0, seed=seed)
        n = round(corner / INTERVAL)
        wander = np.repeat(2.0 * DEG * rng.normal(size=(K // n + 1, 3)), n, axis=0)[:K]
        R_nb = state.R_ns @ R_bs.T @ so3.exp(wander)
        found = fit_mounting(replace(state, R_ns=R_nb @ R_bs), rough(R_bs, seed))
        normalised.append(so3.log(R_bs @ found.R_bs.T) / found.sigma)
    rms = np.sqrt(np.mean(np.square(normalised)))
    assert 0.8 < rms < 1.3  # 90 values: one by 8 %, and the correlation is found from a hundred corners


def uphill(state: State, R_bs: np.ndarray, slope: float) -> State:
    """The same drive on a road that climbs all the way."""
    R_nb = state.R_ns @ R_bs.T
    speed = np.hypot(state.velocity_n[:, 0], state.velocity_n[:, 1])
    up = state.velocity_n + np.outer(slope * speed, [0.0, 0.0, 1.0])
    axis_n = (
        np.cross(state.velocity_n, [0.0, 0.0, 1.0]) / speed[:, None]
    )  # to the right; a turn about it lifts the nose
    return replace(state, R_ns=so3.exp(np.arctan(slope) * axis_n) @ R_nb @ R_bs, velocity_n=up)


@pytest.mark.parametrize("slope", [0.09, -0.05])
def test_a_road_that_climbs_all_the_way_does_not_pass_for_a_crooked_mounting(slope: float) -> None:
    R_bs = random_rotation(4)
    state = state_of_drive(R_bs, slip=0.6 * DEG, lean=0.3 * DEG, noise=0.5 * DEG)
    found = fit_mounting(uphill(state, R_bs, slope), R_bs)
    assert np.max(np.abs(so3.log(found.R_bs @ R_bs.T))) < 0.15 * DEG


def test_the_sigma_of_pitch_contains_the_mean_slope_of_the_road() -> None:
    R_bs = random_rotation(4)
    state = state_of_drive(R_bs, slip=0.6 * DEG, lean=0.3 * DEG, noise=0.5 * DEG)
    length = float(np.sum(np.hypot(state.velocity_n[:, 0], state.velocity_n[:, 1]))) * INTERVAL
    known, unsure = (fit_mounting(state, R_bs, None, sigma).sigma for sigma in (0.0, 30.0))
    assert np.hypot(known[1], 30.0 / length) == pytest.approx(unsure[1])
    np.testing.assert_array_equal(known[[0, 2]], unsure[[0, 2]])
    away = replace(state, position_n=np.outer(np.linspace(0.0, 0.5 * length, K), [0.6, -0.8, 0.0]))
    laps, road = (fit_mounting(each, R_bs, None, None).sigma for each in (state, away))
    assert laps[1] == pytest.approx(known[1])  # positions of `state` are all zero: it came back
    assert road[1] == pytest.approx(np.hypot(known[1], 0.025), rel=0.01)


def test_wild_slides_are_left_out() -> None:
    R_bs = random_rotation(2)
    state = state_of_drive(R_bs, slip=0.6 * DEG, lean=0.3 * DEG, noise=0.5 * DEG)
    spin = np.zeros((K, 3))
    spin[np.random.default_rng(0).random(K) < 0.05, 2] = 60.0 * DEG
    thrown = replace(state, R_ns=state.R_ns @ R_bs.T @ so3.exp(spin) @ R_bs)
    assert np.max(np.abs(so3.log(fit_mounting(thrown, rough(R_bs, 0)).R_bs @ R_bs.T))) < 0.5 * DEG


def test_a_kart_that_hardly_moved_keeps_the_rough_mounting_with_its_sigma() -> None:
    R_bs = random_rotation(3)
    state = state_of_drive(R_bs, 0.0, 0.0, 0.0)
    slow = replace(state, velocity_n=0.1 * state.velocity_n)
    found = fit_mounting(slow, R_bs)
    assert not found.is_observable
    np.testing.assert_array_equal(found.R_bs, R_bs)
    assert np.all(found.sigma > 40.0 * DEG)


def keyframes_of_drive(wheel: float, lean: float, unsure: float, column: float = 50.0 * DEG) -> Keyframes:
    """A kart that slides and leans outwards, seen by a box on a column that leans back by `column` rad.

    wheel: rms rad of how hands move it about where the bend needs it; lean: rad of roll, rms; unsure: sigma rad.
    """
    state = state_of_drive(np.eye(3), slip=0.4 * DEG, lean=0.05 * DEG, noise=0.0)
    rng = np.random.default_rng(5)
    quick = np.convolve(rng.normal(size=K), [0.25, 0.5, 0.25], mode="same") / np.sqrt(0.375)
    axis = np.array([-np.sin(column), 0.0, np.cos(column)])
    R_nb = state.R_ns @ so3.exp(quick[:, None] * wheel * axis) @ so3.exp(rng.normal(size=(K, 1)) * [lean, 0.0, 0.0])
    covariance = np.tile(np.diag([unsure**2] * 9), (K, 1, 1))
    zeros = np.zeros((K, 3))
    return Keyframes(state.t, zeros, state.velocity_n, R_nb, covariance, zeros, zeros, zeros, zeros)


@pytest.mark.parametrize("column", [30.0 * DEG, 60.0 * DEG])
def test_a_logger_that_turns_with_the_steering_wheel_is_noticed(column: float) -> None:
    swing = swing_on_the_wheel(keyframes_of_drive(10.0 * DEG, 0.5 * DEG, 1.0 * DEG, column))
    assert swing is not None
    roll, pitch, yaw = swing / DEG
    assert roll == pytest.approx(10.0 * np.sin(column), rel=0.15)
    assert pitch == 0.0
    assert 10.0 * np.cos(column) < yaw < 10.0 * np.cos(column) + 2.0  # the kart slides as well


@pytest.mark.parametrize(
    ("wheel", "lean", "unsure"),
    [
        (0.0, 0.5 * DEG, 0.5 * DEG),  # a box in the floor
        (2.0 * DEG, 0.5 * DEG, 0.5 * DEG),  # a chassis that twists
        (0.0, 6.0 * DEG, 1.0 * DEG),  # a loose box rocks, but does not turn
        (10.0 * DEG, 0.5 * DEG, 9.0 * DEG),  # an attitude that is not known
    ],
)
def test_no_other_logger_is_taken_for_one_on_the_wheel(wheel: float, lean: float, unsure: float) -> None:
    assert swing_on_the_wheel(keyframes_of_drive(wheel, lean, unsure)) is None


def test_on_a_wheel_attitudes_have_the_sigma_of_its_swing() -> None:
    unsure = keyframes_of_drive(10.0 * DEG, 0.5 * DEG, 9.0 * DEG)
    swing = swing_on_the_wheel(unsure, is_steered=True)
    assert swing is not None
    assert swing[0] > 3.0 * DEG
    assert swing_on_the_wheel(keyframes_of_drive(0.0, 0.5 * DEG, 9.0 * DEG), is_steered=True) is None


def test_attitudes_in_a_hole_of_the_samples_have_no_say() -> None:
    R_bs = random_rotation(2)
    state = state_of_drive(R_bs, slip=0.6 * DEG, lean=0.3 * DEG, noise=0.5 * DEG)
    missing = np.zeros(len(state.t) - 1)
    missing[100 : len(missing) // 2] = 1.0
    made_up = np.flatnonzero(missing)[1:]  # between the keyframes on either side
    R_ns = state.R_ns.copy()
    R_ns[made_up] = R_ns[made_up] @ so3.exp(np.array([0.4, -0.3, 0.5]))
    found = fit_mounting(replace(state, R_ns=R_ns), R_bs, missing)
    assert np.max(np.abs(so3.log(found.R_bs @ R_bs.T))) < 0.3 * DEG


def test_samples_on_one_side_tell_a_keyframe() -> None:
    missing = np.array([0.0, 0.8, 0.1, 0.9, 1.0, 0.5])
    np.testing.assert_array_equal(are_observed(missing), [1, 1, 1, 1, 0, 0, 0])
    assert np.all(are_observed(np.array([0.0, 1.0, 0.0, 1.0, 0.0])))  # bursts in every other interval tell all


def test_the_heading_from_slip_is_beside_axes_that_are_not_quite_level() -> None:
    """Of an alignment with few fixes: 8 deg off level, half a radian off the nose."""
    R_bs = so3.exp(np.array([[0.3, -0.8, 2.0]]))[0]
    tilted = so3.exp(np.array([[8.0 * DEG, -8.0 * DEG, 0.0]]))[0]
    axes = tilted @ so3.exp(np.array([[0.0, 0.0, -0.5]]))[0] @ R_bs
    axis_b = R_bs @ axes[0]  # its direction on level ground, and how far the nose is to the left of it
    offset = -np.arctan2(axis_b[1], axis_b[0])
    state = state_of(np.arange(2.0), np.tile(np.eye(3), (2, 1, 1)), axes_s=axes, slip=np.array([offset, 0.0, 0.0, 0.0]))
    askew = so3.exp(np.array([[0.0, 0.0, 0.1]]))[0] @ R_bs
    found = along_wheels(FittedMounting(askew, np.full(3, 0.01), True, True), state, 0.02**2)
    np.testing.assert_allclose(found.R_bs, R_bs, atol=1e-12)
    assert found.by_wheels
    assert found.sigma[2] == pytest.approx(0.02)
