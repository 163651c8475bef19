"""The table of pins, the README's, the drawing and the firmware's sources say the same."""

import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
PORT = FIRMWARE / "port" / "stm32f103"
sys.path.insert(0, str(FIRMWARE))
import wiring  # noqa: E402

FILES = {"board.c": wiring.HAND, "card.c": wiring.CARD, "gps.c": wiring.GPS, "imu.c": wiring.IMU}
OUTPUTS = {"CS", "SCK", "MOSI/DI", "NCS", "SCL/SCLK", "SDA/SDI", "LED"}  # of the Blue Pill; RX of the parts besides


def pins_of(source: str) -> dict[str, str]:
    """Configuration by pin ("PA4") of a source of the port."""
    numbers = dict(re.findall(r"(\w+_PIN) = (\d+)", source))
    found = re.findall(r"gpio_configure\(GPIO([A-C]), (\w+), (\w+)\)", source)
    return {f"P{port}{numbers.get(pin, pin)}": bits for port, pin, bits in found}


def configured() -> dict[str, str]:
    return {pin: bits for path in sorted(PORT.glob("*.c")) for pin, bits in pins_of(path.read_text()).items()}


def test_firmware_configures_exactly_the_pins_of_the_table():
    assert set(configured()) == {pin.name for pin in wiring.PINS}


@pytest.mark.parametrize("name", FILES)
def test_each_part_has_the_pins_of_its_source(name):
    assert set(pins_of((PORT / name).read_text())) <= {pin.name for pin in wiring.PINS if pin.part == FILES[name]}


def test_pins_drive_what_listens_and_listen_to_what_drives():
    bits = configured()
    for pin in wiring.PINS:
        drives = pin.at in OUTPUTS or pin.at == "RX"
        assert drives == ("OUTPUT" in bits[pin.name] or "ALTERNATE" in bits[pin.name]), pin


def test_readme_and_drawing_are_made_from_the_table():
    assert wiring.with_table(wiring.README.read_text()) == wiring.README.read_text()
    assert wiring.drawing() == wiring.DRAWING.read_text()


def test_drawing_has_a_wire_and_both_names_for_each_pin():
    root = ET.fromstring(wiring.DRAWING.read_text())
    names = [element.text for element in root.iter() if element.tag.endswith("text")]
    wires = [element for element in root.iter() if element.tag.endswith("line")]
    wired = [pin for pin in wiring.PINS if not pin.is_on_board]
    for pin in wired:
        assert names.count(pin.name) == 1
        assert names[names.index(pin.name) + 1] == pin.at
    assert len(wires) == len(wired) + sum(map(len, wiring.SUPPLY.values()))


def test_moved_pin_is_noticed():
    text = (PORT / "card.c").read_text()
    assert "PA8" in pins_of(text.replace("GPIOA, 7,", "GPIOA, 8,"))
