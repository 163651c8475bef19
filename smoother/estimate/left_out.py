"""Sessions without what some of their fixes say. The rows stay, so that masks of fixes fit before and after."""

from dataclasses import replace

import numpy as np

from smoother.arrays import BoolArray
from smoother.samples import Session


def without_positions(session: Session, out: BoolArray) -> Session:
    """Return the session with the positions of the fixes `out` (N,) unknown, their velocities as they are."""
    gnss = session.gnss
    lat_deg, lon_deg, alt_m = (np.where(out, np.nan, v) for v in (gnss.lat_deg, gnss.lon_deg, gnss.alt_m))
    return replace(session, gnss=replace(gnss, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))


def without_fixes(session: Session, out: BoolArray) -> Session:
    """Return the session with positions, velocities and speeds of the fixes `out` (N,) unknown."""
    rest = without_positions(session, out)
    velocity_n = np.where(out[:, None], np.nan, rest.gnss.velocity_n)
    speed = None if rest.gnss.speed is None else np.where(out, np.nan, rest.gnss.speed)
    return replace(rest, gnss=replace(rest.gnss, velocity_n=velocity_n, speed=speed))


def tell_motion(session: Session, *, by_velocity: bool) -> BoolArray:
    """Mask (N,) of the fixes that say how the kart moves: by a level velocity of their own, or else by their place."""
    said = session.gnss.velocity_n if by_velocity else session.fix_position_n
    return np.asarray(np.isfinite(said[:, :2]).all(axis=1))
