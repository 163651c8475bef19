"""Alignment by fixes that are rare, on drives whose mounting, biases and lag are known."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.initial.align import align
from smoother.estimate.initial.align_rare import RareAlignment, align_rare
from smoother.estimate.output.problems import LEAST_EXPLAINED_OF_CHANGES
from smoother.estimate.preprocess.streams import PathMotion
from smoother.samples import ImuSamples
from smoother.sim.motion import Motion, drive
from smoother.sim.scenario import ImuErrors
from smoother.sim.sensors import simulate_imu
from smoother.sim.track import TRACKS
from smoother.sim.truth import Truth
from smoother.units import DEG

DURATION = 250.0
LAG = 0.23
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
ON_ITS_SIDE = so3.exp(np.array([0.4, 1.3, -0.7]))
FAR_OFF = np.array([4.0, -3.0, -58.0]) * DEG  # per s, of a real box


@pytest.fixture(scope="module")
def truth() -> Truth:
    """Laps of a track with bends to both sides, after 5 s of standing."""
    return drive(TRACKS["larkfield"], Motion(standstill=5.0), DURATION, np.random.default_rng(4))


def box(truth: Truth, R_bs: np.ndarray, gyro_bias: np.ndarray) -> ImuSamples:
    errors = ImuErrors(
        accel_noise=0.5, gyro_noise=3.0 * DEG, accel_bias=np.array([0.3, -0.2, 0.2]), gyro_bias=gyro_bias
    )
    raw = simulate_imu(truth, errors, R_bs, DURATION, np.random.default_rng(0)).raw
    return ImuSamples(raw.t, raw.accel, raw.gyro)


def fixes(truth: Truth, every: float, noise: float = 0.15) -> PathMotion:
    t = np.arange(1.0, DURATION - 2.0, every)
    velocity_n = truth.at(np.maximum(t - LAG, 0.0)).velocity_n
    velocity_n = velocity_n + noise * np.random.default_rng(0).normal(size=velocity_n.shape)
    return PathMotion(t, velocity_n)


def found(imu: ImuSamples, path: PathMotion) -> RareAlignment:
    rare = align_rare(imu, path)
    assert rare is not None
    return rare


@pytest.mark.parametrize("every", [3.0, 5.0, 10.0])
@pytest.mark.parametrize("R_bs", [np.eye(3), UPSIDE_DOWN, ON_ITS_SIDE])
def test_mounting_bias_and_lag_are_found_whatever_the_kart_does_between_fixes(
    truth: Truth, every: float, R_bs: np.ndarray
) -> None:
    rare = found(box(truth, R_bs, FAR_OFF), fixes(truth, every))
    assert np.linalg.norm(so3.log(rare.R_bs @ R_bs.T)) < 6.0 * DEG
    assert np.linalg.norm(rare.gyro_bias_s - FAR_OFF) < 1.5 * DEG
    assert abs(rare.lag - LAG) < 0.1
    assert rare.turned > 0.95 and rare.moved > 0.95


def test_a_bias_of_a_whole_turn_from_fix_to_fix_is_found_by_the_velocities(truth: Truth) -> None:
    one_turn = np.array([0.0, 0.0, 36.0 * DEG])  # in 10 s
    rare = found(box(truth, np.eye(3), one_turn), fixes(truth, 10.0))
    assert rare.gyro_bias_s[2] == pytest.approx(one_turn[2], abs=1.0 * DEG)


@pytest.mark.parametrize("late", [-31.0, 9.0, 17.0])
def test_samples_of_another_time_do_not_turn_as_the_course_does(truth: Truth, late: float) -> None:
    imu = box(truth, np.eye(3), np.zeros(3))
    rare = found(replace(imu, t=imu.t + late), fixes(truth, 5.0))
    assert min(rare.turned, rare.moved) < 0.6


def test_samples_of_a_mirrored_box_are_not_of_the_drive(truth: Truth) -> None:
    imu = box(truth, np.eye(3), np.zeros(3))
    mirrored = replace(imu, specific_force_s=imu.specific_force_s * [1.0, -1.0, 1.0])
    rare = found(mirrored, fixes(truth, 5.0))
    assert min(rare.turned, rare.moved) < LEAST_EXPLAINED_OF_CHANGES


def test_a_straight_road_and_a_handful_of_fixes_tell_nothing(truth: Truth) -> None:
    imu, path = box(truth, np.eye(3), np.zeros(3)), fixes(truth, 5.0)
    straight = replace(path, velocity_n=path.speed[:, None] * np.array([1.0, 0.0, 0.0]))
    assert align_rare(imu, straight) is None
    assert align_rare(imu, PathMotion(path.t[:15], path.velocity_n[:15])) is None


def test_what_was_not_sampled_between_two_fixes_does_not_count(truth: Truth) -> None:
    imu, path = box(truth, ON_ITS_SIDE, FAR_OFF), fixes(truth, 5.0)
    in_hole = (imu.t % 60.0 > 30.0) & (imu.t % 60.0 < 33.0)
    holed = ImuSamples(imu.t[~in_hole], imu.specific_force_s[~in_hole], imu.angular_rate_s[~in_hole])
    rare = found(holed, path)
    assert np.linalg.norm(so3.log(rare.R_bs @ ON_ITS_SIDE.T)) < 6.0 * DEG
    assert rare.turned > 0.95 and rare.moved > 0.95


def test_only_measured_velocities_that_are_rare_are_aligned_so(truth: Truth) -> None:
    imu, path = box(truth, np.eye(3), np.zeros(3)), fixes(truth, 5.0)
    assert align(imu, path).by_changes
    assert align(imu, path).share_explained > 0.95
    assert not align(imu, replace(path, is_measured=False)).by_changes
    assert not align(imu, fixes(truth, 1.0)).by_changes
