"""Campaigns on the release image: power cuts, faults, and bugs put in on purpose, which must be noticed.

    python firmware/emulator/campaign.py cuts [--count 500] [--cache 8]     # about 1 s of processor time each
    python firmware/emulator/campaign.py faults
    python firmware/emulator/campaign.py bugs

Each prints what it counted and ends with exit code 0 if everything held, else 1; 2 if a tool is missing.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import emulate
import emulation
from emulation import FIRMWARE, Script, Stimulus, build

from smoother.session.log_decode import decode, find_blocks
from smoother.sim.record_log import drive_records

# ---- power cuts ----

PRESSES_S = (4.0, 7.0, 10.0, 13.0)  # start, stop, start, stop
END_S = 15.5
AFTER_CUT_US = 2_500_000  # to mount, put in order, make the spare
SETTLED_S = 2.0  # after a stop everything is written
TAIL_MS = 60.0  # DESIGN.md, section 6: without a stall
BLOCK_MS = 27.5
PHASES = ("first start", "begin", "logging", "end")


@dataclass(frozen=True)
class Cut:
    """One power cut: when (us), in which phase, and what was wrong after the next start (empty: nothing)."""

    at_us: int
    phase: str
    complaints: tuple[str, ...]
    tail_ms: float


def life(stimulus: Stimulus, **settings: int) -> Script:
    """First start, two recordings of three seconds, each ended."""
    script = Script(dict(settings), ["autostart=no"], [(round(END_S * 1e6), "end")])
    for press in PRESSES_S:
        script.press(round(press * 1e6))
    return script


def phase_of(t_us: int) -> str:
    """Phase of a life."""
    t = t_us / 1e6
    starts, stops = PRESSES_S[0::2], PRESSES_S[1::2]
    if t < starts[0]:
        return PHASES[0]
    if any(0 <= t - start < 0.8 for start in starts):
        return PHASES[1]
    return PHASES[3] if any(0 <= t - stop < starts[1] - stops[0] for stop in stops) else PHASES[2]


def choose_cuts(writes: np.ndarray, count: int, rng: np.random.Generator) -> list[int]:
    """Times (us) spread evenly over the phases, each while a sector is being written or shortly after."""
    phases = np.array([phase_of(int(t)) for t in writes[:, 0]])
    cuts: list[int] = []
    for i, phase in enumerate(PHASES):
        wanted = count // len(PHASES) + (i < count % len(PHASES))
        chosen = rng.choice(np.flatnonzero(phases == phase), wanted)
        length = np.minimum(writes[chosen, 2] - writes[chosen, 0], 20_000)
        cuts += (writes[chosen, 0] + rng.uniform(0.0, 1.3, wanted) * length).astype(int).tolist()
    return sorted(cuts)


def judge_cut(folder: Path, final: dict[str, bytes], cache: int) -> Cut:
    """Judge what a start after a power cut has left."""
    about = dict(line.split("=") for line in (folder / "about.txt").read_text().split())
    cut_us, complaints = int(about["cut_us"]), []
    tool = build.find_tool("fsck.fat") or "fsck.fat"
    checked = subprocess.run([tool, "-n", folder / "card.img"], capture_output=True, text=True)
    if checked.returncode:
        complaints.append("fsck.fat: " + " / ".join(checked.stdout.splitlines()[1:4]))
    tail_ms = 0.0
    for i, (name, whole) in enumerate(sorted(final.items())):
        start_us, stop_us = (round(1e6 * PRESSES_S[2 * i + k]) for k in range(2))
        path = folder / name
        data = path.read_bytes() if path.exists() else b""
        if cut_us > stop_us + SETTLED_S * 1e6:
            if data != whole:
                complaints.append(f"{name}: an earlier recording has changed")
        elif cut_us > start_us + 1e6:
            if data != whole[: len(data)]:
                complaints.append(f"{name}: {len(data)} bytes are not what was recorded")
            records, _ = decode(find_blocks(data)[0])
            until_us = min(cut_us, stop_us)
            tail_ms = (until_us - int(records.imu_t[-1])) / 1e3 if len(records.imu_t) else np.inf
            stall_from, stall_until = int(about["stall_from_us"]), int(about["stall_until_us"])
            allowed = (
                TAIL_MS + cache * BLOCK_MS + (cut_us - stall_from) / 1e3 * (stall_from < cut_us < stall_until + 60_000)
            )
            if tail_ms > allowed:
                complaints.append(f"{name}: {tail_ms:.0f} ms are lost, {allowed:.0f} allowed")
    return Cut(cut_us, phase_of(cut_us), tuple(complaints), tail_ms)


def recordings_of(outcome: emulation.Outcome) -> dict[str, bytes]:
    """Both recordings of a life that nothing has cut short. RuntimeError if there are others."""
    final = {path.name: path.read_bytes() for path in outcome.recordings}
    if len(final) != 2:
        raise RuntimeError(f"two recordings were expected, there are {sorted(final)}")
    return final


def run_cuts(folder: Path, image: Path, count: int, cache: int = 0, stall_ms: int = 0, seed: int = 1) -> list[Cut]:
    """Let the power go `count` times in a life, each time in another copy of the world."""
    records = drive_records(emulate.simulated(seed, 12.0))
    stimulus = emulation.stimulus_of(records, 4.0)
    settings = {"seed": seed, "cache": cache, "stall_us": 1000 * stall_ms, "list_writes": 1}
    whole = emulation.run(folder / "whole", image, stimulus, life(stimulus, **settings))
    writes = np.loadtxt(whole.folder / "writes.txt", dtype=np.int64)
    script, results = life(stimulus, **settings), []
    for chunk in np.array_split(choose_cuts(writes, count, np.random.default_rng(seed)), max(count // 25, 1)):
        script.actions = [action for action in script.actions if not action[1].startswith("cut")]
        script.actions += [(int(t), f"cut {AFTER_CUT_US}") for t in chunk]
        final = recordings_of(emulation.run(folder / "cuts", image, stimulus, script))
        found = sorted((folder / "cuts").glob("cut*"))
        if len(found) != len(chunk):
            raise RuntimeError(f"{len(chunk)} cuts were expected, there are {len(found)}")
        results += [judge_cut(path, final, cache) for path in found]
        for path in found:
            shutil.rmtree(path)
    return results


def report_cuts(cuts: list[Cut]) -> bool:
    """Print the counts; whether nothing was wrong."""
    bad = [cut for cut in cuts if cut.complaints]
    for phase in PHASES:
        of_phase = [cut for cut in cuts if cut.phase == phase]
        print(f"{phase:12} {len(of_phase):5} cuts, {sum(bool(cut.complaints) for cut in of_phase)} with complaints")
    for cut in bad[:10]:
        print(f"  at {cut.at_us} us, {cut.phase}: {'; '.join(cut.complaints)}")
    tails = [cut.tail_ms for cut in cuts if cut.tail_ms]
    print(
        f"{len(cuts)} power cuts, {len(bad)} with complaints; most lost of a recording {max(tails, default=0):.0f} ms"
    )
    return not bad


# ---- bugs put in on purpose ----

BUGS = {
    "ring of 26 blocks, which must fail at 700 ms": ("app/app.h", "APP_RING_BLOCKS = 28", "APP_RING_BLOCKS = 26"),
    "block without its CRC": ("core/block.c", "BLOCK_CRC, crc32_update(0, block, BLOCK_CRC));", "BLOCK_CRC, 0);"),
    "directory written while recording": (
        "app/storage.c",
        "    storage->next_block++;\n}",
        "    storage->next_block++;\n    if (storage->next_block % 64 == 0) {\n        (void)close_stream(storage);\n"
        "        (void)volume_set_size(&storage->volume, &storage->current, storage->current.bytes);\n"
        "        (void)open_stream(storage);\n    }\n}",
    ),
}


def build_with(bug: tuple[str, str, str], folder: Path) -> Path:
    """Build an image from a copy of the sources with one text replaced."""
    name, old, new = bug
    source = folder / "firmware"
    shutil.rmtree(source, ignore_errors=True)
    shutil.copytree(FIRMWARE, source, ignore=shutil.ignore_patterns("emulator", "__pycache__"))
    text = (source / name).read_text()
    if text.count(old) != 1:
        raise RuntimeError(f"{name}: the place for the bug is not there")
    (source / name).write_text(text.replace(old, new))
    toolchain = source / "port" / "stm32f103" / "toolchain.cmake"
    fatfs = build.find_fatfs(build.FATFS_CACHE).resolve()
    options = ["-G", "Unix Makefiles", f"-DCMAKE_TOOLCHAIN_FILE={toolchain}", f"-DFATFS_DIR={fatfs}"]
    build.run(["cmake", "-S", str(source), "-B", str(folder / "build"), *options])
    build.run(["cmake", "--build", str(folder / "build")])
    return folder / "build" / "logger.bin"


def drive(folder: Path, image: Path, duration: float = 30.0, stall_ms: int = 700, seed: int = 1) -> tuple[bool, str]:
    """Whether a drive through an image is recorded as it must be, and what was found."""
    simulation = emulate.simulated(seed, duration)
    direct, emulated = emulate.prepare_folder(simulation, folder)
    outcome = emulate.through_firmware(simulation, emulated, image, seed=seed, stall_us=1000 * stall_ms)
    writes = outcome.number("metadata_writes")
    try:
        found = emulate.compare(simulation, direct, emulated, has_laps=False)
    except ValueError:
        return False, "no recording can be read"
    text = (
        f"{found.equal} of {found.samples} samples, {found.lost_by_logger} lost, {writes:.0f} writes to the file system"
    )
    return found.is_whole and writes == 0, text


def run_bugs(folder: Path, image: Path) -> bool:
    """The image as it is must pass, every one with a bug must not."""
    is_good, text = drive(folder / "drive", image)
    print(f"as it is: {'passes' if is_good else 'FAILS'}: {text}")
    for name, bug in BUGS.items():
        is_passed, text = drive(folder / "drive", build_with(bug, folder / "bug"))
        print(f"{name}: {'NOT NOTICED' if is_passed else 'noticed'}: {text}")
        is_good = is_good and not is_passed
    return is_good


def main() -> int:
    """Run one campaign; the exit code."""
    parser = argparse.ArgumentParser(description="Campaigns on the release image")
    parser.add_argument("what", choices=("cuts", "bugs"))
    parser.add_argument("--count", type=int, default=500, help="power cuts")
    parser.add_argument("--cache", type=int, default=0, help="sectors in the card's write cache that a cut may undo")
    parser.add_argument("--stall", type=int, default=0, help="longest stall of the card during the cuts, ms")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    try:
        emulation.build_emulator()
        image = emulation.build_image()
        build.find_tools(("fsck.fat",))
    except build.MissingError as error:
        print(f"emulator: {error}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name:
        if options.what == "bugs":
            return 0 if run_bugs(Path(name), image) else 1
        cuts = run_cuts(Path(name), image, options.count, options.cache, options.stall, options.seed)
        return 0 if report_cuts(cuts) and len(cuts) == options.count else 1


if __name__ == "__main__":
    sys.exit(main())
