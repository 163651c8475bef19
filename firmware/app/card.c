/* The card: opening, moving blocks, coming back after errors. */
#include "app.h"

/* What is done with a failure depends on how many there were in a row. */
void app_card_failed(app_t *app, uint64_t now_us)
{
    uint32_t delay_us = APP_CARD_RETRY_MOST_US;
    if (app->card.failures < 7)
        delay_us = (uint32_t)APP_CARD_RETRY_US << app->card.failures;
    if (app->card.failures == 0)
        app->card.lost_us = now_us;
    if (app->card.failures <= 1)
        app->card.lost_error = app->storage.card_error;
    if (app->card.failures < UINT8_MAX)
        app->card.failures++;
    app->card.retry_us = now_us + delay_us;
}

/* The card takes blocks again. Only now is there room to say what happened: the ring was full meanwhile. */
static void card_works(app_t *app, uint64_t now_us)
{
    if (app->card.failures == 1)
        app_event(app, EVENT_CARD_RETRY, (uint32_t)app->card.lost_error);
    if (app->card.failures > 1) { /* one that heals at once is a retry */
        app_event(app, EVENT_CARD_LOST, (uint32_t)app->card.lost_error);
        app_event(app, EVENT_CARD_BACK, (uint32_t)((now_us - app->card.lost_us) / 1000));
    }
    app->card.failures = 0;
    app->card.checked_us = now_us;
}

/* ---- settings ---- */

static void apply_config(app_t *app)
{
    const uint64_t now_us = app->board->now_us(app->board->context);
    app->board->set_serial_baud(app->board->context, app->settings.config.stream_baud);
    app_start_gps(app, now_us);
    app->logger.autostart = app->settings.config.autostart;
    if (app->settings.config.stream)
        stream_init(&app->stream, app->board->serial, &app->memory.with_stream.stream.frame);
    app_clear_ring(app);
    app->imu.is_restart_wanted = true;
}

/* Read CONFIG.TXT, once, from the first card seen; the ring is empty then and lends its memory. */
static void read_config(app_t *app)
{
    char *text = (char *)app->memory.blocks;
    size_t length = 0;
    app->settings.is_known = true;
    const int result = storage_read_file(&app->storage, "CONFIG.TXT", text, CONFIG_FILE_LONGEST + 1, &length);
    if (result != STORAGE_OK)
        return;
    app->settings.has_file = true;
    app->settings.result = config_parse(&app->settings.config, text, length);
    (void)serial_print(app->board->serial, "CONFIG.TXT: flaw %u in line %u\n", (unsigned)app->settings.result.flaw,
                       (unsigned)app->settings.result.line);
    if (app->settings.result.flaw == CONFIG_FINE)
        apply_config(app);
}

/* ---- opening ---- */

static void open_card(app_t *app, uint64_t now_us)
{
    app->board->set_mark(app->board->context, AT_CARD_OPEN);
    const int result = storage_open(&app->storage, &app->board->card);
    app->card.has_been_tried = true;
    app->card.result = (int8_t)result;
    if (app->card.failures == 0 || result == STORAGE_OK)
        (void)serial_print(app->board->serial, "card: %d %d, file %u, recovered %u blocks\n", result,
                           app->storage.card_error, (unsigned)app->storage.last_number,
                           (unsigned)app->storage.recovered);
    if (result != STORAGE_OK) {
        app_card_failed(app, now_us);
        return;
    }
    if (!app->settings.is_known && !app->recording.is_open)
        read_config(app);
    if (!app->recording.is_open)
        card_works(app, now_us);
}

/* ---- while recording ---- */

/* Another file for the session that is open. */
static void open_again(app_t *app, uint64_t now_us)
{
    if (app->storage.state != STORAGE_READY) {
        open_card(app, now_us);
        if (app->storage.state != STORAGE_READY)
            return;
    }
    if (storage_begin(&app->storage, app->recording.session, app->recording.is_calibration) != STORAGE_OK)
        app_card_failed(app, now_us);
}

static void come_back(app_t *app, uint64_t now_us)
{
    app->board->set_mark(app->board->context, AT_CARD_RESUME);
    if (app->card.failures > APP_CARD_RESUMES || app->storage.state == STORAGE_READY) {
        open_again(app, now_us);
        return;
    }
    const int result = storage_resume(&app->storage);
    if (app->recording.card_retries < UINT16_MAX)
        app->recording.card_retries++;
    if (result == STORAGE_OK)
        return; /* card_failures is forgotten with the first block that is taken */
    if (result == STORAGE_OTHER)
        app->card.failures = APP_CARD_RESUMES;
    app_card_failed(app, now_us);
}

enum { STEPS = 8 }; /* moves of a block in one turn: enough to empty the ring after a stall, short enough for the rest */

static void move_blocks(app_t *app, uint64_t now_us)
{
    app->board->set_mark(app->board->context, AT_CARD_STEP);
    for (int i = 0; i < STEPS; i++) {
        const uint32_t before = app->storage.next_block;
        const int result = storage_step(&app->storage, &app->writer);
        if (app->storage.next_block != before && app->card.failures)
            card_works(app, now_us);
        if (result < 0)
            app_card_failed(app, now_us);
        if (result <= 0)
            return;
    }
}

static void step_recording(app_t *app, uint64_t now_us)
{
    if (app->storage.state == STORAGE_RECORDING)
        move_blocks(app, now_us);
    else if (now_us >= app->card.retry_us && !app->storage.is_full)
        come_back(app, now_us);
}

static void step_idle(app_t *app, uint64_t now_us)
{
    if (app->storage.state != STORAGE_READY) {
        if (now_us >= app->card.retry_us)
            open_card(app, now_us);
        return;
    }
    if (now_us - app->card.checked_us < APP_CARD_CHECK_US)
        return;
    app->card.checked_us = now_us;
    if (storage_check(&app->storage) != STORAGE_OK)
        app_card_failed(app, now_us);
}

void app_step_card(app_t *app, uint64_t now_us)
{
    if (app->recording.is_open)
        step_recording(app, now_us);
    else if (!app->board->is_supply_low(app->board->context))
        step_idle(app, now_us);
}
