"""Bugs put into the firmware on purpose, and the case of the fault campaign that has to notice each."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from altered import Edit

# name, what is changed, words of the case
BUGS = (
    (
        "what finds no room is not told of",
        Edit(
            "core/log_writer.c",
            "        if (writer->loss[i].count > 0 && !write_gap(",
            "        if (writer->loss[i].count > 0 && false && !write_gap(",
        ),
        "busy for 0.9 s",
    ),
    (
        "after an error the block is taken for written",
        Edit(
            "app/storage.c",
            "int storage_resume(storage_t *storage)\n{\n",
            "int storage_resume(storage_t *storage)\n{\n    storage->next_block++;\n",
        ),
        "refuses a block once",
    ),
    (
        "a failing card is not shown",
        Edit(
            "core/logger.c", "if (logger->card_trouble != CARD_WELL)", "if (logger->card_trouble != CARD_WELL && false)"
        ),
        "pulled out for 4 s",
    ),
    (
        "a card that is not the logger's is written to",
        Edit(
            "app/volume.c",
            "    return is_known ? VOLUME_OK : VOLUME_UNKNOWN;",
            "    return is_known || sd_write(card, 0, volume->fs.win, 1) ? VOLUME_OK : VOLUME_UNKNOWN;",
        ),
        "never formatted",
    ),
    (
        "frozen samples are taken for true",
        Edit(
            "app/sampler.c",
            "    sampler->is_frozen = mpu9250_is_frozen(&sampler->watch, &sample);",
            "    (void)mpu9250_is_frozen(&sampler->watch, &sample);",
        ),
        "measures the same for 1 s",
    ),
    (
        "overflow of the magnetometer is not flagged",
        Edit("app/sampler.c", "(sample.has_mag_overflow ? MAG_OVERFLOW : 0)", "(sample.has_mag_overflow ? 0 : 0)"),
        "magnetometer overflows",
    ),
    (
        "a receiver that fell silent is not looked for",
        Edit(
            "drivers/neo6m.c",
            "    gps->candidate = 0;\n    gps->is_second_try = false;\n    try_candidate(gps, now_us);\n",
            "    gps->heard_us = now_us;\n",
        ),
        "silent for 8 s",
    ),
    (
        "the watchdog is fed by an interrupt",
        Edit(
            "port/stm32f103/time.c",
            "    clear(TIM_SR_CC1IF);\n",
            "    clear(TIM_SR_CC1IF);\n    IWDG->KR = IWDG_KR_FEED;\n",
        ),
        "main loop stuck: main loop stuck",
    ),
    (
        "the main loop appends without keeping the sampling out",
        Edit("port/stm32f103/board.c", "    set_basepri(BASEPRI_SAMPLING);\n", "    set_basepri(0);\n"),
        "nobody asked for, 5000",
    ),
    (
        "an edge during a burst is dropped",
        Edit("port/stm32f103/imu.c", "        again_us = edge_us;", "        again_us = 0;"),
        "nobody asked for, 5000",
    ),
)
