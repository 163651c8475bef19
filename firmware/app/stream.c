#include "stream.h"

void stream_init(stream_t *stream, serial_t *serial, frame_t *frame)
{
    *stream = (stream_t){.serial = serial, .frame = frame};
    frame_init(frame);
}

/* Close the frame and queue it. One that finds no room is left out; its number tells the reader. */
static void send(stream_t *stream)
{
    const size_t length = frame_finish(stream->frame);
    if (length)
        (void)serial_put(stream->serial, stream->frame->bytes, length);
    frame_next(stream->frame);
    stream->samples = 0;
}

/* Room for a record, in this frame or the next; NULL only if it would not fit into an empty one. */
static uint8_t *reserve(stream_t *stream, uint8_t type, size_t length, uint64_t time_us,
                        int32_t *since_base_us)
{
    uint8_t *room = frame_reserve(stream->frame, type, length, time_us, since_base_us);
    if (room == NULL) {
        send(stream);
        room = frame_reserve(stream->frame, type, length, time_us, since_base_us);
    }
    if (stream->frame->used == 0)
        stream->opened_us = time_us;
    return room;
}

static void put_sample(stream_t *stream, const sampler_item_t *item)
{
    int32_t since_us = 0;
    uint8_t *room = reserve(stream, RECORD_IMU, RECORD_IMU_BYTES, item->time_us, &since_us);
    if (room)
        frame_append(stream->frame, record_put_imu(room, (uint16_t)since_us, &item->imu));
    if (item->has_mag) {
        room = reserve(stream, RECORD_MAG, RECORD_MAG_BYTES, item->time_us, &since_us);
        if (room)
            frame_append(stream->frame, record_put_mag(room, (uint16_t)since_us, &item->mag));
    }
    if (++stream->samples >= STREAM_SAMPLES)
        send(stream);
}

void stream_step(stream_t *stream, sampler_t *sampler, uint64_t now_us)
{
    sampler_item_t item;
    for (int i = 0; i < SAMPLER_QUEUE && sampler_take(sampler, &item); i++)
        put_sample(stream, &item);
    if (stream->frame->used && now_us - stream->opened_us > STREAM_AGE_US)
        send(stream);
}

void stream_sentence(stream_t *stream, uint64_t time_us, const uint8_t *sentence, size_t length)
{
    int32_t since_us = 0;
    uint8_t *room = reserve(stream, RECORD_GPS, RECORD_LONG_HEAD + length, time_us, &since_us);
    if (room)
        frame_append(stream->frame, record_put_gps(room, since_us, sentence, length));
}

bool stream_is_setup_due(const stream_t *stream, uint64_t now_us)
{
    return stream->setup_us == 0 || now_us - stream->setup_us >= STREAM_SETUP_US;
}

void stream_setup(stream_t *stream, uint64_t time_us, const record_setup_t *setup)
{
    int32_t since_us = 0;
    uint8_t *room = reserve(stream, RECORD_SETUP, RECORD_SETUP_BYTES, time_us, &since_us);
    if (room)
        frame_append(stream->frame, record_put_setup(room, since_us, setup));
    stream->setup_us = time_us;
}
