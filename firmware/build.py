"""Build the logger's firmware: find or install the cross compiler, fetch FatFs, compile, hold the budget.

    python3 firmware/build.py [--out DIR] [--fatfs DIR]

Writes logger.elf, logger.bin and logger.hex into DIR (build/firmware) and prints flash, RAM and worst-case stack. Exit
code 0; 1 if a budget is exceeded or the build fails; 2 if a tool or FatFs cannot be had, with one line that says which.
"""

import argparse
import contextlib
import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import stack_usage

HERE = Path(__file__).resolve().parent
FATFS_CACHE = HERE.parent / "build" / "fatfs"
FLASH_BYTES = 64 * 1024
RAM_BYTES = 20 * 1024
RAM_SLACK = 1024  # left free for what is to come

# FatFs R0.16 as it lies in the source distribution of a Python package; only these three files are used.
PACKAGE = "fatfs-ng==0.1.16"
ARCHIVE = "fatfs_ng-0.1.16.tar.gz"
ARCHIVE_SHA256 = "86dc7b951c24ae60d5e49bc0c3ca8c535772756e80082595529223a7b9f8fe0a"
FATFS_FOLDER = "foreign/fatfs/source"
FATFS_SHA256 = {
    "ff.c": "dbeae3d7d22dbc070983e31af897fa5e43d29c726a0a240fe9589ffe2ec0ef1e",
    "ff.h": "42920ae4d6080bfc2a72d92a9969b5e94eeaff070e5e71d90da9ab6d7d8e158e",
    "diskio.h": "1c2b29f53e061c55d43b2e412c3a61320b2621bac7561a05e275514baa44785a",
}
DEBIAN_PACKAGES = {
    "arm-none-eabi-gcc": ["gcc-arm-none-eabi", "libnewlib-arm-none-eabi", "binutils-arm-none-eabi"],
    "cmake": ["cmake"],
    "make": ["make"],
    "cppcheck": ["cppcheck"],
    "fsck.fat": ["dosfstools"],
    "mkfs.fat": ["dosfstools"],
    "mcopy": ["mtools"],
    "qemu-system-arm": ["qemu-system-arm"],
    "cargo": ["cargo"],
}
TO_BUILD = ("arm-none-eabi-gcc", "cmake", "make")


class MissingError(Exception):
    """Something the build needs is not here and cannot be fetched."""


@dataclass(frozen=True)
class Sizes:
    """What the image takes, in bytes; `stack` by main and interrupt priority."""

    flash: int
    static_ram: int
    stack_reserved: int
    stack: dict[str, int]

    @property
    def ram(self) -> int:
        """RAM with the region reserved for the stack."""
        return self.static_ram + self.stack_reserved

    @property
    def worst_stack(self) -> int:
        """Deepest stack with every interrupt on top of the other."""
        return sum(self.stack.values())


def run(command: list[str], cwd: Path | None = None) -> str:
    """Run a command; its output if it succeeds, RuntimeError with the end of its output if not."""
    done = subprocess.run(command, cwd=cwd, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stdout[-4000:]}")
    return done.stdout


def install(packages: list[str]) -> None:
    """Install Debian packages, as root or with a sudo that does not ask. MissingError where that cannot be."""
    if shutil.which("apt-get") is None:
        raise MissingError("cannot be installed here")
    root = [] if os.geteuid() == 0 else ["sudo", "-n"]
    try:
        run([*root, "apt-get", "install", "-y", "--no-install-recommends", *packages])
    except (RuntimeError, FileNotFoundError):
        try:
            run([*root, "apt-get", "update"])
            run([*root, "apt-get", "install", "-y", "--no-install-recommends", *packages])
        except (RuntimeError, FileNotFoundError) as error:
            raise MissingError("cannot be installed here") from error


def find_tool(tool: str) -> str | None:
    """Path of a program, also where only root has it on the path."""
    return shutil.which(tool) or shutil.which(tool, path="/usr/sbin:/sbin")


def find_tools(tools: tuple[str, ...] = TO_BUILD) -> None:
    """See to it that programs are there, by installing their Debian packages if need be."""
    if any(find_tool(tool) is None for tool in tools):
        with _alone_installing():
            _install_missing(tools)


@contextlib.contextmanager
def _alone_installing() -> Iterator[None]:
    """Wait for other processes that install: apt lets one at a time, and refuses the second."""
    with (Path(tempfile.gettempdir()) / f"kart-smoother-installs-{os.geteuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _install_missing(tools: tuple[str, ...]) -> None:
    missing = [tool for tool in tools if find_tool(tool) is None]  # another process may have seen to it meanwhile
    if not missing:
        return
    packages = [package for tool in missing for package in DEBIAN_PACKAGES[tool]]
    print(f"installing {' '.join(packages)}")
    try:
        install(packages)
    except MissingError as error:
        text = f"{', '.join(missing)} not found; on Debian and Ubuntu: sudo apt install {' '.join(packages)}"
        raise MissingError(text) from error


def sha256(path: Path) -> str:
    """Hash of a file, in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def has_fatfs(folder: Path) -> bool:
    """Whether the folder holds exactly the files wanted."""
    return all((folder / name).is_file() and sha256(folder / name) == wanted for name, wanted in FATFS_SHA256.items())


def download(requirement: str, archive_sha256: str, folder: Path, *options: str) -> None:
    """Fetch one package's archive into a folder, by its hash; RuntimeError if it cannot be had or is another."""
    folder.mkdir(parents=True, exist_ok=True)
    wanted = folder / "requirements.txt"
    wanted.write_text(f"{requirement} --hash=sha256:{archive_sha256}\n")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    run([*command, *options, "--require-hashes", "-r", str(wanted), "-d", str(folder)])


def download_fatfs(folder: Path) -> None:
    """Fetch the archive by its hash and take the three files out of it."""
    try:
        download(PACKAGE, ARCHIVE_SHA256, folder, "--no-binary", PACKAGE.split("==")[0])
    except RuntimeError as error:
        raise MissingError("FatFs cannot be downloaded; --fatfs names a folder with R0.16 from its author") from error
    with tarfile.open(folder / ARCHIVE) as archive:
        for name in FATFS_SHA256:
            member = archive.extractfile(f"{ARCHIVE.removesuffix('.tar.gz')}/{FATFS_FOLDER}/{name}")
            if member is not None:
                (folder / name).write_bytes(member.read())


def find_fatfs(folder: Path) -> Path:
    """Folder with FatFs' sources, downloaded into `folder` unless they are there already."""
    if not has_fatfs(folder):
        download_fatfs(folder)
    if not has_fatfs(folder):
        raise MissingError("FatFs: the archive's files are not the ones expected")
    return folder


def compile_image(out: Path, fatfs: Path) -> None:
    """Configure and build into `out`."""
    toolchain = HERE / "port" / "stm32f103" / "toolchain.cmake"
    configure = ["cmake", "-S", str(HERE), "-B", str(out), "-G", "Unix Makefiles"]
    run([*configure, f"-DCMAKE_TOOLCHAIN_FILE={toolchain}", f"-DFATFS_DIR={fatfs}"])
    run(["cmake", "--build", str(out), "--parallel", "2"])


def section_sizes(elf: Path) -> dict[str, int]:
    """Bytes of each section of the image."""
    rows = [line.split() for line in run(["arm-none-eabi-size", "-A", str(elf)]).splitlines()]
    return {row[0]: int(row[1]) for row in rows if len(row) == 3 and row[1].isdigit()}


def measure(out: Path) -> Sizes:
    """Sizes of the image built in `out`."""
    sections = section_sizes(out / "logger.elf")
    graph = stack_usage.read_call_graph(sorted(out.rglob("*.ci")))
    flash = sections[".vectors"] + sections[".text"] + sections[".data"]
    return Sizes(flash, sections[".data"] + sections[".bss"], sections[".stack"], stack_usage.worst_stack(graph))


def report(sizes: Sizes) -> bool:
    """Print the budget; whether it is kept."""
    rows = [
        ("flash", sizes.flash, FLASH_BYTES),
        ("RAM, with the stack's region", sizes.ram, RAM_BYTES - RAM_SLACK),
        ("worst stack", sizes.worst_stack, sizes.stack_reserved),
    ]
    for name, used, limit in rows:
        print(f"{name:30}{used:8} of {limit:6} bytes ({used / limit:4.0%}){'' if used <= limit else '  TOO MUCH'}")
    print("worst stack: " + ", ".join(f"{name} {used}" for name, used in sizes.stack.items()))
    return all(used <= limit for _, used, limit in rows)


def main() -> int:
    """Build and report; the exit code."""
    parser = argparse.ArgumentParser(description="Build the logger's firmware")
    parser.add_argument("--out", type=Path, default=HERE.parent / "build" / "firmware")
    parser.add_argument("--fatfs", type=Path, default=os.environ.get("FATFS_DIR"), help="folder with FatFs R0.16")
    options = parser.parse_args()
    try:
        find_tools()
        fatfs = options.fatfs or find_fatfs(FATFS_CACHE)
        compile_image(options.out, Path(fatfs).resolve())
        is_kept = report(measure(options.out))
    except MissingError as error:
        print(f"firmware: {error}", file=sys.stderr)
        return 2
    except (RuntimeError, stack_usage.StackError) as error:
        print(f"firmware: {error}", file=sys.stderr)
        return 1
    print(f"{options.out}/logger.elf, .bin, .hex")
    return 0 if is_kept else 1


if __name__ == "__main__":
    sys.exit(main())
