"""Which axes of the gyroscope are those of the accelerometer, by how a vehicle leans.

A vehicle leans in proportion to its push: out of a bend by k times the acceleration to the left, and back by c times
that ahead. While it turns by w about up, what it leans shows in both level rates, in the bend and on the way into it:

    rate ahead = k d(left)/dt + w c ahead,     rate to the left = -c d(ahead)/dt + w k left.

Accelerations are those of the path, so that nothing is asked of the accelerometer but how the box is mounted. Of a box
whose axes are right, k and c are each one number in both lines, and a vehicle squats when it accelerates: c is positive
(k is too but on banks and on two wheels). A level axis that has the wrong sign, or two that are exchanged, bring k into
the wrong line or in with two signs. All 48 ways to name three axes are tried, since none costs anything.

Both level axes with the wrong sign leave k and c one number each, of the other sign. They are told by c alone, and only
by how the vehicle pitches as it takes the brakes or lets them go, where that is well known: k has either sign.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, IntArray, median
from smoother.units import DEG

AROUND = 1.0  # s over which rates are averaged: bends last for longer, engines and kerbs shake for less
WITHIN = np.linspace(-0.4, 0.4, 5) * AROUND  # s, where the path is looked at for its mean
SPACING = 0.55  # s between fixes at the most; farther apart they hardly tell how a push comes and goes
BLOCK = 5.0  # s; what a corner leaves is independent of what others do
ROUNDS = 6  # of reweighting
FEWEST = 100  # windows
# of the power of what leans, over what its noise makes up: simulated karts have 12 to 150 in minutes, real karts and
# cars 15 to 220, those so shaken that the level axes hardly matter 0.5 to 5
TELLS = 8.0
# rad per m/s^2, half a degree at 1 g, by which whatever leans at all does so. Of a box that is some degrees askew the
# level axes turn with the slip by a fifth of that
LEAST = 0.8e-3
# share of that power that lean does not explain: of healthy boxes that tell 0.2 at the most, with a mistake in a level
# axis 0.6 or more
EXPLAINED, UNEXPLAINED = 0.3, 0.55
UPRIGHT = 10.0 * DEG  # between what is up by forces and by turns, of axes that are right
# Of one that is not seen to lean, likewise, and sigmas of it: twice the 8 deg that are the most there is, and more than
# banks of kart tracks make of it. And what is left of it once the one mistake is undone
ASKEW, CERTAIN, HALF_UPRIGHT = 20.0 * DEG, 4.0, 5.0 * DEG
# sigmas, by which a vehicle has to dive as it accelerates for both level axes to have the wrong sign. Of real cars and
# karts, and simulated ones with right signs, it squats by up to 17, and never dives by 1
BACKWARDS = 6.0
# rows of the coefficients by the vehicle's lean, of it by how the push ahead changes, and by its turn about up
LEANING, BRAKING, TURNING = slice(0, 4), 2, 4


@dataclass(frozen=True, eq=False)
class LeanRates:
    """Coefficients (6, 3) of the rate in s by change of push to the left and back, by turn times each of these (ahead
    for back), by turn and one; sigma (6, 3) of them; usual (6,), the scatter of what they multiply."""

    lines: Array
    sigma: Array
    usual: Array

    def leaning(self, R_bs: Array) -> "Leaning":
        """Return what of them is lean of a vehicle in which the gyroscope is mounted by R_bs (3, 3)."""
        usual = self.usual[LEANING]
        found = (self.lines[LEANING] @ R_bs[:2].T * usual[:, None]).T.ravel()
        by_left, by_ahead = np.zeros((2, len(found)))
        by_left[[0, 5]], by_ahead[[6, 3]] = usual[[0, 1]], usual[[2, 3]]
        left = float(by_left @ found / (by_left @ by_left))
        ahead = max(float(by_ahead @ found / (by_ahead @ by_ahead)), 0.0)
        rest = found - left * by_left - ahead * by_ahead
        noise = 2.0 / 3.0 * float(np.sum((self.sigma[LEANING] * usual[:, None]) ** 2))
        return Leaning(float(np.hypot(left, ahead)), float(found @ found), float(rest @ rest), noise)

    def squat(self, R_bs: Array) -> tuple[float, float]:
        """Return how the vehicle tilts back with the push ahead as that changes, rad per m/s^2, and its sigma."""
        sigma = float(np.linalg.norm(self.sigma[BRAKING] * R_bs[1]))
        return float(self.lines[BRAKING] @ R_bs[1]), sigma

    def off_upright(self, R_bs: Array) -> float:
        """Angle, rad, between what turns with the path and what is up in the vehicle."""
        x, y, up = R_bs @ self.lines[TURNING]
        return float(np.arctan2(np.hypot(x, y), up))


@dataclass(frozen=True)
class Leaning:
    """How a vehicle leans: size, rad per m/s^2. power, rad^2/s^2, is of all that the level rates do with its push, rest
    of what no vehicle does of that, and noise of what noise makes up."""

    size: float
    power: float
    rest: float
    noise: float

    @property
    def tells(self) -> bool:
        """Whether it is seen to lean."""
        return self.power > TELLS * self.noise and self.size > LEAST


@dataclass(frozen=True, eq=False)
class Naming:
    """One way to name the axes: true (3, 3) @ rate measured is the rate. is_single: one sign, or two axes exchanged;
    is_turned_round: two signs."""

    true: Array
    words: str
    is_single: bool
    is_turned_round: bool


def lean_rates(t: Array, axes: Array, at: Array, rate: Array) -> LeanRates | None:
    """Fit mean rates (M, 3) rad/s over AROUND at times `at` (M,) s by the motion along the path.

    axes (N, 3): acceleration ahead and to the left, m/s^2, and yaw rate, rad/s, at t (N,) s. None where there is too
    little to tell.
    """
    if len(at) < FEWEST or float(median(np.diff(t))) > SPACING:
        return None

    def path(shift: float) -> Array:
        return np.stack([np.interp(at + shift, t, values) for values in axes.T])

    change = (path(0.5 * AROUND) - path(-0.5 * AROUND)) / AROUND
    ahead, left, turn = np.mean([_with_turn(path(shift)) for shift in WITHIN], axis=0)
    design = np.stack([change[1], left, -change[0], ahead, turn, np.ones(len(at))], axis=1)
    lines, sigma = _fitted(design, rate, ((at - at[0]) / BLOCK).astype(np.intp))
    return LeanRates(lines, sigma, np.std(design, axis=0))


def wrong_naming(rates: LeanRates, R_bs: Array) -> Naming | None:
    """Return the naming of the gyroscope's axes that explains its rates, None where that is the one they have.

    R_bs (3, 3): the mounting by forces, which right axes of the gyroscope share.
    """
    if unexplained(rates, R_bs, ASKEW) < UNEXPLAINED:
        return None
    left, best = min((unexplained(rates, R_bs @ one.true), i) for i, one in enumerate(NAMINGS))
    found = NAMINGS[best]
    return found if left < EXPLAINED and rates.leaning(R_bs @ found.true).tells else None


def slight_mistakes(rates: LeanRates, R_bs: Array) -> tuple[str, ...]:
    """Return the single mistakes that explain that the gyroscope turns about what is far from up; () where it is not.

    For a box that is not seen to lean, and stands so askew that its turn about up tells. R_bs as for wrong_naming.
    """
    if rates.off_upright(R_bs) < ASKEW + CERTAIN * float(np.linalg.norm(rates.sigma[TURNING])):
        return ()
    off = [(rates.off_upright(R_bs @ one.true), one.words) for one in NAMINGS if one.is_single]
    return tuple(words for angle, words in off if angle < UPRIGHT) if min(off)[0] < HALF_UPRIGHT else ()


def both_turned_round(rates: LeanRates, R_bs: Array) -> str | None:
    """Return what has to be done with two axes that both have the wrong sign, None where they have the right one.

    R_bs as for wrong_naming. Two such axes lie level: else what is up would be elsewhere.
    """
    size, sigma = rates.squat(R_bs)
    if not (size < -max(BACKWARDS * sigma, LEAST) and unexplained(rates, R_bs) < UNEXPLAINED):
        return None
    return min((rates.off_upright(R_bs @ one.true), one.words) for one in NAMINGS if one.is_turned_round)[1]


def unexplained(rates: LeanRates, R_bs: Array, upright: float = UPRIGHT) -> float:
    """Share, 0 to 1, of what the level rates do with the push that no vehicle does; 1 where up is elsewhere."""
    if not rates.off_upright(R_bs) < upright:
        return 1.0
    leaning = rates.leaning(R_bs)
    return leaning.rest / max(leaning.power, 1e-30)


def _with_turn(axes: Array) -> Array:
    """Ahead and left (N,), each times the turn, and the turn; axes (3, N)."""
    return np.stack([axes[0] * axes[2], axes[1] * axes[2], axes[2]])


def _fitted(design: Array, values: Array, block: IntArray) -> tuple[Array, Array]:
    """Lines (p, 3) by least squares with Cauchy weights, and their sigmas from scores summed over blocks (N,).

    Source: White 1980, of clusters.
    """
    weight = np.ones(len(design))
    for _ in range(ROUNDS):
        weighted = (design * weight[:, None]).T
        inverse = np.linalg.pinv(weighted @ design)
        lines = inverse @ (weighted @ values)
        rest = values - design @ lines
        usual = MAD_TO_SIGMA * median(np.abs(rest).ravel()) + 1e-9
        weight = 1.0 / (1.0 + np.sum(rest**2, axis=1) / (8.0 * usual**2))
    sigma = np.empty_like(lines)
    for i, own in enumerate((rest * weight[:, None]).T):
        score = np.stack([np.bincount(block, own * column) for column in design.T], axis=1)
        sigma[:, i] = np.sqrt(np.sum((score @ inverse) ** 2, axis=0))
    return lines, sigma


def _namings() -> tuple[Naming, ...]:
    out = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            true = np.eye(3)[list(order)] * np.array(signs)[:, None]
            moved, negated = sum(i != source for i, source in enumerate(order)), signs.count(-1.0)
            single, round_about = (moved, negated) in ((2, 0), (0, 1)), (moved, negated) == (0, 2)
            out.append(Naming(true, _words(order, signs), single, round_about))
    return tuple(out)


def _words(order: tuple[int, ...], signs: tuple[float, ...]) -> str:
    """What has to be done with the columns."""
    names = ["g" + axis for axis in "xyz"]
    moved = [name for i, name in enumerate(names) if order[i] != i]
    negated = [name for name, sign in zip(names, signs, strict=True) if sign < 0.0]
    if len(moved) == 2 and not negated:
        return f"{moved[0]} and {moved[1]} are exchanged"
    if not moved and len(negated) == 1:
        return f"the sign of {negated[0]} is changed"
    if not moved and negated:
        return f"the signs of {', '.join(negated[:-1])} and {negated[-1]} are changed"
    columns = ["-" * (sign < 0.0) + names[source] for source, sign in zip(order, signs, strict=True)]
    return f"gx, gy, gz are filled from the columns {', '.join(columns)}"


NAMINGS = _namings()
