"""The Earth's magnetic field at a place and date, from the World Magnetic Model (by way of pygeomag).

Erratum of the thesis: eq. 2.28 prints the west component as `+cos(inclination) sin(declination)`. Declination is
positive towards east and n is North-West-Up, so it is minus that.
"""

import datetime
from dataclasses import dataclass, replace

import numpy as np
from pygeomag import GeoMag, calculate_decimal_year

from smoother.arrays import Array, freeze
from smoother.frames import Origin
from smoother.samples import Problem, Session
from smoother.units import DEG

FIRST_YEAR, LAST_YEAR = 2010.0, 2030.0  # the models that pygeomag carries
MODEL_SPAN = 5  # years
NANOTESLA = 1e-9  # T
WEAK_HORIZONTAL = 6000.0 * NANOTESLA  # NOAA's caution zone: a compass is no longer reliable below it


@dataclass(frozen=True, eq=False)
class EarthField:
    """declination (rad, east positive), inclination (rad, down positive), strength (T), field_n (3,) T; year used.

    `note` says what was assumed (a date outside the models), or is empty.
    """

    declination: float
    inclination: float
    strength: float
    field_n: Array
    year: float
    note: str = ""

    def __post_init__(self) -> None:
        freeze(self, field_n=(3,))


def earth_field(origin: Origin, date: datetime.date | float) -> EarthField:
    """Return the field at `origin` and `date` (a date, or a decimal year), clipped to the years of the models."""
    wanted = float(date) if isinstance(date, int | float) else float(calculate_decimal_year(date))
    year = float(np.clip(wanted, FIRST_YEAR, LAST_YEAR))
    note = ""
    if year != wanted:
        note = f"the magnetic model knows {FIRST_YEAR:.0f} to {LAST_YEAR:.0f}; {year:.0f} was used for {wanted:.1f}"
    base = int(min(year, LAST_YEAR - 1.0))  # the last instant still belongs to the last model
    found = GeoMag(base_year=base).calculate(
        glat=origin.lat_deg, glon=origin.lon_deg, alt=origin.alt_m / 1000.0, time=year
    )
    strength = float(found.f) * NANOTESLA
    declination, inclination = float(found.d) * DEG, float(found.i) * DEG
    if strength * np.cos(inclination) < WEAK_HORIZONTAL:
        note = "; ".join(filter(None, [note, "so near to a magnetic pole a compass is not reliable"]))
    return EarthField(declination, inclination, strength, field_n(declination, inclination, strength), year, note)


def field_n(declination: float, inclination: float, strength: float = 1.0) -> Array:
    """Field vector (3,) in n, in the unit of `strength`; eq. 2.28 with its sign corrected. Angles in rad."""
    level = strength * np.cos(inclination)
    return np.array([level * np.cos(declination), -level * np.sin(declination), -strength * np.sin(inclination)])


def session_declination(session: Session) -> tuple[float, tuple[Problem, ...]]:
    """Declination (rad, east positive) for a session; see :func:`session_field`."""
    if session.config.magnetometer.declination_deg is not None:
        return session.config.magnetometer.declination_deg * DEG, ()
    field, problems = session_field(session)
    return field.declination, problems


def session_field(session: Session) -> tuple[EarthField, tuple[Problem, ...]]:
    """Earth's field for a session, from the model at its place and date; a configured declination wins.

    The date comes from the fixes, else from the settings; what had to be assumed is returned as problems.
    """
    problems = []
    date = session_date(session)
    if date is None:
        date = datetime.date(int(LAST_YEAR) - MODEL_SPAN // 2, 1, 1)
        text = f"no date in the fixes or in session.toml; the magnetic model of {date.year} was used"
        problems.append(Problem("magnetic_model_date", text))
    field = earth_field(session.origin, date)
    if field.note:
        problems.append(Problem("magnetic_model", field.note))
    stated = session.config.magnetometer.declination_deg
    if stated is not None:
        turned = field_n(stated * DEG, field.inclination, field.strength)
        field = replace(field, declination=stated * DEG, field_n=turned)
    return field, tuple(problems)


def session_date(session: Session) -> datetime.date | None:
    """Return the UTC date of a session: from its fixes, else from its clock, else from the settings, else None.

    Of a receiver that is years back (before FIRST_YEAR) the settings know better, where they say anything.
    """
    assert session.gnss.unix_s is not None
    known = session.gnss.unix_s[np.isfinite(session.gnss.unix_s)]
    unix = float(np.median(known)) if known.size else session.unix_at_zero
    received = None
    if unix is not None and 0.0 < unix < 4.1e9:  # s, the year 2099; a later date is a damaged one
        received = datetime.datetime.fromtimestamp(unix, datetime.UTC).date()
    if received is not None and received.year >= FIRST_YEAR:
        return received
    try:
        return received if session.config.date is None else datetime.date.fromisoformat(session.config.date)
    except ValueError:
        return received
