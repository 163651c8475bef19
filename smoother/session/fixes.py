"""Columns of fixes, from whatever file, to GnssFixes: checked, put in order of time, normalised."""

import numpy as np

from smoother.arrays import Array
from smoother.frames import velocity_n_from_course
from smoother.samples import GnssFixes, Problem
from smoother.session.checks.fixes import INTERPOLATED, PATH_CHECKS, ROW_CHECKS
from smoother.session.checks.table import run
from smoother.session.fix_columns import ABSURD_SPEED, FixColumns, FixRows
from smoother.session.rows import in_time_order
from smoother.words import counted

ABSURD_CLIMB = 50.0  # m/s
NEARLY_STILL = 0.15  # m/s; noise of a receiver's speed at rest: its direction means nothing


def screen_fixes(columns: FixColumns, file: str, *, has_rows_between: bool = False) -> tuple[GnssFixes, list[Problem]]:
    """Return the usable fixes of a file in time order (maybe none) and what was wrong with the others.

    has_rows_between : whoever read the file left out rows that its exporter interpolated between fixes.
    """
    rows, of_rows = run(ROW_CHECKS, FixRows("fixes", file, columns, has_rows_between))
    c = rows.columns
    ordered = in_time_order(c.t, c.lat_deg, c.lon_deg, file=file, prefix="gps")
    rows, of_path = run(PATH_CHECKS, rows.with_stream("fixes", c.take(ordered.index).at(ordered.t)))
    return _to_fixes(rows.columns), [*of_rows, *ordered.problems, *of_path]


def interpolated_note(file: str, count: int) -> list[Problem]:
    """Say that a file has rows between its fixes."""
    return (
        [Problem("gps_interpolated", f"{file}: {INTERPOLATED}; {counted(count, 'row')} left out", count)]
        if count
        else []
    )


def _to_fixes(c: FixColumns) -> GnssFixes:
    with np.errstate(invalid="ignore"):
        course = np.mod(c.course_deg, 360.0)
        hdop = np.where((c.hdop > 0.0) & (c.hdop < 99.0), c.hdop, np.nan)  # 99.99 means unknown
    return GnssFixes(
        t=c.t,
        lat_deg=c.lat_deg,
        lon_deg=np.where(c.lon_deg > 180.0, c.lon_deg - 360.0, c.lon_deg),
        alt_m=c.alt_m,
        velocity_n=_velocity_n(c, course),
        speed=c.speed,
        course_deg=course,
        sigma_horizontal=c.sigma_horizontal,
        sigma_up=c.sigma_up,
        sigma_velocity=c.sigma_velocity,
        hdop=hdop,
        unix_s=c.unix_s,
        num_sv=np.where(np.isfinite(c.num_sv), c.num_sv, -1.0).astype(np.int64),
        fix=np.where(np.isfinite(c.fix), np.minimum(np.ceil(c.fix), 99.0), 1.0).astype(np.int64),
    )


def _velocity_n(c: FixColumns, course_deg: Array) -> Array:
    """Velocity in n (N, 3): components where sent, else from speed and course, NaN where neither is.

    A climb that comes alone is left out: how late a receiver is shows in level motion.
    """
    with np.errstate(invalid="ignore"):
        sent = np.stack([c.velocity_north, -c.velocity_east, c.velocity_up], axis=-1)
        plausible = np.hypot(sent[:, 0], sent[:, 1]) <= ABSURD_SPEED
        sent[~plausible, :2] = np.nan
        sent[np.abs(sent[:, 2]) > ABSURD_CLIMB, 2] = np.nan
        stands = (c.speed <= NEARLY_STILL) & ~np.isfinite(course_deg)
    computed = velocity_n_from_course(np.where(stands, 0.0, c.speed), np.where(stands, 0.0, course_deg))
    computed[:, 2] = np.where(np.isfinite(computed[:, 0]), sent[:, 2], np.nan)
    return np.where(plausible[:, None], sent, computed)
