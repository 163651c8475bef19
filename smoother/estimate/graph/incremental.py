"""The same graph as batch.py, solved by GTSAM's ISAM2 as the keyframes come in.

A chunk of keyframes is predicted from the inertial samples, its inertial factors join the tree, and then its fixes do.
The measurements are the rows of rows.py: linearised about the newest estimate they become linear factors, and over the
last seconds of the stream they are taken out and linearised again with every chunk, robust weights included. Older ones
stay as they are: what still moves there is what is linear in them, the slow wander of absolute position.

Not estimated here: the constants of the session and the noise. They couple to every keyframe, and a tree in which
everything hangs on one node is rebuilt with every chunk. They come from an identification (or from the settings) and
stay frozen; so a live stream needs values identified on a session before it. Nor are wheels asked for: while the turns
of the newest keyframes are open, rows of slip would be weighed by the errors of these.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, O, V, X

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.estimate.graph.batch import Batch, Solved
from smoother.estimate.graph.chain import NotPositiveDefiniteError
from smoother.estimate.graph.imu import BinnedImu, corrected, dense_path
from smoother.estimate.graph.inertial import inertial_factors
from smoother.estimate.graph.inputs import Data, Noise, Priors
from smoother.estimate.graph.preintegration import preintegrate
from smoother.estimate.graph.rows import Rows, heading_rows
from smoother.estimate.graph.session_rows import expected_of, session_rows
from smoother.estimate.graph.state import ACCEL_BIAS, GYRO_BIAS, OFFSET, VELOCITY, ChainState, Constants

# GTSAM's variables of a keyframe, and the columns of its tangent that each one holds
_POSE, _BIAS = slice(0, VELOCITY.start), slice(ACCEL_BIAS.start, GYRO_BIAS.stop)
_VARIABLES = ((X, _POSE), (V, VELOCITY), (B, _BIAS), (O, OFFSET))
LINEAR = ("gps_offset",)  # rows that never need another linearisation
LINEAR_FIRST = ("gps_offset_start", "bias_prior", "pose_prior")  # likewise, on the first keyframe
ENOUGH_FIXES = 3  # at the start, to determine position and velocity
MOVED = 0.01  # rad of attitude, beyond which the measurements of a keyframe are linearised again


@dataclass(frozen=True)
class IncrementalOptions:
    """Options of the stream, in keyframes.

    chunk: 5 s at five keyframes a second, over which a kart's inertial sensor predicts to some metres. window: how
    far back fixes are linearised again; attitude and weights are settled after 10 s. context: before the window, from
    which the noise of the inertial shape is judged. growth: of the stream,
    after which GTSAM may linearise all of it again; a factor, so that the cost stays linear. factorization: CHOLESKY,
    or QR, which has twice the digits and takes some times as long.
    """

    chunk: int = 25
    window: int = 50
    context: int = 100
    growth: float = 1.3
    factorization: str = "CHOLESKY"


# Steps, in rad, m, m/s, m/s^2, rad/s, beyond which GTSAM linearises a variable again. A pose's chart couples turn and
# shift, and absolute position wanders by metres: with coarse thresholds the inertial factors tear.
_RELINEARIZE = {"x": [2e-3] * 3 + [0.1] * 3, "v": [0.1] * 3, "b": [0.1] * 3 + [0.01] * 3, "o": [1e6] * 3}
_WILDFIRE = 1e-5  # change of a step, in rad, m, m/s, that is still passed on towards older keyframes


def solve_as_stream(
    batch: Batch,
    data: Data,
    binned: BinnedImu,
    priors: Priors,
    noise: Noise,
    start: ChainState,
    constants: Constants,
    held: Array | None = None,
) -> Solved:
    """Return the solution of :func:`solve_incrementally` after one step of `batch`, with that step's covariances.

    The step removes what the stream leaves: old measurements are linear in the axes of poses that have turned since, by
    which absolute position is off by up to half a sigma. The covariances contain how unsure the constants are: as the
    step finds, or held (31, 31) where they are known from elsewhere.
    """
    state = solve_incrementally(data, binned, priors, noise, start, constants)
    return batch.step(batch.graph(state, noise), state, noise, held=held)


def solve_incrementally(
    data: Data,
    binned: BinnedImu,
    priors: Priors,
    noise: Noise,
    start: ChainState,
    constants: Constants,
    options: IncrementalOptions | None = None,
) -> ChainState:
    """Return all keyframes of `start` solved as a stream. Of `start`, only times and the first keyframe are used.

    binned as measured; the sensor errors among the frozen `constants` are taken out here.
    Raises NotPositiveDefiniteError when the measurements do not determine the keyframes.
    """
    options = options or IncrementalOptions()
    try:
        return _streamed(Stream(data, binned, priors, noise, start, constants, options))
    except NotPositiveDefiniteError:  # quick fixes without speeds tell little before they tell it well; digits run out
        exact = replace(options, factorization="QR")
        return _streamed(Stream(data, binned, priors, noise, start, constants, exact))


def _streamed(stream: "Stream") -> ChainState:
    try:
        for end in stream.chunk_ends():
            stream.advance(end)
        return stream.finish()
    except RuntimeError as error:  # what GTSAM's exceptions are in Python
        said = str(error).strip().partition("\n")[0] or "a number is not finite"
        raise NotPositiveDefiniteError(said) from error


class Stream:
    """The tree and the newest estimate of every keyframe that is in it. Each `advance` changes both."""

    def __init__(
        self,
        data: Data,
        binned: BinnedImu,
        priors: Priors,
        noise: Noise,
        start: ChainState,
        constants: Constants,
        options: IncrementalOptions,
    ) -> None:
        self._data, self._priors, self._noise, self._options = data, priors, noise, options
        self._binned = corrected(binned, constants)
        self._state = _own_copy(start, constants)
        self._position_at = _interval_of(start, data.t - constants.position_latency)
        self._velocity_at = _interval_of(start, data.t - constants.velocity_latency)
        self._tree = gtsam.ISAM2(_parameters(options.factorization))
        self._end = 0
        self._held, self._n_held = gtsam.KeyList(), 0  # variables that stay where they were linearised, and keyframes
        self._last_relinearized = 0  # end of the stream when all were free to be
        self._indices: list[list[int]] = []  # in the tree, of the factors of each interval that can be replaced

    @property
    def state(self) -> ChainState:
        """The newest estimate, up to the end of the stream."""
        return _part(self._state, 0, self._end)

    def chunk_ends(self) -> list[int]:
        """Keyframes after which a chunk ends: the first one holds enough fixes to stand on, the last one the rest."""
        n, chunk = len(self._state.t), self._options.chunk
        known = np.flatnonzero(np.any(np.isfinite(self._data.position_n), axis=1))[:ENOUGH_FIXES]
        enough = int(self._position_at[known[-1]]) + 2 if len(known) else n
        return [*range(max(chunk, enough), n - chunk + 1, chunk), n]

    def advance(self, end: int) -> None:
        """Take in the keyframes up to `end` (exclusive), the inertial samples between them and their fixes."""
        begin = self._end
        window = self._window(begin)
        estimate = self._estimate(window)
        self._end = end
        self._hold(window)
        graph = self._predict(begin)
        new = self._values(begin)
        estimate.insert(new)
        # A prediction after an outage is off by more than a robust weight forgives: at first every fix has its say.
        self._measure(window, max(begin - 1, 0), estimate, graph, new)
        self._refine(window)

    def _refine(self, window: int) -> None:
        """Linearise the measurements of the intervals from `window` on again, about the newest estimate."""
        self._measure(window, self._end, self._estimate(window), gtsam.NonlinearFactorGraph(), gtsam.Values())

    def finish(self) -> ChainState:
        """Return the estimate of all keyframes, solved to the end (the tree passes on no change below a threshold)."""
        self._read(0, self._tree.calculateBestEstimate())
        return self.state

    def _hold(self, window: int) -> None:
        """Hold what is older than the window, but let all go when the stream has grown by a share or moved back there.

        Absolute position wanders: without this, something old is linearised again and the tree rebuilt in every update.
        """
        options = self._options
        if self._end > options.growth * self._last_relinearized or window < self._end - options.window - options.chunk:
            self._held, self._n_held, self._last_relinearized = gtsam.KeyList(), 0, self._end
            return
        for key in _keys(self._n_held, window):
            self._held.push_back(key)
        self._n_held = max(self._n_held, window)

    def _window(self, end: int) -> int:
        """First keyframe whose measurements are to be linearised again: further back while attitude moves there."""
        size = self._options.window
        while size < end:
            k = end - size
            now = self._tree.calculateEstimatePose3(X(k)).rotation().matrix()
            if np.linalg.norm(so3.log(self._state.R_ns[k].T @ now)) < MOVED:
                return k
            size *= 2
        return 0

    def _estimate(self, window: int) -> gtsam.Values:
        """Newest estimate from keyframe `window` on, also taken over into the state."""
        estimate = self._tree.calculateEstimate(_keys(window, self._end))
        self._read(window, estimate)
        return estimate

    def _predict(self, begin: int) -> gtsam.NonlinearFactorGraph:
        """Predict keyframes from `begin` on into the state. Returns the inertial factors that lead there."""
        state, end = self._state, self._end
        first = max(begin - 1, 0)
        span = slice(first, end - 1)
        state.accel_bias_s[begin:end] = state.accel_bias_s[first]
        state.gyro_bias_s[begin:end] = state.gyro_bias_s[first]
        bins = self._binned.between(first, end)
        measured = preintegrate(bins, self._noise.inertial, state.accel_bias_s[span], state.gyro_bias_s[span])
        phi = np.exp(-state.interval / self._noise.offset_tau)
        for k, preintegrated in enumerate(measured, first):
            at = gtsam.NavState(gtsam.Rot3(state.R_ns[k]), state.position_n[k], state.velocity_n[k])
            bias = gtsam.imuBias.ConstantBias(state.accel_bias_s[k], state.gyro_bias_s[k])
            predicted = preintegrated.predict(at, bias)
            state.R_ns[k + 1] = predicted.attitude().matrix()
            state.position_n[k + 1], state.velocity_n[k + 1] = predicted.position(), predicted.velocity()
            state.offset_n[k + 1] = phi * state.offset_n[k]
        return inertial_factors(measured, first)

    def _measure(
        self, window: int, new: int, estimate: gtsam.Values, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
    ) -> None:
        """Add `graph` and `values`, and linearise the measurements of intervals from `window` on (again).

        Those from `new` on are new: they get their full weight unless they are doubted, and their linear factors.
        """
        measured, intervals = gtsam.NonlinearFactorGraph(), []
        for rows in self._rows(window):
            if rows.name in LINEAR:
                graph.push_back(_factors(rows, rows.interval >= new, estimate)[0])
            elif rows.name in LINEAR_FIRST:
                if values.exists(X(0)):
                    graph.push_back(_factors(rows, rows.interval >= 0, estimate)[0])
            else:
                full = replace(rows, weight=np.where(rows.interval >= new, rows.weight > 0.0, rows.weight))
                factors, at = _factors(full, rows.interval >= window, estimate)
                measured.push_back(factors)
                intervals += at
        n_other = graph.size()
        graph.push_back(measured)
        old = [index for of_interval in self._indices[window:] for index in of_interval]
        indices = self._tree.update(graph, values, old, None, self._held).getNewFactorsIndices()
        self._indices[window:] = [[] for _ in range(self._end - 1 - window)]
        for interval, index in zip(intervals, indices[n_other:], strict=True):
            self._indices[interval].append(index)

    def _rows(self, window: int) -> Iterator[Rows]:
        """Rows of the intervals from `window` on, and linear ones before; intervals counted from the first of all."""
        begin = max(0, window - self._options.context)
        state, d = _part(self._state, begin, self._end), self._data
        bins = self._binned.between(begin, self._end)
        last = self._end - 1  # intervals before it are complete
        use_position = (self._position_at >= window) & (self._position_at < last)
        use_velocity = (self._velocity_at >= window) & (self._velocity_at < last)
        use = np.flatnonzero(use_position | use_velocity)
        still = d.still[(d.still >= window) & (d.still < last)] - begin
        part = replace(
            d,
            t=d.t[use],
            position_n=np.where(use_position[use, None], d.position_n[use], np.nan),
            velocity_n=np.where(use_velocity[use, None], d.velocity_n[use], np.nan),
            position_scale=d.position_scale[use],
            velocity_scale=d.velocity_scale[use],
            doubted=None if d.doubted is None else d.doubted[use],
            still=still,
            heading=None,
        )
        path = dense_path(bins, state.R_ns, state.position_n, state.velocity_n, state.accel_bias_s, state.gyro_bias_s)
        felt = expected_of(part, path, state, self._noise)
        for rows in session_rows(part, self._priors, path, felt, state, self._noise):
            yield replace(rows, interval=rows.interval + begin)
        if d.heading is not None:
            rows = heading_rows(self._state, d.heading)
            yield _select(rows, (rows.interval >= window) & (rows.interval < last))

    def _values(self, begin: int) -> gtsam.Values:
        state, values = self._state, gtsam.Values()
        for k in range(begin, self._end):
            values.insert(X(k), gtsam.Pose3(gtsam.Rot3(state.R_ns[k]), state.position_n[k]))
            values.insert(V(k), state.velocity_n[k])
            values.insert(B(k), gtsam.imuBias.ConstantBias(state.accel_bias_s[k], state.gyro_bias_s[k]))
            values.insert(O(k), state.offset_n[k])
        return values

    def _read(self, begin: int, values: gtsam.Values) -> None:
        """Take the keyframes from `begin` on over from `values`."""
        state = self._state
        for k in range(begin, self._end):
            pose = values.atPose3(X(k))
            state.R_ns[k], state.position_n[k] = pose.rotation().matrix(), pose.translation()
            bias = values.atConstantBias(B(k)).vector()
            state.accel_bias_s[k], state.gyro_bias_s[k] = bias[:3], bias[3:]
            state.velocity_n[k], state.offset_n[k] = values.atVector(V(k)), values.atVector(O(k))


def _factors(rows: Rows, use: BoolArray, values: gtsam.Values) -> tuple[gtsam.NonlinearFactorGraph, list[int]]:
    """Linear factor and interval of each row of `use` that was measured; `values` is where it was linearised."""
    root = np.sqrt(rows.information)
    parts = [
        (shift, variable, J[:, :, columns] * root[:, :, None])
        for shift, J in ((0, rows.left), (1, rows.right))
        for variable, columns in _VARIABLES
        if np.any(J[:, :, columns])
    ]
    model = gtsam.noiseModel.Unit.Create(rows.residual.shape[1])
    graph, intervals = gtsam.NonlinearFactorGraph(), []
    for i in np.flatnonzero(use & np.any(root > 0.0, axis=1)):
        k = int(rows.interval[i])
        keys = [variable(k + shift) for shift, variable, _ in parts]
        jacobians = [part[i] for _, _, part in parts]
        graph.add(_linear_factor(model, keys, jacobians, root[i] * rows.residual[i], values))
        intervals.append(k)
    return graph, intervals


def _linear_factor(
    model: gtsam.noiseModel.Base, keys: list[int], jacobians: list[Array], residual: Array, values: gtsam.Values
) -> gtsam.LinearContainerFactor:
    """One linear factor of any number of variables: JacobianFactor itself is wrapped for three at the most."""

    def error(_: gtsam.CustomFactor, __: gtsam.Values, out: list[Array] | None) -> Array:
        if out is not None:
            for i, jacobian in enumerate(jacobians):
                out[i] = jacobian
        return residual

    return gtsam.LinearContainerFactor(gtsam.CustomFactor(model, keys, error).linearize(values), values)


def _parameters(factorization: str) -> gtsam.ISAM2Params:
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization(factorization)
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(_WILDFIRE))
    thresholds = gtsam.ISAM2ThresholdMap()
    for symbol, limit in _RELINEARIZE.items():
        thresholds.insert((symbol, np.array(limit)))
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = 1
    return parameters


def _keys(begin: int, end: int) -> list[int]:
    return [variable(k) for k in range(begin, end) for variable, _ in _VARIABLES]


def _interval_of(state: ChainState, t: Array) -> np.ndarray:
    return np.asarray(np.clip(np.floor((t - state.t[0]) / state.interval).astype(np.int64), 0, len(state.t) - 2))


def _own_copy(state: ChainState, constants: Constants) -> ChainState:
    fields = ("R_ns", "position_n", "velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")
    return replace(state, **{name: np.array(getattr(state, name)) for name in fields}, constants=constants)


def _part(state: ChainState, begin: int, end: int) -> ChainState:
    fields = ("t", "R_ns", "position_n", "velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")
    return replace(state, **{name: getattr(state, name)[begin:end] for name in fields})


def _select(rows: Rows, use: BoolArray) -> Rows:
    names = ("interval", "residual", "sigma", "left", "right", "constants", "weight")
    return replace(rows, **{name: getattr(rows, name)[use] for name in names})
