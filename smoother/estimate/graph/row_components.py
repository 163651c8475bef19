"""What a solution leaves of measurements: squared residuals beside what is expected of them."""

from dataclasses import dataclass

from smoother.arrays import Array


@dataclass(frozen=True, eq=False)
class RowComponent:
    """Squared residuals of rows over their variances, and what is expected of them, each (N, r); 0 where unknown."""

    squares: Array
    expected: Array
