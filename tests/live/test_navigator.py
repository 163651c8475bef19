"""Samples and fixes reach the smoother in the order of their times, however they came."""

from dataclasses import replace

import numpy as np
import pytest

from live_here import Done, Foreground
from smoother.laps.results import Line
from smoother.live.identify import Job, Window
from smoother.live.lag import LagStart
from smoother.live.navigator import LONGEST_GAP, PIECE, WINDOW, Item, Navigator, in_order
from smoother.prepare import prepare
from smoother.samples import GnssFixes, ImuSamples


def items_of(drive, end: float) -> tuple[ImuSamples, list[GnssFixes]]:
    session = prepare(drive.simulation.raw)
    assert session.imu is not None
    use = session.imu.t < end
    imu = ImuSamples(session.imu.t[use], session.imu.specific_force_s[use], session.imu.angular_rate_s[use])
    fixes = [session.gnss.select(np.array([i])) for i in np.flatnonzero(session.gnss.t < end)]
    return imu, fixes


def test_a_minute_that_came_at_once_is_taken_in_as_if_it_had_come_in_time(drive) -> None:
    imu, fixes = items_of(drive, 20.0)
    ordered = in_order([imu, *fixes])
    pieces = [item for item in ordered if isinstance(item, ImuSamples)]
    np.testing.assert_array_equal(np.concatenate([piece.t for piece in pieces]), imu.t)
    np.testing.assert_array_equal(np.concatenate([piece.angular_rate_s for piece in pieces]), imu.angular_rate_s)
    assert max(piece.t[-1] - piece.t[0] for piece in pieces) <= PIECE
    ends = np.array([item.t[-1] for item in ordered])
    assert np.all(np.diff(ends) >= 0.0)
    assert [item for item in ordered if isinstance(item, GnssFixes)] == fixes


def test_the_smoother_runs_on_a_stream_in_lumps_and_is_given_up_over_a_long_gap(drive) -> None:
    imu, fixes = items_of(drive, 40.0)
    navigator = Navigator(Foreground())
    for start in range(0, 40, 8):  # s; lumps as a file gives them that is played as fast as it goes
        part = (imu.t >= start) & (imu.t < start + 8)
        lump: list[Item] = [ImuSamples(imu.t[part], imu.specific_force_s[part], imu.angular_rate_s[part])]
        navigator.take([*lump, *(fix for fix in fixes if start <= fix.t[-1] < start + 8)], 1.0)
        navigator.work()
    assert navigator.look().stage == "smoothing"
    assert navigator._lag is not None and navigator._lag.fixes_late <= 2
    later = ImuSamples(imu.t[-200:] + LONGEST_GAP + 2.0, imu.specific_force_s[-200:], imu.angular_rate_s[-200:])
    navigator.take([later], 2.0)
    assert navigator.look().lag is None
    assert "no data for 16 s" in navigator._flaw


def test_what_is_identified_on_has_no_long_gap_in_it(drive) -> None:
    imu, fixes = items_of(drive, 40.0)
    windows: list[Window] = []

    class Watched(Foreground):
        def identify(self, window: Window) -> Job[LagStart | str]:
            windows.append(window)
            return Done("not now")

    navigator = Navigator(Watched())
    for late, part in ((0.0, 0), (LONGEST_GAP + 1.0, 1)):
        some = (imu.t < 25.0) if part == 0 else (imu.t >= 25.0)
        items: list[Item] = [
            ImuSamples(imu.t[some] + late, imu.specific_force_s[some], imu.angular_rate_s[some]),
            *(replace(fix, t=fix.t + late) for fix in fixes if (fix.t[-1] >= 25.0) == bool(part)),
        ]
        for item in in_order(items):
            navigator.take([item], 1.0)
            navigator.work()
    assert windows[0].imu.t[0] < 1.0
    last = windows[-1]
    assert last.imu.t[0] > 25.0 + LONGEST_GAP and last.fixes.t[0] > 25.0 + LONGEST_GAP
    assert last.imu.t[-1] > last.imu.t[0] + 5.0 and len(last.fixes) > 20


class Busy(Foreground):
    """A worker that never comes to an end with an identification, and finds no line."""

    def identify(self, window: Window) -> Job[LagStart | str]:
        class Never(Done[LagStart | str]):
            def done(self) -> bool:
                return False

        return Never("")

    def find_line(self, *_: object) -> Job[Line | None]:
        return Done(None)


def driving(t: float) -> list[Item]:
    """A tenth of a second of samples until t s, and a fix there at 10 m/s north."""
    samples = t + np.array([-0.05, 0.0])
    one, velocity_n = np.array([t]), np.array([[10.0, 0.0, 0.0]])
    fix = GnssFixes(one, 45.0 + one * 10.0 / 111e3, 12.0 + 0.0 * one, 0.0 * one, velocity_n)
    return [ImuSamples(samples, np.tile([0.0, 0.0, 9.8], (2, 1)), np.zeros((2, 3))), fix]


def test_what_is_being_identified_on_is_kept_however_long_that_takes() -> None:
    navigator = Navigator(Busy())
    for t in np.arange(1.0, WINDOW + 60.0, 0.5):
        navigator.take(driving(float(t)), float(t))
        navigator.work()
    assert navigator._imu[0].t[0] == navigator._identified_from < 2.0  # older than the window by now
    assert navigator._fixes[0].t[0] < 2.0


def test_a_silence_of_the_receiver_is_no_driving() -> None:
    navigator = Navigator(Busy())
    for t in (1.0, 1.2, 31.2, 31.4):
        navigator.take(driving(t), t)
    assert navigator._driven == pytest.approx(0.2 + 1.0 + 0.2)
