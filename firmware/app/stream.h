/* Live records over the serial line, in the frames of FORMAT.md section 7. */
#ifndef APP_STREAM_H
#define APP_STREAM_H

#include <stdbool.h>
#include <stdint.h>

#include "frame.h"
#include "sampler.h"
#include "serial.h"

enum {
    STREAM_SAMPLES = 8,      /* in one frame at most */
    STREAM_AGE_US = 20000,   /* a frame is sent when it is this old */
    STREAM_SETUP_US = 2000000
};

/* What only a stream needs: the ring lends it two blocks. */
typedef struct {
    frame_t frame;
    sampler_item_t queue[SAMPLER_QUEUE];
} stream_memory_t;

typedef struct {
    frame_t *frame;
    serial_t *serial;
    uint64_t opened_us; /* first record of the frame */
    uint64_t setup_us;  /* last SETUP */
    uint8_t samples;    /* in the frame */
} stream_t;

void stream_init(stream_t *stream, serial_t *serial, frame_t *frame);

/* Send what the sampler has left, and frames that have waited long enough. */
void stream_step(stream_t *stream, sampler_t *sampler, uint64_t now_us);

void stream_sentence(stream_t *stream, uint64_t time_us, const uint8_t *sentence, size_t length);
bool stream_is_setup_due(const stream_t *stream, uint64_t now_us);
void stream_setup(stream_t *stream, uint64_t time_us, const record_setup_t *setup);

#endif
