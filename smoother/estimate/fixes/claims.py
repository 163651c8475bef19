"""What a receiver claims of its fixes, and when it was another that claimed: corrections come and go.

A receiver that fixes carrier phases is off by centimetres, and by metres as soon as it loses its corrections. What it
is off by then is another error, a hundred times as large, and tells nothing of that before.
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.samples import GnssFixes

# m: an accuracy that only fixed carrier phases have; what others claim leaves their slow error out
RTK = 0.1
# per cent of the fixes, and times by which the others are worse from which on corrections came or went
WORSE, MIXED = 92.0, 6.0
# Receivers claim half to twice what their fixes are off by, of both axes; and no more than that is believed.
HALF, MOST_WORSE = 2.0 * math.sqrt(2.0), 10.0
BESIDE = 5  # fixes before and after, that are as accurate


def claimed_accuracy(fixes: GnssFixes) -> float | None:
    """Horizontal accuracy, m, that a receiver claims of its fixes, None if of none.

    The usual one; but where corrections came or went, and some fixes are many times less accurate, that of those: the
    wander of all is modelled as one.
    """
    reported = fixes.sigma_horizontal
    if reported is None or not np.any(np.isfinite(reported)):
        return None
    usual, worse = np.nanpercentile(reported, [50.0, WORSE])
    return float(worse if usual < RTK and worse > MIXED * usual else usual)


def receiver_share(fixes: GnssFixes, usual: float) -> float:
    """Reported horizontal accuracy over the usual slow error, m: a receiver that claims to be better may be so.

    One that claims to be far worse is believed as well: a session does not show a wander slower than it is long.
    """
    claimed = claimed_accuracy(fixes)
    if claimed is None:
        return 1.0
    share = claimed / usual
    return float(np.clip(share, 0.1, np.clip(share / HALF, 1.0, MOST_WORSE)))


@dataclass(frozen=True, eq=False)
class Claims:
    """Stretches in which a receiver claims to be about as accurate, one after the other.

    renewed (R, 2): stamps s of the fixes between which corrections came or went. share (R + 1,): the slow error of each
    stretch, in parts of that of the least accurate.
    """

    renewed: Array
    share: Array

    def between(self, t: Array, late: float) -> tuple[Array, BoolArray]:
        """Return of the intervals between t (K,) s, of fixes that are late by `late` s, the share (K-1,) of each, and
        whether (K-1,) the error is another after it than before."""
        renewed = self.renewed - late
        anew = np.zeros(len(t) - 1, dtype=np.bool_)
        share = self.share[np.searchsorted(renewed.mean(axis=1), 0.5 * (t[1:] + t[:-1]))]
        for k, (since, until) in enumerate(renewed.tolist()):
            first, last = np.searchsorted(t, [since, until])
            part = slice(max(int(first) - 1, 0), int(last))
            anew[part], share[part] = True, np.max(self.share[k : k + 2])
        return share, anew


ALIKE = Claims(np.empty((0, 2)), np.ones(1))


def claims_of(fixes: GnssFixes) -> Claims:
    """Cut fixes where from one to the next carrier phases are fixed or lost, by what is claimed from then on."""
    reported = fixes.sigma_horizontal
    if reported is None:
        return ALIKE
    known = np.flatnonzero(np.isfinite(reported) & (reported > 0.0))
    claimed, t = np.log(reported[known]), fixes.t[known]
    cuts = []
    for k in (np.flatnonzero(np.abs(np.diff(claimed)) > math.log(MIXED)) + 1).tolist():
        better, worse = sorted([median(claimed[max(0, k - BESIDE) : k]), median(claimed[k : k + BESIDE])])
        if better < math.log(RTK) and worse - better > math.log(MIXED):
            cuts.append(k)
    if not cuts:
        return ALIKE
    usual = np.exp([median(stretch) for stretch in np.split(claimed, cuts)])
    return Claims(np.array([(t[k - 1], t[k]) for k in cuts]), usual / np.max(usual))
