#include <string.h>

#include "check.h"
#include "error.h"
#include "frame.h"

static void put_samples(frame_t *frame, uint32_t first, uint32_t count)
{
    const record_imu_t imu = {{(int16_t)first, 0, 0}, {0, 0, 0}};
    for (uint32_t i = first; i < first + count; i++) {
        int32_t since = -1;
        uint8_t *out = frame_reserve(frame, RECORD_IMU, RECORD_IMU_BYTES, 1000 * (uint64_t)i, &since);
        CHECK(out != NULL && since >= 0);
        if (out != NULL) {
            frame_append(frame, record_put_imu(out, (uint16_t)since, &imu));
        }
    }
}

static void round_trip(void)
{
    frame_t frame;
    frame_view_t view;
    frame_init(&frame);
    frame.number = 0xFFFF;
    put_samples(&frame, 5, 8);
    const size_t length = frame_finish(&frame);
    CHECK_EQUAL(length, FRAME_HEAD + 8 * RECORD_IMU_BYTES + 4);
    CHECK_EQUAL(frame_find(frame.bytes, length, &view), length);
    CHECK(view.number == 0xFFFF && view.base_us == 5000 && view.length == 8 * RECORD_IMU_BYTES);
    CHECK_EQUAL(record_length(view.records, view.length), RECORD_IMU_BYTES);
    frame_next(&frame);
    CHECK_EQUAL(frame.number, 0);
    CHECK_EQUAL(frame_finish(&frame), 0);
}

static void limits(void)
{
    frame_t frame;
    int32_t since;
    frame_init(&frame);
    put_samples(&frame, 0, FRAME_CAPACITY / RECORD_IMU_BYTES);
    CHECK(frame_reserve(&frame, RECORD_IMU, RECORD_IMU_BYTES, 20000, &since) == NULL);
    frame_next(&frame);
    put_samples(&frame, 10, 1);
    CHECK(frame_reserve(&frame, RECORD_IMU, RECORD_IMU_BYTES, 10000 + 65535, &since) != NULL);
    CHECK(frame_reserve(&frame, RECORD_IMU, RECORD_IMU_BYTES, 10000 + 65536, &since) == NULL);
    CHECK(frame_reserve(&frame, RECORD_IMU, RECORD_IMU_BYTES, 9999, &since) == NULL);
    CHECK(frame_reserve(&frame, RECORD_EVENT, RECORD_EVENT_BYTES, 9999, &since) != NULL && since == -1);
}

static void resynchronise(void)
{
    static const char text[] = "debug text\r\n";
    uint8_t line[4096];
    size_t length = 0;
    frame_t frame;
    frame_init(&frame);
    uint32_t state = 3;
    for (uint32_t i = 0; i < 30; i++) {
        const size_t said = random_below(&state, 2) == 0 ? 0 : sizeof text - 1;
        memcpy(line + length, text, said);
        put_samples(&frame, i * 4, 4);
        const size_t bytes = frame_finish(&frame);
        memcpy(line + length + said, frame.bytes, bytes);
        length += said + bytes;
        frame_next(&frame);
    }
    line[20] ^= 1; /* inside the first frame: it alone is lost */
    uint16_t found = 0;
    frame_view_t view;
    size_t at = 0;
    for (size_t done = frame_find(line, length, &view); done > 0; done = frame_find(line + at, length - at, &view)) {
        found = (uint16_t)(found + (view.length > 0 ? 1 : 0));
        at += done;
    }
    CHECK_EQUAL(found, 29);
    CHECK_EQUAL(at, length);
}

static void any_cut(void)
{
    frame_t frame;
    frame_view_t view;
    frame_init(&frame);
    put_samples(&frame, 1, 2);
    const size_t length = frame_finish(&frame);
    for (size_t there = 0; there < length; there++) {
        CHECK_EQUAL(frame_find(frame.bytes, there, &view), 0); /* more is needed, and nothing is dropped */
        CHECK_EQUAL(view.length, 0);
    }
    for (size_t i = 0; i < length; i++) {
        frame.bytes[i] ^= 0x40;
        frame_find(frame.bytes, length, &view);
        CHECK_EQUAL(view.length, 0);
        frame.bytes[i] ^= 0x40;
    }
}

static void impossible_lengths(void)
{
    uint8_t bytes[FRAME_LONGEST] = {FRAME_SYNC_0, FRAME_SYNC_1};
    frame_view_t view;
    for (unsigned records = 0; records < 256; records++) {
        bytes[2] = (uint8_t)records;
        const bool is_possible = records > 0 && records <= FRAME_CAPACITY;
        CHECK_EQUAL(frame_find(bytes, 3, &view), is_possible ? 0 : 1);
    }
}

const suite_t frame_suite = {"frame",
                             (const test_t[]){{"a frame comes back from its bytes", round_trip},
                                              {"what does not fit is refused", limits},
                                              {"frames are found between text", resynchronise},
                                              {"a cut or damaged frame is none", any_cut},
                                              {"a length no frame has is no frame", impossible_lengths},
                                              {0}}};
