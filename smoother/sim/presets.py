"""The presets `white`, `kart` and `kart_harsh`: a table of figures, and the draw of one session from a column of it.

Of a range, a value is drawn uniformly; signs are random; everything is drawn once per session.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.errors import UsageError
from smoother.sim.motion import Motion
from smoother.sim.scenario import GnssErrors, ImuErrors, Interval, Jump, MagErrors, Scenario
from smoother.units import DEG, MILLISECOND, STANDARD_GRAVITY

Range = tuple[float, float]
_SIDES = 2.0 * np.pi


Figures = Mapping[str, Any]
PRESETS = ("white", "kart", "kart_harsh")
# SI; densities per sqrt(Hz), walks per sqrt(s)
TABLE: Mapping[str, tuple[Any, Any, Any]] = {
    "accel_noise": (0.05, 0.15, 0.5),
    "gyro_noise": (0.2 * DEG, 0.7 * DEG, 3.0 * DEG),
    "accel_tone": (0.5, 4.0, 8.0),
    "gyro_tone": (2.0 * DEG, 30.0 * DEG, 90.0 * DEG),
    "accel_bias": (0.2, 0.3, 0.5),
    "gyro_bias": (1.0 * DEG, 5.0 * DEG, 10.0 * DEG),
    "accel_bias_walk": (0.002, 0.003, 0.005),
    "gyro_bias_walk": (0.003 * DEG, 0.005 * DEG, 0.01 * DEG),
    "scale": (0.0, 0.01, 0.02),
    "misalignment": (0.0, 0.5 * DEG, 1.0 * DEG),
    "accel_range": (None, 16.0 * STANDARD_GRAVITY, 8.0 * STANDARD_GRAVITY),
    "gyro_range": (None, 1000.0 * DEG, 500.0 * DEG),
    "white_horizontal": (2.5, 0.2, 0.3),
    "white_up": (4.3, 0.35, 0.5),
    "offset_horizontal": (0.0, 2.0, 3.0),
    "offset_up": (0.0, 3.4, 5.0),
    "offset_tau": (60.0, 60.0, 40.0),
    "velocity_sigma": (0.15, 0.15, 0.25),
    "reported_factor": ((1.0, 1.0), (0.5, 2.0), None),  # None: no hacc and sacc in the file
    "position_latency": ((0.0, 0.0), (0.05, 0.2), (0.05, 0.4)),
    "extra_velocity_latency": ((0.0, 0.0), (0.04, 0.14), (0.0, 0.2)),
    "lever_arm": ((0.0, 0.0), (0.2, 0.6), (0.2, 0.6)),  # m, of each component
    "tilt": ((0.0, 0.0), (0.0, 30.0 * DEG), None),  # rad, about a level axis, after any yaw; None: any attitude
    "yaw": (0.0, np.pi, np.pi),  # rad, largest turn of the logger about up, to either side
    "standstill": (30.0, 5.0, None),
    "outages": ((), ((5.0, 5.0),), ((5.0, 20.0), (5.0, 20.0), (5.0, 20.0))),  # s, the length of each
    "jumps": (0, 0, 10),
    "jump_size": ((0.0, 0.0), (0.0, 0.0), (10.0, 50.0)),
    "clock_drift": (0.0, 50e-6, 200e-6),
    "jitter": (0.0, 1.0 * MILLISECOND, 4.0 * MILLISECOND),
    "imu_gaps": ((), (), (0.15,)),
    "hard_iron": (0.0, 0.6, 0.6),  # fraction of the Earth's field, each axis
    "soft_iron": (0.0, 0.1, 0.1),  # largest distortion of an axis or between axes
    "mag_calibration_points": (500, 0, 0),
    "mag_noise": (0.02, 0.02, 0.02),
    "engine_disturbance": (0.0, 0.05, 0.2),
}


def draw_scenario(preset: str, rng: np.random.Generator, track: str = "larkfield", duration: float = 600.0) -> Scenario:
    """Return a session of `preset` with its random values drawn. Raises UsageError for an unknown preset or track."""
    if preset not in PRESETS:
        raise UsageError(f"no preset named {preset!r}; there are {', '.join(PRESETS)}")
    figures = {name: row[PRESETS.index(preset)] for name, row in TABLE.items()}
    # One stream for each group: a figure added to one does not shift the draws of the others.
    imu_rng, gnss_rng, mag_rng, mounting_rng = rng.spawn(4)
    return Scenario(
        name=preset,
        track=track,
        duration=duration,
        motion=Motion(standstill=figures["standstill"]),
        imu=_draw_imu(figures, duration, imu_rng),
        gnss=_draw_gnss(figures, duration, gnss_rng),
        mag=_draw_mag(figures, mag_rng),
        R_bs=_draw_mounting(figures, mounting_rng),
        lever_arm_b=_signed(figures["lever_arm"], mounting_rng, 3),
    )


def _signed(value: float | Range, rng: np.random.Generator, count: int) -> Array:
    low, high = value if isinstance(value, tuple) else (value, value)
    return rng.choice([-1.0, 1.0], count) * rng.uniform(low, high, count)


def _within(limits: Range, rng: np.random.Generator, count: int) -> tuple[float, ...]:
    return tuple(rng.uniform(*limits, size=count).tolist())


def _same(figures: Figures, *names: str) -> dict[str, Any]:
    """Figures that a sensor has under the same name."""
    return {name: figures[name] for name in names}


def _draw_imu(figures: Figures, duration: float, rng: np.random.Generator) -> ImuErrors:
    return ImuErrors(
        **_same(figures, "accel_noise", "gyro_noise", "accel_bias_walk", "gyro_bias_walk", "accel_range", "gyro_range"),
        **_same(figures, "accel_tone", "gyro_tone", "jitter"),
        accel_bias=_signed(figures["accel_bias"], rng, 3),
        gyro_bias=_signed(figures["gyro_bias"], rng, 3),
        accel_matrix=_draw_matrix(figures, rng),
        gyro_matrix=_draw_matrix(figures, rng),
        bits=None if figures["accel_range"] is None else 16,
        clock_drift=float(_signed(figures["clock_drift"], rng, 1)[0]),
        gaps=_scattered(figures["imu_gaps"], duration, rng),
    )


def _draw_matrix(figures: Figures, rng: np.random.Generator) -> Array:
    """Scale factors on the diagonal, axis misalignments beside it, (3, 3)."""
    crooked = _signed(figures["misalignment"], rng, 9).reshape(3, 3)
    np.fill_diagonal(crooked, _signed(figures["scale"], rng, 3))
    return np.eye(3) + crooked


def _draw_gnss(figures: Figures, duration: float, rng: np.random.Generator) -> GnssErrors:
    factors = (None, None) if figures["reported_factor"] is None else _within(figures["reported_factor"], rng, 2)
    latency = rng.uniform(*figures["position_latency"])
    return GnssErrors(
        **_same(
            figures, "white_horizontal", "white_up", "offset_horizontal", "offset_up", "offset_tau", "velocity_sigma"
        ),
        position_latency=latency,
        velocity_latency=latency + rng.uniform(*figures["extra_velocity_latency"]),
        hacc_factor=factors[0],
        sacc_factor=factors[1],
        outages=_scattered(tuple(rng.uniform(*lengths) for lengths in figures["outages"]), duration, rng),
        jumps=_draw_jumps(figures, duration, rng),
        rounding=figures["offset_horizontal"] > 0.0,
    )


def _draw_jumps(figures: Figures, duration: float, rng: np.random.Generator) -> tuple[Jump, ...]:
    """Jumps in any level direction, of one to five fixes at 5 Hz."""
    jumps = []
    for interval in _scattered(_within((0.2, 1.0), rng, figures["jumps"]), duration, rng):
        size, direction = rng.uniform(*figures["jump_size"]), rng.uniform(0.0, _SIDES)
        offset_n = size * np.array([np.cos(direction), np.sin(direction), 0.0])
        jumps.append(Jump(interval.start, interval.duration, offset_n))
    return tuple(jumps)


def _scattered(lengths: tuple[float, ...], duration: float, rng: np.random.Generator) -> tuple[Interval, ...]:
    """Intervals of the given lengths at random times, one in each equal slice of the middle 90 % of the session."""
    if not lengths:
        return ()
    slice_length = 0.9 * duration / len(lengths)
    fitting = [min(length, 0.8 * slice_length) for length in lengths]  # a very short session gets shorter ones
    starts = [
        0.05 * duration + k * slice_length + rng.uniform(0.0, slice_length - length) for k, length in enumerate(fitting)
    ]
    return tuple(Interval(start, length) for start, length in zip(starts, fitting, strict=True))


def _draw_mag(figures: Figures, rng: np.random.Generator) -> MagErrors:
    distortion = rng.uniform(-figures["soft_iron"], figures["soft_iron"], (3, 3))
    direction = rng.standard_normal(3)
    return MagErrors(
        noise=figures["mag_noise"],
        # uT, to size the iron; the field itself comes from the World Magnetic Model
        hard_iron_s=_signed((0.0, figures["hard_iron"] * 50.0), rng, 3),
        soft_iron=np.eye(3) + 0.5 * (distortion + distortion.T),  # soft iron is symmetric
        engine_disturbance=figures["engine_disturbance"],
        calibration_points=figures["mag_calibration_points"],
        engine_direction_s=direction / np.linalg.norm(direction),
    )


def _draw_mounting(figures: Figures, rng: np.random.Generator) -> Array:
    """R_bs: any attitude, or a tilt about a level axis after a turn about up."""
    quaternion = rng.standard_normal(4)  # its direction is uniform on the sphere: any attitude alike
    yaw, tilt_axis = rng.uniform(-figures["yaw"], figures["yaw"]), rng.uniform(0.0, _SIDES)
    if figures["tilt"] is None:
        return so3.from_quaternion_wxyz(quaternion / np.linalg.norm(quaternion))
    tilt = rng.uniform(*figures["tilt"])
    level_axis = np.array([np.cos(tilt_axis), np.sin(tilt_axis), 0.0])
    return so3.exp(tilt * level_axis) @ so3.exp(np.array([0.0, 0.0, yaw]))
