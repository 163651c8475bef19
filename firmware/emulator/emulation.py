"""The emulator from Python: build it, say what is measured and what happens, run the image, read what it left."""

import importlib.util
import os
import resource
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from smoother.session import velned
from smoother.session.log_format import LogRecords, Setup

HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parent
ROOT = FIRMWARE.parent
sys.path.insert(0, str(FIRMWARE))
import build as build  # noqa: E402  also for those who import it from here

IMAGE = ROOT / "build" / "firmware"
PROGRAM = ROOT / "build" / "emulator" / "emulator"
SOURCES = ("machine.c", "chip.c", "clocks.c", "rules.c", "world.c", "main.c")
MODELS = ("sd_model.c", "fat_image.c", "mpu_model.c", "neo_model.c")
LEAD_S = 6.0  # from power-on to the first simulated sample: the receiver is configured and the spare file made by then
BOOT_S = 0.0025  # from power-on to the zero of the logger's clock: the crystal and the PLL start
TAIL_S = 5.0
AHEAD_S = 0.46
PRESS_S = 0.54  # from pressing the button to its effect: it is released, and no second press has come
GYRO_DELAY_US = 3900  # of the low-pass of 92 Hz, RM-MPU-9250A-00 4.5
TEXT_BYTES = 512
MOTION = np.dtype([("time", "<u8"), ("values", "<i2", 6), ("rest", "V4")])
FIELD = np.dtype([("time", "<u8"), ("values", "<i2", 3), ("rest", "V2")])


@dataclass(frozen=True)
class Stimulus:
    """What the sensors measure, on the emulator's clock: times (N,) us, counts, and fixes as (us, sentences)."""

    imu_t: np.ndarray
    imu: np.ndarray
    mag_t: np.ndarray
    mag: np.ndarray
    fixes: list[tuple[int, bytes]]
    start_us: int
    end_us: int

    def pack(self) -> bytes:
        """Bytes as world.c reads them."""
        motions, fields = np.zeros(len(self.imu_t), MOTION), np.zeros(len(self.mag_t), FIELD)
        motions["time"], motions["values"] = self.imu_t, self.imu
        fields["time"], fields["values"] = self.mag_t, self.mag
        counts = np.array([len(motions), len(fields), len(self.fixes)], dtype="<u8").tobytes()
        texts = b"".join(t.to_bytes(8, "little") + text.ljust(TEXT_BYTES, b"\0") for t, text in self.fixes)
        return counts + motions.tobytes() + fields.tobytes() + texts


def stimulus_of(records: LogRecords, lead_s: float = LEAD_S) -> Stimulus:
    """What a board's sensors must measure for it to record `records`, which begin `lead_s` after power-on.

    A simulated sample is half a period late; the chip's low-pass makes it later, by what the logger's SETUP says.
    """
    lead = round(lead_s * 1e6)
    setup = records.setup or Setup()
    imu_lead = lead + GYRO_DELAY_US - setup.imu_period_us // 2
    fixes: list[tuple[int, bytes]] = []
    last = b""
    for t, told in records.sentences:
        is_velocity = told.startswith(velned.HEAD)  # in hex for the model, whose texts end at a zero
        sentence = b"$UBX," + told[len(velned.HEAD) :].hex().encode() + b"\r\n" if is_velocity else told
        if fixes and sentence[3:6] != last:
            fixes[-1] = (fixes[-1][0], fixes[-1][1] + sentence)
        else:
            last = sentence[3:6]
            fixes.append((t + lead, sentence))
    imu_t, imu = _and_back(records.imu_t + imu_lead, records.imu)
    mag_t, mag = _and_back(records.mag_t + lead, records.mag)
    return Stimulus(imu_t, imu, mag_t, mag, fixes, lead, int(records.imu_t[-1]) + imu_lead)


def _and_back(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Samples (N,), and the last `TAIL_S` of them again, backwards: the sensor does not stop when the session does."""
    tail = max(int(np.count_nonzero(t > t[-1] - 1e6 * TAIL_S)), 2) if len(t) > 2 else 0
    back = slice(-2, -tail - 1, -1)
    return np.concatenate([t, 2 * t[-1] - t[back]]) if tail else t, np.concatenate(
        [values, values[back]]
    ) if tail else values


@dataclass
class Script:
    """Settings, CONFIG.TXT and what happens when (us), in order of time."""

    settings: dict[str, int] = field(default_factory=dict)
    config: list[str] = field(default_factory=list)
    actions: list[tuple[int, str]] = field(default_factory=list)

    def text(self) -> str:
        """Lines as world.c reads them."""
        lines = [f"set {name} {value}" for name, value in self.settings.items()]
        lines += [f"config {line}" for line in self.config]
        lines += [f"{t} {what}" for t, what in sorted(self.actions, key=lambda action: action[0])]
        return "\n".join(lines) + "\n"

    def press(self, at_us: int) -> None:
        """Press the button shortly."""
        self.actions += [(at_us, "button 1"), (at_us + 120_000, "button 0")]


def drive_script(stimulus: Stimulus, records: LogRecords, ahead_s: float = AHEAD_S, **settings: int) -> Script:
    """A drive: the recording begins `ahead_s` before the first sample and ends as long after the last.

    If that is negative, nothing is recorded but what was simulated; else there is also what `_and_back` made up. The
    machine is measured from AHEAD_S after the beginning until the button is pressed to end it.
    """
    setup = records.setup or Setup()
    config = ["autostart=no", f"accel_range={setup.accel_range_g}", f"gyro_range={setup.gyro_range_dps}"]
    config += [f"imu_rate={round(1e6 / setup.imu_period_us)}"]
    begin_us = stimulus.start_us - round(1e6 * ahead_s)
    start_us, stop_us = begin_us - round(1e6 * PRESS_S), stimulus.end_us + round(1e6 * (ahead_s - PRESS_S))
    script = Script(dict(settings), config, [(begin_us + round(1e6 * AHEAD_S), "measure"), (stop_us, "measured")])
    script.press(start_us)
    script.press(stop_us)
    script.actions.append((stimulus.end_us + 3_000_000, "end"))
    return script


@dataclass(frozen=True)
class Outcome:
    """What a run left: its folder, measurements by name, seconds of this machine's processor."""

    folder: Path
    measured: dict[str, str]
    cpu_s: float

    def number(self, name: str) -> float:
        """A measurement as a number; 0 if it was not made."""
        return float(self.measured.get(name, 0))

    @property
    def recordings(self) -> list[Path]:
        """Recordings on the card, without the placeholder of a calibration."""
        return sorted(self.folder.glob("LOG*.KLG"))


def find_unicorn() -> tuple[list[str], list[str]]:
    """Options of the compiler and of the linker for libunicorn: of the Python package, or of the system."""
    found = importlib.util.find_spec("unicorn")
    if found is not None and found.origin is not None:
        folder = Path(found.origin).parent
        library = folder / "lib" / "libunicorn.so.2"
        if library.is_file() and (folder / "include" / "unicorn" / "unicorn.h").is_file():
            return [f"-I{folder / 'include'}"], [str(library), f"-Wl,-rpath,{folder / 'lib'}"]
    if Path("/usr/include/unicorn/unicorn.h").is_file():
        return [], ["-lunicorn"]
    raise build.MissingError(
        "unicorn not found: pip install unicorn, or on Debian and Ubuntu: apt install libunicorn-dev"
    )


def build_emulator(program: Path = PROGRAM) -> Path:
    """Compile the emulator. MissingError without a compiler or libunicorn."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise build.MissingError("gcc not found")
    include, link = find_unicorn()
    program.parent.mkdir(parents=True, exist_ok=True)
    options = ["-std=gnu11", "-O2", "-g", "-Wall", "-Wextra", "-Werror", f"-I{FIRMWARE / 'tests' / 'drivers'}"]
    sources = [str(HERE / name) for name in SOURCES] + [str(FIRMWARE / "tests" / "drivers" / name) for name in MODELS]
    new = program.with_suffix(f".{os.getpid()}")
    build.run([compiler, *options, *include, *sources, "-o", str(new), *link, "-lm"])
    new.replace(program)
    return program


def build_image(out: Path = IMAGE) -> Path:
    """Build the release image; its logger.bin. MissingError without a cross compiler or FatFs."""
    build.find_tools()
    fatfs = Path(os.environ.get("FATFS_DIR") or build.find_fatfs(build.FATFS_CACHE))
    build.compile_image(out, fatfs.resolve())
    return out / "logger.bin"


def run(folder: Path, image: Path, stimulus: Stimulus, script: Script, program: Path = PROGRAM) -> Outcome:
    """Run an image in a folder. RuntimeError if the emulated machine met a fault."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in [*folder.glob("*.KLG"), folder / "card.img"]:
        old.unlink(missing_ok=True)
    (folder / "stimulus.bin").write_bytes(stimulus.pack())
    (folder / "script.txt").write_text(script.text())
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [program, image, folder / "stimulus.bin", folder / "script.txt", folder]
    done = subprocess.run(command, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    measured = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    if done.returncode:
        where = f"{measured.get('fault', '')} at {measured.get('fault_pc', '')}"
        raise RuntimeError(f"emulator: exit code {done.returncode} {done.stderr} {where}")
    cpu = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    return Outcome(folder, measured, cpu)
