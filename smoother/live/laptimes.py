"""Lap times while driving: the path of the last laps, the start line, and the time since its crossing.

Until a smoother runs the path is that of the fixes. A fix that jumps across the line and back would be a lap, so it
is used only after later fixes confirmed it, as after an outage, and dropped otherwise.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array
from smoother.fit.plan_path import PlanPath
from smoother.laps.results import Line
from smoother.laps.timing import BESIDE, gate_crossings

ASTRAY = 5.0  # m from its prediction by velocity, beyond which a fix has jumped
STAYED = 3.0  # s after which jumped fixes are confirmed; reflections last a second or two

Row = tuple[float, Array, Array]  # time s, position m and velocity m/s (3,) in n


@dataclass(frozen=True)
class LapTimes:
    """Times in s, NaN where there is none: since the line, of the last lap, of the best. lap: number of started laps.

    at: time of `running`, on the clock of the rows.
    """

    lap: int = 0
    running: float = float("nan")
    last: float = float("nan")
    best: float = float("nan")
    has_line: bool = False
    at: float = 0.0

    def running_on(self, now: float) -> "LapTimes":
        """Return the same at `now` s, a later time; an earlier one belongs to another run of the logger."""
        return replace(self, running=self.running + now - self.at, at=now) if now > self.at else self


class LapClock:
    """Lap times of the rows that are added; the start line is set from outside."""

    def __init__(self) -> None:
        self._rows: list[Row] = []
        self._line: Line | None = None
        self._crossed: list[float] = []
        self._astray: list[Row] = []  # unconfirmed fixes, each consistent with the previous one
        self._lap, self._best = 0, float("nan")

    @property
    def has_line(self) -> bool:
        """Whether the start line is known."""
        return self._line is not None

    def add_fix(self, t: float, position_n: Array, velocity_n: Array) -> None:
        """Add a fix, as :meth:`add` does a row; one that jumped is used only if later ones confirm it."""
        fix = t, position_n, velocity_n
        if self._rows and not _leads_to(self._rows[-1], fix):
            if self._astray and not _leads_to(self._astray[-1], fix):
                self._astray.clear()
            self._astray.append(fix)
            if t - self._astray[0][0] < STAYED:
                return
        self._astray.clear()
        self.add(*fix)

    def add(self, t: float, position_n: Array, velocity_n: Array) -> None:
        """Add a row: t s, position_n, velocity_n (3,) of the antenna."""
        if self._rows and t - self._rows[-1][0] < 0.1:  # s between rows
            return
        self._rows.append((t, position_n, velocity_n))
        if self._rows[0][0] < t - 600.0:  # s of path, enough for three laps of a long circuit
            del self._rows[: len(self._rows) // 10]
        if self._line is not None and len(self._rows) > 1:
            self._cross(self._path(2))

    def path(self) -> tuple[Array, Array, Array]:
        """Times (N,) s, positions and velocities (N, 3) in n."""
        t, position, velocity = zip(*self._rows, strict=True)
        return np.array(t), np.array(position), np.array(velocity)

    @property
    def seconds(self) -> float:
        """Length of the path, s."""
        return self._rows[-1][0] - self._rows[0][0] if self._rows else 0.0

    def set_line(self, line: Line) -> None:
        """Set the start line; the path before is timed too."""
        self._line, self._crossed, self._lap, self._best = line, [], 0, float("nan")
        if len(self._rows) > 1:
            self._cross(self._path(len(self._rows)))

    def times(self, now: float) -> LapTimes:
        """Return the times at `now` s."""
        crossed = self._crossed
        running = now - crossed[-1] if crossed else float("nan")
        last = crossed[-1] - crossed[-2] if len(crossed) > 1 else float("nan")
        return LapTimes(self._lap, running, last, self._best, self._line is not None, now)

    def _path(self, count: int) -> PlanPath:
        t, position, velocity = zip(*self._rows[-count:], strict=True)
        rows, speeds = np.array(position), np.array(velocity)
        return PlanPath(np.array(t), rows[:, :2], speeds[:, :2], rows[:, 2])

    def _cross(self, path: PlanPath) -> None:
        assert self._line is not None
        for at in gate_crossings(path, self._line, BESIDE).tolist():
            if self._crossed:
                lap = at - self._crossed[-1]
                if lap < 5.0:
                    continue  # the kart moved back and forth over the line
                self._best = float(np.fmin(self._best, lap))
            self._crossed = [*self._crossed[-1:], at]
            self._lap += 1


def _leads_to(one: Row, other: Row) -> bool:
    """Whether a fix agrees with the prediction from an earlier one, or that is older than STAYED."""
    (t, position_n, velocity_n), (later, there_n, then_n) = one, other
    step = later - t
    off = there_n - position_n - 0.5 * step * (velocity_n + then_n)
    return step > STAYED or float(np.hypot(off[0], off[1])) < ASTRAY * (1.0 + step)
