/* The IMU: setting up, noticing that it has gone, bringing it back. */
#include "app.h"

static void stop(app_t *app)
{
    app->board->stop_sampling(app->board->context);
}

static void found(app_t *app, uint64_t now_us)
{
    sampler_init(&app->imu.sampler, &app->writer, app->imu.chip.period_us);
    const uint32_t rate = 1000000 / app->imu.chip.period_us;
    const uint32_t every = app->settings.config.stream ? rate / app->settings.config.stream : 0;
    app->imu.sampler.queue = app->settings.config.stream ? app->memory.with_stream.stream.queue : NULL;
    app->imu.sampler.stream_every = app->settings.config.stream && every == 0 ? 1 : every;
    app->imu.started_us = now_us;
    app->imu.is_working = true;
    const board_events_t *events = &app->imu.events;
    app->board->start_sampling(app->board->context, events);
    if (app->imu.lost_us)
        app_event(app, EVENT_IMU_BACK, (uint32_t)((now_us - app->imu.lost_us) / 1000));
    app->imu.lost_us = 0;
    app->imu.failures = 0;
}

static void missing(app_t *app, uint64_t now_us)
{
    app->imu.is_working = false;
    if (app->imu.failures < UINT8_MAX)
        app->imu.failures++;
    app->imu.is_known = app->imu.is_known || app->imu.failures >= APP_IMU_TRIES;
    app->imu.retry_us = app->imu.failures < APP_IMU_TRIES ? now_us : now_us + APP_IMU_RETRY_US;
}

static void open_imu(app_t *app)
{
    const mpu9250_settings_t settings = {.rate_hz = app->settings.config.imu_rate,
                                         .accel_range_g = app->settings.config.accel_range,
                                         .gyro_range_dps = app->settings.config.gyro_range,
                                         .lowpass_hz = app->settings.config.lowpass,
                                         .has_magnetometer = app->settings.config.magnetometer};
    app->board->set_mark(app->board->context, AT_IMU);
    const int result = mpu9250_open(&app->board->imu, &settings, &app->imu.chip);
    const uint64_t now_us = app->board->now_us(app->board->context);
    (void)serial_print(app->board->serial, "imu: %d, id %x, magnetometer %x\n", result, (unsigned)app->imu.chip.who_am_i,
                       (unsigned)app->imu.chip.mag_who_am_i);
    if (result != MPU9250_OK) {
        missing(app, now_us);
        return;
    }
    app->imu.is_known = true;
    found(app, now_us);
}

static void restart(app_t *app)
{
    app->imu.is_restart_wanted = false;
    stop(app);
    open_imu(app);
}

static void lost(app_t *app, uint64_t now_us)
{
    stop(app);
    app->imu.is_working = false;
    app->imu.lost_us = now_us;
    app->imu.failures = 0;
    app->imu.retry_us = now_us;
    app_event(app, EVENT_IMU_LOST, app->imu.chip.who_am_i);
}

static bool is_silent(const app_t *app, uint64_t now_us)
{
    if (now_us - app->imu.started_us < APP_IMU_SILENT_US)
        return false;
    const uint32_t silent_ms = (uint32_t)(now_us / 1000) - app->imu.sampler.last_ms;
    return (int32_t)silent_ms > APP_IMU_SILENT_US / 1000;
}

static bool is_mag_wanted(const app_t *app)
{
    return app->settings.config.magnetometer && app->imu.chip.who_am_i != MPU9250_WHO_MPU6500;
}

/* A magnetometer that hangs: six axes go on. While nothing is recorded the sensor is set up anew, which resets it. */
static void step_magnetometer(app_t *app, uint64_t now_us)
{
    const uint32_t silent_ms = (uint32_t)(now_us / 1000) - app->imu.sampler.mag_ms;
    const bool is_new = now_us - app->imu.started_us < APP_MAG_SILENT_US;
    const bool has_none = !is_new && (int32_t)silent_ms > APP_MAG_SILENT_US / 1000;
    if (!is_mag_wanted(app) || is_new)
        return;
    if (has_none && !app->imu.is_mag_silent && app->imu.chip.mag_who_am_i)
        app_event(app, EVENT_MAG_ABSENT, app->imu.chip.mag_who_am_i);
    app->imu.is_mag_silent = has_none;
    if (has_none && !app->recording.is_open && now_us - app->imu.started_us > APP_MAG_RETRY_US)
        app->imu.is_restart_wanted = true;
}

void app_step_imu(app_t *app, uint64_t now_us)
{
    if (app->imu.is_restart_wanted) {
        restart(app);
    } else if (app->imu.is_working) {
        if (is_silent(app, now_us) || app->imu.sampler.is_frozen)
            lost(app, now_us);
        else
            step_magnetometer(app, now_us);
    } else if (now_us >= app->imu.retry_us) {
        open_imu(app);
    }
}

void app_run_self_test(app_t *app)
{
    mpu9250_self_test_t test = {.passed = 0};
    stop(app);
    const int result = mpu9250_self_test(&app->board->imu, &test);
    app->imu.has_self_test = result == MPU9250_OK;
    for (int i = 0; i < 6; i++) {
        app->imu.self_test.response[i] = test.response[i];
        app->imu.self_test.factory_code[i] = test.factory_code[i];
    }
    app->imu.self_test.passed = test.passed;
    (void)serial_print(app->board->serial, "self-test: %d, axes passed %x\n", result, (unsigned)test.passed);
    open_imu(app);
}
