/* Output that never waits: bytes queue in a ring that the board's interrupt empties. What does not fit is left out as a
 * whole and counted, never cut. */
#ifndef DRIVERS_SERIAL_H
#define DRIVERS_SERIAL_H

#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

enum { SERIAL_QUEUE = 512 }; /* two of the longest frames; a power of two */

typedef struct {
    uint8_t bytes[SERIAL_QUEUE];
    atomic_uint_fast32_t put;   /* by the main loop */
    atomic_uint_fast32_t taken; /* by the interrupt */
    uint32_t dropped;           /* messages */
    void (*kick)(void *context); /* there is something to send */
    void *context;
} serial_t;

enum { SERIAL_FULL = -1 };

/* Queue `length` bytes, all or none: 0 or SERIAL_FULL. */
int serial_put(serial_t *serial, const uint8_t *data, size_t length);

/* Queue a line of text, printf's %s %u %d %x %c %% (32 bits, no widths). At most 120 characters. 0 or SERIAL_FULL. */
int serial_print(serial_t *serial, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The interrupt's side: the next byte, or -1. */
int serial_take(serial_t *serial);

#endif
