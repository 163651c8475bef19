/* Sessions: how a recording begins and ends. */
#include "app.h"
#include "crc32.h"
#include "error.h"

/* Not a counter, for the card may have been in another logger: whatever differs between two recordings, stirred. */
static uint32_t make_session(const app_t *app, uint64_t now_us)
{
    const uint32_t words[] = {(uint32_t)now_us, app->board->boot_number, app->storage.spare.number,
                              app->imu.sampler.noise, app->storage.volume.fs.free_clst};
    uint32_t session = crc32_update(0, app->board->device, sizeof app->board->device);
    session = crc32_update(session, (const uint8_t *)words, sizeof words);
    return session ? session : 1;
}

void app_clear_ring(app_t *app)
{
    ring_init(&app->ring, app->memory.blocks, app->settings.config.stream ? APP_RING_BLOCKS - APP_STREAM_BLOCKS : APP_RING_BLOCKS);
}

int app_start_recording(app_t *app, uint64_t now_us, bool is_calibration)
{
    app->recording.is_calibration = is_calibration;
    app->recording.session = make_session(app, now_us);
    app->recording.card_retries = 0;
    app->storage.card.retries = app->recording.noted_retries = 0;
    app->card.failures = 0;
    app->recording.is_stopping = app->recording.is_stop_written = false;
    app_clear_ring(app);
    log_writer_start(&app->writer, &app->ring, app->recording.session, now_us);
    app->recording.is_open = true;
    app_write_setup(app, now_us);
    app_write_history(app);
    if (app->imu.has_self_test)
        LOCKED(app, (void)log_writer_self_test(&app->writer, now_us, &app->imu.self_test));
    app->imu.has_self_test = false;
    app->board->lock(app->board->context);
    app->imu.sampler.points = 0;
    app->imu.sampler.last_us = 0;
    app->imu.sampler.is_recording = true;
    app->board->unlock(app->board->context);
    (void)serial_print(app->board->serial, "recording %x\n", (unsigned)app->recording.session);
    return storage_begin(&app->storage, app->recording.session, is_calibration);
}

void app_stop_recording(app_t *app, uint64_t now_us, uint8_t reason)
{
    app->imu.sampler.is_recording = false;
    app->recording.is_stopping = true;
    app->recording.stop_reason = reason;
    app->recording.stop_us = now_us;
}

static void finish(app_t *app)
{
    const bool is_supply_low = app->board->is_supply_low(app->board->context);
    app->board->set_mark(app->board->context, AT_CARD_END);
    /* with the supply going, nothing is begun that the next start can do as well */
    const int result = is_supply_low ? storage_halt(&app->storage) : storage_end(&app->storage);
    app->recording.is_open = app->recording.is_stopping = false;
    (void)serial_print(app->board->serial, "stopped: %d, %u samples, %u lost, %u blocks at most\n", result,
                       (unsigned)app->writer.imu_records, (unsigned)app->writer.imu_lost,
                       (unsigned)app->writer.most_blocks);
}

/* What the driver mended by itself, once in a while: on bad wires it is a block in ten. */
static void note_retries(app_t *app)
{
    if (app->storage.card.retries == app->recording.noted_retries)
        return;
    app->recording.noted_retries = app->storage.card.retries;
    app_event(app, EVENT_CARD_RETRY, (uint32_t)app->storage.card.error);
}

static uint16_t count_retries(const app_t *app)
{
    const uint32_t retries = app->recording.card_retries + app->storage.card.retries;
    return (uint16_t)(retries < UINT16_MAX ? retries : UINT16_MAX);
}

static void step_stopping(app_t *app, uint64_t now_us)
{
    if (!app->recording.is_stop_written) {
        int result = CORE_OK;
        note_retries(app);
        LOCKED(app, result = log_writer_stop(&app->writer, now_us, app->recording.stop_reason, count_retries(app)));
        app->recording.is_stop_written = result == CORE_OK;
    }
    const bool is_drained = app->recording.is_stop_written && storage_is_drained(&app->storage, &app->writer);
    if (is_drained || now_us - app->recording.stop_us > APP_STOP_LONGEST_US)
        finish(app);
}

void app_step_recording(app_t *app, uint64_t now_us)
{
    if (!app->recording.is_open)
        return;
    if (app->recording.is_stopping) {
        step_stopping(app, now_us);
        return;
    }
    if (now_us - app->recording.setup_us >= APP_SETUP_US) {
        app_write_setup(app, now_us);
        note_retries(app);
    }
    LOCKED(app, log_writer_flush_older(&app->writer, now_us, APP_FLUSH_US));
}
