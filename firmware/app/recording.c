/* Sessions: how a recording begins and ends, and the records that are not samples. */
#include "app.h"
#include "crc32.h"
#include "error.h"
#include "firmware_hash.h"

#include <string.h>

/* Appending from the main loop keeps the sampling interrupt out: the writer has one producer at a time. */
#define LOCKED(app, expression)                       \
    do {                                              \
        (app)->board->lock((app)->board->context);    \
        (expression);                                 \
        (app)->board->unlock((app)->board->context);  \
    } while (0)

void app_event(app_t *app, uint16_t code, uint32_t value)
{
    const uint64_t now_us = app->board->now_us(app->board->context);
    (void)serial_print(app->board->serial, "event %u %d\n", (unsigned)code, (int)value);
    if (app->is_recording && !app->is_stop_written) /* the STOP record is the last */
        LOCKED(app, (void)log_writer_event(&app->writer, now_us, code, value));
}

static uint8_t setup_flags(const app_t *app)
{
    const bool is_rejected = app->config_result.flaw != CONFIG_FINE;
    return (uint8_t)((app->board->is_sampling_on_pin(app->board->context) ? SETUP_IMU_INTERRUPT : 0) |
                     (app->sampler.has_pulse ? SETUP_PPS_SEEN : 0) |
                     (app->gps_baud && !app->gps_refused ? SETUP_GPS_ACKNOWLEDGED : 0) |
                     (app->has_config_file ? SETUP_CONFIG_READ : 0) | (is_rejected ? SETUP_CONFIG_REJECTED : 0));
}

record_setup_t app_setup(const app_t *app)
{
    record_setup_t setup = {
        .purpose = app->is_calibration ? PURPOSE_MAG_CALIBRATION : PURPOSE_DRIVE,
        .flags = setup_flags(app),
        .imu_who_am_i = app->is_imu_working ? app->imu.who_am_i : 0xFF,
        .mag_who_am_i = app->imu.mag_who_am_i,
        .reset_cause = app->board->reset_cause,
        .imu_period_us = app->imu.period_us,
        .accel_range_g = app->config.accel_range,
        .gyro_range_dps = app->config.gyro_range,
        .accel_lowpass_hz = app->imu.accel_lowpass_hz,
        .gyro_lowpass_hz = app->imu.gyro_lowpass_hz,
        .accel_delay_us = app->imu.accel_delay_us,
        .gyro_delay_us = app->imu.gyro_delay_us,
        .mag_period_us = app->imu.mag_period_us,
        .gps_period_us = 1000000u / app->config.gps_rate,
        .gps_baud = app->gps_baud,
        .boot_number = app->board->boot_number,
        .firmware = FIRMWARE_HASH,
    };
    memcpy(setup.mag_adjustment, app->imu.mag_adjustment, sizeof setup.mag_adjustment);
    memcpy(setup.device, app->board->device, sizeof setup.device);
    return setup;
}

/* SETUP and the whole CONFIG. */
static void write_setup(app_t *app, uint64_t now_us)
{
    char text[CONFIG_TEXT_LONGEST];
    const size_t length = config_print(&app->config, text);
    record_setup_t setup = app_setup(app);
    setup.config_crc = crc32_update(0, (const uint8_t *)text, length);
    LOCKED(app, (void)log_writer_setup(&app->writer, now_us, &setup));
    LOCKED(app, (void)log_writer_config(&app->writer, now_us, text, length));
    app->setup_us = now_us;
}

/* Not a counter, for the card may have been in another logger: whatever differs between two recordings, stirred. */
static uint32_t make_session(const app_t *app, uint64_t now_us)
{
    const uint32_t words[] = {(uint32_t)now_us, app->board->boot_number, app->storage.spare.number,
                              app->sampler.noise, app->storage.volume.fs.free_clst};
    uint32_t session = crc32_update(0, app->board->device, sizeof app->board->device);
    session = crc32_update(session, (const uint8_t *)words, sizeof words);
    return session ? session : 1;
}

/* What happened before there was a log to say it in. */
static void write_history(app_t *app)
{
    if (app->config_result.flaw != CONFIG_FINE)
        app_event(app, EVENT_CONFIG_REJECTED, app->config_result.line);
    if (app->board->reset_cause & RESET_BY_WATCHDOG)
        app_event(app, EVENT_WATCHDOG, app->board->mark_before_reset);
    if (app->board->fault.is_fault) {
        app_event(app, EVENT_FAULT_PC, app->board->fault.pc);
        app_event(app, EVENT_FAULT_LR, app->board->fault.lr);
        app_event(app, EVENT_FAULT_STATUS, app->board->fault.status);
    }
    if (app->is_imu_working && app->imu.mag_who_am_i == 0 && app->config.magnetometer)
        app_event(app, EVENT_MAG_ABSENT, 0);
    if (!app->is_imu_working)
        app_event(app, EVENT_IMU_LOST, app->imu.who_am_i);
    if (app->gps_baud)
        app_event(app, app->gps_refused ? EVENT_GPS_NOT_CONFIGURED : EVENT_GPS_CONFIGURED,
                  app->gps_refused ? app->gps_refused : app->gps_baud);
    if (app->storage.recovered)
        app_event(app, EVENT_RECOVERED, app->storage.recovered);
    app->storage.recovered = 0;
}

void app_clear_ring(app_t *app)
{
    ring_init(&app->ring, app->memory.blocks, app->config.stream ? APP_RING_BLOCKS - APP_STREAM_BLOCKS : APP_RING_BLOCKS);
}

void app_start_recording(app_t *app, uint64_t now_us, bool is_calibration)
{
    if (app->config.self_test && !is_calibration && app->is_imu_working)
        app_run_self_test(app); /* logs nothing yet: its result is kept */
    app->is_calibration = is_calibration;
    app->session = make_session(app, now_us);
    app->card_retries = 0;
    app->storage.card.retries = app->noted_retries = 0;
    app->card_failures = 0;
    app->is_stopping = app->is_stop_written = false;
    app_clear_ring(app);
    log_writer_start(&app->writer, &app->ring, app->session, now_us);
    app->is_recording = true;
    write_setup(app, now_us);
    write_history(app);
    if (app->has_self_test)
        LOCKED(app, (void)log_writer_self_test(&app->writer, now_us, &app->self_test));
    app->has_self_test = false;
    app->board->lock(app->board->context);
    app->sampler.points = 0;
    app->sampler.last_us = 0;
    app->sampler.is_recording = true;
    app->board->unlock(app->board->context);
    (void)serial_print(app->board->serial, "recording %x\n", (unsigned)app->session);
    if (storage_begin(&app->storage, app->session, is_calibration) != STORAGE_OK)
        app_card_failed(app, now_us);
}

void app_stop_recording(app_t *app, uint64_t now_us, uint8_t reason)
{
    app->sampler.is_recording = false;
    app->is_stopping = true;
    app->stop_reason = reason;
    app->stop_us = now_us;
}

static void finish(app_t *app)
{
    const bool is_supply_low = app->board->is_supply_low(app->board->context);
    app->board->set_mark(app->board->context, AT_CARD_END);
    /* with the supply going, nothing is begun that the next start can do as well */
    const int result = is_supply_low ? storage_halt(&app->storage) : storage_end(&app->storage);
    app->is_recording = app->is_stopping = false;
    (void)serial_print(app->board->serial, "stopped: %d, %u samples, %u lost, %u blocks at most\n", result,
                       (unsigned)app->writer.imu_records, (unsigned)app->writer.imu_lost,
                       (unsigned)app->writer.most_blocks);
}

/* What the driver mended by itself, once in a while: on bad wires it is a block in ten. */
static void note_retries(app_t *app)
{
    if (app->storage.card.retries == app->noted_retries)
        return;
    app->noted_retries = app->storage.card.retries;
    app_event(app, EVENT_CARD_RETRY, (uint32_t)app->storage.card.error);
}

static uint16_t count_retries(const app_t *app)
{
    const uint32_t retries = app->card_retries + app->storage.card.retries;
    return (uint16_t)(retries < UINT16_MAX ? retries : UINT16_MAX);
}

static void step_stopping(app_t *app, uint64_t now_us)
{
    if (!app->is_stop_written) {
        int result = CORE_OK;
        note_retries(app);
        LOCKED(app, result = log_writer_stop(&app->writer, now_us, app->stop_reason, count_retries(app)));
        app->is_stop_written = result == CORE_OK;
    }
    const bool is_drained = app->is_stop_written && storage_is_drained(&app->storage, &app->writer);
    if (is_drained || now_us - app->stop_us > APP_STOP_LONGEST_US)
        finish(app);
}

void app_step_recording(app_t *app, uint64_t now_us)
{
    if (!app->is_recording)
        return;
    if (app->is_stopping) {
        step_stopping(app, now_us);
        return;
    }
    if (now_us - app->setup_us >= APP_SETUP_US) {
        write_setup(app, now_us);
        note_retries(app);
    }
    LOCKED(app, log_writer_flush_older(&app->writer, now_us, APP_FLUSH_US));
}
