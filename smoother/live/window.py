"""The view in a window: matplotlib on Tk, drawn by blitting.

Everything that stands still is drawn once into a background; a frame restores it and draws the dozens of artists that
moved. The box is projected by hand, which is a product of matrices: matplotlib's 3-D axes need ten times as long.
"""

import tkinter
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_tkagg import FigureCanvasTkAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text

from smoother.arrays import Array, IntArray
from smoother.errors import UsageError
from smoother.live import words
from smoother.live.engine import Snapshot
from smoother.live.receiver import LinkStatus
from smoother.units import DEG, STANDARD_GRAVITY

FRAMES = 30.0  # a second
SIZE = (11.5, 7.0)  # inches at DPI
DPI = 90
FORCE_RANGE, RATE_RANGE = 3.0, 180.0  # g, deg/s
INK, DIM, PAPER = "#1a1c20", "#6b7280", "#ffffff"
AXES = ("#c0392b", "#1e8449", "#2458b3")  # forward, left, up
GOOD, BAD = "#1e8449", "#c0392b"
BOX = np.array([1.0, 0.62, 0.26])  # half lengths: forward, left, up
# a camera behind, right of and above the box that looks north: rows are right, up and towards the viewer, in n
_TURN, _RISE = -25.0 * DEG, 28.0 * DEG
_RIGHT = np.array([np.sin(_TURN), -np.cos(_TURN), 0.0])
_AWAY = np.array([np.cos(_TURN) * np.cos(_RISE), np.sin(_TURN) * np.cos(_RISE), -np.sin(_RISE)])
CAMERA = np.stack([_RIGHT, np.cross(_RIGHT, _AWAY), -_AWAY])
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64) * BOX
_FACES = np.array([[4, 5, 7, 6], [0, 1, 3, 2], [2, 3, 7, 6], [0, 1, 5, 4], [1, 3, 7, 5], [0, 2, 6, 4]])
_NORMALS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
_COLOURS = np.array(["#e8a33d", "#9aa3b2", "#b9c1ce", "#b9c1ce", "#dfe4ec", "#7d8696"])


def project(points_n: Array) -> Array:
    """Return points (..., 3) of n as the camera sees them, (..., 2)."""
    return np.asarray(points_n @ CAMERA[:2].T)


def box_faces(R_nb: Array) -> tuple[Array, IntArray]:
    """Return the visible faces of the box, (K, 4, 2), and which they are (K,)."""
    corners = project(_CORNERS @ R_nb.T)
    visible = np.flatnonzero((_NORMALS @ R_nb.T) @ CAMERA[2] > 0.0)
    return corners[_FACES[visible]], visible.astype(np.int64)


class WindowView:
    """A window. `draw` returns False once it was closed by hand."""

    frames_a_second = FRAMES

    def __init__(self, name: str) -> None:
        """Open it. Raises UsageError without a display."""
        try:
            self._root = tkinter.Tk()
        except tkinter.TclError as error:
            raise UsageError(f"no display for a window ({error}); use --view terminal or --headless") from error
        self._root.title(f"smooth live - {name}")
        self._root.protocol("WM_DELETE_WINDOW", self._close)
        self._name, self._is_open = name, True
        self.figure = Figure(SIZE, DPI, facecolor=PAPER)
        self._canvas: Any = _canvas(self.figure, self._root)
        self._canvas.get_tk_widget().pack(fill="both", expand=True)
        self._scene = Scene(self.figure)
        self._background: Any = None
        self._canvas.mpl_connect("resize_event", self._resized)
        self._root.update()

    def __enter__(self) -> "WindowView":
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_open:
            self._close()

    def draw(self, s: Snapshot, link: LinkStatus, delay: float) -> bool:
        """Show a snapshot."""
        self._root.update()
        if not self._is_open:
            return False
        self._scene.update(s, link, self._name, delay)
        if self._background is None:
            self._canvas.draw()
            self._background = self._canvas.copy_from_bbox(self.figure.bbox)
        self._canvas.restore_region(self._background)
        for artist in self._scene.moving:
            artist.axes.draw_artist(artist)
        self._canvas.blit(self.figure.bbox)
        return True

    def _resized(self, _: object) -> None:
        self._background = None

    def _close(self) -> None:
        self._is_open = False
        self._root.destroy()


class Scene:
    """The artists of a figure, and what a snapshot makes of them."""

    def __init__(self, figure: Figure) -> None:
        grid = figure.add_gridspec(
            3,
            2,
            width_ratios=(1.45, 1.0),
            height_ratios=(1.0, 1.0, 1.05),
            left=0.02,
            right=0.975,
            top=0.97,
            bottom=0.03,
        )
        self._box = _Box(_bare(figure.add_subplot(grid[:2, 0])))
        self._words = _Words(_bare(figure.add_subplot(grid[2, 0])))
        self._force = _Bars(figure.add_subplot(grid[0, 1]), "specific force, g", FORCE_RANGE)
        self._rate = _Bars(figure.add_subplot(grid[1, 1]), "angular rate, °/s", RATE_RANGE)
        self._sphere = _Sphere(_bare(figure.add_subplot(grid[2, 1])))
        self._parts = (self._box, self._words, self._force, self._rate, self._sphere)
        for artist in self.moving:
            artist.set_animated(True)

    @property
    def moving(self) -> list[Any]:
        """Artists to be drawn in every frame, in order."""
        return [artist for part in self._parts for artist in part.moving]

    def update(self, s: Snapshot, link: LinkStatus, name: str, delay: float) -> None:
        """Set every artist to a snapshot."""
        self._box.update(s)
        self._words.update(s, link, name, delay)
        self._force.update(s.force / STANDARD_GRAVITY)
        self._rate.update(s.rate / DEG)
        self._sphere.update(s)


class _Box:
    """The box: solid by the smoother (by Madgwick before), outlined by Madgwick."""

    def __init__(self, ax: Axes) -> None:
        ax.set_xlim(-2.1, 2.1)
        ax.set_ylim(-1.55, 1.55)
        ax.set_aspect("equal")
        ring = np.stack([np.cos(np.linspace(0, 2 * np.pi, 73)), np.sin(np.linspace(0, 2 * np.pi, 73))], axis=1)
        ground = np.array([0.0, 0.0, -0.75])
        ax.plot(*project(np.column_stack([1.75 * ring, np.zeros(73)]) + ground).T, color="#d5dae2", lw=1.2, zorder=0)
        for label, direction in zip("NWSE", ([1, 0], [0, 1], [-1, 0], [0, -1]), strict=True):
            at = project(np.array([*(1.95 * np.array(direction)), 0.0]) + ground)
            ax.text(float(at[0]), float(at[1]), label, color=DIM, ha="center", va="center", fontsize=11, zorder=0)
        self._faces = PolyCollection([], edgecolor=INK, linewidth=1.0)
        self._outline = PolyCollection([], facecolor="none", edgecolor=AXES[2], linewidth=1.0, linestyle=(0, (4, 3)))
        for collection in (self._faces, self._outline):
            ax.add_collection(collection, autolim=False)
        self._arrows = [ax.plot([], [], color=colour, lw=2.6, solid_capstyle="round")[0] for colour in AXES]
        self._tips = [
            ax.text(0, 0, label, color=colour, fontsize=10, ha="center", va="center")
            for label, colour in zip(("forward", "left", "up"), AXES, strict=True)
        ]
        self._title = ax.text(0.0, 0.99, "", transform=ax.transAxes, fontsize=15, va="top", color=INK, weight="bold")
        self._second = ax.text(0.0, 0.905, "", transform=ax.transAxes, fontsize=11, va="top", color=AXES[2])
        self._stage = ax.text(0.0, 0.845, "", transform=ax.transAxes, fontsize=10, va="top", color=DIM)
        self.moving: list[Any] = [self._faces, self._outline, *self._arrows, *self._tips]
        self.moving += [self._title, self._second, self._stage]

    def update(self, s: Snapshot) -> None:
        R = s.madgwick if s.lag is None else s.lag.R_nb
        self._title.set_text("roll {}   pitch {}   yaw {}".format(*words.angles(R)))
        both = s.lag is not None and s.madgwick is not None
        second = "Madgwick: roll {}   pitch {}   yaw {}".format(*words.angles(s.madgwick))
        self._second.set_text(second if both else "Madgwick's filter" if s.madgwick is not None else "")
        self._stage.set_text(words.smoother(s))
        for artist in self.moving[:8]:
            artist.set_visible(R is not None)
        self._outline.set_visible(both)
        if R is None:
            return
        faces, which = box_faces(R)
        self._faces.set_verts(list(faces))
        self._faces.set_facecolor(_COLOURS[which].tolist())
        if both and s.madgwick is not None:
            self._outline.set_verts(list(box_faces(s.madgwick)[0]))
        centre = np.zeros(2)
        names = ("forward", "left", "up") if s.R_bs is not None else ("x", "y", "z")
        for arrow, tip, name, i in zip(self._arrows, self._tips, names, range(3), strict=True):
            inner, outer = project(R[:, i] * BOX[i]), project(R[:, i] * (BOX[i] + 0.55))
            arrow.set_data(*np.stack([centre + inner, outer]).T)
            tip.set_position(tuple(project(R[:, i] * (BOX[i] + 0.75))))
            tip.set_text(name)


class _Words:
    """What is said in words."""

    _LABELS = ("GPS", "speed", "laps", "rates", "link", "lost", "delay")

    def __init__(self, ax: Axes) -> None:
        self._lines: dict[str, Text] = {}
        for i, label in enumerate(self._LABELS):
            y = 0.95 - i * 0.145
            ax.text(0.0, y, label, color=DIM, fontsize=10.5, va="center", transform=ax.transAxes)
            self._lines[label] = ax.text(0.11, y, "", color=INK, fontsize=10.5, va="center", transform=ax.transAxes)
        self._lines["speed"].set_fontsize(14)
        self._lines["speed"].set_fontweight("bold")
        self.moving: list[Any] = list(self._lines.values())

    def update(self, s: Snapshot, link: LinkStatus, name: str, delay: float) -> None:
        texts = {
            "GPS": words.gps(s),
            "speed": words.speed(s),
            "laps": words.laps(s),
            "rates": words.rates(s),
            "link": words.connection(link, name),
            "lost": words.losses(s, link),
            "delay": f"{1e3 * delay:.0f} ms",
        }
        for label, text in texts.items():
            self._lines[label].set_text(text if len(text) < 86 else text[:83] + "...")
        self._lines["GPS"].set_color(GOOD if words.is_gps_good(s) else BAD)
        self._lines["link"].set_color(INK if link.is_open or link.is_over else BAD)


class _Bars:
    """Three bars from the middle, with their numbers."""

    def __init__(self, ax: Axes, title: str, limit: float) -> None:
        ax.set_title(title, loc="left", fontsize=10.5, color=INK)
        ax.set_xlim(-limit, limit)
        ax.set_ylim(-0.6, 2.6)
        ax.set_yticks([2, 1, 0], ["x", "y", "z"])
        ax.tick_params(labelsize=9, colors=DIM)
        ax.axvline(0.0, color=DIM, lw=0.8)
        for side in ("top", "right", "left"):
            ax.spines[side].set_visible(False)
        self._limit = limit
        self._bars = [Rectangle((0, y - 0.28), 0, 0.56, color=AXES[i]) for i, y in enumerate((2, 1, 0))]
        for bar in self._bars:
            ax.add_patch(bar)
        self._numbers = [
            ax.text(limit, y + 0.0, "", ha="right", va="center", fontsize=10, color=INK) for y in (2, 1, 0)
        ]
        self.moving: list[Any] = [*self._bars, *self._numbers]

    def update(self, values: Array) -> None:
        for bar, number, value in zip(self._bars, self._numbers, values.tolist(), strict=True):
            bar.set_width(float(np.clip(value, -self._limit, self._limit)))
            number.set_text(f"{value:+.2f}" if self._limit < 10.0 else f"{value:+.0f}")


class _Sphere:
    """Directions of the magnetic field that were seen: both halves of the sphere from above, in the box's axes."""

    def __init__(self, ax: Axes) -> None:
        ax.set_xlim(-1.1, 3.4)
        ax.set_ylim(-1.45, 1.6)
        ax.set_aspect("equal")
        turn = np.linspace(0.0, 2.0 * np.pi, 61)
        for centre, label in ((0.0, "z up"), (2.3, "z down")):
            for radius in (1.0, np.sqrt(2.0 / 3.0), np.sqrt(1.0 / 3.0)):
                ax.plot(centre + radius * np.cos(turn), radius * np.sin(turn), color="#d5dae2", lw=1.0)
            ax.text(centre, -1.28, label, ha="center", va="center", fontsize=9, color=DIM)
        self._points: Line2D = ax.plot([], [], ".", ms=3.5, color=AXES[2])[0]
        self._title = ax.text(-1.1, 1.45, "", fontsize=10.5, color=INK, va="center")
        self.moving: list[Any] = [self._points, self._title]

    def update(self, s: Snapshot) -> None:
        self._points.set_data(*disc_positions(s.field_points - s.field_centre).T)
        self._title.set_text(f"compass: {words.compass(s)}")


def disc_positions(vectors: Array) -> Array:
    """Return where directions of vectors (K, 3) stand in two discs of equal area, (K, 2): z up at 0, z down at 2.3."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit = vectors / np.maximum(length, 1e-12)
    radius = np.sqrt(1.0 - np.abs(unit[:, 2]))
    level = unit[:, :2] / np.maximum(np.linalg.norm(unit[:, :2], axis=1, keepdims=True), 1e-12)
    # seen from above: x up the page, y to the left
    places = np.stack([-level[:, 1], level[:, 0]], axis=1) * radius[:, None]
    places[:, 0] += np.where(unit[:, 2] < 0.0, 2.3, 0.0)
    return np.asarray(places)


def _canvas(figure: Figure, root: tkinter.Tk) -> Any:
    """The canvas, of which matplotlib says no types."""
    make: Any = FigureCanvasTkAgg
    return make(figure, root)


def _bare(ax: Axes) -> Axes:
    ax.set_axis_off()
    return ax
