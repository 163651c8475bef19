"""The presets `white`, `kart` and `kart_harsh`: a table of figures, and the draw of one session from a column of it.

Of a range, a value is drawn uniformly; signs are random; everything is drawn once per session.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.errors import UsageError
from smoother.sim.motion import Motion
from smoother.sim.scenario import GnssErrors, ImuErrors, Interval, Jump, MagErrors, NmeaRounding, Scenario
from smoother.units import DEG, MILLISECOND, STANDARD_GRAVITY

Range = tuple[float, float]
_EARTH_FIELD = 50.0  # uT, to size the iron; the field itself comes from the World Magnetic Model
_SIDES = 2.0 * np.pi


@dataclass(frozen=True)
class Figures:
    """One column of the table of presets. SI; densities per sqrt(Hz), walks per sqrt(s)."""

    accel_noise: float
    gyro_noise: float
    accel_tone: float
    gyro_tone: float
    accel_bias: float
    gyro_bias: float
    accel_bias_walk: float
    gyro_bias_walk: float
    scale: float
    misalignment: float
    accel_range: float | None
    gyro_range: float | None
    white_horizontal: float
    white_up: float
    offset_horizontal: float
    offset_up: float
    offset_tau: float
    velocity_sigma: float
    reported_factor: Range | None  # None: no hacc and sacc in the file
    position_latency: Range
    extra_velocity_latency: Range
    lever_arm: Range  # m, of each component
    tilt: Range | None  # rad, about a level axis, after any yaw; None: any attitude
    yaw: float  # rad, largest turn of the box about up, to either side
    standstill: float | None
    outages: tuple[Range, ...]  # s, the length of each
    jumps: int
    jump_size: Range
    clock_drift: float
    jitter: float
    imu_gaps: tuple[float, ...]
    hard_iron: float  # fraction of the Earth's field, each axis
    soft_iron: float  # largest distortion of an axis or between axes
    mag_calibration_points: int
    mag_noise: float
    engine_disturbance: float


WHITE = Figures(
    accel_noise=0.05,
    gyro_noise=0.2 * DEG,
    accel_tone=0.5,
    gyro_tone=2.0 * DEG,
    accel_bias=0.2,
    gyro_bias=1.0 * DEG,
    accel_bias_walk=0.002,
    gyro_bias_walk=0.003 * DEG,
    scale=0.0,
    misalignment=0.0,
    accel_range=None,
    gyro_range=None,
    white_horizontal=2.5,
    white_up=4.3,
    offset_horizontal=0.0,
    offset_up=0.0,
    offset_tau=60.0,
    velocity_sigma=0.15,
    reported_factor=(1.0, 1.0),
    position_latency=(0.0, 0.0),
    extra_velocity_latency=(0.0, 0.0),
    lever_arm=(0.0, 0.0),
    tilt=(0.0, 0.0),
    yaw=0.0,
    standstill=30.0,
    outages=(),
    jumps=0,
    jump_size=(0.0, 0.0),
    clock_drift=0.0,
    jitter=0.0,
    imu_gaps=(),
    hard_iron=0.0,
    soft_iron=0.0,
    mag_calibration_points=500,
    mag_noise=0.02,
    engine_disturbance=0.0,
)
KART = Figures(
    accel_noise=0.15,
    gyro_noise=0.7 * DEG,
    accel_tone=4.0,
    gyro_tone=30.0 * DEG,
    accel_bias=0.3,
    gyro_bias=5.0 * DEG,
    accel_bias_walk=0.003,
    gyro_bias_walk=0.005 * DEG,
    scale=0.01,
    misalignment=0.5 * DEG,
    accel_range=16.0 * STANDARD_GRAVITY,
    gyro_range=1000.0 * DEG,
    white_horizontal=0.2,
    white_up=0.35,
    offset_horizontal=2.0,
    offset_up=3.4,
    offset_tau=60.0,
    velocity_sigma=0.15,
    reported_factor=(0.5, 2.0),
    position_latency=(0.05, 0.2),
    extra_velocity_latency=(0.04, 0.14),
    lever_arm=(0.2, 0.6),
    tilt=(0.0, 30.0 * DEG),
    yaw=np.pi,
    standstill=5.0,
    outages=((5.0, 5.0),),
    jumps=0,
    jump_size=(0.0, 0.0),
    clock_drift=50e-6,
    jitter=1.0 * MILLISECOND,
    imu_gaps=(),
    hard_iron=0.6,
    soft_iron=0.1,
    mag_calibration_points=0,
    mag_noise=0.02,
    engine_disturbance=0.05,
)
KART_HARSH = Figures(
    accel_noise=0.5,
    gyro_noise=3.0 * DEG,
    accel_tone=8.0,
    gyro_tone=90.0 * DEG,
    accel_bias=0.5,
    gyro_bias=10.0 * DEG,
    accel_bias_walk=0.005,
    gyro_bias_walk=0.01 * DEG,
    scale=0.02,
    misalignment=1.0 * DEG,
    accel_range=8.0 * STANDARD_GRAVITY,
    gyro_range=500.0 * DEG,
    white_horizontal=0.3,
    white_up=0.5,
    offset_horizontal=3.0,
    offset_up=5.0,
    offset_tau=40.0,
    velocity_sigma=0.25,
    reported_factor=None,
    position_latency=(0.05, 0.4),
    extra_velocity_latency=(0.0, 0.2),
    lever_arm=(0.2, 0.6),
    tilt=None,
    yaw=np.pi,
    standstill=None,
    outages=((5.0, 20.0), (5.0, 20.0), (5.0, 20.0)),
    jumps=10,
    jump_size=(10.0, 50.0),
    clock_drift=200e-6,
    jitter=4.0 * MILLISECOND,
    imu_gaps=(0.15,),
    hard_iron=0.6,
    soft_iron=0.1,
    mag_calibration_points=0,
    mag_noise=0.02,
    engine_disturbance=0.2,
)

PRESETS: Mapping[str, Figures] = MappingProxyType({"white": WHITE, "kart": KART, "kart_harsh": KART_HARSH})


def draw_scenario(preset: str, rng: np.random.Generator, track: str = "larkfield", duration: float = 600.0) -> Scenario:
    """Return a session of `preset` with its random values drawn. Raises UsageError for an unknown preset or track."""
    if preset not in PRESETS:
        raise UsageError(f"no preset named {preset!r}; there are {', '.join(PRESETS)}")
    figures = PRESETS[preset]
    # One stream for each group: a figure added to one does not shift the draws of the others.
    imu_rng, gnss_rng, mag_rng, mounting_rng = rng.spawn(4)
    return Scenario(
        name=preset,
        track=track,
        duration=duration,
        motion=Motion(standstill=figures.standstill),
        imu=_draw_imu(figures, duration, imu_rng),
        gnss=_draw_gnss(figures, duration, gnss_rng),
        mag=_draw_mag(figures, mag_rng),
        R_bs=_draw_mounting(figures, mounting_rng),
        lever_arm_b=_signed(figures.lever_arm, mounting_rng, 3),
    )


def _signed(value: float | Range, rng: np.random.Generator, count: int) -> Array:
    low, high = value if isinstance(value, tuple) else (value, value)
    return rng.choice([-1.0, 1.0], count) * rng.uniform(low, high, count)


def _draw_imu(figures: Figures, duration: float, rng: np.random.Generator) -> ImuErrors:
    return ImuErrors(
        accel_noise=figures.accel_noise,
        gyro_noise=figures.gyro_noise,
        accel_bias=_signed(figures.accel_bias, rng, 3),
        gyro_bias=_signed(figures.gyro_bias, rng, 3),
        accel_bias_walk=figures.accel_bias_walk,
        gyro_bias_walk=figures.gyro_bias_walk,
        accel_matrix=_draw_matrix(figures, rng),
        gyro_matrix=_draw_matrix(figures, rng),
        accel_range=figures.accel_range,
        gyro_range=figures.gyro_range,
        bits=None if figures.accel_range is None else 16,
        accel_tone=figures.accel_tone,
        gyro_tone=figures.gyro_tone,
        clock_drift=float(_signed(figures.clock_drift, rng, 1)[0]),
        jitter=figures.jitter,
        gaps=_scattered(figures.imu_gaps, duration, rng),
    )


def _draw_matrix(figures: Figures, rng: np.random.Generator) -> Array:
    """Scale factors on the diagonal, axis misalignments beside it, (3, 3)."""
    crooked = _signed(figures.misalignment, rng, 9).reshape(3, 3)
    np.fill_diagonal(crooked, _signed(figures.scale, rng, 3))
    return np.eye(3) + crooked


def _draw_gnss(figures: Figures, duration: float, rng: np.random.Generator) -> GnssErrors:
    factors = (None, None) if figures.reported_factor is None else tuple(rng.uniform(*figures.reported_factor, 2))
    latency = rng.uniform(*figures.position_latency)
    return GnssErrors(
        white_horizontal=figures.white_horizontal,
        white_up=figures.white_up,
        offset_horizontal=figures.offset_horizontal,
        offset_up=figures.offset_up,
        offset_tau=figures.offset_tau,
        velocity_sigma=figures.velocity_sigma,
        position_latency=latency,
        velocity_latency=latency + rng.uniform(*figures.extra_velocity_latency),
        hacc_factor=factors[0],
        sacc_factor=factors[1],
        outages=_scattered(tuple(rng.uniform(*lengths) for lengths in figures.outages), duration, rng),
        jumps=_draw_jumps(figures, duration, rng),
        rounding=None if figures.offset_horizontal == 0.0 else NmeaRounding(),
    )


def _draw_jumps(figures: Figures, duration: float, rng: np.random.Generator) -> tuple[Jump, ...]:
    """Jumps in any level direction, of one to five fixes at 5 Hz."""
    jumps = []
    for interval in _scattered(tuple(rng.uniform(0.2, 1.0, figures.jumps)), duration, rng):
        size, direction = rng.uniform(*figures.jump_size), rng.uniform(0.0, _SIDES)
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
    distortion = rng.uniform(-figures.soft_iron, figures.soft_iron, (3, 3))
    direction = rng.standard_normal(3)
    return MagErrors(
        noise=figures.mag_noise,
        hard_iron_s=_signed((0.0, figures.hard_iron * _EARTH_FIELD), rng, 3),
        soft_iron=np.eye(3) + 0.5 * (distortion + distortion.T),  # soft iron is symmetric
        engine_disturbance=figures.engine_disturbance,
        calibration_points=figures.mag_calibration_points,
        engine_direction_s=direction / np.linalg.norm(direction),
    )


def _draw_mounting(figures: Figures, rng: np.random.Generator) -> Array:
    """R_bs: any attitude, or a tilt about a level axis after a turn about up."""
    quaternion = rng.standard_normal(4)  # its direction is uniform on the sphere: any attitude alike
    yaw, tilt_axis = rng.uniform(-figures.yaw, figures.yaw), rng.uniform(0.0, _SIDES)
    if figures.tilt is None:
        return so3.from_quaternion_wxyz(quaternion / np.linalg.norm(quaternion))
    tilt = rng.uniform(*figures.tilt)
    level_axis = np.array([np.cos(tilt_axis), np.sin(tilt_axis), 0.0])
    return so3.exp(tilt * level_axis) @ so3.exp(np.array([0.0, 0.0, yaw]))
