"""A recording as one format read it, before settings, time base and checks. What format it has, nothing here asks."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from smoother.arrays import Array
from smoother.samples import Channel, GnssFixes, Problem, RawImu, RawMag, WheelSpeed

# what checks call the streams
STREAMS: Mapping[str, str] = {"fixes": "gnss", "imu": "imu", "mag": "mag", "wheel_speed": "wheel_speed"}


@dataclass(frozen=True, eq=False)
class Recording:
    """What one format made of a directory. The file names are for sentences."""

    gnss: GnssFixes
    gnss_file: str
    inputs: tuple[str, ...]
    problems: tuple[Problem, ...]
    imu: RawImu | None = None
    imu_file: str = ""
    mag: RawMag | None = None
    mag_calibration_field: Array | None = None
    unix_at_zero: float | None = None  # where the file has it, but not with each fix
    imu_delay: float | None = None  # s, of the low-pass before the sampling, where the file has it; corrected
    wheel_speed: WheelSpeed | None = None
    channels: tuple[Channel, ...] = ()

    @property
    def samples(self) -> RawImu:
        """The inertial samples, for checks that need them."""
        assert self.imu is not None
        return self.imu

    def stream(self, name: str) -> Any:
        """Return a stream, None where there is none."""
        return getattr(self, STREAMS[name])

    def file_of(self, name: str) -> str:
        """Return the name of its file."""
        return {"fixes": self.gnss_file, "imu": self.imu_file}.get(name, f"{name}.csv")

    def with_stream(self, name: str, rows: Any) -> "Recording":
        """Return the same with another stream; one of which nothing is left is none, but for fixes."""
        is_left = name == "fixes" or len(rows.t) > 0
        changes: dict[str, Any] = {STREAMS[name]: rows if is_left else None}
        return replace(self, **changes)
