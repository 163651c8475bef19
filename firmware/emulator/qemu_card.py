"""A second opinion on driver, file system layer and FatFs: the same sources on QEMU's machine lm3s6965evb.

    python firmware/emulator/qemu_card.py [--cuts 20]

Its card, SSI and core are models that others wrote, its volume is made by `mkfs.fat`, judged by `fsck.fat` and read by
`mcopy`. Each start puts right what the last one left, records a minute of samples that is ended, and begins a recording
that is not. Then QEMU is killed, so many times, while the logger writes. Prints what was found; exit code 0; 1 if
anything was wrong; 2 if a tool is missing.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from emulation import FIRMWARE, HERE, build
from evidence import account, check_volume
from smoother.session.log_decode import decode, find_blocks

SOURCES = ("core/*.c", "drivers/sdcard.c", "app/storage.c", "app/volume.c", "app/diskio.c", "emulator/qemu/*.c")
COMPILER = ["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-Os", "-g", "-std=c11", "-Wall", "-Wextra", "-Werror"]
LINK = ["-nostartfiles", "--specs=nano.specs", "-Wl,--gc-sections", "-ffunction-sections"]
TOOLS = ("qemu-system-arm", "mkfs.fat", "fsck.fat", "mcopy")
CARD_BYTES = 4 << 30  # a power of two, as QEMU wants it; sparse
CLUSTER_SECTORS = 64
CONFIG = b"imu_rate=1000\n# as a person would write it\n"
ENDED_SAMPLES, OPEN_SAMPLES = 60_000, 20_000
IN_BLOCK = 31  # samples that may be in the block being filled when nothing ends it
LONGEST_S = 120.0


@dataclass(frozen=True)
class Opinion:
    """What the stranger's card showed: starts, recordings compared, samples in them, complaints."""

    starts: int = 0
    recordings: int = 0
    samples: int = 0
    complaints: tuple[str, ...] = ()


def find_tools() -> None:
    """See to it that QEMU and the judges are here. MissingError if they cannot be had."""
    build.find_tools(TOOLS)


def build_program(folder: Path) -> Path:
    """Compile the test program. MissingError without a cross compiler or FatFs."""
    build.find_tools()
    fatfs = build.find_fatfs(build.FATFS_CACHE).resolve()
    copied = folder / "fatfs"  # away from the ffconf.h that lies beside it
    copied.mkdir(parents=True, exist_ok=True)
    for name in build.FATFS_SHA256:
        (copied / name).write_bytes((fatfs / name).read_bytes())
    includes = [f"-I{FIRMWARE / part}" for part in ("core", "drivers", "app", "emulator/qemu")]
    options = [*includes, "-isystem", str(copied)]
    sources = [str(path) for pattern in SOURCES for path in sorted(FIRMWARE.glob(pattern))]
    build.run([*COMPILER, *options, "-w", "-c", str(copied / "ff.c"), "-o", str(folder / "ff.o")])
    program, script = folder / "card.elf", HERE / "qemu" / "lm3s6965.ld"
    build.run([*COMPILER, *options, *sources, str(folder / "ff.o"), *LINK, f"-T{script}", "-o", str(program)])
    return program


def tool(name: str) -> str:
    """Path of a program, also where only root has it on the path."""
    return build.find_tool(name) or name


def make_card(image: Path) -> None:
    """A card as it comes from a computer: formatted, with settings on it."""
    with image.open("wb") as file:
        file.truncate(CARD_BYTES)
    build.run([tool("mkfs.fat"), "-F", "32", "-s", str(CLUSTER_SECTORS), str(image)])
    settings = image.with_name("CONFIG.TXT")
    settings.write_bytes(CONFIG)
    build.run([tool("mcopy"), "-i", str(image), str(settings), "::"])


def start(program: Path, image: Path, cut_s: float | None = None) -> dict[str, str]:
    """One start of the machine; what it said, empty if it was killed after `cut_s`. RuntimeError if it failed."""
    command = [tool("qemu-system-arm"), "-M", "lm3s6965evb", "-kernel", str(program), "-display", "none"]
    command += ["-monitor", "none", "-serial", "stdio", "-semihosting"]
    command += ["-drive", f"file={image},if=sd,format=raw"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=cut_s or LONGEST_S, errors="replace")
    except subprocess.TimeoutExpired:
        if cut_s is None:
            raise RuntimeError(f"QEMU did not end within {LONGEST_S:.0f} s") from None
        return {}
    said = dict(line.split(" ", 1) for line in done.stdout.splitlines() if " " in line)
    if done.returncode or said.get("done") != "1":
        raise RuntimeError(f"exit code {done.returncode}: {done.stdout[-300:]}{done.stderr[-300:]}")
    return said


def read_files(image: Path) -> dict[str, bytes]:
    """The recordings on the card as `mcopy` finds them, by name, without the newest, which nothing has ended yet."""
    rows = build.run([tool("mdir"), "-i", str(image), "-b", "::"]).split()
    names = sorted(name for row in rows if (name := row.removeprefix("::/")).endswith(".KLG"))
    with tempfile.TemporaryDirectory() as folder:
        for name in names[:-1]:
            build.run([tool("mcopy"), "-i", str(image), f"::/{name}", folder])
        return {name: (Path(folder) / name).read_bytes() for name in names[:-1]}


def judge_recording(name: str, data: bytes, least: int) -> tuple[int, str]:
    """Samples of a recording, and what is wrong with it."""
    blocks, damaged = find_blocks(data)
    records, losses = decode(blocks)
    seen = account(records)
    is_whole = len(blocks) * 512 == len(data) and not damaged and losses.blocks == losses.samples == 0
    is_true = (
        seen.missing == seen.told == seen.strange == seen.disorder == 0 and seen.first <= 0 and seen.spread_us == 0
    )
    if is_whole and is_true and seen.recorded >= least:
        return seen.recorded, ""
    return seen.recorded, f"{name}: {len(data)} bytes, {losses}, {seen}; {least} samples at least were expected"


def judge(image: Path, opinion: Opinion, before: dict[str, bytes], least: int) -> tuple[Opinion, dict[str, bytes]]:
    """Judge the card after a start; the recordings on it now."""
    complaints = [f"fsck.fat: {text}" for text in [check_volume(image)] if text]
    now = read_files(image)
    complaints += [f"{name} has changed" for name, data in before.items() if now.get(name) != data]
    fresh = {name: data for name, data in now.items() if name not in before}
    found = [judge_recording(name, data, least) for name, data in fresh.items()]
    complaints += [text for _, text in found if text]
    samples = sum(count for count, _ in found)
    return replace(
        opinion,
        starts=opinion.starts + 1,
        recordings=opinion.recordings + len(found),
        samples=opinion.samples + samples,
        complaints=opinion.complaints + tuple(complaints),
    ), now


def run_starts(folder: Path, program: Path, starts: int = 3) -> Opinion:
    """So many starts, each after the one before was left in the middle of a recording."""
    image, opinion = folder / "card.img", Opinion()
    files: dict[str, bytes] = {}
    make_card(image)
    for i in range(starts):
        said = start(program, image)
        opinion, files = judge(image, opinion, files, OPEN_SAMPLES - IN_BLOCK)
        wrong = [] if said["config"] == str(len(CONFIG)) else [f"CONFIG.TXT: {said['config']} bytes were read"]
        wrong += [] if len(files) == 2 * i + 1 else [f"{sorted(files)} after start {i + 1}"]
        ended = files.get(f"LOG{2 * i + 1:05}.KLG", b"")
        wrong += [text for _, text in [judge_recording("the one ended", ended, ENDED_SAMPLES)] if text]
        opinion = replace(opinion, complaints=opinion.complaints + tuple(wrong))
    return opinion


def run_cuts(folder: Path, program: Path, cuts: int, rng: np.random.Generator) -> Opinion:
    """Kill QEMU so many times in the middle of things; each time the next start must put right what was left."""
    image, opinion = folder / "card.img", Opinion()
    files: dict[str, bytes] = {}
    make_card(image)
    began = time.perf_counter()
    start(program, image)
    whole_s = time.perf_counter() - began
    for _ in range(cuts):
        start(program, image, cut_s=float(rng.uniform(0.1, 1.0) * whole_s))
        start(program, image)
        opinion, files = judge(image, opinion, files, 0)
    return opinion


def report(name: str, opinion: Opinion) -> bool:
    """Print the counts; whether nothing was wrong."""
    print(
        f"{name}: {opinion.starts} starts, {opinion.recordings} recordings with {opinion.samples} samples compared,"
        f" {len(opinion.complaints)} complaints"
    )
    for text in opinion.complaints:
        print(f"  {text}")
    return not opinion.complaints


def main() -> int:
    """Ask for the opinion; the exit code."""
    parser = argparse.ArgumentParser(description="The card layer of the firmware on QEMU's card")
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--cuts", type=int, default=20, help="times that QEMU is killed")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            find_tools()
            program = build_program(folder)
        except build.MissingError as error:
            print(f"qemu: {error}", file=sys.stderr)
            return 2
        is_good = report("left in the middle", run_starts(folder, program, options.starts))
        rng = np.random.default_rng(options.seed)
        return 0 if report("killed", run_cuts(folder, program, options.cuts, rng)) and is_good else 1


if __name__ == "__main__":
    sys.exit(main())
