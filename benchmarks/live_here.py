"""The live smoother in this process, one thing after the other: for measurements and tests."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, TypeVar

from smoother.arrays import Array
from smoother.laps.results import GivenLines, Line
from smoother.laps.tracks import TrackFile
from smoother.live.identify import Job, Window, find_line, identify
from smoother.live.lag import LagStart
from smoother.live.navigator import Item, Navigation, Navigator, Worker

T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True, eq=False)
class Done(Generic[T_co]):
    """A finished computation."""

    value: T_co

    def done(self) -> bool:
        """Always true."""
        return True

    def result(self) -> T_co:
        """Return it."""
        return self.value


class Foreground:
    """A Worker that computes immediately: for tests and for playing a file at full speed."""

    def identify(self, window: Window) -> Job[LagStart | str]:
        """Run :func:`identify`."""
        return Done(identify(window))

    def find_line(self, t: Array, position_n: Array, velocity_n: Array, given: GivenLines | None) -> Job[Line | None]:
        """Run :func:`find_line`."""
        return Done(find_line(t, position_n, velocity_n, given))


class LocalNavigator:
    """A navigator in this process, synchronous: for tests and measurements."""

    is_behind = False

    def __init__(self, worker: Worker, tracks: tuple[TrackFile, ...] = ()) -> None:
        self._make = partial(Navigator, worker, tracks)
        self._navigator = self._make()

    @property
    def start(self) -> LagStart | None:
        """Where its smoother began and what it runs with, None before."""
        return self._navigator.start

    def restart(self) -> None:
        """Start anew: the logger was switched off and on."""
        self._navigator = self._make()

    def exchange(self, items: list[Item], arrival: float) -> Navigation:
        """Process items; return the navigation."""
        self._navigator.take(items, arrival)
        self._navigator.work()
        navigation = self._navigator.look()
        return replace(navigation, is_busy=self._navigator.is_busy)
