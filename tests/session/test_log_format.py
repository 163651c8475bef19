"""The three places that state the format agree: firmware/FORMAT.md, the headers of the core, and log_format.py."""

import re
from pathlib import Path

import pytest

from smoother.session import log_format

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
FORMAT = (FIRMWARE / "FORMAT.md").read_text(encoding="utf-8")
HEADERS = "".join(path.read_text(encoding="utf-8") for path in sorted((FIRMWARE / "core").glob("*.h")))
STRUCTS = {
    "GAP": log_format.GAP_STRUCT,
    "SETUP": log_format.SETUP_STRUCT,
    "EVENT": log_format.EVENT_STRUCT,
    "SELF_TEST": log_format.SELF_TEST_STRUCT,
    "STOP": log_format.STOP_STRUCT,
}


def constants():
    """Named numbers of the headers."""
    return {name: int(value, 0) for name, value in re.findall(r"\b([A-Z][A-Z0-9_]+) = (0x[0-9A-F]+|\d+)\b", HEADERS)}


def tables():
    """Rows of the tables of FORMAT.md, by the number of the section."""
    parts = re.split(r"^## (\d)\. .*$", FORMAT, flags=re.MULTILINE)
    return {
        int(number): [
            [cell.strip(" `") for cell in line.strip("|").split("|")]
            for line in text.splitlines()
            if line.startswith("|")
        ]
        for number, text in zip(parts[1::2], parts[2::2], strict=True)
    }


def test_types_and_lengths_of_records():
    rows = [row for row in tables()[3] if re.fullmatch(r"[0-9A-F]{2}", row[0])]
    assert len(rows) == 10
    header = constants()
    for kind, name, length, _ in rows:
        assert header[f"RECORD_{name}"] == getattr(log_format, name) == int(kind, 16)
        if not length.isdigit():
            continue
        assert header[f"RECORD_{name}_BYTES"] == int(length)
        short = log_format.SHORT_LAYOUTS.get(int(kind, 16))
        assert int(length) == (6 + STRUCTS[name].size if short is None else short.itemsize)


@pytest.mark.parametrize(("section", "size"), [(2, 512), (4, 64)])
def test_fields_follow_each_other_without_a_hole(section, size):
    rows = [row for row in tables()[section] if row[0].isdigit()]
    end = 0
    for offset, length, *_ in rows:
        assert int(offset) == end
        end += int(length)
    assert end == size


def test_events_are_the_same_everywhere():
    rows = {int(row[0]): row[1] for row in tables()[6] if row[0].isdigit()}
    header = {
        value: name.removeprefix("EVENT_") for name, value in constants().items() if re.match("EVENT_(?!BYTES)", name)
    }
    assert rows == log_format.EVENTS == header


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("BLOCK_BYTES", log_format.BLOCK_BYTES),
        ("BLOCK_RECORDS", log_format.RECORDS_AT),
        ("BLOCK_CRC", log_format.CRC_AT),
        ("FRAME_HEAD", log_format.FRAME_HEAD.size),
        ("FRAME_CAPACITY", log_format.FRAME_CAPACITY),
        ("RECORD_GPS_LONGEST", log_format.LONGEST_SENTENCE),
        ("RECORD_CONFIG_PIECE", log_format.CONFIG_PIECE),
        ("RECORD_FIRST_LONG", log_format.FIRST_LONG),
        ("GAP_NO_ROOM", log_format.GAP_NO_ROOM),
        ("GAP_SENSOR", log_format.GAP_SENSOR),
        ("GAP_SERIAL", log_format.GAP_SERIAL),
        ("STOP_CARD_FULL", log_format.STOP_CARD_FULL),
        ("STOP_FAULT", log_format.STOP_FAULT),
        ("PURPOSE_MAG_CALIBRATION", log_format.PURPOSE_MAG_CALIBRATION),
        ("MAG_OVERFLOW", log_format.MAG_OVERFLOW),
        ("SETUP_CONFIG_READ", log_format.SETUP_CONFIG_READ),
    ],
)
def test_numbers_of_the_headers_are_those_of_the_reader(name, value):
    assert constants()[name] == value
