"""A solved session in the first edition's types, until its output reads the graph's own."""

from collections.abc import Callable
from dataclasses import dataclass

from smoother.estimate.graph.batch import Solved
from smoother.estimate.graph.inputs import Noise, Priors
from smoother.estimate.model.heading import Heading
from smoother.samples import Problem

Say = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved session, and what it was solved with; heading: of the magnetometer, None where that is not used."""

    solved: Solved
    noise: Noise
    priors: Priors
    problems: tuple[Problem, ...]
    heading: Heading | None = None
