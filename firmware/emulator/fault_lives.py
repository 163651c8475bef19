"""Lives with faults at random: whatever came together, nothing is lost untold and all is well again afterwards."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from evidence import FIX_US, IMU_US, Evidence, Recording, fix_at
from expectations import POLLED_SPREAD_US, Case, Expectation, led, measured

FIRST_S, LAST_S, CLEAR_S, WELL_S, STOP_S, AGAIN_S, END_S = 3.0, 14.0, 19.0, 42.0, 46.0, 49.0, 56.0
FAULTS_A_LIFE = (2, 5)
# what begins, what ends it, seconds it lasts at most
FAULTS = (
    ("card_absent 1", "card_absent 0", 5.0),
    ("card_refuse 100000", "card_refuse 0", 2.0),
    ("card_mishear 1", "", 0.0),
    ("card_hang 2", "", 0.0),
    ("card_stall 950000", "", 0.0),
    ("card_busy 20000", "card_busy 300", 4.0),
    ("card_other 1", "", 0.0),
    ("card_protect 1", "card_protect 0", 3.0),
    ("gps_absent 1", "gps_absent 0", 4.0),
    ("gps_garble 1", "gps_garble 0", 4.0),
    ("gps_restart 1", "", 0.0),
    ("imu_absent 1", "imu_absent 0", 3.0),
    ("imu_frozen 1", "imu_frozen 0", 1.0),
    ("imu_wire 0", "imu_wire 1", 3.0),
    ("imu_storm 70", "imu_storm 0", 1.0),
    ("mag_overflow 1", "mag_overflow 0", 2.0),
    ("supply_low 1", "supply_low 0", 0.5),
    ("stick 1", "", 0.0),
    ("restart 1", "", 0.0),
)
SLACK = 20  # samples in all: where the IMU was away their count follows from the time
STRANGE = 1000  # while it is frozen


def _is_told(found: Recording) -> bool:
    a = found.account
    away = SLACK if a.told or a.strange else 0
    return abs(a.missing - a.told - a.strange) <= away and a.untold <= away + a.strange and a.disorder == 0


def told() -> Expectation:
    """Every recording keeps its samples, or counts them in a GAP at its time."""

    def find_flaw(seen: Evidence) -> str:
        bad = [f"{found.names}: {found.account}" for found in seen.recordings if not _is_told(found)]
        return "; ".join(bad)

    return Expectation("every sample of every recording is kept, or counted in a GAP at its time", find_flaw)


def well(start_s: float, end_s: float) -> Expectation:
    """A recording has all samples and sentences of a span."""

    def find_flaw(seen: Evidence) -> str:
        wanted = set(range(round(1e6 * start_s) // IMU_US, round(1e6 * end_s) // IMU_US))
        times = range(round(1e6 * start_s) // FIX_US * FIX_US + 300_000, round(1e6 * end_s) - FIX_US, FIX_US)
        lines = {line for t in times for line in fix_at(t).splitlines(keepends=True)}
        missing = [
            (len(wanted - set(found.numbers)), len(lines - {text for _, text in found.records.sentences}))
            for found in seen.recordings
        ]
        return "" if (0, 0) in missing else f"(samples, sentences) missing in each recording: {missing}"

    return Expectation(f"all samples and sentences from {start_s:g} to {end_s:g} s are in one recording", find_flaw)


def random_case(number: int, rng: np.random.Generator) -> Case:
    """A life with some faults; at CLEAR_S the last is over, at WELL_S all must be well."""
    actions: list[tuple[float, str]] = []
    chosen = rng.choice(len(FAULTS), rng.integers(*FAULTS_A_LIFE, endpoint=True), replace=False)
    for i in chosen:
        begin, end, longest_s = FAULTS[i]
        at = float(rng.uniform(FIRST_S, LAST_S))
        actions.append((at, begin))
        if end:
            actions += [(at + float(rng.uniform(0.05, longest_s)), end), (CLEAR_S, end)]
    names = ", ".join(FAULTS[i][0] for i in chosen)
    if "card_other" in names:  # its files are put in order at its next start
        actions += [
            (AGAIN_S, "card_other 1"),
            (AGAIN_S, "restart 1"),
            (END_S - 3.5, "button 1"),
            (END_S - 3.4, "button 0"),
        ]
    sticks = names.count("stick")
    expects = (
        told(),
        well(WELL_S, STOP_S - 0.2),
        led("recording", WELL_S, STOP_S - 0.2),
        measured(f"the watchdog bites {sticks} times at most", "watchdog_resets", 0, sticks),
    )
    end_s = END_S if "card_other" in names else AGAIN_S
    return Case(
        f"life {number}: {names}",
        "faults at random",
        tuple(actions),
        expects,
        end_s,
        stop=STOP_S,
        resets=None,
        spread_us=POLLED_SPREAD_US,
    )


def random_cases(count: int, rng: np.random.Generator) -> list[Case]:
    """So many lives."""
    return [random_case(i + 1, rng) for i in range(count)]
