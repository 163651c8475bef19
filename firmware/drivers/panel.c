#include "panel.h"

void panel_init(panel_t *panel, const panel_pins_t *pins, uint64_t now_us)
{
    panel->pins = pins;
    button_init(&panel->button, now_us);
}

gesture_t panel_step(panel_t *panel, led_pattern_t pattern, uint64_t now_us)
{
    const panel_pins_t *pins = panel->pins;
    pins->set_led(pins->context, led_is_on(pattern, now_us));
    return button_step(&panel->button, pins->is_pressed(pins->context), now_us);
}
