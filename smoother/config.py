"""SessionConfig: what a person may state about a session. Values only; `session.toml` is read in session/settings.py.

Every field is optional. None means: estimate it, or use the documented default where it cannot be estimated.
"""

from dataclasses import dataclass, field

from smoother.arrays import Array


@dataclass(frozen=True)
class Mounting:
    """Mounting of the logger: `lever_arm_b` (3,) m from IMU to antenna; `R_bs` (3, 3), sensor to body axes."""

    lever_arm_b: Array | None = None
    R_bs: Array | None = None


@dataclass(frozen=True)
class ImuNoise:
    """Continuous-time densities: accel m/s^2/sqrt(Hz), gyro rad/s/sqrt(Hz); walks m/s^2/sqrt(s) and rad/s/sqrt(s).

    (A walk density times sqrt(seconds) is the change of the bias in that time.)
    """

    accel_noise: float | None = None
    gyro_noise: float | None = None
    accel_bias_walk: float | None = None
    gyro_bias_walk: float | None = None


@dataclass(frozen=True)
class GnssTiming:
    """Whole delay in seconds: a row stamped t_s was true at t_s - latency."""

    position_latency: float | None = None
    velocity_latency: float | None = None


@dataclass(frozen=True)
class MagnetometerUse:
    """Whether the heading factor may be used, and the declination (deg, east positive) if stated."""

    use: bool | None = None
    declination_deg: float | None = None


@dataclass(frozen=True)
class SessionConfig:
    """The contents of session.toml. `date` is ISO (YYYY-MM-DD); the texts are data, never markup.

    imu_delay, s: what a low-pass before the sampling holds the inertial samples back by: true at t_s - imu_delay.
    Of a log that says what it was, it is that.
    """

    title: str | None = None
    driver: str | None = None
    kart: str | None = None
    track: str | None = None
    date: str | None = None
    notes: str | None = None
    mounting: Mounting = field(default_factory=Mounting)
    imu: ImuNoise = field(default_factory=ImuNoise)
    imu_delay: float | None = None
    gps: GnssTiming = field(default_factory=GnssTiming)
    magnetometer: MagnetometerUse = field(default_factory=MagnetometerUse)
