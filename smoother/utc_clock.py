"""The time of day of a session: UTC beside the clock that its rows are stamped by."""

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, overload

from smoother.arrays import Array

EPOCH = dt.datetime(1970, 1, 1)


@dataclass(frozen=True)
class UtcClock:
    """At `start_s` on the session's clock it was `start_unix`, UTC in seconds since 1970; `rate` of them pass in one.

    A crystal that is off by 50 parts in a million is 0.06 s off after twenty minutes, a cheap one far more.
    """

    start_s: float
    start_unix: float
    rate: float = 1.0

    @overload
    def at(self, t: float) -> float: ...
    @overload
    def at(self, t: Array) -> Array: ...
    def at(self, t: float | Array) -> float | Array:
        """UTC, seconds since 1970, at times t of the session, s."""
        return self.start_unix + self.rate * (t - self.start_s)

    def as_summary(self) -> dict[str, Any]:
        """Return what summary.json holds of it, beside the `start_s` of the first row."""
        return {"start_utc": iso(self.start_unix), "utc_rate": self.rate}

    @staticmethod
    def of_summary(session: Mapping[str, Any]) -> "UtcClock | None":
        """Return the clock that the part `session` of a summary.json holds, None where the time of day is unknown.

        Raises KeyError, TypeError or ValueError where it is damaged.
        """
        if session.get("start_utc") is None:
            return None
        moment = dt.datetime.fromisoformat(session["start_utc"]).replace(tzinfo=None)
        rate = float(session.get("utc_rate", 1.0))
        return UtcClock(float(session["start_s"]), (moment - EPOCH).total_seconds(), rate)


def iso(unix: float) -> str:
    """UTC, seconds since 1970, as ISO 8601 with milliseconds."""
    return (EPOCH + dt.timedelta(milliseconds=round(1e3 * unix))).isoformat(timespec="milliseconds") + "Z"
