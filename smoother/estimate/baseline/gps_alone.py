"""GPS alone, as one more estimator: the fixes joined by straight lines, to compare the others with."""

import numpy as np

from smoother.arrays import Array
from smoother.estimate.output.resample import between_rows, bracket
from smoother.samples import Session
from smoother.trajectory import EstimateReport, Trajectory


class GpsAlone:
    """What a plain GPS logger shows: straight lines between the fixes as received, without correction of the
    latency."""

    name = "GPS alone"

    def __init__(self, rate: float = 50.0) -> None:
        """`rate`: rows per second, Hz, besides one row at each fix."""
        self._rate = rate

    def estimate(self, session: Session) -> Trajectory:
        """Return the fixes joined by straight lines; heights and velocities likewise where they are known."""
        fixes = fixes_as_trajectory(session)
        first, last = fixes.t[0], fixes.t[-1]
        grid = first + np.arange(int((last - first) * self._rate) + 1) / self._rate
        t = np.union1d(grid, fixes.t)
        t = t[np.concatenate([[True], np.diff(t) > 1e-9])]
        place = bracket(fixes.t, t)
        return _gps_trajectory(t, between_rows(fixes.position_n, place), between_rows(fixes.velocity_n, place))


def fixes_as_trajectory(session: Session) -> Trajectory:
    """Return the fixes themselves, one row each; velocity from speed and course where no components were sent."""
    fixes = session.gnss
    return _gps_trajectory(fixes.t, session.fix_position_n, fixes.velocity_n)


def _gps_trajectory(t: Array, position_n: Array, velocity_n: Array) -> Trajectory:
    n = len(t)
    unknown = np.full((n, 3), np.nan)
    report = EstimateReport(mode="gps-only")
    return Trajectory(t, position_n, velocity_n, np.full((n, 3, 3), np.nan), unknown, unknown, report=report)
