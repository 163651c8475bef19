/* A board made of models, in time of its own: nothing happens but when somebody waits or clocks a bus. */
#ifndef TESTS_SIM_BOARD_H
#define TESTS_SIM_BOARD_H

#include "board.h"
#include "mpu_model.h"
#include "neo_model.h"
#include "sd_model.h"

enum { SIM_OUTPUT = 1 << 20 };

typedef struct {
    uint64_t now_us;
    sd_model_t card;
    mpu_model_t imu;
    neo_model_t gps;
    board_t board;

    uint32_t sleep_us; /* how long the board sleeps at most: 250 */
    bool is_int_wired;
    bool is_pressed, is_led_on;
    bool is_supply_low;

    /* its insides */
    uint32_t card_hz;
    uint64_t transfer_done_us;
    bool is_transfer_running;
    const uint8_t *transfer_out;
    uint8_t *transfer_in;
    size_t transfer_length;
    const board_events_t *events;
    uint32_t locks;
    uint64_t next_tick_us;
    uint64_t edge_us;
    bool is_in_interrupt;
    uint32_t line_baud;
    uint64_t sent_until_us;
    void (*idle)(void *);
    void *idle_context;
    serial_t serial;
    uint32_t serial_baud;
    uint64_t next_serial_us;
    uint8_t output[SIM_OUTPUT];
    size_t output_length;
    uint64_t fed_us, longest_unfed_us;
    uint32_t led_changes;
    uint16_t mark;
    uint32_t bursts;
} sim_t;

/* A card of `sectors`; the models at rest. `sim` is large: keep it static or on the heap. */
void sim_init(sim_t *sim, sd_model_kind_t kind, uint32_t sectors);
void sim_free(sim_t *sim);

/* Reset of the controller alone, or with everything's power; time goes on. */
void sim_reset(sim_t *sim);
void sim_power_cycle(sim_t *sim);

/* Let time pass and interrupts happen. */
void sim_advance(sim_t *sim, uint64_t duration_us);

#endif
