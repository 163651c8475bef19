"""The motion sensor in the sheets of a recording: three accelerations and three turn rates, of one sheet or of two."""

from collections.abc import Sequence

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.samples import IMU_AXES_UNKNOWN, IMU_INCOMPLETE, Problem, RawImu
from smoother.session.checks.imu import screen_imu
from smoother.session.interpolated import FEW_BETWEEN, between_samples
from smoother.session.readers.sheet import Sheet

FORCES, RATES = ("ax", "ay", "az"), ("gx", "gy", "gz")
OF_VEHICLE = ("inlineacc", "lateralacc", "rollrate", "yawrate")  # axes of which the maker does not state
LONGEST_APART = 0.1  # s between the samples of one sensor, beyond which those of another are not interpolated
LIKE = 0.25  # squared correlation of what is across with the yaw rate; a car has 0.9, noise next to none
FEWEST_SAMPLES = 100  # that show by noise which of them were measured

Timed = tuple[Sheet, Array]  # a sheet and the times (N,) s of its rows


def imu_of(file: str, timed: Sequence[Timed]) -> tuple[RawImu | None, list[Problem]]:
    """The inertial samples of whichever sheets have forces and turn rates, and what to say of others."""
    forces = [one for one in timed if one[0].has(*FORCES)]
    rates = [one for one in timed if one[0].has(*RATES)]
    if not forces or not rates:
        return None, _unused(file, timed)
    both = next((one for one in forces if one[0].has(*RATES)), None)
    (of_force, t), (of_rate, rate_t) = (both, both) if both is not None else (_best(forces), _best(rates))
    accel = np.stack([of_force.value(axis) for axis in FORCES], axis=-1)
    gyro = np.stack([of_rate.value(axis, _usual_rate(of_force)) for axis in RATES], axis=-1)
    called = [column.name.lower() for axis in RATES if (column := of_rate.column(axis)) is not None]
    if of_force is of_rate:
        gyro = at_accelerations(t, accel, rate_t, gyro)
    else:
        gyro = _interpolated(t, rate_t, gyro)
    accel = _upright(of_force, accel)
    if called == ["roll", "pitch", "yaw"] and x_is_across(accel, gyro[:, 2]):
        gyro = gyro[:, [1, 0, 2]]
    rows = sampled_rows(t, [*accel.T, *gyro.T])
    t, accel, gyro = t[rows], accel[rows], gyro[rows]
    present = np.all(np.isfinite(accel), axis=1) & np.all(np.isfinite(gyro), axis=1) & np.isfinite(t)
    if not present.any():
        return None, []
    return screen_imu(of_force.file, t[present], accel[present], gyro[present])


def _best(timed: Sequence[Timed]) -> Timed:
    """The sheet whose columns have the better names: with gravity in place of without, of this sensor."""
    return min(timed, key=lambda one: _rank(one[0]))


def _rank(sheet: Sheet) -> int:
    column = sheet.column("ax") or sheet.column("gx")
    meaning = None if column is None else column.meaning(sheet.sensor)
    return 1000 if meaning is None else meaning.rank


def _usual_rate(of_force: Sheet) -> str:
    """Unit of turn rates that do not say it: degrees beside accelerations that are called by g."""
    column = of_force.column("ax")
    return "deg/s" if column is not None and column.name.lower().startswith("gforce") else ""


def _upright(of_force: Sheet, accel: Array) -> Array:
    """Forces (N, 3) of a sensor whose maker counts z downwards, and turns of it upwards."""
    down = of_force.about.get("z of forces") == "down" and float(np.nanmean(accel[:, 2])) < 0.0
    return accel * np.array([1.0, 1.0, -1.0]) if down else accel


def x_is_across(accel: Array, yaw_rate: Array) -> bool:
    """Whether x, and not y, of accelerations (N, 3) is the axis across the vehicle, about which it pitches: the one
    whose acceleration follows the yaw rate (N,)."""
    rows = np.all(np.isfinite(accel), axis=1) & np.isfinite(yaw_rate)
    x, y, rate = (values - np.mean(values) for values in (accel[rows, 0], accel[rows, 1], yaw_rate[rows]))
    of_x, of_y = ((rate @ axis) ** 2 / max((rate @ rate) * (axis @ axis), 1e-12) for axis in (x, y))
    return bool(of_x > max(of_y, LIKE))


def _unused(file: str, timed: Sequence[Timed]) -> list[Problem]:
    """What to say of a sensor of which channels are missing, or whose axes are not known."""
    called = [column.name for sheet, _ in timed for column in sheet.columns]
    if names := [name for name in called if name.lower().replace(" ", "") in OF_VEHICLE]:
        text = f"{file}: the inertial channels ({', '.join(names)}) are not used: their axes are not known"
        return [Problem(IMU_AXES_UNKNOWN, text)]
    present = {axis for sheet, _ in timed for axis in (*FORCES, *RATES) if sheet.has(axis)}
    missing = [axis for axis in (*FORCES, *RATES) if axis not in present]
    if len(missing) > len(FORCES):
        return []
    verb = "is missing" if len(missing) == 1 else "are missing"
    text = f"{file}: of the six channels of a motion sensor {', '.join(missing)} {verb}; the others are not used"
    return [Problem(IMU_INCOMPLETE, text)]


def at_accelerations(t: Array, accel: Array, rate_t: Array, gyro: Array) -> Array:
    """Turn rates (N, 3), also in rows t (N,) s of accelerations where the two sensors have rows of their own."""
    forced, turned = (np.isfinite(s) & np.all(np.isfinite(v), axis=1) for s, v in ((t, accel), (rate_t, gyro)))
    if not turned.any() or np.count_nonzero(forced & turned) > 0.5 * np.count_nonzero(forced):
        return gyro
    return np.where((forced & ~turned)[:, None], _interpolated(t, rate_t, gyro), gyro)


def _interpolated(t: Array, rate_t: Array, gyro: Array) -> Array:
    """Turn rates (M, 3) of times (M,) s at other times t (N,) s, between neighbours that are near; else NaN."""
    known = np.flatnonzero(np.isfinite(rate_t) & np.all(np.isfinite(gyro), axis=1))
    order = known[np.argsort(rate_t[known], kind="stable")]
    if order.size < 2:
        return np.full((t.size, 3), np.nan)
    at = rate_t[order]
    place = np.clip(np.searchsorted(at, t), 1, at.size - 1)
    near = (t >= at[0]) & (t <= at[-1]) & (np.maximum(t - at[place - 1], at[place] - t) < LONGEST_APART)
    between = np.stack([np.interp(t, at, gyro[order, axis]) for axis in range(3)], axis=-1)
    return np.where(near[:, None], between, np.nan)


def sampled_rows(t: Array, channels: Sequence[Array]) -> IntArray:
    """Which rows of t (N,) s are samples of the channels (N,), all unless many lie between samples, interpolated.

    Noise keeps six channels that were measured from lying on the lines between their neighbours.
    """
    known = np.flatnonzero(np.all(np.isfinite(channels), axis=0) & np.isfinite(t))
    if known.size < FEWEST_SAMPLES or np.any(np.diff(t[known]) < 0.0):
        return np.arange(t.size)
    known = known[np.append(True, np.diff(t[known]) > 0.0)]  # of rows of one time, the first
    between = between_samples(t[known], [channel[known] for channel in channels])
    return known[~between] if np.mean(between) > FEW_BETWEEN else np.arange(t.size)
