"""Style of the figures: colours for colour-blind readers, a clock on the time axis, thinned lines.

Everything here works on Figure and Axes objects; pyplot and its global state are never touched.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import AutoLocator, FixedLocator, FuncFormatter, MaxNLocator, MultipleLocator, NullLocator
from matplotlib.transforms import ScaledTranslation
from PIL import Image
from scipy.ndimage import median_filter

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
    "axes.titley": 1.0,  # there; else every label above the axes is measured first
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
DOTS_PER_INCH = 110
_TICK_STEPS = (0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400)  # s
SHADES = 48  # of a coloured line; more are not distinguishable
_DECADES = range(-8, 6)
GRID: Any = {"colors": "#dddddd", "linewidths": 0.6, "zorder": 0.5}
SETTLED: Any = STYLE | {"axes.grid": False}  # where :func:`save` draws the grid
X_LABELS: Any = {"ha": "center", "va": "top", "color": "#444444"}
Y_LABELS: Any = {"ha": "right", "va": "center_baseline", "color": "#444444"}
REMARK: Any = {
    "ha": "right",
    "va": "top",
    "fontsize": 8.5,
    "color": "#444444",
    "bbox": {"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1.5},
    "zorder": 5,
}
MARGINS = {"left": 0.8, "right": 0.2, "top": 0.72, "bottom": 0.6}  # inches, for labels of one line


def new_figure(title: str, width: float = 12.0, height: float = 7.2, *, is_laid_out: bool = True) -> Figure:
    """Return an empty figure, inches, under a heading that is never read as mathematics.

    is_laid_out: matplotlib finds room for all labels, which costs as much as drawing twice; else see :func:`panels`.
    """
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained" if is_laid_out else None)
    y = {} if is_laid_out else {"y": 1.0 - 0.1 / height, "va": "top"}
    # 13 points, or fewer for a long name: a letter is 0.6 of its size wide on average
    size = min(13.0, 72.0 * (width - 0.3) / (0.6 * max(len(title), 1)))
    heading = figure.suptitle(title, x=0.01, ha="left", fontsize=size, fontweight="bold", color=INK, **y)
    heading.set_parse_math(False)  # a session may be called $1$
    return figure


def panels(
    figure: Figure, rows: int = 1, columns: int = 1, *, between: float = 0.2, beside: float = 0.85, **more: Any
) -> GridSpec:
    """Return a grid of `rows` and `columns` with room for heading, titles and labels around it.

    between, beside: inches between rows and between columns. more: margins in inches (left, right, top, bottom), and
    what GridSpec takes (width_ratios, height_ratios).
    """
    width, height = figure.get_size_inches()
    margin = {side: more.pop(side, usual) for side, usual in MARGINS.items()}
    inside = width - margin["left"] - margin["right"], height - margin["top"] - margin["bottom"]
    return figure.add_gridspec(
        rows,
        columns,
        left=margin["left"] / width,
        right=1.0 - margin["right"] / width,
        bottom=margin["bottom"] / height,
        top=1.0 - margin["top"] / height,
        wspace=beside / ((inside[0] - (columns - 1) * beside) / columns),
        hspace=between / ((inside[1] - (rows - 1) * between) / rows),
        **more,
    )


def rows(figure: Figure, count: int, **more: Any) -> list[Axes]:
    """Return axes one above the other; `more` as for :func:`panels`."""
    grid = panels(figure, count, **more)
    return [figure.add_subplot(grid[row, 0]) for row in range(count)]


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG. Its axes are final then."""
    for axes in figure.axes:
        if not hasattr(axes, "_colorbar"):
            _settle(axes)
    _align_labels(figure)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba()))  # type: ignore[no-untyped-call]
    # of PNG; 6 costs twice the time for a tenth of the size
    drawn.convert("RGB").save(path, format="png", compress_level=2, dpi=(figure.dpi, figure.dpi))


def _align_labels(figure: Figure) -> None:
    """Put the labels of y axes that stand above one another as far out as the one with the longest figures."""
    columns: dict[float, list[Axes]] = {}
    for axes in figure.axes:
        if axes.get_ylabel():
            columns.setdefault(round(axes.get_position().x0, 3), []).append(axes)
    for column in columns.values():
        farthest = max(axes.yaxis.labelpad for axes in column)
        for axes in column:
            axes.yaxis.labelpad = farthest


def _settle(axes: Axes) -> None:
    """Put lines and texts where the ticks are: matplotlib's ticks cost more than all else that a figure shows."""
    axes.apply_aspect()
    for axis, is_x in ((axes.xaxis, True), (axes.yaxis, False)):
        if isinstance(axis.get_major_locator(), AutoLocator):
            axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))  # along an axis
        low, high = sorted(axis.get_view_interval())
        ticks = np.array([tick for tick in axis.get_majorticklocs() if low <= tick <= high])
        labels = axis.get_major_formatter().format_ticks(list(ticks))
        across = axes.get_xaxis_transform() if is_x else axes.get_yaxis_transform()
        ends = [[(tick, 0.0), (tick, 1.0)] if is_x else [(0.0, tick), (1.0, tick)] for tick in ticks]
        axes.add_collection(LineCollection(ends, transform=across, **GRID), autolim=False)
        if axis.get_tick_params().get("labelbottom" if is_x else "labelleft", True):
            aside = (0.0, -0.06) if is_x else (-0.06, 0.0)  # inches
            style: Any = X_LABELS if is_x else Y_LABELS
            style = style | {"transform": across + ScaledTranslation(*aside, axes.figure.dpi_scale_trans)}
            for tick, label in zip(ticks, labels, strict=True):
                axes.text(tick if is_x else 0.0, 0.0 if is_x else tick, label, **style)
            axis.labelpad = 20.0 if is_x else 8.0 + 6.5 * max(map(len, labels), default=0)  # points
        axis.set_major_locator(NullLocator())


def clock_axis(axes: Axes, seconds: float) -> None:
    """Label the x axis of `seconds` length as minutes:seconds, hours:minutes:seconds, or hours when it is very long."""
    step = next((step for step in _TICK_STEPS if seconds / step <= 8), 6 * 3600)
    axes.xaxis.set_major_locator(MultipleLocator(step))
    if step >= 3600:
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x / 3600:.0f}"))
        axes.set_xlabel("time since the first fix (h)")
        return
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: clock(x, step)))
    axes.set_xlabel("time since the first fix (h:min:s)" if seconds >= 3600 else "time since the first fix (min:s)")


def logarithmic(axes: Axes, name: Literal["x", "y"] = "y") -> None:
    """Make an axis logarithmic, labelled 0.1, 0.2, 0.5, 1 instead of with powers of ten; a long one 0.1, 1, 10."""
    axes.set(**{f"{name}scale": "log"})
    axis = axes.xaxis if name == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    # the finer ones where hardly any of the others is in view
    for steps, enough in (((1,), 5), ((1, 2, 5), 3), ((1, 1.5, 2, 3, 4, 5, 6, 8), 0)):
        ticks = [m * 10.0**e for e in _DECADES for m in steps if low <= m * 10.0**e <= high]
        if len(ticks) >= enough:
            break
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FuncFormatter(lambda value, _: np.format_float_positional(value, precision=9, trim="-")))
    axis.set_minor_locator(NullLocator())


def clock(seconds: float, step: float = 1.0) -> str:
    """Return 1:05, or 1:01:05 beyond an hour, with tenths where the step needs them."""
    minutes, rest = divmod(max(seconds, 0.0) + 1e-9, 60.0)
    second = f"{rest:04.1f}" if step < 1.0 else f"{int(rest):02d}"
    if minutes < 60:
        return f"{int(minutes)}:{second}"
    return f"{int(minutes // 60)}:{int(minutes % 60):02d}:{second}"


def pixels(axes: Axes) -> int:
    """Width of axes that are not moved any more."""
    return max(1, round(axes.get_window_extent().width))


def thinned(t: Array, *values: Array, points: int) -> list[Array]:
    """Return t (N,) and each of values (N,) with at most about `points` rows, keeping every bin's extremes.

    Rows are those where the first of `values` is smallest and largest in its bin, so that no peak is lost; unknown
    rows stay unknown. Two points to a pixel look like all of them.
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


def running_median(t: Array, values: Array, *, seconds: float) -> Array:
    """Return the median of values (N,) over `seconds` around each of t (N,) s, or values where some are unknown."""
    size = round(seconds / float(np.median(np.diff(t)))) if len(t) > 1 else 1
    if size < 2 or not np.isfinite(values).all():
        return values
    return np.asarray(median_filter(values, (min(size, len(t)) - 1) | 1, mode="nearest"))


def thinned_path(x: Array, y: Array, *values: Array, step: float) -> list[Array]:
    """Return x, y (N,) and each of values (N,) at rows about `step` apart, or as far as they are; ends are kept."""
    if not len(x):
        return [x, y, *values]
    way = np.concatenate([[0.0], np.cumsum(np.nan_to_num(np.hypot(np.diff(x), np.diff(y)), nan=step))])
    rows = np.flatnonzero(np.diff(np.floor(way / step), prepend=-1.0, append=np.inf)[:-1] > 0.0)
    rows = np.unique(np.append(rows, len(x) - 1))
    return [x[rows], y[rows], *(value[rows] for value in values)]


def band(axes: Axes, t: Array, value: Array, sigma: Array, colour: str) -> None:
    """Draw value with a band of two sigma."""
    t_, value_, sigma_ = thinned(t, value, sigma, points=pixels(axes))
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


def coloured_line(
    axes: Axes, x: Array, y: Array, colour_by: Array, *, top: float | None = None, **style: Any
) -> LineCollection:
    """Draw a line whose colour follows a third quantity (N,); return it for the colour bar.

    top : where the scale ends, the highest value if None; what is higher has the colour of the top.
    """
    highest = float(np.max(colour_by[np.isfinite(colour_by)], initial=0.0))
    top = max(highest if top is None else top, 1e-9)
    shade = np.floor(np.minimum(np.nan_to_num(colour_by[:-1]) / top, 1.0) * SHADES)
    first = np.flatnonzero(np.diff(shade, prepend=-1.0))
    points = np.stack([x, y], axis=1)
    parts = [points[i : j + 1] for i, j in zip(first, np.append(first[1:], len(shade)), strict=True)]
    lines = LineCollection(parts, cmap="viridis", norm=Normalize(0.0, top), capstyle="round", **style)
    lines.set_array((shade[first] + 0.5) * top / SHADES)
    axes.add_collection(lines)
    return lines


def outside_legend(axes: Axes, columns: int = 4) -> None:
    """Put the legend above the axes' right end, where it covers no data."""
    legend = axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.2)
    for handle in legend.legend_handles:
        if handle is not None:
            handle.set_alpha(1.0)
