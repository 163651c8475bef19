"""What a view is given: all that is known at one moment."""

from dataclasses import dataclass, field

from smoother.live.engine import Snapshot
from smoother.live.receiver import LinkStatus
from smoother.live.recording import RecordingStatus


@dataclass(frozen=True, eq=False)
class Frame:
    """The newest snapshot and how the connection is; delay s since the newest bytes in it came, smoother_delay s since
    the newest in the smoother's state, NaN without one; what is written down, None if nothing is to be. is_held: a file
    waits, as the smoother is behind.
    """

    snapshot: Snapshot = field(default_factory=Snapshot)
    link: LinkStatus = field(default_factory=LinkStatus)
    delay: float = 0.0
    smoother_delay: float = float("nan")
    recording: RecordingStatus | None = None
    is_held: bool = False
