"""The sphere of the magnetometer: covered directions, and the ellipsoid through the readings."""

import numpy as np

from smoother.arrays import Array
from smoother.fit.ellipsoid import COVERAGE_BANDS, COVERAGE_SECTORS, Ellipsoid, FitError, fit_ellipsoid

PER_CELL = 8  # readings kept of each direction; 480 in all
CELLS = COVERAGE_BANDS * COVERAGE_SECTORS
LEAST_EXTENT = 20.0  # uT on every axis for meaningful directions; the Earth's field gives 50 to 130
ENOUGH = 0.5  # of the directions, above which an ellipsoid is fitted


def cell_of(direction: Array) -> int:
    """Cell of a direction (3,), one of :data:`CELLS` of equal area: bands of height, sectors around."""
    length = float(np.linalg.norm(direction))
    height = direction[2] / length if length > 0.0 else 0.0
    band = min(COVERAGE_BANDS - 1, int((height + 1.0) * 0.5 * COVERAGE_BANDS))
    turn = np.arctan2(direction[1], direction[0]) / (2.0 * np.pi) % 1.0
    return band * COVERAGE_SECTORS + min(COVERAGE_SECTORS - 1, int(turn * COVERAGE_SECTORS))


class FieldSphere:
    """Readings by direction about the middle of their extent; the oldest of a full cell is replaced."""

    def __init__(self) -> None:
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._centre = np.zeros(3)
        self._cells: dict[int, list[Array]] = {}
        self.ellipsoid: Ellipsoid | None = None
        self.flaw = ""

    def feed(self, field: Array) -> None:
        """Add readings (K, 3) of any unit."""
        for reading in field[:: max(1, len(field) // 4)]:
            self._low, self._high = np.minimum(self._low, reading), np.maximum(self._high, reading)
            middle = 0.5 * (self._low + self._high)
            if np.linalg.norm(middle - self._centre) > 0.05 * np.linalg.norm(self._high - self._low):
                self._centre = middle
                self._sort_again()
            self._put(reading)

    @property
    def points(self) -> Array:
        """The readings that are kept, (K, 3)."""
        rows = [reading for cell in self._cells.values() for reading in cell]
        return np.array(rows) if rows else np.zeros((0, 3))

    @property
    def coverage(self) -> float:
        """Share (0..1) of all directions with readings, from the middle of their extent."""
        if not np.all(self._high - self._low > LEAST_EXTENT):
            return 0.0
        return len(self._cells) / CELLS

    @property
    def centre(self) -> Array:
        """Middle of the extent, (3,), or that of the ellipsoid once there is one."""
        return self._centre if self.ellipsoid is None else self.ellipsoid.centre

    def fit(self) -> None:
        """Fit the ellipsoid where the coverage is sufficient; takes a tenth of a second."""
        if self.coverage < ENOUGH:
            return
        try:
            self.ellipsoid, self.flaw = fit_ellipsoid(self.points), ""
        except FitError as error:
            self.flaw = str(error)

    def _put(self, reading: Array) -> None:
        cell = self._cells.setdefault(cell_of(reading - self._centre), [])
        cell.append(reading)
        if len(cell) > PER_CELL:
            cell.pop(0)

    def _sort_again(self) -> None:
        rows, self._cells = self.points, {}
        for reading in rows:
            self._put(reading)
