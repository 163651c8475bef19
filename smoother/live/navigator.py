"""The slow half of a stream: identification, smoother, laps. Samples and fixes in, a Navigation out.

It runs in a process of its own (remote_navigator.py), so that it delays no frame. All buffers are bounded: the window
of samples for the identification, the lag of the smoother, the path of the last laps.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from smoother.arrays import Array
from smoother.frames import Origin
from smoother.laps.results import GivenLines, Line
from smoother.laps.tracks import TrackFile, layout_on
from smoother.live.identify import MOVED, Job, Window
from smoother.live.lag import FixedLag, LagStart, LagState, joined
from smoother.live.laptimes import LapClock, LapTimes
from smoother.prepare import choose_origin
from smoother.samples import GnssFixes, ImuSamples

WINDOW = 130.0  # s of samples and fixes for the identification
IDENTIFY_AFTER = (12.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0)  # s of driving
RETRY_AFTER = 10.0  # s of driving after an identification or a smoother that failed
PIECE = 0.1  # s of samples that are processed together
LONGEST_GAP = 15.0  # s without samples, after which the smoother starts anew
LINE_EVERY = 10.0  # s of path between searches for the lap

# exceptions of GTSAM in Python, and of indeterminate systems
FAILURES = (RuntimeError, ArithmeticError, np.linalg.LinAlgError)

NOTHING_YET = "waiting for the logger"
DRIVE = "attitude only, drive to start the smoother"

Item = ImuSamples | GnssFixes


class Worker(Protocol):
    """Runs computations of seconds; see identify.py."""

    def identify(self, window: Window) -> Job[LagStart | str]:
        """Find where a stream begins."""
        ...

    def find_line(self, t: Array, position_n: Array, velocity_n: Array, given: GivenLines | None) -> Job[Line | None]:
        """Find the start line."""
        ...


@dataclass(frozen=True, eq=False)
class Navigation:
    """The newest results. arrival s on the computer's clock, of the newest bytes that are in it.

    lag: the smoother's state, None before; R_bs (3, 3) and latencies (position, velocity) s that it runs with; laps;
    stage as text; is_busy: received data is still being processed; left_out s of the stream that was dropped.
    """

    arrival: float = 0.0
    lag: LagState | None = None
    R_bs: Array | None = None
    latencies: tuple[float, float] | None = None
    laps: LapTimes = field(default_factory=LapTimes)
    stage: str = NOTHING_YET
    is_busy: bool = False
    left_out: float = 0.0


class Navigator:
    """Processes the items of one run of the logger in order; `work` does slow computations."""

    def __init__(self, worker: Worker, tracks: tuple[TrackFile, ...] = (), flaw: str = "") -> None:
        """flaw: why the previous navigator ended."""
        self._worker, self._tracks = worker, tracks
        self._imu: deque[ImuSamples] = deque()
        self._fixes: deque[GnssFixes] = deque()
        self._origin: Origin | None = None
        self._laps = LapClock()
        self._lag: FixedLag | None = None
        self._start: LagStart | None = None
        self._identification: Job[LagStart | str] | None = None
        self._identified_from = 0.0
        self._line: Job[Line | None] | None = None
        self._driven = 0.0
        self._identify_at = IDENTIFY_AFTER[0]
        self._line_at = 0.0
        self._arrival = 0.0
        self._flaw = flaw

    @property
    def is_busy(self) -> bool:
        """Whether received data is still being processed."""
        return self._identification is not None or self._line is not None or self._should_identify()

    @property
    def start(self) -> LagStart | None:
        """Where its smoother began and what it runs with, None before."""
        return self._start

    def take(self, items: Sequence[Item], arrival: float) -> None:
        """Process samples and fixes (a row each). arrival s of the newest bytes."""
        for item in in_order(items):
            if isinstance(item, GnssFixes):
                self._take_fix(item)
                self._lag_state()  # for the path that laps are timed on
            else:
                self._take_imu(item)
        self._forget()
        self._arrival = max(self._arrival, arrival)

    def work(self) -> None:
        """Use finished computations of the worker, and start due ones."""
        self._identify()
        self._find_line()

    def look(self) -> Navigation:
        """Return the newest navigation."""
        lag = self._lag_state()
        now = max((float(held[-1].t[-1]) for held in (self._imu, self._fixes) if held), default=0.0)
        return Navigation(
            self._arrival,
            lag,
            None if self._start is None else self._start.R_bs,
            None if self._lag is None else self._lag.latencies,
            self._laps.times(now),
            self._stage(),
            self.is_busy,
        )

    def _forget(self) -> None:
        """Drop data older than the window, except what a running identification needs to catch up."""
        now = float(self._imu[-1].t[-1]) if self._imu else 0.0
        oldest = now - WINDOW if self._identification is None else min(now - WINDOW, self._identified_from)
        for held in (self._imu, self._fixes):
            while held and held[0].t[-1] < oldest:
                held.popleft()

    # ---- inside -----------------------------------------------------------------------------------------------------

    def _take_imu(self, imu: ImuSamples) -> None:
        self._imu.append(imu)
        self._pass_on(imu)

    def _take_fix(self, fix: GnssFixes) -> None:
        t = float(fix.t[-1])
        if self._origin is None:
            self._origin = choose_origin(fix)
        if self._fixes and speed_of(fix) > MOVED:
            self._driven += min(1.0, t - float(self._fixes[-1].t[-1]))
        self._fixes.append(fix)
        self._pass_on(fix)
        if self._lag is None and np.isfinite(speed_of(fix)):  # laps from the fixes until the smoother runs
            self._laps.add_fix(t, np.nan_to_num(fix.position_n(self._origin)[-1]), np.nan_to_num(fix.velocity_n[-1]))

    def _pass_on(self, item: Item) -> None:
        if self._lag is not None and self._origin is not None and (flaw := _feed(self._lag, item, self._origin)):
            self._lose(flaw)

    def _lose(self, why: str) -> None:
        self._lag, self._start, self._flaw = None, None, why
        self._identify_at = min(self._identify_at, self._driven + RETRY_AFTER)

    def _identify(self) -> None:
        if self._identification is not None and self._identification.done():
            found, self._identification = self._identification.result(), None
            self._restart_smoother(found)
        if self._should_identify() and self._origin is not None:
            window = _since_gap(Window(joined(self._imu), _all_fixes(self._fixes), self._origin))
            later = [after for after in IDENTIFY_AFTER if after > self._driven + 1.0]
            self._identify_at = later[0] if later else float("inf")
            self._identification, self._identified_from = self._worker.identify(window), float(window.imu.t[0])

    def _should_identify(self) -> bool:
        """Whether enough was driven since the last identification, and that is finished."""
        return (
            self._identification is None
            and self._driven >= self._identify_at
            and bool(self._imu)
            and self._origin is not None
        )

    def _restart_smoother(self, start: LagStart | str) -> None:
        """Start from an identification, with the data since then; keep the old smoother if that fails."""
        flaw = start if isinstance(start, str) else self._start_from(start)
        if flaw:
            self._identify_at = min(self._identify_at, self._driven + RETRY_AFTER)
        self._flaw = flaw

    def _start_from(self, start: LagStart) -> str:
        """Replace the smoother after the new one has processed all data; return the failure."""
        assert self._origin is not None
        lag = FixedLag(start)
        held: list[Item] = [*self._imu, *self._fixes]
        for item in in_order([item for item in held if item.t[-1] > start.t]):
            if flaw := _feed(lag, item, self._origin):
                return flaw
        self._lag, self._start = lag, start
        return ""

    def _find_line(self) -> None:
        if self._line is not None and self._line.done():
            line, self._line = self._line.result(), None
            if isinstance(line, Line):
                self._laps.set_line(line)
        is_due = not self._laps.has_line and self._laps.seconds > self._line_at
        if self._line is None and is_due and self._origin is not None:
            self._line_at = self._laps.seconds + LINE_EVERY
            if self._laps.seconds > LINE_EVERY:
                given = layout_on(self._tracks, self._origin, None) if self._tracks else None
                self._line = self._worker.find_line(*self._laps.path(), given)

    def _lag_state(self) -> LagState | None:
        if self._lag is None:
            return None
        try:
            state = self._lag.state()
        except FAILURES as error:
            self._lose(str(error).splitlines()[0])
            return None
        if state is not None:
            self._laps.add(state.t, state.position_n, state.velocity_n)
        return state

    def _stage(self) -> str:
        if self._lag is not None:
            return "smoothing"
        if self._identification is not None:
            return "finding mounting and delays"
        if self._flaw:
            return f"not yet: {self._flaw}"
        if not self._imu and not self._fixes:
            return NOTHING_YET
        return DRIVE if self._fixes else "attitude only, no fix yet"


def in_order(items: Sequence[Item]) -> list[Item]:
    """Return samples in pieces of at most :data:`PIECE`, and fixes among them in order of time.

    A file at full speed arrives a minute at a time, first all samples, then all fixes.
    """
    pieces: list[Item] = []
    for item in items:
        length = float(item.t[-1] - item.t[0])
        if isinstance(item, GnssFixes) or length <= PIECE:
            pieces.append(item)
            continue
        cuts = np.searchsorted(item.t, item.t[0] + PIECE * np.arange(1, int(length / PIECE) + 1))
        ends = [0, *cuts.tolist(), len(item.t)]
        pieces += [item.rows(slice(*part)) for part in pairwise(ends) if part[1] > part[0]]
    return sorted(pieces, key=lambda item: (float(item.t[-1]), isinstance(item, GnssFixes)))


def _feed(lag: FixedLag, item: Item, origin: Origin) -> str:
    """Pass the next item to a smoother; return the failure, empty without one."""
    gap = float(item.t[0]) - lag.newest
    if isinstance(item, ImuSamples) and gap > LONGEST_GAP:
        return f"no data for {gap:.0f} s, the smoother starts again"
    try:
        if isinstance(item, ImuSamples):
            lag.add_imu(item)
        else:
            lag.add_fix(float(item.t[-1]), item.position_n(origin)[-1], item.velocity_n[-1])
    except FAILURES as error:
        return f"the smoother failed ({' '.join(str(error).split())[:60]}) and begins again"
    return ""


def _since_gap(window: Window) -> Window:
    """The data after the last gap of LONGEST_GAP."""
    t = window.imu.t
    gaps = np.flatnonzero(np.diff(t) > LONGEST_GAP)
    after = window.fixes.t > t[gaps[-1]] if len(gaps) else np.zeros(1)
    if not np.any(after):
        return window
    return replace(window, imu=window.imu.between(t[gaps[-1] + 1], np.inf), fixes=window.fixes.select(after))


def speed_of(fix: GnssFixes) -> float:
    """Horizontal speed of the last row, m/s; NaN where unknown."""
    return float(np.hypot(fix.velocity_n[-1, 0], fix.velocity_n[-1, 1]))


def _all_fixes(parts: deque[GnssFixes]) -> GnssFixes:
    return GnssFixes(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(GnssFixes)})
