#include "button.h"
#include "check.h"
#include "led.h"

enum { STEP_US = 5000 };

/* Hold a level for some time; returns the last gesture seen, and counts them. */
static gesture_t hold(button_t *button, bool is_pressed, uint64_t *now_us, uint64_t time_us, unsigned *count)
{
    gesture_t last = GESTURE_NONE;
    for (const uint64_t end_us = *now_us + time_us; *now_us < end_us; *now_us += STEP_US) {
        const gesture_t gesture = button_step(button, is_pressed, *now_us);
        if (gesture != GESTURE_NONE) {
            last = gesture;
            (*count)++;
        }
    }
    return last;
}

static void presses(void)
{
    button_t button;
    uint64_t now_us = 0;
    unsigned count = 0;
    button_init(&button, now_us);
    CHECK_EQUAL(hold(&button, true, &now_us, 200000, &count), GESTURE_NONE);
    CHECK_EQUAL(hold(&button, false, &now_us, 1000000, &count), GESTURE_SHORT);
    CHECK_EQUAL(hold(&button, true, &now_us, 200000, &count), GESTURE_NONE);
    CHECK_EQUAL(hold(&button, false, &now_us, 200000, &count), GESTURE_NONE);
    CHECK_EQUAL(hold(&button, true, &now_us, 200000, &count), GESTURE_NONE);
    CHECK_EQUAL(hold(&button, false, &now_us, 1000000, &count), GESTURE_DOUBLE);
    CHECK_EQUAL(hold(&button, true, &now_us, 5000000, &count), GESTURE_LONG);
    CHECK_EQUAL(hold(&button, false, &now_us, 1000000, &count), GESTURE_NONE);
    CHECK_EQUAL(hold(&button, true, &now_us, 200000, &count), GESTURE_NONE);
    CHECK_EQUAL(hold(&button, false, &now_us, 1000000, &count), GESTURE_SHORT);
    CHECK_EQUAL(count, 4);
}

static void bouncing(void)
{
    button_t button;
    uint64_t now_us = 0;
    unsigned count = 0;
    button_init(&button, now_us);
    for (int i = 0; i < 100; i++) { /* contact noise shorter than the bounce time is no press */
        hold(&button, i % 2 == 0, &now_us, 10000, &count);
    }
    hold(&button, false, &now_us, 1000000, &count);
    CHECK_EQUAL(count, 0);
    for (int i = 0; i < 7; i++) {
        hold(&button, i % 2 == 0, &now_us, 10000, &count);
    }
    hold(&button, true, &now_us, 300000, &count);
    for (int i = 0; i < 6; i++) {
        hold(&button, i % 2 == 0, &now_us, 10000, &count);
    }
    CHECK_EQUAL(hold(&button, false, &now_us, 1000000, &count), GESTURE_SHORT);
    CHECK_EQUAL(count, 1);
}

const suite_t button_suite = {"button",
                              (const test_t[]){{"short, double and long presses are told apart", presses},
                                               {"a bouncing contact is one press", bouncing},
                                               {0}}};

static unsigned flashes(led_pattern_t pattern, uint64_t time_us)
{
    unsigned count = 0;
    bool was_on = false;
    for (uint64_t now_us = 0; now_us < time_us; now_us += 1000) {
        const bool is_on = led_is_on(pattern, now_us);
        count += is_on && !was_on ? 1U : 0U;
        was_on = is_on;
    }
    return count;
}

static void patterns(void)
{
    const uint64_t time_us = 10000000;
    const unsigned want[] = {[LED_OFF] = 0,         [LED_WAITING] = 5,      [LED_RECORDING] = 10,
                             [LED_NO_FIX] = 20,     [LED_OFFERING] = 15,    [LED_CALIBRATING] = 20,
                             [LED_CARD_MISSING] = 100, [LED_CARD_FAILING] = 50,
                             [LED_CARD_FULL] = 25, [LED_CARD_FOREIGN] = 10, [LED_SENSOR_ERROR] = 20, [LED_FATAL] = 1};
    for (led_pattern_t pattern = LED_OFF; pattern <= LED_FATAL; pattern++) {
        CHECK_EQUAL(flashes(pattern, time_us), want[pattern]);
    }
    CHECK(led_is_on(LED_FATAL, 999999));
}

const suite_t led_suite = {"led", (const test_t[]){{"every pattern flashes as described", patterns}, {0}}};
