#include "check.h"
#include "logger.h"

static logger_t logger;
static logger_inputs_t in;

static void begin(bool autostart)
{
    in = (logger_inputs_t){.is_card_ready = true, .is_imu_known = true, .is_imu_working = true, .is_mag_working = true,
                           .is_gps_working = true, .has_fix = true, .is_calibrated = true};
    logger_init(&logger, autostart, 0);
}

static logger_action_t step_after(uint64_t time_us)
{
    in.now_us += time_us;
    const logger_action_t action = logger_step(&logger, &in);
    in.gesture = GESTURE_NONE;
    return action;
}

static logger_action_t step(void)
{
    return step_after(10000);
}

static logger_action_t press(gesture_t gesture)
{
    in.gesture = gesture;
    return step();
}

static void starts_by_itself(void)
{
    begin(true);
    in.is_imu_known = false;
    in.is_card_ready = false;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    in.is_card_ready = true;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    in.is_imu_known = true;
    CHECK_EQUAL(step(), LOGGER_START_RECORDING);
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger.state, LOGGER_RECORDING);
}

static void starts_by_button(void)
{
    begin(false);
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger.state, LOGGER_IDLE);
    CHECK_EQUAL(logger_led(&logger), LED_WAITING);
    CHECK_EQUAL(press(GESTURE_SHORT), LOGGER_START_RECORDING);
    CHECK_EQUAL(press(GESTURE_SHORT), LOGGER_STOP_BUTTON);
    CHECK_EQUAL(logger.state, LOGGER_IDLE);
    CHECK_EQUAL(step_after(100000000), LOGGER_DO_NOTHING);
}

static void stopped_recording_does_not_restart_itself(void)
{
    begin(true);
    CHECK_EQUAL(step(), LOGGER_START_RECORDING);
    CHECK_EQUAL(press(GESTURE_SHORT), LOGGER_STOP_BUTTON);
    CHECK_EQUAL(step_after(100000000), LOGGER_DO_NOTHING);
}

static void offers_calibration_once(void)
{
    begin(true);
    in.is_calibrated = false;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger_led(&logger), LED_OFFERING);
    CHECK_EQUAL(step_after(LOGGER_OFFER_US - 20000), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger.state, LOGGER_OFFERING);
    CHECK_EQUAL(step_after(20000), LOGGER_DO_NOTHING);
    CHECK_EQUAL(step(), LOGGER_START_RECORDING);
}

static void calibrates(void)
{
    begin(true);
    in.is_calibrated = false;
    step();
    CHECK_EQUAL(press(GESTURE_SHORT), LOGGER_START_CALIBRATION);
    CHECK_EQUAL(logger_led(&logger), LED_CALIBRATING);
    in.calibration_points = LOGGER_CALIBRATION_POINTS - 1;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    in.calibration_points = LOGGER_CALIBRATION_POINTS;
    CHECK_EQUAL(step(), LOGGER_STOP_CALIBRATED);
    CHECK_EQUAL(step(), LOGGER_START_RECORDING);
}

static void calibration_by_double_press(void)
{
    begin(false);
    step();
    in.is_mag_working = false;
    CHECK_EQUAL(press(GESTURE_DOUBLE), LOGGER_DO_NOTHING);
    in.is_mag_working = true;
    CHECK_EQUAL(press(GESTURE_DOUBLE), LOGGER_START_CALIBRATION);
    in.is_mag_working = false;
    CHECK_EQUAL(step(), LOGGER_STOP_FAULT);
    in.is_mag_working = true;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(press(GESTURE_DOUBLE), LOGGER_START_CALIBRATION);
    CHECK_EQUAL(step_after(LOGGER_CALIBRATION_LONGEST_US), LOGGER_STOP_FAULT);
}

static void card_away(void)
{
    begin(true);
    step();
    in.is_card_ready = false;
    in.card_trouble = CARD_MISSING;
    CHECK_EQUAL(step_after(100000000), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger.state, LOGGER_RECORDING);
    CHECK_EQUAL(logger_led(&logger), LED_CARD_MISSING);
    in.card_trouble = CARD_FAILING;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger_led(&logger), LED_CARD_FAILING);
    in.card_trouble = CARD_FOREIGN;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger_led(&logger), LED_CARD_FOREIGN);
    in.is_card_ready = true;
    in.card_trouble = CARD_WELL;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger_led(&logger), LED_RECORDING);
}

static void card_full(void)
{
    begin(true);
    step();
    in.is_card_full = true;
    CHECK_EQUAL(step(), LOGGER_STOP_CARD_FULL);
    CHECK_EQUAL(logger_led(&logger), LED_CARD_FULL);
    CHECK_EQUAL(press(GESTURE_SHORT), LOGGER_DO_NOTHING);
    in.is_card_full = false; /* another card */
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(step(), LOGGER_START_RECORDING);
}

static void supply(void)
{
    begin(true);
    step();
    in.is_supply_low = true;
    CHECK_EQUAL(step(), LOGGER_STOP_SUPPLY_LOW);
    CHECK_EQUAL(logger_led(&logger), LED_OFF);
    CHECK_EQUAL(step_after(60000000), LOGGER_DO_NOTHING);
    in.is_supply_low = false;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(step_after(6000000), LOGGER_DO_NOTHING);
    CHECK_EQUAL(step(), LOGGER_START_RECORDING);
}

static void long_press(void)
{
    begin(true);
    step();
    CHECK_EQUAL(press(GESTURE_LONG), LOGGER_STOP_BUTTON);
    CHECK_EQUAL(logger.state, LOGGER_SAFE);
    CHECK_EQUAL(step_after(100000000), LOGGER_DO_NOTHING); /* stays safe, however long it takes to switch off */
    CHECK_EQUAL(logger.state, LOGGER_SAFE);
    CHECK_EQUAL(press(GESTURE_SHORT), LOGGER_DO_NOTHING);
    CHECK_EQUAL(press(GESTURE_SHORT), LOGGER_START_RECORDING);
}

static void sensors_missing(void)
{
    begin(true);
    in.is_imu_working = false;
    in.is_mag_working = false;
    CHECK_EQUAL(step(), LOGGER_START_RECORDING); /* GPS alone is worth a recording */
    CHECK_EQUAL(logger_led(&logger), LED_SENSOR_ERROR);
    in.is_imu_working = true;
    in.has_fix = false;
    step();
    CHECK_EQUAL(logger_led(&logger), LED_NO_FIX);
}

static void nothing_works(void)
{
    begin(true);
    in.is_imu_working = false;
    in.is_gps_working = false;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(step_after(11000000), LOGGER_DO_NOTHING);
    CHECK_EQUAL(logger_led(&logger), LED_FATAL);
    in.is_gps_working = true;
    CHECK_EQUAL(step(), LOGGER_DO_NOTHING);
    CHECK_EQUAL(step(), LOGGER_START_RECORDING);
}

static bool opens(logger_action_t action)
{
    return action == LOGGER_START_RECORDING || action == LOGGER_START_CALIBRATION;
}

/* Whatever happens: starts and stops alternate, and nothing is started on a card that is not ready. */
static void anything(void)
{
    uint32_t state = 99;
    for (int run = 0; run < 200; run++) {
        begin(random_below(&state, 2) == 0);
        bool is_open = false;
        for (int i = 0; i < 2000; i++) {
            if (random_below(&state, 10) == 0) {
                const uint32_t bits = random_next(&state);
                in.is_card_ready = (bits & 1U) != 0;
                in.is_card_full = (bits & 0x30U) == 0;
                in.card_trouble = (bits & 2U) != 0 ? CARD_FAILING : CARD_WELL;
                in.is_imu_working = (bits & 4U) != 0;
                in.is_mag_working = (bits & 8U) != 0;
                in.is_gps_working = (bits & 0x40U) != 0;
                in.is_supply_low = (bits & 0x380U) == 0;
                in.is_calibrated = (bits & 0x400U) != 0;
                in.calibration_points = (uint16_t)(bits >> 16 & 0x3FF);
            }
            in.gesture = random_below(&state, 20) == 0 ? (gesture_t)random_below(&state, 4) : GESTURE_NONE;
            const logger_action_t action = step_after(random_below(&state, 2000000));
            if (action == LOGGER_DO_NOTHING) {
                continue;
            }
            CHECK(opens(action) != is_open);
            CHECK(!opens(action) || (in.is_card_ready && !in.is_supply_low));
            is_open = opens(action);
        }
        CHECK_EQUAL(is_open, logger.state == LOGGER_RECORDING || logger.state == LOGGER_CALIBRATING);
    }
}

const suite_t logger_suite = {
    "logger",
    (const test_t[]){{"with autostart it records as soon as card and sensor are ready", starts_by_itself},
                     {"without, a press starts and a press stops", starts_by_button},
                     {"what a person stopped stays stopped", stopped_recording_does_not_restart_itself},
                     {"the first boot offers a calibration, for some seconds", offers_calibration_once},
                     {"a calibration ends with its points, then the recording begins", calibrates},
                     {"a double press calibrates, and a hopeless calibration ends", calibration_by_double_press},
                     {"a missing card does not end a recording", card_away},
                     {"a full card ends it, another one begins a new one", card_full},
                     {"a low supply ends it, a steady one starts it again", supply},
                     {"a long press makes it safe to switch off", long_press},
                     {"GPS alone is recorded, and the LED says so", sensors_missing},
                     {"without any sensor it is fatal until one comes back", nothing_works},
                     {"whatever happens, starts and stops alternate", anything},
                     {0}}};
