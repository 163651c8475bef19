"""Wheels that roll along: rows against formulas, the decision whether to ask for them, and what they are worth."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate import bridge
from smoother.estimate.evaluate import errors_between
from smoother.estimate.graph import batch as batch_module
from smoother.estimate.graph import slip as slip_module
from smoother.estimate.graph import solve
from smoother.estimate.graph.batch import DrivenMotion, Solved
from smoother.estimate.graph.expected import ExpectedMotion
from smoother.estimate.graph.imu import DensePath
from smoother.estimate.graph.slip import (
    MEMORY,
    Slip,
    SlipNoise,
    not_doubted_by,
    remembered,
    slip_of,
    slip_rows,
    with_nose,
)
from smoother.estimate.graph.state import KEYFRAME_SIZE, ROTATION, SLIP, VELOCITY, ChainState, Constants
from smoother.estimate.model.state import COLUMNS
from smoother.estimate.output.estimated import Estimated, Known
from smoother.estimate.resample import resample
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.estimate.solvers.identify import Solution
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.motion import Spin
from smoother.sim.scenario import Interval
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory
from smoother.units import DEG

K, T = 6, 0.2
SLIDES = np.array([0.02, -0.005, -5e-4, 0.7])  # rad, per m/s^2, per m/s^3, m


def driven(slip: Array, heading: float = 3.0) -> tuple[ChainState, DensePath, ExpectedMotion]:
    """A level kart that speeds up in a bend, the path `slip` (K,) rad beside the nose; the box lies any way."""
    t = T * np.arange(len(slip))
    course = heading + 0.4 * t + 0.1 * t**2
    speed = 12.0 + t
    velocity_n = np.column_stack([speed * np.cos(course), speed * np.sin(course), 0.0 * t])
    R_bs = so3.exp(np.array([[0.4, -1.0, 2.0]]))[0]
    yaw = course - slip
    R_ns = so3.exp(np.column_stack([0.0 * t, 0.0 * t, yaw])) @ R_bs
    acceleration_n = np.gradient(velocity_n, t, axis=0)
    constants = Constants(0.1, 0.15, np.zeros(3), level_axes_s=R_bs)
    zeros = np.zeros((len(slip), 3))
    state = ChainState(t, R_ns, zeros, velocity_n, zeros, zeros, zeros, constants)
    path = DensePath(t, R_ns, zeros, velocity_n, acceleration_n[:-1], zeros[:-1])
    return state, path, ExpectedMotion(velocity_n, acceleration_n, 0.0 * t)


def told() -> np.ndarray:
    return np.ones(K, dtype=np.bool_)


def test_the_slip_is_the_angle_from_nose_to_path_less_what_the_constants_say() -> None:
    angle = 0.01 * np.arange(K) - 0.03
    state, path, felt = driven(angle)
    found = slip_of(state, path, felt, told(), told())
    np.testing.assert_allclose(found.value * found.level, angle, atol=1e-12)
    sliding = replace(state, constants=replace(state.constants, slip=SLIDES))
    v = state.velocity_n
    speed = np.hypot(v[:, 0], v[:, 1])
    lateral = (v[:, 0] * felt.acceleration_n[:, 1] - v[:, 1] * felt.acceleration_n[:, 0]) / speed
    jerk_n = np.gradient(felt.acceleration_n, T, axis=0)
    later = (v[:, 0] * jerk_n[:, 1] - v[:, 1] * jerk_n[:, 0]) / speed
    expected = angle - np.column_stack([np.ones(K), lateral, later, lateral / speed**2]) @ SLIDES
    found = slip_of(sliding, path, felt, told(), told())
    np.testing.assert_allclose(found.value * found.level, expected, atol=1e-12)


@pytest.mark.parametrize("heading", [0.0, np.pi - 0.1, -2.0])
def test_jacobians_are_those_of_a_turn_about_up_and_of_velocity(heading: float) -> None:
    state, path, felt = driven(np.full(K, 0.05), heading)
    found, step = slip_of(state, path, felt, told(), told()), 1e-6
    for column in range(KEYFRAME_SIZE):
        delta = np.zeros((K, KEYFRAME_SIZE))
        delta[:, column] = step
        moved = slip_of(state.retract(delta, np.zeros_like(state.constants.as_vector())), path, felt, told(), told())
        # of turns in s that do not turn the nose about up nothing is asked: the kart is level here
        by_step = (moved.value * moved.level - found.value * found.level) / step  # how level goes with it is left out
        np.testing.assert_allclose(by_step, found.level * found.by_keyframe[:, column], atol=1e-5)
    assert np.any(found.by_keyframe[:, ROTATION])
    assert np.any(found.by_keyframe[:, VELOCITY])
    for i in range(4):
        constants = state.constants.as_vector()
        constants[SLIP.start + i] += step
        other = replace(state, constants=Constants.from_vector(constants, state.constants.level_axes_s))
        moved = slip_of(other, path, felt, told(), told())
        np.testing.assert_allclose((moved.value - found.value) / step, found.by_constants[:, i], atol=1e-6)


def test_a_kart_that_slides_is_not_asked_how_its_wheels_roll() -> None:
    """Nor for a second around the slide; what is usual, by a mounting that is askew, is no slide."""
    angle = np.full(60, 0.4)
    angle[30:33] += np.pi
    state, path, felt = driven(angle)
    found = slip_of(state, path, felt, *2 * (np.ones(60, dtype=np.bool_),))
    np.testing.assert_array_equal(np.flatnonzero(~found.moves), np.arange(25, 38))
    assert found.sliding == pytest.approx(13 / 60)
    unseen = slip_of(state, path, felt, np.ones(60, dtype=np.bool_), np.zeros(60, dtype=np.bool_))
    assert np.all(unseen.moves)  # in an outage the path points where the samples add up to
    # an attitude that nothing holds is off by as much, but not for a moment
    for usual in (np.full(60, 0.4), np.linspace(0.0, 1.2, 300)):
        state, path, felt = driven(usual)
        found = slip_of(state, path, felt, *2 * (np.ones(len(usual), dtype=np.bool_),))
        assert np.all(found.moves)
        assert found.sliding == 0.0


def some_slip(moves: np.ndarray, own: float = 0.0) -> Slip:
    n = len(moves)
    rng = np.random.default_rng(0)
    value, by_keyframe, by_constants = (
        rng.normal(size=n),
        rng.normal(size=(n, KEYFRAME_SIZE)),
        rng.normal(size=(n, 4)),
    )
    return Slip(value, moves, np.full(n, own), by_keyframe, by_constants, np.ones(n))


def test_the_rows_are_a_gauss_markov_process() -> None:
    """Squares over variances, and the product of the variances, are those of the joint density of all values."""
    slip, sigma = some_slip(np.ones(9, dtype=np.bool_)), 0.3
    start, steps = slip_rows(slip, T, sigma)
    apart = T * np.abs(np.subtract.outer(np.arange(9), np.arange(9)))
    covariance = sigma**2 * np.exp(-apart / MEMORY)
    squares = sum(float(np.sum((r.residual / r.sigma) ** 2)) for r in (start, steps))
    assert squares == pytest.approx(slip.value @ np.linalg.solve(covariance, slip.value))
    logarithms = sum(float(np.sum(2.0 * np.log(r.sigma))) for r in (start, steps))
    assert logarithms == pytest.approx(np.linalg.slogdet(covariance)[1])
    phi = remembered(T)
    np.testing.assert_allclose(steps.left[:, 0], -phi * slip.by_keyframe[:-1])
    np.testing.assert_allclose(steps.right[:, 0], slip.by_keyframe[1:])
    np.testing.assert_allclose(steps.constants[:, 0, SLIP], slip.by_constants[1:] - phi * slip.by_constants[:-1])


def test_bumps_are_beside_the_process_at_both_keyframes_of_a_step() -> None:
    own, sigma, phi = np.random.default_rng(3).uniform(0.05, 0.4, 9), 0.3, remembered(T)
    start, steps = slip_rows(replace(some_slip(np.ones(9, dtype=np.bool_)), own=own), T, sigma)
    apart = T * np.abs(np.subtract.outer(np.arange(9), np.arange(9)))
    covariance = sigma**2 * np.exp(-apart / MEMORY) + np.diag(own**2)
    step = np.eye(9)[1:] - phi * np.eye(9)[:-1]
    np.testing.assert_allclose(steps.sigma[:, 0] ** 2, np.diag(step @ covariance @ step.T))
    assert start.sigma[0, 0] ** 2 == pytest.approx(covariance[0, 0])


def test_the_process_starts_anew_after_a_stop() -> None:
    moves = np.array([0, 1, 1, 1, 0, 0, 1, 1, 0, 1], dtype=np.bool_)  # the last one has nothing after it
    start, steps = slip_rows(some_slip(moves), T, 0.1)
    assert start.interval.tolist() == [1, 6]
    assert steps.interval.tolist() == [1, 2, 6]
    none, also_none = slip_rows(some_slip(np.zeros(4, dtype=np.bool_)), T, 0.1)
    assert len(none.interval) == len(also_none.interval) == 0


def test_at_a_solution_without_wheels_rows_are_judged_by_its_errors_too() -> None:
    slip = replace(some_slip(np.ones(9, dtype=np.bool_)), level=np.linspace(0.5, 1.5, 9))
    start, steps = slip_rows(slip, T, 0.3)
    for rows, at in ((start, [0]), (steps, range(8))):
        judged = not_doubted_by(slip, 0.04, rows)
        np.testing.assert_allclose(judged.sigma[:, 0] ** 2, rows.sigma[:, 0] ** 2 + 0.04 / slip.level[at] ** 2)
        np.testing.assert_array_equal(judged.residual, rows.residual)


def noise_on(lateral: Array) -> SlipNoise:
    """What is assumed on a track whose corners, of lateral acceleration (N,), nobody turns into."""
    level = np.sqrt(slip_module.STRAIGHT**2 + (lateral / slip_module.HARD) ** 2)
    slopes = np.column_stack([np.ones(len(lateral)), lateral, 0.0 * lateral, lateral / 200.0]) / level[:, None]
    return SlipNoise(0.01, 0.0, 0.0, slopes.T @ slopes / len(lateral), slip_module.DIFFERENT)


def test_corners_to_one_side_tell_the_nose_by_drawing_on_to_none() -> None:
    both, left, hard = (noise_on(np.linspace(*ends, 100)) for ends in ((-15.0, 15.0), (0.0, 15.0), (10.0, 15.0)))
    assert both.nose_variance < left.nose_variance < 0.1 * hard.nose_variance
    # where corners go both ways alike, a mean of as many values as there are corners
    information = slip_module.DIFFERENT * both.moments[0, 0] / both.sigma**2 + slip_module.PRIOR[0] ** -2
    assert both.nose_variance == pytest.approx(1.0 / information)
    assert replace(both, apart=0.02).nose_variance == pytest.approx(both.nose_variance + 0.02**2)


@pytest.mark.parametrize(
    ("lateral", "corners"),
    [
        (9.0 + 1.0 * np.sin(np.arange(400.0)), 1),  # a skid pad
        (9.0 * np.sin(0.05 * np.arange(400.0)), 7),  # half waves of 63 keyframes, the last one begun
        (4.5 - 4.5 * np.cos(0.05 * np.arange(400.0)), 3),  # an oval, gone round three times
        (np.zeros(400), 1),
    ],
)
def test_corners_are_told_from_one_another_by_what_lies_between_them(lateral: Array, corners: int) -> None:
    assert slip_module.corners(lateral) == corners


def test_what_the_mean_of_the_slip_says_of_the_nose_otherwise_is_found() -> None:
    n = 2000
    slip, rng = some_slip(np.ones(n, dtype=np.bool_)), np.random.default_rng(1)
    constants = np.array([0.03, 0.002, -1e-4, 0.1])
    slip = replace(slip, value=-slip.by_constants @ constants + 1e-3 * rng.normal(size=n))
    assert with_nose(slip, noise_on(np.linspace(-10.0, 10.0, 50))).apart == pytest.approx(0.03, abs=1e-3)


def kart(preset: str, duration: float = 200.0, **changes: Any) -> tuple[Simulation, Session]:
    simulation = simulate_preset(preset, 3, track="tinbarn", duration=duration, **changes)
    return simulation, prepare(simulation.raw)


def errors(simulation: Simulation, session: Session, found: Trajectory) -> tuple[Array, Array]:
    """Yaw (N,) rad and level velocity (N, 2) m/s at speed, the latter in the outages."""
    t = np.arange(40.0, 190.0, 0.1)
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, session.origin)
    error = errors_between(resample(found, t), truth)
    out = ((t > 80.0) & (t < 110.0)) | ((t > 140.0) & (t < 170.0))
    return error.euler[:, 2], error.velocity_n[out, :2]


@pytest.fixture(scope="module")
def both() -> tuple[Simulation, Session, Trajectory, Trajectory]:
    """A session with two outages, smoothed with and without wheels."""
    outages = (Interval(80.0, 30.0), Interval(140.0, 30.0))
    simulation, session = kart("kart_harsh", gnss_outages=outages)
    with_wheels, without = (GraphSmoother(GraphOptions(wheels=wheels)).estimate(session) for wheels in (True, False))
    return simulation, session, with_wheels, without


def test_wheels_tell_the_heading_and_the_velocity_in_outages(
    both: tuple[Simulation, Session, Trajectory, Trajectory],
) -> None:
    simulation, session, with_wheels, without = both
    (yaw, velocity), (yaw_without, velocity_without) = (
        errors(simulation, session, found) for found in (with_wheels, without)
    )
    assert np.std(yaw) < 0.7 * np.std(yaw_without)
    assert np.std(velocity) < 0.8 * np.std(velocity_without)


def test_what_wheels_tell_of_makes_nothing_less_sure(
    both: tuple[Simulation, Session, Trajectory, Trajectory],
) -> None:
    """Not of a last step by sigmas: its covariance is one in the axes of the attitudes that it was taken from."""
    _, _, with_wheels, without = both
    assert with_wheels.sigmas is not None and without.sigmas is not None
    for name in ("velocity_n", "attitude", "track"):
        one, other = (np.median(getattr(found.sigmas, name), axis=0) for found in (with_wheels, without))
        assert np.all(one < 1.02 * other), name


@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
def test_a_last_step_by_a_sigma_is_as_sure_as_one_more_after_it(preset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Covariances are in the axes of the attitudes before the step, and the nose is where the slip after it has it."""
    session, moves, last, found = kart(preset)[1], [], [], {}
    moved = batch_module.moved

    def watched(*given: Any) -> float:
        moves.append(moved(*given))
        return moves[-1]

    monkeypatch.setattr(solve, "moved", watched)
    monkeypatch.setattr(solve, "ALIKE", np.inf)
    for far in (np.inf, 0.0):
        monkeypatch.setattr(solve, "FAR", far)
        found[far > 0.0] = GraphSmoother().estimate(session).sigmas
        last.append(moves[-1])
    assert last[0] > 2.0 * solve.ROLLED and last[1] < solve.ROLLED
    for name in ("velocity_n", "attitude", "track"):
        one, other = (np.median(getattr(found[goes_far], name), axis=0) for goes_far in (True, False))
        np.testing.assert_allclose(one, other, rtol=0.06, err_msg=name)


def test_the_slip_after_a_step_is_that_of_the_state_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """What attitudes were off by before the step is none of what slip says of the nose."""
    looked_at: list[tuple[Slip, Slip, Slip]] = []
    roll = batch_module.Batch.roll

    def watched(batch: batch_module.Batch, linear: batch_module.Linear, motion: DrivenMotion, *given: Any) -> Solved:
        solved = roll(batch, linear, motion, *given)
        before, after = (batch._slip(state, motion) for state in (linear.state, solved.state))
        assert solved.slip is not None
        looked_at.append((before, after, solved.slip))
        return solved

    monkeypatch.setattr(batch_module.Batch, "roll", watched)
    GraphSmoother().estimate(kart("kart_harsh")[1])
    before, after, predicted = looked_at[0]
    moves = before.moves & after.moves
    moved = (after.value - before.value)[moves]
    missed = (after.value - predicted.value)[moves]
    assert np.std(missed) < 0.2 * np.std(moved)


def test_wheels_draw_no_latency_and_no_arm(both: tuple[Simulation, Session, Trajectory, Trajectory]) -> None:
    _, _, with_wheels, without = both
    for key in ("gps_position_latency", "gps_velocity_latency"):
        one, other = with_wheels.report.identified[key], without.report.identified[key]
        assert (one.value, one.sigma) == (other.value, other.sigma)
    # what is found of the nose turns the kart's axes about the box: the arm stays where it was in those of the box
    arms = [
        np.array(found["R_bs"].value).T @ np.array(found["lever_arm_b"].value)
        for found in (with_wheels.report.identified, without.report.identified)
    ]
    np.testing.assert_allclose(arms[0], arms[1], rtol=0.0, atol=1e-9)


def test_the_first_step_with_wheels_finds_how_much_slip_there_is() -> None:
    """Residuals there are mostly errors of attitudes: the step is to be whole, and these not to pass for slip."""
    simulation, session = kart("kart_harsh")
    found = GraphSmoother().estimate(session).report.identified["slip_sigma"].value
    assert isinstance(found, float)
    motion = simulation.scenario.motion
    assert 0.6 < found / (motion.slip_sigma * motion.slip_per_acceleration * slip_module.HARD) < 1.6


@pytest.mark.parametrize("stated", [False, True])
def test_yaw_is_unsure_by_the_nose_only_where_wheels_tell_it(stated: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation, session = kart("kart")
    if stated:
        mounting = replace(session.config.mounting, R_bs=simulation.scenario.R_bs)
        session = replace(session, config=replace(session.config, mounting=mounting))
    solutions = []
    whole = bridge.estimated

    def watched(solution: Solution, known: Known) -> Estimated:
        assert (known.wheels_heading is None) == stated
        solutions.append((solution, known.wheels_heading or 0.0))
        return whole(solution, known)

    monkeypatch.setattr(bridge, "estimated", watched)
    found = GraphSmoother().estimate(session)
    assert found.report.keyframes is not None
    (solution, beyond), *_ = solutions
    state, covariances, column = solution.step.state, solution.covariances, COLUMNS["slip"].start
    turn = state.R_ns[:, 2, :]
    variance = np.einsum("ki,kij,kj->k", turn, covariances.keyframes[:, ROTATION, ROTATION], turn)
    if not stated:
        variance += 2.0 * np.einsum("ki,ki->k", turn, covariances.with_constants[:, ROTATION, column])
        variance += covariances.constants[column, column] + beyond
    yaw = found.report.keyframes.covariance[:, 2, 2]
    np.testing.assert_allclose(yaw[50:-50], variance[50:-50], rtol=0.02)


def test_a_spin_does_not_keep_wheels_from_telling_the_rest() -> None:
    yaw = []
    for spins in ((), (Spin(60.0, 2.5), Spin(120.0, 2.0))):
        simulation, session = kart("kart", motion_spins=spins)
        found = GraphSmoother().estimate(session)
        assert "slip_sigma" in found.report.identified
        error, _ = errors(simulation, session, found)
        yaw.append(np.sqrt(np.mean(error**2)))
    assert yaw[1] < 1.2 * yaw[0]


@pytest.mark.parametrize("damage", ["none", "wheel", "turned"])
def test_a_box_that_turns_otherwise_than_the_kart_is_left_alone(damage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the steering wheel, or turned by 8 deg on its mount: wheels are not asked for."""
    decided = []
    judge = solve.on_wheels

    def watched(*given: Any) -> Any:
        decided.append(damage)
        return judge(*given)

    monkeypatch.setattr(solve, "on_wheels", watched)
    simulation, session = kart("kart", **({"motion_steering": 10.0 * DEG} if damage == "wheel" else {}))
    if damage == "turned":
        imu = session.imu
        assert imu is not None
        turn = so3.exp(np.array([[0.0, 0.0, 8.0 * DEG]]))[0]
        R_bs = simulation.scenario.R_bs
        in_s = R_bs.T @ turn @ R_bs
        after = imu.t[:, None] > 100.0
        force, rate = (np.where(after, v @ in_s.T, v) for v in (imu.specific_force_s, imu.angular_rate_s))
        session = replace(session, imu=replace(imu, specific_force_s=force, angular_rate_s=rate))
    GraphSmoother().estimate(session)
    assert len(decided) == (1 if damage == "none" else 0)


def test_what_is_steered_is_told_from_wheels_by_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit lies well away from both a box on the frame and one that turns with the hands."""
    scatter = {}
    decide = batch_module.slip_noise
    for steering in (0.0, 10.0 * DEG):
        asked = []

        def watched(*given: Any, asked: list[Any] = asked) -> Any:
            asked.append(given)
            return decide(*given)

        monkeypatch.setattr(batch_module, "slip_noise", watched)
        GraphSmoother().estimate(kart("kart", **({"motion_steering": steering} if steering else {}))[1])
        with monkeypatch.context() as unlimited:
            for limit in ("MOST", "APART", "MOST_SLIDING"):
                unlimited.setattr(slip_module, limit, np.inf)
            noise = decide(*asked[0])
        assert noise is not None
        scatter[steering] = noise.sigma
    assert scatter[0.0] < 0.3 * slip_module.MOST
    assert scatter[10.0 * DEG] > 2.5 * slip_module.MOST


def test_wheels_added_to_the_last_step_find_what_a_step_of_its_own_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    session, found, added = kart("kart", duration=300.0)[1], {}, []
    roll = batch_module.Batch.roll

    def counted(*given: Any) -> Solved:
        solved = roll(*given)
        added.append((given[1].system, given[3], solved.solution))
        return solved

    monkeypatch.setattr(batch_module.Batch, "roll", counted)
    for shares in (True, False):
        with monkeypatch.context() as patch:
            if not shares:
                patch.setattr(solve, "_differ_in_slip_alone", lambda *_: False)
            found[shares] = GraphSmoother().estimate(session)
        assert len(added) == 1
    system, gone, step = added[0]
    assert np.any(gone != 0.0)
    np.testing.assert_array_equal(np.delete(step.constants, np.r_[SLIP]), np.delete(gone, np.r_[SLIP]))
    left = np.einsum("kij,kj->ki", system.diagonal, step.x) + system.border @ step.constants - system.rhs
    left[:-1] += np.einsum("kij,kj->ki", system.upper, step.x[1:])
    left[1:] += np.einsum("kji,kj->ki", system.upper, step.x[:-1])
    np.testing.assert_allclose(left, 0.0, atol=1e-6 * np.max(np.abs(system.rhs)))
    of_constants = system.corner @ step.constants + np.einsum("kim,ki->m", system.border, step.x) - system.rhs_constants
    np.testing.assert_allclose(of_constants[SLIP], 0.0, atol=1e-6 * np.max(np.abs(system.rhs_constants[SLIP])))
    one, other = found[True], found[False]
    assert other.sigmas is not None
    for name in ("position_n", "velocity_n"):
        apart = (getattr(one, name) - getattr(other, name)) / getattr(other.sigmas, name)
        assert 0.0 < np.sqrt(np.mean(apart**2)) < 0.15, name
    slip = [float(np.asarray(t.report.identified["slip_sigma"].value)) for t in (one, other)]
    assert abs(np.log(slip[0] / slip[1])) < 0.05
