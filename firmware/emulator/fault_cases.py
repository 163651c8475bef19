"""The rows of the fault table as cases: what happens to the logger, and what must be seen then."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from expectations import (
    Case,
    all_kept,
    event,
    led,
    measured,
    no_event,
    of_one,
    recordings,
    says,
    sentences,
    setup,
    stopped,
)
from fault_cases_card import CARD
from fault_cases_sensors import IMU_PART, RECEIVER
from smoother.session.log_format import (
    STOP_BUTTON,
    STOP_SUPPLY_LOW,
)

AS_EVER = Case(
    "nothing happens",
    "none",
    (),
    (
        recordings(1),
        led("recording", 4, 12),
        all_kept(1.5, 12.4),
        sentences(3, 12),
        stopped(STOP_BUTTON),
        event("GPS_CONFIGURED"),
        no_event("CARD_LOST", "CARD_RETRY", "IMU_LOST", "GPS_SILENT", "WATCHDOG", "RECOVERED"),
        measured("nothing but blocks is written while recording", "metadata_writes", 0, 0),
    ),
)

OTHER = (
    Case(
        "a line is wrong",
        "CONFIG.TXT wrong",
        (),
        (
            all_kept(1.5, 12.4),
            event("CONFIG_REJECTED"),
            setup(accel_range_g=16, gyro_range_dps=1000),
            of_one(
                "the line is 2",
                lambda found: "" if [e.value for e in found.records.events if e.code == 9] == [2] else "it is another",
            ),
        ),
        config=("gyro_range=2000", "accel_range=7"),
    ),
    Case(
        "main loop stuck",
        "main loop stuck",
        ((6, "stick 1"),),
        (
            recordings(2),
            all_kept(1.5, 5.94),
            stopped(0),
            event("WATCHDOG", "RECOVERED", index=1),
            all_kept(14, 16.4, index=1),
            led("recording", 14, 16),
            measured("the watchdog bites once", "watchdog_resets", 1, 1),
        ),
        duration=20,
        resets=1,
    ),
    Case(
        "the main loop jumps to where nothing is",
        "fault of the controller",
        ((6, "lose 1"),),
        (
            recordings(2),
            all_kept(1.5, 5.94),
            stopped(0),
            event("FAULT_PC", "FAULT_LR", "FAULT_STATUS", "RECOVERED", index=1),
            of_one(
                "where: at 60000000",
                lambda found: (
                    "" if 0x60000000 in [e.value for e in found.records.events if e.code == 15] else "elsewhere"
                ),
                index=1,
            ),
            says("fault at 60000000"),
            all_kept(10, 16.4, index=1),
            measured("no watchdog", "watchdog_resets", 0, 0),
        ),
        duration=20,
        resets=1,
    ),
    Case(
        "one call into the card takes longer than a minute",
        "main loop stuck",
        ((0, "card_read 150000"), (75, "card_read 0")),
        (
            recordings(1),
            event("WATCHDOG"),
            of_one(
                "where it was: opening the card",
                lambda found: "" if [e.value for e in found.records.events if e.code == 12] == [2] else "elsewhere",
            ),
            all_kept(85, 95),
        ),
        duration=100,
        settings={"free_clusters": 17_000},
        resets=1,
        is_long=True,
    ),
    Case(
        "does not start",
        "crystal",
        ((0, "crystal 0"),),
        (all_kept(1.5, 12.4), sentences(3, 12), led("recording", 4, 12), says("crystal does not start")),
    ),
    Case(
        "low for 2 s",
        "supply low",
        ((6, "supply_low 1"), (8, "supply_low 0")),
        (
            recordings(2),
            all_kept(1.5, 5.98),
            stopped(STOP_SUPPLY_LOW),
            event("SUPPLY_LOW"),
            all_kept(16, 20, index=1),
            led("dark", 9, 12.5),
            led("recording", 16, 20),
        ),
        duration=24,
    ),
    Case(
        "interrupts that nobody asked for, 5000 a second, while the card stalls",
        "interrupts at random instructions",
        ((0, "stall 500000"),),
        (
            recordings(1, files=1),
            all_kept(3, 26.4),
            no_event("IMU_LOST", "WATCHDOG", "CARD_LOST"),
            sentences(4, 26),
            led("recording", 6, 26),
            measured("as many as were wanted", "spurious", 100_000, 300_000),
        ),
        duration=30,
        settings={"spurious_us": 20, "stall_rest_us": 200_000, "stall_pause_us": 1_000_000},
    ),
    Case(
        "an interrupt before every instruction, start, a full life and a new start",
        "interrupts at random instructions",
        ((12, "card_absent 1"), (12.2, "card_absent 0"), (21, "restart 1")),
        (
            recordings(2),
            all_kept(3, 16.4),
            no_event("IMU_LOST", "WATCHDOG"),
            sentences(4, 16),
            led("recording", 5, 11.9),
            all_kept(23.5, 25, index=1),
            measured("before so many of them", "places_interrupted", 5_500, 32_768),
        ),
        duration=28,
        stop=16.5,
        settings={"probes": 28},
    ),
)

CASES = (AS_EVER, *CARD, *RECEIVER, *IMU_PART, *OTHER)
