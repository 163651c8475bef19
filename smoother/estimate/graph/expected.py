"""The motion that a receiver is expected to have felt: what the inertial samples tell of it, less their noise.

Doppler velocities tell the lever arm by the yaw rate that swings the antenna, and their latency by the acceleration.
Both come from noisy samples. A fit against noisy values is drawn towards zero and thinks itself too certain; a fit
against the most probable ones is not: what they miss is not a part of them (Berkson 1950). They have to be the most
probable given both sensors, though. On a track the yaw rate is nearly lateral acceleration over speed, so that arm and
latency are told apart only by where it is not; filtered one by one, each would miss something that the other one knows,
and the fit would take that for the difference.

How noisy a gyro is where a kart turns is told best by what it shows where no kart does: engines that the samples alias
are not in the noise that was identified, and differ from axis to axis.

They must not lead or lag the samples either. The best guess at each frequency by itself would contain as much of the
slope of the acceleration as it likes; of noise in the velocities that is the second derivative, which goes with what
the fit leaves of it and would look like an arm. Gains without a phase leave such noise out of phase with the rest. But
the nose turns in before the path does, by some hundredths of a second: a yaw rate that gains in phase with the
acceleration lags by as much as it has of it, and what tells arm and latency apart is lost. So both are brought together
by the one time that the yaw rate is ahead, which is found from all turns, and the yaw rate is put back to its own.

The path is better than the samples: below some hertz Doppler has taken most of their noise out of its acceleration.
What is left of it is no part of what the fit reads, the residuals of Doppler against that path (the error of a weighted
mean and the difference of what it is the mean of are independent), so that the acceleration needs to be freed from no
more than that. The turn rate is left to the samples: Doppler tells of it through the path alone, whose errors by the
arm and the latencies it would then be believed.

What a path may hold between two keyframes is another matter. Slopes of fixes are made of velocity and acceleration at
the keyframes, and so are the predictions: of a motion that is too quick for that, a chassis that hops on its tyres ten
times a second, both are made of the same few samples, by which the prediction is then off. Slope and error go together,
by as much as the hop has at the time from keyframe to fix, which looks like a latency: in a car that drives straight,
where little else accelerates, one of 30 ms, this way or that by where in their intervals the fixes fall. So slopes are
made of what samples T s apart can follow (Nyquist). The expected motion itself keeps the rest: it was there. The slope
by the arm, which is the turn rate, is made alike: an arm and a latency are told apart by where turn and acceleration
differ, and what one slope has and the other lacks, most of it noise, would pass for that.

Keyframes of quick receivers follow twice that and more, of which hardly anything is driven: kerbs, over which a chassis
rolls and an antenna above the box goes another way, noise that the path took from either sensor. Little of what tells
latencies is lost without, a fiftieth of what is known of the arm, and what goes with the place of the keyframes goes:
so slopes are of motion slower than DRIVEN_BELOW, whatever the receiver. The second derivative too, which grows with
the square of a frequency: on a real kart with a folded engine and 25 fixes a second, quicker motion was noise, by which
response, delay and arm drove one another to and fro, turn after turn, by 0.05 s and half a metre; simulated receivers
that filter answer slower motion as clearly.

A receiver that filters its velocities shows little of quick motion, and late or early by what depends on its filter.
Slow motion is late by the delay of any filter, and rounded by its response; so all slopes are of motion that is slow
for the response found (:func:`shown_below`). Slopes of quick motion go with what the filter that is looked for has of
it and the receiver's has not: tens of ms of delay, decimetres of arm, beside which the response may seem to be nothing.

Nor does a spectrum tell motion from vibration that the sampling folds to some hertz: it is a line, far above the noise,
and Doppler does not show it, so that a receiver would seem to smooth what it shows, and its delay to go with that.
Vehicles accelerate the less the quicker: where there is more again from SHAKEN on, slopes are made of slower motion.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array
from smoother.estimate.graph.arm import course
from smoother.estimate.graph.wiener import MostProbable, Transform, most_probable
from smoother.estimate.model.imu import DensePath
from smoother.estimate.model.inertial_noise import InertialNoise
from smoother.estimate.on_wheel import QUICK_TURN, SLOW_TURN
from smoother.fit.running import running_mean
from smoother.frames import to_left

SLOWEST_NOISE = 0.05  # Hz; slower, the motion is told by the fixes, and samples have no part in it
LEAST_LEFT = 0.3  # of the power of the samples' noise, in the path, whose swing, arm and latencies err too
QUICKEST_TURN = 0.8  # Hz; up to there a kart turns more than its sensors are noisy
NO_TURN = 4.0  # Hz; from there on a kart does not turn at all
HANN_POWER = 0.375  # mean square of the taper
# s, from which on a turn and an acceleration are of other things; it fades from half of it on. A box on the steering
# wheel turns as early, and what is all on one side of a limit and nothing on the other makes two solutions of one
MOST_LEAD = 0.3
# Hz, and what of them slopes are made of where a motion is no less in the latter: no vehicle's is, 0.3 times at most
DRIVEN, SHAKEN, STEADY_SLOPE = (0.5, 1.0), (2.5, 5.0), 1.5
DRIVEN_BELOW = 2.5  # Hz, that the keyframes of receivers up to 10 Hz follow
# Share of a motion that a response takes off where slopes by it end, and Hz, from which on they hold what a kart drives
ROUNDED, DRIVEN_FROM = 0.3, 0.45
LEAST_SPEED = 3.0  # m/s, by which a turn counts at rest, lest a turn on the spot count for nothing
STEEPEST = 2.5  # turn about up in parts of that about the way ahead: of a column 22 deg off upright
SLOW = 0.5  # of the usual speed; what turns a kart more slowly is not made of so much more of the noise of its force
# channels: accelerations ahead and to the left, turn times speed, acceleration upwards, which goes with none of these
LEVEL, TURN, UPWARDS, LEVEL_AND_TURNING = slice(0, 2), 2, slice(3, 4), slice(0, 3)
TURNING = slice(TURN, TURN + 1)


@dataclass(frozen=True, eq=False)
class Motion:
    """velocity_n (M, 3) m/s, acceleration_n (M, 3) m/s^2 and turn_rate (M,) rad/s about up, at the edges of a path."""

    velocity_n: Array
    acceleration_n: Array
    turn_rate: Array


@dataclass(frozen=True, eq=False)
class ExpectedMotion(Motion):
    """Motion whose velocity is the path's, less what the noise in the acceleration has added to it.

    turn_variance, (rad/s)^2: of the errors of turn_rate. followed: the motion without what is too quick to drive, or
    for keyframes to follow; None where that is all of it. shown: without what is quicker than the receiver shows too;
    None where `followed` is.
    """

    turn_variance: float = 0.0
    followed: Motion | None = None
    shown: Motion | None = None

    @property
    def answered(self) -> Motion:
        """What of the motion a receiver's response is taken to be to."""
        return self if self.followed is None else self.followed

    @property
    def slow(self) -> Motion:
        """What of the motion slopes by latencies, arm and a receiver's response are made of."""
        return self.answered if self.shown is None else self.shown

    def means(self, n_bins: int) -> Array:
        """Mean accelerations (K-1, 3) m/s^2 over intervals of n_bins bins each."""
        of_bins = 0.5 * (self.acceleration_n[1:] + self.acceleration_n[:-1])
        return np.asarray(of_bins.reshape(-1, n_bins, 3).mean(axis=1))


@dataclass(frozen=True)
class DopplerNoise:
    """What velocities tell on an axis: sigma m/s of one of them, and the mean time, s, from one to the next."""

    sigma: float
    every: float

    @staticmethod
    def of(t: Array, velocity: Array, sigma: float) -> "DopplerNoise | None":
        """Of velocities (N,), NaN where unknown, at t (N,) s, with noise of `sigma` m/s; None where there are none."""
        read = t[np.isfinite(velocity)]
        return DopplerNoise(sigma, float(np.ptp(read)) / (len(read) - 1)) if len(read) > 1 else None


def expected_motion(
    path: DensePath,
    level_axes_s: Array,
    noise: InertialNoise,
    doppler: DopplerNoise | None,
    interval: float,
    upwards: DopplerNoise | None = None,
    *,
    is_steered: bool = False,
    slopes_below: float = DRIVEN_BELOW,
    with_slopes: bool = True,
) -> ExpectedMotion:
    """Most probable motion behind the accelerations and rates of the bins of `path`, whose samples had `noise`.

    level_axes_s (3, 3): rows are forward, left and up in s. doppler: of the velocities that the path was fitted to,
    None where there were none, upwards likewise of vertical ones; interval, s, between its keyframes. is_steered: the
    box turns with the steering wheel as well, which is taken out of its turn. slopes_below, Hz: slopes are of that.
    with_slopes: what slopes are made of too.
    """
    R_nb, dt = path.R_ns[:-1] @ level_axes_s.T, float(path.t[1] - path.t[0])
    acceleration_b = np.einsum("kji,kj->ki", R_nb, path.acceleration_n)
    speed = np.sqrt(np.sum(path.velocity_n[:-1, :2] ** 2, axis=1) + LEAST_SPEED**2)
    rate = np.sum(path.R_ns[:-1, 2, :] * path.angular_rate_s, axis=1)
    if is_steered:
        rate = rate + _of_column(
            path, rate, noise.gyro**2 * float(level_axes_s[0] @ np.array(noise.gyro_shape) @ level_axes_s[0])
        )
    scatter = _scatter(level_axes_s, noise, dt)
    if not all(np.all(np.isfinite(values)) for values in (acceleration_b, speed, rate, scatter)):
        # it has run away; the solver says so
        return ExpectedMotion(path.velocity_n, at_edges(path.acceleration_n), at_edges(rate))
    turn = _expected_turn(acceleration_b[:, :2], rate, speed, scatter, dt)
    felt = Transform.of(np.column_stack([acceleration_b[:, :2], rate * speed, acceleration_b[:, 2]]), dt)
    sigma = np.tile(scatter, (len(felt.frequency), 1))
    sigma[:, TURNING] = max(scatter[TURN] * _rms(speed), quick_scatter(felt.channels(TURNING)))
    for channels, velocities in ((LEVEL, doppler), (UPWARDS, upwards)):
        sigma[:, channels] *= np.sqrt(noise_left(felt.frequency, noise.accel, velocities, interval))[:, None]
    lead = np.array([0.0, 0.0, turning_lead(felt.channels(slice(1, 3)))])
    level = most_probable(felt.channels(LEVEL_AND_TURNING).later(lead), sigma[:, LEVEL_AND_TURNING], LEVEL)
    up = most_probable(felt.channels(UPWARDS), sigma[:, UPWARDS], slice(0, 1))
    found = [level.signal, up.signal, turn.signal]
    motion = _motion_along(path, R_nb, found)
    followed, shown = None, None
    if with_slopes:
        quickest = quickest_slope(level.signal, interval)
        followed = _motion_along(path, R_nb, [signal.slower_than(quickest) for signal in found])
        if quickest > 1.01 * slopes_below:
            shown = _motion_along(path, R_nb, [signal.slower_than(slopes_below) for signal in found])
    return ExpectedMotion(
        motion.velocity_n, motion.acceleration_n, motion.turn_rate, float(turn.variance[0]), followed, shown
    )


def _of_column(path: DensePath, rate: Array, rolling_noise: float) -> Array:
    """By how much the kart's turn (M-1,) rad/s is more than that of a box on its wheel, rate (M-1,), all about up.

    The column leans to the driver: the wheel turns the box about the way ahead too, in one ratio, and a kart hardly
    rolls. The ratio is that of what is quicker than bends. What the kart itself turns goes with the wheel, later than
    it: the turn of the path and how that changes take it out. What of the turn about the way ahead is noise, of density
    rolling_noise (rad/s)^2/Hz, would make the ratio too small: its power is taken out, up to half of all there is.
    """
    dt, headed = float(path.t[1] - path.t[0]), course(path.velocity_n)[:-1]
    ahead_n = np.column_stack([np.cos(headed), np.sin(headed), np.zeros(len(headed))])
    rolling = np.einsum("ki,kij,kj->k", ahead_n, path.R_ns[:-1], path.angular_rate_s)
    push = to_left(path.velocity_n[:-1, :2], path.acceleration_n[:, :2])
    of_path = push / (np.sum(path.velocity_n[:-1, :2] ** 2, axis=1) + LEAST_SPEED**2)
    felt = np.column_stack([rolling, of_path, rate])
    slow, quicker = (running_mean(felt, 2 * max(1, round(0.5 * seconds / dt))) for seconds in (SLOW_TURN, QUICK_TURN))
    quick = quicker - slow
    kart = np.column_stack([quick[:, 1], np.gradient(quick[:, 1], dt)])
    roll, turn = (quick[:, ::2] - kart @ np.linalg.lstsq(kart, quick[:, ::2], rcond=None)[0]).T
    power = float(roll @ roll)
    of_noise = len(roll) * rolling_noise * (1.0 / QUICK_TURN - 1.0 / SLOW_TURN)
    ratio = -float(roll @ turn) / max(power - of_noise, 0.5 * power, 1e-30)
    return np.asarray(rolling * min(max(ratio, 0.0), STEEPEST))


def shown_below(response: float) -> float:
    """Frequency, Hz, of motion that a receiver with a response, s^2, shows late, and little else; DRIVEN_BELOW at most.

    The least that a response takes off a motion with angular frequency w is response w^2.
    """
    if response <= 0.0:
        return DRIVEN_BELOW
    return min(DRIVEN_BELOW, max(DRIVEN_FROM, math.sqrt(ROUNDED / response) / (2.0 * math.pi)))


def quickest_slope(level: Transform, interval: float) -> float:
    """Frequency, Hz, up to which slopes are made of a motion with the level accelerations `level`.

    That which keyframes `interval` s apart can follow, at most DRIVEN_BELOW; less, by and by, where there is as much in
    SHAKEN as in DRIVEN.
    """
    power = np.sum(np.abs(level.coefficients) ** 2, axis=1)

    def mean_in(band: tuple[float, float]) -> float:
        inside = (level.frequency >= band[0]) & (level.frequency < band[1])
        return float(np.mean(power[inside])) if np.any(inside) else 0.0

    followed = min(0.5 / interval, DRIVEN_BELOW)
    ratio = mean_in(SHAKEN) / max(mean_in(DRIVEN), 1e-30)
    shaken = float(np.clip(1.0 + math.log2(max(ratio, 1e-30)), 0.0, 1.0))  # from a half to one
    return float(followed * min(STEADY_SLOPE / followed, 1.0) ** shaken)


def _motion_along(path: DensePath, R_nb: Array, found: Sequence[Transform]) -> Motion:
    """Motion with accelerations, m/s^2 ahead, left and up, and turn, rad/s, of the bins of `path`.

    R_nb (M-1, 3, 3) are the axes of the bins. Velocities are the path's but for what its accelerations have beyond.
    """
    *accelerations, turn = (signal.values() for signal in found)
    acceleration_b = np.hstack(accelerations)
    acceleration_n = np.einsum("kij,kj->ki", R_nb, acceleration_b)
    beyond_n = integrated(path.acceleration_n - acceleration_n, float(path.t[1] - path.t[0]))
    return Motion(path.velocity_n - beyond_n, at_edges(acceleration_n), at_edges(turn[:, 0]))


def _expected_turn(level: Array, rate: Array, speed: Array, scatter: Array, dt: float) -> MostProbable:
    """Most probable yaw rate of bins of dt s: of rate (M,) rad/s, and level accelerations (M, 2) m/s^2, ahead and left.

    As a rate, and not as an acceleration that is divided by the speed in the end: what is left of the noise of quick
    corners would be several times as much in slow ones, and what of a yaw rate does not go with the acceleration is
    what tells an arm from a latency. speed (M,) m/s; scatter (4,) of :func:`_scatter`.
    """
    slow = np.maximum(speed, SLOW * _rms(speed))
    felt = Transform.of(np.column_stack([level[:, 0], level[:, 1] / slow, rate]), dt)
    sigma = scatter[:3] * [1.0, _rms(1.0 / slow), 1.0]
    sigma[TURN] = max(sigma[TURN], quick_scatter(felt.channels(TURNING)))
    lead = np.array([0.0, 0.0, turning_lead(felt.channels(slice(1, 3)))])
    turn = most_probable(felt.later(lead), sigma, TURNING)
    return replace(turn, signal=turn.signal.later(-lead[TURNING]))


def expected_tilting(path: DensePath, level_axes_s: Array, noise: InertialNoise) -> tuple[Array, float]:
    """Most probable rates of roll and pitch (M, 2) rad/s, at the edges of `path`, and the variance of their errors.

    level_axes_s as for :func:`expected_motion`.
    """
    rates, dt = path.angular_rate_s @ level_axes_s[:2].T, float(path.t[1] - path.t[0])
    sigma = noise.gyro * np.sqrt(np.diag(level_axes_s[:2] @ np.array(noise.gyro_shape) @ level_axes_s[:2].T) / dt)
    if not np.all(np.isfinite(rates)):
        return at_edges(rates), 0.0
    found = most_probable(Transform.of(rates, dt), sigma, LEVEL)
    return at_edges(found.signal.values()), float(np.mean(found.variance))


def _scatter(level_axes_s: Array, noise: InertialNoise, dt: float) -> Array:
    """Standard deviation (4,) of bins of dt s: acceleration ahead, left, m/s^2, turn, rad/s, acceleration upwards."""
    ahead, left, up = noise.accel * np.sqrt(np.diag(level_axes_s @ np.array(noise.accel_shape) @ level_axes_s.T))
    turn = noise.gyro * np.sqrt(level_axes_s[2] @ np.array(noise.gyro_shape) @ level_axes_s[2])
    return np.asarray(np.array([ahead, left, turn, up]) / np.sqrt(dt))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def quick_scatter(turning: Transform) -> float:
    """Standard deviation of white noise with the mean power that the one channel of `turning` has from NO_TURN on.

    0 where it does not reach that far. Tapered (Hann), lest the step from end to beginning count.
    """
    whole = turning.coefficients[:, 0]
    tapered = 0.5 * whole[1:-1] - 0.25 * (whole[:-2] + whole[2:])
    quick = tapered[turning.frequency[1:-1] >= NO_TURN]
    return math.sqrt(float(np.mean(np.abs(quick) ** 2)) / (HANN_POWER * turning.count)) if len(quick) else 0.0


def turning_lead(both: Transform) -> float:
    """Time, s, that a turn is ahead of the lateral acceleration that it makes; two channels, acceleration and turn.

    The phase between both grows with frequency; its slope, weighted by what they share. Less of what is long.
    """
    angular = 2.0 * np.pi * both.frequency
    use = (angular > 2.0 * np.pi * SLOWEST_NOISE) & (angular < 2.0 * np.pi * QUICKEST_TURN)
    acceleration, turn = both.coefficients[use].T
    shared, angular = acceleration.conj() * turn, angular[use]
    weight = float(np.sum(angular**2 * shared.real))
    found = float(np.sum(angular * shared.imag)) / weight if weight > 0.0 else 0.0
    return found * float(np.clip(2.0 * (1.0 - abs(found) / MOST_LEAD), 0.0, 1.0))


def noise_left(frequency: Array, accel: float, doppler: DopplerNoise | None, interval: float) -> Array:
    """Share (F,) of the power of the samples' noise that is left in a path's acceleration at `frequency` (F,) Hz.

    accel m/s^2/sqrt(Hz), doppler and interval as for :func:`expected_motion`. From one reading to the next, the mean of
    the acceleration is that of both sensors, weighted; within, it is as the samples say.
    LEAST_LEFT is left of what velocities take away.
    """
    if doppler is None:
        return np.ones(len(frequency))
    T = max(interval, doppler.every)
    of_samples = accel**2 / T
    of_doppler = (2.0 * np.sin(np.pi * frequency * T) * doppler.sigma / T) ** 2 * (doppler.every / T)
    of_mean = of_doppler / (of_samples + of_doppler)
    of_path = 1.0 - np.sinc(frequency * T) ** 2 * (1.0 - of_mean)
    return np.asarray(LEAST_LEFT + (1.0 - LEAST_LEFT) * of_path)


def integrated(values: Array, dt: float) -> Array:
    """Integral at the edges (M, c) of means of bins (M-1, c), dt s apart, without what is slower than SLOWEST_NOISE.

    From edge to edge it changes by a bin, as the velocity of a path does. The integral of a smooth curve through the
    bins would leave a tenth of the quick noise in that velocity, and slopes are what differences of it are.
    """
    rate = Transform.of(values, dt)
    angular = 2.0 * np.pi * rate.frequency[1:, None]
    sums = dt * np.exp(-0.5j * angular * dt) / (2j * np.sin(0.5 * angular * dt))
    gain = sums * angular**2 / (angular**2 + (2.0 * np.pi * SLOWEST_NOISE) ** 2)
    changes = np.concatenate([np.zeros((1, values.shape[1])), rate.coefficients[1:] * gain])
    begins = replace(rate, coefficients=changes, mean=0.0 * rate.mean).values()
    return np.concatenate([begins, begins[-1:] + dt * values[-1:]])


def at_edges(values: Array) -> Array:
    """Values of bins (M-1, ...) at their edges, (M, ...)."""
    return np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])
