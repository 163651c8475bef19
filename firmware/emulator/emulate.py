"""A kart session through the release image: simulate, run logger.bin on it, smooth what is on the card, time the laps.

    python firmware/emulator/emulate.py DIR [--duration S] [--seed N] [--stall MS] [--image logger.bin]

Leaves DIR/direct (the session as the simulator writes it, with its truth) and DIR/emulated (card.img, the recordings on
it, serial.txt). Exit code 0; 1 if a sample was lost or a lap time differs; 2 if a tool is missing.
"""

import argparse
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import emulation
from emulation import build

from smoother.arrays import Array
from smoother.cli.lap_stage import fix_path
from smoother.cli.pipeline import calibrated, read
from smoother.estimate.graph.smoother import GraphOptions, GraphSmoother
from smoother.frames import geodetic_to_nwu
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.results import GivenLines
from smoother.session.log import list_recordings, read_records
from smoother.session.log_decode import Losses
from smoother.session.log_format import LogRecords
from smoother.sim.record_log import CALIBRATION_FILE, drive_records, write_klg
from smoother.sim.simulation import Simulation, simulate_preset

LIMIT_MS = 2.0
SAME_LAP_S = 1.0
WAITS = {
    **{"irq6_wait_us": "IMU pin", "irq14_wait_us": "IMU DMA", "irq28_wait_us": "timer"},
    **{"irq38_wait_us": "receiver", "irq16_wait_us": "receiver DMA"},
    **{"irq12_wait_us": "card DMA", "irq37_wait_us": "stream"},
}


@dataclass(frozen=True)
class Comparison:
    """Samples (simulated, recorded as they were, recorded otherwise) and lap times (K,) s: truth, direct, emulated."""

    samples: int
    equal: int
    lost_by_logger: int
    losses: Losses
    laps: Array

    @property
    def worst_ms(self) -> float:
        """Largest difference between the lap times of the two recordings; inf without laps."""
        return float(np.max(np.abs(self.laps[:, 2] - self.laps[:, 1])) * 1e3) if len(self.laps) else np.inf

    @property
    def is_whole(self) -> bool:
        """Whether every simulated sample is in the recording, unchanged."""
        return self.equal == self.samples and self.lost_by_logger == 0 and self.losses == Losses()


def simulated(seed: int, duration: float, track: str = "larkfield") -> Simulation:
    """A kart session at 1 kHz. Its stamps have no jitter: the logger makes its own."""
    changes = {"imu.rate": 1000.0, "imu.jitter": 0.0}
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
    estimate = GraphSmoother(GraphOptions()).estimate(session)
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


def compare(simulation: Simulation, direct: Path, emulated: Path, has_laps: bool = True) -> Comparison:
    """Compare what was written directly with what came through the logger."""
    wanted = drive_records(simulation)
    got, losses = recorded(emulated)
    rows = []
    if has_laps:
        ours, theirs = lap_times(emulated, simulation, emulation.LEAD_S), lap_times(direct, simulation, 0.0)
        rows = [(theirs[k][1], theirs[k][0], ours[k][0]) for k in sorted(ours.keys() & theirs.keys())]
    lost = got.stop.imu_lost if got.stop else len(wanted.imu)
    return Comparison(len(wanted.imu), count_equal(wanted, got), lost, losses, np.array(rows).reshape(-1, 3))


def prepare_folder(simulation: Simulation, folder: Path) -> tuple[Path, Path]:
    """Folders for the direct recording, which is written, and for the emulated one."""
    direct, emulated = folder / "direct", folder / "emulated"
    for part in (direct, emulated):
        shutil.rmtree(part, ignore_errors=True)
    emulated.mkdir(parents=True)
    write_klg(simulation, direct)
    return direct, emulated


def through_firmware(simulation: Simulation, folder: Path, image: Path, **settings: int) -> emulation.Outcome:
    """Run a session through an image; the recordings on its card are left in `folder`."""
    records = drive_records(simulation)
    stimulus = emulation.stimulus_of(records)
    outcome = emulation.run(folder, image, stimulus, emulation.drive_script(stimulus, records, **settings))
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
    print(" lap    truth   direct through firmware  difference ms")
    for i, (true, direct, ours) in enumerate(comparison.laps, 1):
        print(f"{i:4} {true:8.3f} {direct:8.3f} {ours:16.3f} {1e3 * (ours - direct):14.2f}")
    for name, column in (("directly written", 1), ("through the firmware", 2)):
        if len(comparison.laps):
            rms = 1e3 * np.sqrt(np.mean((comparison.laps[:, column] - comparison.laps[:, 0]) ** 2))
            print(f"{name}: {rms:.1f} ms rms from the truth")
    print(f"largest difference {comparison.worst_ms:.2f} ms (limit {LIMIT_MS})")


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
    simulation = simulated(options.seed, options.duration, options.track)
    direct, emulated = prepare_folder(simulation, options.folder)
    show_machine(through_firmware(simulation, emulated, image, seed=options.seed, stall_us=1000 * options.stall))
    comparison = compare(simulation, direct, emulated, not options.no_laps)
    show(comparison)
    is_good = comparison.is_whole and (options.no_laps or comparison.worst_ms < LIMIT_MS)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
