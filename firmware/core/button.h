/* One button: debouncing and gestures. */
#ifndef CORE_BUTTON_H
#define CORE_BUTTON_H

#include <stdbool.h>
#include <stdint.h>

enum {
    BUTTON_BOUNCE_US = 20000,  /* a level counts after it stood this long */
    BUTTON_LONG_US = 1500000,  /* held */
    BUTTON_DOUBLE_US = 400000  /* between release and second press */
};

typedef enum { GESTURE_NONE, GESTURE_SHORT, GESTURE_DOUBLE, GESTURE_LONG } gesture_t;

typedef struct {
    bool is_down;       /* debounced */
    bool raw;
    bool was_long;
    uint8_t presses;
    uint64_t raw_since_us;
    uint64_t since_us;  /* of the debounced level */
} button_t;

void button_init(button_t *button, uint64_t now_us);

/* Call every few milliseconds with the level of the pin. A long press is told while it is held, a short one when no
 * second came in time. */
gesture_t button_step(button_t *button, bool is_pressed, uint64_t now_us);

#endif
