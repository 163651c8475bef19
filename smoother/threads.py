"""Threads that libraries start by themselves, which one session has no use for.

Its matrices are small and many. The threads of a linear algebra library wait for them at full speed: on two cores 1.1 s
of processor time beside the 1.6 s of work on ten minutes of driving, and nothing is done sooner.
"""

import os
from collections.abc import MutableMapping

VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "POLARS_MAX_THREADS",
)
"""What the libraries read when they are imported: numpy's linear algebra, by who built it, and polars."""


def start_none(surroundings: MutableMapping[str, str] = os.environ) -> None:
    """Set one thread for libraries that are not imported yet, where the environment sets no other number."""
    for name in VARIABLES:
        surroundings.setdefault(name, "1")
