"""A window that moves along is the graph of the batch, and its smoother is as sure as it is right."""

import importlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import gtsam
import numpy as np
import pytest

from bound import BoundOptions, information_bound
from live_here import Foreground, LocalNavigator
from smoother import api, so3
from smoother.arrays import Array
from smoother.estimate.factors.gaussian import columns_of
from smoother.estimate.factors.graph import MAX_LATENCY, Graph, build_graph
from smoother.estimate.factors.imu import imu_factors, preintegration_parameters
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.model.state import CONSTANTS_SIZE, KEYFRAME_SIZE, OFFSET, State, vector_values
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.estimate.solve import Solved
from smoother.estimate.solvers.batch import Step, step
from smoother.estimate.solvers.identify import FREE
from smoother.live.engine import Engine, Snapshot
from smoother.live.lag import CONTEXT, LAG, FixedLag, LagStart, rate_without_noise
from smoother.live.lag_graph import Marginal, WindowGraph, extrapolated, rolling
from smoother.live.receiver import Chunk
from smoother.prepare import prepare
from smoother.samples import ImuSamples
from smoother.units import DEG

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
TICK = 300  # bytes at once, a fifteenth of a second


@pytest.fixture(scope="module")
def navigating() -> LocalNavigator:
    return LocalNavigator(Foreground())


@pytest.fixture(scope="module")
def comparing() -> Iterator[ModuleType]:
    """The benchmark as a module; its own folder is on the path only as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("live")


@pytest.fixture(scope="module")
def snapshots(drive, navigating: LocalNavigator) -> list[Snapshot]:
    engine, stream = Engine(navigating), drive.stream
    taken = [engine.step([Chunk(at * 1e-4, stream[at : at + TICK])])[0] for at in range(0, len(stream), TICK)]
    for _ in range(400):  # let a smoother that catches up finish
        taken.append(engine.step([])[0])
    return taken


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
    drive, navigating: LocalNavigator, snapshots: list[Snapshot], comparing: ModuleType
) -> None:
    """In attitude, velocity and position, each over sqrt(P_lag - P_batch) (Hausman 1978)."""
    session = prepare(drive.simulation.raw)
    assert session.imu is not None
    batch = api.smooth(session)
    last = [s.lag for s in snapshots if s.lag is not None and batch.t[-1] - 1.0 < s.lag.t <= batch.t[-1]]
    assert len(last) > 10
    apart = np.array([comparing.apart_from(batch, state, session.imu.t[-1]) for state in last])
    assert np.all(apart < 3.0)


@dataclass(frozen=True)
class Whole:
    """A session's graph, solved in one piece, and one step of it from there."""

    graph: Graph
    binned: BinnedImu
    taken: Step

    @property
    def state(self) -> State:
        return self.taken.state


@pytest.fixture(scope="module")
def whole(drive) -> Whole:
    kept: list[Solved] = []
    GraphSmoother(GraphOptions(rate=5.0), keep=kept.append).estimate(prepare(drive.simulation.raw))
    start, found = kept[-1].start, kept[-1].found
    noise = found.known.noise
    binned = replace(start.binned, rough=None)
    # without what only a whole session has; a tenth of a metre away, so that a step has something to do
    state = replace(found.state, position_n=found.state.position_n + 0.1)
    measured = replace(
        start.data, still=np.empty(0, np.int64), unsampled=None, ground=None, rolls=rolling(state, noise)
    )
    graph = build_graph(binned, measured, noise, start.priors, state)
    return Whole(graph, binned, step(graph, state.values()))


def window_of(whole: Whole, first: int, end: int, prior: gtsam.NonlinearFactorGraph) -> WindowGraph:
    """The graph of the keyframes first to end, exclusive, after those before them, with the fixes until then."""
    graph, intervals = whole.graph, np.arange(end - first - 1)
    preintegrated = graph.preintegrated[first : end - 1]
    reached = graph.measured.t - whole.state.constant("position_latency") < whole.state.t[end - 1]
    return WindowGraph(
        imu_factors(preintegrated, intervals),
        prior,
        intervals,
        preintegrated,
        graph.measured.of(reached),
        graph.noise,
        graph.priors,
        whole.state.part(slice(first, end)),
        before=whole.state.part(slice(0, first)),
    )


def test_a_window_after_what_was_eliminated_is_solved_as_the_whole_graph_is(whole: Whole) -> None:
    leave, n = 200, len(whole.state.t)
    known = Marginal.of(whole.taken, whole.graph.prior, leave)
    window = window_of(whole, leave, n, known.factors())
    taken = step(window, window.state.values())
    assert set(taken.rows) == set(whole.taken.rows) and len(taken.rows["slip"].interval) > 100
    sigma = np.sqrt(np.diag(taken.chain().covariances().keyframes[0]))
    assert np.max(np.abs(whole.taken.keyframes / sigma)) > 0.03
    assert np.max(np.abs(taken.keyframes - whole.taken.keyframes[leave:]) / sigma) < 1e-5
    own, all_of_it = taken.chain().covariances(), whole.taken.chain().covariances()
    np.testing.assert_allclose(own.constants, all_of_it.constants, atol=1e-8)
    scale = np.sqrt(np.einsum("kii->ki", all_of_it.keyframes[leave:]))
    apart = (own.keyframes - all_of_it.keyframes[leave:]) / (scale[:, :, None] * scale[:, None, :])
    assert np.max(np.abs(apart)) < 1e-5


def test_what_was_eliminated_stays_where_it_was_when_the_window_moves(whole: Whole) -> None:
    """The prior is of how far the keyframe is from where it was linearised: its error there is the least."""
    leave = 200
    known = Marginal.of(whole.taken, whole.graph.prior, leave)
    at, factor = known.at.values(), known.factors().at(0)
    moved = known.at.part(slice(None))
    moved = replace(moved, velocity_n=moved.velocity_n + np.array([1.0, 0.0, 0.0]))
    column = 6  # of that velocity
    np.testing.assert_allclose(factor.linearize(at).jacobian()[1], known.A[:, -1])
    b = factor.linearize(moved.values()).jacobian()[1]
    np.testing.assert_allclose(b, known.A[:, -1] - known.A[:, column], atol=1e-6)


def test_a_keyframe_that_has_turned_has_no_more_information_of_position(whole: Whole) -> None:
    """A position and the slow error of the fixes that move against each other change nothing but that error's prior."""
    known, still = Marginal.of(whole.taken, whole.graph.prior, 200), np.zeros(CONSTANTS_SIZE)

    def at(move: Array, since: State) -> State:
        return since.with_values(since.values().retract(vector_values(move[None], still)))

    now = at(np.concatenate([[0.03, -0.02, 0.1, 1.0, -0.5, 0.2], np.zeros(KEYFRAME_SIZE - 6)]), known.at)
    moved, along = known.moved_to(now), np.array([3.0, -2.0, 1.0])

    def shifted(of: Marginal) -> Array:
        return np.asarray(of.A[:, 3:6] @ (of.at.R_ns[0].T @ along) - of.A[:, OFFSET] @ along)

    np.testing.assert_allclose(shifted(moved), shifted(known), atol=1e-8)
    # and its columns are those of its right side
    for column, move in enumerate(1e-6 * np.eye(KEYFRAME_SIZE)):
        ends = [known.moved_to(at(sign * move, now)).A[:, -1] for sign in (-1.0, 1.0)]
        scale = np.max(np.abs(known.A[:, column])) + 1e-9
        np.testing.assert_allclose(moved.A[:, column] / scale, (ends[0] - ends[1]) / 2e-6 / scale, atol=1e-4)


def preintegrated(
    whole: Whole, state: State, force_s: Array, rate_s: Array, dt: float
) -> gtsam.PreintegratedCombinedMeasurements:
    """Samples (N, 3), dt s each, after the last keyframe of a state."""
    noise = whole.graph.noise.inertial
    bias = gtsam.imuBias.ConstantBias(state.accel_bias_s[-1], state.gyro_bias_s[-1])
    parameters = preintegration_parameters(noise.accel, noise.gyro, noise)
    measured = gtsam.PreintegratedCombinedMeasurements(parameters, bias)
    for force, rate in zip(force_s, rate_s, strict=True):
        measured.integrateMeasurement(force, rate, dt)
    return measured


def test_the_state_now_has_the_sigma_of_one_more_keyframe(whole: Whole) -> None:
    first, end = 150, 201
    prior = Marginal.of(whole.taken, whole.graph.prior, first).factors()
    noise = replace(whole.graph.noise, slip=None)  # wheels know something of the next keyframes
    until = replace(window_of(whole, first, end, prior), noise=noise)
    ahead = replace(window_of(whole, first, end + 3, prior), measured=until.measured, noise=noise)
    longer = step(ahead, ahead.state.values())
    wanted, known = longer.chain().covariances(), step(until, until.state.values()).chain().covariances()
    state, t = until.state, whole.state.t
    one = whole.binned.between(end - 1, end + 3)
    samples = one.specific_force_s.reshape(-1, 3), one.angular_rate_s.reshape(-1, 3)
    measured = preintegrated(whole, state, *samples, one.dt)
    _, found = extrapolated(state.part(slice(-1, None)), known, measured, float(t[end + 2]))
    motion = slice(0, 9)  # GTSAM lets the bias of a longer interval walk at its end
    sigma = np.sqrt(np.diag(wanted.keyframes[-1]))[motion]
    apart = (found.keyframes[-1] - wanted.keyframes[-1])[motion, motion] / np.outer(sigma, sigma)
    assert np.max(np.abs(apart)) < 0.03
    beside = (found.with_constants[-1] - wanted.with_constants[-1])[motion] / sigma[:, None]
    assert np.max(np.abs(beside) / np.sqrt(np.diag(wanted.constants))) < 0.03
    assert sigma[7] > 1.3 * np.sqrt(known.keyframes[-1][7, 7])  # 0.6 s of samples alone are seen


def test_errors_of_scale_are_taken_out_of_what_carries_on(whole: Whole) -> None:
    rng, known = np.random.default_rng(6), whole.taken.chain().covariances()
    last = whole.state.part(slice(100, 101))
    axes = last.geometry.level_axes_s
    accel_scale, gyro_scale = rng.normal(0.0, 0.01, (3, 2)), rng.normal(0.0, 0.01, 3)
    constants = last.constants | {"accel_scale": np.zeros(6), "gyro_scale": np.zeros(3)}
    ideal = replace(last, constants=constants)
    flawed = replace(last, constants=constants | {"accel_scale": accel_scale.ravel(), "gyro_scale": gyro_scale})
    force, rate = last.R_ns[0].T @ np.array([3.0, -5.0, 9.8]), axes[2] * 0.5
    ends = []
    for state, f, w in (
        (ideal, force, rate),
        (flawed, force + accel_scale @ axes[:2] @ force, rate + gyro_scale * (axes[2] @ rate)),
        (ideal, force + accel_scale @ axes[:2] @ force, rate + gyro_scale * (axes[2] @ rate)),
    ):
        samples = np.tile(f + state.accel_bias_s, (80, 1)), np.tile(w + state.gyro_bias_s, (80, 1))
        measured = preintegrated(whole, state, *samples, 0.01)
        ends.append(extrapolated(state, known, measured, float(last.t[0]) + 0.8)[0])
    good, corrected, wrong = ends
    # to first order: of 1 % twice 0.01 % of 11 m/s^2 and 0.5 rad/s are left, for 0.8 s
    np.testing.assert_allclose(corrected.velocity_n[-1], good.velocity_n[-1], atol=6e-3)
    np.testing.assert_allclose(corrected.R_ns[-1], good.R_ns[-1], atol=1e-3)
    assert np.max(np.abs(wrong.velocity_n[-1] - good.velocity_n[-1])) > 0.03


def fed(drive, start: LagStart, seconds: float) -> FixedLag:
    """A smoother that has taken in the samples and the fixes of some seconds."""
    session, lag = prepare(drive.simulation.raw), FixedLag(start)
    assert session.imu is not None
    position_n, velocity_n = session.gnss.position_n(session.origin), session.gnss.velocity_n
    for k, t in enumerate(session.gnss.t.tolist()):
        if start.t < t < start.t + seconds:
            lag.add_imu(session.imu.between(lag.newest + 1e-6, t))
            lag.add_fix(t, position_n[k], velocity_n[k])
    return lag


def test_what_no_data_can_tell_of_the_offset_is_in_the_sigma_of_positions_and_in_no_factor(
    drive, navigating: LocalNavigator, snapshots: list[Snapshot]
) -> None:
    assert snapshots and navigating.start is not None
    start = replace(navigating.start, unseen_offset=np.array([9.0, 4.0, 1.0]))
    one, other = (fed(drive, s, 2.0).state() for s in (start, replace(start, unseen_offset=np.zeros(3))))
    assert one is not None and other is not None
    np.testing.assert_allclose(one.position_sigma**2 - other.position_sigma**2, start.unseen_offset)
    np.testing.assert_array_equal(one.velocity_sigma, other.velocity_sigma)
    np.testing.assert_array_equal(one.unseen_offset, start.unseen_offset)


def test_the_attitude_of_the_kart_contains_the_sigma_of_the_mounting(
    drive, navigating: LocalNavigator, snapshots: list[Snapshot]
) -> None:
    assert snapshots and navigating.start is not None
    start = replace(navigating.start, mounting_sigma=np.array([0.02, 0.03, 0.05]))
    one, other = (fed(drive, s, 2.0).state() for s in (start, replace(start, mounting_sigma=np.zeros(3))))
    assert one is not None and other is not None
    np.testing.assert_allclose(one.attitude_sigma**2 - other.attitude_sigma**2, start.mounting_sigma**2)


def test_a_fix_of_a_time_that_samples_have_not_reached_is_left_out(
    navigating: LocalNavigator, snapshots: list[Snapshot]
) -> None:
    assert snapshots and navigating.start is not None
    start = navigating.start
    lag, t = FixedLag(start), start.t + 0.01 * np.arange(1, 51)
    lag.add_imu(ImuSamples(t, np.tile([0.0, 0.0, 9.8], (50, 1)), np.zeros((50, 3))))
    no_latency_explains = 0.5 + MAX_LATENCY + max(lag.latencies) + 0.01
    lag.add_fix(start.t + no_latency_explains, np.zeros(3), np.zeros(3))
    assert (lag.fixes_used, lag.fixes_late, lag.t, lag.state()) == (0, 1, start.t, None)


def with_latencies(start: LagStart, position: float, velocity: float) -> LagStart:
    """The start of a stream whose fixes are late by other times, s."""
    latencies = {"position_latency": np.array([position]), "velocity_latency": np.array([velocity])}
    at = replace(start.known.at, constants=start.known.at.constants | latencies)
    return replace(start, known=replace(start.known, at=at))


@pytest.mark.parametrize("latency", [-0.2, 0.0, 0.45])
def test_a_fix_waits_for_samples_around_it_and_no_longer(
    drive, navigating: LocalNavigator, snapshots: list[Snapshot], latency: float
) -> None:
    """Also where stamps are before the fixes are true: those of Lignano are, by 0.1 s."""
    assert snapshots and navigating.start is not None
    start, waits = with_latencies(navigating.start, latency, latency), []
    for seconds in (2.6, 2.8, 3.0):
        lag = fed(drive, start, seconds)
        assert lag.fixes_used > 9 and lag.fixes_late <= np.ceil(max(latency, 0.0) / 0.2)
        waits.append(lag._fixes.t[-1] - lag._solved)
    # until the next keyframe, and the next fix, from which on both are in the window
    assert max(waits) < max(0.0, 0.4 - latency) + 0.01


def test_constants_are_held_with_wheels_and_their_errors_count(
    drive, navigating: LocalNavigator, snapshots: list[Snapshot]
) -> None:
    assert snapshots and navigating.start is not None and navigating.start.held is not None
    start, lag = navigating.start, fed(drive, navigating.start, 5.0)
    assert lag.state() is not None and lag._known is not None
    for name, values in start.known.at.constants.items():
        moved = np.max(np.abs(lag._state.constants[name] - values))
        assert (moved > 1e-6) if name == "slip" else (moved < 1e-6), name
    kept = np.delete(np.arange(CONSTANTS_SIZE), columns_of(FREE))
    np.testing.assert_allclose(lag._known.constants[np.ix_(kept, kept)], start.held[np.ix_(kept, kept)])
    assert lag._taken is not None
    as_if_known = lag._taken.chain().covariances().keyframes[-1]
    more = np.diag(lag._known.keyframes[-1]) / np.diag(as_if_known)
    assert np.all(more > 0.999) and np.max(more[:9]) > 1.02


def test_the_swing_of_the_antenna_is_without_the_noise_of_the_last_sample(whole: Whole) -> None:
    rng, state, noise = np.random.default_rng(3), whole.state, whole.graph.noise.inertial
    t, turn_s = 0.01 * np.arange(200), state.geometry.level_axes_s.T @ np.array([0.0, 0.0, 0.7])
    wanted, errors, sigmas = state.R_ns[-1] @ turn_s, [], []
    for _ in range(20):
        rates = turn_s + state.gyro_bias_s[-1] + rng.normal(0.0, noise.gyro / np.sqrt(0.01), (200, 3))
        rate_n, covariance = rate_without_noise(ImuSamples(t, np.zeros((200, 3)), rates), state, noise)
        errors.append(rate_n - wanted)
        sigmas.append(np.sqrt(np.mean(np.diag(covariance))))
    white = noise.gyro / np.sqrt(0.01)
    rms = np.sqrt(np.mean(np.square(errors)))
    assert rms < 0.5 * white
    assert 0.5 < rms / np.mean(sigmas) < 2.0


@pytest.mark.parametrize("later", [0, 1])
def test_of_a_fix_across_the_beginning_the_part_counts_that_no_prior_has(
    navigating: LocalNavigator, snapshots: list[Snapshot], later: int
) -> None:
    assert snapshots and navigating.start is not None
    start, zero = with_latencies(navigating.start, *np.roll([0.1, 0.3], later)), np.zeros(3)
    lag = FixedLag(start)
    lag.add_fix(start.t + 0.05, zero, zero)
    lag.add_imu(ImuSamples(start.t + np.array([0.005, 0.008]), np.zeros((2, 3)), np.zeros((2, 3))))
    lag.add_fix(start.t + 0.2, zero, zero)
    assert (lag.fixes_used, lag.fixes_late) == (1, 1)
    lag.add_imu(ImuSamples(start.t + np.array([0.1, 0.15]), np.zeros((2, 3)), np.zeros((2, 3))))
    lag.add_fix(start.t + 0.21, zero, zero)
    parts = lag._fixes.position_n[-1], lag._fixes.velocity_n[-1]
    assert np.isfinite(parts[later]).all() and np.isnan(parts[1 - later]).all()


def test_wheels_hold_the_yaw_where_the_session_has_them_and_not_where_the_kart_spins(whole: Whole) -> None:
    noise, state = whole.graph.noise, whole.state
    rolls = rolling(state, noise)
    assert rolls is not None and np.mean(rolls) > 0.8
    assert rolling(state, replace(noise, slip=None)) is None
    spun = state.R_ns.copy()
    spun[100:105] = spun[100:105] @ so3.exp(np.array([0.0, 0.0, 1.0]))
    beside = rolling(replace(state, R_ns=spun), noise)
    assert beside is not None and rolls[95:110].all() and not beside[95:110].any()
    np.testing.assert_array_equal(beside[:80], rolls[:80])


def test_a_fix_counts_once_in_the_window_or_in_its_prior(
    drive, navigating: LocalNavigator, snapshots: list[Snapshot]
) -> None:
    assert snapshots and navigating.start is not None
    lag = fed(drive, navigating.start, 8.0)
    for values, latency in zip((lag._fixes.position_n, lag._fixes.velocity_n), lag.latencies, strict=True):
        ahead = lag._fixes.t - latency - lag._state.t[0]
        assert np.any(ahead < -0.05) and np.isnan(values[ahead < -0.05]).all()
        assert np.any(ahead > 0.05) and np.isfinite(values[ahead > 0.05, :2]).all()


def test_what_is_older_than_the_lag_is_forgotten(navigating: LocalNavigator, snapshots: list[Snapshot]) -> None:
    assert snapshots[-1].lag is not None
    lag = navigating._navigator._lag
    assert lag is not None and lag.fixes_used > 25
    assert np.ptp(lag._state.t) == pytest.approx(LAG) and np.ptp(lag._before.t) < CONTEXT
    assert len(lag._preintegrated) == len(lag._state.t) - 1
    assert len(lag._fixes.t) < 5 * (LAG + 3.0)
    assert lag.newest - lag._imu[0].t[0] < 4.0


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
    engine = Engine(LocalNavigator(Foreground()))
    for _ in range(50):
        snapshot, batches = engine.step([Chunk(1.0, rng.bytes(2000))])
        assert not batches
    assert snapshot.losses.noise_bytes > 90_000
