#include "button.h"

void button_init(button_t *button, uint64_t now_us)
{
    *button = (button_t){.raw_since_us = now_us, .since_us = now_us};
}

static bool has_changed(button_t *button, bool is_pressed, uint64_t now_us)
{
    if (is_pressed != button->raw) {
        button->raw = is_pressed;
        button->raw_since_us = now_us;
    }
    if (button->raw == button->is_down || now_us - button->raw_since_us < BUTTON_BOUNCE_US) {
        return false;
    }
    button->is_down = button->raw;
    button->since_us = now_us;
    return true;
}

static gesture_t on_release(button_t *button)
{
    if (button->was_long) {
        button->was_long = false;
        button->presses = 0;
        return GESTURE_NONE;
    }
    button->presses++;
    if (button->presses < 2) {
        return GESTURE_NONE;
    }
    button->presses = 0;
    return GESTURE_DOUBLE;
}

gesture_t button_step(button_t *button, bool is_pressed, uint64_t now_us)
{
    if (has_changed(button, is_pressed, now_us)) {
        return button->is_down ? GESTURE_NONE : on_release(button);
    }
    const uint64_t held_us = now_us - button->since_us;
    if (button->is_down && !button->was_long && held_us >= BUTTON_LONG_US) {
        button->was_long = true;
        return GESTURE_LONG;
    }
    if (!button->is_down && button->presses == 1 && held_us >= BUTTON_DOUBLE_US) {
        button->presses = 0;
        return GESTURE_SHORT;
    }
    return GESTURE_NONE;
}
