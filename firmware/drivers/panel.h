/* The LED and the button: pins on one side, patterns and gestures of core on the other. */
#ifndef DRIVERS_PANEL_H
#define DRIVERS_PANEL_H

#include <stdbool.h>
#include <stdint.h>

#include "button.h"
#include "led.h"

typedef struct {
    void *context;
    void (*set_led)(void *context, bool is_on);
    bool (*is_pressed)(void *context);
} panel_pins_t;

typedef struct {
    const panel_pins_t *pins;
    button_t button;
} panel_t;

void panel_init(panel_t *panel, const panel_pins_t *pins, uint64_t now_us);

/* Show `pattern` and look at the button; call every few milliseconds. */
gesture_t panel_step(panel_t *panel, led_pattern_t pattern, uint64_t now_us);

#endif
