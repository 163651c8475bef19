"""What the figures of a session share: their data, maps with north up, and lines over the time of the session."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from smoother.arrays import Array
from smoother.frames import to_left
from smoother.report import style
from smoother.samples import Session
from smoother.trajectory import Trajectory

Limits = tuple[float, float]  # of an axis, or of time
CORNER_TIME = 4.0  # s that a close-up of a corner covers
PASS_TIME = 16.0  # s drawn around its middle: one pass, never the next lap
LEAST_SPEED = 2.0  # m/s; slower rows are not searched for a corner


@dataclass(frozen=True, eq=False)
class Shown:
    """Data of the figures; `heading` is the line above each of them."""

    session: Session
    smoothed: Trajectory
    baseline: Trajectory | None
    heading: str

    @property
    def start(self) -> float:
        """Time of the first row, where the clock of the figures is zero."""
        return float(self.smoothed.t[0])

    @property
    def seconds(self) -> float:
        """Length of the session."""
        return max(float(self.smoothed.t[-1] - self.smoothed.t[0]), 1e-3)

    @property
    def has_attitude(self) -> bool:
        """False for a session without usable samples."""
        return bool(np.isfinite(self.smoothed.R_nb).any())


def map_path(trajectory: Trajectory) -> tuple[Array, Array]:
    """East and north (m), for a map with north up."""
    return -trajectory.position_n[:, 1], trajectory.position_n[:, 0]


def map_limits(shown: Shown) -> tuple[Limits, Limits]:
    """What a map shows in x and y: all of the smoothed path."""
    x, y = map_path(shown.smoothed)
    return style.limits_around(x, least=20.0), style.limits_around(y, least=20.0)


def map_axes(axes: Axes, x_limits: Limits, y_limits: Limits) -> None:
    """Show at least these limits, more of one of them where the space on the page allows it."""
    axes.set_xlim(x_limits, auto=True)  # auto: matplotlib may widen the limits to make metres alike
    axes.set_ylim(y_limits, auto=True)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="east (m)", ylabel="north (m)")


def metres_a_pixel(axes: Axes, x_limits: Limits, y_limits: Limits) -> float:
    """How much of a map within these limits one pixel shows."""
    box = axes.get_window_extent()
    return max((x_limits[1] - x_limits[0]) / box.width, (y_limits[1] - y_limits[0]) / box.height)


def draw_tracks(
    axes: Axes, shown: Shown, size: float, limits: tuple[Limits, Limits], window: Limits = (-np.inf, np.inf)
) -> None:
    """Draw fixes, baseline and smoothed path within limits of place and of time."""
    step = metres_a_pixel(axes, *limits)

    def within(t: Array, x: Array, y: Array) -> list[Array]:
        i, j = np.searchsorted(t, window)
        return style.thinned_path(x[i:j], y[i:j], step=step)

    fixes_n, baseline, smoothed = shown.session.fix_position_n, shown.baseline, shown.smoothed
    fixes = within(shown.session.gnss.t, -fixes_n[:, 1], fixes_n[:, 0])
    axes.plot(*fixes, "o:", markersize=size, linewidth=0.4 * size - 0.6, mew=0, color=style.RAW, label="GPS fixes")
    if baseline is not None:
        path = within(baseline.t, *map_path(baseline))
        axes.plot(*path, "--", linewidth=1.0, color=style.BASELINE, label="baseline")
    axes.plot(*within(smoothed.t, *map_path(smoothed)), linewidth=1.6, color=style.SMOOTHED, label="smoothed")
    map_axes(axes, *limits)


def draw_close_up(axes: Axes, whole: Axes, shown: Shown) -> None:
    """Draw one pass of the tightest corner with the legend above it, and its frame on the map of the whole."""
    t, (x, y) = shown.smoothed.t, map_path(shown.smoothed)
    middle = float(t[_tightest(shown.smoothed)])
    corner = np.abs(t - middle) <= 0.5 * CORNER_TIME
    # a close-up is at least 20 m wide
    x_limits, y_limits = (style.limits_around(line[corner], 0.15, least=20.0) for line in (x, y))
    draw_tracks(axes, shown, 4.5, (x_limits, y_limits), (middle - 0.5 * PASS_TIME, middle + 0.5 * PASS_TIME))
    axes.set_title(f"Corner at {style.clock(middle - shown.start)}")
    style.outside_legend(axes)
    axes.apply_aspect()  # widens the limits until metres are alike: the frame is of what is seen
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    frame = Rectangle((left, bottom), right - left, top - bottom, fill=False, edgecolor=style.INK, linewidth=1.0)
    whole.add_patch(frame)
    whole.set_xlim(_holding(whole.get_xlim(), left, right), auto=True)
    whole.set_ylim(_holding(whole.get_ylim(), bottom, top), auto=True)


def _holding(limits: Limits, low: float, high: float) -> Limits:
    """The limits, extended to contain a frame with a margin."""
    space = 0.02 * (limits[1] - limits[0])
    return min(limits[0], low - space), max(limits[1], high + space)


def _tightest(trajectory: Trajectory) -> int:
    """Row of the largest turn rate of the path at speed, else the middle one."""
    velocity = trajectory.velocity_n[:, :2]
    duration = max(float(trajectory.t[-1] - trajectory.t[0]), 0.1)
    step = max(1, round(0.5 * len(trajectory) / duration))  # half a second
    if len(trajectory) <= 2 * step:
        return len(trajectory) // 2
    before, here, after = velocity[: -2 * step], velocity[step:-step], velocity[2 * step :]
    course_change = np.abs(np.arctan2(*_turn(before, after)))
    speed = np.hypot(here[:, 0], here[:, 1])
    driven = (
        # of the usual speed; the way into the pits is no corner
        speed > 0.5 * np.median(speed[speed > LEAST_SPEED]) if np.any(speed > LEAST_SPEED) else speed < 0.0
    )
    turning = np.where(driven & np.isfinite(course_change), course_change, 0.0)
    return step + int(np.argmax(turning))


def _turn(a: Array, b: Array) -> tuple[Array, Array]:
    """Sine and cosine, times both lengths, of the angle from a to b, each (N, 2)."""
    return to_left(a, b), np.sum(a * b, axis=1)


def draw_line(
    axes: Axes,
    shown: Shown,
    trajectory: Trajectory,
    values: Array,
    label: str,
    colour: str,
    *,
    line: str = "-",
    width: float = 1.2,
    wraps: bool = False,
    part: tuple[float, float] | None = None,
) -> None:
    """Draw values (N,) of a trajectory over time, thinned to the pixels; wraps: an angle (deg), broken at its jumps."""
    rows = slice(None) if part is None else slice(*np.searchsorted(trajectory.t, part))
    points = 2 * style.pixels(axes)
    t, thin = style.thinned(trajectory.t[rows] - shown.start, values[rows], points=points)
    if wraps:
        broken = style.broken_at_wraps(thin)
        # of the rows of an angle that are beside a jump across the half turn
        if np.count_nonzero(np.isnan(broken)) > 0.25 * len(thin):  # whole turns within a pixel
            # for each point of a line, where an angle turns too fast for one
            some = slice(None, None, max(1, len(values[rows]) // (10 * points)))
            t, thin, line = trajectory.t[rows][some] - shown.start, values[rows][some], ","
        else:
            thin = broken
    axes.plot(t, thin, line, color=colour, label=label, linewidth=width)


def time_axes(rows: list[Axes], shown: Shown) -> None:
    """Give axes one above the other the time of the session, labelled once."""
    for axes in rows:
        time_axis(axes, shown, is_labelled=axes is rows[-1])


def time_axis(axes: Axes, shown: Shown, is_labelled: bool = True) -> None:
    """Give axes the time of the session."""
    axes.set_xlim(0.0, shown.seconds)
    style.clock_axis(axes, shown.seconds)
    if not is_labelled:
        axes.set_xlabel("")
        axes.tick_params(labelbottom=False)
