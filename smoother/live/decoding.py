"""From chunks of bytes to records, with counts of all losses. No clock, no thread."""

from dataclasses import dataclass, replace

from smoother.live.receiver import Chunk
from smoother.session.log_format import CRC_STRUCT, FRAME_HEAD, FRAME_SYNC, LogRecords, Setup
from smoother.session.log_frames import Frame, decode_frames, find_frames

_NUMBERS = 65536


@dataclass(frozen=True)
class Losses:
    """Counts since the start: good frames; missing ones by their numbers; frames that failed their CRC; bytes that
    were no frame; restarts of the logger."""

    frames: int = 0
    lost_frames: int = 0
    damaged: int = 0
    noise_bytes: int = 0
    restarts: int = 0

    @property
    def lost_share(self) -> float:
        """Share (0..1) of the sent frames that were not received."""
        return self.lost_frames / max(1, self.frames + self.lost_frames)


@dataclass(frozen=True, eq=False)
class Batch:
    """Records of one logger run in order; restarted: the logger was restarted before them. arrival s of the last."""

    records: LogRecords
    arrival: float
    restarted: bool = False


class Decoder:
    """Takes chunks, returns batches; holds at most one unfinished frame."""

    def __init__(self) -> None:
        self._rest = b""
        self._last: Frame | None = None
        self._setup: Setup | None = None
        self.losses = Losses()

    @property
    def setup(self) -> Setup | None:
        """The settings that the logger last sent."""
        return self._setup

    def feed(self, chunks: list[Chunk]) -> list[Batch]:
        """Return the records of `chunks`, a batch for each run of the logger in them."""
        frames: list[Frame] = []
        arrival = chunks[-1].arrival if chunks else 0.0
        for data in _joined(chunks):
            if data.after_break:
                self._count_noise(self._rest)
                self._rest = b""
            frames += self._frames(self._rest + data.data)
        return [self._batch(run, arrival, restarted) for run, restarted in self._runs(frames)]

    def _frames(self, data: bytes) -> list[Frame]:
        frames, done = find_frames(data)
        good = sum(FRAME_HEAD.size + len(frame.records) + CRC_STRUCT.size for frame in frames)
        syncs = data.count(FRAME_SYNC, 0, done) - sum(_syncs_inside(frame) for frame in frames) - len(frames)
        self._rest = data[done:]
        self.losses = replace(
            self.losses,
            frames=self.losses.frames + len(frames),
            noise_bytes=self.losses.noise_bytes + done - good,
            damaged=self.losses.damaged + max(0, syncs),
        )
        return frames

    def _count_noise(self, data: bytes) -> None:
        self.losses = replace(self.losses, noise_bytes=self.losses.noise_bytes + len(data))

    def _runs(self, frames: list[Frame]) -> list[tuple[list[Frame], bool]]:
        """Split frames where the logger was restarted; count those missing between neighbours."""
        runs: list[tuple[list[Frame], bool]] = []
        for frame in frames:
            last = self._last
            # two seconds back or ten minutes ahead: the logger was switched off and on
            restarted = last is not None and not -2_000_000 < frame.base_us - last.base_us < 600_000_000
            if last is not None and not restarted:
                missing = (frame.number - last.number - 1) % _NUMBERS
                if missing < _NUMBERS // 2:  # else it is a repetition
                    self.losses = replace(self.losses, lost_frames=self.losses.lost_frames + missing)
            if restarted:
                self.losses = replace(self.losses, restarts=self.losses.restarts + 1)
            if restarted or not runs:
                runs.append(([], restarted))
            runs[-1][0].append(frame)
            self._last = frame
        return runs

    def _batch(self, frames: list[Frame], arrival: float, restarted: bool) -> Batch:
        records = decode_frames(frames)
        self._setup = records.setup or (None if restarted else self._setup)
        return Batch(replace(records, setup=self._setup), arrival, restarted)


def _syncs_inside(frame: Frame) -> int:
    """A sync may stand by chance in a good frame."""
    return frame.records.count(FRAME_SYNC)


def _joined(chunks: list[Chunk]) -> list[Chunk]:
    """Neighbouring chunks of one connection as one: because the search for frames has a cost per call."""
    parts: list[list[Chunk]] = []
    for chunk in chunks:
        if chunk.after_break or not parts:
            parts.append([])
        parts[-1].append(chunk)
    return [Chunk(part[-1].arrival, b"".join(c.data for c in part), part[0].after_break) for part in parts]
