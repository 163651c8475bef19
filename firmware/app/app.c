#include "app.h"

#include <string.h>

enum { REPORT_US = 5000000 };

/* ---- the receiver's news ---- */

static void on_sentence(void *context, uint64_t time_us, const uint8_t *sentence, size_t length)
{
    app_t *app = context;
    const nmea_fix_t fix = nmea_fix(sentence, length);
    if (fix != NMEA_SAYS_NOTHING) {
        app->has_fix = fix == NMEA_FIX;
        app->fix_us = time_us;
    }
    const uint32_t fat_time = nmea_fat_time(sentence, length);
    if (fat_time)
        app->storage.volume.fat_time = fat_time;
    if (app->is_recording && !app->is_stopping) {
        app->board->lock(app->board->context);
        (void)log_writer_gps(&app->writer, time_us, sentence, length); /* a loss is counted in there */
        app->board->unlock(app->board->context);
    }
    if (app->config.stream)
        stream_sentence(&app->stream, time_us, sentence, length);
}

static void on_lost(void *context, uint64_t time_us, uint32_t sentences)
{
    app_t *app = context;
    if (!app->is_recording || app->is_stopping)
        return;
    app->board->lock(app->board->context);
    log_writer_lose(&app->writer, RECORD_GPS, GAP_SERIAL, time_us, time_us, sentences);
    app->board->unlock(app->board->context);
}

static void on_configured(void *context, uint32_t baud, uint32_t refused)
{
    app_t *app = context;
    app->gps_baud = baud;
    app->gps_refused = refused;
    app_event(app, refused ? EVENT_GPS_NOT_CONFIGURED : EVENT_GPS_CONFIGURED, refused ? refused : baud);
}

static void on_silent(void *context, uint32_t silent_ms)
{
    app_t *app = context;
    app->gps_baud = 0;
    app->has_fix = false;
    app_event(app, EVENT_GPS_SILENT, silent_ms);
}

/* ---- what goes on while the card or the IMU is waited for ---- */

static void serve(void *context)
{
    app_t *app = context;
    const board_t *board = app->board;
    const uint64_t now_us = board->now_us(board->context);
    neo6m_step(&app->gps, now_us);
    const gesture_t gesture = panel_step(&app->panel, app->is_checking ? LED_FATAL : logger_led(&app->logger), now_us);
    if (gesture != GESTURE_NONE)
        app->gesture = gesture;
    if (app->config.stream) {
        stream_step(&app->stream, &app->sampler, now_us);
        if (stream_is_setup_due(&app->stream, now_us)) {
            const record_setup_t setup = app_setup(app);
            stream_setup(&app->stream, now_us, &setup);
        }
    }
    if (now_us - app->step_us < APP_BLOCKED_LONGEST_US)
        board->feed_watchdog(board->context);
}

/* ---- the logger ---- */

static card_trouble_t card_trouble(const app_t *app)
{
    if (app->storage.state != STORAGE_CLOSED || !app->has_card_been_tried)
        return CARD_WELL;
    if (app->card_result == STORAGE_FORMAT)
        return CARD_FOREIGN;
    return app->storage.card_error == SD_NO_ANSWER ? CARD_MISSING : CARD_FAILING;
}

static logger_inputs_t inputs(app_t *app, uint64_t now_us)
{
    const bool is_ready = app->storage.state == STORAGE_READY && app->storage.has_spare && !app->is_recording;
    const bool has_fix = app->has_fix && now_us - app->fix_us < APP_FIX_US;
    return (logger_inputs_t){
        .now_us = now_us,
        .gesture = app->gesture,
        .is_card_ready = is_ready,
        .is_card_full = app->storage.is_full && !app->storage.has_spare && app->storage.state != STORAGE_CLOSED,
        .card_trouble = card_trouble(app),
        .is_imu_known = app->is_imu_known,
        .is_imu_working = app->is_imu_working,
        .is_mag_working = app->is_imu_working && app->imu.mag_who_am_i != 0,
        .is_gps_working = neo6m_is_working(&app->gps, now_us),
        .has_fix = has_fix,
        .is_supply_low = app->board->is_supply_low(app->board->context),
        .is_calibrated = app->storage.is_calibrated,
        .calibration_points = app->sampler.points,
    };
}

static void start(app_t *app, uint64_t now_us, bool is_calibration)
{
    if (app->config.self_test && !is_calibration && app->is_imu_working)
        app_run_self_test(app); /* its result is kept, for nothing is recorded yet */
    if (app_start_recording(app, now_us, is_calibration) != STORAGE_OK)
        app_card_failed(app, now_us);
}

static void act(app_t *app, logger_action_t action, uint64_t now_us)
{
    switch (action) {
    case LOGGER_DO_NOTHING:
        break;
    case LOGGER_START_RECORDING:
        start(app, now_us, false);
        break;
    case LOGGER_START_CALIBRATION:
        start(app, now_us, true);
        break;
    case LOGGER_STOP_BUTTON:
        app_stop_recording(app, now_us, STOP_BUTTON);
        break;
    case LOGGER_STOP_CARD_FULL:
        app_stop_recording(app, now_us, STOP_CARD_FULL);
        break;
    case LOGGER_STOP_SUPPLY_LOW:
        app_event(app, EVENT_SUPPLY_LOW, 0);
        app_stop_recording(app, now_us, STOP_SUPPLY_LOW);
        break;
    case LOGGER_STOP_CALIBRATED:
        app_stop_recording(app, now_us, STOP_CALIBRATED);
        break;
    case LOGGER_STOP_FAULT:
        app_stop_recording(app, now_us, STOP_FAULT);
        break;
    }
}

static void step_logger(app_t *app, uint64_t now_us)
{
    const logger_inputs_t in = inputs(app, now_us);
    if (app->gesture != GESTURE_NONE)
        app_event(app, EVENT_BUTTON, (uint32_t)app->gesture);
    app->gesture = GESTURE_NONE;
    act(app, logger_step(&app->logger, &in), now_us);
}

/* ---- all of it ---- */

static void report(app_t *app, uint64_t now_us)
{
    if (now_us - app->report_us < REPORT_US)
        return;
    app->report_us = now_us;
    (void)serial_print(app->board->serial, "%u s: state %u, %u samples, %u lost, block %u, busy %u us, stack %u free\n",
                       (unsigned)(now_us / 1000000), (unsigned)app->logger.state, (unsigned)app->sampler.samples,
                       (unsigned)app->writer.imu_lost, (unsigned)app->storage.next_block,
                       (unsigned)app->storage.card.longest_busy_us,
                       (unsigned)app->board->stack_free(app->board->context));
}

void app_init(app_t *app, const board_t *board)
{
    const uint64_t now_us = board->now_us(board->context);
    memset(app, 0, sizeof *app);
    app->board = board;
    app->config = config_defaults();
    app->board_events = (board_events_t){.context = &app->sampler, .on_burst = sampler_on_burst};
    app->gps_events = (neo6m_events_t){.context = app,
                                       .on_sentence = on_sentence,
                                       .on_lost = on_lost,
                                       .on_configured = on_configured,
                                       .on_silent = on_silent};
    const neo6m_settings_t gps = {.baud = app->config.gps_baud, .period_ms = (uint16_t)(1000 / app->config.gps_rate)};
    app_clear_ring(app);
    log_writer_start(&app->writer, &app->ring, 1, now_us);
    sampler_init(&app->sampler, &app->writer, 1000);
    logger_init(&app->logger, app->config.autostart, now_us);
    panel_init(&app->panel, &board->panel, now_us);
    neo6m_init(&app->gps, &board->gps, &app->gps_events, &gps, now_us);
    app->step_us = now_us;
    board->set_idle(board->context, serve, app);
    (void)serial_print(board->serial, "kart logger, reset cause %x\n", (unsigned)board->reset_cause);
    if (board->fault.is_fault)
        (void)serial_print(board->serial, "fault at %x, called from %x, status %x\n", (unsigned)board->fault.pc,
                           (unsigned)board->fault.lr, (unsigned)board->fault.status);
}

void app_step(app_t *app)
{
    const board_t *board = app->board;
    app->step_us = board->now_us(board->context);
    serve(app);
    board->set_mark(board->context, AT_LOOP);
    app_step_card(app, app->step_us);
    app_step_imu(app, board->now_us(board->context));
    app_step_recording(app, board->now_us(board->context));
    step_logger(app, board->now_us(board->context));
    if (serial_is_self_test_asked(board->serial))
        app_check_parts(app);
    report(app, app->step_us);
}
