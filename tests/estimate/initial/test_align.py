"""Alignment in motion on drives whose mounting, biases and lag are known."""

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.initial.align import Alignment, align, initial_attitude
from smoother.estimate.preprocess.streams import PathMotion
from smoother.frames import euler_from_rotation, rotation_from_euler, wrap_angle
from smoother.samples import ImuSamples
from smoother.sim.motion import Motion, drive
from smoother.sim.scenario import ImuErrors
from smoother.sim.sensors import simulate_imu
from smoother.sim.track import TRACKS
from smoother.sim.truth import Truth
from smoother.units import DEG

DURATION = 100.0
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
FIX_TIMES = np.arange(1.0, DURATION - 2.0, 0.2)


@pytest.fixture(scope="module")
def truth() -> Truth:
    """Four laps or so, after 5 s of standing."""
    return drive(TRACKS["larkfield"], Motion(standstill=5.0), DURATION, np.random.default_rng(4))


def box(truth: Truth, R_bs: np.ndarray, gyro_bias: np.ndarray, seed: int = 0) -> ImuSamples:
    """A box with a kart's vibration in its samples."""
    errors = ImuErrors(
        accel_noise=0.5, gyro_noise=3.0 * DEG, accel_bias=np.array([0.5, -0.4, 0.3]), gyro_bias=gyro_bias
    )
    raw = simulate_imu(truth, errors, R_bs, DURATION, np.random.default_rng(seed)).raw
    return ImuSamples(raw.t, raw.accel, raw.gyro)


def fixes(truth: Truth, lag: float = 0.0, t: np.ndarray = FIX_TIMES, seed: int = 0) -> PathMotion:
    """Motion as a receiver with Doppler tells it, `lag` seconds late; it does not say the vertical velocity."""
    states = truth.at(t - lag)
    velocity_n = states.velocity_n + 0.15 * np.random.default_rng(seed).normal(size=(len(t), 3))
    velocity_n[:, 2] = np.nan
    return PathMotion(t, velocity_n)


def random_rotation(seed: int) -> np.ndarray:
    return so3.exp(np.random.default_rng(seed).normal(size=3) * 2.0)


def turn_between(R: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(so3.log(R @ other.T)))


MOUNTINGS = [np.eye(3), UPSIDE_DOWN, so3.exp(np.array([0.0, 0.5 * np.pi, 0.0])), *map(random_rotation, range(5))]


@pytest.mark.parametrize("number", range(len(MOUNTINGS)))
def test_any_mounting_and_large_gyro_biases_are_found_in_motion(truth: Truth, number: int) -> None:
    R_bs = MOUNTINGS[number]
    gyro_bias = np.random.default_rng(number).uniform(-60.0, 60.0, 3) * DEG
    found = align(box(truth, R_bs, gyro_bias, number), fixes(truth))
    assert not found.is_level_only
    # a kart leans and slides by a degree or two in proportion to its acceleration, which passes for mounting
    assert turn_between(found.R_bs, R_bs) < 4.0 * DEG
    np.testing.assert_allclose(found.gyro_bias_s, gyro_bias, atol=1.0 * DEG)
    assert found.share_explained > 0.8


@pytest.mark.parametrize("lag", [0.0, 0.1, 0.25, 0.5])
def test_the_lag_of_the_fixes_is_found(truth: Truth, lag: float) -> None:
    R_bs = random_rotation(7)
    found = align(box(truth, R_bs, np.zeros(3)), fixes(truth, lag))
    # the nose turns before the path does, which adds a few hundredths
    assert found.lag == pytest.approx(lag, abs=0.06)
    assert turn_between(found.R_bs, R_bs) < 4.0 * DEG


@pytest.mark.parametrize("track", sorted(TRACKS))
def test_tracks_that_turn_to_either_side_will_do(track: str) -> None:
    truth = drive(TRACKS[track], Motion(standstill=0.0), DURATION, np.random.default_rng(1))
    R_bs, gyro_bias = random_rotation(3), np.array([0.3, -0.2, -1.0])
    found = align(box(truth, R_bs, gyro_bias), fixes(truth))
    assert turn_between(found.R_bs, R_bs) < 5.0 * DEG
    np.testing.assert_allclose(found.gyro_bias_s, gyro_bias, atol=1.5 * DEG)


def test_a_wild_fix_now_and_then_does_not_matter(truth: Truth) -> None:
    R_bs, path = random_rotation(2), fixes(truth)
    velocity_n = path.velocity_n.copy()
    velocity_n[::37] += np.array([15.0, -20.0, 0.0])
    found = align(box(truth, R_bs, np.zeros(3)), PathMotion(path.t, velocity_n))
    assert turn_between(found.R_bs, R_bs) < 5.0 * DEG


def test_the_initial_attitude_is_good_to_a_few_degrees_in_any_mounting(truth: Truth) -> None:
    R_bs, lag = random_rotation(5), 0.2
    imu, path = box(truth, R_bs, np.array([0.2, -0.1, 0.5])), fixes(truth, lag)
    t = np.arange(1.0, DURATION - 4.0, 0.2)
    R_ns = initial_attitude(t, imu, path, align(imu, path))
    states = truth.at(t)
    error = so3.log((states.R_nb @ R_bs).transpose(0, 2, 1) @ R_ns)
    moving = np.hypot(states.velocity_n[:, 0], states.velocity_n[:, 1]) > 3.0
    assert np.sqrt(np.mean(np.sum(error[moving] ** 2, axis=1))) < 5.0 * DEG
    assert np.max(np.linalg.norm(error, axis=1)) < 30.0 * DEG  # also at rest, where only the gyro speaks


class TestAtRest:
    @pytest.mark.parametrize("number", range(len(MOUNTINGS)))
    def test_a_session_at_rest_is_levelled_and_no_more(self, number: int) -> None:
        R_bs, rng = MOUNTINGS[number], np.random.default_rng(0)
        t = np.arange(1, 6001) / 200.0
        imu = ImuSamples(
            t,
            np.array([0.0, 0.0, 9.8]) @ R_bs + 0.05 * rng.normal(size=(6000, 3)),
            0.02 + 0.01 * rng.normal(size=(6000, 3)),
        )
        path = PathMotion(t[::40], 0.1 * rng.normal(size=(150, 3)))
        found = align(imu, path)
        assert found.is_level_only
        assert not found.problems  # of a parked kart nobody asks where it points
        np.testing.assert_allclose(found.gyro_bias_s, 0.02, atol=1e-3)
        roll, pitch, _ = euler_from_rotation(found.R_bs @ R_bs.T)
        assert abs(roll) < 0.1 * DEG
        assert abs(pitch) < 0.1 * DEG
        R_ns = initial_attitude(path.t, imu, path, found)
        np.testing.assert_allclose(
            R_ns @ R_bs.T @ [0.0, 0.0, 1.0], np.broadcast_to([0.0, 0.0, 1.0], (150, 3)), atol=2e-3
        )

    @pytest.mark.parametrize(("until", "codes"), [(8.0, []), (10.0, ["heading_unknown"])])
    def test_a_kart_that_moved_for_a_second_or_two_is_not_aligned_in_motion(
        self, truth: Truth, until: float, codes: list[str]
    ) -> None:
        path = fixes(truth, t=np.arange(1.0, until, 0.2))
        assert np.count_nonzero(path.speed > 3.0) < 30
        found = align(box(truth, np.eye(3), np.zeros(3)), path)
        assert found.is_level_only
        assert [p.code for p in found.problems] == codes

    def test_while_it_stands_the_yaw_follows_the_gyro(self) -> None:
        """Pushed round by hand between two runs: the course says nothing, the gyro everything."""
        t = np.arange(1, 12001) / 200.0
        rate = np.zeros((12000, 3))
        turning = (t > 25.0) & (t < 27.0)
        rate[turning, 2] = 0.25 * np.pi
        imu = ImuSamples(t, np.tile([0.0, 0.0, 9.8], (12000, 1)), rate)
        fix = t[39::40]
        course = np.where(fix < 26.0, 0.0, 0.5 * np.pi)
        speed = np.where((fix < 20.0) | (fix > 35.0), 10.0, 0.0)
        path = PathMotion(fix, np.stack([speed * np.cos(course), speed * np.sin(course), np.zeros(300)], axis=1))
        aligned = Alignment(np.eye(3), np.zeros(3), 0.0, 1.0, False)
        ask = np.array([10.0, 22.0, 26.0, 30.0, 50.0])
        yaw = euler_from_rotation(initial_attitude(ask, imu, path, aligned))[2]
        np.testing.assert_allclose(wrap_angle(yaw - 0.5 * np.pi * np.array([0.0, 0.0, 0.5, 1.0, 1.0])), 0.0, atol=0.02)


def slid_round(turned: float, ask: Array) -> Array:
    """Error of the yaw (K,), rad, at `ask` s of a kart that turns by `turned` rad while it slides straight on, stands
    for 5 s and drives off in the direction of before."""
    t = np.arange(1, 12001) / 200.0
    fraction = np.clip((t - 25.0) / 2.0, 0.0, 1.0)
    nose = turned * fraction**2 * (3.0 - 2.0 * fraction)
    rate = np.stack([np.zeros(12000), np.zeros(12000), np.gradient(nose, t)], axis=1)
    imu = ImuSamples(t, np.tile([0.0, 0.0, 9.8], (12000, 1)), rate)
    fix = t[39::40]
    speed = np.interp(fix, [0.0, 24.0, 27.0, 32.0, 36.0], [12.0, 12.0, 0.0, 0.0, 12.0])
    path = PathMotion(fix, np.stack([speed, np.zeros(300), np.zeros(300)], axis=1))
    R_ns = initial_attitude(ask, imu, path, Alignment(np.eye(3), np.zeros(3), 0.0, 1.0, False))
    return np.asarray(wrap_angle(euler_from_rotation(R_ns)[2] - np.interp(ask, t, nose)))


class TestSpin:
    @pytest.mark.parametrize("turned", [2.0 * np.pi, -2.0 * np.pi])
    def test_the_nose_is_the_gyros_in_a_spin_and_after(self, turned: float) -> None:
        """Once its turn is lost in the first guess, no solution finds it again."""
        np.testing.assert_allclose(slid_round(turned, np.arange(10.0, 50.0, 0.2)), 0.0, atol=0.03)


class TestRotationToUp:
    def test_it_takes_a_direction_up_by_the_shortest_way(self) -> None:
        directions = np.random.default_rng(0).normal(size=(50, 3))
        for up_s in directions / np.linalg.norm(directions, axis=1, keepdims=True):
            R = so3.rotation_to_up(up_s)
            np.testing.assert_allclose(R @ up_s, [0.0, 0.0, 1.0], atol=1e-12)
            np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
            assert np.linalg.norm(so3.log(R)) == pytest.approx(np.arccos(up_s[2]), abs=1e-7)

    @pytest.mark.parametrize("tiny", [0.0, 1e-12])
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_straight_up_and_straight_down_are_rotations_too(self, tiny: float, sign: float) -> None:
        R = so3.rotation_to_up(np.array([tiny, 0.0, sign]))
        np.testing.assert_allclose(R @ [0.0, 0.0, sign], [0.0, 0.0, 1.0], atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1.0)


SIGNS = [np.diag(signs) for signs in ([-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0])]
SWAPPED = np.eye(3)[[1, 0, 2]]


@pytest.mark.parametrize("mirror", [*SIGNS, SWAPPED, -np.eye(3)])
@pytest.mark.parametrize("seed", [0, 3])
def test_axes_that_are_left_handed_are_noticed(truth: Truth, mirror: np.ndarray, seed: int) -> None:
    imu, path = box(truth, random_rotation(seed), np.zeros(3)), fixes(truth, lag=0.15)
    assert align(imu, path).problems == ()
    (problem, *_) = align(ImuSamples(imu.t, imu.specific_force_s @ mirror, imu.angular_rate_s), path).problems
    assert problem.code == "imu_mirrored" and "wrong sign" in problem.text


def test_a_gyroscope_that_turns_the_wrong_way_is_noticed(truth: Truth) -> None:
    imu, path = box(truth, np.eye(3), np.zeros(3)), fixes(truth)
    (problem,) = align(ImuSamples(imu.t, imu.specific_force_s, imu.angular_rate_s @ SIGNS[2]), path).problems
    assert problem.code == "imu_axes_disagree" and ("180 deg" in problem.text or "17" in problem.text)


@pytest.mark.parametrize(
    ("force", "rate", "named"),
    [
        (np.eye(3), SIGNS[0], "the sign of gx is changed"),
        (np.eye(3), SWAPPED, "gx and gy are exchanged"),
        (-np.eye(3), np.eye(3), "the signs of ax, ay and az are changed"),
        (SIGNS[2], np.eye(3), "the sign of az is changed"),
        (SIGNS[1], SIGNS[1], "the signs of ax and gx are changed"),  # as good as those that were wrong
    ],
)
def test_the_wrong_axis_is_named_where_the_logger_is_askew(
    truth: Truth, force: np.ndarray, rate: np.ndarray, named: str
) -> None:
    imu, path = box(truth, rotation_from_euler(*np.array([-0.35, -0.93, 0.4])), np.zeros(3)), fixes(truth, lag=0.15)
    wrong = ImuSamples(imu.t, imu.specific_force_s @ force, imu.angular_rate_s @ rate)
    problems = align(wrong, path).problems
    assert problems
    assert all(named in problem.text for problem in problems)


def test_a_level_logger_does_not_distinguish_two_mistakes(truth: Truth) -> None:
    imu, path = box(truth, np.eye(3), np.zeros(3)), fixes(truth)
    (problem,) = align(ImuSamples(imu.t, imu.specific_force_s, imu.angular_rate_s @ SIGNS[2]), path).problems
    assert "fits once the sign of gz is changed or the signs of gx, gy and gz are changed" in problem.text
    (problem,) = align(ImuSamples(imu.t, imu.specific_force_s @ SWAPPED, imu.angular_rate_s), path).problems
    assert "fits once" not in problem.text


def test_noise_alone_is_not_called_left_handed(truth: Truth) -> None:
    rng = np.random.default_rng(7)
    t = np.arange(1, 20001) / 200.0
    for _ in range(20):
        force = rng.normal(size=(len(t), 3)) * 3.0 + np.array([0.0, 0.0, 9.8])
        assert align(ImuSamples(t, force, rng.normal(size=(len(t), 3))), fixes(truth)).problems == ()


def test_holes_in_the_samples_are_left_out(truth: Truth) -> None:
    """What would be averages across them were never measured."""
    R_bs = random_rotation(1)
    imu = box(truth, R_bs, np.zeros(3))
    seen = np.ones(len(imu.t), dtype=np.bool_)
    for begin in (15.0, 35.0, 55.0, 75.0):
        seen &= (imu.t < begin) | (imu.t > begin + 12.0)
    found = align(ImuSamples(imu.t[seen], imu.specific_force_s[seen], imu.angular_rate_s[seen]), fixes(truth))
    assert turn_between(found.R_bs, R_bs) < 4.0 * DEG
    assert found.share_explained > 0.8


def test_no_turn_is_lost_in_an_outage_that_the_gyro_drifts_through() -> None:
    """A skid pad, always round to one side, on which the alignment has the gyro's bias wrong by 13 degrees a second."""
    turning, bias = 0.8, 13.0 * DEG
    t = np.arange(0.0, 60.0, 0.01)
    rate_s = np.tile([0.0, 0.0, turning + bias], (len(t), 1))
    imu = ImuSamples(t, np.tile([0.0, 9.0, 9.81], (len(t), 1)), rate_s)
    fixes_t = np.concatenate([np.arange(0.0, 20.0, 0.2), np.arange(40.0, 60.0, 0.2)])  # 260 degrees of drift in between
    course = turning * fixes_t
    path = PathMotion(fixes_t, 10.0 * np.column_stack([np.cos(course), np.sin(course), np.nan * course]))
    found = initial_attitude(t, imu, path, Alignment(np.eye(3), np.zeros(3), 0.0, 1.0, False))
    off = wrap_angle(euler_from_rotation(found)[2] - turning * t)
    assert np.max(np.abs(off)) < 25.0 * DEG


def test_turns_in_a_hole_of_the_samples_are_those_of_the_course(truth: Truth) -> None:
    whole = box(truth, np.eye(3), np.zeros(3))
    keep = (whole.t < 30.0) | (whole.t > 50.0)
    holed = ImuSamples(whole.t[keep], whole.specific_force_s[keep], whole.angular_rate_s[keep])
    path, t = fixes(truth), np.arange(20.0, 60.0, 0.2)
    yaw = euler_from_rotation(initial_attitude(t, holed, path, align(holed, path)))[2]
    off = np.abs(wrap_angle(yaw - truth.euler(t)[:, 2]))
    assert np.max(off) < 12.0 * DEG  # a kart slides by six
    assert np.sqrt(np.mean(off[(t > 30.0) & (t < 50.0)] ** 2)) < 4.0 * DEG
