"""The wiring: one table of pins, from which the README's table and the drawing are made.

    python3 firmware/wiring.py            # writes both
    python3 firmware/wiring.py --check    # exit code 1 if they are not as the table says

tests/firmware/test_wiring.py holds the table against the pins that the firmware's sources configure.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

HERE = Path(__file__).resolve().parent
README, DRAWING = HERE / "README.md", HERE / "wiring.svg"
BEGIN, END = "<!-- pins: made by wiring.py -->\n", "<!-- end of pins -->\n"


@dataclass(frozen=True)
class Pin:
    """A pin of the Blue Pill: the part and its pin it is wired to, and what for."""

    name: str
    part: str
    at: str
    use: str
    is_optional: bool = False
    is_on_board: bool = False


IMU, CARD, GPS, HAND, ADAPTER = "MPU9250", "microSD socket", "NEO-6M", "button", "serial adapter"
PINS = (
    Pin("PB12", IMU, "NCS", "chip select"),
    Pin("PB13", IMU, "SCL/SCLK", "clock"),
    Pin("PB14", IMU, "AD0/SDO", "data to the Blue Pill"),
    Pin("PB15", IMU, "SDA/SDI", "data from it"),
    Pin("PB0", IMU, "INT", "recommended: exact times; without it they are up to 0.5 ms late", True),
    Pin("PA4", CARD, "CS", "chip select"),
    Pin("PA5", CARD, "SCK", "clock"),
    Pin("PA6", CARD, "MISO/DO", "data to the Blue Pill"),
    Pin("PA7", CARD, "MOSI/DI", "data from it"),
    Pin("PA2", GPS, "RX", "lets it be configured; without it, its defaults are logged, once a second"),
    Pin("PA3", GPS, "TX", "sentences"),
    Pin("PA0", HAND, "button", "other side to ground"),
    Pin("PC13", HAND, "LED", "the Blue Pill's own: no wire", is_on_board=True),
    Pin("PA9", ADAPTER, "RX", "optional: live stream and messages", True),
    Pin("PA10", ADAPTER, "TX", "optional: the command `selftest`", True),
)
PARTS = (IMU, CARD, GPS, HAND, ADAPTER)
SUPPLY = {IMU: ("3.3", "GND"), CARD: ("3.3", "GND"), GPS: ("5V", "GND"), HAND: ("GND",), ADAPTER: ("GND",)}
COLOURS = {IMU: "#1f6fb2", CARD: "#b25a1f", GPS: "#2f8f4e", HAND: "#6b4fa0", ADAPTER: "#666666"}


def table() -> str:
    """The README's table."""
    rows = ["| Blue Pill | to | its pin | |", "|---|---|---|---|"]
    rows += [f"| {pin.name} | {pin.part} | {pin.at} | {pin.use} |" for pin in PINS]
    return "\n".join(rows) + "\n"


# ---- the drawing ----

ROW, TOP, BOARD_X, BOARD_WIDTH, PART_X, PART_WIDTH, GAP = 22, 60, 40, 130, 430, 210, 14


def _text(x: float, y: float, text: str, more: str = "") -> str:
    return f'<text x="{x:g}" y="{y:g}" {more}>{escape(text)}</text>'


def _wire(x: float, y: float, end_x: float, colour: str, is_dashed: bool) -> str:
    dash = ' stroke-dasharray="5 4"' if is_dashed else ""
    return f'<line x1="{x:g}" y1="{y:g}" x2="{end_x:g}" y2="{y:g}" stroke="{colour}" stroke-width="2"{dash}/>'


def drawing() -> str:
    """The wiring as SVG: the Blue Pill on the left, each part on the right, one straight wire a row."""
    shapes: list[str] = []
    y = TOP
    for part in PARTS:
        pins = [pin for pin in PINS if pin.part == part and not pin.is_on_board]
        height = ROW * (len(pins) + len(SUPPLY[part])) + 10
        shapes.append(
            f'<rect x="{PART_X}" y="{y}" width="{PART_WIDTH}" height="{height}" rx="6" fill="#ffffff"'
            f' stroke="{COLOURS[part]}" stroke-width="2"/>'
        )
        shapes.append(_text(PART_X + PART_WIDTH - 10, y + 20, part, 'text-anchor="end" font-weight="bold"'))
        rows = [(pin.name, pin.at, pin.is_optional, COLOURS[part]) for pin in pins]
        rows += [
            (name, "VCC" if name != "GND" else "GND", False, "#c0392b" if name != "GND" else "#222222")
            for name in SUPPLY[part]
        ]
        for i, (name, at, is_optional, colour) in enumerate(rows):
            middle = y + ROW * (i + 0.5) + 5
            shapes.append(_wire(BOARD_X + BOARD_WIDTH, middle, PART_X, colour, is_optional))
            shapes.append(_text(BOARD_X + BOARD_WIDTH - 8, middle + 5, name, 'text-anchor="end"'))
            shapes.append(_text(PART_X + 8, middle + 5, at))
        y += height + GAP
    board = (
        f'<rect x="{BOARD_X}" y="{TOP}" width="{BOARD_WIDTH}" height="{y - GAP - TOP}" rx="6" fill="#eef3f8"'
        ' stroke="#1b3a57" stroke-width="2"/>'
    )
    title = _text(
        BOARD_X, 30, "Wiring of the logger: one row, one wire. Dashed: optional.", 'font-size="16" font-weight="bold"'
    )
    label = _text(BOARD_X + 8, TOP + 20, "Blue Pill", 'font-weight="bold"')
    notes = (
        "100 uF and 100 nF at the card's supply. Wires of card and IMU under 10 cm.",
        "5 V comes in at the pin 5V. The LED is the Blue Pill's own.",
    )
    note = "\n".join(_text(BOARD_X, y + 12 + 18 * i, text) for i, text in enumerate(notes))
    style = 'font-family="DejaVu Sans, Arial, sans-serif" font-size="13"'
    width, height = PART_X + PART_WIDTH + 40, y + 48
    size = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    back = f'<rect width="{width}" height="{height}" fill="#ffffff"/>'
    body = "\n".join([back, title, board, label, *shapes, note])
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {style}>\n{body}\n</svg>\n'


def with_table(readme: str) -> str:
    """The README with its table as it must be."""
    before, rest = readme.split(BEGIN)
    return before + BEGIN + table() + END + rest.split(END)[1]


def main() -> int:
    """Write or check; the exit code."""
    parser = argparse.ArgumentParser(description="The wiring's table and drawing")
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    wanted = {README: with_table(README.read_text()), DRAWING: drawing()}
    wrong = [path for path, text in wanted.items() if not path.is_file() or path.read_text() != text]
    for path in wrong:
        print(f"{path.name}: {'is not as the table of pins says' if options.check else 'written'}")
        if not options.check:
            path.write_text(wanted[path])
    return 1 if wrong and options.check else 0


if __name__ == "__main__":
    sys.exit(main())
