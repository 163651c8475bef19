"""The figures of a smoothed session: each function draws one matplotlib Figure, `save_figures` writes them all.

Only axis limits are computed here. Maps are north up, axes in metres; limits follow the smoothed trajectory, so that
outliers of the fixes or a diverged baseline do not shrink the picture.
"""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from smoother.arrays import Array
from smoother.report import style
from smoother.report.drawing import (
    Limits,
    Shown,
    draw_close_up,
    draw_line,
    draw_tracks,
    map_axes,
    map_limits,
    map_path,
    metres_a_pixel,
    time_axes,
    time_axis,
)
from smoother.report.files import replacing
from smoother.report.summary import fastest_row
from smoother.units import DEG, KMH, STANDARD_GRAVITY

MAIN_FIGURE = "overview"
CLOSE_UP_TIME = 30.0  # s shown in a close-up over time
TYPICAL_OVER = 1.0  # s, over which a sigma that swings between keyframes is shown as one
CELLS = 75  # along each side of the g-g diagram


def save_figures(shown: Shown, directory: Path, done: Callable[[float], None] | None = None) -> list[Path]:
    """Write every figure that the session has data for as PNG; return their paths, the main one first.

    `done` gets the share (0..1) that is finished. Figures of an earlier run that no longer apply are removed.
    """
    directory.mkdir(parents=True, exist_ok=True)
    written = []
    with matplotlib.rc_context(style.SETTLED), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # a name may be in any script
        for i, (name, draw) in enumerate(FIGURES.items()):
            path = directory / f"{name}.png"
            figure = draw(shown)
            if figure is None:
                path.unlink(missing_ok=True)
                continue
            with replacing(path) as temporary:
                style.save(figure, temporary)
            figure.clear()  # frees its memory
            written.append(path)
            if done is not None:
                done((i + 1) / len(FIGURES))
    return written


def overview(shown: Shown) -> Figure:
    """Map coloured by speed, a close-up of raw, baseline and smoothed, and speed over time."""
    figure = _figure(shown.heading, 13.0, 7.6)
    grid = style.panels(figure, 2, 2, width_ratios=[1.1, 1.0], height_ratios=[1.5, 1.0], between=0.95)
    left = grid[:, 0].subgridspec(2, 3, height_ratios=[40.0, 1.0], width_ratios=[1.0, 5.0, 1.0], hspace=0.2)
    whole, bar = figure.add_subplot(left[0, :]), figure.add_subplot(left[1, 1])
    close, speed_axes = (figure.add_subplot(grid[row, 1]) for row in (0, 1))
    step = 4.0 * metres_a_pixel(whole, *map_limits(shown))
    path = style.thinned_path(*map_path(shown.smoothed), shown.smoothed.speed / KMH, step=step)
    top, highest = float(shown.smoothed.speed[fastest_row(shown.smoothed)]) / KMH, float(np.max(path[2]))
    line = style.coloured_line(whole, *path, top=top, linewidth=1.8)
    map_axes(whole, *map_limits(shown))
    beyond: Literal["max", "neither"] = "max" if highest > top else "neither"
    figure.colorbar(line, cax=bar, orientation="horizontal", label="speed (km/h)", extend=beyond)
    whole.set_title("Smoothed track, coloured by speed")
    draw_close_up(close, whole, shown)
    _draw_speed(speed_axes, shown)
    speed_axes.set_title("Speed")
    style.outside_legend(speed_axes)
    return figure


def track(shown: Shown) -> Figure:
    """The whole track and a close-up, each with raw fixes, baseline and smoothed."""
    figure = _figure(f"Track: {shown.heading}", 13.0, 7.0)
    grid = style.panels(figure, 1, 2)
    whole, close = (figure.add_subplot(grid[0, column]) for column in (0, 1))
    draw_tracks(whole, shown, 2.0, map_limits(shown))
    whole.set_title("Whole session")
    draw_close_up(close, whole, shown)
    return figure


def speed(shown: Shown) -> Figure:
    """Speed over the session, and half a minute of it with its sigma."""
    figure = _figure(f"Speed: {shown.heading}", 12.0, 7.2)
    grid = style.panels(figure, 2, between=0.95)
    whole, close = (figure.add_subplot(grid[row, 0]) for row in (0, 1))
    _draw_speed(whole, shown)
    whole.set_title("Whole session")
    style.outside_legend(whole)
    near = _near_fastest(shown)
    _draw_speed(close, shown, near)
    if shown.smoothed.sigmas is not None:
        rows = slice(*np.searchsorted(shown.smoothed.t, near))
        t, sigmas = shown.smoothed.t[rows] - shown.start, shown.smoothed.sigmas.speed[rows] / KMH
        style.band(close, t, shown.smoothed.speed[rows] / KMH, sigmas, style.SMOOTHED)
    close.set_title(f"{CLOSE_UP_TIME:.0f} s around the top speed, band: two sigma")
    return figure


def attitude(shown: Shown) -> Figure | None:
    """Roll, pitch and yaw with two sigma, and the baseline's."""
    if not shown.has_attitude:
        return None
    figure = _figure(f"Attitude: {shown.heading}", 12.0, 8.0)
    rows = style.rows(figure, 3, left=1.05)
    labels = ("roll (deg)\nright side down +", "pitch (deg)\nnose down +", "yaw (deg)\nfrom north, left +")
    angles = shown.smoothed.euler / DEG
    limits = [style.limits_around(_with_band(shown, i), 0.1, least=20.0) for i in range(2)] + [(-190.0, 190.0)]
    baseline = _off_the_scale(shown, limits)
    for i, (axes, label) in enumerate(zip(rows, labels, strict=True)):
        if shown.baseline is not None:
            degrees = shown.baseline.euler[:, i] / DEG
            draw_line(axes, shown, shown.baseline, degrees, baseline, style.BASELINE, width=0.7, wraps=True)
        draw_line(axes, shown, shown.smoothed, angles[:, i], "smoothed", style.SMOOTHED, wraps=True)
        if shown.smoothed.sigmas is not None:
            sigma = shown.smoothed.sigmas.attitude[:, i] / DEG
            style.band(axes, shown.smoothed.t - shown.start, style.broken_at_wraps(angles[:, i]), sigma, style.SMOOTHED)
        axes.set_ylabel(label)
        axes.set_ylim(limits[i])
    rows[2].set(yticks=[-180, -90, 0, 90, 180])
    rows[0].set_title("Band: two sigma")
    style.outside_legend(rows[0])
    time_axes(rows, shown)
    return figure


def _with_band(shown: Shown, i: int) -> Array:
    """Roll (0) or pitch (1) of the smoother (N,) deg with both edges of its band, (3 N,)."""
    angle, sigmas = shown.smoothed.euler[:, i] / DEG, shown.smoothed.sigmas
    # deg, one sigma; beyond it a band of attitudes does not widen its axes
    sigma = np.zeros(len(angle)) if sigmas is None else np.minimum(sigmas.attitude[:, i] / DEG, 15.0)
    return np.concatenate([angle, angle - 2.0 * sigma, angle + 2.0 * sigma])


def _off_the_scale(shown: Shown, limits: list[Limits]) -> str:
    """Name of the baseline in the legend of attitudes, which says so where it leaves the limits."""
    if shown.baseline is None:
        return ""
    angles = shown.baseline.euler / DEG
    is_off = any(np.any((angle < low) | (angle > high)) for angle, (low, high) in zip(angles.T, limits, strict=True))
    return "baseline, in places off the scale" if is_off else "baseline"


def accelerations(shown: Shown) -> Figure | None:
    """Forward, left and up acceleration over time in g, and the g-g diagram."""
    if not shown.has_attitude:
        return None
    figure = _figure(f"Accelerations of the kart, gravity removed: {shown.heading}", 13.0, 7.2)
    grid = style.panels(figure, 3, 2, width_ratios=[1.9, 1.0], left=0.95)
    acceleration = shown.smoothed.acceleration_b / STANDARD_GRAVITY
    limit, limit_up = (_limit_of_most(acceleration[:, axes]) for axes in ([0, 1], [2]))
    for i, label in enumerate(("forward (g)\nbraking -", "left (g)\nright turn -", "up (g)")):
        axes = figure.add_subplot(grid[i, 0])
        draw_line(axes, shown, shown.smoothed, acceleration[:, i], "smoothed", style.AXES_COLOURS[i], width=0.8)
        axes.set_ylabel(label)
        reach = limit if i < 2 else limit_up
        axes.set_ylim(-reach, reach)
        beyond = np.nanmax(np.abs(acceleration[:, i]), initial=0.0)
        if beyond > reach:
            axes.text(0.995, 0.97, f"spikes go on to {beyond:.2g} g", transform=axes.transAxes, **style.REMARK)
        time_axis(axes, shown, is_labelled=i == 2)
    circle = figure.add_subplot(grid[:, 1])
    known = np.isfinite(acceleration).all(axis=1)
    seen = np.histogramdd(acceleration[known, :2] * [1.0, -1.0], bins=CELLS, range=[(-limit, limit)] * 2)[0]
    shade = np.log10(np.where(seen > 0.0, seen, np.nan))
    circle.imshow(shade, cmap="cividis", origin="lower", extent=(-limit, limit, -limit, limit), zorder=1)
    circle.set(
        xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal", xlabel="to the right (g)", ylabel="forward (g)"
    )
    circle.set_title("g-g diagram, brighter: more often")
    return figure


def biases(shown: Shown) -> Figure | None:
    """Biases of accelerometer and gyroscope over time, with two sigma, in the sensor's own axes."""
    keyframes = shown.smoothed.report.keyframes
    if keyframes is None or not np.isfinite(keyframes.gyro_bias_s).any():
        return None
    figure = _figure(f"Sensor biases found, in the sensor's own axes: {shown.heading}", 12.0, 7.6)
    grid = style.panels(figure, 3, 2, left=1.0, beside=1.0)  # for ticks as long as -0.075
    t = keyframes.t - shown.start
    sensors = (
        ("Accelerometer (m/s²), band: two sigma", keyframes.accel_bias_s, keyframes.sigma_accel_bias, 1.0),
        ("Gyroscope (deg/s), band: two sigma", keyframes.gyro_bias_s, keyframes.sigma_gyro_bias, DEG),
    )
    for column, (title, bias, sigma, unit) in enumerate(sensors):
        for i, name in enumerate("xyz"):
            axes = figure.add_subplot(grid[i, column])
            axes.plot(*style.thinned(t, bias[:, i] / unit, points=2 * style.pixels(axes)), color=style.AXES_COLOURS[i])
            style.band(axes, t, bias[:, i] / unit, sigma[:, i] / unit, style.AXES_COLOURS[i])
            axes.set_ylabel(name)
            axes.set_title(title if i == 0 else "")
            time_axis(axes, shown, is_labelled=i == 2)
    return figure


def residuals(shown: Shown) -> Figure | None:
    """Residual of every fix without latency and slow offset, over time and as a distribution."""
    fixes = shown.smoothed.report.fixes
    if fixes is None or not len(fixes.index):
        return None
    figure = _figure(f"What the smoother expected minus each fix: {shown.heading}", 12.0, 8.0)
    rows = style.rows(figure, 3, left=0.9, right=2.1)
    t = shown.session.gnss.t[fixes.index] - shown.start
    down = fixes.weight < 0.5
    for i, name in enumerate(("north", "west", "up")):
        residual = fixes.residual_n[:, i]
        known = np.abs(residual[np.isfinite(residual) & ~down])
        limit = 1.6 * float(np.percentile(known, 99)) + 0.1 if known.size else 1.0
        axes = rows[i]
        shown_residual = np.clip(residual, -limit, limit)  # what lies beyond is drawn at the border
        axes.plot(t[~down], shown_residual[~down], ".", markersize=2.5, color=style.SMOOTHED, label="fix")
        axes.plot(t[down], shown_residual[down], "x", markersize=5, color=style.SECOND, label="fix given little weight")
        axes.set_ylabel(f"{name} (m)")
        axes.set_ylim(-1.05 * limit, 1.05 * limit)
        kept = np.clip(residual[~down & np.isfinite(residual)], -limit, limit)
        _distribution_beside(axes, *np.histogram(kept, bins=40, range=(-limit, limit)))
    rows[0].set_title("distribution", x=1.03)
    style.outside_legend(rows[0])
    time_axes(rows, shown)
    return figure


def sigma(shown: Shown) -> Figure | None:
    """The standard deviations the smoother reports, on logarithmic axes."""
    sigmas = shown.smoothed.sigmas
    if sigmas is None:
        return None
    figure = _figure(f"Uncertainty (one sigma): {shown.heading}", 12.0, 8.0)
    t = shown.smoothed.t - shown.start
    horizontal = np.hypot(sigmas.position_n[:, 0], sigmas.position_n[:, 1])

    def typical(values: Array) -> Array:
        """Running median of a sigma, which oscillates between keyframes."""
        return style.running_median(shown.smoothed.t, values, seconds=TYPICAL_OVER)

    groups = {
        "position (m)": {
            "horizontal": horizontal,
            "up": sigmas.position_n[:, 2],
            f"line on the track (median over {TYPICAL_OVER:g} s)": typical(sigmas.track),
        },
        f"velocity (km/h),\nmedian over {TYPICAL_OVER:g} s": {
            "speed": typical(sigmas.speed / KMH),
            "north": typical(sigmas.velocity_n[:, 0] / KMH),
            "west": typical(sigmas.velocity_n[:, 1] / KMH),
        },
        "attitude (deg)": dict(zip(("roll", "pitch", "yaw"), sigmas.attitude.T / DEG, strict=True)),
    }
    groups = {
        label: lines for label, lines in groups.items() if any(np.isfinite(line).any() for line in lines.values())
    }
    rows = style.rows(figure, len(groups), between=0.42, left=1.0)
    for axes, (label, lines) in zip(rows, groups.items(), strict=True):
        for colour, (name, values) in zip(style.AXES_COLOURS, lines.items(), strict=True):
            axes.plot(*style.thinned(t, values, points=2 * style.pixels(axes)), color=colour, label=name)
        style.logarithmic(axes)
        axes.set_ylabel(label)
        style.outside_legend(axes)
    time_axes(rows, shown)
    return figure


FIGURES: dict[str, Callable[[Shown], Figure | None]] = {
    MAIN_FIGURE: overview,
    "track": track,
    "speed": speed,
    "attitude": attitude,
    "accelerations": accelerations,
    "biases": biases,
    "residuals": residuals,
    "sigma": sigma,
}


def _distribution_beside(axes: Axes, counts: Array, edges: Array) -> None:
    """Draw a histogram of the values, lying, to the right of the axes."""
    reach = np.concatenate([[0.0], counts, [0.0]]) / max(1.0, float(np.max(counts)))
    outline = np.stack([1.03 + 0.16 * np.repeat(reach, 2)[1:-1], np.repeat(edges, 2)], axis=1)
    axes.add_patch(
        Polygon(outline, transform=axes.get_yaxis_transform(), clip_on=False, color=style.SMOOTHED, linewidth=0)
    )


def _figure(title: str, width: float, height: float) -> Figure:
    return style.new_figure(title, width, height, is_laid_out=False)


def _limit_of_most(values: Array) -> float:
    """Symmetric axis limit that leaves out isolated high spikes."""
    known = np.abs(values[np.isfinite(values)])
    if not known.size:
        return 1.0
    limit, highest = 1.2 * float(np.percentile(known, 99.8)) + 0.05, float(np.max(known))
    # times a limit, up to which it rather widens than cuts
    return max(limit, 1.05 * highest) if highest < 1.5 * limit else limit


def _draw_speed(axes: Axes, shown: Shown, part: tuple[float, float] | None = None) -> None:
    """Draw the speed over the session, or over the part between two times."""
    window = part or (shown.start, shown.start + shown.seconds)
    fixes = shown.session.gnss
    here = slice(*np.searchsorted(fixes.t, window))
    raw = np.hypot(fixes.velocity_n[here, 0], fixes.velocity_n[here, 1])
    if np.isfinite(raw).any():  # else the legend would name an empty line
        size = 2.5 if len(raw) < 5000 else 1.0  # beyond it their dots are drawn smaller
        axes.plot(fixes.t[here] - shown.start, raw / KMH, ".", markersize=size, color=style.RAW, label="GPS")
    if shown.baseline is not None:
        draw_line(
            axes, shown, shown.baseline, shown.baseline.speed / KMH, "baseline", style.BASELINE, line="--", part=part
        )
    draw_line(axes, shown, shown.smoothed, shown.smoothed.speed / KMH, "smoothed", style.SMOOTHED, part=part)
    axes.set_ylabel("speed (km/h)")
    top = float(shown.smoothed.speed[fastest_row(shown.smoothed)]) / KMH
    axes.set_ylim(-0.03 * top, 1.12 * top + 1.0)
    axes.set_xlim(window[0] - shown.start, window[1] - shown.start)
    style.clock_axis(axes, window[1] - window[0])


def _near_fastest(shown: Shown) -> tuple[float, float]:
    """Times (s) around the top speed."""
    t = shown.smoothed.t
    middle = float(t[fastest_row(shown.smoothed)])
    first = float(np.clip(middle - 0.5 * CLOSE_UP_TIME, t[0], max(t[-1] - CLOSE_UP_TIME, t[0])))
    return first, first + min(CLOSE_UP_TIME, shown.seconds)
