"""The graph of a session solved as a stream by GTSAM's ISAM2.

A chunk of keyframes is predicted from the samples; its IMU factors and its measurements join the tree. Measurements are
the rows of the table, as linear factors: those of the last seconds are removed and linearised again with every chunk,
older ones stay. Constants are held meanwhile. When all keyframes are in, constants join the same tree as one variable,
all measurements are linearised again until convergence, and the heading and the wheels join. Covariances come from one
elimination of the final factors of the tree.
"""

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, O, V, X

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.factors.gaussian import CONSTANTS_BLOCK, by_interval, columns_of, places, put_in_blocks
from smoother.estimate.factors.graph import Graph, build_graph, with_same_samples
from smoother.estimate.factors.imu import imu_factors
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.heading import Heading
from smoother.estimate.model.imu import corrected
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import DIMENSIONS, KEYS, SIZES, State, keyframe_keys
from smoother.estimate.solvers.batch import Step, step
from smoother.estimate.solvers.covariance import IndeterminateError
from smoother.estimate.solvers.identify import (
    MOST_TURNS,
    Problem,
    Solution,
    held_at,
    rolling_at,
    with_heading,
)
from smoother.estimate.solvers.variance_components import SENSOR_SCALE, slip_sigma

PRIORS_OF_FIRST = 3  # pose, velocity and biases, before those of the constants
AT_REST = 1e-3  # rad, rms, by which all measurements linearised anew still turn the keyframes
CHUNK, WINDOW, CONTEXT = 10.0, 10.0, 20.0  # s: joins at once; is linearised again; is low-passed with it
# rad, m, m/s, m/s^2, rad/s, beyond which GTSAM linearises a variable again; linear ones never. A pose's chart couples
# rotation and translation, and positions change by metres: coarser thresholds make IMU factors inconsistent
LINEAR = 1e6
THRESHOLDS = {"x": [2e-3] * 3 + [0.1] * 3, "v": [0.1] * 3, "b": [0.1] * 3 + [0.01] * 3, "o": [LINEAR] * 3}
# constants that the stream of a session estimates; scale and misalignment of the sensors are no variables of a tree
FOUND = tuple(name for name in KEYS if name not in SENSOR_SCALE)


def solve_as_stream(
    problem: Problem,
    noise: Noise,
    covariance: Array,
    heading: Callable[[State], Heading | None] | None = None,
    free: tuple[str, ...] = (),
) -> Solution:
    """Solve a session or a part of it as a stream, from the first keyframe of `problem` on, and its keyframes after
    intervals without samples.

    covariance (C, C): of the constants in `problem`. heading: of a magnetometer, from the attitudes; None without one.
    free: names of constants that are estimated anew, and with the slip its sigma.
    """
    noise, slip = replace(noise, slip=None, constants={}), noise.slip
    held = held_at(problem, problem.state, free)
    stream = Stream(problem, noise, free)
    try:
        stream.take_all()
        graph = build_graph(problem.binned, held.measured, noise, held.priors, problem.state, problem.table)
        stream.settle(graph)
        if heading is not None:
            held = with_heading(held, heading(stream.state))
        if slip is not None and not stream.state.geometry.is_steered:
            here = _eliminated(graph, stream)
            rolls = rolling_at(here, here.chain().covariances().keyframes, graph)
            if rolls is not None:
                held, noise = replace(held, measured=replace(held.measured, rolls=rolls)), replace(noise, slip=slip)
        graph = with_same_samples(graph, held.measured, noise, held.priors, stream.state)
        stream.settle(graph)
        if noise.slip is not None and "slip" in free:
            here = _eliminated(graph, stream)
            noise = replace(noise, slip=slip_sigma(here, here.chain().covariances(), noise.slip))
            graph = with_same_samples(graph, held.measured, noise, held.priors, stream.state)
            stream.settle(graph)
        here = _eliminated(graph, stream)
    except RuntimeError as error:  # what GTSAM's exceptions are in Python
        raise IndeterminateError(str(error).strip().partition("\n")[0]) from error
    chain = here.chain().with_constants(covariance, columns_of(free))
    return Solution(graph, here, chain, chain.covariances())


class Stream:
    """The tree, and the estimate of every keyframe that is in it. free: names of constants that join at the end."""

    def __init__(self, problem: Problem, noise: Noise, free: tuple[str, ...] = ()) -> None:
        p = held_at(problem, problem.state)
        binned = corrected(p.binned, p.state)
        self._graph = build_graph(binned, p.measured, noise, p.priors, p.state, p.table)
        self._first, self._end = p.state, 0
        self._sampled = set(self._graph.sampled.tolist())
        self.values = p.state.part(slice(1)).values()
        self._free, self._joined = free, False
        self._in_tree: list[int] = []  # index of the measurements of each interval
        parameters, thresholds = gtsam.ISAM2Params(), gtsam.ISAM2ThresholdMap()
        for symbol, limit in (THRESHOLDS | {"c": [LINEAR] * places(free)[1]}).items():
            thresholds.insert((symbol, np.array(limit)))
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = 1
        parameters.setFactorization(
            "QR"
        )  # fixes at a high rate without speeds are nearly singular at first for Cholesky
        self._tree = gtsam.ISAM2(parameters)

    @property
    def state(self) -> State:
        """The estimate of the keyframes that are in the tree, and the constants."""
        return self._first.part(slice(self._end)).with_values(self.values)

    def take_all(self) -> None:
        """Add all keyframes, chunk by chunk. Raises RuntimeError where an unknown is not determined."""
        n, first, chunk = (len(self._first.t), *(round(s / self._first.interval) for s in (WINDOW, CHUNK)))
        for end in [*range(first, n - chunk + 1, chunk), n]:
            self.advance(end)
        self.values.update(self._tree.calculateBestEstimate())

    def advance(self, end: int) -> None:
        """Add the keyframes up to `end`, exclusive, with the samples and measurements between them."""
        begin, self._end = self._end, end
        self._measure(begin, *self._predicted(begin))
        # after an outage the prediction is too far off for robust weights, which are known only now
        self._measure(end, gtsam.NonlinearFactorGraph(), gtsam.Values())

    def settle(self, graph: Graph) -> None:
        """Linearise all measurements of `graph` again, with free constants as unknowns, until convergence."""
        for _ in range(MOST_TURNS):
            before, new, added = self.state, gtsam.Values(), gtsam.NonlinearFactorGraph()
            if self._free and not self._joined:
                self._joined = True
                new.insert(CONSTANTS_BLOCK, np.concatenate([before.constants[name] for name in self._free]))
                self.values.insert(new)
                added.add(gtsam.LinearContainerFactor(self._prior(graph), self.values))
            self._replace_rows(graph.rows(before), 0, added, new)
            self._take_estimate(self._tree.calculateBestEstimate())
            turn = so3.log(before.R_ns.transpose(0, 2, 1) @ self.state.R_ns)
            if np.sqrt(np.mean(np.sum(turn**2, axis=1))) < AT_REST:
                return

    def _take_estimate(self, values: gtsam.Values) -> None:
        self.values.update(values)
        if self._joined:
            found, (starts, _) = values.atVector(CONSTANTS_BLOCK), places(self._free)
            for name, start in starts.items():
                self.values.update(KEYS[name], found[start : start + SIZES[name]])

    def _prior(self, graph: Graph) -> gtsam.JacobianFactor:
        """What is known beforehand of the free constants, at their values, as one factor of all."""
        system = gtsam.GaussianFactorGraph()
        linear = graph.prior.linearize(self.values)
        for i in range(PRIORS_OF_FIRST, linear.size()):
            put_in_blocks(linear.at(i), self._free, system)
        A, b = system.jacobian()
        return gtsam.JacobianFactor(CONSTANTS_BLOCK, A, b, gtsam.noiseModel.Unit.Create(len(b)))

    def _predicted(self, begin: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Predict the keyframes from `begin` on. Returns what GTSAM's own factors say of them, and their values."""
        new, x, sampled, first = gtsam.Values(), self.values, self._graph.sampled, self._first
        phi = np.exp(-first.interval / self._graph.noise.offset_tau)
        for k in range(begin, self._end):
            if k > 0:
                bias = x.atConstantBias(B(k - 1))
                if k - 1 in self._sampled:
                    at = gtsam.NavState(x.atPose3(X(k - 1)), x.atVector(V(k - 1)))
                    reached = self._graph.preintegrated[k - 1].predict(at, bias)
                else:
                    reached = gtsam.NavState(gtsam.Rot3(first.R_ns[k]), first.position_n[k], first.velocity_n[k])
                x.insert(X(k), reached.pose())
                x.insert(V(k), reached.velocity())
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
        interval, end = self._first.interval, self._end
        window = max(0, begin - 1 - round(WINDOW / interval))
        first = max(0, window - round(CONTEXT / interval))
        state = self.state
        measured = self._graph.measured.between(state.t, first, end)
        rows = replace(self._graph, measured=measured).rows(state.part(slice(first, end)))
        rows = [replace(r, interval=r.interval + first) for r in rows]
        rows = [replace(r, weight=np.where(r.interval >= begin - 1, 1.0, r.weight)) for r in rows]
        self._replace_rows(rows, window, graph, new)
        self.values.update(self._tree.calculateEstimate())

    def _replace_rows(
        self, rows: list[Rows], window: int, graph: gtsam.NonlinearFactorGraph, new: gtsam.Values
    ) -> None:
        """Add `graph` and `new` to the tree, and `rows` in place of those of the intervals from `window` on."""
        factors, free = graph.size(), self._free if self._joined else ()
        sizes = [*DIMENSIONS, *DIMENSIONS, *([places(free)[1], 1] if free else [1])]
        for k, A in by_interval(rows, window, self._end - 1, free):
            keys = [*keyframe_keys(k), *keyframe_keys(k + 1), CONSTANTS_BLOCK][: len(sizes) - 1]
            of_interval = gtsam.GaussianConditional(keys, 1, gtsam.VerticalBlockMatrix(sizes, A))
            graph.add(gtsam.LinearContainerFactor(of_interval, self.values))
        old = gtsam.KeyList()  # stay linearised where they are, until the end
        for k in range(window):
            for key in keyframe_keys(k):
                old.push_back(key)
        result = self._tree.update(graph, new, self._in_tree[window:], None, old)
        self._in_tree[window:] = result.getNewFactorsIndices()[factors:]


def _eliminated(graph: Graph, stream: Stream) -> Step:
    """The graph linearised and eliminated at the estimate of the stream, without taking the step."""
    values = stream.values
    taken = step(graph, values)
    still = np.zeros_like(taken.keyframes), np.zeros_like(taken.constants)
    return replace(taken, keyframes=still[0], constants=still[1], moved=values)
