"""A smooth path through the fixes alone: positions and Doppler velocity, no inertial sensor.

State in n at every node: position, velocity, acceleration, driven by white jerk (damped, see white_jerk.py); the fixes
have a slow offset and a latency that changes slowly. Noise of positions and of Doppler, density of jerk and of the slow
errors are identified by variance component estimation, outliers lose their weight, and the lag of Doppler behind
position and its bias are constants of the session. It is the smoothing of sessions without a usable IMU, and the
starting point and outlier screen of the graph.

Sources: Förstner 1979 (variance components); Yang et al. 2002 (IGG III weights).
"""

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, IntArray, median
from smoother.estimate.factors.rows import Rows
from smoother.estimate.fixes import path_noise as noise
from smoother.estimate.fixes.path_graph import (
    ACCELERATION,
    KINDS,
    LATENCY,
    NODE_SIZE,
    OFFSET,
    POSITION,
    VELOCITY,
    Measured,
    Nodes,
    PathPrior,
    Solution,
    WhiteJerk,
    fix_rows,
    prior_rows,
    quintic_basis,
    solve,
)
from smoother.estimate.fixes.screen import plausible_positions, plausible_velocities, with_courses
from smoother.estimate.solvers.covariance import IndeterminateError
from smoother.samples import GnssFixes, Session

GRADUATION = (2.0, 2.0, 1.5, 1.2)  # factors on the limits for outliers in the first rounds, while the path is rough
FIRST_ROUNDS = 2  # with noise as it starts where there are outliers, so that they cannot inflate it
# changes that end the rounds, the first two relative, the last in parts of the usual change of the latency
SETTLED_SIGMA, SETTLED_JERK, SETTLED_WEIGHT, SETTLED_LATENCY = 0.03, 0.1, 0.1, 1.5
PUNCTUAL = 1e-6  # s, change of the latency where there is none
UNKNOWN_HEIGHT = 100.0  # m, sigma about the origin's height where no fix has one
RELAXATION = 0.8  # of the constants' steps: lag and acceleration form a product, and full steps swing
HOLE = 10.0  # s; nodes are closer, but where pieces of a long session meet in a pause
ROAMING = 10.0, 20.0  # m/s of an unobserved vehicle, and s for which it keeps its direction
LAG_RANGE, END_MARGIN = (-1.5, 0.5), 0.1  # s: a lag beyond belief, and what nodes reach farther


@dataclass(frozen=True)
class GnssPathOptions:
    """What may be fixed; None is identified, or defaults where it cannot be.

    position_latency, velocity_latency s, whole delay of each; a position latency is never observable here (default 0).
    offset_sigma m (north, west, up) and offset_tau s: the slow error of receivers as a population. Four of them carried
    beside RTK for 840 s had 1.0-4.0 m rms per horizontal axis (median 1.9), 1.8-10 m up, correlation 0.4 after 60 s.
    latency_change s/m: usual change of the latency per metre of reported accuracy, forgotten after latency_change_tau
    s. Receivers are punctual unless their fixes show otherwise, but positions of phones, which report 5 m and more,
    come late by up to two seconds, by a time that varies over some seconds.
    position_sigma, velocity_sigma: white noise (horizontal, up), m and m/s; jerk_density (horizontal, up) in
    m/s^3/sqrt(Hz).
    lag_prior: expectation and sigma, s, of Doppler's lag; kart logs show 0.04-0.14 s. velocity_bias_sigma m/s: of the
    mean of Doppler over a session, which on kart logs disagrees with the positions by 0.01-0.05 m/s.
    max_node_gap s: interpolation between nodes then costs nothing. min_node_gap s: closer fixes share their nodes.
    Simulated karts (6 seeds at 5, 10 and 25 Hz) come out 2-4 % better so than with a node at every fix, because less of
    the fixes' noise passes for wander, and in half the time.
    """

    position_latency: float | None = None
    velocity_latency: float | None = None
    offset_sigma: tuple[float, float, float] = (2.0, 2.0, 3.4)
    offset_tau: float = 60.0
    latency_change: float = 2e-4
    latency_change_tau: float = 10.0
    position_sigma: tuple[float, float] | None = None
    velocity_sigma: tuple[float, float] | None = None
    jerk_density: tuple[float, float] | None = None
    lag_prior: tuple[float, float] = (0.05, 0.1)
    velocity_bias_sigma: float = 0.05
    max_node_gap: float = 0.5
    min_node_gap: float = 0.35
    max_iterations: int = 12


@dataclass(frozen=True)
class VelocityLag:
    """Delay of Doppler velocity behind position, s; `observable`: the data pinned it; source as in Identified."""

    value: float
    sigma: float
    observable: bool
    source: str


@dataclass(frozen=True, eq=False)
class GnssMotion:
    """The path at some times: position_n m, velocity_n m/s, acceleration_n m/s^2 and offset_n m, each (N, 3).

    position_n is without the slow error of the fixes as far as Doppler shows it; `track_n` contains it.
    """

    position_n: Array
    velocity_n: Array
    acceleration_n: Array
    offset_n: Array

    @property
    def track_n(self) -> Array:
        """Positions in the frame of the fixes, (N, 3) m."""
        return self.position_n + self.offset_n


@dataclass(frozen=True, eq=False)
class GnssPathSigmas:
    """Standard deviations at some times: position_n (N, 3) m absolute; track_n (N, 3) m of position plus offset, which
    is the line in the frame of the fixes; velocity_n (N, 3) m/s, north and west with the covariance velocity_cross (N,)
    m^2/s^2, which is large where the speed is known and the direction is not.
    """

    position_n: Array
    track_n: Array
    velocity_n: Array
    velocity_cross: Array


@dataclass(frozen=True, eq=False)
class GnssPath:
    """The smoothed path and its identified constants. K nodes, M fixes; times are corrected for latency.

    t (K,) s; position_n, velocity_n, acceleration_n, offset_n (K, 3); covariance (3, K, 4, 4) per axis of (position,
    velocity, acceleration, offset); velocity_cross (K,): of the velocities north and west. Per fix, NaN or weight 0
    where not measured:
    position_residual_n, velocity_residual_n (M, 3) path - fix with the offset on the path's side;
    position_weight, velocity_weight (M,) horizontal and up_weight (M,), robust, 0..1.
    position_sigma (3,) m and velocity_sigma (3,) m/s white noise per axis; jerk_density (3,) m/s^3/sqrt(Hz).
    position_spread, velocity_spread (3,): sigmas of the logarithms of these.
    position_scale, up_scale, velocity_scale (M,) factor of a fix's own sigma over the usual. position_latency s.
    velocity_bias and its sigma (3,) m/s: mean of Doppler minus path. wander: sigma of the level
    offset of the fixes over the usual one.
    """

    t: Array
    position_n: Array
    velocity_n: Array
    acceleration_n: Array
    offset_n: Array
    covariance: Array
    velocity_cross: Array
    position_residual_n: Array
    velocity_residual_n: Array
    position_weight: Array
    velocity_weight: Array
    up_weight: Array
    position_scale: Array
    up_scale: Array
    velocity_scale: Array
    position_sigma: Array
    velocity_sigma: Array
    position_spread: Array
    velocity_spread: Array
    jerk_density: Array
    position_latency: float
    velocity_lag: VelocityLag
    velocity_bias: Array
    velocity_bias_sigma: Array
    iterations: int
    wander: float = 1.0

    def at(self, t: Array) -> GnssMotion:
        """The path at times of truth t (N,) s; outside the nodes velocity is constant.

        Over hours without a fix, where pieces of a long session meet, it is a straight line.
        """
        t = np.asarray(t, dtype=np.float64)
        inside = np.clip(t, self.t[0], self.t[-1])
        k, fraction, step = self._place(inside)
        left, right = quintic_basis(fraction, step)
        states = np.stack([self.position_n, self.velocity_n, self.acceleration_n], axis=1)
        between = left @ states[k] + right @ states[k + 1]
        if np.any(is_hole := step > HOLE):
            k_h, u = k[is_hole], fraction[is_hole, None]
            way = self.position_n[k_h + 1] - self.position_n[k_h]
            velocity = way / step[is_hole, None]
            between[is_hole] = np.stack([self.position_n[k_h] + u * way, velocity, np.zeros_like(way)], axis=1)
        between[:, 0] += (t - inside)[:, None] * between[:, 1]
        u = fraction[:, None]
        return GnssMotion(
            between[:, 0], between[:, 1], between[:, 2], (1.0 - u) * self.offset_n[k] + u * self.offset_n[k + 1]
        )

    def sigma_at(self, t: Array) -> GnssPathSigmas:
        """Standard deviations at times t (N,) s, interpolated between nodes, those of the end nodes outside."""
        k, fraction, step = self._place(np.clip(t, self.t[0], self.t[-1]))
        P = self.covariance.transpose(1, 0, 2, 3)
        track = P[..., 0, 0] + 2.0 * P[..., 0, 3] + P[..., 3, 3]
        variance = np.stack([P[..., 0, 0], np.maximum(track, 0.0), P[..., 1, 1]])
        u = fraction[:, None]
        variance = (1.0 - u) * variance[:, k] + u * variance[:, k + 1]
        if np.any(is_hole := step > HOLE):
            u, step = u[is_hole], step[is_hole, None]
            strayed = ROAMING[0] ** 2 * ROAMING[1] * step * u * (1.0 - u)
            variance[:, is_hole] += np.stack([strayed, strayed, np.full_like(strayed, ROAMING[0] ** 2)])
        position, track, velocity = np.sqrt(variance)
        cross = (1.0 - fraction) * self.velocity_cross[k] + fraction * self.velocity_cross[k + 1]
        return GnssPathSigmas(position, track, velocity, cross)

    def _place(self, t: Array) -> tuple[IntArray, Array, Array]:
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, self.t.size - 2)
        step = self.t[k + 1] - self.t[k]
        return k, (t - self.t[k]) / step, step


@dataclass(frozen=True, eq=False)
class _Known:
    """What stays the same through the rounds. scale (M, 4): sigma of each fix over the usual; start as in
    PathPrior; reported m: usual accuracy by the receiver, 0 if unknown.
    """

    measured: Measured
    scale: Array
    start: tuple[Array, Array]
    lag: tuple[float, float]
    options: GnssPathOptions
    reported: float


@dataclass(frozen=True, eq=False)
class _State:
    """Where the rounds stand: nodes and the rows of the fixes there, weight (M, 4) by kind, noise.

    solution: what led there. is_clean: no measurement has lost any weight, so there is nothing to approach with care.
    """

    nodes: Nodes
    rows: list[Rows]
    weight: Array
    noise: noise.PathNoise
    solution: Solution | None = None
    is_clean: bool = False


def fit_gnss_path(session: Session, options: GnssPathOptions | None = None) -> GnssPath:
    """Smooth the fixes of `session` (at least one) and identify their noise; see GnssPath.

    Robust against jumps of seconds and against absurd rows; linear in the number of fixes.
    """
    options = GnssPathOptions() if options is None else options
    try:
        return _fit(session, options)
    except IndeterminateError:  # rounding spoils long stretches that hardly measure; wider steps suffer less
        return _fit(session, replace(options, min_node_gap=options.max_node_gap))


def _fit(session: Session, options: GnssPathOptions) -> GnssPath:
    latency, lag = _delays(session, options)
    fixes, position_n = session.gnss, session.fix_position_n
    true_t = fixes.t - latency
    measured = Measured(true_t, position_n, fixes.velocity_n, fixes.speed)
    weight = _first_weights(measured)
    known = _Known(
        measured,
        noise.relative_sigmas(fixes),
        _anchor(position_n, weight),
        lag,
        options,
        _reported_accuracy(fixes),
    )
    state = _first_state(known, _node_times(true_t, fixes.t[-1], lag[0], options), weight)
    rounds = 0
    for rounds in range(1, options.max_iterations + 1):
        before = state
        state = _improve(known, before, rounds)
        if (rounds > len(GRADUATION) or state.is_clean) and _is_settled(before, state):
            break
    return _result(known, state, latency, rounds)


def _delays(session: Session, options: GnssPathOptions) -> tuple[float, tuple[float, float]]:
    """Position latency, s; and Doppler's lag behind it with its sigma, zero where it is configured."""
    timing = session.config.gps
    position = options.position_latency if options.position_latency is not None else timing.position_latency
    velocity = options.velocity_latency if options.velocity_latency is not None else timing.velocity_latency
    position = 0.0 if position is None else position
    return position, options.lag_prior if velocity is None else (velocity - position, 0.0)


def _node_times(true_t: Array, end: float, lag: float, options: GnssPathOptions) -> Array:
    """Times of the nodes: at the fixes where they are far enough apart, a margin at the ends, gaps filled evenly."""
    before, after = max(LAG_RANGE[1], lag) + END_MARGIN, max(-LAG_RANGE[0], -lag) + END_MARGIN
    chosen = true_t if np.all(np.diff(true_t) >= options.min_node_gap) else _thinned(true_t, options.min_node_gap)
    corners = np.concatenate([[true_t[0] - before], chosen, [max(end, true_t[-1] + after)]])
    parts = np.maximum(np.ceil(np.diff(corners) / options.max_node_gap - 1e-6), 1.0).astype(np.int64)
    inner = np.arange(int(parts.sum())) - np.repeat(np.cumsum(parts) - parts, parts)
    t = np.repeat(corners[:-1], parts) + np.repeat(np.diff(corners) / parts, parts) * inner
    return np.append(t, corners[-1])


def _thinned(t: Array, gap: float) -> Array:
    times, chosen, i = t.tolist(), [0], 0
    while (i := bisect_left(times, times[i] + gap, i)) < len(times):
        chosen.append(i)
    return np.asarray(t[chosen])


def _reported_accuracy(fixes: GnssFixes) -> float:
    """Usual horizontal accuracy that the receiver reports, m; 0 where it reports none."""
    assert fixes.sigma_horizontal is not None
    reported = fixes.sigma_horizontal[np.isfinite(fixes.sigma_horizontal)]
    return float(median(reported)) if reported.size else 0.0


def _first_weights(measured: Measured) -> Array:
    """Weights (M, 4) to start with: out is what does not fit its neighbours."""
    velocity = plausible_velocities(measured.true_t, measured.velocity_n)
    velocity_n = with_courses(measured.true_t, measured.position_n, measured.velocity_n, measured.speed)
    position = plausible_positions(measured.true_t, measured.position_n, velocity_n, velocity)
    return np.stack([position, position, velocity, velocity], axis=1).astype(np.float64)


def _anchor(position_n: Array, weight: Array) -> tuple[Array, Array]:
    """Where the path may start (3,) m and how far from it (3,) m: anywhere among the fixes."""
    centre, spread = np.zeros(3), np.full(3, UNKNOWN_HEIGHT)
    for axis in range(3):
        values = position_n[np.isfinite(position_n[:, axis]) & (weight[:, 0] > 0.0), axis]
        if values.size:
            centre[axis], spread[axis] = np.median(values), 1000.0 + np.ptp(values)
    spread[:2] = spread[:2].max()  # north and west are known alike
    return centre, spread


def _first_state(known: _Known, t: Array, weight: Array) -> _State:
    """Straight lines between the fixes to start from; the problem is all but linear, so nothing better is needed."""
    x, measured = np.zeros((len(t), NODE_SIZE)), known.measured
    for axis in range(3):
        good = np.isfinite(measured.position_n[:, axis]) & (weight[:, 0] > 0.0)
        if good.any():
            x[:, axis] = np.interp(t, measured.true_t[good], measured.position_n[good, axis])
            x[:, VELOCITY.start + axis] = np.gradient(x[:, axis], t)
    nodes = Nodes(t, x, known.lag[0], np.zeros(3))
    return _State(nodes, fix_rows(nodes, measured), weight, noise.first_noise(known.reported))


def _improve(known: _Known, now: _State, number: int) -> _State:
    """One round: solve, then weigh, then identify the noise."""
    prior = _prior(known, now.noise)
    before = [
        replace(rows, sigma=rows.sigma * now.noise.sigma[kind] * known.scale[:, kind, None], weight=now.weight[:, kind])
        for kind, rows in enumerate(now.rows)
    ]
    assumed = prior_rows(now.nodes, prior)
    solution = solve(now.nodes, before, assumed, prior.unknown)
    nodes = _relaxed(now.nodes, solution.nodes)
    rows = fix_rows(nodes, known.measured)
    judged = [noise.Judged.of(*both, solution) for both in zip(before, rows, strict=True)]
    size = noise.normalised_sizes(judged)
    weight = noise.robust_weights(size, now.weight, GRADUATION[number - 1] if number <= len(GRADUATION) else 1.0)
    is_clean = bool(np.all(now.weight == 1.0) and np.all(weight == 1.0))
    found = now.noise
    if is_clean or number > FIRST_ROUNDS:
        driven = [
            noise.Judged.of(*both, solution) for both in zip(assumed[:3], prior_rows(nodes, prior)[:3], strict=True)
        ]
        found = _as_configured(noise.identify(judged, known.scale, solution, driven, found), known.options)
    return _State(nodes, rows, weight, found, solution, is_clean)


def _relaxed(before: Nodes, after: Nodes) -> Nodes:
    """The nodes after a step, of which the constants take a part, with latencies that change about 0."""
    bias = before.bias + RELAXATION * (after.bias - before.bias)
    if after.lag == before.lag:
        return replace(after, bias=bias)
    # All times could move by a constant, with it the lag: no measurement determines it, and it would swing.
    constant = float(np.mean(after.x[:, LATENCY]))
    x, slope = after.x.copy(), np.zeros_like(after.x)
    slope[:, POSITION], slope[:, VELOCITY], slope[:, LATENCY] = x[:, VELOCITY], x[:, ACCELERATION], 1.0
    lag = before.lag + RELAXATION * (after.lag - before.lag) - constant
    return replace(after, x=x - constant * slope, lag=float(np.clip(lag, *LAG_RANGE)), bias=bias)


def _prior(known: _Known, now: noise.PathNoise) -> PathPrior:
    level, up = (WhiteJerk(float(now.jerk[i]), *map(float, now.vehicle[i])) for i in range(2))
    options, (start, start_sigma) = known.options, known.start
    slow = (
        np.array([*options.offset_sigma, max(options.latency_change * known.reported, PUNCTUAL)])
        * now.wander[[0, 0, 1, 2]]
    )
    tau = np.array([options.offset_tau] * 3 + [options.latency_change_tau])
    return PathPrior((level, up), slow, tau, start, start_sigma, known.lag, options.velocity_bias_sigma)


def _as_configured(found: noise.PathNoise, options: GnssPathOptions) -> noise.PathNoise:
    sigma = found.sigma.copy()
    for given, groups in ((options.position_sigma, [0, 1]), (options.velocity_sigma, [2, 3])):
        if given is not None:
            sigma[groups] = given
    return replace(
        found, sigma=sigma, jerk=found.jerk if options.jerk_density is None else np.array(options.jerk_density)
    )


def _is_settled(before: _State, after: _State) -> bool:
    sigma = np.abs(np.log(after.noise.sigma / before.noise.sigma)).max()
    jerk = np.abs(np.log(after.noise.jerk / before.noise.jerk)).max()
    weight = np.abs(after.weight - before.weight).max()
    latency = abs(after.noise.wander[2] - before.noise.wander[2])
    changes = np.array([sigma, jerk, weight, latency])
    return bool(np.all(changes < [SETTLED_SIGMA, SETTLED_JERK, SETTLED_WEIGHT, SETTLED_LATENCY]))


def _result(known: _Known, state: _State, latency: float, rounds: int) -> GnssPath:
    solution, nodes, sigma = state.solution, state.nodes, state.noise.sigma
    assert solution is not None
    measured = [np.all(np.isfinite(rows.sigma), axis=1) for rows in state.rows]  # a speed alone is no velocity
    residual = [
        np.where(known[:, None], rows.residual, np.nan) for known, rows in zip(measured, state.rows, strict=True)
    ]
    weight = np.where(np.stack(measured, axis=1), state.weight, 0.0)
    own = np.arange(3)[:, None] + 3 * np.arange(4)
    covariance = solution.covariances.keyframes[:, own[:, :, None], own[:, None, :]].transpose(1, 0, 2, 3)
    return GnssPath(
        t=nodes.t,
        position_n=nodes.x[:, POSITION],
        velocity_n=nodes.x[:, VELOCITY],
        acceleration_n=nodes.x[:, ACCELERATION],
        offset_n=nodes.x[:, OFFSET],
        covariance=covariance,
        velocity_cross=solution.covariances.keyframes[:, VELOCITY.start, VELOCITY.start + 1],
        position_residual_n=np.hstack(residual[:2]),
        velocity_residual_n=np.hstack(residual[2:]),
        position_weight=weight[:, KINDS.index("position")],
        velocity_weight=weight[:, KINDS.index("velocity")],
        up_weight=weight[:, KINDS.index("height")],
        position_scale=known.scale[:, KINDS.index("position")],
        up_scale=known.scale[:, KINDS.index("height")],
        velocity_scale=known.scale[:, KINDS.index("velocity")],
        position_sigma=sigma[[0, 0, 1]],
        velocity_sigma=sigma[[2, 2, 3]],
        position_spread=state.noise.spread[[0, 0, 1]],
        velocity_spread=state.noise.spread[[2, 2, 3]],
        jerk_density=state.noise.jerk[[0, 0, 1]],
        position_latency=latency,
        velocity_lag=_lag(known, nodes.lag, solution.lag_sigma),
        velocity_bias=nodes.bias,
        velocity_bias_sigma=solution.bias_sigma,
        iterations=rounds,
        wander=float(state.noise.wander[0]),
    )


def _lag(known: _Known, value: float, sigma: float) -> VelocityLag:
    prior_sigma = known.lag[1]
    if prior_sigma <= 0.0:
        return VelocityLag(value, 0.0, False, "configured")
    found = sigma < 0.9 * prior_sigma
    return VelocityLag(value, sigma, bool(sigma < prior_sigma / 3.0), "identified" if found else "default")
