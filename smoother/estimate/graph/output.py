"""From a solved graph to the trajectory people use: dense rows, antenna, body axes, sigmas, and the report."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.disc import even_pieces, pieces, release, roomy
from smoother.estimate.gnss_path import UNKNOWN_HEIGHT
from smoother.estimate.graph.arm import arm_axes, arm_axes_at
from smoother.estimate.graph.batch import Solved
from smoother.estimate.graph.components import unseen_offset
from smoother.estimate.graph.expected import DopplerNoise
from smoother.estimate.graph.felt import Felt, felt_on, swing_covariance
from smoother.estimate.graph.identified import doubt_by_rates, identified_values, unsure_moment
from smoother.estimate.graph.imu import BinnedImu, DensePath, are_told, corrected, dense_path, motion_at
from smoother.estimate.graph.inertial_noise import InertialNoise, interval_noise
from smoother.estimate.graph.inputs import Noise, Priors
from smoother.estimate.graph.joint import ChainJoint, Wandering
from smoother.estimate.graph.leftovers import left_of_inertial, left_of_rows
from smoother.estimate.graph.mounting import (
    MIN_KEYFRAMES,
    FittedMounting,
    are_driven,
    swing_on_the_wheel,
)
from smoother.estimate.graph.rows import UP_N, Rows
from smoother.estimate.graph.state import (
    CONSTANTS_SIZE,
    KEYFRAME_SIZE,
    LEVER_ARM,
    ROTATION,
    ChainState,
)
from smoother.estimate.graph.uncertainty import Uncertainty, uncertainty_of
from smoother.estimate.pauses import NO_PAUSES, Pauses
from smoother.frames import euler_jacobian
from smoother.samples import Problem, Session
from smoother.trajectory import (
    BOX_ON_WHEEL,
    EstimateReport,
    FixResiduals,
    Identified,
    JointPosition,
    Keyframes,
    ResidualStatistics,
    Sigmas,
    Trajectory,
)
from smoother.units import ANY_ANGLE

MARGIN = 20.0  # s of the path around the rows that are made together: more than what is expected of them reaches
SAMPLES = 100  # keyframes whose errors are averaged; they last for seconds or for the session, so that these will do
UNUSUAL = 4.0  # times the usual variance of an attitude; standing and driving differ by less
TOGETHER = 1 << 15  # rows or keyframes that are worked on together
SLOPE = 0.03  # rms of ground, as of a hilly road on record; karting tracks have less
# m/s, forgotten in half a minute or later: two modules in one car have 0.020 each beside what their sigmas hold, one
# beside the heights of RTK 0.018; of the level velocities of both it is 0.003 to 0.013
SLOW_UPWARDS = 0.02
ON_WHEEL = (
    "the box turns with the steering wheel: roll, yaw and the accelerations in the box's axes are the wheel's; "
    "position, speed, lap times and accelerations along the path are not affected"
)
LEAST_BETWEEN = 0.25  # of the smaller variance of two keyframes: no less is left anywhere between them


@dataclass(frozen=True, eq=False)
class Estimated:
    """What a solved graph says, of one piece or of windows: all that the output is made of.

    joint: how errors hang together, given the variance (3,) m^2 that the session cannot show; None where unknown.
    common_attitude (3, 3) rad^2: covariance in s of the mean error of all attitudes; zero where unknown.
    inertial: what is left of the inertial factors, by name.
    """

    state: ChainState
    constants_covariance: Array
    uncertainty: Uncertainty
    rows: dict[str, Rows]
    joint: Callable[[Array], JointPosition] | None
    common_attitude: Array = field(default_factory=lambda: np.zeros((3, 3)))
    inertial: Mapping[str, ResidualStatistics] = field(default_factory=dict)


def estimated(solved: Solved, nose: float | None) -> Estimated:
    """Return what a graph that was solved in one piece says; nose, rad^2, as for :func:`uncertainty_of`."""
    state, factor = solved.state, solved.solution.factor
    return Estimated(
        state,
        solved.solution.constants_covariance,
        uncertainty_of(solved, nose),
        solved.rows,
        None if factor is None else lambda unseen: ChainJoint(state, factor, unseen),
        common_attitude(solved),
        left_of_inertial(solved, slice(None)),
    )


def _told(state: ChainState, made_up: BoolArray | None) -> IntArray:
    """Keyframes that the mounting is fitted to, all where they are few: what it takes out of others' errors is less.

    made_up (K,): keyframes without samples, which tell nothing.
    """
    sampled = np.ones(len(state.t), dtype=np.bool_) if made_up is None else ~made_up
    driven = are_driven(state) & sampled
    return np.flatnonzero(driven if np.count_nonzero(driven) >= MIN_KEYFRAMES else sampled)


def common_attitude(solved: Solved, made_up: BoolArray | None = None) -> Array:
    """Covariance (3, 3) rad^2 in s of the mean error of attitude, from SAMPLES keyframes; zero where it is not known.

    made_up (K,): keyframes without samples, whose errors have nothing in common with those of others.
    """
    factor, attitude = solved.solution.factor, solved.solution.covariance[:, ROTATION, ROTATION]
    if factor is None:
        return np.zeros((3, 3))
    told = _told(solved.state, made_up)
    told = told[told < len(attitude) - 1]
    known = told[_usually_known(attitude[told])]
    at = np.repeat(known[np.linspace(0, len(known) - 1, SAMPLES).astype(np.int64)], 3)
    left = np.zeros((len(at), KEYFRAME_SIZE))
    left[:, ROTATION] = np.tile(np.eye(3), (SAMPLES, 1))
    joint = factor.covariance(at, left, np.zeros_like(left), np.zeros((len(at), CONSTANTS_SIZE)))
    return np.asarray(joint.reshape(SAMPLES, 3, SAMPLES, 3).mean(axis=(0, 2)))


def _usually_known(attitude: Array) -> IntArray:
    """Keyframes whose attitude, of covariance (K, 3, 3), is known about as well as most are.

    Before the first sample or in a gap nothing tells it: one such keyframe would outweigh all others in a mean.
    """
    variance = np.einsum("kii->k", attitude)
    return np.flatnonzero(variance <= UNUSUAL * np.median(variance))


def build_trajectory(
    session: Session,
    found: Estimated,
    noise: Noise,
    mounting: FittedMounting,
    binned: BinnedImu,
    priors: Priors,
    rate: float,
    population: Array,
    pauses: Pauses = NO_PAUSES,
    doubt: float = 0.0,
) -> Trajectory:
    """Return rows at `rate` Hz from the first to the last fix: antenna in n, attitude and accelerations of the kart.

    population (3,) m: sigma of the GPS offset of receivers like this one, the least that absolute positions are unsure.
    pauses: where time is cut out of the session; the rows that fall into them are left out. doubt: see
    :func:`identified_values`.
    """
    unseen = unseen_offset(noise, population, len(session.gnss))
    unsure = unseen if priors.has_height else np.add(unseen, [0.0, 0.0, UNKNOWN_HEIGHT**2])
    source = _source(session, found, noise, binned, pauses)
    keyframes = _keyframes_of_kart(session, found, source, mounting, priors, unsure)
    swing = swing_on_the_wheel(keyframes)
    if swing is not None:
        _widen(keyframes, swing)
    sampled_every = float(median(np.diff(session.imu.t))) if session.imu is not None else 0.0
    identified = identified_values(
        found.state.constants,
        found.constants_covariance,
        found.common_attitude,
        noise,
        priors,
        mounting,
        session.config,
        unseen,
        sampled_every,
        doubt,
    )
    report = _report(found, identified, keyframes, is_on_wheel=swing is not None)
    joint = _joint(found, keyframes, unsure, source.doppler)
    t = _times(session, pauses, rate)
    rows = _Rows.empty(len(t))
    unsteady = max(doubt_by_rates(noise.inertial.gyro), doubt) if session.config.gps.position_latency is None else 0.0
    for part in _parts(t, pauses):
        rows.fill(part, t[part], found, noise, mounting, source, keyframes)
        rows.unsure_of_time(part, unsure_moment(sampled_every, session.config.imu_delay, unsteady))
        release(rows, keyframes, binned)
    return rows.trajectory(t, report, joint)


def _source(session: Session, found: Estimated, noise: Noise, binned: BinnedImu, pauses: Pauses) -> "_Source":
    fixes = session.gnss
    level, up = (DopplerNoise.of(fixes.t, fixes.velocity_n[:, i], float(noise.of_velocities[i])) for i in (0, 2))
    return _Source(found.state, binned, noise.inertial, level, up, pauses)


def _keyframes_of_kart(
    session: Session, found: Estimated, source: "_Source", mounting: FittedMounting, priors: Priors, unsure: Array
) -> Keyframes:
    """Keyframes of antenna and kart, as unsure of climbing as the fixes leave it; unsure (3,) m^2 of the offset."""
    height_sigma = float(priors.constants_sigma[LEVER_ARM][2]) if priors.holds_height and priors.drives else 0.0
    keyframes = _keyframes(found, source, mounting, unsure, height_sigma)
    if not (priors.has_height or np.any(np.isfinite(session.gnss.velocity_n[:, 2]))):
        _may_climb(keyframes)
    elif source.upwards is not None:
        _drift_upwards(keyframes)
    return keyframes


def _report(
    found: Estimated, identified: dict[str, Identified], keyframes: Keyframes, *, is_on_wheel: bool
) -> EstimateReport:
    return EstimateReport(
        identified=identified,
        residuals={**left_of_rows(found.rows), **found.inertial},
        fixes=_fix_residuals(found.rows["gps_position"]),
        keyframes=keyframes,
        problems=(Problem(BOX_ON_WHEEL, ON_WHEEL),) if is_on_wheel else (),
        mode="full",
    )


def _joint(found: Estimated, keyframes: Keyframes, unsure: Array, doppler: DopplerNoise | None) -> JointPosition | None:
    """How errors hang together; where Doppler draws the rows between keyframes, their own errors wander too."""
    joint = None if found.joint is None else found.joint(unsure)
    if joint is not None and doppler is not None:
        joint = Wandering(joint, median(np.einsum("kii->ki", keyframes.covariance)[:, 6:8].ravel()))
    return joint


def _times(session: Session, pauses: Pauses, rate: float) -> Array:
    """Times (N,) s of the rows, pauses closed."""
    first, last = pauses.opened(session.gnss.t[[0, -1]])
    t = row_times(first, last, rate)
    return pauses.closed(t[~pauses.are_cut_out(t)]) if len(pauses) else t


@dataclass(frozen=True, eq=False)
class _Source:
    """What dense rows come from: a solved chain, its samples, and the noise of these and of Doppler."""

    state: ChainState
    binned: BinnedImu
    noise: InertialNoise
    doppler: DopplerNoise | None
    upwards: DopplerNoise | None
    pauses: Pauses
    _last: dict[tuple[int, int], "_Stretch"] = field(default_factory=dict)

    def around(self, t: Array) -> "_Stretch":
        """Return the path around times t (n,) s that their rows need, and what was felt on it. No pause is in t."""
        keys = _around(self.state, t, self.pauses)
        known = self._last.pop((keys.start, keys.stop), None)
        self._last.clear()  # of a day, two do not fit
        self._last[keys.start, keys.stop] = found = self._stretch(keys) if known is None else known
        return found

    def _stretch(self, keys: slice) -> "_Stretch":
        state, bins = self.state.between(keys.start, keys.stop), self.binned.between(keys.start, keys.stop)
        c = state.constants
        path = dense_path(
            corrected(bins, c), state.R_ns, state.position_n, state.velocity_n, state.accel_bias_s, state.gyro_bias_s
        )
        return _Stretch(
            keys,
            state,
            bins,
            path,
            felt_on(
                path,
                c.level_axes_s,
                self.noise,
                self.doppler,
                state.interval,
                self.upwards,
                is_steered=c.is_steered,
            ),
        )


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A part of a :class:`_Source`: the keyframes `keys`, their state and bins, the path through them, what is felt."""

    keys: slice
    state: ChainState
    binned: BinnedImu
    path: DensePath
    felt: Felt


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of the trajectory as they are made, a part at a time: those of a day do not fit into the memory."""

    position_n: Array
    velocity_n: Array
    R_nb: Array
    acceleration_b: Array
    angular_rate_b: Array
    sigmas: dict[str, Array]

    @staticmethod
    def empty(n: int) -> "_Rows":
        sigmas = {name: roomy((n, 3)) for name in ("position_n", "velocity_n", "attitude")}
        sigmas |= {name: roomy(n) for name in ("speed", "track")}
        return _Rows(roomy((n, 3)), roomy((n, 3)), roomy((n, 3, 3)), roomy((n, 3)), roomy((n, 3)), sigmas)

    def fill(
        self,
        part: slice,
        t: Array,
        found: Estimated,
        noise: Noise,
        mounting: FittedMounting,
        source: _Source,
        keyframes: Keyframes,
    ) -> None:
        """Make the rows `part` at times t (n,) s, from the keyframes around them."""
        c, near = found.state.constants, source.around(t)
        motion, rate_n = motion_at(near.path, t), near.felt.rate_at(t)
        arm_n, R_nb = arm_axes_at(near.path, c, t, motion.R_ns) @ c.lever_arm_s, motion.R_ns @ mounting.R_bs.T
        self.position_n[part] = motion.position_n + arm_n
        self.velocity_n[part] = motion.velocity_n + np.cross(near.felt.swing_at(t), arm_n)
        self.R_nb[part] = R_nb
        self.acceleration_b[part] = np.einsum("nji,nj->ni", R_nb, near.felt.acceleration_at(t))
        self.angular_rate_b[part] = np.einsum("nji,nj->ni", R_nb, rate_n)
        known, keys, state = found.uncertainty, near.keys, near.state
        bend = known.bend[keys] + _between_samples(near.binned, noise.inertial, state.R_ns)
        covariance, track = keyframes.covariance[keys], known.track[keys]
        track = np.column_stack([track, _bridge(track[:, 0], noise, state.interval)])
        for name, values in _sigmas(t, state.t, covariance, track, bend, R_nb, motion.velocity_n).items():
            self.sigmas[name][part] = values

    def unsure_of_time(self, part: slice, sigma: float) -> None:
        """Add what the kart goes and gains in `sigma` s to the sigmas of position, velocity and speed of `part`."""
        velocity_n, R_nb = self.velocity_n[part], self.R_nb[part]
        acceleration_n = np.einsum("nij,nj->ni", R_nb, self.acceleration_b[part])
        pace = np.maximum(np.hypot(velocity_n[:, 0], velocity_n[:, 1]), 1e-12)
        faster = np.sum(velocity_n[:, :2] * acceleration_n[:, :2], axis=1) / pace
        for name, change in (("position_n", velocity_n), ("velocity_n", acceleration_n), ("speed", faster)):
            self.sigmas[name][part] = np.hypot(self.sigmas[name][part], sigma * change)

    def trajectory(self, t: Array, report: EstimateReport, joint: JointPosition | None) -> Trajectory:
        """Return the rows, all of which are filled."""
        columns = {name: getattr(self, name) for name in vars(self) if name != "sigmas"}
        for values in (*columns.values(), *self.sigmas.values()):
            values.flags.writeable = False
        return Trajectory(t=t, **columns, sigmas=Sigmas(**self.sigmas), report=report, joint=joint)


def _around(state: ChainState, t: Array, pauses: Pauses) -> slice:
    """Keyframes around times t (n,) s that the path there needs, from pause to pause."""
    stretch = pauses.stretches(state.t)[int(np.searchsorted(pauses.cuts, t[0], side="right"))]
    first = max(int(np.searchsorted(state.t, t[0] - MARGIN)) - 1, stretch.start)
    return slice(first, min(int(np.searchsorted(state.t, t[-1] + MARGIN)) + 1, stretch.stop))


def _parts(t: Array, pauses: Pauses) -> Iterator[slice]:
    """Slices of t (n,) s that are worked on together, none across a pause."""
    for stretch in pauses.stretches(t):
        for part in even_pieces(stretch.stop - stretch.start, TOGETHER):
            if part.stop > part.start:
                yield slice(stretch.start + part.start, stretch.start + part.stop)


def row_times(start: float, end: float, rate: float) -> Array:
    """Times (N,) s from start to end at `rate` Hz, without a hole."""
    return np.asarray(start + np.arange(int(np.floor((end - start) * rate + 1e-6)) + 1) / rate)


def _left_of_attitude(found: Estimated, mounting: FittedMounting, made_up: BoolArray | None) -> Array:
    """Share (3,), by axis of b, of the attitude's errors that is left once the mounting is fitted to it.

    An error that all keyframes have in common, by the bias of an axis that nothing shows, is taken for a part of the
    mounting: the box seems askew by so much more, and the kart is none the worse for it.
    made_up (K,): keyframes without samples.
    """
    if not mounting.is_fitted:
        return np.ones(3)
    mean, common = attitude_variance(found, mounting.R_bs, made_up)
    left = np.sqrt(np.clip(1.0 - common / mean, 0.0, 1.0))
    return np.array([*left[:2], 1.0]) if mounting.by_wheels else np.asarray(left)


def attitude_variance(found: Estimated, R_bs: Array, made_up: BoolArray | None) -> tuple[Array, Array]:
    """Mean variance (3,) rad^2, about the axes of b, of attitudes, and the part (3,) of it that all have in common.

    Of those that the mounting is fitted to. made_up (K,): keyframes without samples.
    """
    told = _told(found.state, made_up)
    some = told[:: max(1, len(told) // (10 * SAMPLES))]
    R_nb = found.state.R_ns[some] @ R_bs.T
    attitude = R_nb.transpose(0, 2, 1) @ found.uncertainty.antenna[some, 0:3, 0:3] @ R_nb
    attitude = attitude[_usually_known(attitude)]
    return np.einsum("kii->i", attitude) / len(attitude), np.diag(R_bs @ found.common_attitude @ R_bs.T)


def are_made_up(binned: BinnedImu) -> BoolArray | None:
    """Mask (K,) of the keyframes that the mounting is not fitted to since no samples tell them, None without any."""
    sampled = are_told(binned.missing)
    return None if np.all(sampled) else ~sampled


def _keyframes(
    found: Estimated, source: _Source, mounting: FittedMounting, unseen: Array, height_sigma: float
) -> Keyframes:
    """Antenna and kart at the keyframes, with the covariance of attitude (in n), velocity and position.

    height_sigma, m: of the antenna above the box where the graph held it, which tilting swings it by.
    """
    state, known = found.state, found.uncertainty
    R, arms_n = state.R_ns, arm_axes(state) @ state.constants.lever_arm_s
    R_nb, covariance, velocity_n = R @ mounting.R_bs.T, roomy(known.antenna.shape), state.velocity_n.copy()
    left = _left_of_attitude(found, mounting, are_made_up(source.binned))
    of_mounting = np.array([*mounting.sigma[:2], 0.0]) if mounting.by_wheels else mounting.sigma
    for part in _parts(state.t, source.pauses):
        covariance[part] = known.antenna[part]
        covariance[part, 6:9, 6:9] += np.diag(unseen)
        left_n = (R_nb[part] * left) @ R_nb[part].transpose(0, 2, 1)
        covariance[part, 0:3] = left_n @ covariance[part, 0:3]
        covariance[part, :, 0:3] = covariance[part, :, 0:3] @ left_n
        covariance[part, 0:3, 0:3] += (R_nb[part] * of_mounting**2) @ R_nb[part].transpose(0, 2, 1)
        felt, arm_n = source.around(state.t[part]).felt, arms_n[part]
        swing_n = felt.swing_at(state.t[part])
        velocity_n[part] += np.cross(swing_n, arm_n)
        by_height = height_sigma * np.cross(swing_n, UP_N)
        covariance[part, 3:6, 3:6] += swing_covariance(felt, arm_n) + by_height[:, :, None] * by_height[:, None, :]
        release(covariance, known, source.binned)
    return Keyframes(
        t=state.t,
        position_n=state.position_n + arms_n,
        velocity_n=velocity_n,
        R_nb=R_nb,
        covariance=covariance,
        accel_bias_s=state.accel_bias_s,
        gyro_bias_s=state.gyro_bias_s,
        sigma_accel_bias=known.biases[:, :3],
        sigma_gyro_bias=known.biases[:, 3:],
        gps_offset_n=state.offset_n,
        unseen_offset=unseen,
    )


def _may_climb(keyframes: Keyframes) -> None:
    """Add what ground that was taken to be level, where nothing tells of a height, may rise by to the velocity up."""
    for part in pieces(len(keyframes.t), TOGETHER):
        keyframes.covariance[part, 5, 5] += SLOPE**2 * np.sum(keyframes.velocity_n[part, :2] ** 2, axis=1)
        release(keyframes)


def _drift_upwards(keyframes: Keyframes) -> None:
    """Add the slow error that receivers' vertical velocities have, which nothing in a session tells, to that up."""
    for part in pieces(len(keyframes.t), TOGETHER):
        keyframes.covariance[part, 5, 5] += SLOW_UPWARDS**2
        release(keyframes)


def _widen(keyframes: Keyframes, swing: Array) -> None:
    """Add what the box stands off the kart, (3,) rad rms about the axes of b, to the errors of the kart's attitude."""
    for part in pieces(len(keyframes.t), TOGETHER):
        R_nb = keyframes.R_nb[part]
        keyframes.covariance[part, 0:3, 0:3] += (R_nb * swing**2) @ R_nb.transpose(0, 2, 1)
        release(keyframes)


def _sigmas(
    t: Array, at: Array, covariance: Array, track: Array, bend: Array, R_nb: Array, velocity_n: Array
) -> dict[str, Array]:
    """Sigmas at t (n,), fields of :class:`Sigmas`, between keyframes at `at` (K,), which are closer than these change.

    covariance (K, 9, 9) of the keyframes; track (K, 3) m^2, columns of :func:`track_variance` and :func:`_bridge`;
    bend (K, 3, 3), by which the covariance of velocity is greater halfway to the next keyframe than between both;
    R_nb (n, 3, 3) and velocity_n (n, 3) at t.
    """
    i = np.clip(np.searchsorted(at, t) - 1, 0, len(at) - 2)
    later = (t - at[i]) / (at[i + 1] - at[i])

    def between(values: Array) -> Array:
        """Values (n, ...) at t of values (K, ...) at the keyframes."""
        before = values[i]
        share = later.reshape(-1, *[1] * (before.ndim - 1))
        return np.asarray(before + share * (values[i + 1] - before))

    bent = 4.0 * later * (1.0 - later)
    diagonal = between(np.einsum("kii->ki", covariance)[:, 3:9])
    diagonal[:, 0:3] += bent[:, None] * np.einsum("kii->ki", bend)[i]
    ends = np.einsum("kii->ki", covariance)[:, 3:9]
    diagonal = np.maximum(diagonal, LEAST_BETWEEN * np.minimum(ends[i], ends[i + 1]))
    by_turn = euler_jacobian(R_nb) @ R_nb.transpose(0, 2, 1)
    attitude = np.einsum("nri,nri->nr", by_turn @ between(covariance[:, 0:3, 0:3]), by_turn)
    x, y = (velocity_n[:, :2] / np.maximum(np.linalg.norm(velocity_n[:, :2], axis=1), 1e-12)[:, None]).T
    speed = (
        x**2 * diagonal[:, 0]
        + y**2 * diagonal[:, 1]
        + 2.0 * x * y * (between(covariance[:, 3, 4]) + bent * bend[i, 0, 1])
    )
    alone = (1.0 - later) ** 2 * track[i, 0] + later**2 * track[i + 1, 0]
    variance = alone + 2.0 * later * (1.0 - later) * (track[i, 1] + 2.0 * track[i, 2])
    return {
        "position_n": np.sqrt(diagonal[:, 3:6]),
        "velocity_n": np.sqrt(diagonal[:, 0:3]),
        "speed": np.sqrt(np.maximum(speed, 0.0)),
        "attitude": np.sqrt(np.clip(attitude, 0.0, ANY_ANGLE**2)),  # no angle is less known than one that may be any
        "track": np.sqrt(np.maximum(variance, 0.0)),
    }


def _between_samples(binned: BinnedImu, noise: InertialNoise, R_ns: Array) -> Array:
    """Covariance (K, 3, 3) m^2/s^2 of velocity halfway to the next keyframe, given position and velocity of both.

    White force of density q between two ends that are known leaves q^2 T / 16. Source: the conditional covariance of
    integrated white noise, Q(T/2) - Q(T/2) Phi' Q(T)^-1 Phi Q(T/2).
    """
    density, _ = interval_noise(binned, noise)
    variance = density**2 * np.diff(binned.t) / 16.0
    shape_n = R_ns[:-1] @ np.array(noise.accel_shape) @ R_ns[:-1].transpose(0, 2, 1)
    inside = variance[:, None, None] * shape_n
    return np.concatenate([inside, inside[-1:]])


def _bridge(line: Array, noise: Noise, interval: float) -> Array:
    """What the offset does halfway between two keyframes adds to the variance `line` (K,) of the line at them, m^2.

    The offset walks on between keyframes, where the graph has its mean, and takes the walk for noise of the fixes. A
    fix draws the line to it by line over noise, which is so much less to be wrong by. Source: Brownian bridge, of the
    density of a first-order Gauss-Markov process over times that are short beside its own.
    """
    walk = float(np.mean(noise.offset_sigma[:2] ** 2)) * 0.5 * interval / noise.offset_tau
    return walk * np.maximum(1.0 - 2.0 * line / float(noise.position[0] ** 2), 0.0)


def _fix_residuals(rows: Rows) -> FixResiduals:
    residual = np.where(np.isfinite(rows.sigma), rows.residual, np.nan)
    return FixResiduals(np.arange(len(rows.interval)), residual, rows.weight)
