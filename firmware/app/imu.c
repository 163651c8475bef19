/* The IMU: setting up, noticing that it has gone, bringing it back. */
#include "app.h"

static void stop(app_t *app)
{
    app->board->stop_sampling(app->board->context);
}

static void found(app_t *app, uint64_t now_us)
{
    sampler_init(&app->sampler, &app->writer, app->imu.period_us);
    const uint32_t rate = 1000000 / app->imu.period_us;
    const uint32_t every = app->config.stream ? rate / app->config.stream : 0;
    app->sampler.queue = app->config.stream ? app->memory.with_stream.stream.queue : NULL;
    app->sampler.stream_every = app->config.stream && every == 0 ? 1 : every;
    app->imu_started_us = now_us;
    app->is_imu_working = true;
    const board_events_t *events = &app->board_events;
    app->board->start_sampling(app->board->context, events);
    if (app->imu_lost_us)
        app_event(app, EVENT_IMU_BACK, (uint32_t)((now_us - app->imu_lost_us) / 1000));
    app->imu_lost_us = 0;
    app->imu_failures = 0;
}

static void missing(app_t *app, uint64_t now_us)
{
    app->is_imu_working = false;
    if (app->imu_failures < UINT8_MAX)
        app->imu_failures++;
    app->is_imu_known = app->is_imu_known || app->imu_failures >= APP_IMU_TRIES;
    app->imu_retry_us = app->imu_failures < APP_IMU_TRIES ? now_us : now_us + APP_IMU_RETRY_US;
}

static void open_imu(app_t *app)
{
    const mpu9250_settings_t settings = {.rate_hz = app->config.imu_rate,
                                         .accel_range_g = app->config.accel_range,
                                         .gyro_range_dps = app->config.gyro_range,
                                         .lowpass_hz = app->config.lowpass,
                                         .has_magnetometer = app->config.magnetometer};
    app->board->set_mark(app->board->context, AT_IMU);
    const int result = mpu9250_open(&app->board->imu, &settings, &app->imu);
    const uint64_t now_us = app->board->now_us(app->board->context);
    (void)serial_print(app->board->serial, "imu: %d, id %x, magnetometer %x\n", result, (unsigned)app->imu.who_am_i,
                       (unsigned)app->imu.mag_who_am_i);
    if (result != MPU9250_OK) {
        missing(app, now_us);
        return;
    }
    app->is_imu_known = true;
    found(app, now_us);
}

static void restart(app_t *app)
{
    app->is_imu_restart_wanted = false;
    stop(app);
    open_imu(app);
}

static void lost(app_t *app, uint64_t now_us)
{
    stop(app);
    app->is_imu_working = false;
    app->imu_lost_us = now_us;
    app->imu_failures = 0;
    app->imu_retry_us = now_us;
    app_event(app, EVENT_IMU_LOST, app->imu.who_am_i);
}

static bool is_silent(const app_t *app, uint64_t now_us)
{
    if (now_us - app->imu_started_us < APP_IMU_SILENT_US)
        return false;
    const uint32_t silent_ms = (uint32_t)(now_us / 1000) - app->sampler.last_ms;
    return (int32_t)silent_ms > APP_IMU_SILENT_US / 1000;
}

static bool is_mag_wanted(const app_t *app)
{
    return app->config.magnetometer && app->imu.who_am_i != MPU9250_WHO_MPU6500;
}

/* A magnetometer that hangs: six axes go on. While nothing is recorded the sensor is set up anew, which resets it. */
static void step_magnetometer(app_t *app, uint64_t now_us)
{
    const uint32_t silent_ms = (uint32_t)(now_us / 1000) - app->sampler.mag_ms;
    const bool is_new = now_us - app->imu_started_us < APP_MAG_SILENT_US;
    const bool has_none = !is_new && (int32_t)silent_ms > APP_MAG_SILENT_US / 1000;
    if (!is_mag_wanted(app) || is_new)
        return;
    if (has_none && !app->is_mag_silent && app->imu.mag_who_am_i)
        app_event(app, EVENT_MAG_ABSENT, app->imu.mag_who_am_i);
    app->is_mag_silent = has_none;
    if (has_none && !app->is_recording && now_us - app->imu_started_us > APP_MAG_RETRY_US)
        app->is_imu_restart_wanted = true;
}

void app_step_imu(app_t *app, uint64_t now_us)
{
    if (app->is_imu_restart_wanted) {
        restart(app);
    } else if (app->is_imu_working) {
        if (is_silent(app, now_us) || app->sampler.is_frozen)
            lost(app, now_us);
        else
            step_magnetometer(app, now_us);
    } else if (now_us >= app->imu_retry_us) {
        open_imu(app);
    }
}

void app_run_self_test(app_t *app)
{
    mpu9250_self_test_t test = {.passed = 0};
    stop(app);
    const int result = mpu9250_self_test(&app->board->imu, &test);
    app->has_self_test = result == MPU9250_OK;
    for (int i = 0; i < 6; i++) {
        app->self_test.response[i] = test.response[i];
        app->self_test.factory_code[i] = test.factory_code[i];
    }
    app->self_test.passed = test.passed;
    (void)serial_print(app->board->serial, "self-test: %d, axes passed %x\n", result, (unsigned)test.passed);
    open_imu(app);
}
