#include <string.h>

#include "bytes.h"
#include "check.h"
#include "error.h"
#include "log_writer.h"

enum { RING = 5, SESSION = 0x1234, SENTENCE = 75 };

static uint8_t storage[RING][BLOCK_BYTES];
static ring_t ring;
static log_writer_t writer;

static void start(uint32_t size)
{
    ring_init(&ring, storage, size);
    log_writer_start(&writer, &ring, SESSION, 0);
}

/* What a reader finds: samples carry their number in the first two values, sentences in theirs. */
typedef struct {
    uint32_t blocks;
    uint32_t sequence;   /* expected next */
    uint32_t imu_number; /* expected next, lost ones included */
    uint32_t sample;     /* number of the next sample */
    uint32_t imu;
    uint32_t sentences;
    uint32_t gaps[256];  /* lost records by source */
    uint32_t stops;
    bool is_right;
} reading_t;

static void read_record(reading_t *reading, const block_record_t *record)
{
    if (record->type == RECORD_IMU) {
        const uint32_t number = bytes_get_u32(record->data);
        reading->is_right &= number == reading->sample && record->time_us == 1000 * (uint64_t)number;
        reading->sample++;
        reading->imu++;
        reading->imu_number++;
    } else if (record->type == RECORD_GAP) {
        const uint32_t count = bytes_get_u32(record->data + 2);
        reading->gaps[record->data[0]] += count;
        if (record->data[0] == RECORD_IMU) {
            reading->is_right &= bytes_get_u48(record->data + 6) == 1000 * (uint64_t)reading->sample;
            reading->sample += count;
            reading->imu_number += count;
            reading->is_right &= bytes_get_u48(record->data + 12) == 1000 * ((uint64_t)reading->sample - 1);
        }
    }
    reading->sentences += record->type == RECORD_GPS ? 1 : 0;
    reading->stops += record->type == RECORD_STOP ? 1 : 0;
}

static void read_block(reading_t *reading, const uint8_t *block)
{
    block_head_t head;
    block_record_t record;
    size_t at = 0;
    reading->is_right &= block_read_head(block, &head) == CORE_OK;
    reading->is_right &= head.session == SESSION && head.sequence == reading->sequence++;
    reading->is_right &= head.imu_number == reading->imu_number;
    reading->blocks++;
    int result = block_next(block, &head, &at, &record);
    for (; result > 0; result = block_next(block, &head, &at, &record)) {
        read_record(reading, &record);
    }
    reading->is_right &= result == 0;
}

static void take(reading_t *reading, uint32_t count)
{
    for (; count > 0 && log_writer_count(&writer) > 0; count--) {
        read_block(reading, log_writer_front(&writer, 0));
        log_writer_release(&writer);
    }
}

static int put_sample(uint32_t number)
{
    const record_imu_t imu = {{(int16_t)(number & 0xFFFF), (int16_t)(number >> 16), 0}, {0, 0, -1}};
    return log_writer_imu(&writer, 1000 * (uint64_t)number, &imu);
}

static int put_sentence(uint64_t time_us)
{
    uint8_t sentence[SENTENCE];
    memset(sentence, 'x', sizeof sentence);
    return log_writer_gps(&writer, time_us, sentence, sizeof sentence);
}

/* Samples with sentences between them, and a consumer that takes a block now and then but stalls often. */
static void run_with_stalls(uint32_t seed, uint32_t size, uint32_t samples)
{
    reading_t reading = {.is_right = true};
    uint32_t state = seed;
    uint32_t stall = 0;
    uint32_t lost = 0;
    uint32_t lost_sentences = 0;
    uint32_t sentences = 0;
    start(size);
    for (uint32_t i = 0; i < samples; i++) {
        lost += put_sample(i) == CORE_NO_ROOM ? 1 : 0;
        if (random_below(&state, 60) == 0) {
            sentences++;
            lost_sentences += put_sentence(1000 * (uint64_t)i - (i > 30 ? 20000 : 0)) == CORE_NO_ROOM ? 1 : 0;
        }
        stall = stall > 0 ? stall - 1 : random_below(&state, 400) == 0 ? random_below(&state, 400) : 0;
        take(&reading, stall == 0 ? 2 : 0);
    }
    take(&reading, UINT32_MAX);
    CHECK_EQUAL(log_writer_stop(&writer, 1000 * (uint64_t)samples, STOP_BUTTON, 0), CORE_OK);
    take(&reading, UINT32_MAX);
    CHECK(reading.is_right);
    CHECK_EQUAL(reading.imu + lost, samples);
    CHECK_EQUAL(reading.gaps[RECORD_IMU], lost);
    CHECK_EQUAL(reading.sentences + lost_sentences, sentences);
    CHECK_EQUAL(reading.gaps[RECORD_GPS], lost_sentences);
    CHECK_EQUAL(reading.stops, 1);
    CHECK_EQUAL(writer.imu_lost, lost);
    CHECK(writer.most_blocks <= size);
}

static void stalls(void)
{
    for (uint32_t seed = 1; seed <= 60; seed++) {
        run_with_stalls(seed, 1 + seed % RING, 5000);
    }
}

static void no_stall_no_loss(void)
{
    reading_t reading = {.is_right = true};
    start(RING);
    for (uint32_t i = 0; i < 10000; i++) {
        CHECK_EQUAL(put_sample(i), CORE_OK);
        take(&reading, 1);
    }
    log_writer_flush(&writer);
    take(&reading, 1);
    CHECK(reading.is_right);
    CHECK_EQUAL(reading.imu, 10000);
    CHECK_EQUAL(reading.blocks, (10000 + 31) / 32); /* 32 samples of 15 bytes in 484 */
}

/* The bound of DESIGN.md: all blocks but the one being filled. */
static void stall_within_the_bound(void)
{
    reading_t reading = {.is_right = true};
    start(RING);
    for (uint32_t i = 0; i < 32 * RING; i++) {
        CHECK_EQUAL(put_sample(i), CORE_OK);
    }
    CHECK_EQUAL(put_sample(32 * RING), CORE_NO_ROOM);
    CHECK_EQUAL(put_sample(32 * RING + 1), CORE_NO_ROOM);
    take(&reading, 1);
    CHECK_EQUAL(put_sample(32 * RING + 2), CORE_OK);
    log_writer_flush(&writer);
    take(&reading, UINT32_MAX);
    CHECK(reading.is_right);
    CHECK_EQUAL(reading.gaps[RECORD_IMU], 2);
    CHECK_EQUAL(reading.imu, 32 * RING + 1);
}

static void slow_samples(void)
{
    start(RING);
    const record_imu_t imu = {{0}, {0}};
    CHECK_EQUAL(log_writer_imu(&writer, 1000, &imu), CORE_OK);
    CHECK_EQUAL(log_writer_imu(&writer, 1000 + 65535, &imu), CORE_OK);
    CHECK_EQUAL(log_writer_count(&writer), 0);
    CHECK_EQUAL(log_writer_imu(&writer, 1000 + 65536, &imu), CORE_OK);
    CHECK_EQUAL(log_writer_count(&writer), 1);
}

static void clock_set_back(void)
{
    start(RING);
    const record_imu_t imu = {{0}, {0}};
    block_head_t head;
    CHECK_EQUAL(log_writer_imu(&writer, 5000, &imu), CORE_OK);
    CHECK_EQUAL(log_writer_imu(&writer, 4000, &imu), CORE_OK);
    log_writer_flush(&writer);
    CHECK_EQUAL(log_writer_count(&writer), 2);
    CHECK_EQUAL(block_read_head(log_writer_front(&writer, 1), &head), CORE_OK);
    CHECK_EQUAL(head.base_us, 4000);
}

/* A sentence is as old as it is long; the samples after it must still fit beside it. */
static void old_sentence_opens_a_block(void)
{
    start(RING);
    const record_imu_t imu = {{0}, {0}};
    CHECK_EQUAL(log_writer_imu(&writer, 200000, &imu), CORE_OK);
    log_writer_flush(&writer);
    CHECK_EQUAL(put_sentence(115000), CORE_OK);
    CHECK_EQUAL(log_writer_imu(&writer, 201000, &imu), CORE_OK);
    CHECK_EQUAL(log_writer_count(&writer), 1);
}

static void event_ahead_of_samples(void)
{
    start(RING);
    const record_imu_t imu = {{0}, {0}};
    CHECK_EQUAL(log_writer_imu(&writer, 1000, &imu), CORE_OK);
    log_writer_flush(&writer);
    CHECK_EQUAL(log_writer_event(&writer, 2300, EVENT_BUTTON, 1), CORE_OK);
    CHECK_EQUAL(log_writer_imu(&writer, 2000, &imu), CORE_OK);
    CHECK_EQUAL(log_writer_count(&writer), 1);
}

static void first_block(void)
{
    start(RING);
    char text[CONFIG_TEXT_LONGEST];
    memset(text, 'c', sizeof text);
    const record_setup_t setup = {.imu_period_us = 1000};
    CHECK_EQUAL(log_writer_setup(&writer, 0, &setup), CORE_OK);
    CHECK_EQUAL(log_writer_config(&writer, 0, text, sizeof text), CORE_OK);
    CHECK_EQUAL(log_writer_count(&writer), 0);
    CHECK_EQUAL(log_writer_config(&writer, 0, text, sizeof text + 1), CORE_TOO_LONG);
}

static void losses_elsewhere(void)
{
    reading_t reading = {.is_right = true};
    start(RING);
    put_sample(0);
    log_writer_lose(&writer, RECORD_IMU, GAP_SENSOR, 1000, 3000, 3);
    log_writer_lose(&writer, RECORD_GPS, GAP_SERIAL, 1500, 2500, 2);
    log_writer_lose(&writer, RECORD_GPS, GAP_SERIAL, 1500, 2500, 0);
    put_sample(4);
    log_writer_flush(&writer);
    take(&reading, UINT32_MAX);
    CHECK(reading.is_right);
    CHECK(reading.gaps[RECORD_IMU] == 3 && reading.gaps[RECORD_GPS] == 2 && reading.imu == 2);
}

static void long_absence(void)
{
    reading_t reading = {.is_right = true};
    start(1);
    uint32_t number = 0;
    while (put_sample(number) == CORE_OK) {
        number++;
    }
    const uint64_t two_hours_us = UINT64_C(7200000000);
    log_writer_lose(&writer, RECORD_IMU, GAP_NO_ROOM, 1000 * (uint64_t)number, two_hours_us - 1000, 7200000 - number - 1);
    take(&reading, UINT32_MAX);
    CHECK_EQUAL(put_sample(7200000), CORE_OK);
    log_writer_flush(&writer);
    take(&reading, UINT32_MAX);
    CHECK(reading.is_right);
    CHECK_EQUAL(reading.gaps[RECORD_IMU], 7200000 - number);
}

static void quiet_line(void)
{
    start(RING);
    CHECK_EQUAL(log_writer_event(&writer, 1000, EVENT_BUTTON, 1), CORE_OK);
    const uint64_t two_hours_us = UINT64_C(7200000000);
    CHECK_EQUAL(log_writer_event(&writer, two_hours_us, EVENT_BUTTON, 1), CORE_OK); /* no record every hour is lost */
    log_writer_flush(&writer);
    block_head_t head;
    block_record_t record;
    size_t at = 0;
    CHECK_EQUAL(block_read_head(log_writer_front(&writer, 1), &head), CORE_OK);
    CHECK_EQUAL(block_next(log_writer_front(&writer, 1), &head, &at, &record), 1);
    CHECK_EQUAL(record.time_us, two_hours_us);
}

static void age(void)
{
    start(RING);
    put_sample(5);
    log_writer_flush_older(&writer, 5000 + 1000, 1000);
    CHECK_EQUAL(log_writer_count(&writer), 0);
    log_writer_flush_older(&writer, 5000 + 1001, 1000);
    CHECK_EQUAL(log_writer_count(&writer), 1);
    log_writer_flush_older(&writer, 9000000, 1000);
    log_writer_flush(&writer);
    CHECK_EQUAL(log_writer_count(&writer), 1);
}

static void stop_waits_for_room(void)
{
    reading_t reading = {.is_right = true};
    start(1);
    uint32_t number = 0;
    while (put_sample(number) == CORE_OK) {
        number++;
    }
    CHECK_EQUAL(log_writer_stop(&writer, 40000, STOP_BUTTON, 3), CORE_NO_ROOM);
    take(&reading, UINT32_MAX);
    CHECK_EQUAL(log_writer_stop(&writer, 40000, STOP_BUTTON, 3), CORE_OK);
    take(&reading, UINT32_MAX);
    CHECK(reading.is_right);
    CHECK(reading.stops == 1 && reading.gaps[RECORD_IMU] == 1);
}

static void blocks_written_again_are_the_same(void)
{
    start(RING);
    put_sample(0);
    log_writer_flush(&writer);
    uint8_t copy[BLOCK_BYTES];
    memcpy(copy, log_writer_front(&writer, 0), sizeof copy);
    CHECK_SAME(log_writer_front(&writer, 0), copy, sizeof copy);
    CHECK(log_writer_front(&writer, 1) == NULL);
}

const suite_t log_writer_suite = {
    "log_writer",
    (const test_t[]){{"without stalls nothing is lost and blocks are full", no_stall_no_loss},
                     {"a stall as long as the ring loses nothing, one sample more is a gap", stall_within_the_bound},
                     {"whatever the stalls, what is not there is counted in gaps", stalls},
                     {"samples 65 ms after the base start a new block", slow_samples},
                     {"a clock set back starts a new block", clock_set_back},
                     {"a block that an old sentence opens takes the next samples", old_sentence_opens_a_block},
                     {"so does one that an event opens, though it is younger", event_ahead_of_samples},
                     {"settings and setup fit into the first block", first_block},
                     {"what was lost before the writer is a gap too", losses_elsewhere},
                     {"a gap of two hours is one record", long_absence},
                     {"an event after two quiet hours has its own time", quiet_line},
                     {"a block is committed when it is old", age},
                     {"stopping waits for room and counts what was lost", stop_waits_for_room},
                     {"a block asked for again is the same", blocks_written_again_are_the_same},
                     {0}}};
