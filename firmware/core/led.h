/* What the LED says: a pattern is a row of flashes in a period. */
#ifndef CORE_LED_H
#define CORE_LED_H

#include <stdbool.h>
#include <stdint.h>

typedef enum {
    LED_OFF,
    LED_WAITING,      /* one long, every 2 s: ready, waiting for fix or start */
    LED_RECORDING,    /* one, every second */
    LED_NO_FIX,       /* two, every second: recording without fix */
    LED_OFFERING,     /* three, every 2 s: press to calibrate the magnetometer */
    LED_CALIBRATING,  /* even, twice a second: turn the box */
    LED_CARD_MISSING, /* ten times a second without a pause */
    LED_CARD_FAILING, /* ten times a second for a second, every 2 s */
    LED_CARD_FULL,    /* ten times a second for half a second, every 2 s */
    LED_CARD_FOREIGN, /* two short, every 2 s: not FAT16 or FAT32 */
    LED_SENSOR_ERROR, /* four, every 2 s: recording GPS alone */
    LED_FATAL         /* on */
} led_pattern_t;

bool led_is_on(led_pattern_t pattern, uint64_t now_us);

#endif
