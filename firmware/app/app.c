#include "app.h"

#include <string.h>

enum { REPORT_US = 5000000 };

/* ---- what goes on while the card or the IMU is waited for ---- */

static void serve(void *context)
{
    app_t *app = context;
    const board_t *board = app->board;
    const uint64_t now_us = board->now_us(board->context);
    neo6m_step(&app->gps.receiver, now_us);
    const led_pattern_t pattern = app->panel.is_checking ? LED_FATAL : logger_led(&app->logger);
    const gesture_t gesture = panel_step(&app->panel.pins, pattern, now_us);
    if (gesture != GESTURE_NONE)
        app->panel.gesture = gesture;
    if (app->settings.config.stream) {
        stream_step(&app->stream, &app->imu.sampler, now_us);
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
    if (app->storage.state != STORAGE_CLOSED || !app->card.has_been_tried)
        return CARD_WELL;
    if (app->card.result == STORAGE_FORMAT)
        return CARD_FOREIGN;
    return app->storage.card_error == SD_NO_ANSWER ? CARD_MISSING : CARD_FAILING;
}

static logger_inputs_t inputs(app_t *app, uint64_t now_us)
{
    const bool is_ready = app->storage.state == STORAGE_READY && app->storage.has_spare && !app->recording.is_open;
    const bool has_fix = app->gps.has_fix && now_us - app->gps.fix_us < APP_FIX_US;
    return (logger_inputs_t){
        .now_us = now_us,
        .gesture = app->panel.gesture,
        .is_card_ready = is_ready,
        .is_card_full = app->storage.is_full && !app->storage.has_spare && app->storage.state != STORAGE_CLOSED,
        .card_trouble = card_trouble(app),
        .is_imu_known = app->imu.is_known,
        .is_imu_working = app->imu.is_working,
        .is_mag_working = app->imu.is_working && app->imu.chip.mag_who_am_i != 0,
        .is_gps_working = neo6m_is_working(&app->gps.receiver, now_us),
        .has_fix = has_fix,
        .is_supply_low = app->board->is_supply_low(app->board->context),
        .is_calibrated = app->storage.is_calibrated,
        .calibration_points = app->imu.sampler.points,
    };
}

static void start(app_t *app, uint64_t now_us, bool is_calibration)
{
    if (app->settings.config.self_test && !is_calibration && app->imu.is_working)
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
    if (app->panel.gesture != GESTURE_NONE)
        app_event(app, EVENT_BUTTON, (uint32_t)app->panel.gesture);
    app->panel.gesture = GESTURE_NONE;
    act(app, logger_step(&app->logger, &in), now_us);
}

/* ---- all of it ---- */

static void report(app_t *app, uint64_t now_us)
{
    if (now_us - app->report_us < REPORT_US)
        return;
    app->report_us = now_us;
    (void)serial_print(app->board->serial, "%u s: state %u, %u samples, %u lost, block %u, busy %u us, stack %u free\n",
                       (unsigned)(now_us / 1000000), (unsigned)app->logger.state, (unsigned)app->imu.sampler.samples,
                       (unsigned)app->writer.imu_lost, (unsigned)app->storage.next_block,
                       (unsigned)app->storage.card.longest_busy_us,
                       (unsigned)app->board->stack_free(app->board->context));
}

void app_init(app_t *app, const board_t *board)
{
    const uint64_t now_us = board->now_us(board->context);
    memset(app, 0, sizeof *app);
    app->board = board;
    app->settings.config = config_defaults();
    app->imu.events = (board_events_t){.context = &app->imu.sampler, .on_burst = sampler_on_burst};
    app_clear_ring(app);
    log_writer_start(&app->writer, &app->ring, 1, now_us);
    sampler_init(&app->imu.sampler, &app->writer, 1000);
    logger_init(&app->logger, app->settings.config.autostart, now_us);
    panel_init(&app->panel.pins, &board->panel, now_us);
    app_start_gps(app, now_us);
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
