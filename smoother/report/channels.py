"""Channels at other times than they were logged at: there are no values in gaps."""

import numpy as np

from smoother.arrays import Array, median
from smoother.samples import Channel

LONGEST = 2.5  # usual steps between two values, beyond which there is a gap
SLOWEST = 1.5  # s; shorter intervals are no gap in any channel


def channel_at(channel: Channel, t: Array) -> Array:
    """Values (M,) at times t (M,) s: between neighbours, of a gear or a switch the last one; NaN in gaps."""
    if len(channel.t) < 2:
        return np.full(t.shape, np.nan)
    steps = np.diff(channel.t)
    longest = max(LONGEST * median(steps), SLOWEST)
    after = np.clip(np.searchsorted(channel.t, t, side="right"), 1, len(channel.t) - 1)
    # distinct values of a gear or a switch, which is not interpolated
    is_step = np.unique(channel.values).size <= 12 and np.all(channel.values == np.round(channel.values))
    values = channel.values[np.where(t >= channel.t[-1], after, after - 1)] if is_step else None
    values = np.interp(t, channel.t, channel.values) if values is None else values
    known = (steps[after - 1] <= longest) & (t >= channel.t[0]) & (t <= channel.t[-1])
    return np.where(known, values, np.nan)
