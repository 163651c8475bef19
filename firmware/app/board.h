/* What the app needs of the board it runs on: buses for the drivers, a clock, the sampling of the IMU in the background,
 * and the few things only hardware can say. port/stm32f103 implements it; the host tests have one made of models. */
#ifndef APP_BOARD_H
#define APP_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "mpu9250.h"
#include "neo6m.h"
#include "panel.h"
#include "sdcard.h"
#include "serial.h"

/* Called from the interrupt of the sampling. */
typedef struct {
    void *context;
    void (*on_burst)(void *context, uint64_t time_us, const uint8_t *burst); /* MPU9250_BURST bytes */
} board_events_t;

/* A fault that ended in the last reset: where, where that was called from, and why (CFSR). */
typedef struct {
    bool is_fault;
    uint32_t pc, lr, status;
} board_fault_t;

typedef struct {
    void *context;
    sd_bus_t card;
    mpu9250_bus_t imu;
    neo6m_port_t gps;
    panel_pins_t panel;
    serial_t *serial;

    uint64_t (*now_us)(void *context);
    /* What to do in card.wait and imu.wait_us, besides waiting. */
    void (*set_idle)(void *context, void (*idle)(void *idle_context), void *idle_context);
    /* Background bursts of the IMU, on its interrupt pin if that is wired, else polled twice a millisecond. */
    void (*start_sampling)(void *context, const board_events_t *events);
    void (*stop_sampling)(void *context);
    bool (*is_sampling_on_pin)(void *context);
    /* Keep board_events_t from being called in between; may be nested. A few microseconds at most. */
    void (*lock)(void *context);
    void (*unlock)(void *context);
    bool (*is_supply_low)(void *context);
    void (*set_serial_baud)(void *context, uint32_t baud);
    void (*feed_watchdog)(void *context);
    void (*sleep)(void *context); /* until the next interrupt, half a millisecond at most */
    void (*restart)(void *context);
    /* A number that survives a reset, for finding out where the watchdog bit. */
    void (*set_mark)(void *context, uint16_t mark);
    uint32_t (*stack_free)(void *context); /* bytes never used since reset */

    uint16_t mark_before_reset;
    uint8_t reset_cause; /* bits 31:24 of RCC_CSR */
    board_fault_t fault;
    uint32_t boot_number;
    uint8_t device[12];
} board_t;

enum { RESET_BY_WATCHDOG = 0x20 }; /* board_t.reset_cause: IWDGRSTF */

#endif
