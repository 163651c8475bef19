"""A step in a series of scattered values: did something move at some moment, and stay there?"""

import numpy as np

from smoother.arrays import Array


def largest_step(values: Array, fewest: int, block: int, significance: float) -> float:
    """Largest significant difference of the means of values (N,) before and after any row.

    Each side has at least `fewest` rows. It must stand out by `significance` sigma of the scatter that means over
    `block` rows have. Zero where nothing does, or where there are too few rows.
    """
    if values.size < 2 * fewest:
        return 0.0
    before = np.cumsum(values)[fewest - 1 : values.size - fewest]
    count = np.arange(fewest, values.size - fewest + 1)
    change = (values.sum() - before) / (values.size - count) - before / count
    at = int(np.argmax(np.abs(change)))
    n, largest = int(count[at]), float(np.abs(change[at]))
    rest = values - np.where(np.arange(values.size) < n, before[at] / n, before[at] / n + change[at])
    means = rest[: values.size // block * block].reshape(-1, block).mean(axis=1)
    sigma = np.std(means, ddof=2) * np.sqrt(block / n + block / (values.size - n))
    return largest if largest > significance * sigma else 0.0
