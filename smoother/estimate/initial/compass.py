"""Whether the magnetometer of a session is of use, asked of attitudes that were found without it."""

from dataclasses import dataclass, field, replace

import numpy as np

from smoother.estimate.factors.constraints import heading_rows
from smoother.estimate.initial.guess import Start
from smoother.estimate.model.heading import Heading, heading_from_field
from smoother.estimate.model.imu import MOSTLY_MISSING, BinnedImu
from smoother.estimate.model.state import State
from smoother.fit.magnetic_model import session_field
from smoother.samples import MagSamples, Problem, Session

UNUSED = Problem("magnetometer_unused", "the magnetometer disagrees with the gyro and the course; it was left out")


@dataclass
class Compass:
    """The magnetometer of a session along `start`: its heading and problems, once it was asked.

    is_level: the mean of its headings counts for nothing, as where it is fitted to each window of a session anew.
    """

    session: Session
    start: Start
    is_level: bool = False
    found: Heading | None = None
    problems: tuple[Problem, ...] = field(default=())

    def heading(self, state: State) -> Heading | None:
        """Return the headings that can be used, by the attitudes of `state`."""
        mag = self.session.mag
        if mag is None or self.session.config.magnetometer.use is False:
            return None
        earth, self.problems = session_field(self.session)
        mag = _readings_beside_samples(mag, self.start.binned)
        found = heading_from_field(mag, state, earth.declination, earth.inclination, self.start.data.still)
        if found is None:
            self.problems = (*self.problems, UNUSED)
        elif self.is_level:
            rows = heading_rows(state, found.interval, found.field_s, found.field_yaw, found.sigma, has_offset=False)
            found = replace(found, has_offset=False, field_yaw=found.field_yaw + float(np.median(rows.residual)))
        self.found = found
        return found


def _readings_beside_samples(mag: MagSamples, binned: BinnedImu) -> MagSamples:
    """The readings of the intervals that have inertial samples.

    In a hole the tilt of the kart is uncertain by some degrees, which a steep field turns into two or three times as
    large an error of heading. The heading factor corrects yaw alone, so that the iterations would not converge.
    """
    if not np.any(binned.missing):
        return mag
    interval = np.clip(np.searchsorted(binned.t, mag.t) - 1, 0, len(binned.missing) - 1)
    use = binned.missing[interval] < MOSTLY_MISSING
    return replace(mag, t=mag.t[use], field_s=mag.field_s[use])
