/* A NEO-6M, or one of its successors, on a serial line: speaks NMEA once a second at 9600 baud until it is told otherwise by UBX. What is sent at
 * another rate than its own arrives as noise. */
#ifndef TESTS_NEO_MODEL_H
#define TESTS_NEO_MODEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { NEO_QUEUE = 8192 };

/* The sentences of one fix, one after the other, and when the first begins; `$UBX,` and 36 bytes in hex is a NAV-VELNED. */
typedef struct {
    uint64_t time_us;
    const char *text;
} neo_fix_t;

typedef struct {
    const uint64_t *now_us;
    const neo_fix_t *fixes; /* said instead of the model's own, and between them that there is none; NULL: its own */
    size_t fix_count, fix_at;
    bool is_absent;
    bool is_deaf;          /* the wire to the receiver is missing */
    uint32_t refuse_class_id; /* this command (class << 8 | id) gets a NAK */
    uint32_t chatter;      /* so many bytes of noise before each epoch */
    bool is_garbled;       /* all it says arrives as noise */
    bool has_fix;
    bool is_modern;        /* an M10: knows CFG-VALSET alone */
    bool is_mute_to_old;   /* and says nothing to what it does not know */
    uint16_t shortest_ms;  /* period that it takes */

    uint32_t baud;
    uint16_t period_ms;
    bool messages[16];     /* of class F0 */
    bool has_velocity;     /* NAV-VELNED is on */
    uint8_t dynamic_model, power_mode;
    uint64_t next_epoch_us;
    uint32_t epochs;

    uint8_t in[64];
    size_t in_length;
    uint8_t out[NEO_QUEUE];      /* on their way, at the line's rate */
    uint32_t out_put, out_taken; /* free-running */
    uint64_t out_us;             /* when byte out_taken begins */
    uint32_t sentences, velocities; /* sent */
} neo_model_t;

void neo_model_init(neo_model_t *receiver, const uint64_t *now_us);
void neo_model_power_cycle(neo_model_t *receiver);

/* Bytes arrive that were sent at `baud`. */
void neo_model_receive(neo_model_t *receiver, const uint8_t *bytes, size_t length, uint32_t baud);

/* The next byte that has gone out completely by now, as a line at `baud` sees it, and when it began; false: none. */
bool neo_model_next(neo_model_t *receiver, uint32_t baud, uint8_t *byte, uint64_t *began_us);

/* When the next byte or epoch is due, at the latest look at neo_model_next. */
uint64_t neo_model_due_us(const neo_model_t *receiver);

#endif
