"""Campaigns on the release image: power cuts, and bugs put in on purpose, which must be noticed.

    python firmware/emulator/campaign.py cuts [--count 500] [--cache 8]     # about 1 s of processor time each
    python firmware/emulator/campaign.py bugs

Each prints what it counted and ends with exit code 0 if everything held, else 1; 2 if a tool is missing.
"""

import argparse
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parent))
import emulate
import emulation
from altered import Edit, Workshop
from emulation import PRESS_S, Script, Stimulus, build
from smoother.errors import SmootherError
from smoother.session.log_decode import Losses, decode, find_blocks
from smoother.sim.record_log import drive_records

# ---- power cuts ----

PRESSES_S = (4.0, 7.0, 10.0, 13.0)  # start, stop, start, stop
END_S = 15.5
BEGUN_S = 1.0  # after the press that starts it, the first blocks of a recording are on the card
SETTLED_S = 2.0  # after the press that ends it, everything is written
TAIL_MS = 60.0  # DESIGN.md, section 6: without a stall
BLOCK_MS = 27.5
AGAIN_PRESS_US, AFTERWARDS_US = 2_400_000, 3_600_000  # world.h
SAME_STEP_US = 50  # by which intervals between samples may differ: other interrupts of the same priority
PARTITION = 2048
HEAD_BYTES = 1 << 20
CHUNK = 60
SESSION = slice(4, 8)  # in a block, FORMAT.md
AGAIN_S = 0.45  # least of what is recorded after the start that follows a cut
ORDERED_S = 1.7  # after which the start has put everything in order
PHASES = ("mount", "spare creation", "rename", "logging", "stop")
MOUNT, SPARE, RENAME, LOGGING, STOP = PHASES
Row = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Plan:
    """One power cut to be: when and in which phase; in the mount, what the first cut did is being put in order when the
    power goes again, again_us after it came back."""

    at_us: int
    phase: str
    again_us: int = 0


@dataclass(frozen=True)
class Cut:
    """One power cut, what was wrong after the next start (empty: nothing), and what was lost of the recording."""

    plan: Plan
    complaints: tuple[str, ...]
    tail_ms: float


def life(stimulus: Stimulus, **settings: int) -> Script:
    """First start, two recordings of three seconds, each ended."""
    script = Script(dict(settings), ["autostart=no"], [(round(END_S * 1e6), "end")])
    for press in PRESSES_S:
        script.press(round(press * 1e6))
    return script


def areas(card: Path) -> tuple[int, int]:
    """First sector of the root directory and first of the files, of the partition in the file `card`, counted in it."""
    with card.open("rb") as file:
        boot = file.read(512)
    sectors_per_cluster, reserved, tables = struct.unpack_from("<BHB", boot, 13)
    entries = reserved + tables * struct.unpack_from("<I", boot, 36)[0]
    return entries, entries + sectors_per_cluster


def label_writes(sectors: Row, first_entry: int, first_file: int) -> list[str]:
    """Phase of each write (N,) of a life, from where it went: a recording ends with the first entry written after its
    blocks, and is begun by the last one before them; whatever else is written makes a spare file."""
    is_block = sectors >= first_file
    is_entry = (sectors >= first_entry) & ~is_block
    labels, is_ending = [], False
    for i in range(len(sectors)):
        is_last = i + 1 < len(sectors) and is_entry[i] and is_block[i + 1]
        labels.append(LOGGING if is_block[i] else RENAME if is_last else STOP if is_ending else SPARE)
        is_ending = bool(is_block[i]) or (is_ending and not is_entry[i])
    return labels


def choose_cuts(writes: Row, labels: list[str], count: int, rng: np.random.Generator) -> list[Plan]:
    """Cuts spread evenly over the phases, each while a sector is being written or shortly after.

    writes (N, 3): begin us, sector, end us. Every tenth in the mount is in that of an empty card, the others are in one
    that has to put in order what a cut before has left.
    """
    plans = []
    for i, phase in enumerate(PHASES):
        wanted = count // len(PHASES) + (i < count % len(PHASES))
        rows = [k for k, label in enumerate(labels) if label == phase or phase == MOUNT]
        chosen = rng.choice(rows, wanted)
        length = np.minimum(writes[chosen, 2] - writes[chosen, 0], 20_000)
        at = (writes[chosen, 0] + rng.uniform(0.0, 1.3, wanted) * length).astype(int)
        again = np.zeros(wanted, dtype=int)
        if phase == MOUNT:
            again = rng.uniform(1.0, 1e6 * ORDERED_S, wanted).astype(int)
            at[9::10], again[9::10] = rng.uniform(1.0, writes[0, 0], len(at[9::10])).astype(int), 0
        plans += [Plan(int(t), phase, int(more)) for t, more in zip(at, again, strict=True)]
    return sorted(plans, key=lambda plan: plan.at_us)


def judge_volume(card: Path) -> list[str]:
    """What fsck.fat says about a volume."""
    tool = build.find_tool("fsck.fat") or "fsck.fat"
    checked = subprocess.run([tool, "-n", card], capture_output=True, text=True)
    return ["fsck.fat: " + " / ".join(checked.stdout.splitlines()[1:4])] if checked.returncode else []


def judge_recording(data: bytes, whole: bytes, times_us: tuple[int, int], cut_us: int, ms: float) -> tuple[str, float]:
    """What is wrong with a recording after a cut at cut_us, and what was lost of it, ms.

    whole: what became of it without the cut. times_us: when it was begun and ended. ms: how much may be lost.
    """
    start_us, stop_us = times_us
    if cut_us > stop_us + SETTLED_S * 1e6:
        return ("" if data == whole else "an earlier recording has changed"), 0.0
    if cut_us < start_us + BEGUN_S * 1e6 and data[SESSION] != whole[SESSION]:
        return "", 0.0  # it had not begun; what is there is the next one
    if data != whole[: len(data)]:
        return f"{len(data)} bytes are not what was recorded", 0.0
    if cut_us < start_us + BEGUN_S * 1e6:
        return "", 0.0
    records, _ = decode(find_blocks(data)[0])
    last_us = int(records.imu_t[-1]) if len(records.imu_t) else start_us
    tail_ms = (min(cut_us, stop_us) - last_us) / 1e3
    return (f"{tail_ms:.0f} ms are lost, {ms:.0f} allowed" if tail_ms > ms else ""), tail_ms


def judge_next(recordings: list[bytes]) -> str:
    """What is wrong with what was recorded after the start that follows a cut: by its stamps, which begin anew."""
    for data in recordings:
        records, losses = decode(find_blocks(data)[0])
        times = records.imu_t
        if len(times) and AGAIN_PRESS_US < times[0] < AFTERWARDS_US:
            is_whole = losses == Losses() and not records.gaps and np.ptp(np.diff(times)) < SAME_STEP_US
            span_s = (times[-1] - times[0]) / 1e6
            return "" if is_whole and span_s > AGAIN_S else f"after the next start only {span_s:.2f} s were recorded"
    return "nothing was recorded after the next start"


def judge_cut(folder: Path, plan: Plan, final: dict[str, bytes], settings: dict[str, int]) -> Cut:
    """Judge what the start after a power cut has left and recorded."""
    about = {name: int(value) for name, value in (x.split("=") for x in (folder / "about.txt").read_text().split())}
    found = {path.name: read_head(path) for path in sorted(folder.glob("LOG*.KLG"))}
    cut_us, stall_us = about["cut_us"], (about["stall_from_us"], about["stall_until_us"])
    in_stall = stall_us[0] < cut_us < stall_us[1] + TAIL_MS * 1e3
    allowed_ms = TAIL_MS + settings["cache"] * BLOCK_MS + in_stall * (cut_us - stall_us[0]) / 1e3
    complaints, tails = judge_volume(folder / "card.img"), [0.0]
    for i, (name, whole) in enumerate(sorted(final.items())):
        start_us, stop_us = (round(1e6 * press) for press in PRESSES_S[2 * i : 2 * i + 2])
        if cut_us > start_us + PRESS_S * 1e6:
            complaint, tail_ms = judge_recording(found.get(name, b""), whole, (start_us, stop_us), cut_us, allowed_ms)
            complaints += [f"{name}: {complaint}"] * bool(complaint)
            tails.append(tail_ms)
    is_prompt = not settings["stall_us"]  # else the card may hold up the start, and the blocks, until the copy ends
    if is_prompt and (complaint := judge_next(list(found.values()))):
        complaints.append(complaint)
    return Cut(plan, tuple(complaints), max(tails))


def read_head(path: Path) -> bytes:
    """As much of a file as a life records; one that is being recorded is as long as its space."""
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def recordings_of(outcome: emulation.Outcome) -> dict[str, bytes]:
    """Both recordings of a life that nothing has cut short. RuntimeError if there are others."""
    final = {path.name: path.read_bytes() for path in outcome.recordings}
    if len(final) != 2:
        raise RuntimeError(f"two recordings were expected, there are {sorted(final)}")
    return final


@dataclass(frozen=True)
class World:
    """The image, what its sensors measure, the settings of the card, and how many cuts may be tried at once."""

    image: Path
    stimulus: Stimulus
    settings: dict[str, int]
    jobs: int = 1


def run_cuts(folder: Path, world: World, count: int, seed: int) -> list[Cut]:
    """Let the power go `count` times in a life, each time in another copy of the world."""
    whole = emulation.run(folder / "whole", world.image, world.stimulus, life(world.stimulus, **world.settings))
    writes = np.loadtxt(whole.folder / "writes.txt", dtype=np.int64)
    labels = label_writes(writes[:, 1] - PARTITION, *areas(whole.folder / "card.img"))
    turns = chunks(choose_cuts(writes, labels, count, np.random.default_rng(seed)), CHUNK)
    with ThreadPoolExecutor(world.jobs) as pool:
        done = pool.map(lambda turn: run_turn(folder / f"turn{turn[0]}", world, turn[1]), enumerate(turns))
        return [cut for cuts in done for cut in cuts]


def run_turn(folder: Path, world: World, plans: list[Plan]) -> list[Cut]:
    """Some of the cuts, in one life that goes on after each."""
    script = life(world.stimulus, **world.settings)
    script.actions += [(plan.at_us, f"cut {plan.again_us}") for plan in plans]
    final = recordings_of(emulation.run(folder, world.image, world.stimulus, script))
    found = sorted(folder.glob("cut*"))
    if len(found) != len(plans):
        raise RuntimeError(f"{len(plans)} cuts were expected, there are {len(found)}")
    cuts = [judge_cut(path, plan, final, world.settings) for path, plan in zip(found, plans, strict=True)]
    shutil.rmtree(folder)
    return cuts


def world_of(
    image: Path, seed: int = 1, cache: int = 0, stall_ms: int = 0, flip_every: int = 0, jobs: int = 1
) -> World:
    """The world of a campaign.

    cache: sectors that a cut may undo; stall_ms: longest stall of the card; flip_every: bytes on its wires to one
    flipped bit.
    """
    stimulus = emulation.stimulus_of(drive_records(emulate.simulated(seed, 12.0)), 4.0)
    settings = {"seed": seed, "cache": cache, "stall_us": 1000 * stall_ms, "flip_every": flip_every, "list_writes": 1}
    return World(image, stimulus, settings, jobs)


def chunks(plans: list[Plan], size: int) -> list[list[Plan]]:
    """The cuts in turns, for an image of the card is kept of each until it is judged."""
    turns = max(-(-len(plans) // size), 1)
    return [plans[i::turns] for i in range(turns)]


def report_cuts(cuts: list[Cut]) -> bool:
    """Print the counts; whether nothing was wrong."""
    bad = [cut for cut in cuts if cut.complaints]
    for phase in PHASES:
        of_phase = [cut for cut in cuts if cut.plan.phase == phase]
        print(f"{phase:15} {len(of_phase):5} cuts, {sum(bool(cut.complaints) for cut in of_phase)} with complaints")
    for cut in bad[:10]:
        print(f"  {cut.plan}: {'; '.join(cut.complaints)}")
    most = max((cut.tail_ms for cut in cuts), default=0.0)
    print(f"{len(cuts)} power cuts, {len(bad)} with complaints; most lost of a recording {most:.0f} ms")
    return not bad


# ---- bugs put in on purpose ----

FULL_LOAD: dict[str, Any] = {"mag.rate": 100.0}
STORM = {"stall_rest_us": 200_000, "stall_pause_us": 300_000}
BUGS = {
    "ring of 26 blocks, which must fail at 700 ms": Edit("app/app.h", "APP_RING_BLOCKS = 28", "APP_RING_BLOCKS = 26"),
    "block without its CRC": Edit("core/block.c", "BLOCK_CRC, crc32_update(0, block, BLOCK_CRC));", "BLOCK_CRC, 0);"),
    "directory written while recording": Edit(
        "app/storage.c",
        "    storage->next_block++;\n}",
        "    storage->next_block++;\n    if (storage->next_block % 64 == 0) {\n        (void)close_stream(storage);\n"
        "        (void)volume_set_size(&storage->volume, &storage->current, storage->current.bytes);\n"
        "        (void)open_stream(storage);\n    }\n}",
    ),
}


def drive(folder: Path, image: Path, duration: float = 30.0, stall_ms: int = 700, seed: int = 1) -> tuple[bool, str]:
    """Whether a drive through an image is recorded as it must be, and what was found.

    Stalls follow one another closely, and the magnetometer is as fast as it can be: the most that there is to record.
    """
    simulation = emulate.simulated(seed, duration, **FULL_LOAD)
    direct, emulated = emulate.prepare_folder(simulation, folder)
    settings = {"seed": seed, "stall_us": 1000 * stall_ms, **STORM}
    outcome = emulate.through_firmware(simulation, emulated, image, **settings)
    try:
        found = emulate.compare(simulation, direct, emulated, has_laps=False)
    except (SmootherError, ValueError) as error:
        return False, str(error)
    writes, stalls = outcome.number("metadata_writes"), outcome.number("stalls")
    counts = f"{found.equal} of {found.samples} samples, {found.lost_by_logger} lost in {stalls:.0f} stalls"
    return found.is_whole and writes == 0, f"{counts}, {writes:.0f} writes to the file system"


def run_bugs(folder: Path, image: Path) -> bool:
    """The image as it is must pass, every one with a bug must not."""
    workshop = Workshop(folder / "workshop")
    is_good, text = drive(folder / "drive", image)
    print(f"as it is: {'passes' if is_good else 'FAILS'}: {text}")
    for name, bug in BUGS.items():
        is_passed, text = drive(folder / "drive", workshop.build([bug]))
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
    parser.add_argument("--flip", type=int, default=0, help="bytes on the card's wires to a flipped bit; 0: none")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="cuts tried at the same time")
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
        world = world_of(image, options.seed, options.cache, options.stall, options.flip, options.jobs)
        cuts = run_cuts(Path(name), world, options.count, options.seed)
        return 0 if report_cuts(cuts) and len(cuts) == options.count else 1


if __name__ == "__main__":
    sys.exit(main())
