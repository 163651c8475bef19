"""Solving a session, and what is judged by how far the antenna then is from the box."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smoother.estimate.graph.estimated import Estimated
from smoother.estimate.graph.solve import Say, Solution
from smoother.estimate.graph.windows import WindowsSolution
from smoother.estimate.initial.guess import Start
from smoother.estimate.initial.options import GraphOptions
from smoother.samples import Session

LONGEST_ARM = 2.5  # m from box to antenna, more than any kart is long

Look = Callable[[Start], Start]


def as_it_is(start: Start) -> Start:
    """Return `start`: a first look."""
    return start


@dataclass(frozen=True, eq=False)
class Looked:
    """A solved session, what it was solved with, and the start that it went out from.

    doubt: see :func:`smoother.estimate.graph.identified.identified_values`.
    """

    start: Start
    found: Estimated
    solution: Solution | WindowsSolution
    doubt: float = 0.0


def look(session: Session, start: Start, options: GraphOptions, say: Say, seen: Look = as_it_is) -> Looked:
    """Identify and solve; seen: what the start is made into."""
    from smoother.estimate.bridge import solve_session  # which imports what is above this module

    return Looked(*solve_session(session, seen(start), options, say))


def level_arm(found: Estimated) -> float:
    """How far, m, the antenna is found from the box, seen from above."""
    constants = found.state.constants
    return float(np.linalg.norm(constants.level_axes_s[:2] @ constants.lever_arm_s))
