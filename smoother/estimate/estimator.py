"""The one interface of baseline and smoother: options go to the constructor, data to the method."""

from typing import Protocol

from smoother.samples import Session
from smoother.trajectory import Trajectory


class Estimator(Protocol):
    """Anything that turns a session into a trajectory. `name` labels tables and figures."""

    name: str

    def estimate(self, session: Session) -> Trajectory:
        """Return the trajectory of the session; flawed data ends in its `report.problems`, not in an exception."""
        ...
