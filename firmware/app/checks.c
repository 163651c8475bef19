/* What `selftest` on the serial line does: each part is tried, and a line says what came of it. Only while nothing is
 * recorded. The LED is on meanwhile. */
#include "app.h"

#include <string.h>

enum { MEASURED_BLOCKS = 1000, LISTEN_US = 1000000 };

static void say_imu(app_t *app, uint32_t samples, uint32_t mag_ms)
{
    const board_t *board = app->board;
    const bool is_mag_read = app->imu.chip.mag_who_am_i != 0 && app->imu.sampler.mag_ms != mag_ms;
    (void)serial_print(board->serial, "selftest imu: %s, id %x, %u samples in a second, on the %s\n",
                       app->imu.is_working && samples ? "well" : "BAD", (unsigned)app->imu.chip.who_am_i, (unsigned)samples,
                       board->is_sampling_on_pin(board->context) ? "pin INT" : "clock");
    (void)serial_print(board->serial, "selftest magnetometer: %s, id %x\n", is_mag_read ? "well" : "NONE",
                       (unsigned)app->imu.chip.mag_who_am_i);
}

static void check_imu(app_t *app)
{
    const board_t *board = app->board;
    app_run_self_test(app);
    app->imu.has_self_test = false; /* not for the next recording: somebody may be holding the board */
    const uint32_t before = app->imu.sampler.samples, mag_ms = app->imu.sampler.mag_ms;
    board->imu.wait_us(board->imu.context, LISTEN_US);
    say_imu(app, app->imu.is_working ? app->imu.sampler.samples - before : 0, mag_ms);
}

static void check_card(app_t *app)
{
    uint32_t took_us = 1, longest_us = 0;
    memset(app->memory.blocks[0], 0x55, BLOCK_BYTES); /* nothing is recorded: the ring is empty */
    const uint32_t retries = app->storage.card.retries;
    const int result = storage_measure(&app->storage, app->memory.blocks[0], MEASURED_BLOCKS, &took_us, &longest_us);
    if (result != STORAGE_OK) {
        (void)serial_print(app->board->serial, "selftest card: BAD, %d %d\n", result, app->storage.card_error);
        return;
    }
    (void)serial_print(app->board->serial, "selftest card: well, %u kB/s, longest busy %u us, sent again %u\n",
                       (unsigned)((uint64_t)MEASURED_BLOCKS * BLOCK_BYTES * 1000 / took_us), (unsigned)longest_us,
                       (unsigned)(app->storage.card.retries - retries));
}

static void check_gps(app_t *app, uint64_t now_us)
{
    const bool is_heard = neo6m_is_working(&app->gps.receiver, now_us);
    (void)serial_print(app->board->serial, "selftest gps: %s, %u baud, settings refused %x, %s\n", is_heard ? "well" : "SILENT",
                       (unsigned)(is_heard ? app->gps.baud : 0), (unsigned)app->gps.refused, app->gps.has_fix ? "fix" : "no fix");
}

void app_check_parts(app_t *app)
{
    const board_t *board = app->board;
    if (app->recording.is_open) {
        (void)serial_print(board->serial, "selftest: stop the recording first\n");
        return;
    }
    (void)serial_print(board->serial, "selftest: heard; the LED is on until the end\n");
    app->panel.is_checking = true;
    check_imu(app);
    check_card(app);
    check_gps(app, board->now_us(board->context));
    app->panel.is_checking = false;
    (void)serial_print(board->serial, "selftest: done\n");
}
