#include "logger.h"

enum { FATAL_AFTER_US = 10000000, SUPPLY_STEADY_US = 5000000 };

void logger_init(logger_t *logger, bool autostart, uint64_t now_us)
{
    *logger = (logger_t){.state = LOGGER_STARTING, .since_us = now_us, .autostart = autostart};
}

static logger_action_t enter(logger_t *logger, logger_state_t state, const logger_inputs_t *in, logger_action_t action)
{
    logger->state = state;
    logger->since_us = in->now_us;
    return action;
}

static bool has_lasted(const logger_t *logger, const logger_inputs_t *in, uint64_t time_us)
{
    return in->now_us - logger->since_us >= time_us;
}

static logger_action_t begin(logger_t *logger, const logger_inputs_t *in)
{
    return enter(logger, LOGGER_RECORDING, in, LOGGER_START_RECORDING);
}

static logger_action_t begin_or_wait(logger_t *logger, const logger_inputs_t *in)
{
    return logger->autostart ? begin(logger, in) : enter(logger, LOGGER_IDLE, in, LOGGER_DO_NOTHING);
}

static logger_action_t calibrate(logger_t *logger, const logger_inputs_t *in)
{
    return enter(logger, LOGGER_CALIBRATING, in, LOGGER_START_CALIBRATION);
}

/* Stop for good. `action` ends what is open. */
static logger_action_t secure(logger_t *logger, const logger_inputs_t *in, logger_action_t action)
{
    logger->is_safe_by_supply = in->is_supply_low;
    return enter(logger, LOGGER_SAFE, in, action);
}

static logger_action_t step_starting(logger_t *logger, const logger_inputs_t *in)
{
    if (in->is_supply_low || in->gesture == GESTURE_LONG) {
        return secure(logger, in, LOGGER_DO_NOTHING);
    }
    if (in->is_card_full) {
        return enter(logger, LOGGER_FULL, in, LOGGER_DO_NOTHING);
    }
    if (in->is_imu_known && !in->is_imu_working && !in->is_gps_working) {
        return has_lasted(logger, in, FATAL_AFTER_US) ? enter(logger, LOGGER_FATAL, in, LOGGER_DO_NOTHING)
                                                      : LOGGER_DO_NOTHING;
    }
    if (!in->is_imu_known || !in->is_card_ready) {
        return LOGGER_DO_NOTHING;
    }
    if (in->is_mag_working && !in->is_calibrated && !logger->was_offered) {
        logger->was_offered = true;
        return enter(logger, LOGGER_OFFERING, in, LOGGER_DO_NOTHING);
    }
    return begin_or_wait(logger, in);
}

static logger_action_t step_offering(logger_t *logger, const logger_inputs_t *in)
{
    if (in->is_supply_low || in->gesture == GESTURE_LONG) {
        return secure(logger, in, LOGGER_DO_NOTHING);
    }
    if (in->gesture != GESTURE_NONE && in->is_card_ready && in->is_mag_working) {
        return calibrate(logger, in);
    }
    return has_lasted(logger, in, LOGGER_OFFER_US) ? enter(logger, LOGGER_STARTING, in, LOGGER_DO_NOTHING)
                                                   : LOGGER_DO_NOTHING;
}

static logger_action_t step_idle(logger_t *logger, const logger_inputs_t *in)
{
    if (in->is_supply_low || in->gesture == GESTURE_LONG) {
        return secure(logger, in, LOGGER_DO_NOTHING);
    }
    if (in->is_card_full) {
        return enter(logger, LOGGER_FULL, in, LOGGER_DO_NOTHING);
    }
    if (in->gesture == GESTURE_SHORT && in->is_card_ready) {
        return begin(logger, in);
    }
    const bool can_calibrate = in->is_card_ready && in->is_mag_working;
    return in->gesture == GESTURE_DOUBLE && can_calibrate ? calibrate(logger, in) : LOGGER_DO_NOTHING;
}

/* What ends a recording and a calibration alike; LOGGER_DO_NOTHING if nothing does. A missing card does not: samples are
 * kept, what finds no room becomes a gap, and the recording goes on when the card is back. */
static logger_action_t step_open(logger_t *logger, const logger_inputs_t *in)
{
    if (in->is_supply_low) {
        return secure(logger, in, LOGGER_STOP_SUPPLY_LOW);
    }
    if (in->gesture == GESTURE_LONG) {
        return secure(logger, in, LOGGER_STOP_BUTTON);
    }
    if (in->is_card_full) {
        return enter(logger, LOGGER_FULL, in, LOGGER_STOP_CARD_FULL);
    }
    return in->gesture == GESTURE_SHORT ? enter(logger, LOGGER_IDLE, in, LOGGER_STOP_BUTTON) : LOGGER_DO_NOTHING;
}

static logger_action_t step_calibrating(logger_t *logger, const logger_inputs_t *in)
{
    const logger_action_t action = step_open(logger, in);
    if (action != LOGGER_DO_NOTHING) {
        return action;
    }
    if (in->calibration_points >= LOGGER_CALIBRATION_POINTS) {
        return enter(logger, LOGGER_STARTING, in, LOGGER_STOP_CALIBRATED);
    }
    const bool is_hopeless = !in->is_mag_working || has_lasted(logger, in, LOGGER_CALIBRATION_LONGEST_US);
    return is_hopeless ? enter(logger, LOGGER_STARTING, in, LOGGER_STOP_FAULT) : LOGGER_DO_NOTHING;
}

static logger_action_t step_full(logger_t *logger, const logger_inputs_t *in)
{
    if (in->is_supply_low || in->gesture == GESTURE_LONG) {
        return secure(logger, in, LOGGER_DO_NOTHING);
    }
    return in->is_card_ready && !in->is_card_full ? enter(logger, LOGGER_STARTING, in, LOGGER_DO_NOTHING)
                                                  : LOGGER_DO_NOTHING;
}

/* Safe to switch off, until a press asks for more or a supply that had sagged has been steady for a while. */
static logger_action_t step_safe(logger_t *logger, const logger_inputs_t *in)
{
    if (in->is_supply_low) {
        logger->since_us = in->now_us;
        return LOGGER_DO_NOTHING;
    }
    if (in->gesture == GESTURE_SHORT) {
        return enter(logger, LOGGER_IDLE, in, LOGGER_DO_NOTHING);
    }
    const bool is_steady = logger->is_safe_by_supply && has_lasted(logger, in, SUPPLY_STEADY_US);
    return is_steady ? enter(logger, LOGGER_STARTING, in, LOGGER_DO_NOTHING) : LOGGER_DO_NOTHING;
}

static logger_action_t step_fatal(logger_t *logger, const logger_inputs_t *in)
{
    const bool is_back = in->is_imu_working || in->is_gps_working;
    return is_back ? enter(logger, LOGGER_STARTING, in, LOGGER_DO_NOTHING) : LOGGER_DO_NOTHING;
}

logger_action_t logger_step(logger_t *logger, const logger_inputs_t *inputs)
{
    logger->card_trouble = inputs->card_trouble;
    logger->is_imu_working = inputs->is_imu_working;
    logger->has_fix = inputs->has_fix;
    switch (logger->state) {
    case LOGGER_STARTING: return step_starting(logger, inputs);
    case LOGGER_OFFERING: return step_offering(logger, inputs);
    case LOGGER_IDLE: return step_idle(logger, inputs);
    case LOGGER_RECORDING: return step_open(logger, inputs);
    case LOGGER_CALIBRATING: return step_calibrating(logger, inputs);
    case LOGGER_FULL: return step_full(logger, inputs);
    case LOGGER_SAFE: return step_safe(logger, inputs);
    case LOGGER_FATAL: return step_fatal(logger, inputs);
    }
    return LOGGER_DO_NOTHING;
}

static led_pattern_t led_of_recording(const logger_t *logger)
{
    if (!logger->is_imu_working) {
        return LED_SENSOR_ERROR;
    }
    return logger->has_fix ? LED_RECORDING : LED_NO_FIX;
}

static led_pattern_t led_of_card(card_trouble_t trouble)
{
    if (trouble == CARD_MISSING) {
        return LED_CARD_MISSING;
    }
    return trouble == CARD_FOREIGN ? LED_CARD_FOREIGN : LED_CARD_FAILING;
}

led_pattern_t logger_led(const logger_t *logger)
{
    if (logger->state == LOGGER_FATAL) {
        return LED_FATAL;
    }
    if (logger->state == LOGGER_SAFE) {
        return LED_OFF;
    }
    if (logger->card_trouble != CARD_WELL) {
        return led_of_card(logger->card_trouble);
    }
    if (logger->state == LOGGER_FULL) {
        return LED_CARD_FULL;
    }
    switch (logger->state) {
    case LOGGER_OFFERING: return LED_OFFERING;
    case LOGGER_RECORDING: return led_of_recording(logger);
    case LOGGER_CALIBRATING: return LED_CALIBRATING;
    default: return LED_WAITING;
    }
}
