/* The records that are not samples: events, SETUP and CONFIG, what happened before there was a log. */
#include "app.h"
#include "crc32.h"
#include "firmware_hash.h"

#include <string.h>

void app_event(app_t *app, uint16_t code, uint32_t value)
{
    const uint64_t now_us = app->board->now_us(app->board->context);
    (void)serial_print(app->board->serial, "event %u %d\n", (unsigned)code, (int)value);
    if (app->recording.is_open && !app->recording.is_stop_written) /* the STOP record is the last */
        LOCKED(app, (void)log_writer_event(&app->writer, now_us, code, value));
}

static uint8_t setup_flags(const app_t *app)
{
    const bool is_rejected = app->settings.result.flaw != CONFIG_FINE;
    return (uint8_t)((app->board->is_sampling_on_pin(app->board->context) ? SETUP_IMU_INTERRUPT : 0) |
                     (app->gps.baud && !app->gps.refused ? SETUP_GPS_ACKNOWLEDGED : 0) |
                     (app->settings.has_file ? SETUP_CONFIG_READ : 0) | (is_rejected ? SETUP_CONFIG_REJECTED : 0));
}

record_setup_t app_setup(const app_t *app)
{
    record_setup_t setup = {
        .purpose = app->recording.is_calibration ? PURPOSE_MAG_CALIBRATION : PURPOSE_DRIVE,
        .flags = setup_flags(app),
        .imu_who_am_i = app->imu.is_working ? app->imu.chip.who_am_i : 0xFF,
        .mag_who_am_i = app->imu.chip.mag_who_am_i,
        .reset_cause = app->board->reset_cause,
        .imu_period_us = app->imu.chip.period_us,
        .accel_range_g = app->settings.config.accel_range,
        .gyro_range_dps = app->settings.config.gyro_range,
        .accel_lowpass_hz = app->imu.chip.accel_lowpass_hz,
        .gyro_lowpass_hz = app->imu.chip.gyro_lowpass_hz,
        .accel_delay_us = app->imu.chip.accel_delay_us,
        .gyro_delay_us = app->imu.chip.gyro_delay_us,
        .mag_period_us = app->imu.chip.mag_period_us,
        .gps_period_us = 1000u * app->gps.receiver.settings.period_ms,
        .gps_baud = app->gps.baud,
        .boot_number = app->board->boot_number,
        .firmware = FIRMWARE_HASH,
    };
    memcpy(setup.mag_adjustment, app->imu.chip.mag_adjustment, sizeof setup.mag_adjustment);
    memcpy(setup.device, app->board->device, sizeof setup.device);
    return setup;
}

/* SETUP and the whole CONFIG. */
void app_write_setup(app_t *app, uint64_t now_us)
{
    char text[CONFIG_TEXT_LONGEST];
    const size_t length = config_print(&app->settings.config, text);
    record_setup_t setup = app_setup(app);
    setup.config_crc = crc32_update(0, (const uint8_t *)text, length);
    LOCKED(app, (void)log_writer_setup(&app->writer, now_us, &setup));
    LOCKED(app, (void)log_writer_config(&app->writer, now_us, text, length));
    app->recording.setup_us = now_us;
}

/* What happened before there was a log to say it in. */
void app_write_history(app_t *app)
{
    if (app->settings.result.flaw != CONFIG_FINE)
        app_event(app, EVENT_CONFIG_REJECTED, app->settings.result.line);
    if (app->board->reset_cause & RESET_BY_WATCHDOG)
        app_event(app, EVENT_WATCHDOG, app->board->mark_before_reset);
    if (app->board->fault.is_fault) {
        app_event(app, EVENT_FAULT_PC, app->board->fault.pc);
        app_event(app, EVENT_FAULT_LR, app->board->fault.lr);
        app_event(app, EVENT_FAULT_STATUS, app->board->fault.status);
    }
    if (app->imu.is_working && app->imu.chip.mag_who_am_i == 0 && app->settings.config.magnetometer)
        app_event(app, EVENT_MAG_ABSENT, 0);
    if (!app->imu.is_working)
        app_event(app, EVENT_IMU_LOST, app->imu.chip.who_am_i);
    if (app->gps.baud)
        app_event(app, app->gps.refused ? EVENT_GPS_NOT_CONFIGURED : EVENT_GPS_CONFIGURED,
                  app->gps.refused ? app->gps.refused : app->gps.baud);
    if (app->storage.recovered)
        app_event(app, EVENT_RECOVERED, app->storage.recovered);
    app->storage.recovered = 0;
}
