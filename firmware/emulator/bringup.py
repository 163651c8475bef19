"""What the serial line and the LED say when a wire is missing: the page for the first start of a board.

    python firmware/emulator/bringup.py            # writes firmware/BRINGUP.md
    python firmware/emulator/bringup.py --check    # exit code 1 if the page is not what the image says

Each row is a run of the release image in the emulator.
"""

import argparse
import re
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import emulation
from emulation import FIRMWARE, Script, build
from evidence import Evidence, numbered_stimulus

PAGE = FIRMWARE / "BRINGUP.md"
DURATION_S = 9.0
LED_WINDOW_S = (5.5, 8.5)
HEAD = """# The first start

Connect PA9 to a serial adapter's RX, both grounds, 115200 baud (8N1), and press reset. The table is made by
`firmware/emulator/bringup.py` from runs of the release image on an emulated board; **no board was measured**. What
differs from board to board stands as `..`.

"""
TAIL = """
Type `selftest` and Enter (the adapter's TX on PA10) while nothing is recorded: the LED is on while each part is
tried, and a line says what came of it.

    selftest: heard; the LED is on until the end
    selftest imu: well, id 71, 1000 samples in a second, on the pin INT
    selftest magnetometer: well, id 48
    selftest card: well, 469 kB/s, longest busy 2246 us, sent again 0
    selftest gps: well, 57600 baud, settings refused 0, fix
    selftest: done

The rate of the card is that of single blocks, each waited for; 20 kB/s would do. A card that is
busy for longer than 700 ms costs samples.

Nothing on the line at all, LED dark: no 3.3 V, BOOT0 at 1, nothing flashed, or PA9 on the adapter's TX. LED dark, but
text: a long press has stopped it, or the LED is another than PC13's.

| line | meaning |
|---|---|
| `imu: RESULT, id WHO_AM_I, magnetometer WIA` | 0 well, -1 nobody there, -2 a register is not kept, -3 the bus |
| `card: RESULT ERROR, ..` | result 0 well, -1 the card, -2 not FAT16 or FAT32 |
| | error -1 no answer, -2 too slow, -3 refused, -4 damaged on the wires, -5 cannot write, -6 no SD card |
| `event CODE VALUE` | FORMAT.md, section 6 |
"""


@dataclass(frozen=True)
class Fault:
    """A board: what is wrong with it, and how the emulator makes it so."""

    name: str
    actions: tuple[str, ...] = ()
    settings: tuple[tuple[str, int], ...] = ()


FAULTS = (
    Fault("all is well"),
    Fault("card missing, or its CS, SCK, MISO or supply", ("card_absent 1",)),
    Fault("card on wires that flip bits (long, loose)", ("card_flip 3000",)),
    Fault("card not formatted as FAT32", (), (("blank", 1),)),
    Fault("card full", (), (("free_clusters", 400),)),
    Fault("card write-protected or worn out", ("card_protect 1",)),
    Fault("IMU's NCS, SCLK, SDO or supply", ("imu_absent 1",)),
    Fault("IMU's SDI loose: a register does not keep what is written", (f"imu_stuck {0x1B}",)),
    Fault("IMU's INT: no difference on the line, times are up to 0.5 ms late", ("imu_wire 0",)),
    Fault("IMU is an MPU6500, without magnetometer", ("who 112", "mag_absent 1")),
    Fault("magnetometer does not answer", ("mag_absent 1",)),
    Fault("receiver's TX, or its supply", ("gps_absent 1",)),
    Fault("receiver's RX: it is logged as it is", ("gps_deaf 1",)),
    Fault("receiver at a wrong supply: noise", ("gps_garble 1",)),
    Fault("crystal does not start", ("crystal 0", "restart 1")),
)


def lines_of(serial: str) -> list[str]:
    """What a person would look at: every line once, from the last start on, without what differs from run to run."""
    text = re.split(r"\[.*? at \d+ us\]\n", serial)[-1]
    lines = [re.sub(r"^(recording) \w+", r"\1 ..", line.strip()) for line in text.splitlines()]
    lines = [re.sub(r"\d+ s: state (\d+),.*", r"5 s: state \1, ..", line) for line in lines]
    return list(dict.fromkeys(line for line in lines if line and not line.startswith(("event 13", "10 s"))))


def row_of(fault: Fault, folder: Path, image: Path) -> str:
    """The row of the page for a fault."""
    script = Script(dict(fault.settings), ["autostart=yes"], [(0, action) for action in fault.actions])
    script.actions.append((round(1e6 * DURATION_S), "end"))
    outcome = emulation.run(folder, image, numbered_stimulus(DURATION_S + 1.0), script)
    said = lines_of((folder / "serial.txt").read_text(errors="replace"))
    return f"| {fault.name} | {Evidence(outcome).led(*LED_WINDOW_S)} | {'<br>'.join(f'`{line}`' for line in said)} |"


def make_page(image: Path, faults: tuple[Fault, ...] = FAULTS) -> str:
    """The whole page."""
    with tempfile.TemporaryDirectory() as name:
        rows = [row_of(fault, Path(name) / str(i), image) for i, fault in enumerate(faults)]
    return (
        HEAD + "\n".join(["| what is wrong | LED (README.md) | the line says |", "|---|---|---|", *rows]) + "\n" + TAIL
    )


def main() -> int:
    """Write or check; the exit code."""
    parser = argparse.ArgumentParser(description="The page of the first start")
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    try:
        emulation.build_emulator()
        image = emulation.build_image()
    except build.MissingError as error:
        print(f"emulator: {error}", file=sys.stderr)
        return 2
    page = make_page(image)
    if options.check:
        return 0 if PAGE.read_text() == page else 1
    PAGE.write_text(page)
    return 0


if __name__ == "__main__":
    sys.exit(main())
