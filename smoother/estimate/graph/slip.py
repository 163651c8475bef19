"""Wheels roll along and hardly sideways: where the path points in the kart, as a Gauss-Markov process.

It ties the turn about up, which inertial sensor and fixes tell only where the kart speeds up or slows down, to the
direction of the path, and in an outage the path to the turns. What slip has in common is among the session's constants:
how the axes of the alignment are turned in the kart, what goes with lateral acceleration and with its rate, and what
goes with curvature, since only the rear axle does not move sideways. The rest is the process; how much a corner differs
from another grows with how hard it is taken.

No slip is asked for before a solution without it was seen to agree (:func:`slip_noise`): a box on the steering wheel
turns with the hands, a loose one anyhow.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.expected import ExpectedMotion
from smoother.estimate.graph.imu import DensePath, at_times
from smoother.estimate.graph.rows import Rows, empty_jacobians
from smoother.estimate.graph.state import KEYFRAME_SIZE, ROTATION, SLIP, VELOCITY, ChainState
from smoother.frames import UP_N, wrap_angle
from smoother.units import DEG

MOVING = 4.0  # m/s from which on the path has a direction to speak of
# rad beside the usual slip from which on a kart slides, spins or rolls backwards, for longer than that by AROUND s on
# either side: nothing is asked of its wheels then. Drivers on a slippery track hardly slide by 10 deg without a spin.
SLIDING, AROUND = 20.0 * DEG, 1.0
MOST_SLIDING = 0.2  # of the time at speed; what is beside the usual more often does not point where a kart does
SIDEWAYS = 0.05  # m/s by which bumps push the kart, from keyframe to keyframe
MEMORY = 2.0  # s; a corner's worth
# m/s^2 of lateral acceleration, m/s^3 of its rate, at which the process has its sigma, and the share of it without any:
# a hard corner of a kart; the turn into it, where slip that comes 0.1 s sooner or later than said differs by as much;
# and straights, where karts point along the track to 0.2 deg. (With more trust in the turn into corners, tyres that
# answer late would be told by it, and the nose by them: 0.5 deg off on a track with bends to one side, instead of 0.3.)
HARD, QUICK, STRAIGHT = 10.0, 25.0, 0.3
# Sigma of the process at HARD to begin with. Simulated karts have 0.6 deg. Of cars 0.1 to 1 deg were seen, of real
# karts none yet: the two recorded ones had the box on the steering wheel, where this is 7 deg.
FIRST = 0.6 * DEG
# Of the sigma that is found: that of how much corners differ, of what shows less, since its constants take over what
# they have in common, to what shows more, since tyres that answer late differ too; and rad. 90 karts with as much as
# nobody has seen, drawn at random, had rms 0.7 of that (benchmarks/random_karts.py, draws 1600 to 1689).
UNLIKE = 0.5, 5e-3
MOST = 4.0 * DEG  # of anything that is fixed to a chassis on wheels
ANY_SLIP = 0.5 * MOST  # how much it differs from corner to corner, beforehand
SLIP_COUNT = 5.0  # residuals that say that slip is FIRST
DIFFERENT = 12.0  # corners of a track, each of which has a slip of its own
ROUND_IT, OUT_OF_IT = 0.6, 0.3  # of a hard corner's lateral acceleration, between which one corner becomes another
# s of driving, whose median slip is away from that of all others by at most APART, rms, beyond what attitudes are
# unsure by. Simulated karts and drivers 0 to 0.3 deg, boxes that move on their mount or swing to and fro 0.8 to 4.
BLOCK, APART = 10.0, 0.7 * DEG
BEYOND_DOUBT = 1.4  # sigmas of the scatter of slip by which its process may have less than shows
FIT_SIGMA = 1.0 * DEG  # of a keyframe's slip about what the constants say, where these are fitted to a solution without
ENOUGH = 100  # keyframes at speed from which on a solution without slip tells how much there is
UNSURE_STEP, UNSURE = 0.6 * DEG, 1.0 * DEG  # errors of attitudes that leave a keyframe a quarter of its say in that
# Sigmas of the constants: rad, rad per m/s^2, rad per m/s^3, m. Cars had -0.004 to -0.007 rad per m/s^2, -0.001 to
# -0.003 rad per m/s^3, and the rear axle 1.2 m behind the box.
PRIOR = np.array([0.5, 0.01, 2e-3, 1.0])


@dataclass(frozen=True, eq=False)
class SlipNoise:
    """What is assumed of the slip. sigma rad of its process at HARD, no less than `least`; unsure, rad^2, is what
    attitudes of a solution without wheels leave unsure of it, in the mean.

    moments (4, 4): means of the products of slopes by its constants, over `different` times that are not alike. apart,
    rad: how far the nose, as the mean of all slip has it, is from where the process of the slip has it. shown: how many
    independent residuals tell `sigma`.
    """

    sigma: float
    least: float
    unsure: float
    moments: Array
    different: float
    apart: float = 0.0
    shown: float = 0.0

    @property
    def unsure_sigma(self) -> float:
        """Sigma, rad, of `sigma`, by how far it was from what simulated karts were given: see :data:`UNLIKE`."""
        guessed = SLIP_COUNT / (SLIP_COUNT + self.shown)
        return math.hypot(UNLIKE[0] * self.sigma, UNLIKE[1], guessed * ANY_SLIP)

    @property
    def nose_variance(self) -> float:
        """Variance, rad^2, of where the nose is, by what the constants miss of the slip in the same way in every lap.

        The process forgets in seconds, and a hundred laps would tell the nose ten times as well as one. But tyres are
        not linear, and a driver takes a corner in his way: what is missed comes back lap after lap. A track that turns
        to one side tells the nose by drawing a line on from its corners to none; how far off that is, is in here.

        The process believes how slip changes, a mean how much of it there is. Where the constants say all, both have
        the nose in one place (simulated karts: to 0.03 deg); where tyres answer late or not in proportion, not.
        """
        information = self.different * self.moments / self.sigma**2 + np.diag(PRIOR**-2.0)
        return float(np.linalg.inv(information)[0, 0]) + self.apart**2


@dataclass(frozen=True, eq=False)
class Slip:
    """Slip beyond what the constants say, at K keyframes, over level (K,), how much of it the process has there.

    value (K,) rad; own (K,) rad, its scatter from keyframe to keyframe; Jacobians by_keyframe (K, 18) and by_constants
    (K, 4). moves (K,), whether at speed, with samples, and not in a slide, which takes the share
    `sliding` of that.
    """

    value: Array
    moves: BoolArray
    own: Array
    by_keyframe: Array
    by_constants: Array
    level: Array
    sliding: float = 0.0

    @property
    def first_of_two(self) -> np.ndarray:
        """Keyframes at speed before another one."""
        return np.flatnonzero(self.moves[:-1] & self.moves[1:])


def slip_of(state: ChainState, path: DensePath, felt: ExpectedMotion, told: BoolArray, seen: BoolArray) -> Slip:
    """Return the slip at the keyframes of `state`. felt: the motion expected along `path`, which noise does not turn.

    told (K,): keyframes whose attitude samples tell; others' comes from the path, and would be asked for twice.
    seen (K,): keyframes near fixes, which show a slide; in an outage the path may point anywhere before wheels tell it.
    Only the turn about up is asked for: how steeply noise makes the path climb in the kart must not tilt it.
    """
    velocity_n, ahead_n = state.velocity_n, state.R_ns @ state.constants.level_axes_s[0]
    speed = np.hypot(velocity_n[:, 0], velocity_n[:, 1])
    at_least = np.maximum(speed, MOVING)
    left_n = np.cross(UP_N, velocity_n) / at_least[:, None]
    jerk_n = np.gradient(felt.acceleration_n, path.t[1] - path.t[0], axis=0)
    lateral, later = (
        np.sum(left_n * at_times(path, values, state.t), axis=1) for values in (felt.acceleration_n, jerk_n)
    )
    level = np.sqrt(STRAIGHT**2 + (lateral / HARD) ** 2 + (later / QUICK) ** 2)
    design = np.column_stack([np.ones(len(speed)), lateral, later, lateral / at_least**2])
    by_keyframe = np.zeros((len(speed), KEYFRAME_SIZE))
    by_keyframe[:, ROTATION] = -state.R_ns[:, 2, :]  # takes a turn in s to its part about up
    by_keyframe[:, VELOCITY] = left_n / at_least[:, None]
    course = np.arctan2(velocity_n[:, 1], velocity_n[:, 0]) - np.arctan2(ahead_n[:, 1], ahead_n[:, 0])
    angle = wrap_angle(course - design @ state.constants.slip)
    moves = (speed > MOVING) & told
    rolls = moves & ~_slides(angle, moves & seen, state.interval)
    return Slip(
        angle / level,
        rolls,
        SIDEWAYS / at_least / level,
        by_keyframe / level[:, None],
        -design / level[:, None],
        level,
        float(np.count_nonzero(moves & ~rolls)) / max(int(np.count_nonzero(moves)), 1),
    )


def slip_after_step(slip: Slip, step: Array, constants_step: Array) -> Slip:
    """Return the slip that the linear model predicts after a step (K, 18) and (31,)."""
    moved = np.einsum("ki,ki->k", slip.by_keyframe, step) + slip.by_constants @ constants_step[SLIP]
    return replace(slip, value=slip.value + moved)


def _slides(angle: Array, moves: BoolArray, interval: float) -> BoolArray:
    """Mask (K,) of the keyframes in and around a slide, by the slip (K,) rad of those that move and are seen.

    Beside what is usual in its BLOCK: attitudes that nothing holds are off by more, but for longer.
    """
    at = np.flatnonzero(moves)
    if not len(at):
        return moves
    first = np.arange(0, len(at), round(BLOCK / interval))
    usual = np.repeat([np.median(block) for block in np.split(angle[at], first[1:])], np.diff(first, append=len(at)))
    sliding = np.zeros(len(angle))
    sliding[at] = np.abs(wrap_angle(angle[at] - usual)) > SLIDING
    return np.convolve(sliding, np.ones(2 * round(AROUND / interval) + 1), "same")[: len(angle)] > 0.5


def tells_nose(variance: float) -> bool:
    """Whether the slip that is always there, known to `variance` rad^2, says where the nose points."""
    return bool(variance < (0.5 * PRIOR[0]) ** 2)


def remembered(interval: float) -> float:
    """Share of the process that is left after `interval`, s."""
    return math.exp(-interval / MEMORY)


def slip_rows(slip: Slip, interval: float, sigma: float) -> tuple[Rows, Rows]:
    """Rows of the process: its start wherever the kart gets going, and its steps. sigma rad at HARD; interval s.

    With these no keyframe needs an unknown for it. Source: Gelb 1974, 3.8.
    """
    phi, both = remembered(interval), slip.first_of_two
    begins = both[np.diff(both, prepend=-2) > 1]
    left, right, constants = empty_jacobians(len(begins), 1)
    left[:, 0], constants[:, 0, SLIP] = slip.by_keyframe[begins], slip.by_constants[begins]
    start = _rows("slip_start", begins, slip.value[begins], sigma**2 + slip.own[begins] ** 2, left, right, constants)
    left, right, constants = empty_jacobians(len(both), 1)
    left[:, 0], right[:, 0] = -phi * slip.by_keyframe[both], slip.by_keyframe[both + 1]
    constants[:, 0, SLIP] = slip.by_constants[both + 1] - phi * slip.by_constants[both]
    variance = sigma**2 * (1.0 - phi**2) + slip.own[both + 1] ** 2 + phi**2 * slip.own[both] ** 2
    step = slip.value[both + 1] - phi * slip.value[both]
    return start, _rows("slip", both, step, variance, left, right, constants)


def _rows(
    name: str, interval: np.ndarray, value: Array, variance: Array, left: Array, right: Array, constants: Array
) -> Rows:
    sigma = np.sqrt(variance)[:, None]
    return Rows(name, interval, value[:, None], sigma, left, right, constants, np.ones(len(interval)))


def not_doubted_by(slip: Slip, unsure: float, rows: Rows) -> Rows:
    """Return `rows` of the slip with sigmas to be judged by at a solution without wheels.

    There the errors of its attitudes, of variance `unsure` rad^2, are in the residuals too. Judged by the process alone
    half of them would stand out, and the step would be short, and the process seem to have much of what is theirs.
    """
    variance = rows.sigma**2 + (unsure / slip.level[rows.interval] ** 2)[:, None]
    return replace(rows, sigma=np.sqrt(variance))


def slip_noise(slip: Slip, solution: ChainSolution, interval: float) -> SlipNoise | None:
    """Return what to assume of the slip to begin with; None where it is none of wheels.

    By `solution`, in which no slip was asked for: what of the scatter of the slip, and of its steps, its errors do not
    explain. Keyframes count by how well their attitude is known. interval s. The least is what the scatter shows beyond
    doubt: slip is smoother than a Gauss-Markov process, whose sigma would be taken for less by small steps.
    """
    k = slip.first_of_two
    if len(k) < ENOUGH or slip.sliding > MOST_SLIDING:
        return None
    constants = _fitted(slip, k)
    now, then = (slip.value[i] + slip.by_constants[i] @ constants for i in (k, k + 1))
    P, before, after = solution.covariance, slip.by_keyframe[k], slip.by_keyframe[k + 1]
    of_now, of_then = _product(before, P[k], before), _product(after, P[k + 1], after)
    phi = remembered(interval)
    of_step = of_then + phi**2 * of_now - 2.0 * phi * _product(before, solution.cross[k], after)
    by_steps, _ = _unexplained(then - phi * now, of_step, UNSURE_STEP)
    by_all, spread = _unexplained(now, of_now, UNSURE)
    found = math.sqrt(max(by_steps / (1.0 - phi**2), by_all, 0.0))
    unsure = float(np.mean(of_now * slip.level[k] ** 2))
    if found > MOST or _apart(now * slip.level[k], unsure, interval) > APART:
        return None
    surely = by_all - BEYOND_DOUBT * spread * math.sqrt(MEMORY / interval)  # squares are alike for half as long
    moments = slip.by_constants[k].T @ slip.by_constants[k] / len(k)
    lateral = slip.by_constants[k, 1] / slip.by_constants[k, 0]
    different = min(DIFFERENT, len(k) * interval / (2.0 * MEMORY), corners(lateral))
    return SlipNoise(max(found, FIRST), math.sqrt(max(surely, 0.0)), unsure, moments, different)


def corners(lateral: Array) -> int:
    """How often a kart went into a corner, by its lateral accelerations (N,) m/s^2; a steady circle is one."""
    part = lateral / max(float(np.percentile(np.abs(lateral), 90)), 1e-9)
    turns = np.where(np.abs(part) > ROUND_IT, np.sign(part), 0.0)
    turns = turns[(turns != 0.0) | (np.abs(part) < OUT_OF_IT)]
    return max(1, int(np.count_nonzero((np.diff(turns, prepend=0.0) != 0.0) & (turns != 0.0))))


def with_nose(slip: Slip, noise: SlipNoise) -> SlipNoise:
    """Return the noise with what is left of the nose's place in the slip of a solution with wheels."""
    k = slip.first_of_two
    return replace(noise, apart=float(_fitted(slip, k)[0])) if len(k) else noise


def is_of_wheels(slip: Slip, unsure: float, interval: float) -> bool:
    """Whether a part of a session, solved without slip, slips as its constants say; unsure as of :class:`SlipNoise`."""
    k = slip.first_of_two
    return (
        len(k) >= ENOUGH
        and slip.sliding < MOST_SLIDING
        and _apart(slip.value[k] * slip.level[k], unsure, interval, usual=0.0) < APART
    )


def _apart(angle: Array, unsure: float, interval: float, usual: float | None = None) -> float:
    """How far, rad rms, medians of slip (N,) rad over BLOCK s are from the usual one, beyond the variance `unsure`."""
    n = min(round(BLOCK / interval), len(angle))
    medians = np.median(angle[: len(angle) // n * n].reshape(-1, n), axis=1)
    middle = float(np.median(medians)) if usual is None else usual
    return math.sqrt(max(float(np.mean((medians - middle) ** 2)) - unsure, 0.0))


def _product(left: Array, covariance: Array, right: Array) -> Array:
    return np.asarray(np.einsum("ki,kij,kj->k", left, covariance, right))


def _unexplained(values: Array, variance: Array, unsure: float) -> tuple[float, float]:
    """Mean square of values (N,) beyond their variance (N,), and its sigma were they independent.

    Those of variance unsure^2 have a quarter of the weight.
    """
    weight = 1.0 / (variance + unsure**2) ** 2
    weight = weight / np.sum(weight)
    beyond = float(np.sum(weight * (values**2 - variance)))
    return beyond, math.sqrt(2.0 * float(np.sum((weight * (variance + max(beyond, 0.0))) ** 2)))


def _fitted(slip: Slip, k: np.ndarray) -> Array:
    """Change of the constants (4,) that fits the slip at the keyframes k best, with Cauchy weights and their priors."""
    design, value = -slip.by_constants[k], slip.value[k]
    weight, prior = np.ones(len(k)), np.diag((FIT_SIGMA / PRIOR) ** 2)
    for _ in range(5):
        weighted = design * weight[:, None]
        constants = np.linalg.solve(weighted.T @ design + prior, weighted.T @ value)
        rest = np.abs(value - design @ constants)
        weight = 1.0 / (1.0 + (rest / (3.0 * np.median(rest) + 1e-9)) ** 2)
    return np.asarray(constants)
