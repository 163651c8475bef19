"""Places of which the longitude or the latitude has the wrong sign: a mirrored track, on which the box seems mirrored.

That of the box would be said, were it not for the course that the receiver sends: it goes round as the box does, and
not as the places do.
"""

import numpy as np

from smoother.estimate.fixes.screen import says_velocity
from smoother.estimate.initial.align import align
from smoother.estimate.path_motion import PathMotion
from smoother.frames import Origin
from smoother.samples import GnssFixes, ImuSamples, Problem, Session
from smoother.trajectory import MIRRORED_AXES, MIRRORED_PLACES, UNLIKE_AXES

COURSE_WRONG = "gps_course_wrong"  # problem of a course that points elsewhere than the places go
BASELINE = 1.0  # s between places that make a velocity
TEXT = (
    "longitude (or latitude) has the wrong sign: the course that the receiver sends, accelerometer and gyroscope go "
    "round the other way than the places. West and south are negative; change it in the recording"
)


def explained(problems: tuple[Problem, ...], session: Session) -> tuple[Problem, ...]:
    """Return problems of an estimate, those of mirrored axes replaced where it is the places that are mirrored."""
    if not _are_mirrored(problems) or not (_is_course_wrong(session.problems) or _agrees_with_course(session)):
        return problems
    axes = (MIRRORED_AXES, UNLIKE_AXES)
    return (Problem(MIRRORED_PLACES, TEXT), *(problem for problem in problems if problem.code not in axes))


def mirrored_places(samples: ImuSamples, fixes: GnssFixes, read: tuple[Problem, ...]) -> tuple[Problem, ...]:
    """Return the problem of mirrored places of a recording whose course was `read` and contradicts them, if it is one.

    samples : of its beginning, calibrated or not.
    """
    if not _is_course_wrong(read) or len(fixes) < 2:
        return ()
    return (Problem(MIRRORED_PLACES, TEXT),) if _are_mirrored(align(samples, _way_of(fixes)).problems) else ()


def _are_mirrored(problems: tuple[Problem, ...]) -> bool:
    """Whether force and turn both are: what is left is right turns left, and gravity stays where it is."""
    return {MIRRORED_AXES, UNLIKE_AXES} <= {problem.code for problem in problems}


def _is_course_wrong(read: tuple[Problem, ...]) -> bool:
    return any(problem.code == COURSE_WRONG for problem in read)


def _agrees_with_course(session: Session) -> bool:
    """Whether the box turns as the velocities that were sent with most of the places."""
    known = says_velocity(session.gnss.velocity_n)
    if session.imu is None or np.mean(known) < 0.5:
        return False
    found = align(session.imu, PathMotion(session.gnss.t[known], session.gnss.velocity_n[known]))
    return not found.is_level_only and not found.problems


def _way_of(fixes: GnssFixes) -> PathMotion:
    """Motion by the places alone, over BASELINE."""
    place = fixes.position_n(Origin(float(fixes.lat_deg[0]), float(fixes.lon_deg[0]), 0.0))[:, :2]
    before, after = (
        np.stack([np.interp(fixes.t + half, fixes.t, axis) for axis in place.T], axis=1)
        for half in (-0.5 * BASELINE, 0.5 * BASELINE)
    )
    level = (after - before) / BASELINE
    return PathMotion(fixes.t, np.column_stack([level, np.full(len(fixes), np.nan)]), is_measured=False)
