"""The rows of trajectory.csv in blocks, so that a session of any length takes the same memory.

A block is a `Rows`: columns by name, those of the file and, after `with_motion`, those every format needs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.frames import Origin, nwu_to_geodetic

BLOCK_BYTES = 4 << 20
LONGEST_LINE = 1 << 16  # bytes; a row has 33 numbers
SLOW = 0.5  # m/s; below, the direction of the velocity is noise, and the kart's own heading is used

REQUIRED = (
    *("t_s", "lat_deg", "lon_deg", "alt_m", "north_m", "west_m", "up_m"),
    *("vel_north_mps", "vel_west_mps", "vel_up_mps", "speed_mps"),
)
MOTION = ("roll_deg", "pitch_deg", "yaw_deg", "accel_forward_mps2", "accel_left_mps2", "accel_up_mps2", "yaw_rate_dps")
SIGMAS = (
    *("sigma_north_m", "sigma_west_m", "sigma_up_m"),
    *("sigma_vel_north_mps", "sigma_vel_west_mps", "sigma_vel_up_mps", "sigma_speed_mps"),
    *("sigma_roll_deg", "sigma_pitch_deg", "sigma_yaw_deg", "sigma_track_m"),
)
NUMBERS = (*REQUIRED, *MOTION, *SIGMAS, "lap_distance_m")
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")  # of a full circle
POSITIONS = ("north_m", "west_m", "up_m")
VELOCITIES = ("vel_north_mps", "vel_west_mps", "vel_up_mps")


@dataclass(frozen=True, eq=False)
class Rows:
    """A block of rows: columns by name, each (N,), NaN where unknown."""

    columns: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.columns["t_s"])

    def with_columns(self, **more: Array) -> "Rows":
        """Return these rows with columns added or replaced."""
        return Rows({**self.columns, **more})

    def part(self, rows: slice) -> "Rows":
        """Return some of the rows."""
        return Rows({name: column[rows] for name, column in self.columns.items()})


def joined(first: Rows | None, second: Rows) -> Rows:
    """Return two blocks as one."""
    if first is None:
        return second
    return Rows({name: np.concatenate([first[name], second[name]]) for name in second.columns})


def header_of(path: Path) -> list[str]:
    """Column names of trajectory.csv. Raises SessionError unless everything an export needs is there."""
    try:
        with path.open("rb") as file:
            names = file.readline(LONGEST_LINE).decode("utf-8", errors="replace").strip().split(",")
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({error.strerror or error})") from error
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise SessionError(f"{path}: no column {missing[0]}; smooth the session again")
    return names


def tables(path: Path, wanted: Sequence[str]) -> Iterator[pl.DataFrame]:
    """Yield the wanted columns of trajectory.csv block by block, as text or numbers as polars finds them."""
    header = ",".join(header_of(path)).encode() + b"\n"
    types = {name: pl.String if name == "utc" else pl.Float64 for name in wanted}
    for block in _blocks(path):
        try:
            yield pl.read_csv(BytesIO(header + block), columns=list(wanted), schema_overrides=types).select(wanted)
        except pl.exceptions.PolarsError as error:
            reason = str(error).splitlines()[0]
            raise SessionError(f"{path}: damaged ({reason}); smooth the session again") from error


def _blocks(path: Path) -> Iterator[bytes]:
    """Whole lines of a file after its first, a few megabytes at a time."""
    with path.open("rb") as file:
        file.readline(LONGEST_LINE)
        rest = b""
        while block := file.read(BLOCK_BYTES):
            whole, newline, rest_of_block = (rest + block).rpartition(b"\n")
            if not newline and len(rest_of_block) > LONGEST_LINE:
                raise SessionError(f"{path}: a row of {len(rest_of_block)} bytes; smooth the session again")
            rest = rest_of_block
            if whole.strip():
                yield whole
        if rest.strip():
            yield rest


def read_rows(path: Path) -> Iterator[Rows]:
    """Yield the numbers of trajectory.csv as blocks of rows; optional columns it does not have are NaN."""
    names = header_of(path)
    logged = logged_columns(names)
    present = [*(name for name in NUMBERS if name in names), *logged]
    for frame in tables(path, present):
        known = {name: frame[name].fill_null(np.nan).to_numpy() for name in present}
        unknown = np.full(frame.height, np.nan)
        yield Rows({name: known.get(name, unknown) for name in (*NUMBERS, *logged)})


def logged_columns(names: Sequence[str]) -> list[str]:
    """The columns of trajectory.csv that are channels of the logger: those behind its own."""
    behind = names.index("lap_distance_m") + 1 if "lap_distance_m" in names else len(names)
    return list(names[behind:])


def resampled(blocks: Iterator[Rows], rate: float, origin: Origin) -> Iterator[Rows]:
    """Yield the rows at `rate` Hz from the first on: positions by cubic Hermite, the rest linear."""
    before: Rows | None = None
    start, emitted = 0.0, 0
    for block in blocks:
        if before is None:
            start = float(block["t_s"][0])
        rows = joined(before, block)
        last = int(np.floor((rows["t_s"][-1] - start) * rate + 1e-6))
        t = start + np.arange(emitted, last + 1) / rate
        if t.size and len(rows) > 1:
            yield interpolated(rows, np.minimum(t, rows["t_s"][-1]), origin)
            emitted = last + 1
        elif t.size:
            yield rows
            emitted = 1
        before = rows.part(slice(-1, None))


def interpolated(rows: Rows, t: Array, origin: Origin) -> Rows:
    """Return the rows at times t (M,) s within them; there are two at least."""
    times = rows["t_s"]
    i = np.clip(np.searchsorted(times, t, side="right") - 1, 0, times.size - 2)
    step = times[i + 1] - times[i]
    u = (t - times[i]) / step
    columns = {}
    for name, column in rows.columns.items():
        left, change = column[i], column[i + 1] - column[i]
        columns[name] = left + u * change
    for name in ANGLES:
        change = (rows[name][i + 1] - rows[name][i] + 180.0) % 360.0 - 180.0
        columns[name] = 180.0 - (180.0 - rows[name][i] - u * change) % 360.0
    for position, velocity in zip(POSITIONS, VELOCITIES, strict=True):
        columns[position] = _hermite(rows[position], rows[velocity], i, u, step)
    distance = rows["lap_distance_m"]
    reset = distance[i + 1] < distance[i] - 5.0  # m; a track distance that falls by more has passed the line
    columns["lap_distance_m"] = np.where(reset, distance[np.where(u < 0.5, i, i + 1)], columns["lap_distance_m"])
    position_n = np.stack([columns[name] for name in POSITIONS], axis=-1)
    columns["lat_deg"], columns["lon_deg"], columns["alt_m"] = nwu_to_geodetic(position_n, origin)
    columns["t_s"] = t
    return Rows(columns)


def _hermite(value: Array, slope: Array, i: np.ndarray, u: Array, step: Array) -> Array:
    """Cubic through the values and slopes at rows i and i + 1, at share u (M,) of the step (M,) s between them."""
    a, b = value[i], value[i + 1]
    ma, mb = slope[i] * step, slope[i + 1] * step
    straight = a + u * (b - a)
    curved = a + u * (ma + u * (3.0 * (b - a) - 2.0 * ma - mb + u * (2.0 * (a - b) + ma + mb)))
    return np.asarray(np.where(np.isfinite(curved), curved, straight))


def with_motion(blocks: Iterator[Rows]) -> Iterator[Rows]:
    """Add course_deg, heading where the kart stands, distance_m driven, and accelerations where they are unknown.

    Without an inertial sensor the acceleration is that of the path, from the velocities half a step before and after.
    """
    held: Rows | None = None  # the row before the block, and its distance
    pending: Rows | None = None
    for block in blocks:
        if pending is not None:
            held = _moved(held, pending, block.part(slice(0, 1)))
            yield held
        pending = block
    if pending is not None:
        yield _moved(held, pending, None)


def _moved(before: Rows | None, rows: Rows, after: Rows | None) -> Rows:
    """One block with its neighbours: the block before (already done) and the first row after."""
    last = None if before is None else before.part(slice(-1, None))
    near = [part for part in (last, rows, after) if part is not None]
    t, north, west, speed = (
        np.concatenate([part[name] for part in near]) for name in ("t_s", "vel_north_mps", "vel_west_mps", "speed_mps")
    )
    here = slice(0 if last is None else 1, (0 if last is None else 1) + len(rows))
    driven = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))])
    distance = driven + (0.0 if last is None else float(last["distance_m"][0]))
    course = np.degrees(np.arctan2(-rows["vel_west_mps"], rows["vel_north_mps"]))
    yaw = rows["yaw_deg"]
    course = np.where((rows["speed_mps"] < SLOW) & np.isfinite(yaw), -yaw, course)
    forward, left = _path_acceleration(t, north, west, speed)
    turn = np.degrees(left / np.maximum(speed, SLOW))
    return rows.with_columns(
        course_deg=np.mod(course, 360.0),
        distance_m=distance[here],
        accel_forward_mps2=_filled(rows["accel_forward_mps2"], forward[here]),
        accel_left_mps2=_filled(rows["accel_left_mps2"], left[here]),
        yaw_rate_dps=_filled(rows["yaw_rate_dps"], turn[here]),
    )


def _filled(value: Array, instead: Array) -> Array:
    return np.where(np.isfinite(value), value, instead)


def _path_acceleration(t: Array, north: Array, west: Array, speed: Array) -> tuple[Array, Array]:
    """Acceleration (N,) m/s^2 along and to the left of the horizontal velocity; zero where the kart stands."""
    if t.size < 2:
        return np.zeros(t.size), np.zeros(t.size)
    north_rate, west_rate = np.gradient(north, t), np.gradient(west, t)
    moving = np.where(speed > SLOW, speed, np.inf)
    return (north_rate * north + west_rate * west) / moving, (west_rate * north - north_rate * west) / moving
