"""Write the image onto a board by whatever tool and adapter are there, or make the files of a release.

    python3 firmware/flash.py [--port /dev/ttyUSB0] [--dry-run]     # make flash
    python3 firmware/flash.py --release DIR                         # make release

The first of these that is installed is used: st-flash, openocd (both with an ST-Link), stm32flash (serial adapter, with
--port). Exit code 0; 1 if the tool failed; 2 if none is there.
"""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import build

IMAGE = build.HERE.parent / "build" / "firmware"
FLASH_AT = "0x08000000"
FORMATS = ("bin", "hex")
HELP = "install st-flash (package stlink-tools), openocd or stm32flash; DFU needs a bootloader that a Blue Pill has not"


def find_port() -> str | None:
    """The serial adapter, if there is exactly one."""
    ports = [port for name in ("ttyUSB*", "ttyACM*", "cu.usbserial*") for port in Path("/dev").glob(name)]
    return str(ports[0]) if len(ports) == 1 else None


def command(folder: Path, port: str | None) -> list[str] | None:
    """What writes the image in `folder`; None without a tool. A port that was named wants the serial adapter."""
    tools = [] if port else ["st-flash", "openocd"]
    tool = next((name for name in [*tools, "stm32flash"] if shutil.which(name)), None)
    image, elf = str(folder / "logger.bin"), str(folder / "logger.elf")
    serial = port or find_port()
    if tool == "st-flash":
        return [tool, "--connect-under-reset", "--reset", "write", image, FLASH_AT]
    if tool == "openocd":
        script = f"program {elf} verify reset exit"
        return [tool, "-f", "interface/stlink.cfg", "-f", "target/stm32f1x.cfg", "-c", script]
    if tool == "stm32flash" and serial:
        return [tool, "-w", image, "-v", "-g", FLASH_AT, serial]
    return None


def release(folder: Path, out: Path) -> list[Path]:
    """Copy the image as .bin and .hex into `out`, with SHA256SUMS beside them."""
    out.mkdir(parents=True, exist_ok=True)
    files = [out / f"logger.{name}" for name in FORMATS]
    for path in files:
        shutil.copyfile(folder / path.name, path)
    sums = out / "SHA256SUMS"
    sums.write_text("".join(f"{build.sha256(path)}  {path.name}\n" for path in files))
    return [*files, sums]


def main() -> int:
    """Flash or release; the exit code."""
    parser = argparse.ArgumentParser(description="Flash the image, or make the files of a release")
    parser.add_argument("--image", type=Path, default=IMAGE, help="folder that `make firmware` has built into")
    parser.add_argument("--port", help="serial adapter: set BOOT0 to 1 and press reset before")
    parser.add_argument("--dry-run", action="store_true", help="say what would be run")
    parser.add_argument("--release", type=Path, help="folder for .bin, .hex and their checksums")
    options = parser.parse_args()
    if options.release:
        print("\n".join(str(path) for path in release(options.image, options.release)))
        return 0
    found = command(options.image, options.port)
    if found is None:
        print(f"flash: {HELP}", file=sys.stderr)
        return 2
    print(" ".join(found))
    return 0 if options.dry_run else min(subprocess.run(found, check=False).returncode, 1)


if __name__ == "__main__":
    sys.exit(main())
