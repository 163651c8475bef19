"""The graph of a session solved as a stream by GTSAM's ISAM2, for constants and noise that are known.

A chunk of keyframes is predicted from the samples; its IMU factors and its measurements join the tree. Measurements are
the rows of the table, as linear factors: those of the last seconds are removed and linearised again with every chunk,
older ones stay. What is left of old linearisations one or two steps of the batch remove, which give the covariances.
"""

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, O, V, X

from smoother.arrays import Array
from smoother.estimate.factors.graph import build_graph
from smoother.estimate.factors.imu import imu_factors
from smoother.estimate.model.heading import Heading
from smoother.estimate.model.imu import corrected
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import DIMENSIONS, KEYFRAME_SIZE, State, keyframe_keys
from smoother.estimate.solvers.covariance import IndeterminateError
from smoother.estimate.solvers.identify import Problem, Solution, held_at, solve_held

WIDTH = 2 * KEYFRAME_SIZE + 1  # two keyframes and the residual
PRIORS_OF_FIRST = 3  # pose, velocity and biases, before those of the constants
CHUNK, WINDOW, CONTEXT = 5.0, 10.0, 20.0  # s: joins at once; is linearised again; is low-passed with it
# rad, m, m/s, m/s^2, rad/s, beyond which GTSAM linearises a variable again. A pose's chart couples turn and shift, and
# absolute position wanders by metres: with coarser ones the IMU factors tear. The slow error is linear
THRESHOLDS = {"x": [2e-3] * 3 + [0.1] * 3, "v": [0.1] * 3, "b": [0.1] * 3 + [0.01] * 3, "o": [1e6] * 3}


def solve_as_stream(
    problem: Problem, noise: Noise, covariance: Array, heading: Callable[[State], Heading | None] | None = None
) -> Solution:
    """As :func:`solve_held`, from the keyframes that a stream gives: of those of `problem` the first one counts.

    covariance (C, C): of the constants. heading: as for :func:`identify`, asked after the stream.
    """
    if problem.measured.unsampled is not None and len(problem.measured.unsampled.at):
        return solve_held(problem, noise, covariance, heading)  # what a stream predicts across a hole is no beginning
    state = Stream(problem, replace(noise, slip=None)).solve()
    return solve_held(replace(problem, state=state), noise, covariance, heading)


class Stream:
    """The tree, and the estimate of every keyframe that is in it; constants are held, and no variables of the tree."""

    def __init__(self, problem: Problem, noise: Noise) -> None:
        p, noise = held_at(problem, problem.state), replace(noise, constants={})
        self._graph = build_graph(corrected(p.binned, p.state), p.measured, noise, p.priors, p.state, p.table)
        self._state, self._end = p.state, 0
        self._values = p.state.part(slice(1)).values()
        self._in_tree: list[list[int]] = []  # indices of the measurements of each interval
        parameters, thresholds = gtsam.ISAM2Params(), gtsam.ISAM2ThresholdMap()
        for symbol, limit in THRESHOLDS.items():
            thresholds.insert((symbol, np.array(limit)))
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = 1
        parameters.setFactorization("QR")  # quick fixes without speeds say little at first: digits of Cholesky run out
        self._tree = gtsam.ISAM2(parameters)

    def solve(self) -> State:
        """All keyframes, chunk by chunk. Raises IndeterminateError where an unknown is not determined."""
        n, first, chunk = (len(self._state.t), *(round(s / self._state.interval) for s in (WINDOW, CHUNK)))
        try:
            for end in [*range(first, n - chunk + 1, chunk), n]:
                self.advance(end)
            self._values.update(self._tree.calculateBestEstimate())
        except RuntimeError as error:  # what GTSAM's exceptions are in Python
            raise IndeterminateError(str(error).strip().partition("\n")[0]) from error
        return self._state.with_values(self._values)

    def advance(self, end: int) -> None:
        """Take in the keyframes up to `end`, exclusive, the samples between them and what was measured there."""
        begin, self._end = self._end, end
        self._measure(begin, *self._predicted(begin))
        # a prediction after an outage is off by more than a robust weight forgives: only now are weights known
        self._measure(end, gtsam.NonlinearFactorGraph(), gtsam.Values())

    def _predicted(self, begin: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Predict the keyframes from `begin` on. Returns what GTSAM's own factors say of them, and their values."""
        new, x, sampled = gtsam.Values(), self._values, self._graph.sampled
        phi = np.exp(-self._state.interval / self._graph.noise.offset_tau)
        for k in range(begin, self._end):
            if k > 0:
                bias, at = x.atConstantBias(B(k - 1)), gtsam.NavState(x.atPose3(X(k - 1)), x.atVector(V(k - 1)))
                predicted = self._graph.preintegrated[k - 1].predict(at, bias)
                x.insert(X(k), predicted.pose())
                x.insert(V(k), predicted.velocity())
                x.insert(B(k), bias)
                x.insert(O(k), phi * x.atVector(O(k - 1)))
            new.insert(X(k), x.atPose3(X(k)))
            new.insert(B(k), x.atConstantBias(B(k)))
            new.insert(V(k), x.atVector(V(k)))
            new.insert(O(k), x.atVector(O(k)))
        graph = imu_factors(self._graph.preintegrated, sampled[(sampled >= begin - 1) & (sampled < self._end - 1)])
        for i in range(PRIORS_OF_FIRST if begin == 0 else 0):
            graph.add(self._graph.prior.at(i))
        return graph, new

    def _measure(self, begin: int, graph: gtsam.NonlinearFactorGraph, new: gtsam.Values) -> None:
        """Add `graph` and `new`, and linearise the measurements of the last seconds before keyframe `begin`, and since.

        Those since then have full weight.
        """
        interval, end, factors = self._state.interval, self._end, graph.size()
        window = max(0, begin - 1 - round(WINDOW / interval))
        first = max(0, window - round(CONTEXT / interval))
        state = self._state.part(slice(end)).with_values(self._values)
        measured = self._graph.measured.between(state.t, first, end)
        of_intervals = []
        for r in replace(self._graph, measured=measured).rows(state.part(slice(first, end))):
            r = replace(r, interval=r.interval + first, constants={})
            r = replace(r, weight=np.where(r.interval >= begin - 1, 1.0, r.weight))
            r = r.take(np.flatnonzero(r.interval >= window))
            A = r.whitened({}, WIDTH).reshape(*r.residual.shape, WIDTH)
            for k, of_one in zip(r.interval.tolist(), A, strict=True):
                blocks = gtsam.VerticalBlockMatrix([*DIMENSIONS, *DIMENSIONS, 1], of_one)
                factor = gtsam.GaussianConditional([*keyframe_keys(k), *keyframe_keys(k + 1)], 1, blocks)
                graph.add(gtsam.LinearContainerFactor(factor, self._values))
                of_intervals.append(k)
        old = [index for of_interval in self._in_tree[window:] for index in of_interval]
        indices = self._tree.update(graph, new, old).getNewFactorsIndices()
        self._in_tree[window:] = [[] for _ in range(end - 1 - window)]
        for k, index in zip(of_intervals, indices[factors:], strict=True):
            self._in_tree[k].append(index)
        self._values.update(self._tree.calculateEstimate())
