"""The rows of a fix have the Jacobians they claim, and the smoother is as sure as it is right."""

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, O, V, X

from bound import BoundOptions, information_bound
from smoother import api, so3
from smoother.arrays import Array
from smoother.live.engine import Engine, Snapshot
from smoother.live.identify import Foreground
from smoother.live.lag import FixedLag
from smoother.live.lag_rows import ACCEL_ERROR, CONSTANTS, GYRO_ERROR, FixError, Reading, felt_errors, fix_rows
from smoother.live.navigator import Aboard
from smoother.live.receiver import Chunk
from smoother.prepare import prepare
from smoother.samples import ImuSamples
from smoother.units import DEG

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
TICK = 300  # bytes at once, a fifteenth of a second


@pytest.fixture(scope="module")
def navigating() -> Aboard:
    return Aboard(Foreground())


@pytest.fixture(scope="module")
def comparing() -> Iterator[ModuleType]:
    """The benchmark as a module; its own folder is on the path only as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("live")


@pytest.fixture(scope="module")
def snapshots(drive, navigating: Aboard) -> list[Snapshot]:
    engine, stream = Engine(navigating), drive.stream
    taken = [engine.step([Chunk(at * 1e-4, stream[at : at + TICK])])[0] for at in range(0, len(stream), TICK)]
    for _ in range(400):  # let a smoother that catches up finish
        taken.append(engine.step([])[0])
    return taken


def test_rows_of_a_fix_have_the_jacobians_they_claim() -> None:
    rng = np.random.default_rng(3)
    reading = Reading(rng.normal(0, 5, 3) + np.array([0.0, 0.0, 9.8]), so3.skew(rng.normal(0, 1, 3)))
    R, p, v, offset = so3.exp(rng.normal(0, 1, 3)), *rng.normal(0, 10, (3, 3))
    constants = np.concatenate([[0.15, 0.25, 0.3, -0.2, 0.4], rng.normal(0, 0.03, CONSTANTS - 5)])

    def predicted(x: Array) -> Array:
        turned, moved = R @ so3.exp(x[:3]), p + R @ x[3:6]
        return fix_rows(turned, moved, v + x[6:9], offset + x[9:12], constants + x[12:], reading, 0.2)[0]

    claimed = np.hstack(fix_rows(R, p, v, offset, constants, reading, 0.2)[1])
    np.testing.assert_allclose(claimed, so3.numerical_jacobian(predicted, np.zeros(12 + CONSTANTS)), atol=1e-6)


def test_a_position_that_jumped_takes_no_weight_from_the_velocity_beside_it() -> None:
    values, keys = gtsam.Values(), [X(0), V(0), O(0), C(0)]
    values.insert(keys[0], gtsam.Pose3())
    for key, size in zip(keys[1:], (3, 3, CONSTANTS), strict=True):
        values.insert(key, np.zeros(size))
    reading = Reading(np.array([0.0, 0.0, 9.80665]), np.zeros((3, 3)))
    measured, sigma = np.array([30.0, 0.0, 0.0, 0.2, 0.0, 0.0]), np.repeat([0.5, 0.1], 3)
    error = FixError(keys, measured, sigma, np.arange(6), reading, 0.0, 4.0)
    jacobians = [np.zeros(0)] * 4
    found = error(None, values, jacobians)
    weights = [1.0 / (1.0 + (x / 4.0) ** 2) for x in (60.0, 2.0)]  # Cauchy's, of either
    assert found[[0, 3]] == pytest.approx([-60.0 * np.sqrt(weights[0]), -2.0 * np.sqrt(weights[1])])
    assert jacobians[1][3, 0] == pytest.approx(np.sqrt(weights[1]) / 0.1)


def test_errors_of_scale_are_felt_as_the_batch_smoother_takes_them_out() -> None:
    rng = np.random.default_rng(8)
    axes, force, rate = so3.exp(rng.normal(0, 1, 3)), rng.normal(0, 5, 3), rng.normal(0, 1, 3)
    accel_error, gyro_error = rng.normal(0, 0.01, (3, 2)), rng.normal(0, 0.01, 3)
    constants = np.concatenate([np.zeros(8), accel_error.ravel(), gyro_error])
    felt = felt_errors(axes, force, rate) @ constants
    np.testing.assert_allclose(felt[:3], accel_error @ axes[:2] @ force, atol=1e-12)
    np.testing.assert_allclose(felt[3:], gyro_error * (axes[2] @ rate), atol=1e-12)


def test_attitude_after_a_minute_is_near_the_bound_of_a_filter(drive, snapshots: list[Snapshot]) -> None:
    late = [s.lag for s in snapshots if s.lag is not None and s.lag.t > 50.0]
    truth = drive.simulation.truth.at(np.array([state.t for state in late]))
    error = so3.log(np.swapaxes(truth.R_nb, 1, 2) @ np.array([state.R_nb for state in late]))
    rms = np.sqrt(np.mean(error**2, axis=0))
    bound = information_bound(drive.simulation, BoundOptions(imu_matrix=True)).attitude[-1]
    # 1.5 in the mean of many sessions (benchmarks/live.py); ten seconds of one of them scatter by as much again
    assert np.sqrt(np.mean(rms**2) / np.mean(bound**2)) < 2.0
    assert np.all(rms < 4.0 * DEG)
    sigma = np.array([state.attitude_sigma for state in late])
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 2.0


def test_the_last_second_differs_from_the_batch_smoother_by_what_its_data_are_fewer(
    drive, navigating: Aboard, snapshots: list[Snapshot], comparing: ModuleType
) -> None:
    """In attitude, velocity and position, each over sqrt(P_lag - P_batch) (Hausman 1978)."""
    session = prepare(drive.simulation.raw)
    assert session.imu is not None
    batch = api.smooth(session)
    last = [s.lag for s in snapshots if s.lag is not None and batch.t[-1] - 1.0 < s.lag.t <= batch.t[-1]]
    assert len(last) > 10
    apart = np.array([comparing.apart_from(batch, state, session.imu.t[-1]) for state in last])
    assert np.all(apart < 3.0)


def test_what_no_data_can_tell_of_the_offset_is_in_the_sigma_of_positions_and_in_no_factor(navigating: Aboard) -> None:
    assert navigating.start is not None
    start = replace(navigating.start, unseen_offset=np.array([9.0, 4.0, 1.0]))
    one, other = FixedLag(start).state(), FixedLag(replace(start, unseen_offset=np.zeros(3))).state()
    np.testing.assert_allclose(one.position_sigma**2 - other.position_sigma**2, start.unseen_offset)
    np.testing.assert_array_equal(one.velocity_sigma, other.velocity_sigma)
    np.testing.assert_array_equal(one.unseen_offset, start.unseen_offset)


@pytest.mark.parametrize("accel", [0.15, 5.0])  # m/s^2/sqrt(Hz): little beside what is carried on, and more than that
def test_what_samples_carry_on_is_as_unsure_as_numerical_slopes_make_it(
    drive, navigating: Aboard, snapshots: list[Snapshot], accel: float
) -> None:
    """Nearly a second behind the newest keyframe: attitude, position and velocity of the antenna, beside the noise."""
    session = prepare(drive.simulation.raw)
    assert snapshots and session.imu is not None and navigating.start is not None
    noise = replace(navigating.start.inertial, accel=accel)
    start = replace(navigating.start, inertial=noise, mounting_sigma=np.zeros(3), unseen_offset=np.zeros(3))
    lag = FixedLag(start)
    position_n, velocity_n = session.gnss.position_n(session.origin), session.gnss.velocity_n
    for k, t in enumerate(session.gnss.t.tolist()):
        if start.t < t < start.t + 6.0:
            lag.add_imu(session.imu.between(lag._newest + 1e-6, t))
            lag.add_fix(t, position_n[k], velocity_n[k])
    lag.add_imu(session.imu.between(lag._newest + 1e-6, lag.t + 0.9))
    found, P, dt = lag.state(), lag._joint_covariance(), lag._newest - lag.t
    nav, bias, constants = lag._nav_state, lag._bias.vector(), lag._constants

    def carried(x: Array) -> Array:
        turned = gtsam.Rot3(so3.exp(x[:3]) @ nav.attitude().matrix())
        lag._nav_state = gtsam.NavState(turned, nav.position() + x[3:6], nav.velocity() + x[6:9])
        lag._bias = gtsam.imuBias.ConstantBias(*np.split(bias + x[9:15], 2))
        lag._constants = constants + x[15:]
        state = lag.state()
        return np.concatenate([so3.log(found.R_nb.T @ state.R_nb), state.position_n, state.velocity_n])

    J = so3.numerical_jacobian(carried, np.zeros(15 + CONSTANTS), 1e-5)
    by_noise = np.repeat([noise.gyro**2 * dt, noise.accel**2 * dt**3 / 3.0, noise.accel**2 * dt], 3)
    wanted = np.sqrt(np.diag(J @ P @ J.T) + by_noise)
    assert dt > 0.8
    sigma = np.concatenate([found.attitude_sigma, found.position_sigma, found.velocity_sigma])
    # left out: that the bias of the rate swings the antenna, and what turns by noise on the way push
    np.testing.assert_allclose(sigma, wanted, rtol=0.01)


def test_a_kart_is_as_unsure_as_the_mounting_of_its_box(navigating: Aboard, snapshots: list[Snapshot]) -> None:
    assert snapshots and navigating.start is not None
    start = replace(navigating.start, mounting_sigma=np.array([0.02, 0.03, 0.05]))
    one, other = FixedLag(start).state(), FixedLag(replace(start, mounting_sigma=np.zeros(3))).state()
    np.testing.assert_allclose(one.attitude_sigma**2 - other.attitude_sigma**2, start.mounting_sigma**2)


def test_a_fix_of_a_time_that_samples_have_not_reached_is_left_out(
    navigating: Aboard, snapshots: list[Snapshot]
) -> None:
    assert snapshots and navigating.start is not None
    start = navigating.start
    lag, t = FixedLag(start), start.t + 0.01 * np.arange(1, 51)
    lag.add_imu(ImuSamples(t, np.tile([0.0, 0.0, 9.8], (50, 1)), np.zeros((50, 3))))
    lag.add_fix(start.t + start.velocity_latency + 0.55, start.position_n, start.velocity_n)
    assert (lag.fixes_used, lag.fixes_late, lag.t) == (0, 1, start.t)


def test_errors_of_scale_are_taken_out_of_what_carries_on(navigating: Aboard, snapshots: list[Snapshot]) -> None:
    assert snapshots and navigating.start is not None
    start, rng = navigating.start, np.random.default_rng(6)
    accel_error, gyro_error = rng.normal(0.0, 0.01, (3, 2)), rng.normal(0.0, 0.01, 3)
    force, rate, t = np.array([3.0, -5.0, 9.8]), np.array([0.2, -0.1, 1.5]), start.t + 0.01 * np.arange(1, 81)
    level, up = start.R_bs[:2], start.R_bs[2]
    ideal, flawed = FixedLag(start), FixedLag(start)
    bias = flawed._bias
    flawed._constants[ACCEL_ERROR], flawed._constants[GYRO_ERROR] = accel_error.ravel(), gyro_error
    for lag, felt, turned in (
        (ideal, force, rate),
        (flawed, force + accel_error @ level @ force, rate + gyro_error * (up @ rate)),
    ):
        lag.add_imu(
            ImuSamples(t, np.tile(felt + bias.accelerometer(), (80, 1)), np.tile(turned + bias.gyroscope(), (80, 1)))
        )
    # to first order: of 1 % twice 0.01 % of 11 m/s^2 and 1.5 rad/s are left, for 0.8 s
    np.testing.assert_allclose(flawed.state().velocity_n, ideal.state().velocity_n, atol=6e-3)
    np.testing.assert_allclose(flawed.state().R_nb, ideal.state().R_nb, atol=1e-3)


def test_what_is_older_than_the_lag_is_forgotten(navigating: Aboard, snapshots: list[Snapshot]) -> None:
    assert snapshots[-1].lag is not None
    lag = navigating._navigator._lag
    assert lag is not None and lag.fixes_used > 200
    # four seconds of keyframes, with five factors each and the margins of those forgotten
    assert lag._smoother.getFactors().size() < 150
    assert len(lag._smoother.timestamps()) < 4 * 5 * 6


def test_madgwick_is_there_at_once_and_the_smoother_when_it_drove(snapshots: list[Snapshot]) -> None:
    with_attitude = next(s for s in snapshots if s.madgwick is not None)
    with_smoother = next(s for s in snapshots if s.lag is not None)
    assert with_attitude.t < 1.0
    assert 12.0 < with_smoother.t < 35.0


def test_who_drives_is_not_asked_to_drive(snapshots: list[Snapshot]) -> None:
    stages = {s.stage for s in snapshots if s.lag is None and s.speed > 5.0}
    assert "waiting for the smoother" in stages
    assert not any("drive to start" in stage or "logger" in stage for stage in stages)


def test_rates_fix_and_satellites_are_what_was_sent(snapshots: list[Snapshot]) -> None:
    s = next(s for s in snapshots if s.t > 30.0)
    assert s.rates["imu"] == pytest.approx(200.0, rel=0.02)
    assert s.rates["gps"] == pytest.approx(5.0, rel=0.05)
    assert s.reception.fix >= 1 and s.reception.satellites > 3
    assert s.fix_age < 0.5


def test_a_stream_of_garbage_gives_a_snapshot_and_no_error() -> None:
    rng = np.random.default_rng(4)
    engine = Engine(Aboard(Foreground()))
    for _ in range(50):
        snapshot, batches = engine.step([Chunk(1.0, rng.bytes(2000))])
        assert not batches
    assert snapshot.losses.noise_bytes > 90_000
