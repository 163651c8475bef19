"""Half an hour in a storm of stalls: what the release image loses, and how near it comes to its limits.

    python firmware/emulator/soak.py DIR [--duration 1800] [--seed 1]     # about six minutes of processor time

A simulated kart session at 1 kHz; the card stalls about once a second, each third time for 700 ms. Then stalls of
growing length, which say how long a one costs nothing. Exit code 0; 1 if a sample was lost, changed or stamped wrongly,
the machine left its bounds, or a stall of 700 ms cost anything; 2 if a tool is missing.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import emulate
import emulation
from emulation import Script, build
from evidence import IMU_US, Evidence, numbered_stimulus
from smoother.session.log_format import IMU
from smoother.sim.record_log import drive_records
from smoother.sim.simulation import Simulation

STORM = {"stall_us": 700_000, "stall_rest_us": 200_000, "stall_pause_us": 800_000}
LADDER_US = np.repeat(np.arange(660_000, 801_000, 4_000), 2)
LADDER_FROM_US, LADDER_EVERY_US = 4_000_000, 1_357_000  # no multiple of a block's time
STAMP_SPREAD_US = 100  # another interrupt of the same priority may be in the way
LONGEST_UNFED_US = 2_600_000  # the watchdog's 4 s by a clock that may be half as fast again


def stamp_errors(simulation: Simulation, folder: Path) -> np.ndarray:
    """Recorded less true times (N,) of all samples, us, without their mean; empty if they are not all there."""
    wanted, (got, _) = drive_records(simulation), emulate.recorded(folder)
    starts = np.flatnonzero((got.imu == wanted.imu[0]).all(axis=1))
    for first in starts.tolist():
        part = slice(first, first + len(wanted.imu))
        if np.array_equal(got.imu[part], wanted.imu):
            late = got.imu_t[part] - wanted.imu_t
            return np.asarray(late - late.mean())
    return np.zeros(0)


def soak(folder: Path, image: Path, duration: float, seed: int) -> bool:
    """Run the storm and print what was measured; whether everything held."""
    simulation = emulate.simulated(seed, duration)
    _, emulated = emulate.prepare_folder(simulation, folder)
    outcome = emulate.through_firmware(simulation, emulated, image, seed=seed, **STORM)
    emulate.show_machine(outcome)
    found = emulate.compare(simulation, folder / "direct", emulated, has_laps=False)
    print(f"samples: {found.equal} of {found.samples} unchanged, {found.lost_by_logger} lost, {found.losses}")
    records, _ = emulate.recorded(emulated)
    most = records.stop.most_blocks if records.stop else 0
    print(
        f"blocks waiting at most: {most} of 28; longest without feeding the watchdog "
        f"{outcome.number('longest_unfed_us') / 1e3:.1f} ms; resets {outcome.number('resets'):.0f}"
    )
    late = stamp_errors(simulation, emulated)
    spread = float(np.ptp(late)) if len(late) else np.inf
    print(
        f"stamps: {spread:.0f} us between the earliest and the latest, rms {late.std() if len(late) else np.nan:.1f} us"
    )
    said = {text for _, text in records.sentences}
    wanted = [text for _, text in drive_records(simulation).sentences]
    missing = sum(text not in said for text in wanted)
    print(f"sentences: {missing} of {len(wanted)} missing")
    is_bounded = (
        outcome.number("resets") == 0
        and outcome.number("longest_unfed_us") < LONGEST_UNFED_US
        and outcome.number("stack_used") < outcome.number("stack_size")
        and outcome.number("metadata_writes") == 0
        and outcome.number("protocol_errors") == 0
    )
    return found.is_whole and spread < STAMP_SPREAD_US and missing == 0 and is_bounded


def ladder(folder: Path, image: Path) -> bool:
    """Stalls of growing length, at any fill of the block; whether those of 700 ms and less cost nothing."""
    begins = LADDER_FROM_US + LADDER_EVERY_US * np.arange(len(LADDER_US))
    stimulus = numbered_stimulus(float(begins[-1] / 1e6 + 6))
    actions = [(int(t), f"card_stall {stall}") for t, stall in zip(begins, LADDER_US, strict=True)]
    script = Script({"seed": 1}, [], [*actions, (int(begins[-1]) + 6_000_000, "end")])
    script.press(int(begins[-1]) + 2_500_000)
    (recording,) = Evidence(emulation.run(folder, image, stimulus, script)).recordings
    late = float(np.median(recording.records.imu_t - (recording.numbers + 1) * IMU_US))
    gaps = np.array([gap.first_us - late for gap in recording.records.gaps if gap.source == IMU])
    costs = np.array([((gaps >= t) & (gaps < t + LADDER_EVERY_US)).any() for t in begins])
    free, costly = LADDER_US[~costs] / 1e3, LADDER_US[costs] / 1e3
    is_reported = recording.account.untold == 0 and recording.account.missing == recording.account.told
    print(
        f"{len(costs)} stalls of {LADDER_US[0] / 1e3:.0f} to {LADDER_US[-1] / 1e3:.0f} ms: the shortest that cost a"
        f" sample {costly.min(initial=np.inf):.0f} ms, the longest that cost none {free.max(initial=0):.0f} ms;"
        f" {recording.account.missing} samples lost, {'all' if is_reported else 'NOT all'} told of"
    )
    return is_reported and bool(costly.min(initial=np.inf) > STORM["stall_us"] / 1e3)


def main() -> int:
    """Run the soak; the exit code."""
    parser = argparse.ArgumentParser(description="A long drive through the release image while the card stalls")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--duration", type=float, default=1800.0, help="s; 0: only the growing stalls")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--image", type=Path, help="another logger.bin than the one built here")
    options = parser.parse_args()
    try:
        emulation.build_emulator()
        image = options.image or emulation.build_image()
    except build.MissingError as error:
        print(f"emulator: {error}", file=sys.stderr)
        return 2
    is_good = ladder(options.folder / "ladder", image)
    if options.duration > 0:
        is_good = soak(options.folder, image, options.duration, options.seed) and is_good
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
