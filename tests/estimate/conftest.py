"""Fixes of a vehicle on a smooth closed lap, truth known from a formula, with every flaw of a receiver settable."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from smoother.arrays import Array, BoolArray
from smoother.config import GnssTiming, SessionConfig
from smoother.frames import Origin, nwu_to_geodetic
from smoother.samples import GnssFixes, Session

ORIGIN = Origin(45.0, 12.0, 50.0)
LAP = 50.0  # s
# amplitude m, harmonic of the lap, phase: up to 25 m/s and 15 m/s^2, like a kart
HARMONICS = (
    ((120.0, 1, 0.3), (40.0, 3, 1.0), (12.0, 7, 2.0), (5.0, 11, 0.4)),
    ((90.0, 1, 1.9), (35.0, 2, 0.5), (15.0, 5, 2.2), (6.0, 9, 1.3)),
    ((2.0, 1, 0.0),),
)


def lap_motion(t: Array, derivative: int = 0) -> Array:
    """Position or its derivative in n, (N, 3), at times t (N,) s."""
    value = np.zeros((t.size, 3))
    for axis, terms in enumerate(HARMONICS):
        for amplitude, harmonic, phase in terms:
            rate = 2.0 * np.pi * harmonic / LAP
            value[:, axis] += amplitude * rate**derivative * np.sin(rate * t + phase + 0.5 * np.pi * derivative)
    return value


@dataclass(frozen=True, eq=False)
class LapFixes:
    """A session, which of its fixes were displaced (M,), and the true slow offset of each (M, 3) m."""

    session: Session
    is_bad: BoolArray
    offset_n: Array


def lap_fixes(
    seed: int = 0,
    duration: float = 100.0,
    rate: float = 5.0,
    white: Sequence[float] = (0.2, 0.2, 0.35),
    offset: Sequence[float] = (2.0, 2.0, 3.4),
    tau: float = 60.0,
    doppler: float | None = 0.15,
    latency: float = 0.0,
    lag: float = 0.1,
    jumps: Sequence[tuple[float, float, float]] = (),
    outages: Sequence[tuple[float, float]] = (),
    has_altitude: bool = True,
    is_still: bool = False,
) -> LapFixes:
    """Fixes with white and Gauss-Markov noise per axis; jumps are (start s, end s, metres), outages (start, end) s."""
    rng = np.random.default_rng(seed)
    t = 1.0 + np.arange(round(duration * rate)) / rate
    t = t[~np.any([(t >= a) & (t < b) for a, b in outages], axis=0)] if outages else t
    still = np.zeros_like(t) if is_still else t
    moving = 0.0 if is_still else 1.0
    keep = np.exp(-np.diff(t, prepend=t[0]) / tau)
    drive = rng.normal(size=(t.size, 3)) * np.asarray(offset)
    slow = drive.copy()
    for k in range(1, t.size):
        slow[k] = keep[k] * slow[k - 1] + np.sqrt(1.0 - keep[k] ** 2) * drive[k]
    position = lap_motion(still - latency) + slow + rng.normal(size=(t.size, 3)) * np.asarray(white)
    is_bad = np.zeros(t.size, dtype=np.bool_)
    for start, end, size in jumps:
        rows, angle = (t >= start) & (t < end), rng.uniform(0.0, 2.0 * np.pi)
        position[rows, :2] += size * np.array([np.cos(angle), np.sin(angle)])
        is_bad |= rows
    velocity = np.full((t.size, 3), np.nan)
    if doppler is not None:
        velocity[:, :2] = moving * lap_motion(still - latency - lag, 1)[:, :2] + doppler * rng.normal(size=(t.size, 2))
    lat, lon, alt = nwu_to_geodetic(position, ORIGIN)
    fixes = GnssFixes(t, lat, lon, alt if has_altitude else np.full(t.size, np.nan), velocity)
    config = SessionConfig(gps=GnssTiming(position_latency=latency if latency else None))
    return LapFixes(Session("lap", fixes, ORIGIN, config=config), is_bad, slow)


@pytest.fixture(name="lap_fixes", scope="session")
def lap_fixes_fixture() -> Callable[..., LapFixes]:
    return lap_fixes


@pytest.fixture(name="lap_motion")
def lap_motion_fixture() -> Callable[..., Array]:
    return lap_motion
