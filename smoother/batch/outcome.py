"""What became of one session: exit code, message, the facts an index shows, what it cost."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from smoother.batch.task import SUMMARY, Task
from smoother.documents import load_json
from smoother.errors import SmootherError
from smoother.session.files import list_files
from smoother.session.settings import load_settings

State = Literal["done", "doubtful", "unusable", "limit", "broken", "lost"]
"""lost: the cluster took the session and did not give it back."""
CODES: Mapping[State, int] = {"done": 0, "broken": 1, "lost": 1, "unusable": 2, "limit": 2, "doubtful": 3}
"""Exit code of a session; a limit is for the user to lift, so it counts as unusable and not as a bug."""


@dataclass(frozen=True)
class Facts:
    """What an index shows of a session; None where unknown. Times in s, speeds in m/s, distances in m.

    laps : that count; best_lap : number of the best of them. `length_m` is the track's, `lat_deg` and `lon_deg` are
    the first good fix.
    """

    title: str | None = None
    kart: str | None = None
    driver: str | None = None
    track: str | None = None
    mode: str | None = None
    start_utc: str | None = None
    duration_s: float | None = None
    distance_m: float | None = None
    top_speed_mps: float | None = None
    laps: int | None = None
    best_lap: int | None = None
    best_s: float | None = None
    best_sigma_s: float | None = None
    problems: int | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    length_m: float | None = None


@dataclass(frozen=True)
class Cost:
    """What a session took: s on the clock, s of processor time, the most memory in MB, how often it was started."""

    seconds: float = 0.0
    cpu_s: float = 0.0
    memory_mb: float = 0.0
    starts: int = 1


@dataclass(frozen=True)
class Outcome:
    """What became of a session. message : one line, empty where all is well."""

    state: State
    message: str = ""
    facts: Facts = Facts()
    cost: Cost = Cost()

    @property
    def code(self) -> int:
        """Its exit code, as `smooth SESSION` would have ended."""
        return CODES[self.state]

    @property
    def has_results(self) -> bool:
        """Whether its results are there; a doubtful session's are."""
        return self.state in ("done", "doubtful")


def facts_of_results(out: Path) -> tuple[Facts, tuple[str, ...]]:
    """Return the facts of a smoothed session, and why it failed its quality gate. Raises SmootherError, ValueError."""
    document = load_json(out / SUMMARY)
    about, laps, analysis = (document.get(key) or {} for key in ("session", "laps", "lap_analysis"))
    origin, quality = document.get("origin") or {}, document.get("quality") or {}
    timed = [lap for lap in laps if lap.get("valid") and lap.get("lap_time_s") is not None]
    best: dict[str, Any] = min(timed, key=lambda lap: float(lap["lap_time_s"]), default={})
    problems = [*(document.get("problems") or ()), *((analysis or {}).get("problems") or ())]
    texts = {key: about.get(key) for key in ("title", "kart", "driver", "start_utc")}
    numbers = {key: about.get(key) for key in ("duration_s", "distance_m", "top_speed_mps")}
    facts = Facts(
        **texts,
        **numbers,
        track=(analysis or {}).get("track") or about.get("track"),
        mode=document.get("mode"),
        laps=len(timed),
        best_lap=best.get("lap"),
        best_s=best.get("lap_time_s"),
        best_sigma_s=best.get("lap_time_sigma_s"),
        problems=len(problems),
        lat_deg=origin.get("lat_deg"),
        lon_deg=origin.get("lon_deg"),
        length_m=(analysis or {}).get("length_m"),
    )
    reasons = () if quality.get("passed") is True else tuple(map(str, quality.get("reasons") or ("no verdict",)))
    return facts, reasons


def facts_of_settings(task: Task) -> Facts:
    """Return what session.toml states of a session that has no results."""
    try:
        settings = list_files(task.folder).find("session.toml")
        if settings is None:
            return Facts()
        stated = load_settings(settings)
    except SmootherError:
        return Facts()
    return Facts(title=stated.title, kart=stated.kart, driver=stated.driver, track=stated.track)


def one_line(text: str, longest: int = 400) -> str:
    """Return text without control characters and ends of lines: it came from files and from other programs."""
    words = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return words if len(words) <= longest else words[: longest - 2] + ".."


def from_plain(document: Mapping[str, Any]) -> Outcome:
    """Return an outcome from JSON. Raises TypeError, KeyError or ValueError where that holds something else."""
    state = document["state"]
    if state not in CODES:
        raise ValueError(f"no such state {state!r}")
    return Outcome(state, str(document["message"]), Facts(**document["facts"]), Cost(**document["cost"]))
