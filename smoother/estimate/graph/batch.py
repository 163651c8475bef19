"""A solved graph in the first edition's types, until its output reads the graph's own."""

from dataclasses import dataclass

from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.inertial import LinearInertial
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.state import ChainState


@dataclass(frozen=True, eq=False)
class Solved:
    """A linearised, solved graph at `state`: the state itself, its covariances and the rows they came from.

    linearised_at: the state before the step. Covariances are in its axes: turned along with what a step of some degrees
    moved attitudes by, positions would lend velocities their metres.
    Residuals of rows and slip are those after the step, those of inertial before it: only some are asked for.
    """

    state: ChainState
    linearised_at: ChainState
    solution: ChainSolution
    inertial: LinearInertial
    rows: dict[str, Rows]
    slip: None = None
