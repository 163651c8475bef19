"""Scenario: every figure of a simulated session, each separately settable; presets.py draws them.

A Scenario holds the true values that an estimator has to find (biases, latencies, lever arm, mounting); what is left
to chance when it is simulated is noise. Nothing here computes a sample.
"""

import dataclasses
import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from smoother.arrays import Array, frozen
from smoother.errors import UsageError
from smoother.sim.figures import require_figures
from smoother.sim.motion import Motion
from smoother.sim.track import TRACKS


def _zeros() -> Array:
    return frozen(np.zeros(3), (3,), "zeros")


def _identity() -> Array:
    return frozen(np.eye(3), (3, 3), "identity")


def _check(figures: object, **shapes: tuple[int, ...]) -> None:
    """Make the named arrays read-only. Raises UsageError for a wrong shape or a rate that is not above zero."""
    for name, shape in shapes.items():
        try:
            value = frozen(getattr(figures, name), shape, name)
        except (TypeError, ValueError) as error:
            raise UsageError(f"{error} of finite numbers") from error
        object.__setattr__(figures, name, value)
    if not (rate := getattr(figures, "rate", 1.0)) > 0.0:
        raise UsageError(f"a rate of {rate} Hz gives no samples; leave the sensor out instead")


@dataclass(frozen=True)
class Interval:
    """A stretch of true time, s since the start of the session."""

    start: float
    duration: float


@dataclass(frozen=True, eq=False)
class Jump:
    """Fixes between start and start + duration are displaced by offset_n (3,) m, as multipath does."""

    start: float
    duration: float
    offset_n: Array

    def __post_init__(self) -> None:
        _check(self, offset_n=(3,))


@dataclass(frozen=True, eq=False)
class ImuErrors:
    """Inertial unit. `measured = matrix @ true_s + bias + noise + vibration`, then clipped and rounded.

    accel_noise, gyro_noise: density within the band left by the anti-alias filter, m/s^2/sqrt(Hz), rad/s/sqrt(Hz).
    bias_walk: per sqrt(s). tone: amplitude per axis of the engine's fundamental while driving, before the filter;
    `harmonics` are the amplitudes of the engine orders 1, 2, .. relative to it. anti_alias_hz None: no filter.
    jitter: one sigma of the stamps; they stay in order as a logger's do. clock_offset, clock_drift: of the session's
    clock, which stamps fixes too (drift 50e-6 is 50 ppm). latency: delay of the samples against their stamps;
    accel_delay: that of the force beyond the rate's, as of a slower filter; vibration, of any phase, has none.
    """

    rate: float = 200.0  # Hz
    accel_noise: float = 0.0
    gyro_noise: float = 0.0
    accel_bias: Array = field(default_factory=_zeros)  # (3,) m/s^2 in s
    gyro_bias: Array = field(default_factory=_zeros)  # (3,) rad/s in s
    accel_bias_walk: float = 0.0
    gyro_bias_walk: float = 0.0
    accel_matrix: Array = field(default_factory=_identity)  # scale and axis misalignment
    gyro_matrix: Array = field(default_factory=_identity)
    accel_range: float | None = None  # m/s^2, None: never clips
    gyro_range: float | None = None  # rad/s
    bits: int | None = None  # of the converter over the range; None: not rounded
    accel_tone: float = 0.0  # m/s^2
    gyro_tone: float = 0.0  # rad/s
    harmonics: tuple[float, ...] = (1.0, 0.5, 0.25)
    anti_alias_hz: float | None = 92.0  # the MPU9250's DLPF setting 2
    clock_offset: float = 0.0  # s
    clock_drift: float = 0.0
    jitter: float = 0.0  # s
    latency: float = 0.0  # s
    accel_delay: float = 0.0  # s
    gaps: tuple[Interval, ...] = ()

    def __post_init__(self) -> None:
        _check(self, accel_bias=(3,), gyro_bias=(3,), accel_matrix=(3, 3), gyro_matrix=(3, 3))
        noises = ("accel_noise", "gyro_noise", "accel_bias_walk", "gyro_bias_walk", "accel_tone", "gyro_tone", "jitter")
        require_figures(self, "imu", noises, ("accel_range", "gyro_range", "anti_alias_hz"))

    @property
    def filter_delay(self) -> float | None:
        """Stated delay s of the logger's low-pass, half a sample; None where samples have a further delay.

        A smoother has to identify that.
        """
        return 0.5 / self.rate if self.latency == self.accel_delay == 0.0 else None


@dataclass(frozen=True, eq=False)
class GnssErrors:
    """Receiver. A row stamped t_s holds the position true at t_s - position_latency, velocity likewise.

    Sigmas are per axis. offset_*: first-order Gauss-Markov error with time constant offset_tau; of velocities, beside
    what is white in them (velocity_sigma), velocity_lasting with velocity_tau. hacc_factor scales the reported position
    sigmas, sacc_factor the reported velocity sigma (1: the truth; None: not reported).
    """

    rate: float = 5.0  # Hz
    white_horizontal: float = 0.0  # m
    white_up: float = 0.0  # m
    offset_horizontal: float = 0.0  # m
    offset_up: float = 0.0  # m
    offset_tau: float = 60.0  # s
    velocity: bool = True  # speed and course are in the sentences
    has_vertical_velocity: bool = False
    velocity_sigma: float = 0.0  # m/s
    velocity_lasting: float = 0.0  # m/s
    velocity_tau: float = 1.5  # s
    position_latency: float = 0.0  # s
    velocity_latency: float = 0.0  # s, the whole delay, not the part beyond position_latency
    receive_jitter: float = 0.0  # s, mean of an exponential extra delay of the stamp
    hacc_factor: float | None = 1.0
    sacc_factor: float | None = 1.0
    outages: tuple[Interval, ...] = ()
    jumps: tuple[Jump, ...] = ()
    rounding: bool = False  # to the last digit of the sentences of a NEO-6M

    def __post_init__(self) -> None:
        _check(self)
        positions = ("white_horizontal", "white_up", "offset_horizontal", "offset_up")
        others = ("velocity_sigma", "velocity_lasting", "receive_jitter", "hacc_factor", "sacc_factor")
        require_figures(self, "gnss", (*positions, *others), ("offset_tau", "velocity_tau"))


@dataclass(frozen=True, eq=False)
class MagErrors:
    """Magnetometer. `measured = soft_iron @ (field_s + engine) + hard_iron_s + noise`, in microtesla.

    noise and engine_disturbance are fractions of the field's strength; the engine's field points along
    engine_direction_s and grows with rpm and throttle. inclination and declination come from the World Magnetic Model
    unless field_n (3,) uT says otherwise. calibration_points: readings taken while
    the logger is turned in all directions before the session, as in magcalib.txt; 0 leaves it uncalibrated.
    """

    rate: float = 10.0  # Hz
    noise: float = 0.0
    hard_iron_s: Array = field(default_factory=_zeros)  # (3,) uT
    soft_iron: Array = field(default_factory=_identity)  # (3, 3)
    engine_disturbance: float = 0.0
    engine_direction_s: Array = field(default_factory=lambda: frozen(np.array([1.0, 0.0, 0.0]), (3,), "direction"))
    field_n: Array | None = None
    calibration_points: int = 0
    resolution: float | None = None  # uT per count, 0.15 of the AK8963; None: not rounded

    def __post_init__(self) -> None:
        _check(self, hard_iron_s=(3,), soft_iron=(3, 3), engine_direction_s=(3,))
        if self.field_n is not None:
            _check(self, field_n=(3,))
        require_figures(self, "mag", ("noise", "calibration_points"), ("resolution",))


@dataclass(frozen=True)
class WheelErrors:
    """Sensor of a wheel's speed: that of the kart there, forwards, times 1 + scale + slip * forward acceleration.

    side: of the wheel, to the left of the IMU. noise is white; lasting, with lasting_tau, a first-order Gauss-Markov
    error. A speed stamped t_s was true at t_s - latency.
    """

    rate: float = 0.0  # Hz, 0: there is none
    scale: float = 0.0
    slip: float = 0.0  # s^2/m
    side: float = 0.0  # m
    latency: float = 0.0  # s
    noise: float = 0.0  # m/s
    lasting: float = 0.0  # m/s
    lasting_tau: float = 1.5  # s

    def __post_init__(self) -> None:
        require_figures(self, "wheel", ("rate", "noise", "lasting"), ("lasting_tau",))


@dataclass(frozen=True, eq=False)
class Scenario:
    """One simulated session: where, how long, how driven, and with which sensors. None leaves a sensor out."""

    name: str = "ideal"
    track: str = "larkfield"
    duration: float = 600.0  # s
    start_unix: float = 1778925600.0  # 2026-05-16 10:00 UTC, inside the World Magnetic Model 2025
    motion: Motion = field(default_factory=Motion)
    imu: ImuErrors | None = field(default_factory=ImuErrors)
    gnss: GnssErrors = field(default_factory=GnssErrors)
    mag: MagErrors | None = field(default_factory=MagErrors)
    wheel: WheelErrors = field(default_factory=WheelErrors)
    R_bs: Array = field(default_factory=_identity)
    lever_arm_b: Array = field(default_factory=_zeros)

    def __post_init__(self) -> None:
        if self.track not in TRACKS:
            raise UsageError(f"no track named {self.track!r}; there are {', '.join(TRACKS)}")
        if not self.duration > 0.0:
            raise UsageError(f"a session of {self.duration} s cannot be simulated; ask for more than 0 s")
        _check(self, R_bs=(3, 3), lever_arm_b=(3,))
        require_figures(self, "")


GROUPS: Mapping[str, type] = {
    "motion": Motion,
    "imu": ImuErrors,
    "gnss": GnssErrors,
    "mag": MagErrors,
    "wheel": WheelErrors,
}


def with_changes(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """Return a copy with some figures changed; a key is a field, or `group.field` as in `gnss.rate`.

    `group_field` is accepted for `group.field`. Raises UsageError for a key that does not exist, naming the nearest.
    """
    for key, value in changes.items():
        group, name = _split(key)
        if group is None:
            scenario = dataclasses.replace(scenario, **{name: value})
            continue
        part = getattr(scenario, group)
        if part is None:
            raise UsageError(f"{key}: this scenario has no {group}")
        scenario = dataclasses.replace(scenario, **{group: dataclasses.replace(part, **{name: value})})
    return scenario


def _split(key: str) -> tuple[str | None, str]:
    known: dict[str, tuple[str | None, str]] = {f.name: (None, f.name) for f in dataclasses.fields(Scenario)}
    for group, kind in GROUPS.items():
        known.update({f"{group}.{f.name}": (group, f.name) for f in dataclasses.fields(kind)})
        known.update({f"{group}_{f.name}": (group, f.name) for f in dataclasses.fields(kind)})
    if key not in known:
        figures = [name for name in known if name not in GROUPS]  # a group is none by itself
        nearest = difflib.get_close_matches(key, figures, n=1, cutoff=0.0)
        raise UsageError(f"no figure named {key!r}; the nearest is {nearest[0]!r}")
    return known[key]
