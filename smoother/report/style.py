"""How the figures look: colours that colour-blind readers can tell apart, a clock on the time axis, thinned lines.

Everything here works on Figure and Axes objects; pyplot and its global state are never touched.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MultipleLocator, NullFormatter

from smoother.arrays import Array

# Okabe and Ito's palette; the estimators differ in line style and width as well
RAW, BASELINE, SMOOTHED, INK = "#8a8a8a", "#E69F00", "#0072B2", "#222222"
FIRST, SECOND, THIRD = "#0072B2", "#D55E00", "#009E73"
AXES_COLOURS = (FIRST, SECOND, THIRD)

STYLE: Any = {  # matplotlib types every key of it by name
    "font.family": "DejaVu Sans",  # comes with matplotlib, so every machine draws the same
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666666",
    "axes.labelcolor": INK,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.frameon": True,
    "legend.framealpha": 0.9,
    "legend.edgecolor": "none",
    "legend.fontsize": 9.0,
    "lines.linewidth": 1.2,
    "figure.facecolor": "white",
}
DOTS_PER_INCH = 130
LINE_POINTS = 4000  # more than any figure has pixels across
_TICK_STEPS = (0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400)  # s


def new_figure(title: str, width: float = 12.0, height: float = 7.2) -> Figure:
    """Return an empty figure, inches, under a heading that is never read as mathematics."""
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained")
    heading = figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold", color=INK)
    heading.set_parse_math(False)  # a session may be called $1$
    return figure


def clock_axis(axes: Axes, seconds: float) -> None:
    """Label the x axis of `seconds` length as minutes:seconds, or hours:minutes when it is long."""
    step = next((step for step in _TICK_STEPS if seconds / step <= 12), 6 * 3600)
    axes.xaxis.set_major_locator(MultipleLocator(step))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: clock(x, step)))
    axes.set_xlabel("time since the first fix (h:min:s)" if seconds >= 3600 else "time since the first fix (min:s)")


def logarithmic(axes: Axes) -> None:
    """Make the y axis logarithmic, labelled 0.1, 0.2, 0.5, 1 instead of with powers of ten."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(FixedLocator([m * 10.0**e for e in range(-4, 5) for m in (1, 2, 5)]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def clock(seconds: float, step: float = 1.0) -> str:
    """Return 1:05, or 1:01:05 beyond an hour, with tenths where the step needs them."""
    minutes, rest = divmod(max(seconds, 0.0) + 1e-9, 60.0)
    second = f"{rest:04.1f}" if step < 1.0 else f"{int(rest):02d}"
    if minutes < 60:
        return f"{int(minutes)}:{second}"
    return f"{int(minutes // 60)}:{int(minutes % 60):02d}:{second}"


def thinned(t: Array, *values: Array, points: int = LINE_POINTS) -> list[Array]:
    """Return t (N,) and each of values (N,) with at most about `points` rows, keeping every bin's extremes.

    Rows are those where the first of `values` is smallest and largest in its bin, so that no peak is lost; unknown
    rows stay unknown.
    """
    size = -(-2 * len(t) // points)
    if size <= 2:
        return [np.asarray(t), *values]
    whole = len(t) // size * size
    bins = values[0][:whole].reshape(-1, size)
    first = np.arange(len(bins)) * size
    known = np.isfinite(bins)
    low = first + np.argmin(np.where(known, bins, np.inf), axis=1)
    high = first + np.argmax(np.where(known, bins, -np.inf), axis=1)
    rows = np.unique(np.concatenate([low, high, np.arange(whole, len(t)), [0, len(t) - 1]]))
    return [np.asarray(t)[rows], *(value[rows] for value in values)]


def band(axes: Axes, t: Array, value: Array, sigma: Array, colour: str) -> None:
    """Draw value with a band of two sigma."""
    t_, value_, sigma_ = thinned(t, value, sigma)
    axes.fill_between(t_, value_ - 2 * sigma_, value_ + 2 * sigma_, color=colour, alpha=0.2, linewidth=0)


def broken_at_wraps(degrees: Array) -> Array:
    """Return angles with NaN where they jump across the half turn, so that no line is drawn through."""
    out = np.array(degrees)
    out[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    return out


def limits_around(values: Array, margin: float = 0.08, least: float = 0.0) -> tuple[float, float]:
    """Return axis limits around the known values, at least `least` apart."""
    known = values[np.isfinite(values)]
    if not known.size:
        return -1.0, 1.0
    low, high = float(np.min(known)), float(np.max(known))
    space = max(margin * (high - low), 0.5 * (least - (high - low)), 1e-9)
    return low - space, high + space


def coloured_line(axes: Axes, x: Array, y: Array, colour_by: Array, **style: Any) -> LineCollection:
    """Draw a line whose colour follows a third quantity (N,); return it for the colour bar."""
    rows = np.arange(0, len(x), max(1, len(x) // (2 * LINE_POINTS)))
    x, y, c = x[rows], y[rows], colour_by[rows]
    points = np.stack([x, y], axis=1)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    scale = Normalize(0.0, max(float(np.max(c[np.isfinite(c)], initial=0.0)), 1e-9))
    lines = LineCollection(list(segments), cmap="viridis", norm=scale, capstyle="round", **style)
    lines.set_array(c[:-1])
    axes.add_collection(lines)
    return lines


def outside_legend(axes: Axes, columns: int = 4) -> None:
    """Put the legend above the axes' right end, where it covers no data."""
    legend = axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.2)
    for handle in legend.legend_handles:
        if handle is not None:
            handle.set_alpha(1.0)
