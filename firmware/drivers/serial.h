/* Output that never waits: bytes queue in a ring that the board's interrupt empties. What does not fit is left out as a
 * whole and counted, never cut. And one command, which a person types: `selftest`, ended by Enter. */
#ifndef DRIVERS_SERIAL_H
#define DRIVERS_SERIAL_H

#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
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
    uint8_t heard;               /* letters of the command so far */
    atomic_bool is_command_heard;
} serial_t;

enum { SERIAL_FULL = -1 };

/* Queue `length` bytes, all or none: 0 or SERIAL_FULL. */
int serial_put(serial_t *serial, const uint8_t *data, size_t length);

/* Queue a line of text, printf's %s %u %d %x %c %% (32 bits, no widths). At most 120 characters. 0 or SERIAL_FULL. */
int serial_print(serial_t *serial, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The interrupt's side: the next byte, or -1. */
int serial_take(serial_t *serial);

/* The interrupt's side: a byte has come in. */
void serial_hear(serial_t *serial, uint8_t byte);

/* Whether the command has come since the last call. */
bool serial_is_self_test_asked(serial_t *serial);

#endif
