"""The state of a live stream: bytes in, one value out that says all there is to show. No clock, no port, no screen.

Everything held is bounded: the window of samples that mounting and delays are identified on, the smoother's lag, the
path of the last laps, the readings of the compass by direction.
"""

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field, fields
from typing import Protocol

import numpy as np

from smoother.arrays import Array
from smoother.calibration import Calibration
from smoother.frames import Origin
from smoother.laps.results import GivenLines, Line
from smoother.laps.tracks import TrackFile, layout_on
from smoother.live.attitude import MadgwickTracker
from smoother.live.decoding import Batch, Decoder, Losses
from smoother.live.field import FieldSphere
from smoother.live.identify import MOVED, Window
from smoother.live.lag import FixedLag, LagOptions, LagStart, LagState
from smoother.live.laptimes import LapClock, LapTimes
from smoother.live.receiver import Chunk
from smoother.live.sensing import FixAssembler, RateMeter, Reception, field_samples, inertial_samples
from smoother.prepare import choose_origin
from smoother.samples import GnssFixes, ImuSamples
from smoother.session.log_format import PURPOSE_MAG_CALIBRATION, LogRecords

WINDOW = 130.0  # s of samples and fixes for the identification
IDENTIFY_AFTER = (12.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0)  # s of driving; then mounting and delays are known
RETRY_AFTER = 10.0  # s of driving after an identification that failed
CATCH_UP = 1  # fixes that a new smoother takes in with each step besides as many as came new; 10 ms each
SILENT = 1.5  # s without a fix, after which there is none
LINE_EVERY = 10.0  # s of path between searches for the lap
FIT_EVERY = 2.0  # s between fits of the compass's ellipsoid


class Worker(Protocol):
    """Where slow work is done; see identify.py."""

    def identify(self, window: Window) -> "Future[LagStart | str]":
        """Find where a stream begins."""
        ...

    def find_line(
        self, t: Array, position_n: Array, velocity_n: Array, given: GivenLines | None
    ) -> "Future[Line | None]":
        """Find the start line."""
        ...


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What is known now. t s on the sensor's clock; arrival s on the computer's, of the newest bytes.

    madgwick (3, 3): R_ns of the sensor, before there is a mounting, else R_nb of the kart; lag: the smoother's state,
    None before. force (3,) m/s^2, rate (3,) rad/s: means of the newest samples, in s. rates per second by sensor.
    speed m/s, of the fix where the smoother has none. field_points (K, 3) uT.
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
    coverage: float = 0.0
    field_points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    field_centre: Array = field(default_factory=lambda: np.zeros(3))
    field_rms: float = float("nan")
    is_calibrating: bool = False
    losses: Losses = field(default_factory=Losses)
    stage: str = "waiting for the logger"
    lat_deg: float = float("nan")
    lon_deg: float = float("nan")


class _Drive:
    """What belongs to one run of the logger; a restart begins another."""

    def __init__(self) -> None:
        self.imu: deque[ImuSamples] = deque()
        self.fixes: deque[GnssFixes] = deque()
        self.origin: Origin | None = None
        self.madgwick = MadgwickTracker()
        self.assembler = FixAssembler()
        self.laps = LapClock()
        self.meters = {name: RateMeter() for name in ("imu", "mag", "gps")}
        self.lag: FixedLag | None = None
        self.start: LagStart | None = None
        self.next: FixedLag | None = None
        self.next_start: LagStart | None = None
        self.todo: deque[ImuSamples | GnssFixes] = deque()
        self.identification: Future[LagStart | str] | None = None
        self.line: Future[Line | None] | None = None
        self.driven = 0.0
        self.fix_count = 0
        self.identify_at = IDENTIFY_AFTER[0]
        self.line_at = 0.0
        self.fit_at = 0.0
        self.imu_t = self.mag_t = float("-inf")
        self.flaw = ""


class Engine:
    """Takes chunks, gives snapshots. Slow work goes to `worker`; its results are taken over when they are there."""

    def __init__(
        self,
        worker: Worker,
        calibration: Calibration | None = None,
        tracks: tuple[TrackFile, ...] = (),
        lag: LagOptions | None = None,
    ) -> None:
        self._worker, self._calibration, self._tracks = worker, calibration or Calibration(), tracks
        self._lag_options = lag
        self._decoder = Decoder()
        self._sphere = FieldSphere()
        self._drive = _Drive()
        self._snapshot = Snapshot()
        self._shown: FixedLag | None = None

    @property
    def is_busy(self) -> bool:
        """Whether something is still being worked out of what has come."""
        d = self._drive
        return d.identification is not None or d.next is not None or d.line is not None

    def step(self, chunks: list[Chunk]) -> tuple[Snapshot, list[Batch]]:
        """Take in what came; return what is known now, and the records that came, to be written down."""
        batches = self._decoder.feed(chunks)
        new = 0
        for batch in batches:
            if batch.restarted:
                self._drive = _Drive()
            before = self._drive.fix_count
            self._take(batch.records)
            new += self._drive.fix_count - before
        self._identify()
        self._catch_up(CATCH_UP + new)
        self._find_line()
        is_other = self._drive.lag is not self._shown
        self._shown = self._drive.lag
        if batches or is_other or self._snapshot.losses != self._decoder.losses:
            self._snapshot = self._look(batches[-1].arrival if batches else self._snapshot.arrival)
        return self._snapshot, batches

    # ---- taking in --------------------------------------------------------------------------------------------------

    def _take(self, records: LogRecords) -> None:
        d = self._drive
        field_and_raw = field_samples(records, self._calibration, d.mag_t)
        imu = inertial_samples(records, self._calibration, d.imu_t)
        mag = None
        if field_and_raw is not None:
            mag, raw = field_and_raw
            d.mag_t = float(mag.t[-1])
            d.meters["mag"].add(d.mag_t, len(mag.t))
            self._sphere.feed(raw)
        if imu is not None:
            d.imu_t = float(imu.t[-1])
            d.meters["imu"].add(d.imu_t, len(imu.t))
            d.madgwick.feed(imu, mag)
            d.imu.append(imu)
            self._pass_on(imu)
        now = max(d.imu_t, records.sentences[-1][0] * 1e-6 if records.sentences else 0.0)
        for fix in d.assembler.feed(records.sentences, now):
            self._take_fix(fix)
        while d.imu and d.imu[0].t[-1] < d.imu_t - WINDOW:
            d.imu.popleft()
        while d.fixes and d.fixes[0].t[-1] < d.imu_t - WINDOW:
            d.fixes.popleft()

    def _take_fix(self, fix: GnssFixes) -> None:
        d, t = self._drive, float(fix.t[-1])
        if d.origin is None:
            d.origin = choose_origin(fix)
        if d.fixes and _speed(fix) > MOVED:
            d.driven += min(1.0, t - float(d.fixes[-1].t[-1]))
        d.meters["gps"].add(t, 1)
        d.fixes.append(fix)
        d.fix_count += 1
        self._pass_on(fix)
        if d.lag is None and np.isfinite(_speed(fix)):  # laps from the fixes until the smoother runs
            d.laps.add(t, np.nan_to_num(fix.position_n(d.origin)[-1]), np.nan_to_num(fix.velocity_n[-1]))

    def _pass_on(self, item: ImuSamples | GnssFixes) -> None:
        d = self._drive
        if d.next is not None:
            d.todo.append(item)
        if d.lag is not None and d.origin is not None:
            _feed(d.lag, item, d.origin)

    # ---- slow work --------------------------------------------------------------------------------------------------

    def _identify(self) -> None:
        d = self._drive
        if d.identification is not None and d.identification.done():
            self._begin_again(d.identification)
            d.identification = None
        if d.identification is None and d.next is None and d.driven >= d.identify_at and d.origin is not None:
            window = Window(_all_imu(d.imu), _all_fixes(d.fixes), d.origin)
            later = [after for after in IDENTIFY_AFTER if after > d.driven + 1.0]
            d.identify_at = later[0] if later else float("inf")
            d.identification = self._worker.identify(window)

    def _begin_again(self, done: "Future[LagStart | str]") -> None:
        """Start a smoother at the head of the window with what was identified; the old one goes on meanwhile."""
        d = self._drive
        failure = done.exception()
        start = str(failure) if failure is not None else done.result()
        if isinstance(start, str):
            d.flaw, d.identify_at = start, min(d.identify_at, d.driven + RETRY_AFTER)
            return
        d.flaw = ""
        try:
            d.next, d.next_start = FixedLag(start, self._lag_options), start
        except RuntimeError as error:  # what GTSAM's exceptions are in Python
            d.next, d.flaw = None, str(error).splitlines()[0]
            return
        parts: list[ImuSamples | GnssFixes] = [part for part in d.imu if part.t[-1] > start.t]
        parts += [fix for fix in d.fixes if fix.t[-1] > start.t + start.velocity_latency]
        d.todo = deque(sorted(parts, key=lambda part: (float(part.t[-1]), isinstance(part, GnssFixes))))

    def _catch_up(self, most: int) -> None:
        """Let a new smoother take in `most` fixes more, and put it in its place once it knows all."""
        d = self._drive
        if d.next is None or d.origin is None:
            return
        fixes = 0
        while d.todo and fixes < most:
            item = d.todo.popleft()
            fixes += isinstance(item, GnssFixes)
            if not _feed(d.next, item, d.origin):
                d.next, d.flaw = None, "the smoother failed and begins again"
                d.todo.clear()
                d.identify_at = d.driven + RETRY_AFTER
                return
        if not d.todo:
            d.lag, d.start, d.next, d.next_start = d.next, d.next_start, None, None

    def _find_line(self) -> None:
        d = self._drive
        if d.line is not None and d.line.done():
            line = d.line.result() if d.line.exception() is None else None
            d.line = None
            if line is not None:
                d.laps.set_line(line)
        if d.line is None and not d.laps.has_line and d.laps.seconds > d.line_at and d.origin is not None:
            d.line_at = d.laps.seconds + LINE_EVERY
            if d.laps.seconds > LINE_EVERY:
                given = layout_on(self._tracks, d.origin, None) if self._tracks else None
                d.line = self._worker.find_line(*d.laps.path(), given)

    # ---- looking ----------------------------------------------------------------------------------------------------

    def _look(self, arrival: float) -> Snapshot:
        d = self._drive
        lag = self._lag_state()
        R_bs = None if d.start is None else d.start.R_bs
        madgwick = d.madgwick.R_ns if d.madgwick.is_started else None
        if madgwick is not None and R_bs is not None:
            madgwick = madgwick @ R_bs.T
        newest = d.imu[-1] if d.imu else None
        now = max(d.imu_t, float(d.fixes[-1].t[-1]) if d.fixes else float("-inf"), 0.0)
        fix = d.fixes[-1] if d.fixes else None
        setup = self._decoder.setup
        is_calibrating = setup is not None and setup.purpose == PURPOSE_MAG_CALIBRATION
        if now > d.fit_at and (is_calibrating or d.driven == 0.0):
            d.fit_at = now + FIT_EVERY
            self._sphere.fit()
        sphere = self._sphere
        return Snapshot(
            now,
            arrival,
            madgwick,
            lag,
            R_bs,
            None if d.lag is None else d.lag.latencies,
            np.zeros(3) if newest is None else newest.specific_force_s.mean(axis=0),
            np.zeros(3) if newest is None else newest.angular_rate_s.mean(axis=0),
            {name: meter.rate(now) for name, meter in d.meters.items()},
            d.assembler.reception,
            _shown_speed(lag, fix),
            float("inf") if fix is None else now - float(fix.t[-1]),
            d.laps.times(now),
            sphere.coverage,
            sphere.points,
            sphere.centre,
            float("nan") if sphere.ellipsoid is None else sphere.ellipsoid.rms,
            is_calibrating,
            self._decoder.losses,
            self._stage(),
            float("nan") if fix is None else float(fix.lat_deg[-1]),
            float("nan") if fix is None else float(fix.lon_deg[-1]),
        )

    def _lag_state(self) -> LagState | None:
        d = self._drive
        if d.lag is None:
            return None
        try:
            state = d.lag.state()
        except RuntimeError as error:
            d.lag, d.start, d.flaw = None, None, str(error).splitlines()[0]
            d.identify_at = d.driven + RETRY_AFTER
            return None
        d.laps.add(state.t, state.position_n, state.velocity_n)
        return state

    def _stage(self) -> str:
        d = self._drive
        if not d.imu and not d.fixes:
            return "waiting for the logger"
        if d.lag is not None:
            return "smoothing"
        if d.identification is not None or d.next is not None:
            return "finding mounting and delays"
        if d.flaw:
            return f"not yet: {d.flaw}"
        return "attitude only, drive to start the smoother" if d.fixes else "attitude only, no fix yet"


def _feed(lag: FixedLag, item: ImuSamples | GnssFixes, origin: Origin) -> bool:
    """Give a smoother its next item; False if it failed."""
    try:
        if isinstance(item, ImuSamples):
            lag.add_imu(item)
        else:
            lag.add_fix(float(item.t[-1]), item.position_n(origin)[-1], item.velocity_n[-1])
    except RuntimeError:  # what GTSAM's exceptions are in Python
        return False
    return True


def _speed(fix: GnssFixes) -> float:
    return float(np.hypot(fix.velocity_n[-1, 0], fix.velocity_n[-1, 1]))


def _shown_speed(lag: LagState | None, fix: GnssFixes | None) -> float:
    if lag is not None:
        return float(np.hypot(lag.velocity_n[0], lag.velocity_n[1]))
    return float("nan") if fix is None else _speed(fix)


def _all_imu(parts: deque[ImuSamples]) -> ImuSamples:
    return ImuSamples(
        np.concatenate([part.t for part in parts]),
        np.concatenate([part.specific_force_s for part in parts]),
        np.concatenate([part.angular_rate_s for part in parts]),
        parts[-1].accel_full_scale,
        parts[-1].gyro_full_scale,
    )


def _all_fixes(parts: deque[GnssFixes]) -> GnssFixes:
    return GnssFixes(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(GnssFixes)})
