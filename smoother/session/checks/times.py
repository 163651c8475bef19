"""Checks of what of a recording runs together: gaps, drives of several days, samples without fixes, wheel speed."""

from functools import partial

import numpy as np

from smoother.arrays import Array, median
from smoother.frames import Origin
from smoother.samples import IMU_AFTER_FIXES, IMU_BEFORE_FIXES, GnssFixes
from smoother.session.checks.table import Check, Finding
from smoother.session.clock import are_fix_gaps
from smoother.session.recorded import Recording
from smoother.words import counted, span

SLOWEST_FIXES = 20.0  # s from one to the next; a kart is somewhere else by then
LONGEST_PAUSE = 8.0 * 3600.0  # s without a fix within one recording; heats of one day are nearer
FEW_OUTSIDE = 0.01  # share of the fixes
LEAST_UNFIXED = (10.0, 0.05)  # s and share of the IMU's recording, before the first fix or after the last
DRIVING = 3.0  # m/s by the fixes, from which on the two are compared
FEWEST_DRIVING = 20  # fixes at speed
LEAST_RATIO, LARGEST_RATIO = 0.7, 1.4  # of the wheel's speed over that of the fixes; km/h have 3.6, mph 2.2


def gaps(r: Recording) -> Finding | None:
    """Fixes that are missing."""
    steps = np.diff(r.gnss.t)
    found = steps[are_fix_gaps(steps)] if steps.size else steps
    if not found.size:
        return None
    return Finding(f"{counted(found.size, 'gap')} in the fixes, the longest {span(found.max())}", int(found.size))


def too_rare(r: Recording) -> Finding | None:
    """Fixes between which the motion of a kart is not known."""
    steps = np.diff(r.gnss.t)
    usual = float(np.median(steps)) if steps.size else 0.0
    return Finding(f"a fix only every {usual:.0f} s; is t_s in seconds?") if usual > SLOWEST_FIXES else None


def several_drives(r: Recording) -> Finding | None:
    """Drives of several days: the one with most fixes is used. A trajectory of the night between says nothing."""
    t = r.gnss.t
    cuts = np.flatnonzero(np.diff(t) > LONGEST_PAUSE) + 1
    if not cuts.size:
        return None
    bounds = np.concatenate([[0], cuts, [t.size]])
    most = int(np.argmax(np.diff(bounds)))
    lost = np.ones(t.size, dtype=np.bool_)
    lost[bounds[most] : bounds[most + 1]] = False
    count, longest = int(np.count_nonzero(lost)), float(np.max(np.diff(t)))
    at = ", ".join(f"{t[cut - 1]:.0f} s" for cut in cuts[:5].tolist())
    text = f"{cuts.size + 1} recordings, with up to {span(longest)} between them; number {most + 1} is used"
    return Finding(f"{text}, {counted(count, 'fix')} of the others left out. Split the files at {at}", count, drop=lost)


def rows_of_other_drives(stream: str, r: Recording) -> Finding | None:
    """Rows of those other drives, of which the fixes are left out."""
    t, first, last = r.stream(stream).t, r.gnss.t[0], r.gnss.t[-1]
    if len(t) == 0 or (t[0] > first - LONGEST_PAUSE and t[-1] < last + LONGEST_PAUSE):
        return None
    lost = (t < first - LONGEST_PAUSE) | (t > last + LONGEST_PAUSE)
    none_left = stream == "imu" and np.all(lost)
    return Finding("no sample in the recording that is used: smoothed from GPS alone" if none_left else "", drop=lost)


def outside(r: Recording) -> Finding | None:
    """Fixes beside which no samples were recorded."""
    t, imu_t = r.gnss.t, r.samples.t
    count = int(np.count_nonzero((t < imu_t[0]) | (t > imu_t[-1])))
    if count <= FEW_OUTSIDE * t.size:
        return None
    return Finding(f"{count} of {t.size} fixes lie before or after the IMU's recording", count)


def unfixed(when: str, r: Recording) -> Finding | None:
    """Samples long before the first fix or after the last: no result is given there."""
    t, imu_t = r.gnss.t, r.samples.t
    lasts = t[0] - imu_t[0] if when == "before" else imu_t[-1] - t[-1]
    if lasts <= max(LEAST_UNFIXED[0], LEAST_UNFIXED[1] * (imu_t[-1] - imu_t[0])):
        return None
    if when == "before":
        text = f"the first fix comes {lasts:.0f} s after the IMU's first sample; nothing is smoothed before it"
    else:
        text = f"the last fix comes {lasts:.0f} s before the IMU's last sample; nothing is smoothed after it"
        text += "; did the GPS stop?"
    return Finding(text)


def empty(r: Recording) -> Finding | None:
    """A wheel speed of which no row was usable."""
    assert r.wheel_speed is not None
    return None if len(r.wheel_speed.t) else _unused(r, "no usable row; smoothed without wheel speed")


def alone(r: Recording) -> Finding | None:
    """A wheel speed without samples beside it."""
    text = "not used; a wheel speed needs inertial samples beside it"
    return _unused(r, text) if r.imu is None else None


def unlike(r: Recording) -> Finding | None:
    """A wheel speed that is in another unit, or of another vehicle."""
    wheel, gnss, speed = r.wheel_speed, r.gnss, _speed(r.gnss)
    assert wheel is not None
    with np.errstate(invalid="ignore"):
        driving = (speed > DRIVING) & (gnss.t > wheel.t[0]) & (gnss.t < wheel.t[-1])
    if np.count_nonzero(driving) < FEWEST_DRIVING:
        return None
    ratio = median(np.interp(gnss.t[driving], wheel.t, wheel.speed) / speed[driving])
    if LEAST_RATIO <= ratio <= LARGEST_RATIO:
        return None
    return _unused(r, f"the wheel is {ratio:.2f} times as fast as the fixes; not used. Is speed_mps in m/s?")


def _unused(r: Recording, text: str) -> Finding:
    assert r.wheel_speed is not None
    return Finding(text, drop=np.ones(len(r.wheel_speed.t), dtype=np.bool_))


def _speed(gnss: GnssFixes) -> Array:
    """Speed (N,) m/s of the fixes: as measured, else by their distances."""
    measured = np.hypot(gnss.velocity_n[:, 0], gnss.velocity_n[:, 1])
    if np.isfinite(measured).any() or len(gnss) < 2:
        return np.asarray(measured)
    position_n = gnss.position_n(Origin(float(gnss.lat_deg[0]), float(gnss.lon_deg[0]), 0.0))
    return np.asarray(np.hypot(*(np.gradient(position_n[:, i], gnss.t) for i in (0, 1))))


GAPS = (
    Check("gps_too_slow", "fixes", (), too_rare),
    Check("gps_gap", "fixes", (), gaps),
    Check("recordings_apart", "fixes", (), several_drives),
    *(
        Check("recordings_apart", stream, (), partial(rows_of_other_drives, stream))
        for stream in ("imu", "mag", "wheel_speed")
    ),
)
TOGETHER = (
    Check("gps_outside_imu", "fixes", (), outside),
    Check(IMU_BEFORE_FIXES, "fixes", (), partial(unfixed, "before")),
    Check(IMU_AFTER_FIXES, "fixes", (), partial(unfixed, "after")),
)
WHEEL_CHECKS = (
    Check("wheel_speed_empty", "wheel_speed", (), empty),
    Check("wheel_speed_unused", "wheel_speed", (), alone),
    Check("wheel_speed_unlike", "wheel_speed", (), unlike),
)
