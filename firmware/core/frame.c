#include "frame.h"

#include <string.h>

#include "bytes.h"
#include "crc32.h"

enum { NUMBER_AT = 3, BASE_AT = 5, CRC_BYTES = 4, LENGTH_AT = 2, LONGEST_SHORT_TIME_US = 65535 };

void frame_init(frame_t *frame)
{
    memset(frame, 0, sizeof *frame);
}

uint8_t *frame_reserve(frame_t *frame, uint8_t type, size_t length, uint64_t time_us, int32_t *since_base_us)
{
    if (frame->used == 0) {
        frame->base_us = time_us;
    }
    const int64_t since_us = (int64_t)time_us - (int64_t)frame->base_us;
    const bool is_long = type >= RECORD_FIRST_LONG;
    const int64_t least = is_long ? INT32_MIN : 0;
    const int64_t most = is_long ? INT32_MAX : LONGEST_SHORT_TIME_US;
    if (length > FRAME_CAPACITY - frame->used || since_us < least || since_us > most) {
        return NULL;
    }
    *since_base_us = (int32_t)since_us;
    return frame->bytes + FRAME_HEAD + frame->used;
}

void frame_append(frame_t *frame, size_t length)
{
    frame->used += length;
}

size_t frame_finish(frame_t *frame)
{
    if (frame->used == 0) {
        return 0;
    }
    frame->bytes[0] = FRAME_SYNC_0;
    frame->bytes[1] = FRAME_SYNC_1;
    frame->bytes[LENGTH_AT] = (uint8_t)frame->used;
    bytes_put_u16(frame->bytes + NUMBER_AT, frame->number);
    bytes_put_u48(frame->bytes + BASE_AT, frame->base_us);
    const size_t end = FRAME_HEAD + frame->used;
    bytes_put_u32(frame->bytes + end, crc32_update(0, frame->bytes + LENGTH_AT, end - LENGTH_AT));
    return end + CRC_BYTES;
}

void frame_next(frame_t *frame)
{
    frame->used = 0;
    frame->number++;
}

static size_t find_sync(const uint8_t *bytes, size_t length)
{
    size_t at = 0;
    while (at < length && (bytes[at] != FRAME_SYNC_0 || (at + 1 < length && bytes[at + 1] != FRAME_SYNC_1))) {
        at++;
    }
    return at;
}

static bool is_good(const uint8_t *frame, size_t records)
{
    const size_t end = FRAME_HEAD + records;
    return crc32_update(0, frame + LENGTH_AT, end - LENGTH_AT) == bytes_get_u32(frame + end);
}

size_t frame_find(const uint8_t *bytes, size_t length, frame_view_t *view)
{
    view->length = 0;
    const size_t noise = find_sync(bytes, length);
    if (noise > 0) {
        return noise;
    }
    if (length <= LENGTH_AT) {
        return 0;
    }
    const size_t records = bytes[LENGTH_AT];
    if (records == 0 || records > FRAME_CAPACITY) {
        return 1;
    }
    const size_t whole = FRAME_HEAD + records + CRC_BYTES;
    if (length < whole) {
        return 0;
    }
    if (!is_good(bytes, records)) {
        return 1;
    }
    view->number = bytes_get_u16(bytes + NUMBER_AT);
    view->base_us = bytes_get_u48(bytes + BASE_AT);
    view->records = bytes + FRAME_HEAD;
    view->length = records;
    return whole;
}
