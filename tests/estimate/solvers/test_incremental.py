"""The stream by ISAM2: near to the batch as it goes, and with it where all measurements are linearised again."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from smoother.estimate.factors.graph import Graph, GraphOptions
from smoother.estimate.initial.guess import make_start, problem_of
from smoother.estimate.model.state import COLUMNS
from smoother.estimate.solvers import incremental
from smoother.estimate.solvers.batch import Step, step
from smoother.estimate.solvers.identify import Problem, Solution, identify, solve_held
from smoother.estimate.solvers.incremental import FOUND, Stream, solve_as_stream
from smoother.prepare import prepare
from smoother.sim.scenario import Interval
from smoother.sim.simulation import simulate_preset

OUTAGE = Interval(30.0, 12.0)  # s


@pytest.fixture(name="solved", scope="module")
def _solved() -> tuple[Problem, Solution]:
    """A session with an outage in which the samples are not corrected for what the busiest part showed."""
    simulation = simulate_preset("kart", 3, track="tinbarn", duration=80.0, gnss_outages=(OUTAGE,), gnss_jumps=())
    problem = problem_of(make_start(prepare(simulation.raw), GraphOptions()))
    found = identify(problem, problem.usual, lambda _: None)
    return replace(problem, state=replace(problem.state, constants=found.state.constants)), found


def test_the_stream_ends_near_the_batch(solved: tuple[Problem, Solution]) -> None:
    problem, found = solved
    stream = Stream(problem, found.noise)
    stream.take_all()
    state, batch = stream.state, found.state
    sigma = np.sqrt(np.einsum("kii->ki", found.covariances.keyframes))
    known = (batch.t < OUTAGE.start) | (batch.t > OUTAGE.start + OUTAGE.duration)
    for name, part in (("velocity_n", slice(6, 9)), ("position_n", slice(3, 6))):
        apart = (getattr(state, name) - getattr(batch, name))[known] / np.linalg.norm(sigma[known, part], axis=1)[
            :, None
        ]
        assert np.sqrt(np.mean(apart**2)) < 0.3, name


def test_measurements_linearised_again_take_it_to_the_batch(solved: tuple[Problem, Solution]) -> None:
    problem, found = solved
    held = found.covariances.constants
    stream, batch = (solve(problem, found.noise, held) for solve in (solve_as_stream, solve_held))
    sigma, of_stream = (np.sqrt(np.einsum("kii->ki", s.covariances.keyframes)) for s in (batch, stream))
    apart = (stream.state.velocity_n - batch.state.velocity_n) / sigma[:, 6:9]
    assert np.sqrt(np.mean(apart**2)) < 0.03  # up to 0.3 where a fix beside the outage loses weight
    np.testing.assert_allclose(of_stream, sigma, rtol=0.05)


def test_constants_are_found_in_the_tree(solved: tuple[Problem, Solution]) -> None:
    problem, found = solved
    off = problem.state.constants | {"velocity_latency": problem.state.constants["velocity_latency"] + 0.02}
    problem = replace(problem, state=replace(problem.state, constants=off))
    stream = solve_as_stream(problem, found.noise, found.covariances.constants, free=FOUND)
    sigma = np.sqrt(np.diag(found.covariances.constants))
    for name in ("position_latency", "velocity_latency", "lever_arm"):
        apart = stream.state.constants[name] - found.state.constants[name]
        assert np.all(np.abs(apart) < 0.5 * sigma[COLUMNS[name]]), name
    assert stream.state.constant("velocity_latency") != off["velocity_latency"]


def test_no_step_is_taken_from_the_elimination(
    solved: tuple[Problem, Solution], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its covariances come from it; a step that goes astray moves nothing."""
    problem, found = solved
    expected = solve_as_stream(problem, found.noise, found.covariances.constants).state

    def astray(graph: Graph, values: gtsam.Values) -> Step:
        taken = step(graph, values)
        return replace(taken, keyframes=taken.keyframes + 1.0, moved=problem.state.values())

    monkeypatch.setattr(incremental, "step", astray)
    state = solve_as_stream(problem, found.noise, found.covariances.constants).state
    np.testing.assert_array_equal(state.velocity_n, expected.velocity_n)


def test_without_isam2_there_is_no_stream(solved: tuple[Problem, Solution], monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise RuntimeError("no update")

    monkeypatch.setattr(gtsam.ISAM2, "update", fails)
    with pytest.raises(ArithmeticError, match="no update"):
        solve_as_stream(solved[0], solved[1].noise, solved[1].covariances.constants)
