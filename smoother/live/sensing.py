"""From records to samples in SI; fixes as soon as they are complete."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from smoother.calibration import Calibration
from smoother.errors import SessionError
from smoother.samples import GnssFixes, ImuSamples, MagSamples, RawImu, RawMag
from smoother.session.log import COUNTS, TICKS_PER_SECOND, magnetic_field, seconds
from smoother.session.log_format import MAG_OVERFLOW, LogRecords, Setup
from smoother.session.nmea import fixes_from_sentences
from smoother.units import DEG, STANDARD_GRAVITY

RATE_OVER = 2.0  # s


@dataclass(frozen=True)
class Reception:
    """Newest state of the receiver: fix quality (0 none), satellites used (-1 unknown), hdop (NaN), t s of that."""

    fix: int = 0
    satellites: int = -1
    hdop: float = float("nan")
    t: float = float("-inf")


def inertial_samples(records: LogRecords, calibration: Calibration, after: float) -> ImuSamples | None:
    """Return the samples later than `after` s, calibrated, in axes s; None without any. Times as in log.imu_samples."""
    setup = records.setup or Setup()
    t = seconds(records.imu_t - (setup.gyro_delay_us - setup.imu_period_us // 2))
    keep = t > np.maximum.accumulate(np.concatenate([[after], t[:-1]])) if t.size else np.zeros(0, dtype=np.bool_)
    if not np.any(keep):
        return None
    accel_full_scale, gyro_full_scale = setup.accel_range_g * STANDARD_GRAVITY, setup.gyro_range_dps * DEG
    counts = records.imu[keep].astype(np.float64)
    raw = RawImu(
        t[keep],
        counts[:, :3],
        counts[:, 3:],
        accel_full_scale / COUNTS,
        gyro_full_scale / COUNTS,
        accel_full_scale,
        gyro_full_scale,
    )
    return calibration.apply_to_imu(raw)


def field_samples(records: LogRecords, calibration: Calibration, after: float) -> MagSamples | None:
    """Return the field later than `after` s in axes s; None without any."""
    t = seconds(records.mag_t)
    good = (records.mag_flags & MAG_OVERFLOW) == 0
    good &= t > np.maximum.accumulate(np.concatenate([[after], t[:-1]])) if t.size else good
    if not np.any(good):
        return None
    field = magnetic_field(records.mag[good], records.setup or Setup())
    return calibration.apply_to_mag(RawMag(t[good], field))


class FixAssembler:
    """Collects the sentences of one fix. A fix is complete when all kinds of sentences of the previous one arrived."""

    def __init__(self) -> None:
        self._pending: list[tuple[float, bytes]] = []
        self._usual: frozenset[bytes] = frozenset()
        self._last_t = float("-inf")
        self._last_unix = float("-inf")
        self.reception = Reception()
        self.unreadable = 0

    def feed(self, sentences: Iterable[tuple[int, bytes]], now: float) -> list[GnssFixes]:
        """Return the fixes, a row each, that sentences (us, text) complete; now s on the sensor's clock."""
        fixes = []
        for t_us, text in sentences:
            if self._pending and _time_of(text) and _time_of(text) != self._pending_time():
                fixes += self._flush()
            self._pending.append((t_us / TICKS_PER_SECOND, text))
            self._listen(t_us / TICKS_PER_SECOND, text)
            kinds = frozenset(_kind(other) for _, other in self._pending)
            # sentences; more than any receiver sends in a second
            if (self._usual and kinds >= self._usual) or len(self._pending) > 64:
                fixes += self._flush()
        # s after its first sentence in which all sentences of a fix have come
        if self._pending and now > self._pending[0][0] + 0.15:
            fixes += self._flush()
        return fixes

    def _pending_time(self) -> bytes:
        return next((time for _, text in self._pending if (time := _time_of(text))), b"")

    def _flush(self) -> list[GnssFixes]:
        pending, self._pending = self._pending, []
        self._usual = frozenset(_kind(text) for _, text in pending)
        try:
            fixes = fixes_from_sentences(pending, "stream").gnss
        except SessionError:
            self.unreadable += 1
            return []
        if len(fixes) == 0 or fixes.t[-1] <= self._last_t:
            return []
        assert fixes.unix_s is not None
        if fixes.unix_s[-1] <= self._last_unix:
            return []  # a late sentence of the previous fix
        self._last_t, self._last_unix = float(fixes.t[-1]), float(np.nan_to_num(fixes.unix_s[-1], nan=-np.inf))
        return [fixes.select(np.array([len(fixes) - 1]))]

    def _listen(self, t: float, text: bytes) -> None:
        """Satellites and quality from GGA, which has them also without a fix."""
        cells = text.split(b"*")[0].split(b",")
        if _kind(text) == b"GGA" and len(cells) > 8:
            quality, used = _integer(cells[6], 0), _integer(cells[7], -1)
            try:
                hdop = float(cells[8])
            except ValueError:
                hdop = float("nan")
            self.reception = Reception(quality, used, hdop, t)
        elif _kind(text) == b"RMC" and len(cells) > 2 and cells[2] != b"A":
            self.reception = replace(self.reception, fix=0, t=t)


def _integer(cell: bytes, default: int) -> int:
    return int(cell) if cell.isdigit() else default


def _kind(text: bytes) -> bytes:
    return text[3:6]


def _time_of(text: bytes) -> bytes:
    cells = text.split(b",", 8)
    if _kind(text) in (b"RMC", b"GGA", b"GST", b"GNS", b"ZDA") and len(cells) > 1:
        return cells[1]
    return b""


class RateMeter:
    """Rate per second over the last RATE_OVER seconds of the sensor's clock."""

    def __init__(self) -> None:
        self._marks: list[tuple[float, int]] = []

    def add(self, t: float, count: int) -> None:
        """Count `count` more until t s."""
        self._marks.append((t, count))
        while len(self._marks) > 2 and self._marks[0][0] < t - RATE_OVER:
            self._marks.pop(0)

    def rate(self, now: float) -> float:
        """Return the rate at `now` s, 0 without data in RATE_OVER."""
        if len(self._marks) < 2 or now - self._marks[-1][0] > RATE_OVER:
            return 0.0
        length = max(self._marks[-1][0], now - 0.25 * RATE_OVER) - self._marks[0][0]
        return sum(count for _, count in self._marks[1:]) / length if length > 0.0 else 0.0
