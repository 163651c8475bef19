"""The view in a window: a Tk canvas, whose items are moved, never drawn anew.

matplotlib was measured first: 75 ms of processor time a frame even with blitting, of which 60 lay out and draw twenty
texts. A canvas keeps its texts and lines in the display server and takes a few milliseconds. The logger is projected by
a product of matrices.
"""

import tkinter
from typing import Any

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.errors import UsageError
from smoother.live import view_text
from smoother.live.engine import Snapshot
from smoother.live.frame import Frame
from smoother.units import DEG, STANDARD_GRAVITY

FRAMES = 40.0  # a second; a busy machine drops a third of them
WIDTH, HEIGHT = 1060, 640  # pixels
WRAPPED, LONGEST = 560, 150  # pixels of a line of text, letters of two
FORCE_RANGE, RATE_RANGE = 3.0, 180.0  # g, deg/s
INK, DIM, FAINT, PAPER = "#1a1c20", "#6b7280", "#d5dae2", "#ffffff"
AXES = ("#c0392b", "#1e8449", "#2458b3")  # forward, left, up
GOOD, BAD = "#1e8449", "#c0392b"
FONT = "DejaVu Sans"
BOX = np.array([1.0, 0.62, 0.26])  # half lengths: forward, left, up
# a camera behind, right of and above the logger, facing north: rows are right, up and towards the viewer, in n
_TURN, _RISE = -25.0 * DEG, 28.0 * DEG
_RIGHT = np.array([np.sin(_TURN), -np.cos(_TURN), 0.0])
_AWAY = np.array([np.cos(_TURN) * np.cos(_RISE), np.sin(_TURN) * np.cos(_RISE), -np.sin(_RISE)])
CAMERA = np.stack([_RIGHT, np.cross(_RIGHT, _AWAY), -_AWAY])
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64) * BOX
_FACES = np.array([[4, 5, 7, 6], [0, 1, 3, 2], [2, 3, 7, 6], [0, 1, 5, 4], [1, 3, 7, 5], [0, 2, 6, 4]])
_NORMALS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
_COLOURS = ("#e8a33d", "#9aa3b2", "#b9c1ce", "#b9c1ce", "#dfe4ec", "#7d8696")


def project(points_n: Array) -> Array:
    """Return the projection (..., 2) of points (..., 3) of n."""
    return np.asarray(points_n @ CAMERA[:2].T)


def box_faces(R_nb: Array) -> tuple[Array, IntArray]:
    """Return the visible faces of the box, (K, 4, 2), and their indices (K,)."""
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
        self._root.resizable(False, False)
        self._root.protocol("WM_DELETE_WINDOW", self._close)
        self._name, self._is_open = name, True
        canvas = tkinter.Canvas(self._root, width=WIDTH, height=HEIGHT, background=PAPER, highlightthickness=0)
        canvas.pack()
        self._box = _Box(canvas, (330.0, 235.0), 118.0)
        self._words = _Words(canvas, (28.0, 420.0))
        self._force = _Bars(canvas, (680.0, 22.0), "specific force, g", FORCE_RANGE)
        self._rate = _Bars(canvas, (680.0, 215.0), "angular rate, °/s", RATE_RANGE)
        self._root.update()

    def __enter__(self) -> "WindowView":
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_open:
            self._close()

    def draw(self, frame: Frame) -> bool:
        """Show a frame."""
        self._root.update()
        if not self._is_open:
            return False
        s = frame.snapshot
        self._box.update(s, is_stale=view_text.is_stale(frame))
        self._words.update(frame, self._name)
        self._force.update(s.force / STANDARD_GRAVITY)
        self._rate.update(s.rate / DEG)
        self._root.update_idletasks()
        return True

    def _close(self) -> None:
        self._is_open = False
        self._root.destroy()


class _Item:
    """An item of the canvas; only changes are sent to it."""

    def __init__(self, canvas: tkinter.Canvas, item: int) -> None:
        self._canvas, self._item = canvas, item
        self._options: dict[str, object] = {}

    def set(self, **values: object) -> None:
        """Set options, as text or fill."""
        changed = {name: value for name, value in values.items() if self._options.get(name) != value}
        if changed:
            options: dict[str, Any] = changed
            self._canvas.itemconfigure(self._item, **options)
            self._options.update(changed)

    def move(self, points: Array) -> None:
        """Put the item's points at (K, 2) pixels."""
        self._canvas.coords(self._item, *points.ravel().tolist())

    def show(self, is_shown: bool) -> None:
        """Show or hide."""
        self.set(state="normal" if is_shown else "hidden")


def _text(canvas: tkinter.Canvas, x: float, y: float, size: int, colour: str = INK, **options: Any) -> _Item:
    font = (FONT, -size, "bold") if options.pop("bold", False) else (FONT, -size)
    options.setdefault("anchor", "w")
    return _Item(canvas, canvas.create_text(x, y, fill=colour, font=font, **options))


class _Box:
    """The logger: solid by the smoother (by Madgwick before), outlined by Madgwick."""

    def __init__(self, canvas: tkinter.Canvas, centre: tuple[float, float], scale: float) -> None:
        self._centre, self._scale = np.array(centre), scale
        turn = np.linspace(0, 2 * np.pi, 73)
        ground = np.array([0.0, 0.0, -0.75])
        ring = 1.75 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(73)]) + ground
        canvas.create_line(*self._pixels(project(ring)).ravel().tolist(), fill=FAINT, width=2)
        for label, direction in zip("NWSE", ([1, 0], [0, 1], [-1, 0], [0, -1]), strict=True):
            x, y = self._pixels(project(np.array([*(1.95 * np.array(direction)), 0.0]) + ground))
            _text(canvas, x, y, 15, DIM, text=label, anchor="center")
        nowhere = [0.0] * 8
        self._faces = [_Item(canvas, canvas.create_polygon(*nowhere, outline=INK, width=1)) for _ in range(3)]
        self._outline = [
            _Item(canvas, canvas.create_polygon(*nowhere, outline=AXES[2], fill="", dash=(5, 4))) for _ in range(3)
        ]
        self._arrows = [
            _Item(canvas, canvas.create_line(0, 0, 0, 0, fill=colour, width=3, arrow="last")) for colour in AXES
        ]
        self._tips = [_text(canvas, 0, 0, 13, colour, anchor="center") for colour in AXES]
        self._title = _text(canvas, 28, 30, 22, bold=True)
        self._second = _text(canvas, 28, 60, 15, AXES[2])
        self._stage = _text(canvas, 28, 84, 14, DIM)

    def update(self, s: Snapshot, *, is_stale: bool) -> None:
        R = s.madgwick if s.lag is None else s.lag.R_nb
        both = s.lag is not None and s.madgwick is not None
        title = "roll {}   pitch {}   yaw {}".format(*view_text.angles(R))
        self._title.set(text=title, fill=DIM if is_stale else INK)
        second = "Madgwick (dashed): roll {}   pitch {}   yaw {}".format(*view_text.angles(s.madgwick))
        self._second.set(text=second if both else "Madgwick's filter" if s.madgwick is not None else "")
        self._stage.set(text=view_text.smoother(s))
        self._put(self._faces, R, is_filled=True)
        self._put(self._outline, s.madgwick if both else None, is_filled=False)
        names = ("forward", "left", "up") if s.R_bs is not None else ("x", "y", "z")
        for arrow, tip, name, i in zip(self._arrows, self._tips, names, range(3), strict=True):
            arrow.show(R is not None)
            tip.show(R is not None)
            if R is not None:
                reach = np.array([BOX[i], BOX[i] + 0.5, BOX[i] + 0.68])
                points = self._pixels(project(reach[:, None] * R[:, i]))
                arrow.move(points[:2])
                tip.move(points[2])
                tip.set(text=name)

    def _put(self, items: list[_Item], R: Array | None, *, is_filled: bool) -> None:
        faces, which = (np.zeros((0, 4, 2)), np.zeros(0, dtype=np.int64)) if R is None else box_faces(R)
        for i, item in enumerate(items):
            item.show(i < len(which))
            if i < len(which):
                item.move(self._pixels(faces[i]))
                if is_filled:
                    item.set(fill=_COLOURS[which[i]])

    def _pixels(self, points: Array) -> Array:
        """Pixels of points in the plane of the screen, which has y up."""
        return np.asarray(self._centre + self._scale * points * [1.0, -1.0])


class _Words:
    """The texts."""

    _LABELS = ("GPS", "speed", "laps", "rates", "link", "delay", "record", "lost")

    def __init__(self, canvas: tkinter.Canvas, corner: tuple[float, float]) -> None:
        self._lines: dict[str, _Item] = {}
        for i, label in enumerate(self._LABELS):
            y = corner[1] + 26 * i
            _text(canvas, corner[0], y, 14, DIM, text=label)
            x, is_large = corner[0] + 66, label == "speed"
            if label == "lost":  # the last one has room for a second line
                self._lines[label] = _text(canvas, x, y - 9, 14, anchor="nw", width=WRAPPED)
            else:
                self._lines[label] = _text(canvas, x, y, 20 if is_large else 14, bold=is_large)

    def update(self, frame: Frame, name: str) -> None:
        s, link = frame.snapshot, frame.link
        texts = {
            "GPS": view_text.gps(s),
            "speed": view_text.speed(s),
            "laps": view_text.laps(s),
            "rates": view_text.rates(frame),
            "link": view_text.connection(link, name),
            "lost": view_text.losses(frame),
            "delay": view_text.delay(frame),
            "record": view_text.recording(frame),
        }
        for label, text in texts.items():
            longest = LONGEST if label == "lost" else LONGEST // 2
            self._lines[label].set(text=text if len(text) < longest else text[: longest - 3] + "...")
        self._lines["speed"].set(fill=DIM if view_text.is_stale(frame) else INK)
        self._lines["GPS"].set(fill=GOOD if view_text.is_gps_good(s) else BAD)
        self._lines["record"].set(fill=INK if view_text.is_recording_well(frame) else BAD)
        self._lines["link"].set(fill=INK if link.is_open or link.is_over else BAD)


class _Bars:
    """Three bars from the middle, with their numbers."""

    def __init__(self, canvas: tkinter.Canvas, corner: tuple[float, float], title: str, limit: float) -> None:
        x, y = corner
        _text(canvas, x, y, 14, text=title)
        self._middle, self._half, self._limit = x + 140.0, 115.0, limit
        self._rows = [y + 32.0 + 38.0 * i for i in range(3)]
        top, bottom = self._rows[0] - 16, self._rows[2] + 18
        for share in (-1.0, -0.5, 0.0, 0.5, 1.0):
            at = self._middle + share * self._half
            canvas.create_line(at, top, at, bottom, fill=DIM if share == 0.0 else FAINT)
            _text(canvas, at, bottom + 10, 11, DIM, text=f"{share * limit:g}", anchor="center")
        for label, row in zip("xyz", self._rows, strict=True):
            _text(canvas, x, row, 13, DIM, text=label)
        self._bars = [_Item(canvas, canvas.create_rectangle(0, 0, 0, 0, fill=c, outline="")) for c in AXES]
        self._numbers = [_text(canvas, x + 345.0, row, 15, anchor="e") for row in self._rows]

    def update(self, values: Array) -> None:
        for bar, number, row, value in zip(self._bars, self._numbers, self._rows, values.tolist(), strict=True):
            end = self._middle + self._half * min(1.0, max(-1.0, value / self._limit))
            bar.move(np.array([[self._middle, row - 11.0], [end, row + 11.0]]))
            number.set(text=f"{value:+.2f}" if self._limit < 10.0 else f"{value:+.0f}")
