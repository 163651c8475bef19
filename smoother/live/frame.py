"""The input of a view: everything known at one time."""

from dataclasses import dataclass, field

from smoother.live.engine import Snapshot
from smoother.live.receiver import LinkStatus
from smoother.live.recording import RecordingStatus


@dataclass(frozen=True, eq=False)
class Frame:
    """The newest snapshot and the state of the connection; delay s since the arrival of its newest bytes,
    smoother_delay s since that of the newest bytes in the smoother's state, NaN without one; state of the recording,
    None without one. is_held: a file waits, because the smoother is behind.
    """

    snapshot: Snapshot = field(default_factory=Snapshot)
    link: LinkStatus = field(default_factory=LinkStatus)
    delay: float = 0.0
    smoother_delay: float = float("nan")
    recording: RecordingStatus | None = None
    is_held: bool = False
