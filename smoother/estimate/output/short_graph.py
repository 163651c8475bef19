"""The graph of a few seconds of a session, for those who want to see it: with all factors as GTSAM's own.

What solves a session hands GTSAM linear factors, made of all measurements at once. Here the same rows are CustomFactors
in one gtsam.NonlinearFactorGraph, so that GTSAM's optimizers and Marginals can be tried on it, and other factors added.
That is for seconds: the cost of a CustomFactor grows with the length of the graph.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from smoother.arrays import Array
from smoother.errors import UsageError
from smoother.estimate.factors.gaussian import custom_factors
from smoother.estimate.factors.graph import Factor, Graph, GraphOptions, Inputs, build_graph
from smoother.estimate.factors.rows import Rows, robust
from smoother.estimate.initial.guess import make_start, problem_of, stretch
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.state import COLUMNS, DIMENSIONS, KEYS, State, keyframe_keys
from smoother.estimate.solvers.batch import step
from smoother.estimate.solvers.identify import identify
from smoother.estimate.solvers.incremental import FOUND
from smoother.estimate.solvers.variance_components import SENSOR_SCALE
from smoother.samples import Session

FEWEST = 3  # keyframes


@dataclass(frozen=True, eq=False)
class ShortGraph:
    """The graph of some keyframes at t (K,) s, and the values to begin with. Scales of the sensors are held: GTSAM's
    CombinedImuFactor has none.

    Variables are X(k) Pose3 of the sensor in n, V(k) m/s in n, B(k) biases and O(k) m, the slow error of the fixes, as
    in docs/estimation.md. keys: those of the constants, by name; their priors are those of all of the session.
    """

    graph: Graph
    values: gtsam.Values

    @property
    def t(self) -> Array:
        """Times of the keyframes, (K,) s."""
        return self.graph.state.t

    @property
    def keys(self) -> Mapping[str, int]:
        """Keys of the constants of the session."""
        return KEYS

    def factors(self, values: gtsam.Values) -> dict[str, gtsam.NonlinearFactorGraph]:
        """Return all factors by their names in the table, `imu` and `prior` beside them.

        Slopes by constants are those of the low-passed motion along `values`, and robust weights are held as they are
        there.
        """
        state, inertial = self.graph.state.with_values(values), self.graph.noise.inertial
        motion = LowPassedMotion(state, inertial.accel, inertial.gyro)
        out = {"prior": self.graph.prior, "imu": self.graph.imu}
        for factor in self.graph.table:
            parts = range(len(self._rows(factor, state, motion)))
            custom = [
                one
                for i in parts
                for one in custom_factors(lambda at, i=i, f=factor: self._rows(f, at, motion)[i], state)  # type: ignore[misc]
            ]
            if custom:
                out[factor.name] = gtsam.NonlinearFactorGraph()
                for one in custom:
                    out[factor.name].add(one)
        return out

    def _rows(self, factor: Factor, state: State, motion: LowPassedMotion) -> list[Rows]:
        g = self.graph
        inputs = Inputs(g.measured, g.noise, g.priors, state, motion)
        return [robust(rows) if factor.is_robust else rows for rows in factor.rows(inputs)]

    def step(self, values: gtsam.Values) -> gtsam.Values:
        """Return the values after one step of the loop that solves sessions."""
        return step(self.graph, values, FOUND).moved

    def covariances(self, values: gtsam.Values) -> dict[int, Array]:
        """Return the covariance of every variable by its key, from one sweep over what GTSAM eliminates at `values`."""
        found = step(self.graph, values, FOUND).chain().covariances()
        ends = np.cumsum([0, *DIMENSIONS]).tolist()
        out: dict[int, Array] = {}
        for k, covariance in enumerate(found.keyframes):
            for key, begin, end in zip(keyframe_keys(k), ends[:-1], ends[1:], strict=True):
                out[key] = covariance[begin:end, begin:end]
        return out | {key: found.constants[COLUMNS[name], COLUMNS[name]] for name, key in KEYS.items()}


def short_graph(session: Session, begin: float, lasts: float) -> ShortGraph:
    """Return the graph of `lasts` seconds from `begin` s on, with the noise and the constants of the whole session.

    The values to begin with are those that all of the session would be solved from. Clocks are taken as they are.
    Raises UsageError where there are no keyframes.
    """
    start = make_start(session, GraphOptions().for_fixes(session.gnss.t))
    t = start.state.t
    first, last = (int(k) for k in np.searchsorted(t, [begin, begin + lasts]))
    if min(last, len(t) - 1) - first < FEWEST:
        raise UsageError(f"no keyframes from {begin:.1f} s on for {lasts:.1f} s; there are {t[0]:.1f} to {t[-1]:.1f} s")
    problem = problem_of(start)
    solution = identify(problem, problem.usual, lambda _: None)
    part = stretch(start, first, min(last, len(t) - 1))
    sigmas = np.sqrt(np.diag(solution.covariances.constants))
    constants = {name: (value, sigmas[COLUMNS[name]]) for name, value in solution.state.constants.items()}
    for name in SENSOR_SCALE:
        constants[name] = np.zeros_like(constants[name][0]), constants[name][1]
    state = replace(part.state, constants={name: mean for name, (mean, _) in constants.items()})
    priors = replace(part.priors, constants=constants)
    graph = build_graph(part.binned, part.data, solution.noise, priors, state, part.table)
    return ShortGraph(graph, state.values())
