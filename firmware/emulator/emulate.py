"""A kart session through the release image: simulate, run logger.bin on it, smooth what is on the card, time the laps.

    python firmware/emulator/emulate.py DIR [--duration S] [--seed N] [--stall MS] [--image logger.bin]

Leaves DIR/direct (the session as the simulator writes it, with its truth) and DIR/emulated (card.img, the recordings on
it, serial.txt). Exit code 0; 1 if a sample was lost or a lap time differs; 2 if a tool is missing.
"""

import argparse
import shutil
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import emulation
from emulation import build
from smoother import api
from smoother.arrays import Array
from smoother.cli.pipeline import calibrated, read
from smoother.frames import geodetic_to_nwu
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.results import GivenLines
from smoother.laps.stage import fix_path
from smoother.session.log import list_recordings, read_records
from smoother.session.log_decode import Losses
from smoother.session.log_encode import encode
from smoother.session.log_format import LogRecords, Setup
from smoother.sim.record_log import CALIBRATION_FILE, DRIVE_FILE, drive_records, write_klg
from smoother.sim.simulation import Simulation, simulate_preset

LIMIT_MS = 2.0
SAME_LAP_S = 1.0
SIMULATED_HZ = 1000.0
INSIDE_S = 1.0  # by which the recording begins after the simulation, and ends before it
SLACK_US = 2000  # by which the stamps of one reading or sentence may differ; the next one is farther away
WAITS = {
    **{"irq6_wait_us": "IMU pin", "irq14_wait_us": "IMU DMA", "irq28_wait_us": "timer"},
    **{"irq38_wait_us": "receiver", "irq16_wait_us": "receiver DMA"},
    **{"irq12_wait_us": "card DMA", "irq37_wait_us": "stream"},
}


@dataclass(frozen=True)
class Comparison:
    """What was written directly against what came through the logger.

    samples of the IMU, how many of them are equal, how many the logger says it lost; losses: blocks and the like;
    others, others_missing: readings of the magnetometer and sentences; laps (K, 3) s: truth, direct, emulated;
    laps_missing: laps that only one of the two recordings has.
    """

    samples: int
    equal: int
    lost_by_logger: int
    losses: Losses
    others: int
    others_missing: int
    laps: Array
    laps_missing: int = 0

    @property
    def worst_ms(self) -> float:
        """Largest difference between the lap times of the two recordings; inf if one has a lap that the other has not.

        0 without laps: a drive may be too short for one.
        """
        differences = np.abs(self.laps[:, 2] - self.laps[:, 1])
        return np.inf if self.laps_missing else float(np.max(differences, initial=0.0)) * 1e3

    @property
    def is_whole(self) -> bool:
        """Whether every simulated sample, reading and sentence is in the recording, unchanged."""
        is_complete = self.equal == self.samples > 0 and self.others_missing == 0
        return is_complete and self.lost_by_logger == 0 and self.losses == Losses()


def simulated(seed: int, duration: float, track: str = "larkfield", **others: Any) -> Simulation:
    """A kart session at 1 kHz, with `others` of the scenario's figures. No jitter: the logger makes its own stamps."""
    changes = {"imu.rate": SIMULATED_HZ, "imu.jitter": 0.0, "gnss.has_vertical_velocity": True, **others}
    return simulate_preset("kart", seed, track=track, duration=duration, **changes)


def recorded(folder: Path) -> tuple[LogRecords, Losses]:
    """The longest recording of a folder."""
    found = [read_records(files) for files in list_recordings(sorted(folder.glob("LOG*.KLG")))]
    return max(found, key=lambda recording: len(recording[0].imu_t))


def count_equal(wanted: LogRecords, got: LogRecords) -> int:
    """How many of the samples wanted stand in a recording, in one run without any other in between."""
    size = len(wanted.imu)
    if len(got.imu) < size:
        return 0
    starts = np.flatnonzero((got.imu[: len(got.imu) - size + 1] == wanted.imu[0]).all(axis=1))
    return max((int((got.imu[i : i + size] == wanted.imu).all(axis=1).sum()) for i in starts), default=0)


def lap_times(folder: Path, simulation: Simulation, offset_s: float) -> dict[int, tuple[float, float]]:
    """Lap time and true time, s, by the number of the true crossing that begins the lap, on the track's own line."""
    session = calibrated(read(folder), folder)
    estimate = api.smooth(session)
    ends = simulation.track.start_line_deg
    origin = session.origin
    plan = geodetic_to_nwu(ends[:, 0], ends[:, 1], np.full(2, origin.alt_m), origin)[:, :2]
    found = analyse(estimate, fix_path(session), LapOptions(lines=GivenLines(plan, name=simulation.track.name)))
    crossings, laps = simulation.lap_crossings(), {}
    for lap in found.laps:
        k = int(np.argmin(np.abs(crossings - (lap.start - offset_s))))
        if lap.is_timed and k + 1 < len(crossings) and abs(crossings[k] - (lap.start - offset_s)) < SAME_LAP_S:
            laps[k] = lap.time, float(crossings[k + 1] - crossings[k])
    return laps


def part_recorded(wanted: LogRecords, got: LogRecords) -> LogRecords:
    """Return the part of a simulation that a recording spans: of each sensor, from the first recorded to the last.

    The same drive over another span is another measurement: the kart stands at the start for some seconds, and each
    tenth of a second of that has its share in what is known about the biases (README.md, "Lap times").
    """
    period = (wanted.setup or Setup()).imu_period_us
    delay = emulation.GYRO_DELAY_US - period // 2
    imu = _spanned(wanted.imu_t, got.imu_t - delay, period // 2)
    mag = _spanned(wanted.mag_t, got.mag_t, SLACK_US)
    said = _spanned(_times(wanted.sentences), _times(got.sentences), SLACK_US)
    return replace(
        wanted,
        imu_t=wanted.imu_t[imu],
        imu=wanted.imu[imu],
        sentences=wanted.sentences[said],
        mag_t=wanted.mag_t[mag],
        mag=wanted.mag[mag],
        mag_flags=wanted.mag_flags[mag],
    )


def _times(sentences: Sequence[tuple[int, bytes]]) -> np.ndarray:
    return np.array([t for t, _ in sentences], dtype=np.int64)


def _spanned(simulated_us: np.ndarray, recorded_us: np.ndarray, slack_us: int) -> slice:
    """Rows of the simulation from the first recorded to the last."""
    if len(recorded_us) == 0:
        return slice(0, 0)
    ends = recorded_us[[0, -1]] - round(1e6 * (emulation.LEAD_S - emulation.BOOT_S)) + [-slack_us, slack_us]
    return slice(*np.searchsorted(simulated_us, ends).tolist())


def keep_recorded_part(direct: Path, emulated: Path) -> None:
    """Leave of the direct recording only what the emulated one spans."""
    files = list_recordings([direct / DRIVE_FILE])[0]
    part = part_recorded(read_records(files)[0], recorded(emulated)[0])
    (direct / DRIVE_FILE).write_bytes(encode(part, files.session))


def count_missing(wanted: LogRecords, got: LogRecords) -> int:
    """How many readings of the magnetometer and sentences do not stand in a recording, or too few times."""
    pairs = (
        (map(bytes, wanted.mag), map(bytes, got.mag)),
        (dict(wanted.sentences).values(), dict(got.sentences).values()),
    )
    return sum((Counter(there) - Counter(here)).total() for there, here in pairs)


def compare(simulation: Simulation, direct: Path, emulated: Path, has_laps: bool = True) -> Comparison:
    """Compare what was written directly with what came through the logger."""
    (wanted, _), (got, losses) = recorded(direct), recorded(emulated)
    rows, laps_missing = [], 0
    if has_laps:
        ours, theirs = (
            lap_times(emulated, simulation, emulation.LEAD_S - emulation.BOOT_S),
            lap_times(direct, simulation, 0.0),
        )
        rows = [(theirs[k][1], theirs[k][0], ours[k][0]) for k in sorted(ours.keys() & theirs.keys())]
        laps_missing = len(ours.keys() ^ theirs.keys())
    lost = got.stop.imu_lost if got.stop else len(wanted.imu)
    others, missing = len(wanted.mag) + len(wanted.sentences), count_missing(wanted, got)
    equal = count_equal(wanted, got)
    laps = np.array(rows).reshape(-1, 3)
    return Comparison(len(wanted.imu), equal, lost, losses, others, missing, laps, laps_missing)


def prepare_folder(simulation: Simulation, folder: Path) -> tuple[Path, Path]:
    """Folders for the direct recording, which is written, and for the emulated one."""
    direct, emulated = folder / "direct", folder / "emulated"
    for part in (direct, emulated):
        shutil.rmtree(part, ignore_errors=True)
    emulated.mkdir(parents=True)
    write_klg(simulation, direct)
    return direct, emulated


def through_firmware(
    simulation: Simulation, folder: Path, image: Path, ahead_s: float = emulation.AHEAD_S, **settings: int
) -> emulation.Outcome:
    """Run a session through an image; the recordings on its card are left in `folder`.

    ahead_s as in :func:`emulation.drive_script`, settings as in world.c.
    """
    records = drive_records(simulation)
    stimulus = emulation.stimulus_of(records)
    outcome = emulation.run(folder, image, stimulus, emulation.drive_script(stimulus, records, ahead_s, **settings))
    calibration = folder.parent / "direct" / CALIBRATION_FILE
    if calibration.exists():  # in place of the placeholder that was on the card
        shutil.copy(calibration, folder / "MAG00001.KLG")
    return outcome


def show_machine(outcome: emulation.Outcome) -> None:
    """Print what was measured of the machine."""
    simulated_s = outcome.number("simulated_s")
    speed = f"{simulated_s / outcome.cpu_s:.1f} times real time"
    print(f"emulated {simulated_s:.1f} s in {outcome.cpu_s:.1f} s of processor time: {speed}")
    print(f"CPU load {100 * outcome.number('load'):.1f} % while driving")
    waits = ", ".join(f"{name} {outcome.number(key):.1f}" for key, name in WAITS.items() if key in outcome.measured)
    print(f"worst wait for an interrupt, us: {waits}")
    print(f"deepest stack {outcome.number('stack_used'):.0f} of {outcome.number('stack_size'):.0f} bytes")
    stalls, longest = outcome.number("stalls"), outcome.number("longest_stall_us") / 1e3
    print(f"card: {outcome.number('writes'):.0f} writes, {stalls:.0f} stalls, the longest {longest:.0f} ms")
    print(f"writes to the file system while recording: {outcome.number('metadata_writes'):.0f}")


def show(comparison: Comparison) -> None:
    """Print samples and lap times."""
    samples = f"{comparison.equal} of {comparison.samples} unchanged, {comparison.lost_by_logger} lost"
    print(f"samples: {samples}, {comparison.losses}")
    print(f"magnetometer and sentences: {comparison.others_missing} of {comparison.others} missing")
    if not len(comparison.laps) and not comparison.laps_missing:
        print("no lap was completed: a drive of 60 s is too short for most tracks")
        return
    print(" lap    truth   direct through firmware  difference ms")
    for i, (true, direct, ours) in enumerate(comparison.laps, 1):
        print(f"{i:4} {true:8.3f} {direct:8.3f} {ours:16.3f} {1e3 * (ours - direct):14.2f}")
    for name, column in (("directly written", 1), ("through the firmware", 2)):
        if len(comparison.laps):
            rms = 1e3 * np.sqrt(np.mean((comparison.laps[:, column] - comparison.laps[:, 0]) ** 2))
            print(f"{name}: {rms:.1f} ms rms from the truth")
    print(f"largest difference {comparison.worst_ms:.2f} ms (limit {LIMIT_MS})")


def run_session(options: argparse.Namespace, image: Path) -> Comparison:
    """Simulate the session that is asked for, run it through an image, compare."""
    simulation = simulated(options.seed, options.duration + 2.0 * INSIDE_S, options.track)
    direct, emulated = prepare_folder(simulation, options.folder)
    settings = {"seed": options.seed, "stall_us": 1000 * options.stall}
    show_machine(through_firmware(simulation, emulated, image, -INSIDE_S, **settings))
    keep_recorded_part(direct, emulated)
    return compare(simulation, direct, emulated, not options.no_laps)


def main() -> int:
    """Run one session; the exit code."""
    parser = argparse.ArgumentParser(description="A simulated kart session through the release image")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--duration", type=float, default=180.0, help="s")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--track", default="larkfield")
    parser.add_argument("--stall", type=int, default=700, help="longest stall of the card, ms; 0: none")
    parser.add_argument("--image", type=Path, help="another logger.bin than the one built here")
    parser.add_argument("--no-laps", action="store_true", help="only compare the samples")
    options = parser.parse_args()
    try:
        emulation.build_emulator()
        image = options.image or emulation.build_image()
    except build.MissingError as error:
        print(f"emulator: {error}", file=sys.stderr)
        return 2
    comparison = run_session(options, image)
    show(comparison)
    is_long = comparison.samples >= SIMULATED_HZ * options.duration
    return 0 if is_long and comparison.is_whole and (options.no_laps or comparison.worst_ms < LIMIT_MS) else 1


if __name__ == "__main__":
    sys.exit(main())
