#include "led.h"

typedef struct {
    uint32_t period_us;
    uint32_t flash_us;   /* length of a flash, and of the pause after it */
    uint32_t flashes;
} rhythm_t;

static const rhythm_t rhythms[] = {
    [LED_OFF] = {1000000, 1, 0},
    [LED_WAITING] = {2000000, 1000000, 1},
    [LED_RECORDING] = {1000000, 100000, 1},
    [LED_NO_FIX] = {1000000, 100000, 2},
    [LED_OFFERING] = {2000000, 150000, 3},
    [LED_CALIBRATING] = {500000, 250000, 1},
    [LED_CARD_MISSING] = {100000, 50000, 1},
    [LED_CARD_FAILING] = {2000000, 50000, 10},
    [LED_CARD_FULL] = {2000000, 50000, 5},
    [LED_CARD_FOREIGN] = {2000000, 50000, 2},
    [LED_SENSOR_ERROR] = {2000000, 150000, 4},
    [LED_FATAL] = {1000000, 1000000, 1},
};

bool led_is_on(led_pattern_t pattern, uint64_t now_us)
{
    const rhythm_t rhythm = rhythms[pattern];
    const uint32_t step = (uint32_t)(now_us % rhythm.period_us) / rhythm.flash_us;
    return step % 2 == 0 && step / 2 < rhythm.flashes;
}
