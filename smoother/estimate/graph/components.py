"""The noise of a session from its residuals: variance components, one step towards the restricted likelihood's maximum.

Each source of noise answers for a part of the squared residuals, of which a certain number is expected: the ratio says
by how much it was taken too small or too large. Two that the residuals hardly tell apart are brought there together.
"""

from smoother.arrays import Array
from smoother.estimate.gnss_offset import OffsetModel, unseen_variance
from smoother.estimate.graph.inputs import Noise

SMALLEST_POSITION = 0.02  # m; a digit of latitude is worth about this
OWN_SCATTER = 0.3  # of the scatter between bins: the noise that moves the path is not far below what is seen


def unseen_offset(noise: Noise, population: Array, n_fixes: int, hidden: float = 0.0) -> Array:
    """Variance (3,) m^2 of the GPS offset beyond what the session shows, see :func:`unseen_variance`."""
    offset = OffsetModel(noise.offset_sigma, noise.offset_tau, noise.offset_tau_spread)
    return unseen_variance(offset, float(noise.position[0]), population, n_fixes, hidden)
