"""The batch: GTSAM carries it, all rows of the table count, and it ends where GTSAM's own optimizer ends."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from smoother.estimate.factors.gaussian import custom_factors
from smoother.estimate.factors.graph import TABLE, GraphOptions, Inputs, build_graph
from smoother.estimate.factors.motion_prior import Unsampled
from smoother.estimate.initial.guess import make_start, problem_of
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.state import State
from smoother.estimate.smoother import GraphSmoother
from smoother.estimate.solvers.batch import step
from smoother.estimate.solvers.covariance import IndeterminateError
from smoother.estimate.solvers.identify import Problem, identify
from smoother.prepare import prepare
from smoother.samples import Session, WheelSpeed
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import Trajectory

SMALL = ("gps_position", "gps_velocity", "gps_offset")


@pytest.fixture(name="session", scope="module")
def _session() -> Session:
    simulation = simulate_preset("kart", 3, track="tinbarn", duration=60.0, gnss_outages=(), motion_standstill=5.0)
    return prepare(simulation.raw)


@pytest.fixture(name="problem", scope="module")
def _problem(session: Session) -> Problem:
    return problem_of(make_start(session, GraphOptions()))


def no_progress(_: float) -> None:
    return


def estimate(session: Session) -> Trajectory:
    return GraphSmoother().estimate(session)


def test_without_the_elimination_of_gtsam_there_is_no_solution_at_all(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert estimate(session).report.mode == "full"

    def fails(*_: object) -> None:
        raise RuntimeError("no elimination")

    monkeypatch.setattr(gtsam.GaussianFactorGraph, "eliminateSequential", fails)
    with pytest.raises(IndeterminateError, match="no elimination"):
        estimate(session)


def test_the_trajectory_is_that_of_the_final_values(problem: Problem) -> None:
    found = identify(problem, problem.usual, no_progress)
    pose = found.step.moved.atPose3(gtsam.symbol("x", 40))
    np.testing.assert_array_equal(found.state.position_n[40], pose.translation())
    np.testing.assert_array_equal(found.state.R_ns[40], pose.rotation().matrix())


@pytest.mark.parametrize(
    "name", [factor.name for factor in TABLE if factor.name not in ("heading", "wheels", "ground")]
)
def test_each_row_of_the_table_counts(name: str, problem: Problem) -> None:
    """The session has neither a usable heading without a solution, nor wheels or ground before one."""
    hole = np.isin(np.arange(len(problem.state.t) - 1), [100, 101]).astype(np.float64)
    unsampled = Unsampled.of(hole, problem.state, problem.measured.t, follows=True)
    state = problem.state
    wheel = WheelSpeed(state.t[10:-10:10], 1.1 * np.linalg.norm(state.velocity_n[10:-10:10], axis=1))
    problem = replace(problem, measured=replace(problem.measured, unsampled=unsampled, wheel_speed=wheel))
    without = replace(problem, table=tuple(factor for factor in TABLE if factor.name != name))
    values = problem.state.values()

    def moved(problem: Problem) -> np.ndarray:
        graph = build_graph(
            problem.binned, problem.measured, problem.usual, problem.priors, problem.state, problem.table
        )
        return step(graph, values).after.velocity_n

    if name in ("gps_offset", "motion_prior"):  # nothing else holds the slow error, or crosses a hole in the samples
        with pytest.raises(ArithmeticError):
            moved(without)
    else:
        assert np.abs(moved(problem) - moved(without)).max() > 1e-3


def test_a_small_graph_ends_where_the_optimizer_of_gtsam_ends(problem: Problem) -> None:
    """With the same rows as CustomFactor, along the same low-passed motion, from the same start."""
    held = {"velocity_response": (np.zeros(1), np.full(1, 1e-3))}  # two seconds say nothing of it
    some = _some(problem, 10, 22)
    some = replace(some, priors=replace(some.priors, constants=some.priors.constants | held))
    table = tuple(factor for factor in TABLE if factor.name in SMALL)
    graph = build_graph(some.binned, some.measured, some.usual, some.priors, some.state, table)
    motion = LowPassedMotion(some.state, 1e-3, 1e-4)
    whole = gtsam.NonlinearFactorGraph(graph.imu)
    whole.push_back(graph.prior)
    for factor in table:
        for i in range(len(list(factor.rows(_inputs(some, some.state, motion))))):

            def build(state: State, factor=factor, i=i):  # type: ignore[no-untyped-def]
                return list(factor.rows(_inputs(some, state, motion)))[i]

            for one in custom_factors(build, some.state):
                whole.add(one)
    values = some.state.values()
    start = whole.error(values)
    found = gtsam.LevenbergMarquardtOptimizer(whole, values).optimize()
    ours = values
    for _ in range(8):
        ours = step(graph, ours).moved
    assert whole.error(found) < 0.5 * start
    assert whole.error(ours) < 1.02 * whole.error(found)


def _inputs(problem: Problem, state: State, motion: LowPassedMotion) -> Inputs:
    return Inputs(problem.measured, problem.usual, problem.priors, state, motion)


def _some(problem: Problem, begin: int, end: int) -> Problem:
    """The keyframes begin .. end - 1 of a problem, and the fixes between them."""
    s, m = problem.state, problem.measured
    names = ("t", "R_ns", "position_n", "velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")
    state = replace(s, **{name: getattr(s, name)[begin:end] for name in names})
    use = (m.t > state.t[2]) & (m.t < state.t[-2])
    measured = replace(m.of(use), still=np.empty(0, np.int64), unsampled=None)
    return replace(problem, state=state, measured=measured, binned=problem.binned.between(begin, end))
