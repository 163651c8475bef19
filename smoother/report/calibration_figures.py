"""The figures of a calibration: before and after, each drawn from the fit and the data that made it."""

from collections.abc import Callable, Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D

from smoother.arrays import Array, IntArray
from smoother.fit.allan import AllanDeviation, NoiseFigures
from smoother.fit.ellipsoid import Ellipsoid
from smoother.fit.gyro_bias import TemperatureFit
from smoother.fit.six_position import AccelFit
from smoother.fit.timing import Spectrum
from smoother.report import style
from smoother.units import DEG, STANDARD_GRAVITY

MOST_POINTS = 3000  # in a cloud
BEFORE, AFTER = "#D55E00", "#0072B2"
LETTERS = "xyz"


def draw(function: Callable[..., Figure], **data: Any) -> Figure:
    """Return the figure that a function of this module draws, in the common style."""
    with matplotlib.rc_context(style.STYLE):
        figure = function(**data)
        figure.canvas.draw()  # fonts and layout are settled while the style holds
        return figure


def ellipsoid(readings: Array, fit: Ellipsoid) -> Figure:
    """Readings (N, 3) with their ellipsoid in 3-D, and on the unit sphere after the calibration."""
    figure = style.new_figure("Magnetometer: before and after", 12.0, 6.2)
    shown = _spread_out(readings)
    used = fit.is_used[shown]
    back = np.linalg.inv(fit.to_unit_sphere)
    sphere = _sphere()
    panels = (
        ("as read", readings[shown], sphere @ back + fit.centre, fit.centre, BEFORE, " (units)"),
        ("calibrated", fit.apply(readings[shown]), sphere, np.zeros(3), AFTER, ""),
    )
    extent = float(np.max(fit.semi_axes))
    for i, (title, points, mesh, centre, colour, unit) in enumerate(panels):
        axes = figure.add_subplot(1, 2, i + 1, projection="3d")
        assert isinstance(axes, Axes3D)
        axes.plot_wireframe(*np.moveaxis(mesh, -1, 0), color="#999999", linewidth=0.5, alpha=0.6)
        axes.scatter(*points[used].T, s=5, color=colour, alpha=0.6, linewidth=0, label="readings")
        near = np.linalg.norm(points - centre, axis=1) < 2.0 * (extent if i == 0 else 1.0)
        if np.any(~used & near):
            axes.scatter(*points[~used & near].T, s=16, color=style.INK, marker="x", linewidth=0.8, label="left out")
        axes.scatter(0, 0, 0, s=60, marker="+", color=style.INK, label="zero")
        _cube(axes, np.vstack([mesh.reshape(-1, 3), np.zeros((1, 3))]))
        axes.set_title(title)
        for letter in LETTERS:
            getattr(axes, f"set_{letter}label")(f"m{letter}{unit}")
        axes.legend(loc="upper left")
    return figure


def _spread_out(readings: Array) -> IntArray:
    """Indices of at most MOST_POINTS readings, one per place: readings at rest must not dominate."""
    low, high = np.percentile(readings, [1.0, 99.0], axis=0)
    cell = np.round((readings - low) / max(float(np.max(high - low)), 1e-300) * 60.0)
    _, first = np.unique(cell, axis=0, return_index=True)
    return first[np.linspace(0, len(first) - 1, min(len(first), MOST_POINTS)).astype(np.int64)]


def _sphere() -> Array:
    turn, dip = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    return np.stack([np.sin(dip) * np.cos(turn), np.sin(dip) * np.sin(turn), np.cos(dip)], axis=-1)


def _cube(axes: Axes3D, points: Array) -> None:
    """Give all three axes the same scale."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.53 * float(np.max(high - low))
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_zlim(middle[2] - half, middle[2] + half)
    axes.set_box_aspect((1.0, 1.0, 1.0))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(5))


def positions(force: Array, fit: AccelFit) -> Figure:
    """Length of the mean force (K, 3) in each resting position, before and after."""
    figure = style.new_figure("Accelerometer: length of gravity in each resting position", 12.0, 6.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    number = np.arange(1, len(force) + 1)
    before = np.linalg.norm(force, axis=1) - STANDARD_GRAVITY
    upper.plot(number, before, "o", color=BEFORE, label="as read")
    upper.plot(number[fit.is_used], fit.residual[fit.is_used], "s", color=AFTER, label="calibrated")
    upper.set_ylabel("length less gravity (m/s²)")
    lower.plot(number[fit.is_used], 1000.0 * fit.residual[fit.is_used], "s", color=AFTER, label="calibrated, enlarged")
    lower.set_ylabel("length less gravity (mm/s²)")
    lower.set_xlabel("resting position")
    lower.set_xticks(number[:: max(1, len(number) // 20)])
    if not np.all(fit.is_used):
        upper.plot(number[~fit.is_used], fit.residual[~fit.is_used], "x", color=style.INK, label="left out")
    for axes in (upper, lower):
        axes.axhline(0.0, color=style.INK, linewidth=0.8)
        style.outside_legend(axes)
    return figure


def alignment(t: Array, before: Array, after: Array, gravity: float) -> Figure:
    """Accelerations (N, 3) at rest at t (N,) s, in sensor axes and rotated to north, west and up."""
    figure = style.new_figure("Level and heading: accelerations at rest before and after rotation", 12.0, 6.0)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, values, names, title in (
        (panels[0], before, ("x", "y", "z"), "in the axes of the sensor, as read"),
        (panels[1], after, ("north", "west", "up"), "calibrated and rotated"),
    ):
        for i in range(3):
            axes.plot(t, values[:, i], color=style.AXES_COLOURS[i], linewidth=0.8, label=names[i])
        axes.axhline(gravity, color=style.INK, linewidth=0.8, linestyle=":")
        axes.axhline(0.0, color=style.INK, linewidth=0.8, linestyle=":")
        axes.set_title(title)
        axes.set_xlabel("time (s)")
        style.outside_legend(axes)
    panels[0].set_ylabel("specific force (m/s²)")
    margin = 0.2 * gravity  # movements before and after the rest must not shrink the picture
    low = min(0.0, float(np.min(np.median(before, axis=0))), float(np.min(np.median(after, axis=0))))
    panels[0].set_ylim(low - margin, gravity + margin)
    return figure


def allan(curves: Mapping[str, AllanDeviation], figures: Mapping[str, NoiseFigures]) -> Figure:
    """Allan deviation of each sensor with error bars, and that of the identified noise parameters."""
    figure = style.new_figure("Noise at rest: Allan deviation (points) and the noise seen in it (lines)", 12.0, 6.2)
    for axes, (name, curve) in zip(figure.subplots(1, 2), curves.items(), strict=True):
        factor, unit = (1.0 / DEG, "deg/s") if name == "gyroscope" else (1.0, "m/s²")
        model = figures[name].allan_deviation(curve.tau, of_seen=True)
        for i in range(3):
            colour = style.AXES_COLOURS[i]
            value, sigma = factor * curve.deviation[:, i], factor * curve.sigma[:, i]
            axes.fill_between(
                curve.tau, np.maximum(value - sigma, 0.3 * value), value + sigma, color=colour, alpha=0.15, linewidth=0
            )
            axes.plot(curve.tau, value, "o", color=colour, markersize=3, label=LETTERS[i])
            axes.plot(curve.tau, factor * model[:, i], color=colour, linewidth=1.0)
        style.logarithmic(axes, "x")
        style.logarithmic(axes, "y")
        axes.set_title(name)
        axes.set_xlabel("averaging time (s)")
        axes.set_ylabel(f"Allan deviation ({unit})")
        style.outside_legend(axes)
    return figure


def spectrum(spectra: Mapping[str, Spectrum]) -> Figure:
    """Amplitude density of both sensors."""
    figure = style.new_figure("Vibration", 12.0, 5.2)
    for axes, (name, found) in zip(figure.subplots(1, 2), spectra.items(), strict=True):
        factor, unit = (1.0 / DEG, "deg/s/√Hz") if name == "gyroscope" else (1.0, "m/s²/√Hz")
        shown = found.frequency > 0.0
        for i in range(3):
            density = factor * np.sqrt(found.density[shown, i])
            axes.plot(found.frequency[shown], density, color=style.AXES_COLOURS[i], linewidth=0.9, label=LETTERS[i])
        style.logarithmic(axes)
        axes.set_title(name)
        axes.set_xlabel("frequency as sampled (Hz)")
        axes.set_ylabel(unit)
        style.outside_legend(axes)
    return figure


def temperature(temperature: Array, means: Array, fit: TemperatureFit) -> Figure:
    """Mean rates (B, 3) at rest over temperature (B,) deg C, with the fitted line, and the residuals."""
    figure = style.new_figure("Gyroscope: bias and temperature", 12.0, 5.2)
    panels = figure.subplots(1, 2)
    ends = np.array(fit.span)
    for i in range(3):
        colour = style.AXES_COLOURS[i]
        middle = fit.bias[i] / DEG
        panels[0].plot(
            temperature, means[:, i] / DEG - middle, ".", color=colour, label=f"{LETTERS[i]} less {middle:.3f}"
        )
        panels[0].plot(ends, fit.at(ends)[:, i] / DEG - middle, color=colour)
        panels[1].plot(
            temperature, (means[:, i] - fit.at(temperature)[:, i]) / DEG, ".", color=colour, label=LETTERS[i]
        )
    for axes, title in zip(panels, ("as read", "calibrated"), strict=True):
        axes.set_title(title)
        axes.set_xlabel("temperature (°C)")
        axes.set_ylabel("mean rate at rest (deg/s)")
        style.outside_legend(axes)
    return figure


FIGURES: Mapping[str, tuple[Callable[..., Figure], str]] = {
    "gyroscope bias": (temperature, "gyro_temperature"),
    "accelerometer": (positions, "accelerometer"),
    "magnetometer": (ellipsoid, "magnetometer"),
    "level and heading": (alignment, "level"),
    "noise at rest": (allan, "allan"),
    "timing and vibration": (spectrum, "spectrum"),
}
"""What each procedure's `drawing` is drawn by, and the name of the file."""
