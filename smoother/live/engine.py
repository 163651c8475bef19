"""The state of a live stream: bytes in, a Snapshot out. No clock, no port, no screen.

Fast work is done here: decoding, Madgwick's filter, rates. The rest is done by the navigator, which may run in another
process and is never waited for. All buffers are bounded.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.live.attitude import MadgwickTracker
from smoother.live.decoding import Batch, Decoder, Losses
from smoother.live.identify import MOVED
from smoother.live.lag import LagState
from smoother.live.laptimes import LapTimes
from smoother.live.navigator import DRIVE, NOTHING_YET, Item, Navigation, speed_of
from smoother.live.receiver import Chunk
from smoother.live.sensing import FixAssembler, RateMeter, Reception, field_samples, inertial_samples
from smoother.samples import GnssFixes, ImuSamples
from smoother.session.log_format import PURPOSE_MAG_CALIBRATION, LogRecords

SILENT = 1.5  # s without a fix, after which there is none


class Navigating(Protocol):
    """Where the smoother runs: remote_navigator.RemoteNavigator, or one of a test."""

    @property
    def is_behind(self) -> bool:
        """Whether so many items wait that a source that can wait should."""
        ...

    def restart(self) -> None:
        """Start anew: the logger was switched off and on."""
        ...

    def exchange(self, items: list[Item], arrival: float) -> Navigation:
        """Pass items, arrival s of their bytes; return the newest navigation."""
        ...


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state at one time. t s on the sensor's clock; arrival s on the computer's, of the newest bytes.

    madgwick (3, 3): R_ns of the sensor, before there is a mounting, else R_nb of the kart; lag: the smoother's state,
    None before; smoother_arrival like arrival, of the newest bytes in that; left_out s of stream that it
    dropped. force (3,) m/s^2, rate (3,) rad/s: means of the newest samples, in s. rates per second by sensor. speed
    m/s, of the fix where the smoother has none.
    """

    t: float = 0.0
    arrival: float = 0.0
    madgwick: Array | None = None
    lag: LagState | None = None
    R_bs: Array | None = None
    latencies: tuple[float, float] | None = None
    force: Array = field(default_factory=lambda: np.zeros(3))
    rate: Array = field(default_factory=lambda: np.zeros(3))
    rates: dict[str, float] = field(default_factory=dict)
    reception: Reception = field(default_factory=Reception)
    speed: float = float("nan")
    fix_age: float = float("inf")
    laps: LapTimes = field(default_factory=LapTimes)
    is_calibrating: bool = False
    losses: Losses = field(default_factory=Losses)
    stage: str = "waiting for the logger"
    lat_deg: float = float("nan")
    lon_deg: float = float("nan")
    smoother_arrival: float = 0.0
    left_out: float = 0.0


class _Drive:
    """State of one run of the logger; a restart begins another."""

    def __init__(self) -> None:
        self.imu: ImuSamples | None = None  # the newest
        self.fix: GnssFixes | None = None
        self.madgwick = MadgwickTracker()
        self.assembler = FixAssembler()
        self.meters = {name: RateMeter() for name in ("imu", "mag", "gps")}
        self.imu_t = self.mag_t = float("-inf")


class Engine:
    """Takes chunks, returns snapshots, and includes the newest navigation."""

    def __init__(self, navigating: Navigating, calibration: Calibration | None = None) -> None:
        self._navigating, self._calibration = navigating, calibration or Calibration()
        self._decoder = Decoder()
        self._drive = _Drive()
        self._snapshot = Snapshot()
        self._navigation = Navigation()

    @property
    def is_busy(self) -> bool:
        """Whether received data is still being processed."""
        return self._navigation.is_busy

    @property
    def is_behind(self) -> bool:
        """Whether so many items wait for the navigator that a source that can wait should."""
        return self._navigating.is_behind

    def step(self, chunks: list[Chunk]) -> tuple[Snapshot, list[Batch]]:
        """Process chunks; return the snapshot, and the records to be written."""
        batches = self._decoder.feed(chunks)
        items: list[Item] = []
        for batch in batches:
            if batch.restarted:
                self._drive = _Drive()
                self._navigating.restart()
                items = []
            items += self._take(batch.records)
        arrival = batches[-1].arrival if batches else self._snapshot.arrival
        before, self._navigation = self._navigation, self._navigating.exchange(items, arrival)
        if batches or _is_news(before, self._navigation) or self._snapshot.losses != self._decoder.losses:
            self._snapshot = self._look(arrival)
        return self._snapshot, batches

    def _take(self, records: LogRecords) -> list[Item]:
        """Return the samples, and the fixes that they complete, for the navigator."""
        d = self._drive
        items: list[Item] = []
        mag = field_samples(records, self._calibration, d.mag_t)
        imu = inertial_samples(records, self._calibration, d.imu_t)
        if mag is not None:
            d.mag_t = float(mag.t[-1])
            d.meters["mag"].add(d.mag_t, len(mag.t))
        if imu is not None:
            d.imu, d.imu_t = imu, float(imu.t[-1])
            d.meters["imu"].add(d.imu_t, len(imu.t))
            d.madgwick.feed(imu, mag)
            items.append(imu)
        now = max(d.imu_t, records.sentences[-1][0] * 1e-6 if records.sentences else 0.0)
        for fix in d.assembler.feed(records.sentences, now):
            d.fix = fix
            d.meters["gps"].add(float(fix.t[-1]), 1)
            items.append(fix)
        return items

    def _look(self, arrival: float) -> Snapshot:
        d, navigation = self._drive, self._navigation
        R_bs, lag, fix = navigation.R_bs, navigation.lag, d.fix
        madgwick = d.madgwick.R_ns if d.madgwick.is_started else None
        if madgwick is not None and R_bs is not None:
            madgwick = madgwick @ R_bs.T
        now = max(d.imu_t, float(fix.t[-1]) if fix is not None else 0.0, 0.0)
        setup = self._decoder.setup
        return Snapshot(
            now,
            arrival,
            madgwick,
            lag,
            R_bs,
            navigation.latencies,
            np.zeros(3) if d.imu is None else d.imu.specific_force_s.mean(axis=0),
            np.zeros(3) if d.imu is None else d.imu.angular_rate_s.mean(axis=0),
            {name: meter.rate(now) for name, meter in d.meters.items()},
            d.assembler.reception,
            _shown_speed(lag, fix),
            float("inf") if fix is None else now - float(fix.t[-1]),
            navigation.laps.running_on(now),
            setup is not None and setup.purpose == PURPOSE_MAG_CALIBRATION,
            self._decoder.losses,
            self._stage(),
            float("nan") if fix is None else float(fix.lat_deg[-1]),
            float("nan") if fix is None else float(fix.lon_deg[-1]),
            navigation.arrival,
            navigation.left_out,
        )

    def _stage(self) -> str:
        """The stage of the navigator as text."""
        stage, fix = self._navigation.stage, self._drive.fix
        is_driving = fix is not None and speed_of(fix) > MOVED
        return "waiting for the smoother" if is_driving and stage in (DRIVE, NOTHING_YET) else stage


def _is_news(before: Navigation, after: Navigation) -> bool:
    """Whether a navigation differs from the previous one."""
    return before.lag is not after.lag or (before.stage, before.laps.lap) != (after.stage, after.laps.lap)


def _shown_speed(lag: LagState | None, fix: GnssFixes | None) -> float:
    if lag is not None:
        return float(np.hypot(lag.velocity_n[0], lag.velocity_n[1]))
    return float("nan") if fix is None else speed_of(fix)
