"""What numbers a figure of a simulation may be: no sigma is negative, and none is no number."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from smoother.errors import UsageError


def require_figures(figures: Any, group: str, not_negative: Sequence[str] = (), above_zero: Sequence[str] = ()) -> None:
    """Raise UsageError with the first figure of a dataclass that is no number, or below what it can be.

    group : what stands before the names on the command line, "" for none. None and all that is no float is passed over;
    only a figure that has no bound may be infinite.
    """
    prefix = f"{group}." if group else ""
    for field in dataclasses.fields(figures):
        value, name = getattr(figures, field.name), f"{prefix}{field.name}"
        if not isinstance(value, float | int) or isinstance(value, bool):
            continue
        if field.name in above_zero and not 0.0 < value < math.inf:
            raise UsageError(f"{name} is {value:g}; it has to be a number above 0")
        if field.name in not_negative and not 0.0 <= value < math.inf:
            raise UsageError(f"{name} is {value:g}; it has to be a number of 0 or more")
        if math.isnan(value):
            raise UsageError(f"{name} is nan; it has to be a number")
