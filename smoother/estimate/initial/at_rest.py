"""Velocities of fixes while the kart stands: what each of them tells of a bias that lasts through the session.

At rest nothing moves but the satellites, and what is wrong with a velocity is wrong with those after it as well. Two
modules in one car show an autocorrelation of 0.8 after 1 s, 0.7 after 3 s and 0.4 after 10 s, a kart's receiver 0.6,
0.5 and 0.3; each stand has another mean, of up to 0.03 m/s. Counted one by one, as if their noise were white, the
velocities of a minute at rest would say what bias those of the drive have, and the whole path would slide away with it.
A third receiver, beside RTK, has none of it: what lasts is found from the session.
"""

import numpy as np

from smoother.arrays import Array, BoolArray, median

LASTS = 20.0  # s for which all that lasts of a velocity's error counts as one
LATER = 2.0  # s after which two velocities have in common what lasts
USUAL_SHARE, USUAL_FOR = 0.7, 5.0  # of the variance of velocities at rest that lasts; s of a stand that say as much


def scale_at_rest(t: Array, velocity_n: Array, standing: BoolArray) -> float:
    """Factor of the sigma of each velocity at rest, by which all of them tell what they do together.

    t (N,) s; velocity_n (N, 3) m/s, NaN where unknown; standing (N,): at rest.
    A share r of their variance lasts, the rest is white: n of them, LASTS long, have a mean of variance r + (1 - r)/n.
    """
    if len(t) < 2:
        return 1.0
    spacing = float(median(np.diff(t)))
    count = max(1.0, LASTS / spacing)
    share = _lasting_share(velocity_n[:, :2], standing, max(1, round(LATER / spacing)), spacing)
    return float(np.sqrt(1.0 + share * (count - 1.0)))


def _lasting_share(level: Array, standing: BoolArray, later: int, spacing: float) -> float:
    """Share of the variance of level velocities (N, 2) at rest that those `later` fixes on have in common."""
    stood = np.concatenate([[0], np.cumsum(standing)])
    throughout = np.flatnonzero(stood[later + 1 :] - stood[: -later - 1] == later + 1)
    pairs = level[throughout], level[throughout + later]
    known = np.all(np.isfinite(np.hstack(pairs)), axis=1)
    one, two = (values[known] for values in pairs)
    power = 0.5 * float(np.sum(one**2 + two**2))
    seconds = len(one) * spacing if power > 0.0 else 0.0
    shown = float(np.sum(one * two)) / power if power > 0.0 else 0.0
    share = (seconds * shown + USUAL_FOR * USUAL_SHARE) / (seconds + USUAL_FOR)
    return float(np.clip(share, 0.0, 1.0))
