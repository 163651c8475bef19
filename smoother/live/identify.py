"""Identification of mounting, latencies and noise from the data received so far.

The batch smoother runs over the window in a process of its own. Its graph without the last seconds, marginalised, is
the prior of the stream, so that no fix counts twice.
"""

from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from smoother.arrays import Array
from smoother.errors import SmootherError
from smoother.estimate.factors.graph import build_graph
from smoother.estimate.initial.guess import problem_of
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.estimate.solve import Solved
from smoother.estimate.solvers.batch import step
from smoother.estimate.solvers.identify import FREE, held_at
from smoother.fit.plan_path import PlanPath
from smoother.frames import Origin
from smoother.laps.circuit import find_circuit
from smoother.laps.results import GivenLines, Line
from smoother.live.lag import LAG, LagStart
from smoother.live.lag_graph import Marginal, rolling
from smoother.samples import GnssFixes, ImuSamples, Problem, Session

T_co = TypeVar("T_co", covariant=True)
MOVED = 5.0  # m/s; slower fixes hardly show the mounting


@dataclass(frozen=True, eq=False)
class Window:
    """Received data, oldest first. Fixes as in a session; n at `origin`."""

    imu: ImuSamples
    fixes: GnssFixes
    origin: Origin


def identify(window: Window) -> LagStart | str:
    """Return the start of a stream, with its prior and noise; or the reason why there is none.

    A latency of the accelerometer is not corrected in the stream.
    """
    session, kept = Session("live", window.fixes, window.origin, window.imu), list[Solved]()
    options = replace(GraphOptions(), rate=5.0, in_step=False)  # Hz; the rows are not used
    try:
        report = GraphSmoother(options, keep=kept.append).estimate(session).report
    except (SmootherError, ValueError, np.linalg.LinAlgError) as error:
        return str(error)
    if report.mode != "full" or report.keyframes is None:
        return "; ".join(problem.text for problem in report.problems) or "the fixes alone"
    start, found, mounting = kept[-1].start, kept[-1].found, report.identified["R_bs"]
    state, noise = found.state, found.known.noise
    measured, with_wheels = replace(start.data, rolls=rolling(state, noise)), noise.slip is not None
    priors = held_at(problem_of(start), state, FREE).priors if with_wheels else start.priors
    graph = build_graph(start.binned, measured, noise, priors, state, start.table)
    leave = int(np.searchsorted(state.t, window.imu.t[-1] - LAG)) - 1
    if leave < 10:  # keyframes of a usable result
        return "the window is too short"
    try:
        known = Marginal.of(step(graph, state.values()), graph.prior, leave)
    except ArithmeticError as error:
        return str(error)
    return LagStart(
        state.part(slice(0, leave)),
        known,
        noise,
        priors,
        found.known.constants_covariance if with_wheels else None,
        np.array(mounting.value),
        np.array(mounting.sigma),
        np.zeros(3) if report.keyframes.unseen_offset is None else report.keyframes.unseen_offset,
    )


def find_line(t: Array, position_n: Array, velocity_n: Array, given: GivenLines | None) -> Line | None:
    """Return the start line of the laps, None without a loop. t (N,) s; position_n, velocity_n (N, 3)."""
    path = PlanPath(t, position_n[:, :2], velocity_n[:, :2], position_n[:, 2])
    try:
        circuit = find_circuit(path, given, None, 100.0, np.zeros(len(t), dtype=np.bool_))  # m, as for recorded laps
    except (SmootherError, ValueError, IndexError):
        return None
    return None if isinstance(circuit, Problem) else circuit.start_line


class Job(Protocol[T_co]):
    """A requested computation; its result is text where it failed."""

    def done(self) -> bool:
        """Whether there is a result."""
        ...

    def result(self) -> T_co | str:
        """Return it. Only once it is done."""
        ...
