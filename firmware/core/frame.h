/* Frames of FORMAT.md section 7, for the stream on USART1: encoding, and a decoder that resynchronises. */
#ifndef CORE_FRAME_H
#define CORE_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "records.h"

enum {
    FRAME_SYNC_0 = 0xA5,
    FRAME_SYNC_1 = 0x5A,
    FRAME_HEAD = 11,
    FRAME_CAPACITY = 240, /* bytes of records */
    FRAME_LONGEST = FRAME_HEAD + FRAME_CAPACITY + 4
};

typedef struct {
    uint8_t bytes[FRAME_LONGEST];
    size_t used; /* bytes of records so far */
    uint64_t base_us;
    uint16_t number;
} frame_t;

void frame_init(frame_t *frame);

/* Where record_put_* may write a record of this type, `length` bytes (RECORD_*_BYTES) and time, and its time since the
 * base in *since_base_us; NULL if it does not fit (space, or time of a short record): finish the frame first. */
uint8_t *frame_reserve(frame_t *frame, uint8_t type, size_t length, uint64_t time_us, int32_t *since_base_us);
void frame_append(frame_t *frame, size_t length);

/* Close the frame and return its length in frame->bytes, 0 if it is empty; frame_next starts the one after it. */
size_t frame_finish(frame_t *frame);
void frame_next(frame_t *frame);

typedef struct {
    uint16_t number;
    uint64_t base_us;
    const uint8_t *records;
    size_t length;
} frame_view_t;

/* Look for a frame in `bytes`. Returns the bytes that are done with (drop them and call again), *view filled if they
 * end with a good frame, view->length 0 if not. 0: more bytes are needed. */
size_t frame_find(const uint8_t *bytes, size_t length, frame_view_t *view);

#endif
