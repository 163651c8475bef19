"""What a fault must leave behind, said in words and checked against what was left (evidence.py)."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from emulation import Script
from evidence import IMU_US, Evidence, Recording, fix_at

STOP_BEFORE_END_S = 3.5  # for the last blocks, the next spare
STAMP_SPREAD_US = 100
POLLED_SPREAD_US = 1_000  # half a millisecond late at most, by a timer that runs through


@dataclass(frozen=True)
class Expectation:
    """What must be seen, in words, and what is seen otherwise (empty: nothing)."""

    text: str
    find_flaw: Callable[[Evidence], str]


@dataclass(frozen=True)
class Case:
    """A fault: its row of the table, what happens when (s, verb of world.c), what must be seen then.

    The logger records from power-on; `stop` is when the button ends it (s), by default shortly before the end.
    """

    name: str
    row: str
    actions: tuple[tuple[float, str], ...]
    expects: tuple[Expectation, ...]
    duration: float = 16.0
    config: tuple[str, ...] = ()
    settings: dict[str, int] = field(default_factory=dict)
    stop: float | None = None
    resets: int | None = 0  # None: any
    spread_us: float = STAMP_SPREAD_US
    is_long: bool = False

    def script(self) -> Script:
        """The emulator's script."""
        stop = self.duration - STOP_BEFORE_END_S if self.stop is None else self.stop
        script = Script({"seed": 1, **self.settings}, list(self.config))
        script.actions = [(round(1e6 * t), what) for t, what in self.actions]
        if stop < self.duration:
            script.press(round(1e6 * stop))
        script.actions.append((round(1e6 * self.duration), "end"))
        return script


# ---- expectations ----


def led(pattern: str, start_s: float, end_s: float) -> Expectation:
    """The LED shows one pattern in a window."""

    def find_flaw(seen: Evidence) -> str:
        found = seen.led(start_s, end_s)
        return "" if found == pattern else f"it is {found or 'none of the patterns'}"

    return Expectation(f"LED: {pattern}, {start_s:g} to {end_s:g} s", find_flaw)


def of_one(text: str, find_flaw: Callable[[Recording], str], index: int = 0) -> Expectation:
    """Something about one of the recordings."""

    def find(seen: Evidence) -> str:
        count = len(seen.recordings)
        return find_flaw(seen.recordings[index]) if -count <= index < count else f"there are {count} recordings"

    return Expectation(
        text if index == 0 else f"recording {index + 1 if index > 0 else 'before the end'}: {text}", find
    )


def recordings(count: int, files: int | None = None) -> Expectation:
    """So many recordings, in so many files in all."""
    files = count if files is None else files

    def find_flaw(seen: Evidence) -> str:
        names = [recording.names for recording in seen.recordings]
        return "" if len(names) == count and sum(map(len, names)) == files else f"there are {names}"

    return Expectation(f"{count} recording(s) in {files} file(s)", find_flaw)


def event(*names: str, index: int = 0) -> Expectation:
    """Events that stand in a recording."""
    return of_one(
        f"EVENT {', '.join(names)}",
        lambda found: "" if set(names) <= found.events else f"only {sorted(found.events)}",
        index,
    )


def no_event(*names: str, index: int = 0) -> Expectation:
    """Events that must not stand in a recording."""
    return of_one(f"no EVENT {', '.join(names)}", lambda found: ", ".join(set(names) & found.events), index)


def all_kept(start_s: float, end_s: float, index: int = 0) -> Expectation:
    """Every sample of a span is recorded, as it was measured."""

    def find_flaw(found: Recording) -> str:
        a = found.account
        is_kept = a.missing == a.told == a.strange == a.disorder == 0 and _reaches(found, start_s, end_s)
        return "" if is_kept else str(a)

    return of_one(f"every sample from {start_s:g} to {end_s:g} s is kept, as measured", find_flaw, index)


def all_told(
    start_s: float, end_s: float, lost: tuple[int, int], slack: int = 0, strange: int = 0, index: int = 0
) -> Expectation:
    """Every sample of a span is recorded, or counted by a GAP that says when: (least, most) of them; `slack` where the
    count follows from the time alone; up to `strange` ones as the sensor gave them."""

    def find_flaw(found: Recording) -> str:
        a = found.account
        is_reported = abs(a.missing - a.told - a.strange) <= slack and a.untold <= slack + a.strange and a.disorder == 0
        is_within = lost[0] <= a.told <= lost[1] and a.strange <= strange
        return "" if is_reported and is_within and _reaches(found, start_s, end_s) else str(a)

    text = f"samples from {start_s:g} to {end_s:g} s are kept, or counted in a GAP at its time ({lost[0]} to {lost[1]})"
    return of_one(text, find_flaw, index)


def _reaches(found: Recording, start_s: float, end_s: float) -> bool:
    first_s, last_s = ((n + 1) * IMU_US / 1e6 for n in (found.account.first, found.account.last))
    return found.account.recorded > 0 and first_s <= start_s and last_s >= end_s


def no_samples(index: int = 0) -> Expectation:
    """A recording without samples of the IMU."""
    return of_one("no samples", lambda found: str(len(found.records.imu) or ""), index)


def sentences(start_s: float, end_s: float, index: int = 0) -> Expectation:
    """Every sentence that the receiver said in a span is recorded."""

    def find_flaw(found: Recording) -> str:
        said = {text for _, text in found.records.sentences}
        times = [t for t in range(300_000, round(1e6 * end_s), 200_000) if t >= 1e6 * start_s]
        lines = [line for t in times for line in fix_at(t).splitlines(keepends=True)]
        missing = [line for line in lines if line not in said]
        return f"{len(missing)} of {len(lines)} are missing" if missing or not lines else ""

    return of_one(f"every sentence from {start_s:g} to {end_s:g} s is kept", find_flaw, index)


def no_sentences(start_s: float, end_s: float) -> Expectation:
    """No sentence has a time in a span."""

    def find_flaw(found: Recording) -> str:
        return str(sum(start_s <= t / 1e6 <= end_s for t, _ in found.records.sentences) or "")

    return of_one(f"no sentences from {start_s:g} to {end_s:g} s", find_flaw)


def setup(index: int = 0, **wanted: int) -> Expectation:
    """Fields of the newest SETUP."""

    def find_flaw(found: Recording) -> str:
        seen = {name: getattr(found.records.setup, name, None) for name in wanted}
        return "" if seen == wanted else f"it has {seen}"

    words = ", ".join(f"{name} {value:#x}" if "who" in name else f"{name} {value}" for name, value in wanted.items())
    return of_one(f"SETUP: {words}", find_flaw, index)


def stopped(reason: int, index: int = 0) -> Expectation:
    """How a recording was ended; 0: it was not."""

    def find_flaw(found: Recording) -> str:
        seen = found.records.stop.reason if found.records.stop else 0
        return "" if seen == reason else f"it is {seen}"

    return of_one(f"STOP {reason}" if reason else "no STOP", find_flaw, index)


def says(text: str) -> Expectation:
    """Words among the messages."""
    return Expectation(f"message: {text}", lambda seen: "" if text in seen.serial else "it is not there")


def measured(text: str, name: str, low: float, high: float) -> Expectation:
    """A measurement of the emulator within bounds."""

    def find_flaw(seen: Evidence) -> str:
        value = seen.outcome.number(name)
        return "" if low <= value <= high else f"it is {value:g}"

    return Expectation(text, find_flaw)


def seen_as(text: str, find_flaw: Callable[[Evidence], str]) -> Expectation:
    """Anything else."""
    return Expectation(text, find_flaw)


# ---- what holds for every case ----


def always(case: Case) -> tuple[Expectation, ...]:
    """The volume is clean, nothing was damaged, the machine stayed in its bounds."""

    def find_damage(seen: Evidence) -> str:
        return "; ".join(
            f"{found.names}: {found.losses}"
            for found in seen.recordings
            if found.losses.blocks or found.losses.samples or found.losses.unreadable
        )

    def find_spread(seen: Evidence) -> str:
        worst = max((found.account.spread_us for found in seen.recordings), default=0.0)
        return "" if worst <= case.spread_us else f"they are {worst:.0f} us apart"

    return (
        seen_as("fsck.fat has no complaint", lambda seen: seen.volume_complaints),
        seen_as("no block is missing or damaged", find_damage),
        seen_as(f"stamps are true to {case.spread_us:g} us", find_spread),
        *([] if case.resets is None else [measured(f"{case.resets} resets", "resets", case.resets, case.resets)]),
        measured("no command to the card out of order", "protocol_errors", 0, 0),
        measured("the stack stays in its region", "stack_used", 1, 2303),
    )
