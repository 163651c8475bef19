"""The rows of the fault table that are about the card."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from expectations import (
    Case,
    Expectation,
    all_kept,
    all_told,
    event,
    led,
    measured,
    no_event,
    recordings,
    says,
    seen_as,
    stopped,
)
from smoother.session.log_format import (
    STOP_BUTTON,
    STOP_CARD_FULL,
)

STEP_CLUSTERS = 512  # 16 MB, the smallest spare file
KEPT_FILE = "MAG00001KLG"  # on the card beforehand


def _untouched() -> tuple[Expectation, ...]:
    return (measured("nothing is written to the card", "writes", 0, 0),)


def _kept_file() -> tuple[Expectation, ...]:
    return (
        seen_as("what was on the card is still there", lambda seen: "" if seen.files.get(KEPT_FILE) else "it is not"),
    )


def _no_recording() -> tuple[Expectation, ...]:
    return (recordings(0),)


CARD = (
    Case(
        "missing at the start, put in after 6 s",
        "card missing",
        ((0, "card_absent 1"), (6, "card_absent 0")),
        (led("card missing", 1.5, 5.5), led("recording", 9, 12), all_kept(9, 12.4), recordings(1), says("card: -1 ")),
    ),
    Case(
        "initialisation does not end for 6 s",
        "card missing",
        ((0, "card_mute 1"), (6, "card_mute 0")),
        (led("card failing", 2.5, 5.5), led("recording", 10, 12), all_kept(10, 12.4), recordings(1)),
    ),
    Case(
        "loose: away for 0.1 s, for 0.3 s and for 0.5 s",
        "card removed",
        (
            *((5, "card_absent 1"), (5.1, "card_absent 0"), (7, "card_absent 1"), (7.3, "card_absent 0")),
            *((9, "card_absent 1"), (9.5, "card_absent 0")),
        ),
        (
            recordings(1, files=1),
            all_kept(1.5, 12.4),
            event("CARD_LOST", "CARD_BACK"),
        ),
    ),
    Case(
        "pulled out for 4 s",
        "card removed",
        ((6, "card_absent 1"), (10, "card_absent 0")),
        (
            led("card missing", 7, 9.8),
            led("recording", 13, 15.5),
            recordings(1, files=2),
            all_told(1.5, 16.4, lost=(2500, 6000)),
            event("CARD_LOST", "CARD_BACK"),
            stopped(STOP_BUTTON),
        ),
        duration=20,
    ),
    Case(
        "another card is put in after 3 s",
        "card removed",
        ((6, "card_absent 1"), (9, "card_other 1")),
        (
            led("card missing", 7, 8.8),
            led("recording", 13, 15.5),
            recordings(1, files=2),
            all_told(1.5, 16.4, lost=(1500, 6000)),
            event("CARD_LOST", "CARD_BACK"),
        ),
        duration=20,
    ),
    Case(
        "pulled out for good, put in again before the next start",
        "card removed",
        ((8, "card_absent 1"), (24, "restart 1")),
        (
            led("card missing", 9, 11.8),
            recordings(2),
            all_kept(1.5, 7.9),
            stopped(0),
            event("RECOVERED", index=1),
            led("recording", 27, 31),
        ),
        duration=32,
        stop=12,
    ),
    Case(
        "refuses a block once, mishears another",
        "card failing",
        ((5, "card_refuse 1"), (7, "card_mishear 1")),
        (recordings(1, files=1), all_kept(1.5, 12.4), event("CARD_RETRY")),
    ),
    Case(
        "wires that flip a bit in 20,000 bytes",
        "card's wires",
        ((0, "card_flip 20000"), (0, "stall 700000")),
        (recordings(1, files=1), all_kept(3, 26.4), event("CARD_RETRY"), no_event("CARD_LOST"), stopped(STOP_BUTTON)),
        duration=30,
    ),
    Case(
        "wires that flip a bit in 3,000 bytes",
        "card's wires",
        ((0, "card_flip 3000"),),
        (recordings(1), all_kept(4, 26.4), event("CARD_RETRY"), led("recording", 8, 26)),
        duration=30,
    ),
    Case(
        "wires that carry 5 MHz and no more",
        "card's wires",
        ((0, "card_flip 500"), (0, "card_flip_above 5000000")),
        (recordings(1, files=1), all_kept(4, 12.4), measured("the clock has come down", "card_hz", 4.5e6, 4.5e6)),
    ),
    Case(
        "refuses every block for 1 s",
        "card failing",
        ((6, "card_refuse 100000"), (7, "card_refuse 0")),
        (
            recordings(1, files=2),
            all_told(1.5, 14.4, lost=(1000, 2000)),
            event("CARD_LOST", "CARD_BACK"),
            led("recording", 11, 14),
        ),
        duration=18,
    ),
    Case(
        "hangs after a block until it is started again",
        "card busy for longer than 1 s",
        ((6, "card_hang 5"),),
        (recordings(1, files=1), all_told(1.5, 12.4, lost=(200, 1000)), event("CARD_RETRY"), led("recording", 9, 12)),
    ),
    Case(
        "busy for 0.9 s",
        "card busy up to 1 s",
        ((6, "card_stall 900000"),),
        (recordings(1, files=1), all_told(1.5, 12.4, lost=(50, 300)), no_event("CARD_RETRY", "CARD_LOST")),
    ),
    Case(
        "stalls of up to 700 ms",
        "card busy up to 1 s",
        ((0, "stall 700000"),),
        (recordings(1, files=1), all_kept(3, 16.4), no_event("CARD_RETRY", "CARD_LOST")),
        duration=20,
        settings={"stall_rest_us": 200_000, "stall_pause_us": 300_000},
    ),
    Case(
        "slow: 20 ms a block",
        "card slow",
        ((3, "card_busy 10000"),),
        (
            recordings(1, files=1),
            all_kept(1.5, 12.4),
            no_event("CARD_RETRY", "CARD_LOST"),
            led("recording", 6, 12),
            stopped(STOP_BUTTON),
        ),
        duration=30,
        stop=12.5,
    ),
    Case(
        "too slow: 60 ms a block, half of what comes",
        "card slow",
        ((4, "card_busy 30000"), (12, "card_busy 300")),
        (
            recordings(1, files=1),
            all_told(1.5, 16.4, lost=(2000, 5000)),
            no_event("CARD_LOST"),
            led("recording", 6, 12),
        ),
        duration=20,
    ),
    Case(
        "answers without knowing about CRCs, misreads a sector at the start",
        "card failing",
        ((0, "card_no_crc 1"), (0, "card_misread 3")),
        (recordings(1), all_kept(4, 12.4)),
    ),
    Case(
        "misreads a sector at the start",
        "card failing",
        ((0, "card_misread 3"),),
        (recordings(1), all_kept(4, 12.4)),
    ),
    Case(
        "write-protected from the start",
        "card write-protected",
        ((0, "card_protect 1"),),
        (led("card failing", 3, 12), *_no_recording(), *_untouched(), *_kept_file(), says("card: -1 ")),
    ),
    Case(
        "takes no writes any more from 7 s on, and again after the next start",
        "card write-protected",
        ((7, "card_protect 1"), (26, "card_protect 0"), (26, "restart 1")),
        (
            led("card failing", 9, 13),
            recordings(2),
            all_kept(1.5, 6.9),
            stopped(0),
            event("RECOVERED", index=1),
            all_kept(29, 30, index=1),
        ),
        duration=34,
        stop=14,
    ),
    Case(
        "full at the start",
        "card full",
        (),
        (led("card full", 3, 12), *_no_recording(), *_kept_file()),
        settings={"free_clusters": STEP_CLUSTERS - 100},
    ),
    Case(
        "full after a quarter of an hour",
        "card full",
        (),
        (
            recordings(1),
            stopped(STOP_CARD_FULL),
            all_kept(1.5, 900),
            led("recording", 800, 880),
            led("card full", 975, 985),
            measured("all of it but what the reserve spares", "writes", 32768 - 64, 32768 + 2500),
            *_kept_file(),
        ),
        duration=990,
        stop=990,
        settings={"free_clusters": STEP_CLUSTERS + 100},
        is_long=True,
    ),
    Case(
        "full after 400 blocks: the file is made to seem that short",
        "card full",
        ((3, "poke storage.blocks 400"),),
        (
            recordings(1),
            stopped(STOP_CARD_FULL),
            all_kept(1.5, 8),
            led("recording", 4, 9),
            led("card full", 14, 17),
            *_kept_file(),
        ),
        duration=18,
        stop=18,
        settings={"free_clusters": STEP_CLUSTERS + 5},
    ),
    Case(
        "fragmented: 19 MB in a row at most, the next file after 400 blocks",
        "card fragmented",
        ((6, "poke storage.blocks 400"),),
        (recordings(1, files=2), all_kept(4, 20), led("recording", 6, 20), *_kept_file()),
        duration=24,
        settings={"free_run": 600},
    ),
    Case(
        "fragmented: 19 MB in a row at most, the next file after a quarter of an hour",
        "card fragmented",
        (),
        (recordings(1, files=2), all_kept(8, 990), led("recording", 12, 800), *_kept_file()),
        duration=995,
        settings={"free_run": 600},
        is_long=True,
    ),
    Case(
        "32 GB, fragmented, slow to read: 19 MB in a row at most",
        "card fragmented",
        ((0, "card_read 600"),),
        (recordings(1), all_kept(40, 46), led("recording", 42, 46)),
        duration=50,
        settings={"clusters": 1_000_000, "free_run": 600},
        is_long=True,
    ),
    Case(
        "fragmented: no 16 MB in a row",
        "card fragmented",
        (),
        (led("card full", 8, 14), *_no_recording(), *_kept_file()),
        settings={"free_run": STEP_CLUSTERS - 10},
        duration=18,
    ),
    Case(
        "never formatted",
        "card not FAT16 or FAT32",
        (),
        (led("card foreign", 2.5, 12), *_untouched(), says("card: -2 ")),
        settings={"blank": 1},
    ),
)
